"""The results of `greygate train` as one HTML page (docs/training.md says how to read it)."""

from greygate.identify.trained import Evidence
from greygate.pages import templates
from greygate.pages.training.sections import dynamics, head, residuals, weights

SECTIONS = (head, dynamics, weights, residuals)


def page(figures: dict, evidence: Evidence) -> str:
    """Make one self-contained HTML page. figures: of `train_source`."""
    title = f"greygate training: {evidence.after.name}"
    sections = templates.render_sections(SECTIONS, figures, evidence)
    return templates.render("training/page.html", title=title, sections=sections)
