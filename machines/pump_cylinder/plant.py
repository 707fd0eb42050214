"""The cylinder of thesis chapter 6: two pumps of variable speed drive a differential cylinder, simulated.

`pump_cylinder()` is table 6.1; with `DIFFERENCES`, which no network knows, it is the rig in the laboratory. One loop
controls the position, another the sum of the pressures. `record` drives either plant and reads it through noisy sensors
and converters. The thesis's own recordings were never published.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.plants.excitation import chirp, prms
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate
from greygate.reading import read_toml

SIMULATED = Path(__file__).parent / "simulated"
PLANT = Plant.read(SIMULATED / "pump_cylinder.toml")
"""Thesis table 6.1."""

DIFFERENCES = read_toml(SIMULATED / "differences.toml", "install greygate again")
"""Parameters of the rig in the laboratory."""

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
    return PLANT.with_parameters(**values)


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
