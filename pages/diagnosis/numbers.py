"""The section with every figure of the diagnosis, and with the questions it leaves open."""

from collections.abc import Mapping

from greygate.mismatch import words
from greygate.pages.diagnosis.case import Diagnosed


def context(case: Diagnosed) -> dict:
    """Effects with their parameters, the fit, and open questions."""
    result, found = case.result, case.found
    return {
        "effects": [(e, words.means(result, e), amounts(e["parameters"])) for e in found["effects"]],
        "parameters": [words.parameter(result, n, p) for n, p in found["parameters"].items()],
        "fit": words.fit_table(found["fit"]),
        "alike": words.alike(result, found),
        "unseen": words.hidden(result),
        "refused": found.get("refused", []),
        "bounds": words.bounds(found),
        "noises": words.noises(found),
        "remaining": found["remaining"] or words.nothing_left(result),
        "seconds": found["seconds"],
    }


def amounts(parameters: Mapping) -> list[tuple[str, words.Amount, str]]:
    """(name, amount, and the term, if a fitted term stands for the effect)."""
    return [
        (n, words.amount(p["value"], p["ci95"], p["unit"]), f"{p['place']}: {p['term']}" if "term" in p else "")
        for n, p in parameters.items()
    ]
