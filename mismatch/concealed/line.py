"""Belt drive and cable drum: an error between motor and load that depends on the path travelled."""

import numpy as np
from numba import njit

from .rig import SAMPLE_TIME, Columns, ConcealedRig, HiddenEffect, Sensor, fields, motion, nothing, smoothed_difference

FINE = 10  # steps of the true motion in a recorded sample
HALF = 8  # samples on either side, over which a recorded speed or acceleration is taken
TRAVELLED, SPEEDS = (0.5, 1.0), (0.6, 1.0)  # of the travel and of the highest speed, by the draw
HARMONIC = 0.1  # of the variant: the second harmonic of a sine, over the sine
STRETCHING, WARMING, DRIFTING = 0.005, 30, 40  # s, of the variants: in which the belt stretches, growth and drift end
DRAGGED = 0.4  # m: where the guide drags on the belt no more
SLIPPING = 0.02  # s, of the variant: in which slip follows speed and acceleration
CREEP = 2e-4  # the data sheet's creep, to which the variant's slip is in proportion
SLOW_SHARE, SLOWER = 0.5, 3  # of the variant: the share of the wind-up that relaxes more slowly, and how much so
CABLE = 0.8  # m of cable at the beginning
TURN = 2 * np.pi
PHASE = (0.0, TURN)
WHERE = ("transmission",)


def _effect(sizes: dict, on: str, others: dict | None = None, **options) -> HiddenEffect:
    return HiddenEffect(WHERE, tuple(on.split()), sizes, others or {}, **options)


BELT_PARAMETERS = {"band": 0.00015, "closing": 0.004, "play": 6e-05, "offset": 0.0}  # SI
BELT_EFFECTS = {
    "tooth_ripple": _effect({"ripple": (1.0e-6, 3e-5)}, "x", {"pitch": (0.003, 0.008), "ripple_phase": PHASE}),
    "pulley_eccentricity": _effect({"ecc": (1.5e-6, 6e-5)}, "x", {"pulley_rev": (0.07, 0.14), "ecc_phase": PHASE}),
    "guide_error": _effect({"guide": (1.5e-6, 4e-5)}, "x", {"guide_period": (0.016, 0.05), "guide_phase": PHASE}),
    "inertial_stretch": _effect({"inertia": (1e-5, 4e-4)}, "a"),
    "thermal_growth": _effect({"thermal": (1.5e-6, 8e-5)}, "x t", signed=True),
    "scale_error": _effect({"scale": (1.2e-5, 8e-4)}, "x", signed=True),
    "rate_dependent_band": _effect({"rate_band": (0.4, 12.0)}, "v"),
    "drift": _effect({"drift": (2e-7, 8e-6)}, "t", signed=True),
    "reversal_play": _effect({"play": (2.5e-6, 1e-4)}, "x v", without=("play",)),
}
BELT_FOREIGN = {
    "damaged_tooth": _effect({"bump": (1e-5, 8e-5)}, "x", {"bump_at": (0.02, 0.1), "bump_width": (0.004, 0.012)}),
    "speed_stretch": _effect({"speed_stretch": (2e-4, 4e-3)}, "v", {"speed_from": (0.005, 0.015)}),
    "guide_drag": _effect({"drag": (2e-4, 6e-3)}, "v x"),
}
DRUM_PARAMETERS = {"radius": 0.025, "creep": 0.0002}  # SI
DRUM_EFFECTS = {
    "drum_eccentricity": _effect({"ecc": (1.5e-6, 6e-5)}, "x", {"ecc_phase": PHASE}),
    "speed_slip": _effect({"speed_slip": (4e-4, 1e-2)}, "v", signed=True),
    "direction_slip": _effect({"asym": (1e-5, 4e-4)}, "v"),
    "drift": _effect({"drift": (3e-7, 8e-6)}, "t", signed=True),
    "acceleration_slip": _effect({"accel_slip": (5e-4, 1.5e-2)}, "a"),
    "cable_stretch": _effect({"stretch": (3e-5, 1e-3)}, "a x", {"length": (0.2, 0.5)}),
    "rest_relaxation": _effect({"rest_relax": (4e-5, 1e-3)}, "x t", {"rest_time": (0.5, 2.5)}),
}
DRUM_FOREIGN = {
    "winding_layers": _effect({"winding": (6e-5, 1.5e-3)}, "x", signed=True),
    "wind_up_step": _effect({"step": (4e-6, 6e-5)}, "x", {"step_at": (0.03, 0.15)}),
    "temperature_cycle": _effect({"warmth": (4e-6, 5e-5)}, "t", {"cycle": (4.0, 9.0), "cycle_phase": PHASE}),
}
Belt = fields("Belt", __name__, BELT_PARAMETERS | {"play": 0.0})  # none if it is not told
BeltEffects = nothing(
    "BeltEffects", __name__, BELT_EFFECTS | BELT_FOREIGN, "pitch", "pulley_rev", "guide_period", "bump_width"
)
Drum = fields("Drum", __name__, DRUM_PARAMETERS)
DrumEffects = nothing("DrumEffects", __name__, DRUM_EFFECTS | DRUM_FOREIGN, "rest_time", "cycle")


@njit(cache=True)
def _belt(x, v, a, dt, plant, e):
    """Load position (samples,) from motor position, velocity, acceleration; the micro-slip law solved along dx."""
    y = np.empty(len(x))
    play = plant.play + e.play
    h, g = -1.0, -play
    bend = 0.0
    turn = 2 * np.pi
    for k in range(len(x)):
        dx = x[k] - x[k - 1] if k else 0.0
        before = g
        g = min(max(g - dx, -play), play)
        # variant: the belt slips on the pinion by what is left of the motion after the backlash
        slid = dx + (g - before) if e.form and e.play else dx
        if slid != 0.0:
            to = -np.sign(slid) * (1 + (e.rate_band * abs(v[k]) if e.form else 0.0))
            h = to + (h - to) * np.exp(-abs(slid) / plant.closing)
        band = plant.band * (1.0 if e.form else 1 + e.rate_band * abs(v[k]))
        error = plant.offset + band * h + g
        error += e.ripple * np.sin(turn * x[k] / e.pitch + e.ripple_phase)
        if e.form:  # variant: teeth and pulleys are not quite sinusoidal
            error += HARMONIC * e.ripple * np.sin(2 * turn * x[k] / e.pitch + e.ripple_phase)
            error += HARMONIC * e.guide * np.sin(2 * turn * x[k] / e.guide_period)
        error += e.ecc * np.sin(turn * x[k] / e.pulley_rev + e.ecc_phase)
        error += e.guide * np.sin(turn * x[k] / e.guide_period + e.guide_phase)
        # variant: the belt is damped, and the stretch follows later
        bend += min(dt / STRETCHING, 1.0) * (-e.inertia * a[k] - bend) if e.form else -e.inertia * a[k] - bend
        error += bend
        t = k * dt
        error += e.thermal * x[k] * (WARMING * (1 - np.exp(-t / WARMING)) if e.form else t)
        error += e.drift * (DRIFTING * (1 - np.exp(-t / DRIFTING)) if e.form else t)
        error += e.scale * x[k]
        error += e.bump * np.exp(-(((x[k] - e.bump_at) / e.bump_width) ** 2))
        error -= e.speed_stretch * np.sign(v[k]) * max(abs(v[k]) - e.speed_from, 0.0)
        error -= e.drag * v[k] * (DRAGGED - x[k])
        y[k] = x[k] + error
    return y


@njit(cache=True)
def _drum(x, v, a, dt, plant, e):
    """Load position (samples,) from drum position, velocity, acceleration."""
    y = np.empty(len(x))
    slip, wound, slow = 0.0, 0.0, 0.0
    fast, hard = 0.0, 0.0
    turn = 2 * np.pi
    for k in range(len(x)):
        dx = x[k] - x[k - 1] if k else 0.0
        # variant: slip follows speed and acceleration later
        fast = fast + min(dt / SLIPPING, 1.0) * (abs(v[k]) - fast) if e.form else abs(v[k])
        hard = hard + min(dt / SLIPPING, 1.0) * (abs(a[k]) - hard) if e.form else abs(a[k])
        # variant: the extra slip is in proportion to the creep
        back = e.asym * (plant.creep / CREEP if e.form else 1.0) if dx < 0 else 0.0
        slip += (plant.creep + back + e.speed_slip * fast + e.accel_slip * hard) * dx
        # variant: half of the wind-up relaxes three times more slowly
        share = SLOW_SHARE if e.form else 1.0
        wound += share * e.rest_relax * dx - dt * wound / e.rest_time
        slow += (1 - share) * e.rest_relax * dx - dt * slow / (SLOWER * e.rest_time)
        t = k * dt
        error = slip + wound + slow + e.ecc * (np.sin(x[k] / plant.radius + e.ecc_phase) - np.sin(e.ecc_phase))
        if e.form:
            error += HARMONIC * e.ecc * np.sin(2 * x[k] / plant.radius)
        error += e.drift * (DRIFTING * (1 - np.exp(-t / DRIFTING)) if e.form else t)
        error -= e.stretch * a[k] * (e.length + x[k] if e.form else CABLE - x[k])
        error += e.winding * x[k] * x[k] + (e.step if x[k] > e.step_at else 0.0)
        error += e.warmth * (np.sin(turn * t / e.cycle + e.cycle_phase) - np.sin(e.cycle_phase))
        y[k] = x[k] + error
    return y


def _pair(kernel, plant, effects, motor: str, motions: tuple[float, float, float]):
    """`record` and `predict` of a rig whose load follows a motor; `motions` bounds travel, speed, acceleration."""

    def record(parameters, extra, form, seconds, rng) -> Columns:
        dt = SAMPLE_TIME / FINE
        travel = rng.uniform(*TRAVELLED) * motions[0]
        x, v, a = motion(rng, seconds + SAMPLE_TIME, dt, travel, rng.uniform(*SPEEDS) * motions[1], motions[2])
        x, v, a = (np.concatenate([np.zeros(1), s]) for s in (x, v, a))
        y = kernel(x, v, a, dt, plant(**parameters), effects(form=form, **extra))
        samples = round(seconds / SAMPLE_TIME) + 1
        return {motor: x[::FINE][:samples], "x_load": y[::FINE][:samples]}

    def predict(columns, parameters, extra, form, every=1) -> Columns:
        x = columns[motor]
        v = smoothed_difference(x, HALF)
        a = smoothed_difference(v, HALF)
        return {"x_load": kernel(x, v, a, SAMPLE_TIME, plant(**parameters), effects(form=form, **extra))}

    return record, predict


_belt_record, _belt_predict = _pair(_belt, Belt, BeltEffects, "x_motor", (0.30, 0.07, 0.2))
BELT = ConcealedRig(
    plant="belt_drive",
    parameters=BELT_PARAMETERS,
    tolerance={"band": 0.08, "closing": 0.15, "play": 0.08},
    places={"band": WHERE, "closing": WHERE, "play": WHERE},
    channels=(Sensor("x_motor", "m", "input", resolution=1e-6), Sensor("x_load", "m", "output", noise=1e-6)),
    window=None,
    optional=("play",),
    record=_belt_record,
    predict=_belt_predict,
    effects=BELT_EFFECTS,
    foreign=BELT_FOREIGN,
)

_drum_record, _drum_predict = _pair(_drum, Drum, DrumEffects, "x_drum", (0.60, 0.12, 0.3))
DRUM = ConcealedRig(
    plant="cable_drum",
    parameters=DRUM_PARAMETERS,
    tolerance={"creep": 0.25},
    places={"creep": WHERE},
    channels=(Sensor("x_drum", "m", "input", resolution=2e-6), Sensor("x_load", "m", "output", noise=1e-6)),
    window=None,
    record=_drum_record,
    predict=_drum_predict,
    effects=DRUM_EFFECTS,
    foreign=DRUM_FOREIGN,
)
