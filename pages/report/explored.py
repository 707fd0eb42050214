"""The section on the designs that were explored: which are worth having, and which was chosen."""

from collections.abc import Mapping, Sequence

from markupsafe import Markup

from greygate.pages import figures
from greygate.pages.figures import Curve


def context(study: dict) -> dict | None:
    """Two pictures and a table of the front; None where nothing was explored."""
    if not study["explored"]:
        return None
    found = study["explored"]
    names = list(dict.fromkeys(p["architecture"] for p in found["front"]))
    return {
        "found": found,
        "names": names,
        "unit": {"x": "times float", "unit": ""}.get(found["error_in"], found["error_in"]),
        "pictures": [
            picture(found, names, "error", "luts", "error", "LUTs"),
            picture(found, names, "microseconds", "luts", "µs a step", "LUTs"),
        ],
    }


def picture(found: Mapping, names: Sequence[str], x: str, y: str, x_title: str, y_title: str) -> Markup:
    """The front in two of its figures, a line of points for each architecture; the chosen design is marked."""
    curves = []
    for n, name in enumerate(names):
        points = sorted((p[x], p[y]) for p in found["front"] if p["architecture"] == name)
        for a, b in points:  # a short line, because points alone have no length
            curves.append(Curve([a, a * 1.03], [b, b], f"series{n % 5} dots wide-dots"))
    chosen = found["chosen"]
    return figures.chart(
        curves,
        x=f"{x_title} [{found['error_in']}]" if x == "error" else x_title,
        y=y_title,
        x_log=True,
        y_log=True,
        x_limits=figures.span([p[x] for p in found["front"]], log=True),
        levels=[(chosen[y], "chosen")] if chosen else [],
        marks=[chosen[x]] if chosen else [],
        width=575,
        height=300,
    )
