"""Whether a network predicts: free run, k steps ahead, residuals, accuracy over frequency, and the long run.

The residual is e = measured - predicted throughout, in the unit of the output.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import eigh, toeplitz
from threadpoolctl import threadpool_limits

from greygate.errors import InputError
from greygate.models.network import Network, Port
from greygate.models.spectra import frequency_response
from greygate.models.training.kernels import forward, tabulate
from greygate.models.training.problem import CORES, Problem, Record

HORIZONS = (1, 2, 5, 10, 20, 50, 100)  # steps ahead
ORIGINS = 1000  # most points of a record from which it predicts k steps ahead
DEVIATIONS = 1.96  # of the 95 % band of a correlation
CHANCE = 0.005  # that a residual with nothing wrong in it has too many lags outside the band; or one too far outside
DRAWS = 2000  # from which that is found
REPETITIONS = 10
AMPLITUDES = (1.0, 1.2)  # of the inputs about their mean, in the long run
LEASH = 20.0  # half ranges of the measured output that a bounded prediction stays within
PERIODIC = 1e-9  # half ranges by which a repetition may differ from the one before for all that follow to be the same
HUGE = 1e100  # normalised: as good as infinite
SETTLED = 0.01  # of the output's deviation by which the error of a settled network may grow per repetition


@dataclass(frozen=True)
class Correlation:
    """One residual test: a correlation that is zero at every lag if the residual is white and no input is in it.

    values: coefficients (M,) at `lags`, in steps; at a positive lag the residual comes after. plain: the 95 % band
    1.96/sqrt(N) (thesis 3.2). band: the same where one of the two is white, wider where both are coloured. allowed and
    limit: how many lags outside the band, and how large a coefficient, chance may bring about; neighbouring lags are
    alike where a signal is coloured, so that they leave the band together.
    """

    name: str
    lags: np.ndarray
    values: np.ndarray
    plain: float
    band: float
    allowed: int
    limit: float

    @property
    def outside(self) -> int:
        """Lags outside `band`; 5 % of them are expected."""
        return int(np.count_nonzero(np.abs(self.values) > self.band))

    @property
    def passed(self) -> bool:
        """Whether chance may have brought this about; it fails 1 % of residuals that have nothing wrong."""
        return self.outside <= self.allowed and bool(np.max(np.abs(self.values)) <= self.limit)


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
    free run, the accuracy A = Y_hat/Y (thesis 3.3), None if it diverges. measured, predicted, one_step: (N,), whole.
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
class Range:
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
    progress: Callable[[str], None] | None = None,
) -> list[Validation]:
    """Every output of the network on every record. period: s. lags: of the residual tests.

    k steps ahead: up to step t the measured outputs stand in the feedback, and the prediction of t + k is k steps of
    free run from there, for up to 1000 points t of the record. Hidden states, which nobody measured, start from where
    the measured outputs before t have brought them.
    Raises InputError as `Problem`, and for a record with fewer than 4 (lags + 2) samples.

    >>> (found,) = validate(lag, {"train": record}, period=1e-3)
    >>> found.output, round(found.fit, 3), found.bounded
    ('y', 100.0, True)
    """
    if not records:
        raise InputError(f"network {network.name}: no records to validate on")
    if lags < 1 or not horizons or min(horizons) < 1:
        raise InputError(f"network {network.name}: {lags} lags, horizons {tuple(horizons)}; give numbers above 0")
    for name, record in records.items():
        Problem(network, [record])  # names what is wrong with it
        if (used := len(record) - record.skip) < 4 * (lags + 2):
            raise InputError(
                f"record {name}: {used} samples are too few for {lags} lags; give {4 * (lags + 2)}, or fewer lags"
            )
    model = _Model(network)

    def work(name: str) -> list[Validation]:
        if progress:
            progress(name)
        return list(_validated(model, name, records[name], period, horizons, lags))

    with threadpool_limits(1, "blas"):
        return [v for found in CORES.map(work, records) for v in found]


def coverage(network: Network, records: Mapping[str, Record], training: Sequence[str]) -> list[Range]:
    """Ranges of every input and output on every record. training: names of the records that the network learnt from."""
    found = []
    for port in network.inputs + network.outputs:
        values = {n: (r.inputs | r.targets)[port.name] for n, r in records.items()}
        for i, label in enumerate(labels(port)):
            columns = {n: np.asarray(v, float).reshape(-1, port.size)[:, i] for n, v in values.items()}
            low = min(columns[n].min() for n in training)
            high = max(columns[n].max() for n in training)
            found += [
                Range(label, port.unit, n, x.min(), x.max(), (low, high), float(np.mean((x < low) | (x > high))))
                for n, x in columns.items()
            ]
    return found


def labels(port: Port) -> list[str]:
    """Names of a port's elements: its own, or `name[0]`, `name[1]`, ... where there are several."""
    return [port.name] if port.size == 1 else [f"{port.name}[{i}]" for i in range(port.size)]


def fit_per_cent(measured: np.ndarray, predicted: np.ndarray) -> float:
    """100 (1 - |y - y_hat| / |y - mean y|): 100 is perfect, 0 is no better than the mean. NaN for a constant y."""
    spread = np.linalg.norm(measured - np.mean(measured))
    with np.errstate(invalid="ignore"):
        return float(100 * (1 - np.linalg.norm(measured - predicted) / spread)) if spread > 0 else np.nan


# ---- residual tests


def correlation(name: str, a: np.ndarray, b: np.ndarray, lags: np.ndarray) -> Correlation | None:
    """Correlation of a(k - lag) with b(k), both (N,) and taken about their means (thesis 3.2); None if one is constant.

    If a and b are independent, the covariance of the coefficients at lags l and l + d is sum_t R_aa(t) R_bb(t + d) / N
    (Bartlett 1955; Ljung 1999, 16.6), 1/N at d = 0 where one of them is white; the band is never taken narrower. For an
    autocorrelation (a is b) it is that of a white signal.
    """
    if any(not np.ptp(x) > 1e-12 * np.abs(x).max() for x in (a, b)):
        return None
    n, white = len(a), a is b
    a, b = (np.fft.rfft(x - np.mean(x), 2 * n) for x in (a, b))
    own_a, own_b = (np.fft.irfft(np.abs(x) ** 2) for x in (a, b))
    values = np.fft.irfft(np.conj(a) * b)[lags] / np.sqrt(own_a[0] * own_b[0])
    spread = np.eye(1, len(lags))[0]
    if not white:
        for own in (own_a, own_b):
            own /= own[0]
            own[n // 4 : -(n // 4) + 1] = 0  # far lags are noise
        spread = np.fft.irfft(np.fft.rfft(own_a).real * np.fft.rfft(own_b).real)[: len(lags)]
    plain = float(DEVIATIONS / np.sqrt(n))
    band = plain * float(np.sqrt(max(1.0, spread[0])))
    allowed, limit = _by_chance(spread)
    return Correlation(name, lags, values, plain, band, allowed, limit * band / DEVIATIONS)


def _by_chance(spread: np.ndarray) -> tuple[int, float]:
    """Of M standard Gaussian numbers with covariance `spread` by lag: most outside 95 % bands, largest, by chance.

    The draws go through the symmetric root, of which there is one: eigenvectors alone have a sign, and where their
    values are alike a direction, that every processor chooses otherwise.
    """
    values, vectors = eigh(toeplitz(spread))
    root = vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    draws = np.abs(_normal(len(spread)) @ root.T)
    outside, largest = np.count_nonzero(draws > DEVIATIONS, axis=1), np.max(draws, axis=1)
    at = int((1 - CHANCE) * DRAWS)
    return int(np.partition(outside, at)[at]), float(np.partition(largest, at)[at])


@lru_cache(4)
def _normal(columns: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(DRAWS, columns))


def residual_tests(e: np.ndarray, inputs: Mapping[str, np.ndarray], lags: int = 25) -> tuple[Correlation, ...]:
    """Tests of a residual (N,) against itself and each input (N,) (Billings and Voon 1986, Int. J. Control 44).

    phi_ee: whiteness. phi_ue: an input that is left in the residual linearly. phi_u2e, phi_u2e2: even terms of it;
    phi_eeu: e(k - 1) u(k - 1) left in e(k), a product of input and noise. u2 = u^2 less its mean. A test is left out
    where an input, or its square, is constant.
    """
    both, past = np.arange(-lags, lags + 1), np.arange(1, lags + 1)
    e = e - np.mean(e)
    found = [correlation("phi_ee", e, e, past)]
    for name, u in inputs.items():
        u = u - np.mean(u)
        found += [
            correlation(f"phi_ue {name}", u, e, both),
            correlation(f"phi_u2e {name}", u**2, e, both),
            correlation(f"phi_u2e2 {name}", u**2, e**2, both),
            correlation(f"phi_eeu {name}", e * u, e, past),
        ]
    return tuple(c for c in found if c)


# ---- running


class _Model:
    """A flat network as arrays for `kernels.forward`, run from any state."""

    def __init__(self, network: Network):
        problem = Problem(network, [])
        self.flat, self.theta, self.columns = problem.flat, problem.theta, problem.elements()
        self.tables, _ = tabulate(self.flat)
        self.depth = self.tables.depth
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
            now[self.depth :, self.columns[p.name]] = (u - p.offset) / p.scale
            now[: self.depth, self.columns[p.name]] = (record.initial.get(p.name, p.initial) - p.offset) / p.scale
        for name, layer in self.flat.modules.items():
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
        for i, label in enumerate(labels(p))
    }
    long_runs = _long_runs(model, record, measured)
    for j, (label, unit) in enumerate((label, p.unit) for p in model.outputs for label in labels(p)):
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
            rms=_rms(y - y_hat),
            worst=float(np.abs(y - y_hat).max()) if finite else np.inf,
            fit=fit_per_cent(y, y_hat) if finite else -np.inf,
            ahead={k: (_rms(e[:, j]), fit_per_cent(m[:, j], m[:, j] - e[:, j])) for k, (m, e) in ahead.items()},
            tests={n: residual_tests(e, inputs, lags) for n, e in residuals.items() if np.isfinite(e).all()},
            response=_response(y, y_hat, period) if finite else None,
            long_run=long_runs[j],
            measured=measured[:, j],
            predicted=predicted[:, j],
            one_step=None if one_step is None else one_step[:, j],
        )


def _ahead(
    model: _Model,
    measured: np.ndarray,
    one_step: np.ndarray,
    seen: np.ndarray,
    skip: int,
    horizons: Sequence[int],
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
    outputs, settled = measured.shape[1], slice(max(len(measured) // 2, record.skip), None)
    middle, half = np.mean(measured, axis=0), np.ptp(measured, axis=0) / 2
    half = np.where(half > 0, half, np.maximum(np.abs(middle), 1e-300))
    spread = np.where(np.std(measured, axis=0) > 0, np.std(measured, axis=0), half)
    rms = np.full((outputs, REPETITIONS), np.inf)
    reach = np.full((outputs, len(AMPLITUDES), REPETITIONS), np.inf)
    for a, amplitude in enumerate(AMPLITUDES):
        before = np.inf
        for r, outcome in zip(range(REPETITIONS), model.repeated(record, amplitude), strict=False):
            if not np.isfinite(outcome).all():
                break
            periodic = np.all(np.abs(outcome - before) <= PERIODIC * half)
            same = slice(r, None if periodic else r + 1)  # repetitions that are as this one
            reach[:, a, same] = (np.max(np.abs(outcome - middle)[settled], axis=0) / half)[:, None]
            if amplitude == 1.0:
                rms[:, same] = [[_rms(e)] for e in (measured - outcome)[settled].T]
            if periodic:
                break
            before = outcome
    found = []
    for j in range(outputs):
        finite = np.isfinite(rms[j]).all()
        slope = np.polyfit(np.arange(1, REPETITIONS), rms[j, 1:], 1)[0] if finite else np.inf
        found.append(LongRun(rms[j], reach[j], float(slope / spread[j])))
    return found


def _response(y: np.ndarray, y_hat: np.ndarray, period: float) -> dict:
    found = frequency_response(y, {"free run": y_hat}, period)
    return {"frequency": found["frequency"], **found["free run"]}


def _rms(error: np.ndarray) -> float:
    value = float(np.sqrt(np.mean(np.square(error))))
    return value if np.isfinite(value) else np.inf
