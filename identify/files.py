"""From files to files: `greygate identify`."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Annotated, NotRequired, TypedDict

import numpy as np

from greygate.errors import InputError
from greygate.files import replaceable, replacing, replacing_folder
from greygate.identify.fitted import warm
from greygate.identify.halving import WORSE, Halving, reach
from greygate.identify.looking import UNSEEN, Seen, look
from greygate.identify.task import SHORTEST, Task, task
from greygate.identify.tried import SURE, Tried, draws, interval, segmented, segments, sure_of
from greygate.models.accuracy import rms
from greygate.models.network import Network
from greygate.models.sampling import same
from greygate.models.training.record import Record
from greygate.models.validation import coverage, fit_per_cent
from greygate.plain import Count, Figure, json_text, plain
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import Recording
from greygate.progress import Progress, once, silent

KIND = "identify"  # of the folder's manifest
UNLIKE = 5.0  # times the median part's error, from which a part is taken to hold what no other does
EXPLAINED = 50.0  # per cent of fit, from which inputs are known to act
NEXT = 1.1  # times what was foretold: what errs by less is as foretold
FEW = 0.05  # of a channel's samples on a test, beyond what was recorded
SHOWN = 12  # models in the table of a terminal


class Row(TypedDict):
    model: str
    parameters: Count
    held_out: Figure
    fit: Figure
    seconds: float


class Confidence(TypedDict):
    better_than_linear: float | None
    better_than_next: float | None
    next: str | None
    next_is: Annotated[str | None, "Why the next was not chosen, where it is likelier to be the better one."]


class IdentifiedFacts(TypedDict):
    """What was tried and chosen. Errors are RMS in free run in the output's unit; null where it diverges."""

    chosen: Row
    better_than_mean: bool
    whole: Figure
    part_count: Annotated[int, "Parts of each recording, one held out at a time: 8, or 2 where models drift."]
    parts: Annotated[dict[int, Figure], "Part that was held out -> error over it."]
    held_out_interval: tuple[Figure, Figure]
    test: dict[str, float | None]
    test_linear: Annotated[dict[str, float | None], "The best linear model's errors, where a network was chosen."]
    test_beyond: Annotated[dict[str, dict[str, float]], "Channel -> share beyond what was recorded to learn from."]
    test_fit: Annotated[dict[str, Figure], "Per cent; 0 is no better than the mean."]
    unit: str
    confidence: Confidence
    models: list[Row]
    tried: Count
    untried: Annotated[dict[str, Count], "Kind of model -> how many of it there was no time for."]
    settle: Count
    seconds: float
    recordings: dict[str, Seen]
    out: NotRequired[str]
    next: NotRequired[list[str]]


@dataclass(frozen=True)
class Identified:
    """The chosen model, fitted to everything, and every model that was tried. seen: of each recording, by `look`.

    line: the best linear model, where tests compare it with a network.
    """

    task: Task
    chosen: Tried
    network: Network
    search: Halving
    seen: dict[str, Seen]
    tests: Mapping[str, Recording]
    seconds: float
    line: Network | None = None


def identify(
    recordings: Mapping[str, Recording],
    inputs: Sequence[str],
    output: str,
    tests: Mapping[str, Recording],
    *,
    seconds: float,
    jobs: int,
    settle: int | None = None,
    progress: Progress = silent,
) -> Identified:
    """Find a network of one output from recordings. Raises InputError as `task` and `Halving`."""
    first = next(iter(recordings.values()))
    for other in (*recordings.values(), *tests.values()):
        if not same(other.dt, first.dt):
            raise InputError(f"{other.source}: sampled every {other.dt:g} s, {first.source} every {first.dt:g} s")
    posed = task(recordings, inputs, output, settle)
    for test in tests.values():
        if test.samples < (least := posed.settle + SHORTEST):
            raise InputError(
                f"{test.source}: {test.samples} samples; a test needs {least}, for its state settles in the first "
                f"{posed.settle}; give fewer by --settle"
            )
    progress("loading what trains networks")
    warm(posed)
    began = process_time()
    seen = {name: look(r, inputs, output) for name, r in recordings.items()}
    search = Halving(posed, seconds - (process_time() - began), jobs, progress)
    search.run(*reach(posed, seen.values()))
    chosen, fit = search.final()
    network = replace(fit.network, dt=first.dt)
    line = search.best_linear()[1] if tests and not chosen.model.form.linear else None
    return Identified(search.task, chosen, network, search, seen, tests, search.clock.spent(), line)


# ---- what is told


def figures(found: Identified) -> IdentifiedFacts:
    """Everything that is told, as plain data."""
    t, search, folds = found.task, found.search, found.search.shared()
    finalists = search.finalists()
    line = next((x for x in finalists if x.model.form.linear), found.chosen)
    runner = next((x for x in finalists if x is not found.chosen), None)
    judged = {n: t.record(r) for n, r in found.tests.items()}
    tested = {n: t.errors(found.network, r) for n, r in judged.items()}
    lined = {} if found.line is None else {n: t.errors(found.line, r) for n, r in judged.items()}
    measured = {n: r.targets[t.output.name][t.settle :] for n, r in judged.items()}
    fits = {n: -np.inf if e is None else fit_per_cent(measured[n], measured[n] + e) for n, e in tested.items()}
    row = _row(t, found.chosen, folds)
    sure = None if found.chosen.model.form.linear else sure_of(found.chosen, line, folds)
    return {
        "chosen": row,
        "better_than_mean": _beats_the_mean(found, folds),
        "whole": search.whole(found.network),
        "part_count": t.parts,
        "parts": {place + 1: found.chosen.over([place]) for place in folds},
        "held_out_interval": interval(segments(found.chosen, folds)),
        "test": {n: None if e is None else rms(e) for n, e in tested.items()},
        "test_linear": {n: None if e is None else rms(e) for n, e in lined.items()},
        "test_beyond": _beyond(found, judged),
        "test_fit": fits,
        "unit": t.output.unit,
        "confidence": {
            "better_than_linear": sure,
            "better_than_next": None if runner is None else sure_of(found.chosen, runner, folds),
            "next": None if runner is None else runner.model.name,
            "next_is": None if runner is None else _why_not(search, runner, found.chosen, line),
        },
        "models": [_row(t, tried, folds) for tried in finalists],
        "tried": len(search.tried),
        "untried": dict(Counter(model.form.name for model in search.untried)),
        "settle": t.settle,
        "seconds": round(found.seconds, 1),
        "recordings": {n: _answering(seen, row["fit"]) for n, seen in found.seen.items()},
    }


def _beats_the_mean(found: Identified, folds: Sequence[int]) -> bool:
    """Whether the chosen one surely errs less than the mean of what was recorded, on what was held out."""
    t, mean = found.task, found.task.output.offset
    blocks = [b for place in folds for b in found.search.folds[place].blocks]
    flat = segmented([b.targets[t.output.name][b.skip :] - mean for b in blocks])
    errors = segments(found.chosen, folds)
    drawn = draws(len(errors))
    return bool(np.mean(errors[drawn].mean(1) < flat[drawn].mean(1)) >= SURE)


def _beyond(found: Identified, tests: Mapping[str, Record]) -> dict[str, dict[str, float]]:
    records = {**found.task.records, **tests}
    shares = coverage(found.network, records, list(found.task.records)) if tests else []
    return {n: {c.signal: c.outside for c in shares if c.record == n and c.outside > FEW} for n in tests}


def _why_not(search: Halving, other: Tried, chosen: Tried, line: Tried) -> str | None:
    """Why another was not chosen that is likelier to be the better one; None where it is not."""
    if sure_of(chosen, other, search.shared()) >= 0.5:
        return None
    if not other.model.form.linear and line.model.form.linear and not search.agrees(other, line):
        return "where inputs are larger its networks of different parts answer apart"
    if not other.model.form.linear and chosen.model.form.linear:
        return "it is not surely better than a linear model"
    if not other.safe:
        return "beyond what was recorded it may run off"
    return "it has more weights" if other.parameters > chosen.parameters else "over everything it errs more"


def _answering(seen: Seen, fit: float) -> Seen:
    """What was seen, without doubts whether inputs act where a model of them explains the output."""
    if not fit > EXPLAINED:
        return seen
    return {**seen, "remarks": [r for r in seen["remarks"] if UNSEEN not in r]}


def _row(t: Task, tried: Tried, folds: Sequence[int]) -> Row:
    spread = float(np.std(np.concatenate([r.targets[t.output.name] for r in t.records.values()])))
    error = tried.over(folds)
    return {
        "model": tried.model.name,
        "parameters": tried.parameters,
        "held_out": error,
        "fit": 100 * (1 - error / spread),
        "seconds": round(tried.seconds, 2),
    }


def lines(found: IdentifiedFacts) -> list[str]:
    """What a person reads of the figures."""
    unit = f" {found['unit']}" if found["unit"] != "1" else ""
    rows = [f"{'model':62} {'weights':>7} {'held out':>10} {'fit %':>7} {'s':>6}"]
    for row in found["models"][:SHOWN]:
        mark = "*" if row["model"] == found["chosen"]["model"] else " "
        rows.append(
            f"{mark} {row['model'][:60]:60} {row['parameters']:7d} {_finite(row['held_out'], '.4g'):>10} "
            f"{_finite(row['fit'], '.2f'):>7} {row['seconds']:6.1f}"
        )
    if len(found["models"]) > SHOWN:
        rows.append(f"  and {len(found['models']) - SHOWN} more; all are in the .json")
    if found["untried"]:
        kinds = ", ".join(f"{count} of {kind}" for kind, count in found["untried"].items())
        rows.append(f"  not tried, for want of --seconds: {kinds}")
    low, high = found["held_out_interval"]
    several = len(found["recordings"]) > 1
    told = [f"{n}: {r}" if several else r for n, seen in found["recordings"].items() for r in seen["remarks"]]
    told = [*told, *rows, f"chosen: {found['chosen']['model']}; held out {found['chosen']['held_out']:.4g}{unit}"]
    told.append(f"of held-out stretches, drawn again and again: {low:.4g} to {high:.4g}{unit} (95 %)")
    told.append("these stretches chose the model too, so a new recording may well lie above")
    sure = found["confidence"]
    if sure["better_than_linear"] is not None:
        told.append(f"there better than the best linear model with probability {sure['better_than_linear']:.2f}")
    if (ahead := sure["better_than_next"]) is not None and sure["next_is"] is not None:
        told.append(f"{sure['next']} is better with probability {1 - ahead:.2f}, but {sure['next_is']}")
    elif ahead is not None:
        told.append(f"better than the next, {sure['next']}, with probability {ahead:.2f}")
    usual = float(np.median(list(found["parts"].values())))
    for part, error in found["parts"].items():
        if error > UNLIKE * usual:
            told.append(
                f"part {part} of {found['part_count']} errs by {error:.4g}{unit} where {usual:.4g}{unit} is usual: "
                "what happens there happens nowhere else; record more of it, or cut it off"
            )
    if not found["better_than_mean"]:
        told.append(
            "no model predicts better than the output's mean: other inputs, a longer recording, or more --seconds"
        )
    if found["whole"] > WORSE * found["chosen"]["held_out"]:
        told.append(
            f"over the complete recordings it errs by {found['whole']:.4g}{unit}: it drifts in longer runs; "
            "give the input that is missing, or a structure (greygate build-snn)"
        )
    for name, missed in found["test"].items():
        told.append(f"test {name}: RMSE {'inf' if missed is None else format(missed, '.4g')}{unit}")
        if name in found["test_linear"]:
            line = found["test_linear"][name]
            less = line is not None and not (missed is not None and missed <= line)
            told[-1] += f"; the best linear model {'errs less, ' * less}{_finite(line, '.4g')}{unit}"
        told += _unforetold(found, name, high)
    return told


def _unforetold(found: IdentifiedFacts, name: str, high: float) -> list[str]:
    """What to say of a test that errs by more than was foretold."""
    missed, fit = found["test"][name], found["test_fit"][name]
    if missed is not None and missed <= NEXT * high:
        return []
    beyond = [f"{share:.0%} of {channel}" for channel, share in found["test_beyond"][name].items()]
    where = f": {' and '.join(beyond)} lies beyond what was recorded; record there, too" if beyond else ""
    times = "" if missed is None or not high > 0 else f"{missed / high:.2g} times what held-out stretches foretold"
    mean = "no better than the output's mean" if fit is None or not fit > 0 else ""
    return ["  that is " + ", and ".join(filter(None, (times, mean))) + where] if times or mean else []


def _finite(value: float | None, form: str) -> str:
    """A figure; one of a model that diverges is inf here, and None once it is plain data."""
    return "–" if value is None or not np.isfinite(value) else format(value, form)


def identify_files(
    files: Mapping[str, str],
    tests: Mapping[str, str],
    inputs: Sequence[str],
    output: str,
    out: Path,
    *,
    dt: float | None,
    seconds: float,
    jobs: int,
    settle: int | None,
    html: Path | None = None,
    page: Callable[[Identified, IdentifiedFacts], str] | None = None,
    progress: Progress = silent,
) -> IdentifiedFacts:
    """Identify from CSV files and write OUT/NAME.toml, .safetensors, .json and recordings of canonical form.

    OUT is written completely or not at all; it replaces what an earlier search wrote there, and nothing else. html: a
    page to write, which `page` makes. Returns the figures. Raises InputError before anything is written.
    """
    if both := set(files) & set(tests):
        raise InputError(f"{min(both)} is both a recording to train on and one to test on; rename one of them")
    if len({Path(p).resolve() for p in (*files.values(), *tests.values())}) < len(files) + len(tests):
        raise InputError("one file is given twice; leave one out")
    name = out.name
    if not re.fullmatch(r"[A-Za-z]\w*", name):
        raise InputError(f"--out {out}: the folder gives the network its name; use letters, digits and _")
    replaceable(out, KIND)
    if not inputs:
        raise InputError("--input is missing; give the channels that drive the plant")
    if output in inputs or len(set(inputs)) < len(inputs):
        raise InputError(f"--input {', '.join(inputs)}, --output {output}: name each channel once")
    read_in, read_tests = (
        {n: read_recording(p, dt=dt, bare=True, told=once) for n, p in of.items()} for of in (files, tests)
    )
    first = next(iter(read_in.values()))
    for recording in (*read_in.values(), *read_tests.values()):
        for channel in (*inputs, output):
            recording[channel]  # raises InputError for an unknown name
            if recording.units[channel] != first.units[channel]:
                raise InputError(f"{recording.source}: {channel} is in another unit than in {first.source}")
    with ExitStack() as place:
        new = place.enter_context(replacing_folder(out, KIND))
        drawn = None if html is None else place.enter_context(replacing(html))  # before a minute of work, not after
        found = identify(
            read_in, inputs, output, read_tests, seconds=seconds, jobs=jobs, settle=settle, progress=progress
        )
        kept = figures(found)
        replace(found.network, name=name).save(new / name, json_text(plain(kept)))
        used = (*inputs, output)
        for label, recording in {**read_in, **read_tests}.items():
            of = Recording(recording.dt, {c: recording[c] for c in used}, {c: recording.units[c] for c in used})
            of.write_csv(new / f"{label}.csv")
        if drawn is not None and page is not None:
            drawn.write_text(page(found, plain(kept)), encoding="utf-8", newline="\n")
    records = " ".join(f"{out / n}.csv" for n in read_in)
    file = out / f"{name}.toml"
    return plain(
        {
            **kept,
            "out": str(file),
            "next": [
                f"greygate validate {file} {records} --settle {kept['settle']}",
                f"greygate compile {file} {records} --out {out / 'compiled'}",
            ],
        }
    )
