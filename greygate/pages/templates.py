"""How a page is put together: one Jinja environment, and sections that each have a template and a context.

A section is a module with a function `context`, beside it the template of the same name: `report/widths.py` says what
`report/widths.html` shows. A page is a list of such modules. `page.html` is the frame of every page.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from greygate.files import replacing
from greygate.pages import units

PACKAGE = __package__


@cache
def environment() -> Environment:
    """The templates of every page. What they show is escaped, whatever it is; only `Markup` is taken as it stands."""
    found = Environment(loader=PackageLoader(PACKAGE, "."), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    found.filters |= {"number": units.number, "figure": units.figure}
    found.globals |= {"differing": units.differing, "display": units.display, "shown": units.shown}
    return found


def render(template: str, **context: object) -> Markup:
    """The template, a path below this folder, filled in."""
    return Markup(environment().get_template(template).render(context))


def render_sections(sections: Sequence[ModuleType], *subject: object) -> list[Markup]:
    """Each section of what the page is about; a section whose `context` is None has nothing to show and is left out."""
    contexts = [(section, section.context(*subject)) for section in sections]
    return [render(_template(section), **context) for section, context in contexts if context is not None]


def _template(section: ModuleType) -> str:
    return section.__name__.removeprefix(f"{PACKAGE}.").replace(".", "/") + ".html"


def write(html: str, path: Path | str) -> None:
    """Write a page, whole or not at all. Raises InputError where the folder cannot be written."""
    with replacing(path) as temporary:
        temporary.write_text(html, encoding="utf-8")
