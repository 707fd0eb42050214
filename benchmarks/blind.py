"""The blind benchmark of missing physics on its development split.

Writes results/NAME.json (every figure of every tool), NAME.txt (the table), NAME.csv (a line a case of the first tool)
and NAME.svg (its reliability diagram). An interrupted run goes on from the answers in FOLDER. With `--secret` the split
is the sealed one that the secret stands for.
"""

import hashlib
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

from .concealed_bench import tables
from .concealed_bench.diagram import draw
from .concealed_bench.make import COMMITMENT, make
from .concealed_bench.run import BASELINES, OURS, run
from .concealed_bench.score import Score, score
from .made import place, stamp
from .shared import Jobs

TAKES = "hours"
NEEDS = ("pysindy", "sklearn")
CASES, LIMIT = 180, 300.0  # each kind under each condition twice, on every plant; s for an explanation


def report(scores: dict[str, Sequence[Score]], name: str, commitment: bytes) -> list[str]:
    """Write the results of the tools, with the hash of what sealed the answers, and return the lines of the table."""
    found = {tool: tables.summary(part) for tool, part in scores.items()}
    content = {tool: found[tool] | {"reliability": tables.reliability(part)} for tool, part in scores.items()}
    content["commitment_sha256"] = hashlib.sha256(commitment).hexdigest()
    first = next(iter(scores.values()))
    lines = tables.lines(found)
    place(f"{name}.json").write_text(json.dumps(content) + "\n")
    place(f"{name}.txt").write_text("\n".join(lines) + "\n")
    tables.write_rows(first, place(f"{name}.csv"))
    draw(first, place(f"{name}.svg"))
    for ending in ("json", "txt", "csv", "svg"):
        stamp(place(f"{name}.{ending}"))
    return lines


def main(
    *tools: Annotated[str, (OURS, *BASELINES)],
    cases: int = CASES,
    limit: Annotated[float, "seconds for an explanation"] = LIMIT,
    jobs: Jobs = 1,
    folder: Annotated[Path, "for the cases and the answers"] = Path("build/blind"),
    name: Annotated[str, "of the results"] = "blind",
    secret: Annotated[Path | None, "file with the secret of the sealed split"] = None,
    table: Annotated[bool, "only score what was answered"] = False,
) -> None:
    asked, bench, answers = tools or (OURS, *BASELINES), folder / "bench", folder / "answers"
    if not bench.exists():
        bench.parent.mkdir(parents=True, exist_ok=True)
        make(bench, cases, secret.read_text().strip() if secret else "")
    for tool in () if table else asked:
        print(tool, flush=True)
        run(bench, tool, answers / tool, limit, jobs=jobs, progress=partial(print, flush=True))
    scores = {tool: score(bench, answers / tool) for tool in asked}
    print("\n".join(report(scores, name, (bench / COMMITMENT).read_bytes())))
