"""The whole way from a plant and its recordings to verified Verilog, and the page that tells it: `greygate make`."""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType

from markupsafe import Markup

from greygate import schemas
from greygate.compiler.explore import Request, told
from greygate.compiler.verilog import holdable
from greygate.contents import contents
from greygate.control.choices import Case, Method, Place
from greygate.control.own import Machine
from greygate.control.predictive import solver
from greygate.errors import InputError
from greygate.files import making, replacing
from greygate.hardware.build import LATER, Project
from greygate.hardware.controlled import driven, storable, table, written
from greygate.hardware.exploring import Explorer, requested
from greygate.identify.expert.building import DIAGNOSING, TESTED, parts_of, upto
from greygate.identify.expert.diagnosed import Corrected, correct, only
from greygate.identify.expert.diagnosed import asked as ask
from greygate.identify.expert.files import RIG, build_files, read
from greygate.identify.expert.task import Task
from greygate.machines.asked import Wishes, columns_of, rough
from greygate.machines.asked import of as tracking
from greygate.machines.source import Source
from greygate.mismatch.joining import acting
from greygate.mismatch.rig import Rig
from greygate.mismatch.simulation import read as read_diagnosis
from greygate.models.accuracy import Errors
from greygate.pages import story
from greygate.pages.units import display, number
from greygate.pages.validation.judged import advice, judge, long_run
from greygate.plain import json_text, plain
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording, run_name
from greygate.plants.written import entries, text
from greygate.progress import Budget, Progress, once, silent
from greygate.project import compile_project, verify_project
from greygate.reporting import study_of
from greygate.steps import NOTHING, Done, Steps, Told

KIND, PAGE, CONTROL = "make", "index.html", "control"
PICTURE, FITTED = "picture.html", "fitted.html"  # in the folder of a step: what the page shows of it, or the next
DIAGNOSIS, FIGURES, BUILD, REPORT = "diagnosis.json", "validation.json", "build", "report.json"
UNHEARD = 5.0  # times what an input moves on record: limits so wide are likely in another unit
TABLE, HARDWARE = "control.json", "network, Verilog"  # of controllers, the last of which is that


@dataclass(frozen=True)
class Tracking:
    """What the corrected plant is to do. reference: file of what its outputs are to be.

    limits: signal -> (low, high); an input that has none stays within what is on record. rates: input -> its largest
    change in a second.
    """

    reference: Path
    limits: Mapping[str, tuple[float, float]]
    rates: Mapping[str, float]


@dataclass(frozen=True)
class Asked:
    """What is to be made. where: PLANT.toml or a rig. sensors: as of `Task`. error: allowed to fixed point.

    recordings: name -> to learn from; held: to judge by; where there is none, the end of the others judges. track: what
    it is to do under control, if anything.
    """

    where: Path
    task: Task
    recordings: Mapping[str, Recording]
    held: Mapping[str, Recording]
    sensors: Sequence[str]
    request: Request
    error: str
    seconds: float
    track: Tracking | None = None

    @classmethod
    def of(
        cls, where: Path, files: Mapping[str, str], tests: Mapping[str, str], sensors: Sequence[str],
        targets: Sequence[str], device: str, error: str, seconds: float, track: Tracking | None = None,
    ) -> "Asked":  # fmt: skip
        """Read all of it. Without tests the last of several recordings is held out. Raises InputError."""
        if not files:
            files, tests = _of_rig(where, tests)
        if not tests and len(files) > 1:
            *names, last = files
            files, tests = {n: files[n] for n in names}, {last: files[last]}
        if both := {*files} & {*tests}:
            raise InputError(f"{min(both)} is both a recording to learn from and one to judge by; rename one of them")
        plant, found = read(where, {**files, **tests})
        if isinstance(plant, Rig) and not targets:
            targets = [n for n in plant.predict if n not in sensors]
        task = Task.of(plant, [*found.values()], sensors, targets)
        holdable(task.plant.name, task.plant.name)  # minutes before the Verilog is written
        request = requested(device, {t: task.plant.unit(t) for t in task.targets}, error)
        kept = {n: only(r, (*task.inputs, *task.targets)) for n, r in found.items()}
        learnt, held = ({n: kept[n] for n in each} for each in (files, tests))
        made = cls(where, task, learnt, held, sensors, request, error, seconds, track)
        if track:  # minutes before the plant is corrected
            solver()
            storable(machine(made, task.reduced, where))
        return made

    @property
    def judges(self) -> Sequence[str]:
        """The recordings that judge, whole or their end."""
        return [*(self.held or self.recordings)]

    @cached_property
    def heads(self) -> list[Recording]:
        """What is diagnosed: the recordings to learn from without the ends that decide."""
        _, heads = parts_of(self.recordings, bool(self.held))
        return [upto(r, heads[n]) for n, r in self.recordings.items()]

    @property
    def facts(self) -> dict:
        """The plant, the rig and what is asked of the network, as data."""
        folder = self.task.rig.folder if self.task.rig else None
        beside = [folder / n for n in (RIG, "effects.toml")] if folder else []
        written = {p.name: p.read_text(encoding="utf-8") for p in beside if p.exists()}
        return {"plant": entries(self.task.plant), "rig": written, "sensors": [*self.sensors],
                "outputs": [*self.task.targets], "seconds": self.seconds}  # fmt: skip

    def on_record(self, name: str) -> tuple[float, float]:
        """The range of a channel over what is learnt from."""
        values = [r[name] for r in self.recordings.values()]
        return float(min(v.min() for v in values)), float(max(v.max() for v in values))

    def shown(self, output: str, value: float | None) -> str:
        """An error of an output with its unit."""
        if value is None or not math.isfinite(value):
            return "without bound"
        factor, unit = display(self.task.plant.unit(output), value)
        return f"{number(factor * value)} {unit}".strip()

    def errs(self, errors: Mapping[str, Mapping[str, float | None]]) -> str:
        """Recording -> output -> its error, in words."""
        found = [f"{t} errs by {self.shown(t, e)} on {n}" for n, by in errors.items() for t, e in by.items()]
        return "; ".join(found)


def _of_rig(where: Path, tests: Mapping[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """The recordings of a rig's folder. Raises InputError for a plant's file, which has none."""
    rig, _ = read(where, {})
    if not isinstance(rig, Rig):
        raise InputError(f"{where}: no recordings; give FILE.csv after it")
    files = {run_name(file): str(rig.folder / file) for file in rig.identify}
    held = {run_name(file): str(rig.folder / file) for file in rig.holdout if (rig.folder / file).exists()}
    return files, dict(tests) or held


def _digests(recordings: Mapping[str, Recording]) -> dict[str, str]:
    """Of what each recording holds."""
    found = {}
    for name, recording in recordings.items():
        digest = hashlib.sha256(repr((recording.dt, *recording.units.items())).encode())
        for values in recording.channels.values():
            digest.update(values.tobytes())
        found[name] = digest.hexdigest()
    return found


def make(
    asked: Asked, out: Path, progress: Progress = silent, finished: Callable[[Done], None] = lambda done: None
) -> list[Done]:
    """Do every step of which something has changed, and write the page. finished: is told of each step.

    Raises InputError as the steps do, and for a folder that holds other files; `Unmet` where no design will do. What
    was done until then stays, and the page tells of it.
    """
    given: dict[str, dict] = {
        "look": {"learnt": _digests(asked.recordings), "held": _digests(asked.held)},
        "diagnose": asked.facts,
        "compile": {"device": asked.request.device, "error": asked.error},
    }
    if asked.track:
        reference = hashlib.sha256(contents(asked.track.reference)).hexdigest()
        limits, rates = (dict(sorted(each.items())) for each in (asked.track.limits, asked.track.rates))
        given[CONTROL] = {"reference": reference, "limits": limits, "rates": rates}
    steps = Steps(out, KIND, STEPS, [PAGE], progress)
    with making(out):
        try:
            for name, (_, work) in STEPS.items():
                if name == CONTROL and not asked.track:
                    continue
                later = f"{BUILD}/({LATER})" if name == "compile" else NOTHING
                finished(steps.do(name, partial(work, asked, out), given.get(name, {}), later))
        finally:
            if steps.done:
                _tell(asked, steps.done, out / PAGE)
    return steps.done


def _tell(asked: Asked, done: Sequence[Done], path: Path) -> None:
    rows = [{**vars(d), "title": STEPS[d.name][0], "picture": _drawn(d.folder)} for d in done]
    page = story.page(f"greygate make: {asked.task.plant.name}", rows)
    with replacing(path) as new:
        new.write_text(page, encoding="utf-8", newline="\n")


def _draw(folder: Path, picture: Markup, name: str = PICTURE) -> None:
    (folder / name).write_text(picture, encoding="utf-8", newline="\n")


def _drawn(folder: Path, name: str = PICTURE) -> Markup:
    return Markup((folder / name).read_text(encoding="utf-8"))


# ---- the steps: each fills its folder `new`; `out` has those of the steps before


def _look(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    for name, recording in {**asked.recordings, **asked.held}.items():
        recording.write_csv(new / f"{name}.csv")
    _draw(new, story.recorded(next(iter(asked.recordings.values()))))
    lengths = [f"{n} {r.samples * r.dt:.4g} s" for n, r in asked.recordings.items()]
    judged = [f"{n} {r.samples * r.dt:.4g} s" for n, r in asked.held.items()]
    held = ", ".join(judged) if judged else f"the last {TESTED:.0%}"
    step = f"{asked.task.step:.4g} s"
    return Told(f"{', '.join(lengths)}, every {step}; held out: {held}", f"{next(iter(asked.recordings))}.csv")


def _diagnose(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    limit = Budget(asked.seconds / 2, DIAGNOSING)
    result, found = ask(asked.task, asked.heads, limit, progress, [*asked.held.values()])
    (new / DIAGNOSIS).write_text(json_text(plain(found)), encoding="utf-8", newline="\n")
    seen, fitted = story.diagnosed(result)
    _draw(new, seen)
    _draw(new, fitted, FITTED)
    named = ", ".join(e["id"] for e in found["effects"] if e["id"] != "unknown")
    return Told(found["verdict"].replace("_", " ") + (f": {named}" if named else ""), DIAGNOSIS)


def _correct(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    diagnosis = read_diagnosis(out / "diagnose" / DIAGNOSIS)
    found = correct(asked.task, asked.heads, diagnosis)
    remarks = [f"{where}: {what}, {why}" for where, what, why in found.said]
    plant, absent = _whole(found)
    remarks += [f"not in this file: what the diagnosis says of {absent}, which no term can say"] if absent else []
    name = f"{asked.task.plant.name}.toml"
    (new / name).write_text(text(plant, "\n".join(remarks)), encoding="utf-8", newline="\n")
    _draw(new, _drawn(out / "diagnose", FITTED))
    fit = diagnosis["fit"]["holdout" if asked.held else "identify"]
    before, after = ({t: asked.shown(t, e[who]) for t, e in fit.items()} for who in ("simulation", "corrected"))
    said = "; ".join(f"{t} errs by {before[t]} with the data sheet, {after[t]} corrected" for t in fit)
    return Told(f"{said}; not in the file: {absent}" if absent else said, name)


def _whole(found: Corrected) -> tuple[Plant, str]:
    """The corrected plant, with the laws by which inputs act; the inputs, sensors and effects that it leaves out."""
    laws = {name: [(kind, [repr(v) for v in given]) for kind, given in each] for name, each in found.filters.items()}
    plant, left = acting(found.plant, laws)
    return plant, ", ".join(dict.fromkeys([*left, *found.readings, *found.left]))


def _files(asked: Asked, out: Path) -> tuple[dict[str, str], dict[str, str]]:
    """The recordings to learn from and those that judge, as the first step wrote them."""
    learnt, held = ({n: str(out / "look" / f"{n}.csv") for n in each} for each in (asked.recordings, asked.held))
    return learnt, held


def _network(asked: Asked, out: Path) -> Path:
    return out / "build-snn" / f"{asked.task.plant.name}.toml"


def _build(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    found = build_files(
        asked.where, *_files(asked, out), asked.sensors, asked.task.targets, asked.seconds / 2, new, progress,
        out / "diagnose" / DIAGNOSIS,
    )  # fmt: skip
    units = {t: asked.task.plant.unit(t) for t in asked.task.targets}
    _draw(new, story.built(found["rms"], units, found["decisions"]))
    rms: Errors = found["rms"]["network"]
    ends = {n: rms[n] for n in rms if n in asked.held or not (asked.held or n in asked.recordings)}
    return Told(f"{asked.errs(ends)}; {found['neurons']} neurons", _network(asked, out).name, found["better"])


def _validate(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    learnt, held = _files(asked, out)
    settle = asked.task.rig.settle if asked.task.rig else 0
    settle = settle if held else min(parts_of(asked.recordings, False)[0].values())
    judged = judge(Source(str(_network(asked, out)), {**learnt, **held}, settle, len(learnt)), progress=progress)
    _draw(new, story.validated(judged, asked.judges))
    (new / FIGURES).write_text(
        schemas.text("validate", judged.figures() | {"advice": advice(judged)}), encoding="utf-8", newline="\n"
    )
    fresh = [v for v in judged.validations if v.record in asked.judges]
    fits = [f"{v.output} on {v.record}: fit {v.fit:.4g} %, {long_run(v)} over ten times the record" for v in fresh]
    return Told("; ".join(fits), FIGURES, judged.bounded)


def _compile(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    learnt, held = _files(asked, out)
    source = Source(str(_network(asked, out)), {**learnt, **held}, learnt=len(learnt))
    explorer = Explorer(asked.request, progress=progress, training=source.training)
    compile_project(source, new / BUILD, explorer=explorer, progress=progress)
    _draw(new, story.compiled(explorer.facts))
    return Told(f"{told(explorer.point, asked.request)} on {asked.request.device}", f"{BUILD}/rtl")


def _verify(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    progress("simulating")
    project = Project.open(out / "compile" / BUILD)
    verdicts = [v for found in verify_project(project).values() for v in found.verdicts]
    study = study_of(project, (), progress)
    (new / REPORT).write_text(json_text([study]), encoding="utf-8", newline="\n")
    _draw(new, story.verified(study, asked.judges))
    if wrong := next((v for v in verdicts if v.mismatch), None):
        return Told(f"{wrong.architecture} on {wrong.scenario} differs: {wrong.mismatch}", REPORT, False)
    outputs = {n: study["scenarios"][n]["outputs"] for n in asked.judges}
    fixed = {n: {t: o["rmse"]["fixed"] for t, o in by.items()} for n, by in outputs.items()}
    return Told(f"0 bits differ in {sum(v.steps for v in verdicts)} steps; {asked.errs(fixed)}", REPORT)


def machine(asked: Asked, plant: Plant, where: Path, noise: Mapping[str, float] = MappingProxyType({})) -> Machine:
    """A plant that is to track the reference, of the file `where`. noise: of its outputs, RMS.

    Raises InputError as `machines.asked.asked`, and where the network reads what the plant does not compute.
    """
    assert asked.track, "nobody asks for a machine without a reference"
    if asked.sensors:
        why = f"{', '.join(asked.sensors)} drives the corrected plant as it was measured"
        raise InputError(f"--control: {why}, and nothing says what it would be; leave --sensor out")
    free = {*asked.task.inputs} - {*columns_of(asked.track.reference)} - {*asked.track.limits}
    ranges = {n: asked.on_record(n) for n in asked.task.inputs if n in free}
    if still := [n for n, (low, high) in ranges.items() if low == high]:
        why = f"{still[0]} does not move on record; give --limits {still[0]}=LOW:HIGH, or a column of REFERENCE.csv"
        raise InputError(f"--control: {why}")
    for name, (low, high) in asked.track.limits.items():
        least, most = asked.on_record(name) if name in asked.task.inputs else (low, high)
        if high - low > UNHEARD * (most - least) > 0:
            unit = asked.task.plant.unit(name)
            seen = f"on record {name} goes from {least:g} to {most:g} {unit}"
            once(f"--limits {name}={low:g}:{high:g} is in {unit}; {seen}")
    wishes = Wishes(ranges | dict(asked.track.limits), asked.track.rates)
    return tracking(where, plant, noise, asked.track.reference, wishes)


def _noise(asked: Asked, fit: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Of each channel of a fit, RMS: what its rig tells, else how rough it is, but no more than the fit leaves.

    What a free run leaves drifts, too.
    """
    channels = asked.task.rig.channels if asked.task.rig else {}
    sizes = rough(next(iter(asked.recordings.values())), [*fit])
    sizes = {channel: min(size, fit[channel]["corrected"] or size) for channel, size in sizes.items()}
    return sizes | {n: channels[n].noise for n in sizes if n in channels and channels[n].noise}


def _control(asked: Asked, out: Path, new: Path, progress: Progress) -> Told:
    plant, diagnosis = out / "correct" / f"{asked.task.plant.name}.toml", read_diagnosis(out / "diagnose" / DIAGNOSIS)
    found = correct(asked.task, asked.heads, diagnosis)
    still = [n for n, filters in found.filters.items() if any(kind == "dead_zone" for kind, _ in filters)]
    moving, absent = _whole(replace(found, filters={n: f for n, f in found.filters.items() if n not in still}))
    absent = ", ".join([*(f"the dead zone of {n}" for n in still), *([absent] if absent else [])])
    chosen = machine(asked, moving, plant, _noise(asked, diagnosis["fit"]["identify"]))
    done = table(chosen, Method.NETWORK, Place.RTL, progress)
    for cases in done.found["rows"].values():
        for run in cases.values():
            run.pop("microseconds", None)  # they are others in each run
    written(chosen, done, new)
    (new / TABLE).write_text(schemas.text("control-own", plain(done.found)), encoding="utf-8", newline="\n")
    _draw(new, story.controlled(done.found, driven(chosen, done.last[Case.NOMINAL])))
    rows = done.found["rows"]
    imitating = done.found["network"]
    errors = {name: {t: e["rms"] for t, e in rows[name][Case.NOMINAL]["errors"].items()} for name in rows}
    said = [f"{t} errs by {asked.shown(t, errors[HARDWARE][t])} under a network in Verilog, "
            f"{asked.shown(t, errors['predictive'][t])} under predictive control, {asked.shown(t, errors['PI'][t])} "
            "under PI" for t in done.found["units"]]  # fmt: skip
    said += [f"controlled without {absent}"] if absent else []
    said += [] if imitating["matches"] else [imitating["said"]]
    bits = imitating["differing_bits"]
    return Told(f"{'; '.join(said)}; {bits} bits differ", TABLE, imitating["matches"] and not bits)


STEPS: dict[str, tuple[str, Callable[[Asked, Path, Path, Progress], Told]]] = {  # name -> its heading, its work
    "look": ("What was recorded", _look),
    "diagnose": ("What the plant leaves out", _diagnose),
    "correct": ("The plant as the recordings correct it", _correct),
    "build-snn": ("The network that stands for it", _build),
    "validate": ("How it predicts what it has not seen", _validate),
    "compile": ("The design on the FPGA", _compile),
    "verify": ("The Verilog, bit for bit", _verify),
    CONTROL: ("The corrected plant under control", _control),
}
