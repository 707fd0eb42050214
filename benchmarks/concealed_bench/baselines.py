"""Methods to compare with, which name nothing.

    nominal      the simulation with the data sheet's values
    calibrated   its uncertain parameters fitted (the benchmark's own calibration)
    linear       + a ridge regression of what calibration leaves on the signals and their past
    sparse       + a sparse regression of it over a library of functions (STLSQ of pysindy, two thresholds)
    gaussian     + a Gaussian process of it over the signals (scikit-learn)
    neural       + a tanh network of it over the signals (scikit-learn)

A residual model reads inputs and simulated outputs, never recorded outputs, so that it predicts as the simulation does.
It corrects where, learned from the first three quarters of identify.csv, it makes the last quarter better.
"""

import json
import tomllib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from greygate.errors import InputError
from greygate.mismatch.concealed.conceal import EVERY_RIG
from greygate.mismatch.concealed.rig import Columns, ConcealedRig, Sensor, calibrate, rms
from greygate.mismatch.concealed.stress import between
from greygate.plants.table import read_table
from greygate.reading import read_json

from .answer import PREDICTED, Answer

LENGTHS = (1e-1, 1e3)  # of the kernel, in standard deviations of a signal
KEPT = "calibrated.json"
EVERY = 8  # of the windows of a rig that restarts is seen by the calibration
PAST = (1, 2, 4, 8, 16, 32)  # samples ago, of which the linear model knows the signals
RIDGE = 1e-3  # of the samples: the penalty of a coefficient of standardised signals
THRESHOLDS = (0.02, 0.1)  # of the error's RMS: the least coefficient of the sparse model
TRIED = 0.75  # of identify.csv, from which a model is learned that is tried on the rest
LEARNED = 4000  # samples, evenly spread, that the sparse model learns from
TRAINED = 400  # samples that the Gaussian process learns from: its time grows with the third power
CHUNK = 2000  # samples that it predicts at once
NEURONS, EPOCHS = (32,), 400  # of the network
SEED = 1
INSTALL = "pip install 'greygate[bench]'"


def rig_of(case: Path) -> tuple[ConcealedRig, dict[str, float]]:
    """The machine of a case as rig.toml describes it, and its data sheet."""
    sheet = tomllib.loads((case / "rig.toml").read_text(encoding="utf-8"))
    rig = EVERY_RIG[Path(sheet["plant"]).stem]
    channels = tuple(
        Sensor(name, c["unit"], c["role"], c.get("resolution", 0.0), c.get("noise_rms", 0.0))
        for name, c in sheet["channels"].items()
    )
    every = round(sheet["sample_time_s"] / rig.sample_time)
    if every > 1:
        rig = replace(rig, predict=between(rig, every), sample_time=sheet["sample_time_s"])
    return replace(rig, channels=channels, tolerance=sheet["tolerance"]), sheet["parameters"]


def columns_of(path: Path) -> Columns:
    """The recorded channels."""
    found = read_table(path)
    return dict(zip(found.header[1:], found.values.T[1:], strict=True))


def signals_of(rig: ConcealedRig, recorded: Columns, simulated: Columns) -> np.ndarray:
    """What a residual model reads (samples, signals): inputs, simulated outputs, the rates of both."""
    inputs = [recorded[c.name] for c in rig.channels if c.role == "input"]
    outputs = [simulated[c.name] for c in rig.predicted]
    rates = [np.gradient(signal) for signal in (*inputs, *outputs)]
    if not rig.window:
        return np.stack([*inputs, *outputs, *rates], axis=1)
    window = round(rig.window / rig.sample_time)  # within a window the error grows from 0
    since = np.arange(len(outputs[0])) % window / window
    grown = np.stack([*inputs, *outputs, *rates], axis=1)
    return np.column_stack([grown, since, grown * since[:, None]])


Model = Callable[[np.ndarray], np.ndarray]  # (samples, signals) -> (samples,)
Learner = Callable[[np.ndarray, np.ndarray], Model]  # of the signals and the error


def linear(signals: np.ndarray, error: np.ndarray) -> Model:
    """Ridge regression on the standardised signals, now and in the past."""

    def past(now: np.ndarray) -> np.ndarray:
        shifted = [np.concatenate([np.repeat(now[:1], ago, axis=0), now[:-ago]]) for ago in PAST]
        return np.column_stack([np.ones(len(now)), now, *shifted])

    known = past(signals)
    weights = np.linalg.solve(known.T @ known + RIDGE * len(known) * np.eye(known.shape[1]), known.T @ error)
    return lambda now: past(now) @ weights


def library(now: np.ndarray) -> np.ndarray:
    """Functions of the signals: products of two, cubes, magnitudes and signs."""
    products = [now[:, i] * now[:, j] for i in range(now.shape[1]) for j in range(i, now.shape[1])]
    own = [f(signal) for signal in now.T for f in (lambda s: s**3, np.abs, np.tanh)]
    return np.column_stack([np.ones(len(now)), now, *products, *own])


def sparse(signals: np.ndarray, error: np.ndarray, threshold: float = THRESHOLDS[0]) -> Model:
    """Sequentially thresholded least squares over `library`."""
    try:
        from pysindy import STLSQ
    except ImportError:
        raise InputError(f"sparse: needs pysindy; {INSTALL}") from None
    some = slice(None, None, max(1, len(error) // LEARNED))
    known, error = library(signals[some]), error[some]
    scale = known.std(axis=0)
    scale[scale == 0] = 1.0
    with warnings.catch_warnings():  # that nothing is left: then nothing is corrected
        warnings.simplefilter("ignore", UserWarning)
        model = STLSQ(threshold=threshold, alpha=RIDGE * len(known)).fit(known / scale, error[:, None])
    weights = model.coef_[0] / scale
    return lambda now: library(now) @ weights


def gaussian(signals: np.ndarray, error: np.ndarray) -> Model:
    """Gaussian process with one length for all standardised signals, on a part of the samples."""
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
    except ImportError:
        raise InputError(f"gaussian: needs scikit-learn; {INSTALL}") from None
    some = np.random.default_rng(SEED).choice(len(error), min(TRAINED, len(error)), replace=False)
    kernel = ConstantKernel() * RBF(np.sqrt(signals.shape[1]), LENGTHS) + WhiteKernel()
    with (
        threadpool_limits(1),
        warnings.catch_warnings(),
    ):  # of a length or size at its bound: what is left may be noise alone
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = GaussianProcessRegressor(kernel, random_state=SEED).fit(signals[some], error[some])
    return lambda now: np.concatenate([model.predict(now[k : k + CHUNK]) for k in range(0, len(now), CHUNK)])


def neural(signals: np.ndarray, error: np.ndarray) -> Model:
    """A network of one tanh layer, trained until a tenth of the samples that it does not learn from gets no better."""
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPRegressor
    except ImportError:
        raise InputError(f"neural: needs scikit-learn; {INSTALL}") from None
    some = slice(None, None, max(1, len(error) // LEARNED))
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = MLPRegressor(
            hidden_layer_sizes=NEURONS, activation="tanh", early_stopping=True, max_iter=EPOCHS, random_state=SEED
        )
        model.fit(signals[some], error[some])
    return model.predict


MODELS: dict[str, list[Learner]] = {
    "linear": [linear],
    "sparse": [partial(sparse, threshold=threshold) for threshold in THRESHOLDS],
    "gaussian": [gaussian],
    "neural": [neural],
}


def learned(learners: Sequence[Learner], signals: np.ndarray, error: np.ndarray) -> Model:
    """The model of all samples, by the learner that is best on samples it did not see; zero if none helps."""
    end = round(TRIED * len(error))
    left = [rms(learn(signals[:end], error[:end])(signals[end:]) - error[end:]) for learn in learners]
    if not min(left) < rms(error[end:]):
        return lambda now: np.zeros(len(now))
    return learners[int(np.argmin(left))](signals, error)


def explain(method: str, case: Path, place: Path) -> None:
    """Calibrate, and write an answer that claims nothing."""
    rig, known = rig_of(case)
    if method != "nominal":
        known = calibrate(rig, columns_of(case / "identify.csv"), known, every=EVERY if rig.window else 1)
    (place / KEPT).write_text(json.dumps(known) + "\n")
    Answer().write(place)


def predict(method: str, case: Path, place: Path, recording: Path) -> None:
    """Predict the channels of `recording`; what is learned of the residual is learned from identify.csv."""
    rig, _ = rig_of(case)
    known = read_json(place / KEPT, "explain the case first")

    def simulated(columns: Columns) -> Columns:
        return rig.predict(columns, known, {}, 0.0, 1)

    unseen, seen = columns_of(recording), columns_of(case / "identify.csv")
    found, before = simulated(unseen), simulated(seen)
    if method in MODELS:
        signals = signals_of(rig, seen, before)
        centre, spread = signals.mean(axis=0), signals.std(axis=0)
        spread[spread == 0] = 1.0
        low, high = signals.min(axis=0), signals.max(axis=0)
        now = (np.clip(signals_of(rig, unseen, found), low, high) - centre) / spread
        for name, simulation in before.items():
            error = seen[name] - simulation
            size = float(error.std()) or 1.0
            model = learned(MODELS[method], (signals - centre) / spread, error / size)
            found[name] = found[name] + size * model(now)
    table = np.column_stack([np.arange(len(next(iter(found.values())))) * rig.sample_time, *found.values()])
    header = ",".join(("t", *found))
    np.savetxt(place / PREDICTED, table, delimiter=",", header=header, comments="", fmt="%.10g")
