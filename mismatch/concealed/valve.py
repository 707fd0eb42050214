"""Valve-controlled cylinder: Runge-Kutta 4 at 40 us (simulations at 62.5 us), under digital position control."""

import numpy as np
from numba import njit

from .cylinder import HALF, QUANTUM, SIGN_SPEED, STOP, WEIGHTS, WINDOW, bulk, command_at, reference, seep, stribeck
from .rig import SAMPLE_TIME, Columns, ConcealedRig, HiddenEffect, Sensor, fields, nothing, smoothed_difference

FINE, COARSE = 25, 16  # steps a sample: the true rig, a simulation of it
VOLT = 10 / 2**11  # 12 bits of +-10 V: the plant sees the rounded command
STAGES = 5  # of Runge-Kutta 4: four slopes, and a state between
DISCRIMINANT = 4  # of a quadratic: b^2 - 4 a c
ROUNDED = 1.6e-11  # m^2, of the variant: 4 squared lengths of 2 um, over which an edge is rounded
SPLIT = 0.5  # of the variant's asymmetry: the supply edges have one half of it, the tank edges the other
BRAKED, BRAKING = 0.018, 0.0319  # m: where the end cushion begins, and over which it throttles
BRAKED_LATE, BRAKING_LONG = 0.02, 0.05  # m: the same of the variant
SAGGING = 0.02  # s, of the variant: in which the supply follows what is drawn
SOFT, SLOW = 0.5, 0.5  # of the variant: stiffness of bristles and Stribeck speed over the usual ones
BEGIN = 0.5  # of the supply pressure, in both chambers
INTEGRATED, LIMIT = 1.5, 1.499  # V: commands that are integrated, and that are given
SIGNALS = ("v_c", "x", "p_a", "p_b")

# the controller, by the draw
REACH, QUICK = 0.036, (12, 80)  # m and rad/s of the reference
PI_SHARE, RESET = 0.4, (20, 120)  # of the controllers integrate; V per m and s
GAIN = (60, 130)  # V per m
CURRENT, SPOOL, RATE, P_A, P_B, X, V, BRISTLE, SUPPLY, SENSED, STATES = range(11)

FRICTION = {"sigma0": 1.2e6, "sigma1": 300.0, "sigma2": 60.0, "f_coulomb": 100.0, "f_static": 130.0, "v_stribeck": 0.1}
PARAMETERS = {
    "mass": 9.0, "viscous": 2000.0, "stiffness": 10.0, "area": 0.000645, "p_supply": 20e6, "p_tank": 0.0,
    "k_valve": 3.2e-05, "bulk_modulus": 1.4e9, "v_a0": 5e-05, "v_b0": 5e-05, "k_h": 0.0401, "omega_n": 1256.0,
    "zeta": 0.7, "l_coil": 0.59, "r_coil": 100.0, "i_max": 0.015, "u_max": 0.0006,
    **FRICTION,
}  # fmt: skip
"""SI."""
SPOOL_EQ, FLOWS, FILLS, MOTION = ("spool",), ("flow_a", "flow_b"), ("continuity_a", "continuity_b"), ("motion",)
UNCERTAIN = {
    "viscous": (0.1, MOTION),
    "k_valve": (0.04, FLOWS),
    "bulk_modulus": (0.08, FILLS),
    "v_a0": (0.04, ("continuity_a",)),
    "v_b0": (0.04, ("continuity_b",)),
    "p_supply": (0.02, FLOWS),
    "omega_n": (0.1, SPOOL_EQ),
}
"""Parameter -> its tolerance, and the equations in which it stands."""


def _effect(equation: tuple[str, ...], on: str, others: dict | None = None, **options) -> HiddenEffect:
    signed, without = options.pop("signed", False), options.pop("without", ())
    return HiddenEffect(equation, tuple(on.split()), options, others or {}, signed=signed, without=without)


EFFECTS = {
    "internal_leakage": _effect(FILLS, "p_a p_b", c_internal=(1.2e-12, 1.5e-11)),
    "external_leakage": _effect(FILLS, "p_a p_b", c_external=(8e-15, 3e-13)),
    "valve_overlap": _effect(FLOWS, "v_c", overlap=(6e-6, 1.2e-4)),
    "valve_underlap": _effect(FLOWS, "v_c", overlap=(-6e-6, -1.2e-4)),
    "orifice_asymmetry": _effect(FLOWS, "v_c p_a p_b", orifice_asym=(0.025, 0.4), signed=True),
    "entrained_air": _effect(FILLS, "p_a p_b", air_fraction=(0.03, 0.3)),
    "supply_droop": _effect(FLOWS, "v_c", droop=(3e9, 1e11)),
    "input_delay": _effect(SPOOL_EQ, "v_c", delay=(8e-4, 1.5e-2)),
    "dry_friction": _effect(MOTION, "v", f_coulomb=(15.0, 250.0), f_static=(20.0, 330.0), without=tuple(FRICTION)),
    "constant_load": _effect(MOTION, "", f_load=(25.0, 1200.0)),
    "hardening_spring": _effect(MOTION, "x", k_cubic=(4e6, 1e8)),
    "end_cushion": _effect(FLOWS, "x", cushion=(1.5, 80.0)),
    "sensor_offset_p_a": _effect(("sensor_p_a",), "", pa_offset=(2.5e4, 6e5), signed=True),
    "sensor_gain_p_a": _effect(("sensor_p_a",), "p_a", pa_gain=(2.5e-3, 7e-2), signed=True),
}
FOREIGN = {
    "valve_hysteresis": _effect(SPOOL_EQ, "v_c", hysteresis=(0.012, 0.25)),
    "position_friction": _effect(MOTION, "x v", f_position=(2500.0, 3e4)),
    "viscosity_drift": _effect(MOTION, "v t", thinning=(0.06, 0.5)),
    "supply_drift": _effect(FLOWS, "t", sinking=(6e-4, 1.5e-2)),
    "sensor_lag_p_b": _effect(("sensor_p_b",), "p_b", pb_lag=(0.01, 0.2)),
}
Valve = fields("Valve", __name__, PARAMETERS | {"f_coulomb": 0.0, "f_static": 0.0})  # no dry friction if it is not told
ValveEffects = nothing("ValveEffects", __name__, EFFECTS | FOREIGN)


@njit(cache=True)
def _edge(spool, overlap, rounded):
    """Opening of one edge [m]: sharp, or (variant) rounded over 4 um where the lap is not zero."""
    opening = spool - overlap
    if rounded and overlap != 0.0:
        return HALF * (opening + np.sqrt(opening * opening + ROUNDED))
    return max(opening, 0.0)


@njit(cache=True)
def _orifice(opening, high, low):
    drop = high - low
    return opening * np.sqrt(drop) if drop >= 0 else -opening * np.sqrt(-drop)


@njit(cache=True)
def _supplied(opening, supply, chamber, droop):
    """Flow over k through a supply edge where the supply sags by `droop` times that flow: the root of a quadratic."""
    drop = supply - chamber
    if drop <= 0 or droop == 0.0:
        return _orifice(opening, supply, chamber)
    c = opening * opening
    return HALF * (np.sqrt(c * c * droop * droop + DISCRIMINANT * c * drop) - c * droop)


@njit(cache=True)
def _slopes(s, volt, t, p, e, d):
    """Derivatives d (STATES,) of the states s at time t [s] under the command `volt`."""
    u, p_a, p_b, x, v = s[SPOOL], s[P_A], s[P_B], s[X], s[V]
    variant = e.form != 0.0
    d[CURRENT] = (volt - p.r_coil * s[CURRENT]) / p.l_coil
    d[SPOOL] = s[RATE]
    d[RATE] = p.omega_n**2 * (p.k_h * s[CURRENT] - u) - 2 * p.zeta * p.omega_n * s[RATE]

    full = p.p_supply * (np.exp(-e.sinking * t) if e.sinking > 0 else 1.0)
    supply, sag = (s[SUPPLY], 0.0) if variant and e.droop > 0 else (full, e.droop * p.k_valve)
    rich = 1 + e.orifice_asym * (SPLIT if variant else 1.0)
    poor = 1 - SPLIT * e.orifice_asym if variant else 1.0
    out, back = _edge(u, e.overlap, variant), _edge(-u, e.overlap, variant)
    from_a, from_b = rich * _supplied(out, supply, p_a, sag), rich * _supplied(back, supply, p_b, sag)
    to_a, to_b = poor * _orifice(back, p_a, p.p_tank), poor * _orifice(out, p_b, p.p_tank)
    near = max(abs(x) - BRAKED, 0.0) / BRAKING  # variant: begins later, without the square
    throttle = 1 / (1 + e.cushion * (max(abs(x) - BRAKED_LATE, 0.0) / BRAKING_LONG if variant else near * near))
    from_a, from_b, to_a, to_b = from_a * throttle, from_b * throttle, to_a * throttle, to_b * throttle
    drawn = p.k_valve * (max(from_a, 0.0) + max(from_b, 0.0))
    d[SUPPLY] = (full - e.droop * drawn - s[SUPPLY]) / SAGGING

    across = seep(e.c_internal, p_a - p_b, variant)
    q_a = p.k_valve * (from_a - to_a) - across - seep(e.c_external, p_a - p.p_tank, variant)
    q_b = p.k_valve * (from_b - to_b) + across - seep(e.c_external, p_b - p.p_tank, variant)
    d[P_A] = bulk(p.bulk_modulus, p_a, e.air_fraction, variant) / (p.v_a0 + p.area * x) * (q_a - p.area * v)
    d[P_B] = bulk(p.bulk_modulus, p_b, e.air_fraction, variant) / (p.v_b0 - p.area * x) * (q_b + p.area * v)
    d[SENSED] = (p_b - s[SENSED]) / e.pb_lag if e.pb_lag > 0 else 0.0

    coulomb, static = max(p.f_coulomb, e.f_coulomb), max(p.f_static, e.f_static)
    friction = e.f_position * abs(x) * np.tanh(v / SIGN_SPEED) if e.f_position > 0 else 0.0
    d[BRISTLE] = 0.0
    if coulomb > 0:
        # variant: softer bristles and a lower Stribeck speed than the usual ones
        soft, speed = (SOFT, SLOW * p.v_stribeck) if variant and e.f_coulomb > 0 else (1.0, p.v_stribeck)
        level = stribeck(v, coulomb, static, speed)
        d[BRISTLE] = v - abs(v) * s[BRISTLE] * soft * p.sigma0 / level
        friction += soft * p.sigma0 * s[BRISTLE] + p.sigma1 * d[BRISTLE] + p.sigma2 * v
    viscous = p.viscous * (np.exp(-e.thinning * t) if e.thinning > 0 else 1.0)
    force = (p_a - p_b) * p.area - viscous * v - p.stiffness * x - friction - e.f_load - e.k_cubic * x**3
    d[X] = v
    d[V] = force / p.mass


@njit(cache=True)
def _step(s, volt, t, dt, p, e, work):
    """One step of Runge-Kutta 4, then the limits of current, spool, pressures and stroke. work: (STAGES, STATES)."""
    k1, k2, k3, k4, mid = work[0], work[1], work[2], work[3], work[4]
    _slopes(s, volt, t, p, e, k1)
    for n in range(STATES):
        mid[n] = s[n] + HALF * dt * k1[n]
    _slopes(mid, volt, t + HALF * dt, p, e, k2)
    for n in range(STATES):
        mid[n] = s[n] + HALF * dt * k2[n]
    _slopes(mid, volt, t + HALF * dt, p, e, k3)
    for n in range(STATES):
        mid[n] = s[n] + dt * k3[n]
    _slopes(mid, volt, t + dt, p, e, k4)
    for n in range(STATES):
        s[n] += dt / WEIGHTS * (k1[n] + 2 * k2[n] + 2 * k3[n] + k4[n])
    s[CURRENT] = min(max(s[CURRENT], -p.i_max), p.i_max)
    if abs(s[SPOOL]) > p.u_max:
        s[SPOOL] = np.sign(s[SPOOL]) * p.u_max
        s[RATE] = 0.0
    s[P_A], s[P_B] = max(s[P_A], 0.0), max(s[P_B], 0.0)
    if abs(s[X]) > STOP:
        s[X] = np.sign(s[X]) * STOP
        s[V] = 0.0


@njit(cache=True)
def _record(target, gain, reset, p, e, fine):
    """Signals (4, samples) v_c, x, p_a, p_b of a rig that follows `target` [m] under P or PI control at 1 kHz."""
    samples = len(target)
    out, command = np.empty((len(SIGNALS), samples)), np.empty(samples)
    s, work = np.zeros(STATES), np.empty((STAGES, STATES))
    s[P_A] = s[P_B] = s[SENSED] = BEGIN * p.p_supply
    s[SUPPLY] = p.p_supply
    total, felt = 0.0, 0.0
    for k in range(samples):
        seen = QUANTUM * np.round(s[X] / QUANTUM)
        volt = gain * (target[k] - seen) + total
        if abs(volt) < INTEGRATED:
            total += reset * SAMPLE_TIME * (target[k] - seen)
        volt = VOLT * np.round(min(max(volt, -LIMIT), LIMIT) / VOLT)
        out[0, k], out[1, k] = volt, s[X]
        out[2, k] = (s[P_A] * (1 + e.pa_gain)) + e.pa_offset
        out[3, k] = s[SENSED] if e.pb_lag > 0 else s[P_B]
        felt = min(max(felt, volt - e.hysteresis), volt + e.hysteresis)
        command[k] = felt
        for n in range(fine):
            into = n * SAMPLE_TIME / fine
            _step(s, command_at(command, k, into, e.delay), k * SAMPLE_TIME + into, SAMPLE_TIME / fine, p, e, work)
    return out


@njit(cache=True)
def _predict(volts, x, p_a, p_b, speed, window, every, p, e, fine):
    """Simulated x, p_a, p_b (3, samples): restarted from the record every `window` samples, NaN in windows left out."""
    samples = len(volts)
    out = np.full((len(SIGNALS[1:]), samples), np.nan)
    s, work = np.zeros(STATES), np.empty((STAGES, STATES))
    command = np.empty(samples)
    felt = 0.0
    for k in range(samples):
        felt = min(max(felt, volts[k] - e.hysteresis), volts[k] + e.hysteresis)
        command[k] = felt
    for first in range(0, samples, window * every):
        acting = command_at(command, first, 0.0, e.delay)
        s[CURRENT] = min(max(acting / p.r_coil, -p.i_max), p.i_max)
        s[SPOOL] = min(max(p.k_h * s[CURRENT], -p.u_max), p.u_max)
        s[RATE] = 0.0
        s[P_A] = (p_a[first] - e.pa_offset) / (1 + e.pa_gain)
        s[P_B] = s[SENSED] = p_b[first]
        s[X], s[V] = x[first], speed[first]
        coulomb = max(p.f_coulomb, e.f_coulomb)
        soft, slow = (SOFT, SLOW * p.v_stribeck) if e.form != 0.0 and e.f_coulomb > 0 else (1.0, p.v_stribeck)
        level = stribeck(s[V], coulomb, max(p.f_static, e.f_static), slow)
        s[BRISTLE] = np.sign(s[V]) * level / (soft * p.sigma0)
        flow = p.k_valve * np.sqrt(max(p.p_supply - (s[P_A] if s[SPOOL] > 0 else s[P_B]), 0.0)) * abs(s[SPOOL])
        s[SUPPLY] = p.p_supply - e.droop * flow
        for k in range(first, min(first + window, samples)):
            out[0, k], out[1, k] = s[X], s[P_A] * (1 + e.pa_gain) + e.pa_offset
            out[2, k] = s[SENSED] if e.pb_lag > 0 else s[P_B]
            for n in range(fine):
                into = n * SAMPLE_TIME / fine
                _step(s, command_at(command, k, into, e.delay), k * SAMPLE_TIME + into, SAMPLE_TIME / fine, p, e, work)
    return out


def record(parameters: dict, extra: dict, form: float, seconds: float, rng: np.random.Generator) -> Columns:
    """True signals of one campaign from rest at mid-stroke, `seconds` + one sample long."""
    target = reference(rng, round(seconds / SAMPLE_TIME) + 1, REACH, QUICK)
    reset = rng.uniform(*RESET) if rng.uniform() < PI_SHARE else 0.0
    out = _record(target, rng.uniform(*GAIN), reset, Valve(**parameters), ValveEffects(form=form, **extra), FINE)
    return dict(zip(SIGNALS, out, strict=True))


def predict(columns: Columns, parameters: dict, extra: dict, form: float, every: int = 1) -> Columns:
    """x, p_a, p_b by the comparison rule: restarted every WINDOW samples from the recorded state."""
    speed = smoothed_difference(columns["x"])
    volts, x, p_a, p_b = (columns[name] for name in SIGNALS)
    p, e = Valve(**parameters), ValveEffects(form=form, **extra)
    out = _predict(volts, x, p_a, p_b, speed, WINDOW, every, p, e, COARSE)
    return dict(zip(SIGNALS[1:], out, strict=True))


VALVE = ConcealedRig(
    plant="valve_hydraulic",
    parameters=PARAMETERS,
    optional=tuple(FRICTION),
    tolerance={name: tolerance for name, (tolerance, _) in UNCERTAIN.items()},
    places={name: equations for name, (_, equations) in UNCERTAIN.items()},
    channels=(
        Sensor("v_c", "V", "input", resolution=VOLT),
        Sensor("x", "m", "output", resolution=5e-6),
        Sensor("p_a", "Pa", "output", noise=12e3),
        Sensor("p_b", "Pa", "output", noise=12e3),
    ),
    window=0.25,
    record=record,
    predict=predict,
    same=(frozenset({"valve_overlap", "valve_underlap"}), frozenset({"sensor_offset_p_a", "sensor_gain_p_a"})),
    effects=EFFECTS,
    foreign=FOREIGN,
)
