"""What `greygate validate` finds, as one HTML page. How to read it: docs/validation.md."""

from markupsafe import Markup
from plotly.offline import get_plotlyjs

from greygate.pages import templates
from greygate.pages.validation import head, ranges, records
from greygate.pages.validation.judged import Judged

SECTIONS = (head, records, ranges)


def page(judged: Judged) -> str:
    """One HTML page that needs nothing else: styles, pictures (SVG), and Plotly for the runs that can be zoomed."""
    return templates.render(
        "validation/page.html",
        title=f"greygate validation: {judged.title}",
        sections=templates.render_sections(SECTIONS, judged),
        plotly=Markup(get_plotlyjs()),
    )
