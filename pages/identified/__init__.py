"""What `greygate identify` found, as one HTML page (docs/identify.md says how to read it)."""

from dataclasses import replace

from greygate.identify.files import Identified, IdentifiedFacts
from greygate.identify.trained import Evidence, evidence
from greygate.models.training.initial import initialised
from greygate.pages import templates
from greygate.pages.identified.sections import head, runs
from greygate.pages.training.sections import dynamics, residuals


def page(found: Identified, told: IdentifiedFacts) -> str:
    """Make one self-contained HTML page. told: the figures of `found`."""
    sections = templates.render_sections((head, runs), found, told)
    sections += templates.render_sections((dynamics, residuals), {}, judged(found))
    title = f"greygate identify: {found.task.output.name}"
    return templates.render("identified/page.html", title=title, sections=sections, plotly=templates.plotly())


def judged(found: Identified) -> Evidence:
    """Poles, responses and residual tests of the chosen network, on recordings and tests."""
    records = dict(found.task.records) | {n: found.task.record(r) for n, r in found.tests.items()}
    begun = {n: initialised(found.network, r) for n, r in records.items()}
    learnt = [replace(begun[n], skip=0) for n in found.task.records]
    return evidence(found.network, found.network, learnt, begun, found.network.dt or 1.0, found.chosen.model.decay)
