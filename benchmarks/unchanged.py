"""Did a change of the house change a result? SHA-256 of every build of the catalogue, stored network and diagnosis.

    python benchmarks/unchanged.py BEFORE.json            # on the commit before: writes
    python benchmarks/unchanged.py BEFORE.json --check    # on the one after: names what differs, exit 1

A build is every file that `greygate compile NAME` writes; a diagnosis is what `greygate diagnose RIG --json` prints,
without its seconds. The rigs are those of ../shared/rigs, where that folder is.
"""

import argparse
import hashlib
import json
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from greygate.machines.catalog import CATALOG

ROOT = Path(__file__).parents[1]
RIGS = ROOT.parent / "shared" / "rigs"
GREYGATE = str(Path(sys.executable).with_name("greygate"))
SECONDS = re.compile(rb'"seconds": [^,\n}]+')


def digest(files: list[tuple[str, bytes]]) -> str:
    told = hashlib.sha256()
    for name, content in sorted(files):
        told.update(name.encode() + b"\0" + content + b"\0")
    return told.hexdigest()


def build(name: str) -> str:
    """Of every file of a build, or of the refusal."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([GREYGATE, "compile", name, "--out", "built"], cwd=folder, capture_output=True)
        found = [(p.relative_to(folder).as_posix(), p.read_bytes()) for p in Path(folder).rglob("*") if p.is_file()]
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


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("file", type=Path)
    asked.add_argument("--check", action="store_true", help="compare with the file instead of writing it")
    asked.add_argument("--jobs", type=int, default=1)
    given = asked.parse_args()
    rigs = sorted(p.parent.name for p in RIGS.glob("*/rig.toml"))
    with ThreadPoolExecutor(given.jobs) as pool:
        parts = {
            "builds": dict(zip(CATALOG, pool.map(build, CATALOG), strict=True)),
            "diagnoses": dict(zip(rigs, pool.map(diagnosis, rigs), strict=True)),
            "networks": stored(),
        }
    counts = ", ".join(f"{len(found)} {part}" for part, found in parts.items())
    if not given.check:
        given.file.write_text(json.dumps(parts, indent=1) + "\n", encoding="utf-8")
        print(f"{given.file}: {counts}")
        return 0
    before = json.loads(given.file.read_text(encoding="utf-8"))
    wrong = [
        f"{part} {name}: {before[part].get(name)} before, {found.get(name)} now"
        for part, found in parts.items()
        for name in sorted(before[part].keys() | found.keys())
        if before[part].get(name) != found.get(name)
    ]
    print("\n".join([*wrong, f"{counts}: {len(wrong)} differ"]))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
