"""A compiled network as a folder, which `greygate compile` writes and `verify`, `emulate` and `report` read.

program.json           the integer program (docs/integer-program.md)
network.toml, .safetensors   the generic float network it was quantized from
compile.json           the source, the passes, the architectures
manifest.json          SHA-256 of each file above and below; a file that it does not list is never replaced
rtl/parallel, rtl/folded     the Verilog of each architecture, and <program>.f, its list of files
bench/                 a bench in plain Verilog for any of them, and the scenario that it plays
verify.json            results of the last verification; results-*.xml beside it are JUnit
resources.json         resources that synthesis found, by architecture and target
simulation/            results and logs of the last verification, by architecture
"""

import os
import re
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from greygate import children
from greygate.compiler.emit import emit, emitted, sources
from greygate.compiler.pipeline import Compiled, Pass, compile_declared, compile_network, entropy_pruning, fixed_error
from greygate.compiler.prune import Round, retrained
from greygate.compiler.quantize import Formats
from greygate.compiler.ranges import ranges
from greygate.compiler.saliency import METHODS, saliency_pruning
from greygate.compiler.targets import BOTH, NAMES, Architecture, Design, target
from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.exploring import Explorer
from greygate.facts import FACTS, read_facts, read_hardware, read_resources
from greygate.files import (
    changed,
    linked,
    locked,
    manifest,
    replacing,
    replacing_all,
    replacing_folder,
    settle,
    settle_folder,
    writing,
)
from greygate.hardware.board.benches import core_bench
from greygate.hardware.replay import replay
from greygate.hardware.synthesis import synthesize
from greygate.hardware.verify import Case, Scenario, Verification, verify_many
from greygate.hardware.waveform import with_waveform
from greygate.machines.catalog import CATALOG, entry
from greygate.machines.identification import TRAINED
from greygate.models.accuracy import float_error, rms
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.pages.report.study import size
from greygate.plain import json_text
from greygate.plants.readers.read import is_recording
from greygate.progress import Progress, silent, titled
from greygate.reading import read_json
from greygate.source import Source, read_record, read_records

LATER = (  # the files that verify and synthesize add to a build; nothing else writes there
    rf"verify\.json|resources\.json|results-({'|'.join(NAMES)})\.xml|"
    rf"simulation/({'|'.join(NAMES)})/(results\.xml|(sim|verilator|make)\.log|dump\.vcd|"
    r"build/(bench(\.v)?|job\.(json|npz)|verdicts\.json|(verilator|make)\.log|(Vtop|verilat)\w*(\.\w+)+))"
)
RETRAIN_EPOCHS = 4
COUNTED_STEPS = 4  # of a simulation that only counts the clocks between them


def compile_project(
    source: Source,
    folder: Path | str,
    formats: Formats | None = None,
    *,
    budget: float | None = None,
    prune: float | None = None,
    weights: str | None = None,
    held: Sequence[str] = (),
    generic: bool = False,
    architectures: Sequence[str] = BOTH,
    design: Design = Design(),
    explorer: Explorer | None = None,
    progress: Progress = silent,
) -> Compiled:
    """Compile a network and write the folder that `Project.open` reads, completely or not at all.

    The folder replaces an earlier build and nothing else. A lock keeps other processes from writing it meanwhile.

    formats: those of the source if not given. budget, generic: as for `compile`.
    prune: factor by which entropy pruning may raise the RMS error on the training records, e.g. 1.02.
    weights: method of `compiler.saliency` that then removes single weights and may raise the error by that factor
    again. held: scenarios, other than the training ones, that bound the error of pruning instead.
    architectures: of the Verilog. design: how each is built. explorer: instead of formats, a budget, architectures and
    a design, what chooses them for a device; it raises `Unmet`, before anything is written, if no design will do.
    Raises InputError as `Source`, `compile` and `emit`, and for a folder that holds other files.

    >>> compiled = build(source, "lag", Formats(18))
    >>> sorted(path.name for path in Path("lag/rtl").iterdir())
    ['folded', 'parallel']
    """
    if weights is not None and weights not in METHODS:
        raise InputError(f"no pruning method {weights!r}; there are {', '.join(METHODS)}")
    quantized = source.quantized()
    if quantized and (formats or budget or prune or weights or generic or explorer):
        raise InputError(
            f"{source.name}: its Quant nodes fix every weight and format; leave out the width, finer, budget, pruning, "
            "generic and device, or export it without them"
        )
    formats = formats or source.formats()
    with replacing_folder(folder, "compile", LATER) as new:
        records = source.records()
        if quantized:
            compiled = compile_declared(quantized, records, source.training, source.period)
        else:
            compiled = compile_network(
                source.network(),
                records,
                formats,
                ranged_on=source.training,
                budget=budget,
                prune=_pruning(source, records, prune, weights, held, progress),
                generic=generic,
                choose=partial(explorer.choose, records, source.period) if explorer else None,
                period=source.period,
            )
        facts = {}
        if explorer:
            formats, architectures, design = explorer.formats, (explorer.architecture,), explorer.design
            facts = {"explored": explorer.facts}
        _write(new, source, compiled, formats, architectures, design, facts)
        if any(isinstance(target(a), Architecture) for a in architectures):
            _write_bench(new, compiled.program, records[(source.scenarios or source.training)[0]])
    return compiled


def _pruning(
    source: Source,
    records: Mapping[str, Record],
    prune: float | None,
    weights: str | None,
    held: Sequence[str],
    progress: Progress,
) -> Callable[[Network], tuple[Network, list[Round]]] | None:
    """The pruning passes, one after the other; None if nothing is to be pruned."""
    if learnt := set(held) & set(source.training):
        raise InputError(f"{min(learnt)} sets the ranges and cannot be held out; give another recording before it")
    training, judges = ([records[n] for n in names] for names in (source.training, held))
    passes: list[Callable] = []
    stored = entry(source.name).prune if source.name in CATALOG else None
    if prune is not None and not held and stored is not None:
        own: dict = {"weights": METHODS[weights]} if weights else {}
        passes.append(partial(stored, allowed=prune, progress=progress, **own))
    else:
        if prune is not None:
            passes.append(entropy_pruning(training, partial(_retrain, training, progress), prune, judges))
        if weights is not None:
            passes.append(saliency_pruning(training, METHODS[weights], prune or 1.0, judges, progress=progress))
    progress("compiling")
    return partial(_in_turn, passes) if passes else None


def _write(
    folder: Path,
    source: Source,
    compiled: Compiled,
    formats: Formats,
    architectures: Sequence[str],
    design: Design,
    more: Mapping[str, object],
) -> None:
    """Fill the folder of a build. more: facts beside those of every build."""
    facts = {
        "source": source.name if source.name in CATALOG else str(Path(source.name).resolve()),
        "recordings": {n: str(Path(p).resolve()) for n, p in source.recordings.items()},
        "title": source.title,
        "architectures": list(architectures),
        "design": asdict(design),
        "finer": formats.finer,
        "passes": [asdict(p) for p in compiled.passes],
        "pruning": [asdict(r) for r in compiled.pruning],
        **more,
    }
    for architecture in architectures:
        emit(compiled.program, folder / "rtl" / architecture, architecture, design)
    compiled.program.save(folder / "program.json")
    replace(compiled.network, dt=compiled.program.period).save(folder / "network")
    _write_json(folder / FACTS, facts)


def _write_bench(folder: Path, program: Program, record: Record) -> None:
    """Write the bench of the cores in plain Verilog; it reads a file beside it that holds a scenario."""
    listing = "bench/scenario.hex"
    text, words = core_bench(program, program.encode(record.inputs), listing)
    (folder / "bench").mkdir()
    (folder / "bench" / f"{program.name}__bench.v").write_text(text, encoding="utf-8")
    (folder / listing).write_text(words, encoding="utf-8")


def fixed_and_float(compiled: Compiled, record: Record, before: Network | None = None) -> dict[str, dict]:
    """RMSE of the program, of the float network it was made from, and of `before` pruning, by output, in its unit."""
    errors = {"before": float_error(before, record)} if before else {}
    errors |= {"float": float_error(compiled.network, record), "fixed": fixed_error(compiled.program, record)}
    return {
        port.name: {"unit": port.unit} | {kind: rms(e[port.name], record.skip) for kind, e in errors.items()}
        for port in compiled.network.outputs
    }


def _retrain(records: list[Record], progress: Progress, network: Network) -> Network:
    progress(f"retraining with {sum(layer.size for layer in network.layers().values())} neurons")
    return retrained(network, records, RETRAIN_EPOCHS)


def _in_turn(passes: Sequence[Callable], network: Network) -> tuple[Network, list[Round]]:
    rounds: list[Round] = []
    for prune in passes:
        network, more = prune(network)
        rounds += more
    return network, rounds


@dataclass(frozen=True)
class Project:
    """A folder that `build` wrote, read back.

    folder: its path. source: what it was compiled from. program, network: the compiler's results, in integers and in
    float. facts: the content of compile.json.

    >>> project = Project.open("lag")
    >>> project.program.name, project.design.multipliers
    ('lag', 4)
    """

    folder: Path
    source: Source
    program: Program
    network: Network
    facts: dict

    @staticmethod
    def open(folder: Path | str) -> "Project":
        """Read a build. Raises InputError if `compile` did not write the folder, or a file outside rtl/ was changed."""
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
        source, program = Source(facts["source"], facts["recordings"]), Program.load(folder / "program.json")
        network = replace(Network.load(folder / "network"), dt=program.period)
        return Project(folder, source, program, network, facts)

    def records(self) -> dict[str, Record]:
        """The scenarios by name; recordings are read again. Raises InputError as `Source.records`."""
        return read_records(self.network, paths) if (paths := self.source.recordings) else self.source.records()

    def compiled(self, records: Mapping[str, Record]) -> Compiled:
        """The result of the compiler, with ranges computed again from the training records."""
        found = ranges(self.network, [records[n] for n in self.source.training])
        passes = tuple(Pass(**p) for p in self.facts["passes"])
        return Compiled(self.network, found, self.program, passes)

    def scenarios(self, names: tuple[str, ...] = ()) -> dict[str, Scenario]:
        """Inputs and the outputs and states that hardware must give, by the emulator.

        Raises InputError for a scenario that does not exist.
        """
        records = self.records()
        found = {}
        for name in names or self.source.scenarios:
            if name not in records:
                raise InputError(f"no scenario {name!r}; there are {', '.join(records)}")
            codes = self.program.encode(records[name].inputs)
            answer = run(self.program, codes)
            found[name] = Scenario(codes, answer.outputs, answer.states)
        return found

    def inputs(self, recording: str) -> tuple[Mapping[str, np.ndarray], float]:
        """The inputs of a file, or else of a scenario of that name, and the sample time in s.

        Raises InputError for a file that cannot be read, and for a name that is neither.
        """
        if Path(recording).exists() or is_recording(recording):
            record, dt = read_record(self.network, recording, targets=False)
            return record.inputs, dt
        if recording not in (records := self.records()):
            raise InputError(f"{recording}: no such file, and no scenario of this build; it has {', '.join(records)}")
        return records[recording].inputs, self.program.period

    def case(self, architecture: str, names: tuple[str, ...] = ()) -> Case:
        """One emitted design with the answers that it must give."""
        where = self.folder / "rtl" / architecture
        return Case(self.program, self.scenarios(names), architecture, self.design, emitted=where)

    @property
    def design(self) -> Design:
        """How the Verilog was built."""
        return Design(**self.facts["design"])

    @property
    def designs(self) -> list[str]:
        """The architectures in Verilog. Raises InputError if there is none."""
        found = [a for a in self.facts["architectures"] if isinstance(target(a), Architecture)]
        if not found:
            raise InputError(f"{self.folder}: holds no Verilog; run greygate compile --architecture both")
        return found

    def edited(self) -> list[Path]:
        """Files in rtl/ that differ from the Verilog of the program: code of the user, or of a stranger."""
        found = []
        for architecture in self.facts["architectures"]:
            where = self.folder / "rtl" / architecture
            for name, text in emitted(self.program, architecture, self.design).items():
                path = where / name
                if not path.is_file() or path.read_bytes() != text.encode():
                    found.append(path)
        return found

    @property
    def hardware(self) -> dict | None:
        """The results of `verify` by architecture, or None."""
        settle(_results(self.folder))
        return read_hardware(self.folder)

    @property
    def resources(self) -> dict | None:
        """The results of `synthesize` by "architecture, target", or None.

        If the build has none, those that the package keeps for this network, if its program has the same size.
        """
        if (found := read_resources(self.folder)) is not None:
            return found
        kept = _kept(self.source.name)
        if self.source.name not in CATALOG or not kept.exists():
            return None
        found = read_json(kept, "install greygate again")
        return found["resources"] if found["size"] == size(self.program) else None


def _kept(name: str) -> Path:
    """The file in the package that keeps a network's resources."""
    return TRAINED / f"{name}.resources.json"


def _results(folder: Path) -> list[Path]:
    """The files that `verify` writes together."""
    return [folder / "verify.json", *(folder / f"results-{architecture}.xml" for architecture in NAMES)]


def verify_project(
    project: Project, names: tuple[str, ...] = (), seed: int | None = None, as_is: bool = False
) -> dict[str, Verification]:
    """Compare each emitted design in Verilator with the emulator; the architectures run in parallel.

    Writes verify.json and a results-ARCHITECTURE.xml (JUnit) for each architecture into the folder, and a waveform of
    the first step that differs. as_is: also verify Verilog that differs from what `emit` makes of the program. It is
    code, and Verilator runs it; without `as_is` it raises InputError.

    >>> found = verify(project, seed=1)
    >>> {architecture: one.passed for architecture, one in found.items()}
    {'parallel': True, 'folded': True}
    """
    with writing(project.folder), locked(project.folder.resolve()):
        if (edited := project.edited()) and not as_is:
            raise InputError(
                f"{edited[0]}: is not the Verilog of program.json, and Verilog is code; compile again, or read it and "
                "give --as-is"
            )
        for path in edited:
            print(f"verify: {path} is not the Verilog of program.json; verified as it is", file=sys.stderr)
        _clear(project.folder)
        return _verify(project, names, seed)


def _clear(folder: Path) -> None:
    """Remove the build of an earlier verification, because make would run it and a stranger may have put it there.

    Raises InputError for a file that `verify` does not write.
    """
    found = sorted(path for path in (folder / "simulation").rglob("*") if not path.is_dir() or path.is_symlink())
    for path in found:
        if not re.fullmatch(LATER, path.relative_to(folder).as_posix()):
            raise InputError(f"{path}: greygate verify did not write this file, and make may run it; move it elsewhere")
    if found:
        shutil.rmtree(folder / "simulation")


def _verify(project: Project, names: tuple[str, ...], seed: int | None) -> dict[str, Verification]:
    architectures = project.designs

    def check(architecture: str) -> Verification:
        case, folder = project.case(architecture, names), project.folder / "simulation" / architecture
        return with_waveform(case, verify_many([case], folder, seed), folder)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        futures = [pool.submit(check, architecture) for architecture in architectures]
        try:
            results = {a: future.result() for a, future in zip(architectures, futures, strict=True)}
        except BaseException:  # Ctrl-C and `kill` do not reach Verilator, for which the pool waits
            while wait(futures, 0.1).not_done:
                children.stop()
            raise
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
        found.write_text(json_text(hardware), encoding="utf-8")
        for architecture, path in zip(NAMES, junits, strict=True):
            if architecture in results:
                path.write_bytes(results[architecture].junit.read_bytes())
    return results


def synthesize_project(
    project: Project,
    target: str,
    clock_rate: bool = False,
    limit: float | None = None,
    keep: bool = False,
    mhz: float | None = None,
    progress: Progress = silent,
) -> dict[str, dict]:
    """Find the resources of each architecture by Yosys (and nextpnr), and add them to resources.json.

    clock_rate, mhz, limit: as for `greygate.hardware.synthesis.synthesize`; a design that takes longer than the limit
    has the result {"stopped_after_s": limit}. With a clock rate come the clocks and the microseconds of a step.
    keep: store them in the package too; this raises InputError for a program that is not of the catalogue.

    >>> sorted(synthesize(project, "ice40"))
    ['folded, ice40', 'parallel, ice40']
    """
    name = project.source.name
    if keep and (name not in CATALOG or project.source.recordings):
        raise InputError(f"{project.folder}: only resources of a network of the catalogue are kept, not of {name}")
    found = project.resources or {}
    with writing(project.folder), locked(project.folder.resolve()):
        if edited := project.edited():
            raise InputError(f"{edited[0]}: is not the Verilog of program.json; compile again")
        for architecture in reversed(project.designs):
            folder, told = project.folder / "rtl" / architecture, titled(progress, architecture)
            counts = synthesize(folder, project.program.name, target, clock_rate, limit, mhz, told)
            if mhz_reached := counts.get("clock_mhz"):
                clocks = clocks_per_step(project, architecture, told)
                counts |= {"clocks": clocks, "us_per_step": clocks / mhz_reached}
            found[f"{architecture}, {target}"] = counts
        _write_json(project.folder / "resources.json", found)
    if keep:
        _write_json(_kept(name), {"size": size(project.program), "resources": found})
    return found


def clocks_per_step(project: Project, architecture: str, progress: Progress = silent) -> float:
    """Clocks that a step takes: as the last verification counted them, the target says, or a simulation counts."""
    verified = (project.hardware or {}).get(architecture, {}).get("clocks_per_step")
    if verified is not None:
        return verified
    found = target(architecture)
    counted = found.clocks if isinstance(found, Architecture) else None
    if counted is not None:
        return float(counted(project.program, project.design))
    steps = np.zeros((COUNTED_STEPS, sum(p.signal.size for p in project.program.inputs)), np.int64)
    files = sources(project.folder / "rtl" / architecture, project.program.name)
    return replay(files, project.program, steps, run(project.program, steps).outputs, progress=progress).clocks


def _write_json(path: Path, value: object) -> None:
    with replacing(path) as temporary:
        temporary.write_text(json_text(value), encoding="utf-8")
