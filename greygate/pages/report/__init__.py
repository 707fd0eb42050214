"""The report: what quantization cost, as one self-contained HTML page. How to read it: docs/report.md.

`study.study` measures one compiled network, `page` draws several, `write` puts page and JSON on disk. The dict of a
study is in SI units; the page turns them into what a person reads.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path

from greygate.files import replacing_all
from greygate.pages import templates
from greygate.pages.report import formats, head, inside, runs, widths
from greygate.pages.summary import LEFT

SECTIONS = (head, widths, formats, runs, inside)
"""Of each study on the page."""


def page(studies: Sequence[dict], tables: Sequence[Sequence[dict]] = ()) -> str:
    """One HTML page that needs nothing else: styles and pictures (SVG) are inside. studies: as `study` gives them.

    tables: of `greygate.pages.summary`, on top.
    """
    title = f"greygate report: {', '.join(s['title'] for s in studies)}"
    sections = [(s["title"], templates.render_sections(SECTIONS, s)) for s in studies]
    return templates.render("report/page.html", title=title, studies=sections, tables=tables, LEFT=LEFT)


def write(
    studies: Sequence[dict], html_path: Path | str, json_path: Path | str, tables: Sequence[Sequence[dict]] = ()
) -> None:
    """Write `page` and the JSON, each whole or not at all. Raises InputError where a folder cannot be written."""
    html, text = page(studies, tables), json.dumps(list(studies), indent=1, allow_nan=False, ensure_ascii=False)
    text = re.sub(r"\[[^][{}]*\]", lambda found: " ".join(found[0].split()), text)  # a list of numbers on one line
    with replacing_all([html_path, json_path]) as (first, second):
        first.write_text(html, encoding="utf-8")
        second.write_text(text + "\n", encoding="utf-8")
