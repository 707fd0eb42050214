"""Builds a page from sections, each with a template and a context, in one Jinja environment.

A section is a function that gives the context of the template of its name: `widths` of `report/sections.py` computes
what `report/widths.html` shows. A page is a list of such functions. `page.html` is the frame of every page.
"""

from base64 import b64encode
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from greygate.files import replacing
from greygate.pages import units

PACKAGE = __package__


@cache
def environment() -> Environment:
    """The templates of every page; they escape every value except `Markup`."""
    found = Environment(loader=PackageLoader(PACKAGE, "."), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    found.filters |= {"number": units.number, "figure": units.figure, "heading": units.heading}
    found.policies["json.dumps_kwargs"] = {}  # not sorted: curves are drawn in their order
    found.globals |= {"differing": units.differing, "display": units.display, "shown": units.shown}
    return found


def render(template: str, **context: object) -> Markup:
    """The template, a path below this folder, filled in."""
    return Markup(environment().get_template(template).render(context))


@cache
def plotly() -> str:
    """Plotly's script for lines and bars, packed: half a megabyte, for a page that must work without a network.

    It is plotly.js-basic-dist-min 3.7.0 of the npm registry, MIT licence, by gzip -9n, in base64.
    """
    return b64encode(Path(__file__).with_name("plotly-basic.min.js.gz").read_bytes()).decode()


def render_sections(sections: Sequence[Callable[..., dict | None]], *subject: object) -> list[Markup]:
    """Render each section of a page's subject; a section whose context is None is left out, as it shows nothing."""
    contexts = [(section, section(*subject)) for section in sections]
    return [render(_template(section), **context) for section, context in contexts if context is not None]


def _template(section: Callable) -> str:
    folder = section.__module__.removeprefix(f"{PACKAGE}.").partition(".")[0]
    return f"{folder}/{section.__name__}.html"


def write(html: str, path: Path | str) -> None:
    """Write a page completely or not at all. Raises InputError if the folder cannot be written."""
    with replacing(path) as temporary:
        temporary.write_text(html, encoding="utf-8", newline="\n")
