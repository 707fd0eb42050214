"""The head of the page: the rig, the verdict, and the headline."""

import math
from collections.abc import Mapping

from greygate.mismatch.locate import display_unit
from greygate.mismatch.model import TINY
from greygate.mismatch.verdict import Verdict
from greygate.mismatch.words import DIVERGES, amount, means, parameter
from greygate.pages.diagnosis.case import Diagnosed
from greygate.pages.units import number

BETTER = 0.98  # ratio of RMS errors below which a correction counts as an improvement


def context(case: Diagnosed) -> dict:
    """The verdict in a sentence, the headline, and whether there is a ladder of evidence to lead to."""
    return {
        "title": case.title,
        "plant": case.found["plant"],
        "sentence": Verdict(case.found["verdict"]).words,
        "facts": facts(case),
        "rivals": sum(map(math.isfinite, case.result.rivals.values())) > 1,
    }


def facts(case: Diagnosed) -> list[tuple[str, str, bool | None]]:
    """The headline: (value, its meaning, whether it is good, or None)."""
    found = case.found
    place = " and ".join(p["equation"] for p in found["where"])
    lines: list[tuple[str, str, bool | None]] = [
        (found["verdict"].replace("_", " "), f"in {place}" if place else "verdict", None)
    ]
    for entry in found["effects"]:
        size = ""
        if entry["id"] != "unknown" and entry["parameters"]:
            name, p = next(iter(entry["parameters"].items()))
            known = amount(p["value"], p["ci95"], p["unit"])
            size = f", {name} {known.value} {known.unit}"
        lines.append((entry["id"], f"{means(case.result, entry)}{size}", None))
    if "explained" in found:
        lines.append((f"{found['explained']:.0%}", "of the squared error that can be removed, by what is named", None))
    for name, p in found["parameters"].items():
        if p.get("outside_tolerance"):
            lines.append((name, parameter(case.result, name, p), None))
    return [*lines, _error(case)]


def _error(case: Diagnosed) -> tuple[str, str, bool | None]:
    """The RMS error that the correction reduces most, before and after it."""
    fit = case.found["fit"]
    record = "holdout" if "holdout" in fit else "identify"

    def reduced(item: tuple[str, Mapping]) -> float:
        was, now = item[1]["calibrated"], item[1]["corrected"]
        return math.inf if was is None or now is None else now / max(was, TINY)

    channel, rms = min(fit[record].items(), key=reduced)
    if None in (rms["calibrated"], rms["corrected"]):
        return DIVERGES, f"the simulation of {channel} on {record}", False
    factor, unit = display_unit(rms["unit"], rms["calibrated"])
    was, now = (number(factor * rms[kind]) for kind in ("calibrated", "corrected"))
    if not case.changed:
        return f"{now} {unit}", f"RMS error of {channel} on {record}", None
    better = rms["corrected"] < BETTER * rms["calibrated"]
    return f"{was} → {now} {unit}", f"RMS error of {channel} on {record}, calibrated → corrected", better or None
