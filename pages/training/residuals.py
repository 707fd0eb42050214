"""Residual tests of the free run, each with what to do."""

from greygate.identify.trained import Evidence
from greygate.models.residuals import asks_for
from greygate.pages.validation.records import label, stems


def context(figures: dict, evidence: Evidence) -> dict | None:
    """None where nothing could be tested."""
    groups = [
        (record, output, [(t, label(t), stems(t), "" if t.passed else asks_for(t, output)) for t in tests])
        for (record, output), tests in evidence.tests.items()
    ]
    return {"groups": groups} if groups else None
