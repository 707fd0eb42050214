"""Pump-controlled cylinder: Runge-Kutta 4 at 40 us (simulations at 62.5 us), under digital control of position, and in
half of the rigs of the sum of the pressures, as in chapter 6 of the thesis."""

import numpy as np
from numba import njit

from .cylinder import HALF, QUANTUM, SIGN_SPEED, STOP, WEIGHTS, WINDOW, bulk, command_at, reference, seep, stribeck
from .rig import SAMPLE_TIME, Columns, ConcealedRig, HiddenEffect, Sensor, fields, nothing, smoothed_difference

FINE, COARSE = 25, 16  # steps a sample: the true rig, a simulation of it
OFFSETS = -1.2294  # lambda: offset speed of pump 1 over that of pump 2
STAGES = 5  # of Runge-Kutta 4: four slopes, and a state between
LOSS_PRESSURE = 1e7  # Pa, at which `disp_loss` is the share of the displacement that is lost
AHEAD = 0.5  # rad, of the variant: by which the ripple of pump 1 goes before that of pump 2
LAMINAR = 1e5  # Pa, of the variant: below which the turbulent leak is laminar; the standard form's 1 Pa only avoids 0/0
BEGIN_A, BEGIN_B = 5e6, 6e6  # Pa
BIAS = 0.3, 2  # of the offset, between which the controller of the pressures may set it
FASTEST = 7.0  # rev/s, that the controller of the position commands
SIGNALS = ("n_1", "n_2", "x", "p_a", "p_b")

# the controllers, by the draw
REACH, QUICK = 0.032, (8, 25)  # m and rad/s of the reference
TOTAL = (16e6, 36e6)  # Pa, of the sum of the pressures
REGULATED = 0.5  # of the rigs control that sum
SUM_GAIN, SUM_RESET = (2e-8, 8e-8), (2e-8, 2e-7)  # rev/s per Pa, rev/s per Pa and s
GAIN = (150, 350)  # rev/s per m
P_A, P_B, X, V, BRISTLE, TURN_1, TURN_2, N_1, N_2, M_1, M_2, SENSED, STATES = range(13)

PARAMETERS = {
    "mass": 12.3, "viscous": 2600.0, "gravity": 9.81, "area_a": 0.0019635, "area_b": 0.0010014, "v_a0": 0.00014258,
    "v_b0": 7.6821e-05, "bulk_modulus": 1.3e9, "displacement": 1.56e-05, "c_i": 1.027e-12, "c_ea": 1.2e-13,
    "c_eb": 1.2e-13, "sigma0": 1.2e6, "sigma1": 2600.0, "sigma2": 0.0, "f_coulomb": 330.0, "f_static": 360.0,
    "v_stribeck": 0.1,
}  # fmt: skip
"""SI and rev/s."""
FLOWS, FILLS, MOTION = ("flow_a", "flow_b"), ("continuity_a", "continuity_b"), ("motion",)
UNCERTAIN = {
    "viscous": (0.1, MOTION),
    "bulk_modulus": (0.08, FILLS),
    "displacement": (0.02, FLOWS),
    "c_i": (0.08, FLOWS),
    "v_a0": (0.04, ("continuity_a",)),
    "v_b0": (0.04, ("continuity_b",)),
    "f_coulomb": (0.08, MOTION),
    "f_static": (0.05, MOTION),
}
"""Parameter -> its tolerance, and the equations in which it stands."""


def _effect(
    equation: tuple[str, ...], on: str, others: dict | None = None, signed: bool = False, **sizes
) -> HiddenEffect:
    return HiddenEffect(equation, tuple(on.split()), sizes, others or {}, signed=signed)


EFFECTS = {
    "cylinder_leakage": _effect(FILLS, "p_a p_b", c_cyl=(2e-14, 4e-12)),
    "turbulent_leakage": _effect(FLOWS, "p_a p_b", c_turb=(6e-11, 1e-8)),
    "entrained_air": _effect(FILLS, "p_a p_b", air_fraction=(0.02, 0.3)),
    "input_delay": _effect(FLOWS, "n_1 n_2", delay=(6e-4, 1.5e-2)),
    "constant_load": _effect(MOTION, "", f_load=(30.0, 2000.0)),
    "pump_ripple": _effect(FLOWS, "n_1 n_2", {"teeth": (7, 14), "ripple_phase": (0.0, 2 * np.pi)}, ripple=(0.01, 0.2)),
    "motor_lag": _effect(FLOWS, "n_1 n_2", speed_lag=(1e-3, 4e-2)),
    "displacement_loss": _effect(FLOWS, "p_a p_b n_1 n_2", disp_loss=(0.006, 0.12)),
}
FOREIGN = {
    "position_friction": _effect(MOTION, "x v", f_position=(4000.0, 6e4)),
    "leakage_drift": _effect(FLOWS, "p_a p_b t", warming=(0.003, 0.1)),
    "speed_sensor_offset_n_1": _effect(FLOWS, "n_1", n1_offset=(0.005, 0.2)),
    "sensor_lag_p_b": _effect(("sensor_p_b",), "p_b", pb_lag=(0.002, 0.06)),
}
Pump = fields("Pump", __name__, PARAMETERS)
PumpEffects = nothing("PumpEffects", __name__, EFFECTS | FOREIGN, "teeth")


@njit(cache=True)
def _pulse(turn, ripple, teeth, phase):
    """Displacement over its mean at `turn` revolutions."""
    return 1 + ripple * np.sin(2 * np.pi * teeth * turn + phase) if ripple > 0 else 1.0


@njit(cache=True)
def _slopes(s, n_1, n_2, t, p, e, d):
    """Derivatives d (STATES,) of the states s at time t [s] under the commanded speeds [rev/s]."""
    p_a, p_b, x, v = s[P_A], s[P_B], s[X], s[V]
    variant = e.form != 0.0
    if e.speed_lag > 0:
        poles = 2.0 if variant else 1.0  # variant: two equal lags of half the time
        d[N_1], d[N_2] = poles * (n_1 - s[N_1]) / e.speed_lag, poles * (n_2 - s[N_2]) / e.speed_lag
        d[M_1], d[M_2] = poles * (s[N_1] - s[M_1]) / e.speed_lag, poles * (s[N_2] - s[M_2]) / e.speed_lag
        n_1, n_2 = (s[M_1], s[M_2]) if variant else (s[N_1], s[N_2])
    else:
        d[N_1] = d[N_2] = d[M_1] = d[M_2] = 0.0
    d[TURN_1], d[TURN_2] = n_1, n_2

    # the loss grows with the pressure across each pump; variant: with p_a for both
    high = p_a if variant else abs(p_a - p_b)
    other = e.ripple_phase + (AHEAD if variant else 0.0)
    flow_1 = (
        p.displacement * n_1 * (1 - e.disp_loss * p_a / LOSS_PRESSURE) * _pulse(s[TURN_1], e.ripple, e.teeth, other)
    )
    flow_2 = (
        p.displacement
        * n_2
        * (1 - e.disp_loss * high / LOSS_PRESSURE)
        * _pulse(s[TURN_2], e.ripple, e.teeth, e.ripple_phase)
    )
    drop = p_a - p_b
    c_i = p.c_i * (1 + e.warming * t)
    back = c_i * drop
    if e.c_turb > 0:  # variant: laminar at small pressures
        back += e.c_turb * drop / np.sqrt(abs(drop) + (LAMINAR if variant else 1.0))
    across = seep(e.c_cyl, drop, variant)
    q_a = flow_2 - back - p.c_ea * p_a + flow_1 - c_i * p_a - p.c_ea * p_a
    q_b = flow_2 - back + p.c_eb * p_b
    stiff_a = bulk(p.bulk_modulus, p_a, e.air_fraction, variant) / (p.v_a0 + p.area_a * x)
    stiff_b = bulk(p.bulk_modulus, p_b, e.air_fraction, variant) / (p.v_b0 - p.area_b * x)
    d[P_A] = stiff_a * (q_a - p.area_a * v - across)
    d[P_B] = stiff_b * (p.area_b * v - q_b + across)
    d[SENSED] = (p_b - s[SENSED]) / e.pb_lag if e.pb_lag > 0 else 0.0

    level = stribeck(v, p.f_coulomb, p.f_static, p.v_stribeck)
    d[BRISTLE] = v - abs(v) * s[BRISTLE] * p.sigma0 / level
    friction = p.sigma0 * s[BRISTLE] + p.sigma1 * d[BRISTLE] + p.sigma2 * v
    if e.f_position > 0:
        friction += e.f_position * abs(x) * np.tanh(v / SIGN_SPEED)
    d[X] = v
    pull = p.viscous * v + p.mass * p.gravity + friction + e.f_load
    d[V] = (p.area_a * p_a - p.area_b * p_b - pull) / p.mass


@njit(cache=True)
def _step(s, n_1, n_2, t, dt, p, e, work):
    """One step of Runge-Kutta 4, then the limits of pressures and stroke. work: (STAGES, STATES)."""
    k1, k2, k3, k4, mid = work[0], work[1], work[2], work[3], work[4]
    _slopes(s, n_1, n_2, t, p, e, k1)
    for n in range(STATES):
        mid[n] = s[n] + HALF * dt * k1[n]
    _slopes(mid, n_1, n_2, t + HALF * dt, p, e, k2)
    for n in range(STATES):
        mid[n] = s[n] + HALF * dt * k2[n]
    _slopes(mid, n_1, n_2, t + HALF * dt, p, e, k3)
    for n in range(STATES):
        mid[n] = s[n] + dt * k3[n]
    _slopes(mid, n_1, n_2, t + dt, p, e, k4)
    for n in range(STATES):
        s[n] += dt / WEIGHTS * (k1[n] + 2 * k2[n] + 2 * k3[n] + k4[n])
    s[P_A], s[P_B] = max(s[P_A], 0.0), max(s[P_B], 0.0)
    if abs(s[X]) > STOP:
        s[X] = np.sign(s[X]) * STOP
        s[V] = 0.0


@njit(cache=True)
def _record(target, gain, offset, total, gain_sum, reset_sum, p, e, fine):
    """Signals (5, samples) n_1, n_2, x, p_a, p_b of a rig that follows `target` [m].

    n_1 - (gamma - 1) n_2 is `offset` [rev/s] plus a PI controller of the sum of the pressures about `total` [Pa], whose
    gains may be zero.
    """
    samples = len(target)
    out, n_1, n_2 = np.empty((len(SIGNALS), samples)), np.empty(samples), np.empty(samples)
    s, work = np.zeros(STATES), np.empty((STAGES, STATES))
    s[P_A], s[P_B], s[SENSED] = BEGIN_A, BEGIN_B, BEGIN_B
    ratio = p.area_a / p.area_b - 1
    summed = 0.0
    for k in range(samples):
        short = total - s[P_A] - s[P_B]
        summed += reset_sum * SAMPLE_TIME * short
        bias = min(max(offset + gain_sum * short + summed, BIAS[0] * offset), BIAS[1] * offset)
        n_20 = bias / (OFFSETS - ratio)
        moving = min(max(gain * (target[k] - QUANTUM * np.round(s[X] / QUANTUM)), -FASTEST), FASTEST)
        n_2[k], n_1[k] = moving + n_20, ratio * moving + OFFSETS * n_20
        if k == 0:
            s[N_1] = s[M_1] = n_1[0]
            s[N_2] = s[M_2] = n_2[0]
        out[0, k], out[1, k], out[2, k], out[3, k] = n_1[k] + e.n1_offset * np.sign(n_1[k]), n_2[k], s[X], s[P_A]
        out[4, k] = s[SENSED] if e.pb_lag > 0 else s[P_B]
        for n in range(fine):
            into = n * SAMPLE_TIME / fine
            first, second = command_at(n_1, k, into, e.delay), command_at(n_2, k, into, e.delay)
            _step(s, first, second, k * SAMPLE_TIME + into, SAMPLE_TIME / fine, p, e, work)
    return out


@njit(cache=True)
def _predict(n_1, n_2, x, p_a, p_b, speed, window, every, p, e, fine):
    """Simulated x, p_a, p_b (3, samples): restarted from the record every `window` samples, NaN in windows left out."""
    samples = len(n_1)
    out = np.full((len(SIGNALS[2:]), samples), np.nan)
    s, work = np.zeros(STATES), np.empty((STAGES, STATES))
    n_1 = n_1 - e.n1_offset * np.sign(n_1)
    turn_1, turn_2 = np.cumsum(n_1) * SAMPLE_TIME, np.cumsum(n_2) * SAMPLE_TIME
    for start in range(0, samples, window * every):
        s[P_A], s[P_B], s[SENSED] = p_a[start], p_b[start], p_b[start]
        s[X], s[V] = x[start], speed[start]
        s[BRISTLE] = np.sign(s[V]) * stribeck(s[V], p.f_coulomb, p.f_static, p.v_stribeck) / p.sigma0
        s[N_1] = s[M_1] = command_at(n_1, start, 0.0, e.delay)
        s[N_2] = s[M_2] = command_at(n_2, start, 0.0, e.delay)
        s[TURN_1], s[TURN_2] = turn_1[start] - n_1[start] * SAMPLE_TIME, turn_2[start] - n_2[start] * SAMPLE_TIME
        for k in range(start, min(start + window, samples)):
            out[0, k], out[1, k] = s[X], s[P_A]
            out[2, k] = s[SENSED] if e.pb_lag > 0 else s[P_B]
            for n in range(fine):
                into = n * SAMPLE_TIME / fine
                first, second = command_at(n_1, k, into, e.delay), command_at(n_2, k, into, e.delay)
                _step(s, first, second, k * SAMPLE_TIME + into, SAMPLE_TIME / fine, p, e, work)
    return out


def _offset(p, e, total: float) -> float:
    """n_1 - (gamma - 1) n_2 [rev/s] that keeps the sum of the pressures at `total` [Pa] while the cylinder rests."""
    p_a = (total * p.area_b + p.mass * p.gravity + e.f_load) / (p.area_a + p.area_b)
    p_b = total - p_a
    drop = p_a - p_b
    back = p.c_i * drop + e.c_turb * drop / np.sqrt(abs(drop)) + e.c_cyl * drop
    flow_2 = back - p.c_eb * p_b
    flow_1 = back - flow_2 + (2 * p.c_ea + p.c_i) * p_a
    return (flow_1 - (p.area_a / p.area_b - 1) * flow_2) / p.displacement


def record(parameters: dict, extra: dict, form: float, seconds: float, rng: np.random.Generator) -> Columns:
    """True signals of one campaign from mid-stroke, 5 and 6 MPa, `seconds` + one sample long."""
    target = reference(rng, round(seconds / SAMPLE_TIME) + 1, REACH, QUICK)
    p, e = Pump(**parameters), PumpEffects(form=form, **extra)
    total = rng.uniform(*TOTAL)
    regulated = float(rng.uniform() < REGULATED)
    gains = regulated * rng.uniform(*SUM_GAIN), regulated * rng.uniform(*SUM_RESET)
    out = _record(target, rng.uniform(*GAIN), _offset(p, e, total), total, *gains, p, e, FINE)
    return dict(zip(SIGNALS, out, strict=True))


def predict(columns: Columns, parameters: dict, extra: dict, form: float, every: int = 1) -> Columns:
    """x, p_a, p_b by the comparison rule: restarted every WINDOW samples from the recorded state."""
    speed = smoothed_difference(columns["x"])
    n_1, n_2, x, p_a, p_b = (columns[name] for name in SIGNALS)
    p, e = Pump(**parameters), PumpEffects(form=form, **extra)
    out = _predict(n_1, n_2, x, p_a, p_b, speed, WINDOW, every, p, e, COARSE)
    return dict(zip(SIGNALS[2:], out, strict=True))


PUMP = ConcealedRig(
    plant="pump_hydraulic",
    parameters=PARAMETERS,
    tolerance={name: tolerance for name, (tolerance, _) in UNCERTAIN.items()},
    places={name: equations for name, (_, equations) in UNCERTAIN.items()},
    channels=(
        Sensor("n_1", "rev/s", "input", resolution=0.001),
        Sensor("n_2", "rev/s", "input", resolution=0.001),
        Sensor("x", "m", "output", resolution=5e-6),
        Sensor("p_a", "Pa", "output", noise=12e3),
        Sensor("p_b", "Pa", "output", noise=12e3),
    ),
    window=0.25,
    record=record,
    predict=predict,
    same=(frozenset({"cylinder_leakage", "turbulent_leakage"}), frozenset({"input_delay", "motor_lag"})),
    effects=EFFECTS,
    foreign=FOREIGN,
)
