"""Modules and functions of PyTorch with all their options: carried right, refused, silently wrong, or a traceback.

Exit code 1 if one is wrong or a traceback.
"""

import warnings
from collections import Counter
from typing import Annotated

from torch_cases import AGREED, GROUPS, STEPS, tried

from .made import keep

TAKES = "half an hour"

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


def main(*, every: Annotated[int, "try one case of so many"] = 1) -> int:
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
        "--every",
        str(every),
    )
    return int(any(row["failing"] for row in rows))
