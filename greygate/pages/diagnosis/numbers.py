"""Every figure of the diagnosis, and what it could not tell."""

from greygate.mismatch.experiments.excitation import unseen
from greygate.pages.diagnosis.case import Case


def context(case: Case) -> dict:
    """Effects with their parameters, the fit, and what remains open."""
    words = case.words
    return {
        "effects": words.effects,
        "parameters": words.parameters.values(),
        "fit": words.fit,
        "alike": words.alike,
        "unseen": unseen(case.result.calibrated),
        "remaining": case.found["remaining"],
        "seconds": case.found["seconds"],
    }
