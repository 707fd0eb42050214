"""The results of `greygate validate` as one HTML page (docs/validation.md says how to read it)."""

from greygate.pages import templates
from greygate.pages.validation.judged import Judged
from greygate.pages.validation.sections import head, ranges, records

SECTIONS = (head, records, ranges)


def page(judged: Judged) -> str:
    """Make one self-contained HTML page: styles, pictures (SVG), and Plotly for the runs that can be zoomed."""
    return templates.render(
        "validation/page.html",
        title=f"greygate validation: {judged.title}",
        sections=templates.render_sections(SECTIONS, judged),
        plotly=templates.plotly(),
    )
