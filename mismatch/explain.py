"""Turns the folder of a rig into a diagnosis that a person reads: printed lines, `diagnosis.json`, an HTML page."""

import csv
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np

from greygate import children
from greygate.errors import InputError, shown
from greygate.files import replacing, replacing_all, scratch
from greygate.mismatch import effects as table
from greygate.mismatch import words
from greygate.mismatch.concealed.conceal import reveal, sealed
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.effects import Effect
from greygate.mismatch.excitation import check
from greygate.mismatch.experiments.experiment import nominal
from greygate.mismatch.experiments.isolability import isolability
from greygate.mismatch.printed import Rms
from greygate.mismatch.rig import Rig, load
from greygate.mismatch.search import Search
from greygate.mismatch.simulation import asked, read, simulate
from greygate.models import accuracy
from greygate.plants.recording import Recording
from greygate.progress import Budget, Progress, silent

PER_CENT = 100.0
Page = Callable[[Diagnosis], str]
"""What makes the HTML page of a diagnosis: `greygate.pages.diagnosis.page`."""


def table_of(paths: Iterable[Path], rig: Rig, recording: Recording | None) -> dict[str, Effect]:
    """The effects to try on a rig: those of greygate's table, extended by the user's own files."""
    return table.known(rig, recording, given=extended({}, paths))


def extended(effects: Mapping[str, Effect], paths: Iterable[Path]) -> dict[str, Effect]:
    """Effects with those of the user's own files."""
    for path in paths:
        effects = {**effects, **table.read(path)}
    return dict(effects)


def explain(
    folder: Path,
    out: Path | None = None,
    html: Path | None = None,
    own: Sequence[Path] = (),
    progress: Progress = silent,
    page: Page | None = None,
    budget: Budget | None = None,
) -> tuple[dict, list[str]]:
    """Diagnose the rig in `folder`, write the files asked for, and return (content of diagnosis.json, lines to print).

    own: files of effects to try besides greygate's. page: what makes the page; needed where `html` is given. budget: as
    for `diagnose`.
    Raises InputError, before anything is written, for a rig, recording or table that cannot be used.
    """
    for path in (out, html):
        if path is not None and not path.absolute().parent.is_dir():
            raise InputError(f"{path.parent}: no such folder; make it, or write elsewhere")
    made = Explained.of(folder, page if html else None, own, progress, budget)
    made.write(out, html)
    return made.found, made.lines


def explain_all(
    folders: Sequence[Path],
    out: Path | None = None,
    html: Path | None = None,
    own: Sequence[Path] = (),
    jobs: int | None = None,
    progress: Progress = silent,
    page: Page | None = None,
    seconds: float = math.inf,
) -> dict[str, tuple[dict, list[str]]]:
    """`explain` for several rigs: name of the folder -> (content of diagnosis.json, lines to print).

    out, html: a file for one rig; for several a folder, which gets NAME.json or NAME.html as soon as it is found.
    seconds: for each rig. jobs: rigs at a time. They run on joblib's backend:
    `with joblib.parallel_config(backend="dask")` sends them to a cluster, whose workers read the rigs at the same
    paths. progress: gets the number of rigs that are done, and the name of the last one.

    If one of several rigs cannot be diagnosed, or its process is killed twice, the others go on: its content is
    {"error": line}, and its lines say so. Raises InputError for two rigs of one name, for a missing folder to
    write to, and for a single rig as `explain`.
    """
    folders, own = ([Path(path).resolve() for path in paths] for paths in (folders, own))
    names, several = [folder.name for folder in folders], len(folders) > 1
    if twice := next((n for n in names if names.count(n) > 1), None):
        raise InputError(f"{twice}: two rigs of that name; diagnose them one by one")
    for path in (out, html) if several else ():
        if path is not None and not path.is_dir():
            raise InputError(f"{path}: no such folder; of several rigs --out and --html name folders, make it")
    tasks = [partial(_attempt, folder, page if html else None, own, seconds) for folder in folders]
    results = {}
    for name, made in zip(names, children.workers(jobs, tasks), strict=True):
        try:
            if made is children.DIED:
                raise InputError(children.KILLED)
            if isinstance(made, InputError):
                raise made
            made.write(*(p / (name + end) if p and several else p for p, end in ((out, ".json"), (html, ".html"))))
            results[name] = made.found, made.lines
        except InputError as error:
            if not several:
                raise
            results[name] = {"error": str(error)}, [f"{name}: not diagnosed: {error}"]
        progress(f"{len(results)} of {len(folders)}: {name}")
    return results


def _attempt(folder: Path, page: Page | None, own: Sequence[Path], seconds: float) -> "Explained | InputError":
    """Return the InputError of a rig like a result, so that the other rigs go on."""
    try:
        return Explained.of(folder, page, own, budget=Budget(seconds))
    except InputError as error:
        return error


@dataclass(frozen=True)
class Explained:
    """The diagnosis of a rig, ready to write: content of diagnosis.json, lines to print, and the page if wanted."""

    found: dict
    lines: list[str]
    page: str | None

    @classmethod
    @np.errstate(over="ignore", invalid="ignore")  # a trial may diverge
    def of(
        cls,
        folder: Path,
        page: Page | None = None,
        own: Sequence[Path] = (),
        progress: Progress = silent,
        budget: Budget | None = None,
    ) -> "Explained":
        rig = _uncertain(folder)
        recording = rig.to_explain()
        rig.held_out()  # a faulty file is reported before hours of fitting
        effects = table_of(own, rig, recording)
        check(rig, recording, effects)
        try:
            result = diagnose(rig, effects=effects, progress=progress, budget=budget)
        except np.linalg.LinAlgError as error:
            raise InputError(
                f"{folder}: the fit fails numerically ({error}); check the values and units in rig.toml, "
                "or restart the simulation in windows of window_s"
            ) from error
        return cls(result.as_dict(), words.lines(result), page(result) if page else None)

    def write(self, out: Path | None, html: Path | None) -> None:
        """Write each file completely or not at all, and both together if they are in one folder."""
        wanted = [
            (p, t) for p, t in ((out, json.dumps(self.found, indent=1) + "\n"), (html, self.page)) if p is not None
        ]
        for _, group in groupby(wanted, key=lambda one: one[0].parent):
            paths, texts = zip(*group, strict=True)
            with replacing_all(paths) as new:
                for temporary, text in zip(new, texts, strict=True):
                    temporary.write_text(text, encoding="utf-8", newline="\n")


def _uncertain(folder: Path) -> Rig:
    """Load the rig in `folder`. Raises InputError if no parameter is uncertain, since nothing could be fitted."""
    rig = load(folder)
    if not rig.uncertain():
        raise InputError(f"{rig.folder}/rig.toml: tolerance: no parameter is uncertain; give at least one, e.g. 0.01")
    return rig


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge
def isolable(
    folder: Path, own: Sequence[Path] = (), ranges: Mapping[str, tuple[float, float]] | None = None
) -> tuple[dict, list[str]]:
    """Which effects the rig in `folder` can tell apart; (groups, unseen, singular values, ..., lines to print).

    The motion is that of its identify.csv. With `ranges` of the inputs (in their units) it is simulated on the data
    sheet's plant, so that no recording is needed. Raises InputError for a rig, recording, table or ranges that cannot
    be used.
    """
    rig = _uncertain(folder)
    path = rig.folder / rig.identify[0]
    if not ranges and not path.exists():
        wish = " ".join(f"--range {name}=LOW:HIGH" for name in rig.inputs)
        raise InputError(f"{path}: there is no such file; record it, or give {wish}")
    if ranges:
        recording = nominal(rig, table_of(own, rig, None), ranges)
    else:
        recording = rig.to_explain()
    effects = table_of(own, rig, recording)
    check(rig, recording, effects)
    search = Search(rig, recording, effects)
    if not search.effects:
        raise InputError(f"{rig.plant.name}: no table has an effect of this plant; write one and give it by --effects")
    found = isolability(search)
    seconds = recording.samples * recording.dt
    motion = "motion by rule" if ranges else "recording"
    head = f"{rig.folder.resolve().name} ({rig.plant.name}), {seconds:.4g} s of {motion}"
    return {"plant": rig.plant.name, **found.as_dict()}, [head, *(f"  {line}" for line in found.lines())]


def predict(
    folder: Path, recording: Path, diagnosis: Path | None, out: Path, own: Sequence[Path] = (), name: str | None = None
) -> dict[str, Rms]:
    """Write `t`, as it stands in `recording`, and the predicted channels to the CSV file `out`.

    name: of the recording of rig.toml whose own parameters hold, by default that of the file.
    Returns channel -> rms of simulated minus recorded (None if the simulation diverges), unit, finite.
    """
    rig = load(folder)
    if name is not None and name not in rig.own:
        known = ", ".join(rig.own) or "none"
        raise InputError(f"--as {shown(name)}: no [recordings.NAME] of {rig.folder}/rig.toml; it has {known}")
    measured, clock = rig.timed(recording)
    claimed = None if diagnosis is None else read(diagnosis)
    effects = extended(table.named(rig, measured, asked(claimed)), own)
    found = simulate(rig, measured, claimed, effects, name)
    with replacing(out) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["t", *found])
        writer.writerows(zip(clock, *(values.tolist() for values in found.values()), strict=True))
    rms: dict[str, Rms] = {}
    for name, values in found.items():
        with np.errstate(over="ignore", invalid="ignore"):
            error = accuracy.rms(values - measured[name])
        finite = math.isfinite(error)
        rms[name] = {"rms": error if finite else None, "unit": rig.channels[name].unit, "finite": finite}
    return rms


def score(folder: Path, diagnosis: Path | None, own: Sequence[Path] = ()) -> tuple[dict, list[str], bool]:
    """Score a concealed case: (answer and score, lines to print, whether the diagnosis is right).

    If no diagnosis is given and the folder holds none, only the answer is returned.
    """
    for path in own:
        table.read(path)  # a faulty table is reported before the answer is opened
    answer = sealed(folder)
    what = ", ".join(answer["concealed"]) or answer["parameter"] or "nothing"
    out = [words.row("concealed", f"{what} ({answer['kind']}, {answer['form']} form, {answer['plant']})")]
    true = {**answer["effects_true"], **({answer["parameter"]: answer["parameters_true"][answer["parameter"]]}
                                         if answer["parameter"] else {})}  # fmt: skip
    out.append(words.row("", ", ".join(f"{name} = {value:.5g}" for name, value in true.items()))) if true else None
    if diagnosis is None:
        diagnosis = Path(folder) / "diagnosis.json"
        if not diagnosis.exists():
            return {"answer": answer}, out, True
    reveal(folder, diagnosis)  # a faulty file is reported before anything is simulated
    with scratch() as place:
        corrected = place / "corrected.csv"
        predict(folder, Path(folder) / "third.csv", diagnosis, corrected, own)
        found = reveal(folder, diagnosis, {"corrected": corrected})
    right = (
        found["right_verdict"]
        and found["all_named"] is not False
        and found["right_parameter"] is not False
        and not found["false_effects"]
    )
    said = {True: "right", False: "wrong", None: "–"}
    out.append(words.row("claimed", ", ".join(found["named"]) or "no effect"))
    for key in ("verdict", "first", "equation", "parameter"):
        out.append(words.row(key, said[found[f"right_{key}"]])) if found[f"right_{key}"] is not None else None
    if found["false_effects"]:
        out.append(words.row("false", ", ".join(found["false_effects"])))
    inside = found["inside"]
    out.append(words.row("intervals", f"{sum(inside.values())} of {len(inside)} hold the true value"))
    if found["removed"] is not None:
        removed = f"{PER_CENT * found['removed']:.1f} % of the removable error on the held-out recording"
        out.append(words.row("removed", removed))
    return {"answer": answer, **found, "right": right}, out, right
