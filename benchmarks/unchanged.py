"""Did a change of the house change a result? SHA-256 of every build of the catalogue, stored network and diagnosis.

    python -m benchmarks unchanged BEFORE.json            # on the commit before: writes
    python -m benchmarks unchanged BEFORE.json --check    # on the one after: names what differs, exit 1

A build is every file that `greygate compile NAME` writes; a diagnosis is what `greygate diagnose RIG --json` prints,
without its seconds. The rigs are those of ../shared/rigs, where that folder is.
"""

import hashlib
import json
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

from greygate.machines.catalog import CATALOG

from .made import ROOT
from .shared import GREYGATE, Jobs, scratch

TAKES = "five minutes"
THREADS = "all"  # as a user runs it: the last bits of a diagnosis depend on them
RIGS = ROOT.parent / "shared" / "rigs"
SECONDS = re.compile(rb'"seconds": [^,\n}]+')


def digest(files: list[tuple[str, bytes]]) -> str:
    told = hashlib.sha256()
    for name, content in sorted(files):
        told.update(name.encode() + b"\0" + content + b"\0")
    return told.hexdigest()


def build(name: str) -> str:
    """Of every file of a build, or of the refusal."""
    with scratch() as folder:
        done = subprocess.run([GREYGATE, "compile", name, "--out", "built"], cwd=folder, capture_output=True)
        found = [(p.relative_to(folder).as_posix(), p.read_bytes()) for p in folder.rglob("*") if p.is_file()]
    return digest(found) if done.returncode == 0 else f"exit code {done.returncode}: {done.stderr.decode()}"


def diagnosis(rig: str) -> str:
    done = subprocess.run([GREYGATE, "diagnose", str(RIGS / rig), "--json"], capture_output=True)
    return digest([(rig, SECONDS.sub(b"", done.stdout))]) if done.returncode == 0 else f"exit code {done.returncode}"


def stored() -> dict[str, str]:
    """Networks that the repository holds, each with all files of its name."""
    networks = [p for p in sorted((ROOT / "models" / "trained").rglob("*.toml"))]
    return {
        p.relative_to(ROOT).as_posix(): digest([(q.name, q.read_bytes()) for q in p.parent.glob(f"{p.stem}.*")])
        for p in networks
    }


def main(
    file: Path, *, check: Annotated[bool, "compare with the file instead of writing it"] = False, jobs: Jobs = 1
) -> int:
    rigs = sorted(p.parent.name for p in RIGS.glob("*/rig.toml"))
    with ThreadPoolExecutor(jobs) as pool:
        parts = {
            "builds": dict(zip(CATALOG, pool.map(build, CATALOG), strict=True)),
            "diagnoses": dict(zip(rigs, pool.map(diagnosis, rigs), strict=True)),
            "networks": stored(),
        }
    counts = ", ".join(f"{len(found)} {part}" for part, found in parts.items())
    if not check:
        file.write_text(json.dumps(parts, indent=1) + "\n", encoding="utf-8")
        print(f"{file}: {counts}")
        return 0
    before = json.loads(file.read_text(encoding="utf-8"))
    wrong = [
        f"{part} {name}: {before[part].get(name)} before, {found.get(name)} now"
        for part, found in parts.items()
        for name in sorted(before[part].keys() | found.keys())
        if before[part].get(name) != found.get(name)
    ]
    print("\n".join([*wrong, f"{counts}: {len(wrong)} differ"]))
    return 1 if wrong else 0
