"""The SRNN of the pump-controlled cylinder: trained on the nominal plant, adapted to its simulated rig (thesis ch. 6).

No prediction uses a pressure sensor; only `sensor_backup` reads the other chamber's pressure, as the thesis had to.
"""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from greygate.machines.procedure import Procedure
from greygate.machines.pump_cylinder.network import leakage_bounds, pump_srnn
from greygate.machines.pump_cylinder.plant import PUMP_CYLINDER, RECORDS, SAMPLE_TIME, SENSORS, pump_cylinder, record
from greygate.models.accuracy import free_run_rms, rms
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.library import library
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.plants.simulator import simulate
from greygate.progress import Progress, silent, titled

TRAINING = ("rig_training",)
SCENARIOS = ("rig_training", "rig_chirp", "rig_random", "rig_open")
THESIS = {  # RMS in Pa, chambers A and B
    "chirp": (0.0547e6, 0.0911e6),  # simulated plant (6.3.3)
    "sensor_training": (0.092e6, 0.116e6),  # the other chamber measured (table 6.4)
    "sensor_validation": (0.112e6, 0.195e6),  # the same (6.4); without a sensor it diverged
}
_COMPARED = {  # source -> scenario -> figure of `THESIS`; there is none for its rig without a sensor
    "thesis, simulated plant": {"rig_chirp": "chirp"},
    "thesis, with a sensor": {
        "rig_training": "sensor_training",
        "rig_chirp": "sensor_validation",
        "rig_random": "sensor_validation",
    },
}
REFERENCES = {
    source: {name: dict(zip(("p_a", "p_b"), THESIS[figure], strict=True)) for name, figure in scenarios.items()}
    for source, scenarios in _COMPARED.items()
}
Q_MAX, P_MAX = 3e-4, 2e7  # m^3/s, Pa; the networks' normalisation
X_SCALE = 5e-6 * 2**14  # m; a step of the sensor is an exact binary fraction
EPOCHS = 40
NARX = {number: ((number - 1) // 3 + 1, (5, 10, 15)[(number - 1) % 3]) for number in range(1, 10)}
"""Table 6.2: architecture -> samples of each signal, neurons."""
NARX_EPOCHS, NOE_EPOCHS = 2000, 30
THESIS_NARX = (0.07e6, 0.07e6, 0.07e6, 0.02e6, 0.01e6, 8e3, 0.01e6, 5e3, 6e3)  # Pa, in training (table 6.2)
THESIS_NOE = 0.2e6  # Pa, in training


@lru_cache
def recording(name: str, known: str = "") -> Record:
    """Speeds `n_1`, `n_2` [rev/s] and position `x` [m] as sensors give them; targets: measured pressures [Pa].

    known: chamber whose sensor's reading is an input, `p_a_measured` or `p_b_measured`, and no target.
    """
    c = record(name).channels
    inputs = {n: c[n] for n in ("n_1", "n_2", "x")} | ({f"p_{known}_measured": c[f"p_{known}"]} if known else {})
    return Record(inputs, {f"p_{chamber}": c[f"p_{chamber}"] for chamber in "ab" if chamber != known})


def records() -> dict[str, Record]:
    """The rig's training record and its three validation scenarios."""
    return {name: recording(name) for name in SCENARIOS}


def assemble(known: str = "") -> Network:
    """The SRNN with the parameters of table 6.1, at rest at 12 MPa. known: as for `pump_srnn`."""
    plant = pump_cylinder()
    k = {symbol: p.value for symbol, p in PUMP_CYLINDER.items()} | {"q_max": Q_MAX, "p_max": P_MAX}
    k |= {f"p_{c}_rest": plant.constant(plant.states[f"p_{c}"].initial) for c in "ab"}
    rest = plant.initial()
    n_1, n_2 = (Port(n, "rev/s", SENSORS[n][0], initial=rest[n], resolution=SENSORS[n][2]) for n in ("n_1", "n_2"))
    return pump_srnn(k, library("divider"), (n_1, n_2), Port("x", "m", X_SCALE, resolution=SENSORS["x"][2]), known)


def fit(network: Network, name: str, known: str = "", progress: Progress = silent) -> Trained:
    """Free-run training on one record, the leakage kept as `assemble` bounds it."""
    bounds = leakage_bounds(assemble(known))
    return train(network, [recording(name, known)], epochs=EPOCHS, bounds=bounds, progress=titled(progress, name))


def train_srnn(progress: Progress = silent) -> tuple[Network, dict]:
    """Train on the nominal plant, adapt on the rig's training record. Returns the network and its figures.

    Figures: RMS in Pa, chambers A and B, by step and record; `constant`: of the training record's mean pressures.
    """
    snn = Procedure({name: recording(name) for name in RECORDS})
    snn.join(assemble)
    snn.step("nominal", partial(fit, snn.network, "training", progress=progress))
    snn.step("adapted", partial(fit, snn.network, "rig_training", progress=progress))
    steps = ("joined", "nominal", "adapted")
    figures: dict = {name: {r: tuple(e.values()) for r, e in snn[name].errors.items()} for name in steps}
    figures |= {"constant": constant(), "sensor_backup": sensor_backup(progress), "thesis": THESIS}
    figures["noisy_position"] = noisy_position(snn["nominal"].network)
    figures["seconds"] = {name: snn[name].seconds for name in ("nominal", "adapted")}
    return snn.network, figures


def constant() -> dict[str, tuple[float, ...]]:
    """RMS in Pa of the simplest model: the mean pressures of the rig's training record."""
    mean = {p: v.mean() for p, v in recording("rig_training").targets.items()}
    return {name: tuple(rms(v - mean[p]) for p, v in recording(name).targets.items()) for name in SCENARIOS}


def sensor_backup(progress: Progress = silent) -> dict[str, tuple[float, ...]]:
    """RMS in Pa of `RNN P_A` and `RNN P_B`, each with the other chamber's sensor (figs. 6.5, 6.6, table 6.4)."""
    found: dict[str, tuple[float, ...]] = dict.fromkeys(SCENARIOS, ())
    for known in "ba":
        network = fit(assemble(known), "training", known, progress).network
        network = fit(network, "rig_training", known, progress).network
        for name in SCENARIOS:
            found[name] += tuple(free_run_rms(network, recording(name, known)).values())
    return found


def noisy_position(nominal: Network) -> dict[str, tuple[float, ...]]:
    """RMS in Pa of the adaptation repeated with five times the noise of position, by record."""

    def noisier(name: str) -> Record:
        r, (_, noise, _) = recording(name), SENSORS["x"]
        more = np.sqrt(24.0) * noise * np.random.default_rng(RECORDS[name][1] + 500).standard_normal(len(r))
        return replace(r, inputs={**r.inputs, "x": r.inputs["x"] + more})

    bounds = leakage_bounds(assemble())
    network = train(nominal, [noisier("rig_training")], epochs=EPOCHS, bounds=bounds).network
    return {name: tuple(free_run_rms(network, noisier(name)).values()) for name in SCENARIOS}


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


def black_boxes(progress: Progress = silent) -> dict:
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
        told = titled(progress, f"NARX {number}")
        fit = fits[number] = train(begun, [training], teacher=True, epochs=NARX_EPOCHS, progress=told)
        told = titled(progress, f"NARX {number} without noise")
        exact = train(begun, [black_box("training", True)], teacher=True, epochs=NARX_EPOCHS, progress=told)
        found[number] = {"ahead": _ahead(fit), "exact": _ahead(exact), "chirp": _both(fit.network, chirp)}
        found[number] |= {"epochs": len(fit.history) - 1, "seconds": fit.seconds}
    best = min(found, key=lambda n: found[n]["ahead"])
    fit = train(fits[best].network, [training], epochs=NOE_EPOCHS, progress=titled(progress, "NOE"))
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
