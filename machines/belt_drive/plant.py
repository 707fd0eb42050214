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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greygate.errors import InputError
from greygate.plants.excitation import band_limited_noise
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate

SAMPLE_TIME = 5e-3
TRAVEL = 0.3  # m
ENCODER = 1e-5  # m of belt per count of the motor's encoder
SCALE = 1e-6  # m per count of the linear scale on the carriage
SCALE_NOISE = 1e-6  # m RMS
PLAY = 120e-6  # m, the gearbox
TRAINING_SPEED = 0.040  # m/s
SLIP = 0.15  # RMS of the relative variation of slip from one moment to the next

_GROUPS = {1: (0.30, 0.004), 2: (0.35, 0.009), 3: (0.35, 0.018)}  # part of the band, closing distance in m
_TURN = 2 * np.pi

PARAMETERS = {
    "m_motor": Parameter(8.0, "kg", meaning="motor and gears, at the belt"),
    "bandwidth": Parameter(200.0, "rad/s", meaning="of the motor's speed loop, whose integral acts at a fourth of it"),
    "f_motor": Parameter(5.0, "N", meaning="friction of motor and gears"),
    "half_play": Parameter(PLAY / 2, "m", meaning="of the gearbox"),
    "k_gears": Parameter(5e6, "N/m", meaning="of a flank of the gears"),
    "d_gears": Parameter(100.0, "N s/m", meaning="grease between the gears"),
    "m_pulley": Parameter(0.2, "kg", meaning="driving pulley and free wheel, at the belt"),
    "rigidity": Parameter(1e5, "N", meaning="EA of the belt"),
    "strand": Parameter(0.15, "m", meaning="from the pulley to the carriage at 0"),
    "strand_back": Parameter(0.6, "m", meaning="from there over the free wheel back to the pulley"),
    "d_belt": Parameter(150.0, "N s/m", meaning="damping of the belt"),
    "m_carriage": Parameter(4.0, "kg"),
    "f_guide": Parameter(10.0, "N", meaning="friction of the guide, once it slides"),
    "sigma0": Parameter(3e6, "N/m", meaning="stiffness of its bristles"),
    "sigma1": Parameter(2e3, "N s/m", meaning="damping of its bristles"),
    "viscous": Parameter(150.0, "N s/m", meaning="grease of the guide: the error depends on speed"),
    "half_band": Parameter(65e-6, "m", meaning="of the teeth between their flanks"),
    "k_teeth": Parameter(4e6, "N/m", meaning="of a group of teeth on its flank"),
    "load": Parameter(14.0, "N", meaning="at which closing distances are given"),
    "guide": Parameter(20e-6, "m", meaning="guides and Abbe offset, over the whole travel"),
    "rail": Parameter(8e-6, "m", meaning="form error of the rail"),
    "band_long": Parameter(12e-6, "m", meaning="variation of the half band over the belt"),
    "band_short": Parameter(5e-6, "m", meaning="the same, short"),
    "closing": Parameter(1.0, "1", meaning="factor on all closing distances: preload of the belt"),
    "closing_texture": Parameter(0.25, "1", meaning="variation of closing distances over the belt"),
    "closing_speed": Parameter(3.0, "s/m", meaning="slip of a moving belt against a creeping one"),
    "tooth": Parameter(15e-6, "m", meaning="meshing wave"),
    "pitch": Parameter(0.005, "m", meaning="of the teeth"),
    "phase": Parameter(0.0, "rad", meaning="of the tooth wave: how the belt was laid on"),
    "drift": Parameter(0.0, "m", meaning="warmth of belt and frame"),
}
_LOWER = "-half_band - band_long * sin(0.5)"  # teeth on the flank that pushes forward, at x = 0


def belt_drive(**values: float) -> Plant:
    """The drive after an engaged forward motion: inputs `v` (m/s, the speed asked of the motor), `slip` (relative).

    Outputs: `x` (m, of the motor), `e` (m), `e_smooth` (m, e without the tooth wave), `gap` (m, in the gears), `w1` to
    `w3`, the places of the groups of teeth: -1 and below on the flank that pushes forward, 1 and above on the other.
    Raises InputError for an unknown parameter.
    """
    parameters = dict(PARAMETERS)
    states = {
        "x": State("m"),
        "v_motor": State("m/s"),
        "behind": State("m"),
        "x_pulley": State("m", "-half_play"),
        "v_pulley": State("m/s"),
        "x_carriage": State("m", f"-half_play {_LOWER}"),
        "v_carriage": State("m/s"),
        "bristles": State("m"),
    }
    equations = {
        "encoder": Equation("x", {"speed": "v_motor"}),
        "speed_error": Equation("behind", {"asked": "v", "driven": "-v_motor"}),
        "motor": Equation(
            "v_motor",
            {
                "loop": "m_motor * bandwidth * (v - v_motor + bandwidth / 4 * behind)",
                "gears": "-f_gears",
                "friction": "-f_motor * tanh(v_motor / 1e-3)",
            },
            storage="m_motor",
        ),
        "pulley_position": Equation("x_pulley", {"speed": "v_pulley"}),
        "pulley": Equation("v_pulley", {"gears": "f_gears", "belt": "-f_belt"}, storage="m_pulley"),
        "carriage_position": Equation("x_carriage", {"speed": "v_carriage"}),
        "carriage": Equation(
            "v_carriage",
            {"belt": "f_belt", "bristles": "-sigma0 * bristles", "rubbing": "-sigma1 * rubbing",
             "grease": "-viscous * v_carriage"},
            storage="m_carriage",
        ),
        "guide": Equation("bristles", {"rubbing": "rubbing"}),
    }  # fmt: skip
    slack = {}
    for n, (part, distance) in _GROUPS.items():
        parameters[f"part_{n}"] = Parameter(part, "1", meaning=f"of the band, group {n}")
        parameters[f"closing_{n}"] = Parameter(distance, "m", meaning=f"from flank to flank, group {n}")
        states[f"w{n}"] = State("1", -1.0)
        teeth = f"k_teeth * width * part_{n} * (min(w{n} + 1, 0) + max(w{n} - 1, 0))"
        creep = f"-2 * abs(v_pulley) * slipping / closing_{n} / load"
        equations[f"group_{n}"] = Equation(f"w{n}", {"creep": f"{creep} * (f_belt + {teeth})"})
        slack[f"group_{n}"] = f"width * part_{n} * w{n}"
    definitions = {
        "gears": Definition("gap", "m", {"pulley": "x_pulley", "motor": "-x"}),
        "flanks": Definition(
            "f_gears",
            "N",
            {
                "flanks": "-k_gears * (min(gap + half_play, 0) + max(gap - half_play, 0))",
                "grease": "d_gears * (v_motor - v_pulley)",
            },
        ),
        "width": Definition(
            "width",
            "m",
            {
                "mean": "half_band",
                "long": f"band_long * sin({_TURN / 0.17} * x + 0.5)",
                "short": f"band_short * sin({_TURN / 0.06} * x)",
            },
        ),
        "slack": Definition("slack", "m", slack),
        "belt": Definition(
            "f_belt",
            "N",
            {
                "stretch": "(rigidity / (strand + x_carriage) + rigidity / (strand_back - x_carriage))"
                " * (x_pulley + slack - x_carriage)",
                "damping": "d_belt * (v_pulley - v_carriage)",
            },
        ),
        "slipping": Definition(
            "slipping",
            "1",
            {
                "slip": f"(1 + slip) * (1 - closing_speed * abs(v_pulley)) / closing"
                f" / (1 + closing_texture * sin({_TURN / 0.11} * x + 1.2))"
            },
        ),
        "rubbing": Definition(
            "rubbing",
            "m/s",
            {"sliding": "v_carriage", "yielding": "-sigma0 / f_guide * abs(v_carriage) * bristles"},
        ),
        "smooth": Definition(
            "e_smooth",
            "m",
            {
                "carriage": "x_carriage",
                "motor": "-x",
                "drift": "drift",
                "guide": f"guide * sin({_TURN / 0.30} * x + 0.3)",
                "rail": f"rail * sin({_TURN / 0.09} * x + 1.0)",
            },
        ),
        "error": Definition("e", "m", {"smooth": "e_smooth", "tooth": f"tooth * sin({_TURN} * x / pitch + phase)"}),
    }
    outputs = ("x", "e", "e_smooth", "gap", *(f"w{n}" for n in _GROUPS))
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


def measure(motion: Motion, source: str = "belt_drive", varying: float = 1.0, **values: float) -> Recording:
    """Drive the rig on the motion's day and read it every 5 ms.

    varying: factor on how slip varies from moment to moment. values: other parameters of the rig. Channels: `x` of the
    encoder (10 um per count), `e` = linear scale (1 um per count, noisy) minus encoder; the true values `x_true`,
    `e_smooth`, `v`; and `engaged`: 1 on the lower boundary, -1 on the upper one, between them inside.
    """
    rng = np.random.default_rng(1000 + motion.day)
    day = {
        "phase": rng.uniform(0, _TURN),
        "drift": 3e-6 * rng.normal(),
        "closing": 1 + 0.06 * rng.normal(),
        "viscous": PARAMETERS["viscous"].value * (1 + 0.1 * rng.normal()),
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
        "engaged": -sum(np.clip(true[f"w{n}"], -1, 1) for n in _GROUPS) / len(_GROUPS),
    }
    return Recording(SAMPLE_TIME, channels, dict.fromkeys(channels, "m") | {"v": "m/s", "engaged": "1"}, source)
