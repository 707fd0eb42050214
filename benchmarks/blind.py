"""The blind benchmark of missing physics on its development split: `python benchmarks/blind.py [TOOL ...]`.

Writes results/NAME.json (every figure of every tool), NAME.txt (the table), NAME.csv (a line a case of the first tool)
and NAME.svg (its reliability diagram). An interrupted run goes on from the answers in FOLDER. With `--secret` the split
is the sealed one that the secret stands for.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from concealed_bench import tables
from concealed_bench.diagram import draw
from concealed_bench.make import COMMITMENT, make
from concealed_bench.run import BASELINES, OURS, run
from concealed_bench.score import Score, score
from made import stamp

RESULTS = Path(__file__).parent / "results"
CASES, LIMIT = 180, 300.0  # each kind under each condition twice, on every plant; s for an explanation


def report(scores: dict[str, Sequence[Score]], name: str, commitment: bytes) -> list[str]:
    """Write the results of the tools, with the hash of what sealed the answers, and return the lines of the table."""
    found = {tool: tables.summary(part) for tool, part in scores.items()}
    content = {tool: found[tool] | {"reliability": tables.reliability(part)} for tool, part in scores.items()}
    content["commitment_sha256"] = hashlib.sha256(commitment).hexdigest()
    first = next(iter(scores.values()))
    lines = tables.lines(found)
    (RESULTS / f"{name}.json").write_text(json.dumps(content) + "\n")
    (RESULTS / f"{name}.txt").write_text("\n".join(lines) + "\n")
    tables.write_rows(first, RESULTS / f"{name}.csv")
    draw(first, RESULTS / f"{name}.svg")
    for ending in ("json", "txt", "csv", "svg"):
        stamp(RESULTS / f"{name}.{ending}", " ".join(sys.argv[1:]))
    return lines


def say(line: str) -> None:
    print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tools", nargs="*", default=[OURS, *BASELINES])
    parser.add_argument("--cases", type=int, default=CASES)
    parser.add_argument("--limit", type=float, default=LIMIT)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("build/blind"), help="for the cases and the answers")
    parser.add_argument("--name", default="blind", help="of the results")
    parser.add_argument("--secret", type=Path, help="file with the secret of the sealed split")
    parser.add_argument("--table", action="store_true", help="only score what was answered")
    options = parser.parse_args()
    bench, answers = options.folder / "bench", options.folder / "answers"
    if not bench.exists():
        bench.parent.mkdir(parents=True, exist_ok=True)
        make(bench, options.cases, options.secret.read_text().strip() if options.secret else "")
    if not options.table:
        for tool in options.tools:
            say(tool)
            run(bench, tool, answers / tool, options.limit, jobs=options.jobs, progress=say)
    scores = {tool: score(bench, answers / tool) for tool in options.tools}
    print("\n".join(report(scores, options.name, (bench / COMMITMENT).read_bytes())))


if __name__ == "__main__":
    main()
