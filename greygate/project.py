"""Builds a compiled network as a folder, and verifies and synthesizes it (hardware/build.py says what is in it)."""

import os
import re
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import numpy as np

from greygate import children
from greygate.compiler.emit import emit, sources
from greygate.compiler.pipeline import Compiled, Pass, compile_declared, compile_network, entropy_pruning, fixed_error
from greygate.compiler.quantize import Formats
from greygate.compiler.study import Explored, size
from greygate.compiler.targets import BOTH, NAMES, Architecture, Design, target
from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import locked, replacing, replacing_all, replacing_folder, writing
from greygate.hardware.board.benches import core_bench
from greygate.hardware.build import LATER, Project, kept_file, result_files
from greygate.hardware.exploring import Explorer
from greygate.hardware.facts import FACTS
from greygate.hardware.replay import replay
from greygate.hardware.synthesis import synthesize
from greygate.hardware.verify import Verification, verify_many, with_waveform
from greygate.machines.catalog import CATALOG, entry
from greygate.machines.source import Source
from greygate.models.accuracy import float_error, rms
from greygate.models.network import Network
from greygate.models.prune import Round, retrained
from greygate.models.saliency import METHODS, saliency_pruning
from greygate.models.training.record import Record
from greygate.plain import Count, Json, json_text, plain
from greygate.progress import Progress, silent, titled

RETRAIN_EPOCHS = 4
COUNTED_STEPS = 4  # of a simulation that only counts the clocks between them


class Facts(TypedDict):
    """What a build was compiled from, and how."""

    source: str
    recordings: dict[str, str]
    title: str
    architectures: Annotated[list[str], Json(minItems=1, uniqueItems=True)]
    design: Design
    finer: Count
    passes: list[Pass]
    pruning: list[dict[str, Any]]
    explored: NotRequired[Explored]
    learnt: NotRequired[Annotated[Count, "How many recordings set the ranges, the first; one where it is absent."]]


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
        records = source.records(answering=True)
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
            point = explorer.point
            formats, architectures, design = point.candidate.formats, (point.architecture,), point.design
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
        **({"learnt": len(source.training)} if source.recordings else {}),
        "title": source.title,
        "architectures": list(architectures),
        "design": design,
        "finer": formats.finer,
        "passes": list(compiled.passes),
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
    (folder / "bench" / f"{program.name}__bench.v").write_text(text, encoding="utf-8", newline="\n")
    (folder / listing).write_text(words, encoding="utf-8", newline="\n")


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
    with replacing_all(result_files(project.folder)) as (found, *junits):
        found.write_text(json_text(hardware), encoding="utf-8", newline="\n")
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
    has the result {"stopped_after_s": limit}. With a clock rate come the clocks and the microseconds of a step; always,
    what the figures are bought with: bits of the widest input or output, and weights that are not zero.
    keep: store them in the package too; this raises InputError for a program that is not of the catalogue.

    >>> sorted(synthesize(project, "ice40"))
    ['folded, ice40', 'parallel, ice40']
    """
    name = project.source.name
    if keep and (name not in CATALOG or project.source.recordings):
        raise InputError(f"{project.folder}: only resources of a network of the catalogue are kept, not of {name}")
    found, program = project.resources or {}, project.program
    edges = max(p.signal.fix.width for p in (*program.inputs, *program.outputs))
    terms = {"edge_bits": edges, "weights": size(program)["multiplications"]}
    with writing(project.folder), locked(project.folder.resolve()):
        if edited := project.edited():
            raise InputError(f"{edited[0]}: is not the Verilog of program.json; compile again")
        for architecture in reversed(project.designs):
            folder, told = project.folder / "rtl" / architecture, titled(progress, architecture)
            counts = synthesize(folder, program.name, target, clock_rate, limit, mhz, told)
            if mhz_reached := counts.get("clock_mhz"):
                clocks = clocks_per_step(project, architecture, told)
                counts |= {"clocks": clocks, "us_per_step": clocks / mhz_reached}
            found[f"{architecture}, {target}"] = counts | (terms if "luts" in counts else {})
        _write_json(project.folder / "resources.json", found)
    if keep:
        _write_json(kept_file(name), {"size": size(program), "resources": found})
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
        temporary.write_text(json_text(plain(value)), encoding="utf-8", newline="\n")
