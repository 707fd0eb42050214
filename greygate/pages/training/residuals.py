"""Residual tests of the free run, each with what to do."""

from greygate.pages.validation.records import label, stems
from greygate.trained import Evidence, do


def context(figures: dict, evidence: Evidence) -> dict | None:
    """None where nothing could be tested."""
    groups = [
        (record, output, [(t, label(t), stems(t), "" if t.passed else do(t, output)) for t in tests])
        for (record, output), tests in evidence.tests.items()
    ]
    return {"groups": groups} if groups else None
