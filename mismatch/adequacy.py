"""Whether what a run leaves goes with the machine's own signals: then it is no noise, however it is coloured.

Where no noise is told, or another than is found, what a fit leaves was made equal to noise before. Noise of a sensor
knows nothing of the machine. So functions of the predicted channels, of their rates, of the inputs and of the terms in
which they meet are fitted to what is left on most of the recording, and judged on the rest. Chance is what they predict
of the same errors, shifted in time.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.signal import lfilter

from greygate.mismatch.fit import Fit
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.runs import along
from greygate.plants.expressions import names

FOLDS = 6  # contiguous parts of the recording, held out in turn
SHIFTS = 99  # of the errors in time: with none of them 100, so that one in a hundred can be told
CHANCE = 0.01  # of so good a prediction where there is none
NOTABLE = 0.1  # of the variance, that is predicted where nothing was learnt: less is not worth a verdict
POINTS = 2000  # of the recording, at most; a longer one is averaged
KNEE = 0.1  # of a rate's RMS, at which its sign sets in
MEMORIES = (4, 16, 64)  # points over which a signal is remembered
SHIFTED = (0.05, 0.95)  # of the recording, between which what is left is shifted
RIDGE = 1e-2  # of a unit diagonal: features are many and alike


def dependent(fit: Fit) -> str:
    """What the errors of a run go with, in words; empty where chance predicts them as well."""
    model = fit.likelihood.model
    error = fit.likelihood.residual(fit.values)
    if not np.isfinite(error).all():
        return ""
    size, pieces = max(len(error) // POINTS, 1), model.pieces
    signals = [*(model.target - error).T, *(model.recording[name] for name in model.rig.inputs), *_joining(model, fit)]
    features = np.column_stack([_mean(f, size, pieces) for f in _features(signals, pieces)])
    features = features - features.mean(axis=0)
    features = features / (features.std(axis=0) + TINY)
    predict = _predictor(features)
    for i, channel in enumerate(model.rig.predict):
        left = _mean(error[:, i], size, pieces)
        left = left - left.mean()
        share = _share(left, predict(left))
        if share < NOTABLE:
            continue
        steps = np.linspace(*SHIFTED, SHIFTS) * len(left)
        drawn = [_share(s, predict(s)) for s in (np.roll(left, int(step)) for step in steps)]
        if (1 + np.sum(np.array(drawn) >= share)) / (1 + len(drawn)) <= CHANCE:
            rms = float(np.sqrt(np.mean(error[:, i] ** 2)))
            unit = model.rig.channels[channel].unit
            return f"{share:.0%} of what is left of {channel}, {rms:.3g} {unit} RMS, goes with the machine's own motion"
    return ""


def _mean(signal: np.ndarray, size: int, pieces: Sequence[slice]) -> np.ndarray:
    """Means over so many samples (points,), none of which lies in two recordings."""
    return along(lambda part: part[: len(part) // size * size].reshape(-1, size).mean(axis=1), pieces, signal)


def _joining(model: Model, fit: Fit) -> Iterator[np.ndarray]:
    """The terms (samples,) of the plant in which several of its signals meet: where one has a limit, no signal does."""
    plant, scope = model.rig.plant, model.scope({**model.values, **fit.values})
    for equation in plant.equations.values():
        for text in equation.terms.values():
            if len(names([text]) - {*plant.parameters}) > 1:
                yield np.broadcast_to(scope.evaluate(text), model.recording.samples)


def _features(signals: Sequence[np.ndarray], pieces: Sequence[slice]) -> Iterator[np.ndarray]:
    """Functions of signals (samples,): powers, signs, and what they were a while ago."""
    size = max(len(signals[0]) // POINTS, 1)
    for signal in signals:
        away = signal - signal.mean()
        away = away / (away.std() + TINY)
        rate = along(np.gradient, pieces, away)
        turning = np.tanh(rate / (KNEE * rate.std() + TINY))
        for base in (away, away**2, away**3, np.abs(signal), np.sign(signal), turning):
            yield base
            for points in MEMORIES:
                decay = np.exp(-1.0 / (points * size))
                yield along(lambda part, d=decay: lfilter([1.0 - d], [1.0, -d], part - part[0]), pieces, base)


def _predictor(features: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A function of errors (points,): what the features predict of them where they did not learn (points,)."""
    fold = np.arange(len(features)) * FOLDS // len(features)
    parts = []
    for k in range(FOLDS):
        learn = features[fold != k]
        normal = learn.T @ learn + RIDGE * len(learn) * np.eye(features.shape[1])
        parts.append((fold == k, fold != k, features[fold == k] @ np.linalg.solve(normal, learn.T)))

    def predict(errors: np.ndarray) -> np.ndarray:
        out = np.empty(len(errors))
        for judged, learnt, by in parts:
            out[judged] = by @ errors[learnt]
        return out

    return predict


def _share(errors: np.ndarray, predicted: np.ndarray) -> float:
    """The share of the variance of errors that a prediction takes."""
    return 1.0 - float(np.sum((errors - predicted) ** 2) / max(np.sum(errors**2), TINY))
