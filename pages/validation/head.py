"""The head of the page: the network, its headline, and a table with a row for each record and output."""

import math

from greygate.pages.units import per_cent
from greygate.pages.validation.judged import Judged, long_run, rows, tally


def context(judged: Judged) -> dict:
    """The judgement itself, its headline, its table."""
    records = list(dict.fromkeys(v.record for v in judged.validations))
    return {"j": judged, "facts": facts(judged), "rows": rows(judged), "records": records}


def facts(judged: Judged) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, its meaning, whether it is good, or None)."""
    fresh = [v for v in judged.validations if v.record not in judged.training] or judged.validations
    worst = min(fresh, key=lambda v: v.fit if not math.isnan(v.fit) else math.inf)
    where = f"{worst.output} on {worst.record}"
    fit = f"{per_cent(worst.fit)} %" if math.isfinite(worst.rms) else "diverges"
    lines: list[tuple[str, str, bool | None]] = [(fit, f"worst fit of a free run, {where}", None)]
    if ahead := [v for v in fresh if 1 in v.ahead]:
        worst = min(ahead, key=lambda v: v.ahead[1][1])
        where = f"{worst.output} on {worst.record}"
        lines.append((f"{per_cent(worst.ahead[1][1])} %", f"worst fit one step ahead, {where}", None))
    for residual in ("free run", "one step ahead"):
        tests = [t for v in fresh for t in v.tests.get(residual, ())]
        if tests:
            good = all(t.passed for t in tests)
            lines.append((tally(tests), f"residual tests passed, {residual}", good or None))
    runs = {long_run(v) for v in judged.validations}
    state = next(s for s in ("unbounded", "drifts", "stable") if s in runs)
    lines.append((state, "over ten times each record, inputs to 1.2 times", state == "stable"))
    if beyond := [r for r in judged.ranges if r.record not in judged.training]:
        widest = max(beyond, key=lambda r: r.outside)
        what = f"of {widest.signal} on {widest.record} beyond what was learnt"
        lines.append((f"{100 * widest.outside:.0f} %", what, None))
    return lines
