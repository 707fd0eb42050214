"""The cylinder of thesis chapter 6: two pumps of variable speed drive a differential cylinder, simulated.

`pump_cylinder()` is table 6.1; with `DIFFERENCES`, which no network knows, it is the rig in the laboratory. One loop
controls the position, another the sum of the pressures. `record` drives either plant and reads it through noisy sensors
and converters. The thesis's own recordings were never published.
"""

from functools import lru_cache

import numpy as np

from greygate.errors import InputError
from greygate.plants.excitation import chirp, prms
from greygate.plants.plant import Definition, Equation, Parameter, Plant, State
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate

PUMP_CYLINDER = {
    "mass": Parameter(12.3, "kg"),
    "gravity": Parameter(9.81, "m/s^2", meaning="against extension"),
    "area_a": Parameter(1963.5e-6, "m^2", meaning="cap side"),
    "area_b": Parameter(1001.4e-6, "m^2", meaning="rod side"),
    "v_a0": Parameter(1.4258e-4, "m^3", meaning="cap side volume at the centre"),
    "v_b0": Parameter(7.6821e-5, "m^3", meaning="rod side volume at the centre"),
    "x_max": Parameter(0.05, "m", meaning="stroke either side of the centre"),
    "bulk_modulus": Parameter(1.3e9, "Pa", meaning="of the oil"),
    "p_air": Parameter(0.0, "Pa", meaning="absolute pressure at which entrained air doubles the oil's compliance"),
    "displacement_1": Parameter(15.6e-6, "m^3", meaning="pump 1, a revolution"),
    "displacement_2": Parameter(15.6e-6, "m^3", meaning="pump 2, a revolution"),
    "ripple": Parameter(0.0, "1", meaning="of either pump's flow, nine times a revolution"),
    "c_i": Parameter(1.027e-12, "m^3/(Pa s)", meaning="internal leakage of a pump"),
    "c_ea": Parameter(1.2e-13, "m^3/(Pa s)", meaning="external leakage, side A"),
    "c_eb": Parameter(1.2e-13, "m^3/(Pa s)", meaning="external leakage, side B"),
    "c_seal": Parameter(0.0, "m^(7/2)/kg^(1/2)", meaning="turbulent leakage past the piston"),
    "warming": Parameter(0.0, "1", meaning="rise of laminar leakage once the oil is warm"),
    "t_warm": Parameter(60.0, "s", meaning="time constant of the oil's warming"),
    "t_drive": Parameter(3e-3, "s", meaning="lag of a drive's speed"),
    "n_max": Parameter(20.0, "rev/s", meaning="limit of a drive's speed"),
    "sigma0": Parameter(12e5, "N/m", meaning="LuGre bristle stiffness"),
    "sigma1": Parameter(2600.0, "N s/m", meaning="LuGre bristle damping"),
    "sigma2": Parameter(2600.0, "N s/m", meaning="LuGre viscous friction"),
    "f_coulomb": Parameter(330.0, "N", meaning="Coulomb friction"),
    "f_static": Parameter(360.0, "N", meaning="static friction"),
    "v_stribeck": Parameter(0.1, "m/s", meaning="Stribeck velocity"),
    "p_sum": Parameter(12e6, "Pa", meaning="sum of the pressures that it starts with"),
    "ratio": Parameter(1963.5 / 1001.4 - 1, "1", meaning="gamma - 1, dynamic speed of pump 1 over that of pump 2"),
    "offset_ratio": Parameter(-1.2294, "1", meaning="lambda, offset of pump 1 over that of pump 2"),
    "psi": Parameter(-0.0265e-6, "rev/(s Pa)", meaning="offset of pump 2 over the sum of the pressures"),
    "k_sum": Parameter(1.0, "1/s", meaning="integral gain of the loop of the sum; 0: feedforward alone"),
    "k_position": Parameter(1500.0, "rev/(s m)", meaning="gain of the position loop"),
}
"""Thesis table 6.1; what it does not print (drives, loops) is ours."""

DIFFERENCES = {
    "bulk_modulus": 1.15e9,
    "p_air": 2e5,
    "v_a0": 1.50e-4,
    "v_b0": 7.35e-5,
    "displacement_1": 15.9e-6,
    "displacement_2": 15.45e-6,
    "ripple": 0.01,
    "c_i": 1.13e-12,
    "c_ea": 1.45e-13,
    "c_eb": 1.0e-13,
    "c_seal": 1e-10,
    "warming": 0.03,
    "f_coulomb": 400.0,
    "f_static": 470.0,
    "sigma2": 2200.0,
    "t_drive": 4e-3,
}
"""The rig against table 6.1: softer oil with air in it, other volumes, pumps that differ and pulse, more leakage that
grows as the oil warms, a seal that leaks turbulently, other friction, slower drives."""

SAMPLE_TIME = 1e-3
CONVERTER = 2**-15  # of full scale: 16 bit, signed
SENSORS = {
    "n_1": (50.0, 0.02, 50.0 * CONVERTER),
    "n_2": (50.0, 0.02, 50.0 * CONVERTER),
    "x": (0.08, 4e-6, 5e-6),
    "p_a": (2e7, 2e4, 2e7 * CONVERTER),
    "p_b": (2e7, 2e4, 2e7 * CONVERTER),
}
"""Channel -> full scale, RMS of its white noise, resolution, all in the channel's unit."""
SETTLING = 3000  # samples before a record begins

_ATMOSPHERE = 1e5  # Pa; pressures are gauge
RECORDS = {
    "training": (10_001, 1),
    "chirp": (50_000, 2),
    "rig_training": (50_001, 3),
    "rig_choice": (20_000, 4),
    "rig_random": (50_000, 5),
    "rig_chirp": (50_000, 6),
    "rig_open": (50_000, 7),
}
"""Name -> samples, seed of its noise and of its signals."""


def pump_cylinder(**values: float) -> Plant:
    """The plant of thesis section 6.2: inputs `x_ref` (m), `n_ref` (rev/s) and `p_ref` (Pa).

    Outputs are `x`, `n_1`, `n_2`, `p_a`, `p_b`, `v`. The commands to the drives are n_2 = k_position (x_ref - x) +
    n_ref plus an offset, and n_1 = (gamma - 1) times that plus an offset of its own (6.2, 6.4). The loop of the sum
    integrates `p_ref - p_a - p_b`. Raises InputError for an unknown parameter.
    """
    leak = "(1 + warming * warm)"
    air = {c: f"(1 + p_air / (p_{c} + {_ATMOSPHERE}))" for c in "ab"}
    plant = Plant(
        "pump_cylinder",
        PUMP_CYLINDER,
        {"x_ref": "m", "n_ref": "rev/s", "p_ref": "Pa"},
        {
            "x": State("m", 0.0, "-x_max", "x_max", rate="v"),
            "v": State("m/s"),
            "z": State("m"),
            "n_1": State("rev/s", "psi * offset_ratio * p_sum", "-n_max", "n_max"),
            "n_2": State("rev/s", "psi * p_sum", "-n_max", "n_max"),
            "turned_1": State("rev"),
            "turned_2": State("rev"),
            "trim": State("Pa"),
            "warm": State("1"),
            "p_a": State("Pa", "(p_sum * area_b + mass * gravity) / (area_a + area_b)", low=0.0),
            "p_b": State("Pa", "(p_sum * area_a - mass * gravity) / (area_a + area_b)", low=0.0),
        },
        {
            "position": Equation("x", {"velocity": "v"}),
            "motion": Equation(
                "v",
                {"pressure": "p_a * area_a - p_b * area_b", "gravity": "-mass * gravity", "friction": "-f_friction"},
                "mass",
            ),
            "bristle": Equation("z", {"slip": "z_dot"}),
            "drive_1": Equation(
                "n_1", {"dynamic": "ratio * n_dynamic", "offset": "offset_ratio * offset", "own": "-n_1"}, "t_drive"
            ),
            "drive_2": Equation("n_2", {"command": "n_dynamic + offset", "own": "-n_2"}, "t_drive"),
            "shaft_1": Equation("turned_1", {"speed": "n_1"}),
            "shaft_2": Equation("turned_2", {"speed": "n_2"}),
            "sum": Equation("trim", {"error": "k_sum * (p_ref - p_a - p_b)"}),
            "oil": Equation("warm", {"warming": "1 - warm"}, "t_warm"),
            "continuity_a": Equation(
                "p_a", {"pumps": "q_a", "piston": "-area_a * v"}, f"(v_a0 + area_a * x) / bulk_modulus * {air['a']}"
            ),
            "continuity_b": Equation(
                "p_b", {"pumps": "-q_b", "piston": "area_b * v"}, f"(v_b0 - area_b * x) / bulk_modulus * {air['b']}"
            ),
        },
        ("x", "n_1", "n_2", "p_a", "p_b", "v"),
        {
            "dynamic": Definition("n_dynamic", "rev/s", {"loop": "k_position * (x_ref - x)", "reference": "n_ref"}),
            "offset": Definition("offset", "rev/s", {"sum": "psi * (p_ref + trim)"}),
            "pump_1": Definition(
                "q_1", "m^3/s",
                {"mean": "displacement_1 * n_1", "pulses": "ripple * displacement_1 * n_1 * sin(56.55 * turned_1)"},
            ),
            "pump_2": Definition(
                "q_2", "m^3/s",
                {"mean": "displacement_2 * n_2", "pulses": "ripple * displacement_2 * n_2 * sin(56.55 * turned_2)"},
            ),
            "across": Definition(
                "q_across", "m^3/s",
                {"laminar": f"c_i * (p_a - p_b) * {leak}", "seal": "c_seal * orifice(1, p_a, p_b)"},
            ),
            "flow_a": Definition(
                "q_a", "m^3/s",
                {"pumps": "q_1 + q_2", "across": "-q_across", "leakage": f"-(c_i + 2 * c_ea) * p_a * {leak}"},
            ),
            "flow_b": Definition(
                "q_b", "m^3/s",
                {"pump": "q_2", "across": "-q_across", "leakage": f"c_eb * p_b * {leak}"},
            ),
            "stribeck": Definition(
                "g", "m",
                {
                    "coulomb": "f_coulomb / sigma0",
                    "static": "(f_static - f_coulomb) / sigma0 * exp(-(v / v_stribeck)**2)",
                },
            ),
            "slip": Definition("z_dot", "m/s", {"sliding": "v", "yielding": "-abs(v) * z / g"}),
            "friction": Definition(
                "f_friction", "N", {"stiffness": "sigma0 * z", "damping": "sigma1 * z_dot", "viscous": "sigma2 * v"}
            ),
        },
    )  # fmt: skip
    return plant.with_parameters(**values)


@lru_cache
def record(name: str, seed: int | None = None) -> Recording:
    """One of `RECORDS`: `training` and `chirp` of table 6.1, the others of the rig; 1 kHz; see `measure`.

    Training, choice and random: a staircase of pump speed, held 0.03 to 0.4 s, one of position and one of the sum of
    the pressures. Chirp: 10 mm of position, 0.1 to 10 Hz in 50 s, at 12 MPa. Open: the chirp at 4 mm with the sum of
    the pressures fed forward alone. seed: of another run of the same kind. Raises InputError for another name.
    """
    if name not in RECORDS:
        raise InputError(f"record {name!r} is unknown; give one of {', '.join(RECORDS)}")
    samples, own = RECORDS[name]
    seed = own if seed is None else seed
    values = DIFFERENCES if name.startswith("rig") else {}
    total, still = samples + SETTLING, np.zeros(SETTLING)
    n_ref, p_ref = np.zeros(total), np.full(total, 12e6)
    if name.endswith(("chirp", "open")):
        amplitude = 10e-3 if name.endswith("chirp") else 4e-3
        x_ref = np.concatenate([still, chirp(samples, amplitude, 0.1, 10.0, SAMPLE_TIME)])
        values = values | ({"k_sum": 0.0} if name.endswith("open") else {})
    else:
        n_ref = np.concatenate([still, prms(samples, -16.0, 16.0, (30, 400), seed + 100)])
        x_ref = smoothed(np.concatenate([still, prms(samples, -0.03, 0.03, (1000, 4000), seed + 200)]), 1.5)
        p_ref[SETTLING:] = prms(samples, 9e6, 14e6, (1000, 3000), seed + 300)
    return measure(pump_cylinder(**values), x_ref, n_ref, p_ref, seed, SETTLING, name)


def smoothed(values: np.ndarray, cutoff: float) -> np.ndarray:
    """`values` (samples,) through two first-order low-passes of `cutoff` Hz."""
    keep = np.exp(-2 * np.pi * cutoff * SAMPLE_TIME)
    for _ in range(2):
        state, out = values[0], np.empty_like(values)
        for k, value in enumerate(values):
            out[k] = state = keep * state + (1 - keep) * value
        values = out
    return values


def measure(
    plant: Plant,
    x_ref: np.ndarray,
    n_ref: np.ndarray,
    p_ref: np.ndarray,
    seed: int,
    settling: int = 0,
    source: str = "pump_cylinder",
) -> Recording:
    """Simulate at 1 kHz and read `n_1`, `n_2`, `x`, `p_a`, `p_b` through sensors and converters.

    x_ref: m, n_ref: rev/s, p_ref: Pa, each (samples,); the first `settling` are left out. Channels: those five after
    `SENSORS`; the true values `x_true`, `p_a_true`, ...; the references. seed: of the noise.
    """
    true = simulate(plant, {"x_ref": x_ref, "n_ref": n_ref, "p_ref": p_ref}, sample_time=SAMPLE_TIME)
    rng = np.random.default_rng(seed)
    channels: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for name, (full_scale, noise, step) in SENSORS.items():
        read = true[name] + noise * rng.standard_normal(true.samples)
        channels[name] = step * np.round(np.clip(read, -full_scale, full_scale - step) / step)
        channels[f"{name}_true"] = true[name]
        units |= dict.fromkeys((name, f"{name}_true"), true.units[name])
    for name in plant.inputs:
        channels[name], units[name] = true[name], true.units[name]
    return Recording(SAMPLE_TIME, {name: v[settling:] for name, v in channels.items()}, units, source)
