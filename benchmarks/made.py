"""Stored results: benchmarks/results/NAME.json holds, part by part, what a command found and when.

    {"PART": {"made": {"command": ..., "commit": ..., "date": ...}, ...what was found}}

The pages are written from them (`make pages`).
"""

import json
import subprocess
import sys
from collections.abc import Mapping
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"


def keep(name: str, part: str, found: Mapping) -> None:
    """Put what was found for `part` into results/NAME.json, beside its other parts."""
    path = RESULTS / f"{name}.json"
    content = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    content[part] = {"made": made(part), **found}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def made(part: str) -> dict[str, str]:
    """What makes that part again, on which commit it was made and when; a `+` says that files were changed since."""
    script = Path(sys.argv[0]).resolve().relative_to(ROOT)
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!benchmarks/results", ":!docs")
    return {
        "command": f"python {script} {part}".rstrip(),
        "commit": _git("rev-parse", "--short=10", "HEAD") + ("+" if changed else ""),
        "date": date.today().isoformat(),
    }


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
