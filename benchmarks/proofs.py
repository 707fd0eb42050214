"""The proofs of whole networks, with seconds and counts: greygate.hardware.proofs on the architectures of a build.

Without a build it compiles the flow network, in both architectures, and the pruned valve cylinder, which is recurrent,
as the folded one. Kept after each proof.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from greygate.hardware.build import Project
from greygate.hardware.proofs.build import PROOFS, prove
from greygate.hardware.proofs.elaborated import Proof
from greygate.machines.source import Source
from greygate.plants.recording import Recording
from greygate.project import compile_project

from .flow import flow
from .made import store, stored
from .shared import VERILATOR, Limit, say, scratch, stopwatch

TAKES = "a quarter of an hour"
NEEDS = VERILATOR
TARGETS = ("ice40", "ecp5", "xc7a35t")  # a family each; the first three of which every cell has a model
RECURRENT, PRUNED = "valve_cylinder", 1.0
PERIOD = 1e-3  # s, of the grid's samples; the network has no feedback, so that nothing depends on it


def flow_build(folder: Path) -> Path:
    """The build of the flow network; its recording is the grid of its inputs."""
    network, record = flow()
    network.save(folder / "flow")
    values = {**record.inputs, **record.targets}
    Recording(PERIOD, values, dict.fromkeys(values, "1")).write_csv(folder / "grid.csv")
    compile_project(Source(str(folder / "flow.toml"), {"grid": str(folder / "grid.csv")}), folder / "build")
    return folder / "build"


def recurrent_build(folder: Path) -> Path:
    """The build of the pruned valve cylinder as the folded architecture."""
    compile_project(Source(RECURRENT), folder, prune=PRUNED, architectures=("folded",))
    return folder


def facts(proof: Proof) -> dict:
    """The proof for the results, the rows counted."""
    found = asdict(proof)
    del found["what"]
    return found | {"rows": len(proof.rows)}


def main(
    *build: Path,
    only: Annotated[Sequence[str], PROOFS] = (),
    architecture: Sequence[str] = (),
    target: Sequence[str] = TARGETS,
    limit: Limit = 300.0,
) -> None:
    kept, watch = stored("proofs"), stopwatch()

    def told(line: str) -> None:
        say(f"{watch():6.0f} s  {line}")

    with scratch() as folder:
        builds = {one.name: one for one in build}
        if not builds:
            (folder / "flow").mkdir()
            builds = {"flow": flow_build(folder / "flow"), RECURRENT: recurrent_build(folder / RECURRENT)}
        for title, place in builds.items():
            project = Project.open(place)
            for name in only or PROOFS:
                for one in target if name == "netlist" else TARGETS[:1]:
                    for proof in prove(project, [name], one, list(architecture), limit=limit, progress=told):
                        print(f"{title}: {proof.line()}", flush=True)
                        kept.setdefault(title, {})[proof.what] = facts(proof)
                    store("proofs", kept)
