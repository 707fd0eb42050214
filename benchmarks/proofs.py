"""The proofs of whole networks, with seconds and counts: greygate.hardware.proofs on the architectures of a build.

    python benchmarks/proofs.py [BUILD ...] [--only NAME ...] [--architecture NAME ...] [--target NAME ...]

Without a build it compiles the flow network, in both architectures, and the pruned valve cylinder, which is recurrent,
as the folded one. Writes results/proofs.json after each proof and prints its lines.
"""

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from flow import flow
from made import stamp

from greygate.hardware.build import Project
from greygate.hardware.proofs.build import PROOFS, prove
from greygate.hardware.proofs.proof import Proof
from greygate.machines.source import Source
from greygate.plants.recording import Recording
from greygate.project import compile_project

RESULTS = Path(__file__).parent / "results" / "proofs.json"
TARGETS = ["ice40", "ecp5", "xc7a35t"]  # a family each; the first three of which every cell has a model
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


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("build", nargs="*", type=Path)
    options.add_argument("--only", action="append", default=[], choices=[*PROOFS])
    options.add_argument("--architecture", action="append", default=[])
    options.add_argument("--target", action="append", default=[])
    options.add_argument("--limit", type=float, default=300.0, help="seconds of processor time for each tool")
    given = options.parse_args()
    kept = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    start = time.monotonic()

    def told(line: str) -> None:
        print(f"{time.monotonic() - start:6.0f} s  {line}", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        builds = {build.name: build for build in given.build}
        if not builds:
            (folder / "flow").mkdir()
            builds = {"flow": flow_build(folder / "flow"), RECURRENT: recurrent_build(folder / RECURRENT)}
        for title, build in builds.items():
            project = Project.open(build)
            for name in given.only or PROOFS:
                for target in (given.target or TARGETS) if name == "netlist" else TARGETS[:1]:
                    for proof in prove(project, [name], target, given.architecture, limit=given.limit, progress=told):
                        print(f"{title}: {proof.line()}", flush=True)
                        kept.setdefault(title, {})[proof.what] = facts(proof)
                    RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
                    stamp(RESULTS)


if __name__ == "__main__":
    main()
