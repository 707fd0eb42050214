"""Modules and functions of PyTorch with all their options: carried right, refused, silently wrong, or a traceback.

`python benchmarks/torch_options.py options` (half an hour; `--every 8`: of eight cases one) writes
benchmarks/results/torch_options.json. Exit code 1 if one is wrong or a traceback.
"""

import argparse
import sys
import warnings
from collections import Counter

from made import keep
from torch_cases import AGREED, GROUPS, STEPS, tried

VERDICTS = ("right", "refused", "wrong", "traceback")


def measured(group, every: int) -> dict:
    counts, largest, failing, differing = Counter(), 0.0, [], 0
    for case in list(group())[::every]:
        found = tried(case)
        counts[found.verdict] += 1
        largest = max(largest, found.largest if found.verdict == "right" else 0.0)
        differing += found.verdict == "refused" and "differs from" in found.said
        if found.verdict in VERDICTS[2:]:
            failing.append({"case": case.name, "said": found.said, "largest": found.largest})
            print(case, found, flush=True)
    counted = {verdict: counts[verdict] for verdict in VERDICTS}
    return {"group": case.group, **counted, "refused_by_comparison": differing, "largest": largest, "failing": failing}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["options"], nargs="?")
    parser.add_argument("--every", type=int, default=1, help="try one case of so many")
    every = parser.parse_args().every
    rows = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of torch, about its own modules
        for group in GROUPS:
            rows.append(measured(group, every))
            print(rows[-1], flush=True)
    keep(
        "torch_options",
        "options",
        {"steps": STEPS, "every": every, "agreed": AGREED, "rows": rows},
        ["models/importers"],
    )
    return int(any(row["failing"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
