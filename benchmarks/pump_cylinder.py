"""The rivals of the pump-controlled cylinder's network, from nothing.

flows        table 6.3: the linear flow networks by least mean squares
black_boxes  table 6.2 to the thesis's epochs, output error from the best, a linear model: half an hour on one core
starts       the structured network from random weights, with and without bounds on its leakage
"""

import numpy as np

from greygate.machines.pump_cylinder.network import leakage_bounds
from greygate.machines.pump_cylinder.plant import SAMPLE_TIME, SENSORS, pump_cylinder, record
from greygate.machines.pump_cylinder.study import EPOCHS, P_MAX, Q_MAX, SCENARIOS, X_SCALE, assemble, recording
from greygate.models.accuracy import free_run_rms, rms
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.plants.simulator import simulate
from greygate.progress import titled

from .shared import say

TAKES = "half an hour"
NARX = {number: ((number - 1) // 3 + 1, (5, 10, 15)[(number - 1) % 3]) for number in range(1, 10)}
"""Table 6.2: architecture -> samples of each signal, neurons."""
NARX_EPOCHS, NOE_EPOCHS = 2000, 30
THESIS_NARX = (0.07e6, 0.07e6, 0.07e6, 0.02e6, 0.01e6, 8e3, 0.01e6, 5e3, 6e3)  # Pa, in training (table 6.2)
THESIS_NOE = 0.2e6  # Pa, in training


def black_box(name: str, true: bool = False) -> Record:
    """The record of table 6.2's networks: `recording` with the speed `v` [m/s], and both pressures as one port `p`.

    true: what the machine does, before sensors and converters.
    """
    end = "_true" if true else ""
    c = {n: record(name).channels[n + end] for n in ("n_1", "n_2", "x", "p_a", "p_b")}
    inputs = {n: c[n] for n in ("n_1", "n_2", "x")} | {"v": np.diff(c["x"], prepend=c["x"][0]) / SAMPLE_TIME}
    return Record(inputs, {"p": np.stack([c["p_a"], c["p_b"]], axis=1)})


def narx(samples: int, neurons: int, seed: int = 0) -> Network:
    """An architecture of table 6.2: samples of each signal, and one hidden layer of tansig neurons; 0: linear."""
    ports = {n: Port(n, "rev/s", SENSORS[n][0]) for n in ("n_1", "n_2")}
    inputs = [*ports.values(), Port("x", "m", X_SCALE), Port("v", "m/s", 0.5)]
    taps = {port: range(samples) for port in inputs}
    output = Port("p", "Pa", P_MAX, size=2, initial=6e6)
    past = range(1, samples + 1)
    if not neurons:
        return noe("linear", taps, output, past)
    return nguyen_widrow(noe("narx", taps, output, past, (neurons,), bypass=False), seed)


def black_boxes() -> dict:
    """Table 6.2 and the NOE of 6.3.1 on the nominal plant, and a linear model on the rig; RMS in Pa, both chambers.

    `narx`: by architecture, one step ahead in training, `exact` the same where no sensor adds noise, the free run of
    the chirp (inf: diverges), epochs and seconds of the former.
    `noe`: the architecture of the lowest training error, trained on in free run, by record.
    `linear`: two samples of each signal and no neurons, ARX and then OE, trained and judged as the SRNN is.
    """
    training, chirp = black_box("training"), black_box("chirp")
    found, fits = {}, {}
    for number, (samples, neurons) in NARX.items():
        begun = narx(samples, neurons)
        told = titled(say, f"NARX {number}")
        fit = fits[number] = train(begun, [training], teacher=True, epochs=NARX_EPOCHS, progress=told)
        told = titled(say, f"NARX {number} without noise")
        exact = train(begun, [black_box("training", True)], teacher=True, epochs=NARX_EPOCHS, progress=told)
        found[number] = {"ahead": _ahead(fit), "exact": _ahead(exact), "chirp": _both(fit.network, chirp)}
        found[number] |= {"epochs": len(fit.history) - 1, "seconds": fit.seconds}
    best = min(found, key=lambda n: found[n]["ahead"])
    fit = train(fits[best].network, [training], epochs=NOE_EPOCHS, progress=titled(say, "NOE"))
    errors = {"training": _both(fit.network, training), "chirp": _both(fit.network, chirp)}
    own = {"architecture": best, "seconds": fit.seconds, "outcome": fit.outcome.value}
    ahead = train(narx(2, 0), [black_box("rig_training")], teacher=True, epochs=EPOCHS).network
    linear = train(ahead, [black_box("rig_training")], epochs=EPOCHS).network
    rival = {name: _both(linear, black_box(name)) for name in SCENARIOS}
    return {"narx": found, "noe": errors | own, "linear": rival, "thesis": {"narx": THESIS_NARX, "noe": THESIS_NOE}}


def _ahead(fit: Trained) -> float:
    """RMS in Pa of one step ahead in training."""
    return float(np.sqrt(2 * fit.history[-1])) * P_MAX


def _both(network: Network, record: Record) -> float:
    return free_run_rms(network, record)["p"]


def flow_models() -> dict[str, dict]:
    """Table 6.3: the linear flow networks (6.16), (6.17) from nothing, by the flows of the nominal plant.

    By network `q_a`, `q_b`: RMS in m^3/s over a run with the references of training, after one epoch of least mean
    squares (Widrow and Hoff 1960, normalised) and of least squares; with the pressures of the same instant, and `late`
    with those of the sample before, which are all that the assembled network has; and the `weights` that least squares
    finds, in SI units.
    """
    r, plant = record("training").channels, pump_cylinder()
    driven = {n: r[n] for n in plant.inputs}
    at = simulate(plant, driven, sample_time=SAMPLE_TIME, channels=("n_1", "n_2", "p_a", "p_b", "q_a", "q_b"))
    scale = {"n_1": SENSORS["n_1"][0], "n_2": SENSORS["n_2"][0], "p_a": P_MAX, "p_b": P_MAX}
    found = {}
    for flow, regressors in {"q_a": ("n_1", "n_2", "p_a", "p_b"), "q_b": ("n_2", "p_a", "p_b")}.items():
        now = np.stack([at[n][1:] / scale[n] for n in regressors], axis=1)
        late = np.stack([at[n][: -1 if n[0] == "p" else None][-len(now) :] / scale[n] for n in regressors], axis=1)
        wanted = at[flow][1:] / Q_MAX
        exact = np.linalg.lstsq(now, wanted, rcond=None)[0]
        late_exact = np.linalg.lstsq(late, wanted, rcond=None)[0]
        found[flow] = {
            "mean_squares": Q_MAX * rms(now @ _least_mean_squares(now, wanted) - wanted),
            "least_squares": Q_MAX * rms(now @ exact - wanted),
            "late": Q_MAX * rms(late @ late_exact - wanted),
            "weights": {n: float(w) * Q_MAX / scale[n] for n, w in zip(regressors, exact, strict=True)},
        }
    return found


def _least_mean_squares(regressors: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The weights of a linear neuron after one epoch, sample by sample, begun at zero."""
    weights = np.zeros(regressors.shape[1])
    for row, value in zip(regressors, wanted, strict=True):
        if length := float(row @ row):
            weights += row * (value - row @ weights) / length
    return weights


def random_starts(bounded: bool, seeds: range = range(3)) -> list[tuple[float, ...]]:
    """RMS in Pa on `rig_chirp` of SRNNs trained on `rig_training` from random weights of flow, speed and place.

    bounded: whether the leakage stays within `leakage_bounds`; without these bounds, some networks diverge.
    """
    start, found = assemble(), []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        drawn = {
            name: 0.5 * rng.normal(size=w.shape)
            for name, w in start.parameters().items()
            if name[0] == "q" or (name.startswith(("speed", "gamma")) and not name.endswith("bias"))
        }
        bounds = leakage_bounds(start) if bounded else None
        network = train(start.with_parameters(drawn), [recording("rig_training")], epochs=EPOCHS, bounds=bounds).network
        found.append(tuple(free_run_rms(network, recording("rig_chirp")).values()))
    return found


def starts() -> dict:
    """RMS in Pa on the rig's chirp, chambers A and B, of three starts."""
    return {name: random_starts(bounded) for name, bounded in (("free", False), ("bounded", True))}


PARTS = {"flows": flow_models, "black_boxes": black_boxes, "starts": starts}
