"""A carriage on a timing belt (thesis chapter 4), simulated: its position error against the encoder on the motor.

Three masses: the motor, under a speed loop; the pulley, behind gears that have play; and the carriage, on a guide that
rubs. Between pulley and carriage the belt is a spring on both sides of the carriage, in series with three groups of
teeth. A group's teeth lie on one flank or the other, where they are elastic, or between them; there friction carries
the belt, which creeps with the travel as far as the friction has more to carry than the teeth (thesis 4.2).

    e = x_scale - x_encoder = carriage - motor + guides and Abbe offset (4.1) + tooth wave

What the encoder does not see is thus play, teeth, belt and load: an engaged belt errs by its band and by what friction
stretches it; a turn winds that back, crosses the play, and creeps to the other flanks. The thesis's recordings were
never published.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.plants.excitation import band_limited_noise
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate
from greygate.reading import read_toml

SAMPLE_TIME = 5e-3
TRAVEL = 0.3  # m
ENCODER = 1e-5  # m of belt per count of the motor's encoder
SCALE = 1e-6  # m per count of the linear scale on the carriage
SCALE_NOISE = 1e-6  # m RMS
PLAY = 120e-6  # m, the gearbox
TRAINING_SPEED = 0.040  # m/s
SLIP = 0.15  # RMS of the relative variation of slip from one moment to the next

GROUPS = (1, 2, 3)  # of teeth

SIMULATED = Path(__file__).parent / "simulated"
PLANT = Plant.read(SIMULATED / "belt_drive.toml")


def belt_drive(**values: float) -> Plant:
    """The drive after an engaged forward motion: inputs `v` (m/s, the speed asked of the motor), `slip` (relative).

    Outputs: `x` (m, of the motor), `e` (m), `e_smooth` (m, e without the tooth wave), `gap` (m, in the gears), `w1` to
    `w3`, the places of the groups of teeth. Raises InputError for an unknown parameter.
    """
    return PLANT.with_parameters(**values)


@dataclass(frozen=True)
class Motion:
    """A motion: the positions at which the carriage turns (m, from 0 on), its speed (m/s), and whether it is by hand.

    day: seed of the conditions of that day (tooth phase, warmth, preload), of the hand, and of the noise.
    """

    turns: Sequence[float]
    speed: float
    day: int
    by_hand: bool = True


def _mm(*turns: float) -> tuple[float, ...]:
    return tuple(t / 1e3 for t in turns)


def _loops(told: Mapping[str, Sequence[Sequence[float]]]) -> tuple[float, ...]:
    """Turns of motions out and home; each loop lists its turns on the way."""
    return _mm(*(t for loop in told["forth"] for t in loop), 299, *(t for loop in told["back"] for t in loop), 1)


_STAIRS = _mm(*(t for far in (25, 30, 37, *range(50, 300, 25)) for t in (far, 0.5)), 299.5)
_STAIRS += _mm(*(t for near in (275, 270, 263, *range(250, 0, -25)) for t in (near, 299.5)), 0.5)
_TURNS = read_toml(SIMULATED / "motions.toml", "install greygate again")
MOTIONS = {
    "training": Motion((*_STAIRS, *_loops(_TURNS["cascades"])), TRAINING_SPEED, 1, by_hand=False),
    "boundaries": Motion(_mm(299.5, 0.5) * 12, TRAINING_SPEED, 2, by_hand=False),
    **{name: Motion(_loops(told), told["speed"], told["day"]) for name, told in _TURNS["by_hand"].items()},
}
"""Training recordings and the thesis's scenarios."""


def record(name: str) -> Recording:
    """A motion of `MOTIONS`, driven and measured; see `measure`. Raises InputError for another name.

    training: out and back to every 25 mm (and 30, 37 mm) from either end (4.3.2), then cascaded loops.
    boundaries: 12 round trips. choice: by hand, for the choices that training leaves open.
    """
    if name not in MOTIONS:
        raise InputError(f"motion {name!r} is unknown; give one of {', '.join(MOTIONS)}")
    return measure(MOTIONS[name], source=name)


def velocity(motion: Motion) -> np.ndarray:
    """Speed of the motor, m/s, (samples,): smooth ramps at both ends of each leg; a hand varies the rest by a fifth."""
    rng, legs, at = np.random.default_rng(motion.day), [], 0.0
    for turn in motion.turns:
        distance, ramp = abs(turn - at), 0.06 * motion.speed / TRAINING_SPEED
        speed = motion.speed * (rng.uniform(0.85, 1.15) if motion.by_hand else 1.0)
        steps = max(round((distance / speed + ramp) / SAMPLE_TIME), 4)
        t = (np.arange(steps) + 0.5) / steps
        edge = np.minimum(np.minimum(t, 1 - t) * steps * SAMPLE_TIME / ramp, 1.0)
        shape = np.sin(np.pi / 2 * edge) ** 2
        if motion.by_hand:
            waves = range(1, max(2, round(steps * SAMPLE_TIME * 1.5)))
            sway = sum(rng.normal() / n**0.5 * np.sin(np.pi * n * t + rng.uniform(0, np.pi)) for n in waves)
            shape = shape * (1 + 0.2 * np.tanh(sway))
        legs.append((turn - at) * shape / (shape.sum() * SAMPLE_TIME))
        at = turn
    return np.concatenate(legs)


def measure(motion: Motion, source: str = "belt_drive", varying: float = 1.0, **values: float) -> Recording:
    """Drive the rig on the motion's day and read it every 5 ms.

    varying: factor on how slip varies from moment to moment. values: other parameters of the rig. Channels: `x` of the
    encoder (10 um per count), `e` = linear scale (1 um per count, noisy) minus encoder; the true values `x_true`,
    `e_smooth`, `v`; and `engaged`: 1 on the lower boundary, -1 on the upper one, between them inside.
    """
    rng = np.random.default_rng(1000 + motion.day)
    day = {
        "phase": rng.uniform(0, 2 * np.pi),
        "drift": 3e-6 * rng.normal(),
        "closing": 1 + 0.06 * rng.normal(),
        "viscous": PLANT.parameters["viscous"].value * (1 + 0.1 * rng.normal()),
    }
    plant = belt_drive(**(day | values))
    v = velocity(motion)
    slip = np.clip(band_limited_noise(len(v), SLIP, 0.02, 0.5, SAMPLE_TIME, seed=2000 + motion.day), -0.6, 0.6)
    true = simulate(plant, {"v": v, "slip": varying * slip}, sample_time=SAMPLE_TIME)
    x = ENCODER * np.round(true["x"] / ENCODER)
    scale = SCALE * np.round((true["x"] + true["e"] + SCALE_NOISE * rng.standard_normal(true.samples)) / SCALE)
    channels = {
        "x": x,
        "e": scale - x,
        "x_true": true["x"],
        "e_smooth": true["e_smooth"],
        "v": true["v"],
        "engaged": -sum(np.clip(true[f"w{n}"], -1, 1) for n in GROUPS) / len(GROUPS),
    }
    return Recording(SAMPLE_TIME, channels, dict.fromkeys(channels, "m") | {"v": "m/s", "engaged": "1"}, source)
