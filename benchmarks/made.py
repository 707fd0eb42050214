"""Stored results: which command found them, on which commit, day and machine, and which code they measure.

    python -m benchmarks made [PATH ...] [--command COMMAND] [--measures PATH ...]

JSON by parts says it itself, results/NAME.json: {"PART": {"made": {"command", "commit", "date", "machine"}, ...what was
found}}. The index results/made.json has a line for every other file or folder of results, and says of each which code
it measures:

    {"benchmarks/results/NAME.csv": {"command", "commit", "date", "machine", "sha256", "measures": ["folder"]}}

A benchmark stores by `keep("NAME", "PART", found)` or `store("NAME", found)`, or writes its file or folder and calls
`stamp(path)`. What none of them wrote is stamped by hand, by this command; without PATH it stamps whatever was changed
since its stamp. A new result has to be told what it `measures` once, by hand too. `stored` in place of `commit` is the
commit that brought a file here: what measured it is unknown. `python -m benchmarks stale` names what is older than the
code it measures. The pages are written from the results (`make pages`).
"""

import hashlib
import json
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

from greygate.system import cores

TAKES = "seconds"
ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
INDEX = RESULTS / "made.json"
STORED = (RESULTS, ROOT / "models" / "trained")
RUN = {"results": RESULTS, "name": ""}  # of the run that is on: where its results go, and its benchmark


def place(name: str) -> Path:
    """Where this run keeps a file or folder of results."""
    return RUN["results"] / name


def stored(name: str) -> dict:
    """Content of NAME.json among the results; empty where there is none."""
    path = place(f"{name}.json")
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def keep(name: str, part: str, found: Mapping, *words: str) -> None:
    """Put what was found for `part` into results/NAME.json, beside its other parts.

    words: of the command line that finds it, the part by default.
    """
    how = made(shlex.join(["python", "-m", "benchmarks", RUN["name"], *(words or (part,))]))
    _write(name, stored(name) | {part: {"made": how, **found}})
    _measured(place(f"{name}.json"))


def store(name: str, content: Mapping | Sequence) -> None:
    """Write results/NAME.json, and say in the index how it was made."""
    _write(name, content)
    stamp(place(f"{name}.json"))


def stamp(path: Path, command: str = "", measures: Sequence[str] = ()) -> None:
    """Say in the index how a file, or every file of a folder, was made: just now, by the command that runs."""
    _measured(path, measures, {**made(command), "sha256": digest(path)})


def made(command: str = "") -> dict[str, str]:
    """What makes a result again, and on which commit, day and machine it was made.

    The commit is the last one of `main`, where there is one: a branch's own may be gone tomorrow. A `+` says that code
    was changed since.
    """
    commit = git("merge-base", "HEAD", "main") or git("rev-parse", "HEAD")
    changed = git("diff", "--stat", commit, "--", ".", ":!benchmarks/results", ":!docs", ":!models/trained")
    return {
        "command": command or shlex.join(["python", "-m", "benchmarks", RUN["name"], *sys.argv[2:]]),
        "commit": commit[:10] + "+" * bool(changed),
        "date": date.today().isoformat(),
        "machine": machine(),
    }


def machine() -> str:
    """The processor, as Linux or else Python names it, and its cores that this process may use."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text(encoding="utf-8").splitlines() if told.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = (names or [platform.processor() or platform.machine()])[0]
    return f"{processor}, {cores()} cores"


def git(*arguments: str) -> str:
    """What git says; nothing where it fails."""
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True).stdout.strip()


def index() -> dict[str, dict]:
    """Stored file or folder, by its path from the root -> how it was made and what it measures."""
    return json.loads(INDEX.read_text(encoding="utf-8"))


def stamps(path: str, entry: Mapping) -> list[Mapping]:
    """How a stored result, or each of its parts, was made."""
    if "date" in entry:
        return [entry]
    return [part["made"] for part in json.loads((ROOT / path).read_text(encoding="utf-8")).values()]


def digest(path: Path) -> str:
    """SHA-256 of a file, or of names and contents of a folder's; its first 16 digits."""
    found = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            found.update(file.name.encode() + file.read_bytes() if path.is_dir() else file.read_bytes())
    return found.hexdigest()[:16]


def files() -> list[Path]:
    """Every stored result."""
    found = [f for folder in STORED for f in folder.rglob("*") if f.is_file() and f != INDEX]
    return sorted(f for f in found if f.is_relative_to(RESULTS) or f.suffix == ".json")


def _write(name: str, content: Mapping | Sequence) -> None:
    place(f"{name}.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _measured(path: Path, measures: Sequence[str] = (), how: Mapping | None = None) -> None:
    """Write the line of the index; `measures` stay what they were where none are given.

    What is written anywhere else is no stored result, and left alone.
    """
    if any(path.resolve().is_relative_to(folder) for folder in STORED):
        known, name = index(), str(path.resolve().relative_to(ROOT))
        known[name] = {**(how or {}), "measures": list(measures) or known.get(name, {}).get("measures", [])}
        INDEX.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")


def main(*path: Path, command: str = "", measures: Sequence[str] = ()) -> None:
    known = index()
    changed = [ROOT / n for n, e in known.items() if "sha256" in e and digest(ROOT / n) != e["sha256"]]
    for one in path or changed:
        before = known.get(str(one.resolve().relative_to(ROOT)), {})
        stamp(one, command or before.get("command", "unknown"), measures)
        print(f"stamped {one}")
