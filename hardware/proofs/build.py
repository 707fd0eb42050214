"""All proofs of a build that `greygate compile` wrote."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from greygate.compiler.emit import sources
from greygate.compiler.verilog import stream_widths
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.hardware.proofs.accumulators import accumulators
from greygate.hardware.proofs.bound import STEPS, bounded, contraction, feedback, no_drift
from greygate.hardware.proofs.elaborated import Proof, blocks, elaborate
from greygate.hardware.proofs.handshake import handshake
from greygate.hardware.proofs.mapped import netlist_equals_emulator
from greygate.hardware.proofs.primitives import primitives, unknown
from greygate.hardware.proofs.sums import sums
from greygate.hardware.proofs.tables import tables
from greygate.progress import Progress, silent, titled

# a table, every code of which is tried, or what computes nothing
ELSEWHERE = ("greygate_lookup", "greygate_product", "greygate_skid", "greygate_stream")
NOTHING = "it has nothing that this concerns"
LONGEST = 5000  # steps of a scenario that a netlist plays


def prove(
    project: Project,
    only: Sequence[str] = (),
    target: str = "ice40",
    architectures: Sequence[str] = (),
    steps: int = STEPS,
    limit: float | None = None,
    progress: Progress = silent,
) -> list[Proof]:
    """The proofs named by `only`, or all of PROOFS, in their order.

    target: family or device of the netlist. architectures: all of the build if none is named. steps: of the long run.
    limit: seconds of processor time for each tool.
    Raises InputError for a name that is not in PROOFS, Verilog that was changed, or a tool that is not installed.
    """
    for name in only:
        if name not in PROOFS:
            raise InputError(f"no proof {name!r}; there are {', '.join(PROOFS)}")
    if edited := project.edited():
        raise InputError(f"{edited[0]}: is not the Verilog of program.json; compile again")
    if other := set(architectures) - set(project.designs):
        raise InputError(f"{project.folder}: holds no {min(other)}; there are {', '.join(project.designs)}")
    designs = [name for name in project.designs if not architectures or name in architectures]
    chosen = {"target": target, "steps": steps, "limit": limit, "designs": designs}
    found: list[Proof] = []
    for name in PROOFS:
        if not only or name in only:
            proofs = list(PROOFS[name](project, chosen, progress))
            nothing = Proof(f"{name} of {' and '.join(designs)}", "reading the build", None, counterexample=NOTHING)
            found += proofs or [nothing]
    return found


def _files(project: Project, architecture: str) -> list[Path]:
    return sources(project.folder / "rtl" / architecture, project.program.name)


def _primitives(project: Project, chosen: dict, progress: Progress) -> Iterator[Proof]:
    """The building blocks of all architectures, each set of parameters once; then the tables."""
    done: set = set()
    program = project.program
    for architecture in chosen["designs"]:
        files, told = _files(project, architecture), titled(progress, architecture)
        modules = elaborate(files, program.name, progress=told)
        found = [block for block in blocks(modules) if str(block) not in done]
        done |= {str(block) for block in found}
        own = [path for path in files if path.name.startswith("greygate_")]
        for proof in (*primitives(own, found, progress=told), *unknown(found, ELSEWHERE)):
            yield _of(proof, architecture)
        for proof in (*accumulators(program, project.design, blocks(modules)), *tables(files, program, modules, told)):
            yield _of(proof, architecture)


def _sums(project: Project, chosen: dict, progress: Progress) -> Iterator[Proof]:
    for architecture in chosen["designs"]:
        for proof in sums(_files(project, architecture), project.program, titled(progress, architecture)):
            yield _of(proof, architecture)


def _handshakes(project: Project, chosen: dict, progress: Progress) -> Iterator[Proof]:
    top, widths = project.program.name, stream_widths(project.program)
    for architecture in chosen["designs"]:
        folder, told = project.folder / "rtl" / architecture, titled(progress, architecture)
        for proof in handshake(folder, top, widths, progress=told):
            yield _of(proof, architecture)


def _netlists(project: Project, chosen: dict, progress: Progress) -> Iterator[Proof]:
    scenario = next(iter(project.scenarios(project.source.scenarios[:1]).values()))
    codes, answers = scenario.inputs[:LONGEST], scenario.outputs[:LONGEST]
    for architecture in chosen["designs"]:
        files, told = _files(project, architecture), titled(progress, architecture)
        proof = netlist_equals_emulator(files, project.program, chosen["target"], codes, answers, chosen["limit"], told)
        yield _of(proof, architecture)


def _bound(project: Project, chosen: dict, progress: Progress) -> Iterator[Proof]:
    """Between the least and the greatest value of each input in all scenarios; then what holds of feedback."""
    records = project.records().values()
    ends = {
        p.name: (min(np.min(r.inputs[p.name]) for r in records), max(np.max(r.inputs[p.name]) for r in records))
        for p in project.network.inputs
    }
    yield bounded(project.program, project.network, ends, progress=titled(progress, "bound"))
    if feedback(project.program):
        yield contraction(project.program)


def _drift(project: Project, chosen: dict, progress: Progress) -> Iterator[Proof]:
    name = project.source.training[0]
    yield no_drift(project.program, project.network, project.records()[name], chosen["steps"], progress)


def _of(proof: Proof, architecture: str) -> Proof:
    """The proof as one of that architecture."""
    return replace(proof, what=f"{architecture}: {proof.what}")


PROOFS: dict[str, Callable[[Project, dict, Progress], Iterator[Proof]]] = {
    "primitives": _primitives,
    "sums": _sums,
    "handshake": _handshakes,
    "bound": _bound,
    "netlist": _netlists,
    "drift": _drift,
}
