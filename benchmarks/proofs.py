"""The proofs of whole networks, with seconds and counts: greygate.hardware.proofs on every architecture of a build.

    python benchmarks/proofs.py [BUILD ...] [--only NAME ...] [--architecture NAME ...] [--target ice40] [--limit 300]

Without a build it compiles the pruned valve cylinder. Writes results/proofs.json and prints its lines.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from greygate.hardware.proofs.build import prove
from greygate.project import Project, compile_project
from greygate.source import Source

RESULTS = Path(__file__).parent / "results" / "proofs.json"
DEFAULT, PRUNED = "valve_cylinder", 1.0


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("build", nargs="*")
    options.add_argument("--only", action="append", default=[])
    options.add_argument("--architecture", action="append", default=[])
    options.add_argument("--target", default="ice40")
    options.add_argument("--limit", type=float, default=300.0)
    given = options.parse_args()
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        builds = [Path(name) for name in given.build]
        if not builds:
            builds = [Path(folder) / DEFAULT]
            compile_project(Source(DEFAULT), builds[0], prune=PRUNED)
        for build in builds:
            project = Project.open(build)
            proofs = prove(
                project,
                given.only,
                given.target,
                given.architecture,
                limit=given.limit,
                progress=lambda line: print(line, file=sys.stderr),
            )
            kept = found.setdefault(build.name, {})
            for proof in proofs:
                print(f"{build.name}: {proof.line()}")
                facts = asdict(proof)
                facts["rows"] = len(facts["rows"])
                kept[facts.pop("what")] = facts
    RESULTS.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
