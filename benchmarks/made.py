"""Stored results: which command found them, on which commit and day, and which code they measure.

JSON by parts says it itself, results/NAME.json: {"PART": {"made": {"command", "commit", "date"}, ...what was found}}.
The index results/made.json has a line for every other file or folder of results, and says of each which code it
measures:

    {"benchmarks/results/NAME.csv": {"command", "commit", "date", "sha256", "measures": ["folder", "file.py"]}}

A script stores by `keep("NAME", "PART", found, measures=[...])`, or writes its file or folder and calls
`stamp(path, measures=[...])`; `measures` is needed the first time. What no script of this folder wrote is stamped by
hand: `python benchmarks/made.py PATH [--command COMMAND] [--measures PATH ...]`. Without PATH it stamps whatever was
changed since its stamp. `stored` in place of `commit` is the commit that brought a file here: what measured it is
unknown. `benchmarks/stale.py` names what is older than the code it measures. The pages are written from the results
(`make pages`).
"""

import argparse
import hashlib
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
INDEX = RESULTS / "made.json"
STORED = (RESULTS, ROOT / "models" / "trained")


def keep(name: str, part: str, found: Mapping, measures: Sequence[str] = ()) -> None:
    """Put what was found for `part` into results/NAME.json, beside its other parts."""
    path = RESULTS / f"{name}.json"
    content = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    content[part] = {"made": made(part), **found}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    _measured(path, measures)


def stamp(path: Path, part: str = "", command: str | None = None, measures: Sequence[str] = ()) -> None:
    """Say in the index how a file, or every file of a folder, was made: just now, by this script.

    What is written anywhere else is no stored result, and left alone.
    """
    if any(path.resolve().is_relative_to(folder) for folder in STORED):
        _measured(path, measures, {**made(part, command), "sha256": digest(path)})


def made(part: str, command: str | None = None) -> dict[str, str]:
    """What makes that part again, on which commit it was made and when.

    The commit is the last one of `main`, where there is one: a branch's own may be gone tomorrow. A `+` says that code
    was changed since.
    """
    script = Path(sys.argv[0]).resolve()
    if command is None:
        command = f"python {script.relative_to(ROOT)} {part}".rstrip()
    commit = git("merge-base", "HEAD", "main") or git("rev-parse", "HEAD")
    changed = git("diff", "--stat", commit, "--", ".", ":!benchmarks/results", ":!docs", ":!models/trained")
    return {"command": command, "commit": commit[:10] + "+" * bool(changed), "date": date.today().isoformat()}


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


def _measured(path: Path, measures: Sequence[str], how: Mapping | None = None) -> None:
    """Write the line of the index; `measures` stay what they were where none are given."""
    known, name = index(), str(path.resolve().relative_to(ROOT))
    line = {**(how or {}), "measures": list(measures) or known.get(name, {}).get("measures", [])}
    known[name] = line
    INDEX.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("path", nargs="*", type=Path, help="stored files or folders; all that were changed by default")
    parser.add_argument("--command", help="what made them; as it was by default")
    parser.add_argument("--measures", nargs="+", default=[], help="folders and files of code; as they were by default")
    given = parser.parse_args()
    known = index()
    changed = [ROOT / n for n, e in known.items() if "sha256" in e and digest(ROOT / n) != e["sha256"]]
    for path in given.path or changed:
        before = known.get(str(path.resolve().relative_to(ROOT)), {})
        stamp(path, command=given.command or before.get("command", "unknown"), measures=given.measures)
        print(f"stamped {path}")


if __name__ == "__main__":
    main()
