"""A carriage on a timing belt (thesis chapter 4), simulated: its position error against the encoder on the motor.

    e = x_scale - x_encoder = centre(x) + half band(x) * engagement + play + lag(v) + tooth wave

`engagement` goes from -1 (the teeth push the carriage forward: lower boundary) to 1 (upper boundary) in three slip
elements of different closing distance, so that the path inside the band depends on the place and the history of the
turn. `play` is that of the gearbox, which is crossed in half a millisecond. The thesis's recordings were never
published.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greygate.errors import InputError
from greygate.plants.excitation import band_limited_noise
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State
from greygate.plants.recording import Recording
from greygate.plants.simulate import simulate

SAMPLE_TIME = 5e-3
TRAVEL = 0.3  # m
ENCODER = 1e-5  # m of belt per count of the motor's encoder
SCALE = 1e-6  # m per count of the linear scale on the carriage
SCALE_NOISE = 1e-6  # m RMS
PLAY = 120e-6  # m, the gearbox
TRAINING_SPEED = 0.040  # m/s
SLIP = 0.15  # RMS of the relative variation of slip from one moment to the next

_ELEMENTS = {1: (0.30, 0.004), 2: (0.35, 0.009), 3: (0.35, 0.018)}  # part of the band, closing distance in m
_TURN = 2 * np.pi


def belt_drive(**values: float) -> Plant:
    """The drive after an engaged forward motion: inputs `v` (m/s, of the motor at the belt), `slip` (relative).

    Outputs: `x` (m, of the motor), `e` (m), `e_smooth` (m, e without the tooth wave), `w1` to `w3`, `play`.
    Raises InputError for an unknown parameter.
    """
    parameters = {
        "half_band": Parameter(90e-6, "m", meaning="of the belt on its pulley; 0.3 mm wide with the play"),
        "half_play": Parameter(PLAY / 2, "m", meaning="of the gearbox"),
        "play_rate": Parameter(0.25, "m/s", meaning="at which the preloaded belt pulls the gears across their play"),
        "v_play": Parameter(1e-4, "m/s", meaning="velocity that decides on which flank the gears lie"),
        "guide": Parameter(20e-6, "m", meaning="guides and Abbe offset, over the whole travel"),
        "rail": Parameter(8e-6, "m", meaning="form error of the rail"),
        "band_long": Parameter(12e-6, "m", meaning="variation of the half band over the belt"),
        "band_short": Parameter(5e-6, "m", meaning="the same, short"),
        "closing": Parameter(1.0, "1", meaning="factor on all closing distances: preload of the belt"),
        "closing_texture": Parameter(0.25, "1", meaning="variation of closing distances over the belt"),
        "closing_speed": Parameter(3.0, "s/m", meaning="slip of a moving belt against a creeping one"),
        "lag": Parameter(4e-4, "s", meaning="position error of speed"),
        "tooth": Parameter(15e-6, "m", meaning="meshing wave"),
        "pitch": Parameter(0.005, "m", meaning="of the teeth"),
        "phase": Parameter(0.0, "rad", meaning="of the tooth wave: how the belt was laid on"),
        "drift": Parameter(0.0, "m", meaning="warmth of belt and frame"),
    }
    states = {"x": State("m"), "play": State("m", "-half_play", "-half_play", "half_play")}
    equations = {
        "motor": Equation("x", {"velocity": "v"}),
        "gears": Equation("play", {"crossing": "-play_rate * tanh(v / v_play)"}),
    }
    band = {}
    for n, (part, distance) in _ELEMENTS.items():
        parameters[f"part_{n}"] = Parameter(part, "1", meaning=f"of the band, element {n}")
        parameters[f"closing_{n}"] = Parameter(distance, "m", meaning=f"from boundary to boundary, element {n}")
        states[f"w{n}"] = State("1", -1.0, -1.0, 1.0)
        equations[f"element_{n}"] = Equation(f"w{n}", {"slip": f"-2 * v * slipping / closing_{n}"})
        band[f"element_{n}"] = f"width * part_{n} * w{n}"
    definitions = {
        "width": Definition(
            "width",
            "m",
            {
                "mean": "half_band",
                "long": f"band_long * sin({_TURN / 0.17} * x + 0.5)",
                "short": f"band_short * sin({_TURN / 0.06} * x)",
            },
        ),
        "slipping": Definition(
            "slipping",
            "1",
            {
                "slip": f"(1 + slip) * (1 - closing_speed * abs(v)) / closing"
                f" / (1 + closing_texture * sin({_TURN / 0.11} * x + 1.2))"
            },
        ),
        "smooth": Definition(
            "e_smooth",
            "m",
            {
                "drift": "drift",
                "guide": f"guide * sin({_TURN / 0.30} * x + 0.3)",
                "rail": f"rail * sin({_TURN / 0.09} * x + 1.0)",
                "play": "play",
                "lag": "-lag * v",
            }
            | band,
        ),
        "error": Definition("e", "m", {"smooth": "e_smooth", "tooth": f"tooth * sin({_TURN} * x / pitch + phase)"}),
    }
    outputs = ("x", "e", "e_smooth", "play", *(f"w{n}" for n in _ELEMENTS))
    plant = Plant("belt_drive", parameters, {"v": "m/s", "slip": "1"}, states, equations, outputs, definitions)
    return plant.with_parameters(**values)


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


def _loops(forth: Sequence[Sequence[float]], back: Sequence[Sequence[float]]) -> tuple[float, ...]:
    """Turns of motions out and home, in mm; each loop lists its turns on the way."""
    return _mm(*(t for loop in forth for t in loop), 299, *(t for loop in back for t in loop), 1)


_STAIRS = _mm(*(t for far in (25, 30, 37, *range(50, 300, 25)) for t in (far, 0.5)), 299.5)
_STAIRS += _mm(*(t for near in (275, 270, 263, *range(250, 0, -25)) for t in (near, 299.5)), 0.5)
_CASCADES = _loops(
    [(60, 52, 57, 50), (110, 97, 104, 96), (170, 161, 168, 155), (235, 220, 231, 226)],
    [(250, 262, 255, 264), (185, 197, 190, 204), (130, 143, 138, 141), (70, 83, 72, 78)],
)
MOTIONS = {
    "training": Motion((*_STAIRS, *_CASCADES), TRAINING_SPEED, 1, by_hand=False),
    "boundaries": Motion(_mm(299.5, 0.5) * 12, TRAINING_SPEED, 2, by_hand=False),
    "choice": Motion(
        _loops(
            [(50, 20), (100, 82, 93, 85), (175, 130), (220, 208, 214, 205), (280, 262)],
            [(255, 281), (205, 217, 208, 222), (135, 175), (90, 102, 95, 98), (45, 62)],
        ),
        0.030,
        3,
    ),
    "s1": Motion(
        _loops([(75, 48), (150, 121), (245, 217), (295, 268)], [(230, 258), (150, 178), (80, 107)]), 0.032, 11
    ),
    "s2": Motion(
        _loops([(60, 12), (125, 70), (190, 135), (270, 212)], [(225, 275), (160, 212), (90, 148), (35, 88)]), 0.028, 12
    ),
    "s3": Motion(
        _loops(
            [(55, 36), (105, 92, 100, 87), (160, 147, 155, 150), (205, 186, 196, 180), (265, 252, 260, 250)],
            [(240, 259), (195, 207, 200, 213), (145, 157, 149, 154), (95, 114, 104, 119), (40, 52, 45, 56)],
        ),
        0.024,
        13,
    ),
    "s4": Motion(
        _loops(
            [(40, 27, 35, 22), (85, 65), (130, 118, 126, 120), (185, 167, 178, 163), (240, 228, 236, 224)],
            [(260, 272, 264, 277), (215, 234), (165, 176, 169, 173), (120, 138, 127, 142), (65, 77, 70, 80)],
        ),
        0.0255,
        14,
    ),
}
"""Training recordings and the thesis's scenarios (4.6): s1 and s2 loops that end engaged, s3 and s4 cascaded ones."""


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


def measure(motion: Motion, source: str = "belt_drive") -> Recording:
    """Drive the rig on the motion's day and read it every 5 ms.

    Channels: `x` of the encoder (10 um per count), `e` = linear scale (1 um per count, noisy) minus encoder; the true
    values `x_true`, `e_smooth`, `v`; and `engaged`: 1 on the lower boundary, -1 on the upper one, between them inside.
    """
    rng = np.random.default_rng(1000 + motion.day)
    plant = belt_drive(
        phase=rng.uniform(0, _TURN),
        drift=3e-6 * rng.normal(),
        closing=1 + 0.06 * rng.normal(),
        lag=4e-4 + 4e-5 * rng.normal(),
    )
    v = velocity(motion)
    slip = np.clip(band_limited_noise(len(v), SLIP, 0.02, 0.5, SAMPLE_TIME, seed=2000 + motion.day), -0.6, 0.6)
    true = simulate(plant, {"v": v, "slip": slip}, sample_time=SAMPLE_TIME)
    x = ENCODER * np.round(true["x"] / ENCODER)
    scale = SCALE * np.round((true["x"] + true["e"] + SCALE_NOISE * rng.standard_normal(true.samples)) / SCALE)
    channels = {
        "x": x,
        "e": scale - x,
        "x_true": true["x"],
        "e_smooth": true["e_smooth"],
        "v": true["v"],
        "engaged": -sum(true[f"w{n}"] for n in _ELEMENTS) / len(_ELEMENTS),
    }
    return Recording(SAMPLE_TIME, channels, dict.fromkeys(channels, "m") | {"v": "m/s", "engaged": "1"}, source)
