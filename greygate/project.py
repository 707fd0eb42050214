"""A compiled network as a folder: what `greygate compile` writes and `verify`, `emulate` and `report` read.

program.json           the integer program (docs/integer-program.md)
network.toml, .safetensors   the generic float network it was quantized from
compile.json           where it came from, the passes, the architecture
manifest.json          SHA-256 of each file above and below; what it does not list is not replaced
rtl/parallel, rtl/folded     the Verilog of each architecture, and <program>.f, its list of files
verify.json            what the last verification found; results-*.xml beside it are JUnit
resources.json         what synthesis found, by architecture and target
simulation/            where the last verification built and ran
"""

import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from greygate.build import ARCHITECTURES, FACTS, read_facts, read_hardware, read_resources
from greygate.compiler.emit import emit, emitted
from greygate.compiler.pipeline import (
    Compiled,
    Pass,
    compile_network,
    entropy_pruning,
    fixed_error,
    float_error,
)
from greygate.compiler.prune import Round, retrained
from greygate.compiler.quantize import Formats
from greygate.compiler.ranges import ranges
from greygate.compiler.saliency import METHODS, Step, saliency_pruning
from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import (
    changed,
    linked,
    locked,
    making,
    manifest,
    replacing,
    replacing_all,
    replacing_folder,
    settle,
    settle_folder,
    writing,
)
from greygate.hardware.synthesis import synthesize
from greygate.hardware.verify import Case, Scenario, Verification, verify_many
from greygate.machines.catalog import CATALOG, REPORTED, entry
from greygate.machines.identification import TRAINED, initialised
from greygate.machines.procedure import rms
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Outcome, narx_noe, train
from greygate.models.training.problem import Record, held_out
from greygate.pages.report import plain, size
from greygate.plants.recording import read_csv
from greygate.reading import read_json

LATER = (  # what verify and synthesize add to a build, in which nobody else writes
    r"verify\.json|resources\.json|results-(parallel|folded)\.xml|"
    r"simulation/(parallel|folded)/(results\.xml|sim\.log|dump\.vcd|"
    r"build/(bench(\.v)?|job\.(json|npz)|verdicts\.json|(verilator|make)\.log|(Vtop|verilat)\w*(\.\w+)+))"
)
RETRAIN_EPOCHS = 4
SAME_TIME = 1e-3  # by which sample times may differ, relatively: printed times are rounded


def read_record(network: Network, path: Path | str, targets: bool = True) -> Record:
    """A recording as the network's ports name it: columns `port_unit`, time in `t_s`.

    Raises InputError for a missing column or unit, NaN, non-uniform time, an empty file.
    """
    return _read(network, path, targets)[0]


def read_records(network: Network, paths: Mapping[str, Path | str]) -> dict[str, Record]:
    """Recordings by scenario, as `read_record`. Raises InputError if their sample times differ."""
    found = {scenario: _read(network, path) for scenario, path in paths.items()}
    times = {path: dt for path, (_, dt) in zip(paths.values(), found.values(), strict=True)}
    for path, dt in times.items():
        first, expected = next(iter(times.items()))
        if abs(dt - expected) > SAME_TIME * expected:
            raise InputError(f"{path}: sampled every {dt:g} s, {first} every {expected:g} s; resample one of them")
    return {scenario: record for scenario, (record, _) in found.items()}


def _read(network: Network, path: Path | str, targets: bool = True) -> tuple[Record, float]:
    """The record and its sample time in s."""
    for port in network.inputs + network.outputs:
        if port.size > 1:
            raise InputError(f"port {port.name} has {port.size} elements, a CSV column holds one; use scalar ports")
    wanted = network.inputs + (network.outputs if targets else [])
    recording = read_csv(path, {p.name: p.unit for p in wanted})

    def channels(ports: list[Port]) -> dict[str, np.ndarray]:
        return {p.name: recording[p.name] for p in ports}

    return Record(channels(network.inputs), channels(network.outputs) if targets else {}), recording.dt


@dataclass(frozen=True)
class Source:
    """Where a network and its records come from: a name of the catalogue, or a file with recordings beside it."""

    name: str
    recordings: Mapping[str, str]  # scenario -> CSV; empty for the catalogue's own
    settle: int = 0  # first samples of each recording that only tell the state it starts from

    def network(self) -> Network:
        if self.name in CATALOG:
            return entry(self.name).network()
        path = Path(self.name)
        if self.name.endswith((".toml", ".safetensors")) or (path.name and path.with_suffix(".toml").exists()):
            return Network.load(self.name)
        entry(self.name)  # names those there are

    def records(self) -> dict[str, Record]:
        if not self.recordings:
            if self.name not in CATALOG:
                raise InputError(f"{self.name}: give recordings of it, --record FILE.csv")
            return dict(entry(self.name).records())
        records = read_records(self.network(), self.recordings)
        return {scenario: replace(record, skip=self.settle) for scenario, record in records.items()}

    @property
    def title(self) -> str:
        return entry(self.name).title if self.name in CATALOG else Path(self.name).stem

    @property
    def period(self) -> float:
        if self.name in CATALOG:
            return entry(self.name).period
        return read_csv(next(iter(self.recordings.values()))).dt if self.recordings else 1e-3

    @property
    def training(self) -> tuple[str, ...]:
        """Scenarios that set ranges and formats: the catalogue's training runs, or the first recording given."""
        return entry(self.name).training if not self.recordings else tuple(self.recordings)[:1]

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Scenarios that hardware is verified on."""
        if self.name in CATALOG and not self.recordings:
            return entry(self.name).scenarios
        return tuple(self.recordings)

    def formats(self, width: int = 16, finer: int | None = None) -> Formats:
        """Formats of that word; finer: as in `Formats`, what the catalogue says of the network if not given."""
        own = entry(self.name).finer if self.name in CATALOG else 0
        return Formats(width, own if finer is None else finer)

    @property
    def references(self) -> Mapping[str, Mapping]:
        return entry(self.name).references if self.name in CATALOG else {}


def train_source(
    source: Source,
    folder: Path,
    held: Mapping[str, str],
    *,
    narx: bool = True,
    progress: Callable[[int, str], None] | None = None,
    **options,
) -> dict:
    """Train the network on its recordings and write it, with the figures returned, into the folder.

    held: scenario -> CSV that only chooses the epoch. narx: learn one step ahead first. options: of `train`. If the
    source settles, the state before each recording is estimated, in training and for the figures.
    Raises InputError as `train`, before anything is written.
    """
    if both := set(source.recordings) & set(held):
        raise InputError(f"{min(both)} is given to learn from and to judge on; name one otherwise")
    paths = {name: Path(path).resolve() for name, path in (source.recordings | held).items()}
    if len(set(paths.values())) < len(paths):
        raise InputError("one file is given twice, under two names; give another to judge on")
    network, found = source.network(), replace(source, recordings=source.recordings | held).records()
    records, others = ({name: found[name] for name in names} for names in (source.recordings, held))
    follow = progress and (lambda epoch, loss: progress(epoch, f"loss {loss:.3g}"))
    learn = narx_noe if narx and not options.get("shooting") else train
    checkpoint = folder / f"{network.name}.checkpoint"
    with making(folder), writing(folder):
        fit = learn(
            network,
            list(records.values()),
            held=list(others.values()),
            checkpoint=checkpoint,
            keep=True,
            progress=follow,
            estimate_initial=source.settle > 0,
            **options,
        )
    trained = network.with_parameters(fit.network.parameters())  # as it was declared, meanings and modules kept
    _, ends = held_out(network, list(records.values()), options.get("tail", 0.0), ())
    judged = {name: initialised(trained, record) for name, record in found.items()}
    judged |= {f"{name} tail": replace(judged[name], skip=end.skip) for name, end in zip(records, ends, strict=False)}
    figures = {
        "outcome": fit.outcome.name.lower(),
        "sentence": fit.outcome.value,
        "epochs": len(fit.history) - 1,
        "loss": fit.history[-1],
        "seconds": round(fit.seconds, 2),
        "rmse": {name: rms(trained, record) for name, record in judged.items()},
        "remarks": list(fit.remarks),
        "out": str(folder / f"{network.name}.toml"),
    }
    trained.save(folder / network.name, _json(plain(figures)))
    if fit.outcome not in (Outcome.INTERRUPTED, Outcome.TIME):
        for left in ("", ".shooting"):
            Path(f"{checkpoint}{left}").unlink(missing_ok=True)
    return plain(figures)


def compile_project(
    source: Source, folder: Path | str, formats: Formats, *, progress: Callable[[str], None] | None = None, **options
) -> Compiled:
    """Compile and write the folder, whole or not at all: see `replacing_folder` for what it may replace.

    options: of `_compile`. Nobody else writes that folder meanwhile.
    """
    with replacing_folder(folder, "compile", LATER) as new:
        return _compile(source, new, formats, progress or (lambda text: None), **options)


def _compile(
    source: Source,
    new: Path,
    formats: Formats,
    say: Callable[[str], None],
    *,
    budget: float | None = None,
    prune: float | None = None,
    weights: str | None = None,
    held: Sequence[str] = (),
    generic: bool = False,
    architectures: Sequence[str] = ARCHITECTURES,
    macs: int = 4,
) -> Compiled:
    """Compile and fill the folder `new`.

    prune: factor by which entropy pruning may raise the RMS error on the training records, e.g. 1.02.
    weights: method of `compiler.saliency` that then takes out single weights, within that factor once more.
    held: scenarios that bound the error of pruning instead, other than the training ones.
    """
    if weights is not None and weights not in METHODS:
        raise InputError(f"no pruning method {weights!r}; there are {', '.join(METHODS)}")
    network, records = source.network(), source.records()
    if learnt := set(held) & set(source.training):
        raise InputError(f"{min(learnt)} sets the ranges and cannot be held out; give another recording before it")
    training, judges = ([records[n] for n in names] for names in (source.training, held))
    passes = []
    own = {"weights": METHODS[weights]} if weights else {}
    if prune is not None and not held and source.name in CATALOG and entry(source.name).prune:
        passes.append(partial(entry(source.name).prune, allowed=prune, progress=say, **own))
    else:
        if prune is not None:
            passes.append(entropy_pruning(training, partial(_retrain, training, say), prune, judges))
        if weights is not None:
            told = partial(_tell, say)
            passes.append(saliency_pruning(training, METHODS[weights], prune or 1.0, judges, progress=told))
    say("compiling")
    compiled = compile_network(
        network,
        records,
        formats,
        ranged_on=source.training,
        budget=budget,
        prune=partial(_in_turn, passes) if passes else None,
        generic=generic,
        period=source.period,
    )
    facts = {
        "source": source.name if source.name in CATALOG else str(Path(source.name).resolve()),
        "recordings": {n: str(Path(p).resolve()) for n, p in source.recordings.items()},
        "title": source.title,
        "architectures": list(architectures),
        "macs": macs,
        "finer": formats.finer,
        "passes": [asdict(p) for p in compiled.passes],
        "pruning": [asdict(r) for r in compiled.pruning],
    }
    for architecture in architectures:
        emit(compiled.program, new / "rtl" / architecture, architecture, macs)
    compiled.program.save(new / "program.json")
    compiled.network.save(new / "network")
    _write_json(new / FACTS, facts)
    return compiled


def fixed_and_float(compiled: Compiled, record: Record, before: Network | None = None) -> dict[str, dict]:
    """RMSE of the program, of the network it was quantized from, and of that before pruning, by output, in its unit."""
    errors = {"before": float_error(before, record)} if before else {}
    errors |= {"float": float_error(compiled.network, record), "fixed": fixed_error(compiled.program, record)}
    return {
        port.name: {"unit": port.unit}
        | {kind: float(np.sqrt(np.mean(e[port.name][record.skip :] ** 2))) for kind, e in errors.items()}
        for port in compiled.network.outputs
    }


def _retrain(records: list[Record], say: Callable[[str], None], network: Network) -> Network:
    say(f"retraining with {sum(layer.size for layer in network.modules.values())} neurons")
    return retrained(network, records, RETRAIN_EPOCHS)


def _tell(say: Callable[[str], None], step: Step) -> None:
    say(f"pruning weights: {step.parameters} parameters")


def _in_turn(passes: Sequence[Callable], network: Network) -> tuple[Network, list[Round]]:
    rounds: list[Round] = []
    for prune in passes:
        network, more = prune(network)
        rounds += more
    return network, rounds


@dataclass(frozen=True)
class Project:
    """A compiled folder, read back."""

    folder: Path
    source: Source
    program: Program
    network: Network
    facts: dict

    @staticmethod
    def open(folder: Path | str) -> "Project":
        """Raises InputError if the folder is not one that `compile` wrote, or other than it wrote it, but for rtl/."""
        folder = Path(folder)
        with writing(folder, "read this folder"):
            return Project._open(folder)

    @staticmethod
    def _open(folder: Path) -> "Project":
        settle_folder(folder, "compile", LATER)
        facts = read_facts(folder)
        files = manifest(folder, "compile")
        data = {name: digest for name, digest in files.items() if not name.startswith("rtl/")}
        if missing := {FACTS, "program.json", "network.toml", "network.safetensors"} - set(data):
            raise InputError(f"{folder}: its manifest does not list {min(missing)}; run greygate compile again")
        if other := [*changed(folder, data), *linked(folder)]:
            raise InputError(f"{folder / other[0]}: not as greygate compile wrote it; run greygate compile again")
        source = Source(facts["source"], facts["recordings"])
        return Project(folder, source, Program.load(folder / "program.json"), Network.load(folder / "network"), facts)

    def compiled(self, records: Mapping[str, Record]) -> Compiled:
        """As the compiler left it; ranges are taken again from the training records."""
        found = ranges(self.network, [records[n] for n in self.source.training])
        passes = tuple(Pass(**p) for p in self.facts["passes"])
        return Compiled(self.network, found, self.program, passes)

    def scenarios(self, names: tuple[str, ...] = ()) -> dict[str, Scenario]:
        """What hardware must answer, from the emulator. Raises InputError for a name that does not exist."""
        records = self.source.records()
        found = {}
        for name in names or self.source.scenarios:
            if name not in records:
                raise InputError(f"no scenario {name!r}; there are {', '.join(records)}")
            codes = self.program.encode(records[name].inputs)
            answer = run(self.program, codes)
            found[name] = Scenario(codes, answer.outputs, answer.states)
        return found

    def case(self, architecture: str, names: tuple[str, ...] = ()) -> Case:
        """One emitted design with what it must answer."""
        where = self.folder / "rtl" / architecture
        return Case(self.program, self.scenarios(names), architecture, self.facts["macs"], emitted=where)

    def edited(self) -> list[Path]:
        """Files in rtl/ that are other than the program's own Verilog: a person's code, or a stranger's."""
        found = []
        for architecture in self.facts["architectures"]:
            where = self.folder / "rtl" / architecture
            for name, text in emitted(self.program, architecture, self.facts["macs"]).items():
                path = where / name
                if not path.is_file() or path.read_bytes() != text.encode():
                    found.append(path)
        return found

    @property
    def hardware(self) -> dict | None:
        """What `verify` found, by architecture, or None."""
        settle(_results(self.folder))
        return read_hardware(self.folder)

    @property
    def resources(self) -> dict | None:
        """What `synthesize` found, by "architecture, target", here or else of a program of this size, or None."""
        if (found := read_resources(self.folder)) is not None:
            return found
        kept = _kept(self.source.name)
        if self.source.name not in CATALOG or not kept.exists():
            return None
        found = read_json(kept, "install greygate again")
        return found["resources"] if found["size"] == size(self.program) else None


def _kept(name: str) -> Path:
    """Resources that are kept in the package beside the network."""
    return TRAINED / f"{name}.resources.json"


def plants(folder: Path, progress: Callable[[str], None] | None = None) -> list[Project]:
    """The plants of the catalogue, each from folder/NAME, compiled there if it is not yet.

    Raises InputError where that folder holds something else.
    """
    found = []
    for name in REPORTED:
        if not (folder / name / FACTS).exists():
            if progress:
                progress(f"compiling {name}")
            compile_project(Source(name, {}), folder / name, Source(name, {}).formats())
        project = Project.open(folder / name)
        if project.source != Source(name, {}):
            raise InputError(f"{folder / name}: holds {project.source.name}; give a folder in which {name} is {name}")
        found.append(project)
    return found


def _results(folder: Path) -> list[Path]:
    """What `verify` writes, together."""
    return [folder / "verify.json", *(folder / f"results-{architecture}.xml" for architecture in ARCHITECTURES)]


def verify_project(
    project: Project, names: tuple[str, ...] = (), seed: int | None = None, as_is: bool = False
) -> dict[str, Verification]:
    """Each emitted design in Verilator against the emulator, by architecture, side by side on the cores there are.

    Writes verify.json and one results-ARCHITECTURE.xml (JUnit) each into the folder. as_is: even Verilog that is not
    what `emit` makes of the program; it is code, and Verilator runs it. Raises InputError for such Verilog otherwise.
    """
    with writing(project.folder), locked(project.folder.resolve()):
        if (edited := project.edited()) and not as_is:
            raise InputError(
                f"{edited[0]}: not the Verilog of program.json, and Verilog is code; compile again, or read it and give"
                " --as-is"
            )
        for path in edited:
            print(f"verify: {path} is not the Verilog of program.json; verified as it is", file=sys.stderr)
        _clear(project.folder)
        return _verify(project, names, seed)


def _clear(folder: Path) -> None:
    """Remove what an earlier verification built: make would run it, and a stranger may have put it there.

    Raises InputError for a file that no verification writes.
    """
    found = sorted(path for path in (folder / "simulation").rglob("*") if not path.is_dir() or path.is_symlink())
    for path in found:
        if not re.fullmatch(LATER, path.relative_to(folder).as_posix()):
            raise InputError(f"{path}: no file of greygate verify, and make may run it; move it elsewhere")
    if found:
        shutil.rmtree(folder / "simulation")


def _verify(project: Project, names: tuple[str, ...], seed: int | None) -> dict[str, Verification]:
    architectures = project.facts["architectures"]

    def check(architecture: str) -> Verification:
        return verify_many([project.case(architecture, names)], project.folder / "simulation" / architecture, seed)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        results = dict(zip(architectures, pool.map(check, architectures), strict=True))
    hardware = {}
    for architecture, result in results.items():
        clocks = [v.clocks_per_step for v in result.verdicts if np.isfinite(v.clocks_per_step)]
        hardware[architecture] = {
            "clocks_per_step": max(clocks, default=None),
            "seed": result.seed,
            "scenarios": {
                v.scenario: {"steps": v.steps, "differing_bits": None if v.mismatch else 0, "mismatch": v.mismatch}
                for v in result.verdicts
            },
        }
    with replacing_all(_results(project.folder)) as (found, *junits):
        found.write_text(_json(hardware))
        for architecture, path in zip(ARCHITECTURES, junits, strict=True):
            if architecture in results:
                path.write_bytes(results[architecture].junit.read_bytes())
    return results


def synthesize_project(
    project: Project, target: str, clock_rate: bool = False, limit: float | None = None, keep: bool = False
) -> dict[str, dict]:
    """Resources of each architecture by Yosys (and nextpnr); adds to resources.json.

    limit: seconds of processor time for each tool; a design that takes longer is told as {"stopped_after_s": limit}.
    keep: add them to those in the package too. Raises InputError there for a program that is not the catalogue's.
    """
    name = project.source.name
    if keep and (name not in CATALOG or project.source.recordings):
        raise InputError(f"{project.folder}: only resources of a network of the catalogue are kept, not of {name}")
    found = project.resources or {}
    with writing(project.folder), locked(project.folder.resolve()):
        if edited := project.edited():
            raise InputError(f"{edited[0]}: is not the Verilog of program.json; compile again")
        for architecture in reversed(project.facts["architectures"]):
            folder = project.folder / "rtl" / architecture
            found[f"{architecture}, {target}"] = synthesize(folder, project.program.name, target, clock_rate, limit)
        _write_json(project.folder / "resources.json", found)
    if keep:
        _write_json(_kept(name), {"size": size(project.program), "resources": found})
    return found


def study_project(project: Project, progress: Callable[[str], None] | None = None, **options) -> dict:
    """What the report says of one project: see `greygate.pages.report.study`, which takes the options."""
    from greygate.pages.report import study  # brings scipy.signal, which takes a second

    records = project.source.records()
    return study(
        project.facts["title"],
        project.compiled(records),
        records,
        ranged_on=project.source.training,
        period=project.program.period,
        called=Path(project.source.name).stem,
        references=project.source.references,
        hardware=project.hardware,
        resources=project.resources,
        progress=progress,
        **{"formats": Formats(finer=project.facts.get("finer", 0))} | options,
    )


def _json(value: object) -> str:
    return json.dumps(value, indent=1) + "\n"


def _write_json(path: Path, value: object) -> None:
    with replacing(path) as temporary:
        temporary.write_text(_json(value))
