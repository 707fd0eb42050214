"""The templates of the files that stand beside a core: one Jinja environment, in which a missing value is an error."""

from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined

from greygate.compiler.verilog import remark


@cache
def _environment() -> Environment:
    found = Environment(
        loader=PackageLoader(__package__, "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters["remark"] = remark
    return found


def render(template: str, context: dict) -> str:
    """The template of that name, filled in."""
    return _environment().get_template(f"{template}.j2").render(context)
