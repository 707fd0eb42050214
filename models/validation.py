"""Whether a network predicts: free run, k steps ahead, residuals, accuracy over frequency, and the long run.

The residual is e = measured - predicted throughout, in the unit of the output.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from greygate.errors import InputError
from greygate.models import sampling
from greygate.models.accuracy import rms
from greygate.models.network import Network
from greygate.models.residuals import Correlation, residual_tests
from greygate.models.spectra import Octave, frequency_response, octaves
from greygate.models.training.kernels import forward
from greygate.models.training.objective import CORES, Objective
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

HORIZONS = (1, 2, 5, 10, 20, 50, 100)  # steps ahead
ORIGINS = 1000  # most points of a record from which it predicts k steps ahead
REPETITIONS = 10
AMPLITUDES = (1.0, 1.2)  # of the inputs about their mean, in the long run
LEASH = 20.0  # half ranges of the measured output that a bounded prediction stays within
PERIODIC = 1e-9  # half ranges by which a repetition may differ from the one before for all that follow to be the same
HUGE = 1e100  # normalised: as good as infinite
SETTLED = 0.01  # of the output's deviation by which the error of a settled network may grow per repetition


@dataclass(frozen=True)
class LongRun:
    """Free run over the record's inputs, ten times end to end, as recorded and 1.2 times as large about their mean.

    From the end of a record to its beginning inputs jump as no plant could, so that the first half of each repetition
    is left to settle, and the figures are of its second half. rms: (10,) error of each repetition as recorded. reach:
    (2, 10) largest distance from the measured mean, in half ranges of the measured output, by amplitude and repetition.
    growth: of rms per repetition after the first, in standard deviations of the measured output. inf stands where the
    run is not finite.
    """

    rms: np.ndarray
    reach: np.ndarray
    growth: float

    @property
    def bounded(self) -> bool:
        return bool(np.max(self.reach) <= LEASH)

    @property
    def stable(self) -> bool:
        """Bounded, and the error has settled."""
        return self.bounded and self.growth <= SETTLED


@dataclass(frozen=True)
class Validation:
    """What one output of a network does on one record, from `Record.skip` on, in `unit`.

    spread: standard deviation of the measured output. rms, worst, fit: of the free run's error; fit is
    100 (1 - |e| / |y - mean y|) per cent. ahead: k -> (RMS, fit) of the prediction k steps ahead, empty where no output
    is fed back. tests: residual ("free run", "one step ahead") -> residual tests. response: `frequency_response` of the
    free run, the accuracy A = Y_hat/Y (thesis 3.3), None if it diverges. octaves: of the free run's error and of the
    measured output, empty if it diverges; at: s from `skip` on. measured, predicted, one_step: (N,), over the
    full record.
    """

    record: str
    output: str
    unit: str
    samples: int
    skip: int
    spread: float
    rms: float
    worst: float
    fit: float
    ahead: dict[int, tuple[float, float]]
    tests: dict[str, tuple[Correlation, ...]]
    response: dict | None
    octaves: tuple[Octave, ...]
    long_run: LongRun
    measured: np.ndarray
    predicted: np.ndarray
    one_step: np.ndarray | None

    @property
    def bounded(self) -> bool:
        """Whether the free run over the record and the long run stay finite and near what was measured."""
        return bool(np.isfinite(self.rms)) and self.long_run.bounded

    def figures(self) -> dict:
        """Everything but the signals, as a dict."""
        found = {k: v for k, v in asdict(self).items() if k not in ("measured", "predicted", "one_step")}
        for residual, tests in self.tests.items():
            for entry, test in zip(found["tests"][residual], tests, strict=True):
                entry |= {"outside": test.outside, "passed": test.passed}
        found["long_run"] |= {"bounded": self.long_run.bounded, "stable": self.long_run.stable}
        return found | {"bounded": self.bounded}


@dataclass(frozen=True)
class Covered:
    """What a signal covers on one record against the training records. outside: share of samples beyond `trained`."""

    signal: str
    unit: str
    record: str
    low: float
    high: float
    trained: tuple[float, float]
    outside: float


def validate(
    network: Network,
    records: Mapping[str, Record],
    *,
    period: float,
    horizons: Sequence[int] = HORIZONS,
    lags: int = 25,
    progress: Progress = silent,
) -> list[Validation]:
    """Every output of the network on every record. period: s. lags: of the residual tests.

    k steps ahead: up to step t the measured outputs stand in the feedback, and the prediction of t + k is k steps of
    free run from there, for up to 1000 points t of the record. Hidden states, which nobody measured, start from where
    the measured outputs before t have brought them.
    Raises InputError as `Objective`, and for a record with fewer than 4 (lags + 2) samples.

    >>> (found,) = validate(lag, {"train": record}, period=1e-3)
    >>> found.output, round(found.fit, 3), found.bounded
    ('y', 100.0, True)
    """
    if not records:
        raise InputError(f"network {network.name}: no records to validate on")
    sampling.check(network, period, f"period {period:g}", "resample the records")
    if lags < 1 or not horizons or min(horizons) < 1:
        raise InputError(f"network {network.name}: {lags} lags, horizons {tuple(horizons)}; give numbers above 0")
    for name, record in records.items():
        Objective(network, [record])  # names what is wrong with it
        if (used := len(record) - record.skip) < 4 * (lags + 2):
            raise InputError(
                f"record {name}: {used} samples are too few for {lags} lags; give {4 * (lags + 2)}, or fewer lags"
            )
    model = _Model(network)

    def work(name: str) -> list[Validation]:
        progress(name)
        return list(_validated(model, name, records[name], period, horizons, lags))

    with threadpool_limits(1, "blas"):
        return [v for found in CORES.map(work, records) for v in found]


def coverage(network: Network, records: Mapping[str, Record], training: Sequence[str]) -> list[Covered]:
    """Ranges of every input and output on every record. training: names of the records that the network learnt from."""
    found = []
    for port in network.inputs + network.outputs:
        values = {n: {**r.inputs, **r.targets}[port.name] for n, r in records.items()}
        for i, label in enumerate(port.labels):
            columns = {n: np.asarray(v, float).reshape(-1, port.size)[:, i] for n, v in values.items()}
            low = min(columns[n].min() for n in training)
            high = max(columns[n].max() for n in training)
            found += [
                Covered(label, port.unit, n, x.min(), x.max(), (low, high), float(np.mean((x < low) | (x > high))))
                for n, x in columns.items()
            ]
    return found


def fit_per_cent(measured: np.ndarray, predicted: np.ndarray) -> float:
    """100 (1 - |y - y_hat| / |y - mean y|): 100 is perfect, 0 is no better than the mean. NaN for a constant y."""
    spread = np.linalg.norm(measured - np.mean(measured))
    with np.errstate(invalid="ignore"):
        return float(100 * (1 - np.linalg.norm(measured - predicted) / spread)) if spread > 0 else np.nan


# ---- running


class _Model:
    """A flat network as arrays for `kernels.forward`, run from any state."""

    def __init__(self, network: Network):
        objective = Objective(network, [])
        self.flat, self.theta, self.columns = objective.flat, objective.theta, objective.elements()
        self.tables, self.depth = objective.tables, objective.depth
        self.inputs, self.outputs = self.flat.inputs, self.flat.outputs
        self.shown = self.tables.rows[self.tables.shown]  # element of each output column
        self.scale = np.concatenate([np.full(p.size, p.scale) for p in self.outputs])
        self.offset = np.concatenate([np.full(p.size, p.offset) for p in self.outputs])
        feeds = self.flat.feeds()
        delayed = {source for source, delay in feeds.values() if delay > 0}
        self.fed_back = any(feeds[p.name][0] in delayed for p in self.outputs)
        self.forced = np.zeros(self.tables.layers[-1, 0], bool)
        self.forced[self.shown] = True

    def rows(self, record: Record, amplitude: float = 1.0) -> np.ndarray:
        """(depth + N, elements): inputs, `amplitude` times as large about their mean, and the state before step 0."""
        now = np.zeros((self.depth + len(record), len(self.forced)))
        for p in self.inputs:
            u = np.asarray(record.inputs[p.name], float).reshape(-1, p.size)
            u = u if amplitude == 1.0 else np.mean(u, axis=0) + amplitude * (u - np.mean(u, axis=0))
            now[self.depth :, self.columns[p.name]] = p.normalised(u)
            now[: self.depth, self.columns[p.name]] = p.normalised(record.initial.get(p.name, p.initial))
        for name, layer in self.flat.layers().items():
            now[: self.depth, self.columns[name]] = record.initial.get(name, layer.initial)
        return now

    def run(self, now: np.ndarray, past: np.ndarray, forced: np.ndarray | None = None) -> np.ndarray:
        """Fill `now` and `past`; outputs (N, outputs) in physical units, NaN where the run has diverged."""
        t = self.tables
        free = np.zeros_like(self.forced) if forced is None else forced
        done = forward(t.layers, t.links, t.n_inputs, t.depth, self.theta, now, past, free)
        found = now[self.depth :, self.shown]
        found[done:] = np.nan
        return np.where(np.abs(found) < HUGE, found, np.nan) * self.scale + self.offset

    def taught(self, record: Record, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (N, outputs) one step ahead, and what delayed reads saw (depth + N, elements)."""
        now = self.rows(record)
        past = now.copy()
        past[self.depth :, self.shown] = (measured - self.offset) / self.scale
        return self.run(now, past, self.forced), past

    def ahead(self, seen: np.ndarray, origins: np.ndarray, steps: int) -> np.ndarray:
        """(origins, steps, outputs): free runs from each origin, which know what was measured before it."""
        found = np.empty((len(origins), steps, len(self.shown)))
        for i, at in enumerate(origins):
            past = seen[at : at + self.depth + steps].copy()
            found[i] = self.run(past.copy(), past)
        return found

    def repeated(self, record: Record, amplitude: float) -> Iterator[np.ndarray]:
        """Outputs (N, outputs) of the free run over the record's inputs, again and again without a fresh start."""
        now = self.rows(record, amplitude)
        while True:
            yield self.run(now, now.copy())
            now[: self.depth] = now[len(now) - self.depth :]


def _validated(
    model: _Model, name: str, record: Record, period: float, horizons: Sequence[int], lags: int
) -> Iterator[Validation]:
    columns = [np.asarray(record.targets[p.name], float).reshape(-1, p.size) for p in model.outputs]
    measured = np.concatenate(columns, axis=1)
    used = slice(record.skip, None)
    now = model.rows(record)
    predicted = model.run(now, now.copy())
    one_step, ahead = None, {}
    if model.fed_back:
        one_step, seen = model.taught(record, measured)
        ahead = dict(_ahead(model, measured, one_step, seen, record.skip, horizons))
    inputs = {
        label: np.asarray(record.inputs[p.name], float).reshape(-1, p.size)[used, i]
        for p in model.inputs
        for i, label in enumerate(p.labels)
    }
    long_runs = _long_runs(model, record, measured)
    for j, (label, unit) in enumerate((label, p.unit) for p in model.outputs for label in p.labels):
        y, y_hat = measured[used, j], predicted[used, j]
        residuals = {"free run": y - y_hat} | ({} if one_step is None else {"one step ahead": y - one_step[used, j]})
        finite = bool(np.isfinite(y_hat).all())
        yield Validation(
            record=name,
            output=label,
            unit=unit,
            samples=len(y),
            skip=record.skip,
            spread=float(np.std(y)),
            rms=rms(y - y_hat),
            worst=float(np.abs(y - y_hat).max()) if finite else np.inf,
            fit=fit_per_cent(y, y_hat) if finite else -np.inf,
            ahead={k: (rms(e[:, j]), fit_per_cent(m[:, j], m[:, j] - e[:, j])) for k, (m, e) in ahead.items()},
            tests={n: residual_tests(e, inputs, lags) for n, e in residuals.items() if np.isfinite(e).all()},
            response=_response(y, y_hat, period) if finite else None,
            octaves=tuple(octaves(y - y_hat, y, period)) if finite else (),
            long_run=long_runs[j],
            measured=measured[:, j],
            predicted=predicted[:, j],
            one_step=None if one_step is None else one_step[:, j],
        )


def _ahead(
    model: _Model, measured: np.ndarray, one_step: np.ndarray, seen: np.ndarray, skip: int, horizons: Sequence[int]
) -> Iterator[tuple[int, tuple[np.ndarray, np.ndarray]]]:
    """k -> (measured, residual), each (points, outputs); one step ahead from every point."""
    room = (len(measured) - skip) // 4
    kept = [k for k in sorted(set(horizons)) if k <= room]
    last = len(measured) - max(kept, default=1)
    origins = np.unique(np.linspace(skip, last, min(ORIGINS, last - skip + 1)).astype(int))
    found = model.ahead(seen, origins, max(kept, default=1))
    for k in kept:
        target, value = (measured[skip:], one_step[skip:]) if k == 1 else (measured[origins + k - 1], found[:, k - 1])
        yield k, (target, target - value)


def _long_runs(model: _Model, record: Record, measured: np.ndarray) -> list[LongRun]:
    """One an output."""
    outputs, judged = measured.shape[1], slice(max(len(measured) // 2, record.skip), None)
    middle, half = np.mean(measured, axis=0), np.ptp(measured, axis=0) / 2
    half = np.where(half > 0, half, np.maximum(np.abs(middle), 1e-300))
    spread = np.where(np.std(measured, axis=0) > 0, np.std(measured, axis=0), half)
    errors = np.full((outputs, REPETITIONS), np.inf)
    reach = np.full((outputs, len(AMPLITUDES), REPETITIONS), np.inf)
    for a, amplitude in enumerate(AMPLITUDES):
        before = np.full(outputs, np.inf)
        for r, outcome in zip(range(REPETITIONS), model.repeated(record, amplitude), strict=False):
            if not np.isfinite(outcome).all():
                break
            periodic = np.all(np.abs(outcome - before) <= PERIODIC * half)
            same = slice(r, None if periodic else r + 1)  # repetitions that are as this one
            reach[:, a, same] = (np.max(np.abs(outcome - middle)[judged], axis=0) / half)[:, None]
            if amplitude == 1.0:
                errors[:, same] = [[rms(e)] for e in (measured - outcome)[judged].T]
            if periodic:
                break
            before = outcome
    found = []
    for j in range(outputs):
        finite = np.isfinite(errors[j]).all()
        slope = np.polyfit(np.arange(1, REPETITIONS), errors[j, 1:], 1)[0] if finite else np.inf
        found.append(LongRun(errors[j], reach[j], float(slope / spread[j])))
    return found


def _response(y: np.ndarray, y_hat: np.ndarray, period: float) -> dict:
    found = frequency_response(y, {"free run": y_hat}, period)
    return {"frequency": found["frequency"], **found["free run"]}
