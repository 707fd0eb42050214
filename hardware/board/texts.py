"""The templates of the files that stand beside a core: in Jinja, where a missing value is an error."""

from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined

from greygate.compiler.verilog import remark


@cache
def _environment(package: str) -> Environment:
    found = Environment(
        loader=PackageLoader(package, "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters["remark"] = remark
    return found


def render(template: str, context: dict, package: str = __package__) -> str:
    """The template of that name in the folder of a package, filled in."""
    return _environment(package).get_template(f"{template}.j2").render(context)
