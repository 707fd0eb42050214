"""The section on the evidence: how much worse each hypothesis is than the best."""

import math
from html import escape

from markupsafe import Markup

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.selection import APART
from greygate.mismatch.verdict import Verdict
from greygate.pages.diagnosis.case import Diagnosed
from greygate.pages.figures import Scale
from greygate.pages.units import number

LADDER = 12  # hypotheses drawn


def context(case: Diagnosed) -> dict | None:
    """The ladder of hypotheses; None where there is only one."""
    if sum(map(math.isfinite, case.result.rivals.values())) < 2:
        return None
    return {"ladder": ladder(case.result), "verdict": case.found["verdict"]}


def ladder(result: Diagnosis, width: int = 980) -> Markup:
    """Draw every fully fitted hypothesis by its distance from the best, on a logarithmic scale."""
    rivals = {h: cost for h, cost in result.rivals.items() if math.isfinite(cost)}  # the others diverge
    best = min(rivals.values())
    taken = None if result.verdict == Verdict.UNEXPLAINED else result.best
    rungs = sorted((cost - best, str(h), h == taken) for h, cost in rivals.items())
    rungs = [*rungs[:LADDER], *(rung for rung in rungs[LADDER:] if rung[1] == "nothing")]
    right, row, below = 70, 22, 40
    left = min(max(round(6.8 * max(len(name) for _, name, _ in rungs)) + 20, 160), width - 400)
    height = row * len(rungs) + below
    top = max(max(gap for gap, _, _ in rungs), 100.0)
    scale = Scale(1.0, top, width - left - right, log=True)
    parts = [f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="evidence for each hypothesis">']
    for power in range(math.ceil(math.log10(top)) + 1):
        if 10.0**power > top:
            break
        at = left + scale(10.0**power)
        parts.append(f'<path class="grid" d="M{at:.1f} 0V{height - below + 4}"/>')
        label = number(10.0**power, 1).removeprefix("1·")
        parts.append(f'<text class="tick" x="{at:.1f}" y="{height - 24}" text-anchor="middle">{label}</text>')
    at = left + scale(APART)
    parts.append(f'<path class="mark" d="M{at:.1f} 0V{height - below + 4}"/>')
    for k, (gap, name, bold) in enumerate(rungs):
        y = row * k + row / 2
        end = scale(max(gap, 1.0))
        weight = ' font-weight="600"' if bold else ""
        parts.append(f'<text x="{left - 10}" y="{y + 4:.1f}" text-anchor="end"{weight}>{escape(name)}</text>')
        kind = "good-dot" if bold else "dot"
        parts.append(f'<path class="rung" d="M{left} {y:.1f}h{end:.1f}"/>')
        parts.append(f'<circle class="{kind}" cx="{left + end:.1f}" cy="{y:.1f}" r="5"/>')
        text = "best" if gap == 0.0 else number(gap)
        parts.append(f'<text class="tick" x="{left + end + 10:.1f}" y="{y + 4:.1f}">{text}</text>')
    parts.append(
        f'<text class="label" x="{left + (width - left - right) / 2}" y="{height - 5}">'
        "cost above the best (logarithmic); left of the dashed line: not told apart</text>"
    )
    return Markup("".join(parts) + "</svg>")
