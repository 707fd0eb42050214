"""The linearised analysis of the prediction error, (5.19) and (5.20): a part of valve_cylinder.py.

Around a slow extension at mid-stroke, spool and load of the valve-controlled cylinder move a little. From what the
pressure of chamber A does in answer, k1, k2, k3 of (5.19a) are fitted, for the rig and for the trained network on the
rig's own signals. With them (5.20) foretells the amplitude of the network's error under a sine of force, which is
measured beside it.
"""

import numpy as np

from greygate.machines import catalog
from greygate.machines.valve_cylinder.plant import valve_cylinder
from greygate.machines.valve_cylinder.scenarios import SAMPLE_TIME
from greygate.plants.excitation import band_limited_noise
from greygate.plants.simulator import simulate

BAR = 1e5
SAMPLES, SETTLED = 2500, 500  # of a run; until it has settled
FINER = 10  # samples of the rig in one of the network
OPENING = 0.1  # of the spool's stroke, about which it moves
SPOOL, FORCE = 0.5, 300.0  # RMS of what is added: of the opening; N
BAND = (0.5, 30.0)  # Hz
SINE, FREQUENCIES = 500.0, (2.0, 5.0, 10.0, 20.0)  # N, Hz: whole periods in what is judged


def measured(plant, network, v_c: np.ndarray, force: np.ndarray) -> dict[str, np.ndarray]:
    """Of the rig and the network from where the run has settled: pressures, and over each step before them the means of
    spool and speed, of the supply and of the position.
    """
    held = {"v_c": np.repeat(v_c, FINER), "f_ext": np.repeat(force, FINER)}
    fine = simulate(plant, held, sample_time=SAMPLE_TIME / FINER)
    x = fine["x"][::FINER]
    steps = {"u": fine["u"].reshape(-1, FINER).mean(axis=1), "v": np.diff(x, append=x[-1]) / SAMPLE_TIME, "x": x}
    found = {name: np.roll(values, 1) for name, values in steps.items()}  # the step that ends with the sample
    found |= {
        "p": fine["p_a"][::FINER],
        "p_s": fine["p_s"][::FINER],
        "network": network.run({"v_c": v_c, "x": x})["p_a"],
    }
    return {name: values[SETTLED:] for name, values in found.items()}


def coefficients(pressure: np.ndarray, u: np.ndarray, v: np.ndarray) -> list[float]:
    """k1 [Pa/(m s)], k2 [Pa/m], k3 [1/s] of dp/dt = k1 u - k2 v - k3 p, from samples of small deviations."""
    matrix = np.column_stack([pressure[:-1], u[1:], v[1:]])
    decay, by_u, by_v = np.linalg.lstsq(matrix / (size := matrix.std(axis=0)), pressure[1:], rcond=None)[0] / size
    k3 = -np.log(decay) / SAMPLE_TIME
    return [float(k) for k in (by_u * k3 / (1 - decay), -by_v * k3 / (1 - decay), k3)]


def amplitude(signal: np.ndarray, frequency: float) -> complex:
    t = SAMPLE_TIME * np.arange(len(signal))
    return complex(2 * np.mean(signal * np.exp(-2j * np.pi * frequency * t)))


def linearised() -> dict:
    plant, network = valve_cylinder(), catalog.entry("valve_cylinder").network()
    k = {symbol: p.value for symbol, p in plant.parameters.items()}
    opening = OPENING * k["u_max"]
    voltage = opening * k["r_coil"] / k["k_h"]
    still = np.zeros(SAMPLES)
    base = measured(plant, network, still + voltage, still)

    drawn = (band_limited_noise(SAMPLES, size, *BAND, SAMPLE_TIME, seed=s) for s, size in enumerate((1.0, FORCE)))
    wiggle, force = drawn
    moved = measured(plant, network, voltage * (1 + SPOOL * wiggle), force)
    off = {name: moved[name] - base[name] for name in base}
    rig, ours = (coefficients(off[name], off["u"], off["v"]) for name in ("p", "network"))

    p_s, volume = float(np.mean(base["p_s"])), k["v_a0"] + k["area"] * float(np.mean(base["x"]))
    stiffness = k["bulk_modulus"] / volume
    formula = [stiffness * k["k_valve"] * np.sqrt(p_s / 2), stiffness * k["area"]]
    formula.append(stiffness * k["k_valve"] * opening / np.sqrt(2 * p_s))

    sines = []
    for frequency in FREQUENCIES:
        turn = 2 * np.pi * frequency
        swung = measured(plant, network, still + voltage, SINE * np.sin(turn * SAMPLE_TIME * np.arange(SAMPLES)))
        speed, error = (amplitude(swung[n] - base[n], frequency) for n in ("v", "p"))
        error -= amplitude(swung["network"] - base["network"], frequency)
        told = -(rig[1] / (1j * turn + rig[2]) - ours[1] / (1j * turn + ours[2])) * speed
        sines.append({"hz": frequency, "told": abs(told) / BAR, "measured": abs(error) / BAR})
    return {"formula": [float(f) for f in formula], "rig": rig, "network": ours, "newtons": SINE, "sines": sines}
