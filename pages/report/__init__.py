"""The report on what quantization cost, as one self-contained HTML page (docs/report.md says how to read it).

`study.study` measures one compiled network, `page` draws several studies, `write` writes the page and the JSON. The
dict of a study is in SI units; the page converts them into a person's units.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path

from greygate.files import replacing_all
from greygate.pages import templates
from greygate.pages.report.sections import explored, formats, head, inside, runs, widths
from greygate.pages.summary import LEFT

SECTIONS = (head, explored, widths, formats, runs, inside)
"""Of each study on the page."""


def page(studies: Sequence[dict], tables: Sequence[Sequence[dict]] = ()) -> str:
    """Make one self-contained HTML page, with styles, pictures (SVG) and Plotly inside. studies: by `study`.

    tables: of `greygate.pages.summary`, shown on top.
    """
    title = f"greygate report: {', '.join(s['title'] for s in studies)}"
    sections = [(s["title"], templates.render_sections(SECTIONS, s)) for s in studies]
    return templates.render(
        "report/page.html", title=title, studies=sections, tables=tables, LEFT=LEFT, plotly=templates.plotly()
    )


def write(
    studies: Sequence[dict], html_path: Path | str, json_path: Path | str, tables: Sequence[Sequence[dict]] = ()
) -> None:
    """Write `page` and the JSON, each completely or not at all. Raises InputError if a folder cannot be written."""
    html, text = page(studies, tables), json.dumps(list(studies), indent=1, allow_nan=False, ensure_ascii=False)
    text = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), text)  # a list of numbers on one line
    with replacing_all([html_path, json_path]) as (first, second):
        first.write_text(html, encoding="utf-8", newline="\n")
        second.write_text(text + "\n", encoding="utf-8", newline="\n")
