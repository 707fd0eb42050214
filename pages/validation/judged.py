"""A network judged on its records, for the validation page and for the terminal, and what to do about it."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, NotRequired, TypedDict

import numpy as np

from greygate.errors import InputError
from greygate.machines.catalog import CATALOG, entry
from greygate.machines.source import Source
from greygate.models.accuracy import rms
from greygate.models.importers.beside import Beside
from greygate.models.residuals import asks_for
from greygate.models.spectra import Octave
from greygate.models.training.initial import initialised
from greygate.models.training.record import check_skips
from greygate.models.validation import Correlation, Covered, Validation, coverage, validate
from greygate.pages.summary import aligned
from greygate.pages.units import NONE, display, per_cent, shown
from greygate.plain import Count, Figure, plain
from greygate.progress import Progress, silent


class TestFigures(TypedDict):
    name: str
    lags: list[int]
    values: list[Figure]
    plain: Figure
    band: Figure
    allowed: Count
    limit: Figure
    outside: Count
    passed: bool


class Response(TypedDict):
    frequency: list[float]
    magnitude: list[Figure]
    phase: list[Figure]
    coherence: list[Figure]


class LongRunFigures(TypedDict):
    rms: list[Figure]
    reach: list[list[Figure]]
    growth: Figure
    bounded: bool
    stable: bool


class OutputFigures(TypedDict):
    record: str
    output: str
    unit: str
    samples: Count
    skip: Count
    spread: Figure
    rms: Figure
    worst: Figure
    fit: Figure
    ahead: Annotated[dict[str, list[Figure]], "Steps ahead -> figures."]
    tests: Annotated[dict[str, list[TestFigures]], "Residual -> its tests."]
    response: Response | None
    octaves: NotRequired[
        Annotated[
            list[Octave],
            "By octave, the fastest first: RMS of error and signal, by Haar's wavelet; at: s from the first sample "
            "that counts, where the error is most.",
        ]
    ]
    long_run: LongRunFigures
    bounded: bool


class ValidationFigures(TypedDict):
    """A float network in free run, a few steps ahead, under residual tests, over a long run."""

    title: str
    name: str
    parameters: Count
    period: float
    training: list[str]
    bounded: bool
    outputs: list[OutputFigures]
    ranges: list[Covered]
    advice: list[str]
    imported: NotRequired[Annotated[Beside, "A network of another tool beside its own program."]]


@dataclass(frozen=True)
class Judged:
    """One network judged on its records. training: the records it was trained on. period: s."""

    title: str
    name: str
    parameters: int
    period: float
    training: tuple[str, ...]
    validations: list[Validation]
    ranges: list[Covered]

    @property
    def bounded(self) -> bool:
        return all(v.bounded for v in self.validations)

    def figures(self) -> dict:
        """JSON-able: SI units, None for what is not finite; signals are left out."""
        found = {k: getattr(self, k) for k in ("title", "name", "parameters", "period", "training", "bounded")}
        found["outputs"] = [v.figures() for v in self.validations]
        return plain(found | {"ranges": [asdict(r) for r in self.ranges]})


def judge(source: Source, lags: int = 25, progress: Progress = silent) -> Judged:
    """Validate a network of the catalogue, or a file, on its records. Raises InputError as `validate` and `Source`.

    A network of the catalogue is also judged on its training records, even if recordings are given. Any other network
    is assumed to be trained on the first recording, if it is not said on how many (`Source.learnt`).
    """
    source = replace(source, learnt=source.learnt or 1)
    network, records, training = source.network(), source.records(), source.training
    if source.name in CATALOG and source.recordings:
        training, own = entry(source.name).training, entry(source.name).records()
        if taken := set(training) & set(records):
            raise InputError(f"record {min(taken)}: {source.name} learnt from one of that name; name yours otherwise")
        records = {n: own[n] for n in training} | records
    check_skips(network, list(records.values()))  # before anything is run
    records = {name: initialised(network, record) for name, record in records.items()}
    validations = validate(network, records, period=source.period, lags=lags, progress=progress)
    size = sum(v.size for v in network.flatten().parameters().values())
    ranges = coverage(network, records, training)
    return Judged(source.title, network.name, size, source.period, training, validations, ranges)


def tally(tests: Sequence[Correlation] | None) -> str:
    """`4/5` of the tests passed."""
    return NONE if tests is None else f"{sum(t.passed for t in tests)}/{len(tests)}"


def long_run(v: Validation) -> str:
    return "unbounded" if not v.bounded else "stable" if v.long_run.stable else "drifts"


def rows(judged: Judged) -> list[dict]:
    """The rows of the table, {column: cell}, one for each record and output."""
    found = []
    for v in judged.validations:
        reach = v.rms if math.isfinite(v.rms) else v.spread
        ahead = {k: per_cent(v.ahead[k][1] if k in v.ahead else None) for k in (1, 10)}
        found.append(
            {
                "record": v.record + ("*" if v.record in judged.training else ""),
                "output": v.output,
                "std": shown(v.spread, v.unit, reach),
                "RMS": shown(v.rms, v.unit, reach) if math.isfinite(v.rms) else "∞",
                "unit": display(v.unit, reach)[1] or "1",
                "fit %": per_cent(v.fit),
                "1 step": ahead[1],
                "10 steps": ahead[10],
                "free run": tally(v.tests.get("free run")),
                "one step": tally(v.tests.get("one step ahead")),
                "long run": long_run(v),
            }
        )
    return found


def table(judged: Judged) -> list[str]:
    """Lines for a terminal."""
    found = aligned(rows(judged), ("record", "output", "unit", "long run"))
    return [
        judged.title,
        *found,
        "* learnt from this record",
        "fit %: free run; 1 step, 10 steps: fit % of the prediction that far ahead from what was measured",
        "free run, one step: residual tests passed; long run: ten times the record, inputs to 1.2 times",
    ]


STARTS = (10, 20, 50, 100, 200, 500, 1000)  # samples of a beginning that are offered as --settle
LOUD = 3.0  # times the later residual, from which a beginning is taken to settle
QUIET = 1.5  # times the later residual, below which the state has settled
LATER = 0.5  # share of a record at its end, to which its beginning is compared


def advice(judged: Judged) -> list[str]:
    """What to do, a sentence each; first what matters most."""
    return list(dict.fromkeys(line for v in judged.validations for line in _of(v)))


def _of(v: Validation) -> list[str]:
    where = f"{v.output} on {v.record}"
    found = []
    if not v.bounded:
        found.append(
            f"{where}: the free run leaves what was measured; train in free run (not one step ahead alone), with more "
            "--decay, longer records, or linear_loop=True"
        )
    elif not v.long_run.stable:
        found.append(f"{where}: the error grows with each repetition; take the offset off the inputs, or measure more")
    if (settle := settling(v)) is not None:
        samples, ratio = settle
        found.append(
            f"{where}: residuals of the first {samples} samples are {ratio:.0f} times the rest: --settle {samples}"
        )
    residual = "free run" if "one step ahead" not in v.tests else "one step ahead"
    for test in v.tests.get(residual, ()):
        if not test.passed:
            found.append(f"{where}, {residual}: {asks_for(test, v.output)}")
    return found


def settling(v: Validation) -> tuple[int, float] | None:
    """Samples at the beginning of a record whose residual is far larger than later, and by how much; None if not."""
    e = (v.measured - v.predicted)[v.skip :]
    later = rms(e[int(LATER * len(e)) :])
    if v.skip or not (np.isfinite(later) and later > 0):
        return None
    for samples in STARTS:
        if samples > len(e) // 5:
            return None
        if rms(e[samples : 2 * samples]) <= QUIET * later:
            ratio = rms(e[:samples]) / later
            return (samples, ratio) if ratio > LOUD else None
    return None
