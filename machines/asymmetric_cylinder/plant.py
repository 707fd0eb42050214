"""The second machine: the asymmetric cylinder with a solenoid valve of thesis section 5.4 (table 5.5), simulated.

`asymmetric_cylinder()` is the plant of the data sheets. With `DIFFERENCES`, which no network knows, it is the rig in
the laboratory. `record` drives the rig and reads it through noisy sensors, converters and causal low-pass filters.
The thesis's own recordings were never published.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.machines.valve_cylinder.plant import valve_cylinder
from greygate.plants.excitation import chirp, prms
from greygate.plants.plant import Plant, read_entries
from greygate.plants.preparation import filtered
from greygate.plants.recording import Recording
from greygate.plants.simulator import simulate
from greygate.reading import read_toml

SIMULATED = Path(__file__).parent / "simulated"
OWN = read_entries(SIMULATED / "bench.toml")
BENCH = OWN["parameters"]
"""Thesis table 5.5, and chapter 6 for what it leaves out of the same bench."""

SUPPLY = {"f_relief": 1500.0, "p_gas0": 1.2e7}
"""Relief valve at 150 bar, accumulator charged to 120 bar."""

DIFFERENCES = read_toml(SIMULATED / "differences.toml", "install greygate again")
"""Parameters of the rig in the laboratory."""

SAMPLE_TIME = 1e-3
CONVERTER = 2**-15  # of full scale: 16 bit, signed
SENSORS = {"u": (10.0, 0.01), "x": (0.05, 2e-5), "p_a": (4e7, 4e4), "p_b": (4e7, 4e4), "p_s": (4e7, 4e4)}
"""Channel -> full scale, RMS of its white noise, both in the channel's unit."""
CUTOFF = 100.0
"""Hz, of the second-order Butterworth filter that every channel passes, causal, as it would run online (5.4.2).

One filter for all delays all alike, by 2 ms. The thesis's position has 20 Hz beside 100 Hz for the rest: run online, it
comes 9 ms after the spool, and a chamber does not forgive that. See `filters` of benchmarks/asymmetric_cylinder.py."""

SAMPLES = {"training": 50_001, "choice": 20_000, "v3": 2_500, "v4": 10_000, "v5": 10_000, "v6": 50_000}
_SEEDS = {"training": 1, "choice": 3, "v3": 2, "v4": 4, "v6": 6}
CLOSED, SLOW = 200.0, 60.0  # V/m, gain of the position loop; slow in v3
MOVES = RESTS = (500, 1500)  # samples: least and most of a motion and of a pause of the training run's staircase


def asymmetric_cylinder(**values: float) -> Plant:
    """The second machine with its full supply: inputs `v_c` (V), `x_ref` (m), `f_ext` (N).

    The valve's driver controls the spool `u` (V) to `v_c + k_position (x_ref - x)`. The outputs are those of the first
    machine. The piston starts at rest at the centre, where the chamber pressures carry its weight. Raises InputError
    for an unknown parameter.
    """
    bench = {symbol: p.value for symbol, p in BENCH.items()} | SUPPLY | values
    first = valve_cylinder("full")
    known = {symbol: v for symbol, v in bench.items() if symbol in first.parameters}
    plant = valve_cylinder("full", **known)
    p_b = plant.constant(plant.states["p_b"].initial)
    p_a = (p_b * bench["area_b"] + bench["mass"] * bench["gravity"]) / bench["area_a"]
    gone = ("area", "i_max", "l_coil", "r_coil", "k_h")
    parameters = {symbol: p for symbol, p in {**plant.parameters, **BENCH}.items() if symbol not in gone}
    at_rest = {symbol: replace(OWN["states"][symbol], initial=p) for symbol, p in (("p_a", p_a), ("p_b", p_b))}
    states = {symbol: s for symbol, s in {**plant.states, **OWN["states"], **at_rest}.items() if symbol != "i"}
    equations = {name: e for name, e in {**plant.equations, **OWN["equations"]}.items() if name != "coil"}
    plant = Plant(
        "asymmetric_cylinder",
        parameters,
        {"v_c": "V", "x_ref": "m", "f_ext": "N"},
        states,
        equations,
        plant.outputs,
        plant.definitions,
    )
    return plant.with_parameters(**{**SUPPLY, **values})


def record(name: str, seed: int | None = None, cutoff: float | None = CUTOFF) -> Recording:
    """One run of the rig, 1 kHz; see `measure`. Raises InputError for an unknown name.

    seed: of another run of the same kind. cutoff: of `measure`.

    training (50,001 samples), choice (20,000), v3 (2,500): the valve follows a random staircase with steps of 0.08 to
    0.6 s, smoothed at 8 Hz. A position loop keeps the piston off its stops and moves its mean position. In training and
    choice the staircase pauses while the reference stands still: the loop brings the piston to rest and the valve to
    its lap. Choices that training leaves open are made on `choice`, so that they never depend on a validation run.
    v4, v5 (10,000), v6 (50,000): closed position loop, as in the thesis, with a random staircase of 60 mm, a chirp of
    40 mm from 0.1 to 3 Hz, and a staircase plus a sine of 10 mm and 1.3 Hz.
    """
    if name not in SAMPLES:
        raise InputError(f"record {name!r} is unknown; give one of {', '.join(SAMPLES)}")
    samples, seed = SAMPLES[name], _SEEDS.get(name, 0) if seed is None else seed
    v_c = np.zeros(samples)
    if name in ("training", "choice", "v3"):
        moving = np.ones(samples, bool) if name == "v3" else moves(samples, seed + 3000)
        v_c = smoothed(prms(samples, -2.5, 2.5, (80, 600), seed) * moving, 8.0)
        last = np.maximum.accumulate(np.where(moving, np.arange(samples), 0))  # sample at which it moved
        x_ref = smoothed(prms(samples, -0.025, 0.025, (500, 3000), seed + 1000)[last], 1.0)
    elif name == "v5":
        x_ref = chirp(samples, 0.02, 0.1, 3.0, SAMPLE_TIME)
    else:
        x_ref = smoothed(prms(samples, -0.03, 0.03, (400, 2000), seed), 4.0)
    if name == "v6":
        x_ref += 0.005 * np.sin(2 * np.pi * 1.3 * SAMPLE_TIME * np.arange(samples))
    rig = asymmetric_cylinder(**DIFFERENCES, k_position=SLOW if name == "v3" else CLOSED)
    return measure(rig, v_c, x_ref, np.zeros(samples), seed + 2000, name, cutoff)


def moves(samples: int, seed: int) -> np.ndarray:
    """Whether the staircase moves (samples,); motions and pauses alternate, with random lengths of `MOVES`, `RESTS`."""
    rng = np.random.default_rng(seed)
    turns = [rng.integers(*span) for _ in range(samples // MOVES[0] + 1) for span in (MOVES, RESTS)]
    return np.repeat(np.arange(len(turns)) % 2 == 0, turns)[:samples]


def smoothed(values: np.ndarray, cutoff: float) -> np.ndarray:
    """`values` (samples,) through a second-order Butterworth low-pass of `cutoff` Hz, forth and back."""
    from scipy.signal import butter, sosfiltfilt  # takes a second

    return sosfiltfilt(butter(2, cutoff, fs=1 / SAMPLE_TIME, output="sos"), values)


def measure(
    plant: Plant,
    v_c: np.ndarray,
    x_ref: np.ndarray,
    f_ext: np.ndarray,
    seed: int,
    source: str = "asymmetric_cylinder",
    cutoff: float | None = CUTOFF,
) -> Recording:
    """Simulate at 1 kHz and read `u`, `x`, `p_a`, `p_b`, `p_s` through sensors, converters and filters.

    v_c: V, x_ref: m, f_ext: N, each (samples,). Channels: those five after `SENSORS` and filters; the true values
    `u_true`, `x_true`, `p_a_true`, `p_b_true`; `v_c`, `x_ref`, `f_ext`. seed: of the noise. cutoff: Hz, of
    the filters; None: none.
    """
    true = simulate(plant, {"v_c": v_c, "x_ref": x_ref, "f_ext": f_ext}, sample_time=SAMPLE_TIME)
    rng = np.random.default_rng(seed)
    channels, units = {}, {}
    for name, (full_scale, noise) in SENSORS.items():
        step = full_scale * CONVERTER
        codes = np.round((true[name] + noise * rng.standard_normal(true.samples)) / step)
        channels[name] = np.clip(codes, -(2**15), 2**15 - 1) * step
        units[name] = true.units[name]
    for name in ("u", "x", "p_a", "p_b"):
        channels[f"{name}_true"], units[f"{name}_true"] = true[name], true.units[name]
    for name in plant.inputs:
        channels[name], units[name] = true[name], true.units[name]
    read = Recording(SAMPLE_TIME, channels, units, source)
    return read if cutoff is None else filtered(read, "low", cutoff, phase="causal", channels=tuple(SENSORS))
