"""Shows what became of a build's figures: as rows for a terminal, and as a page with a bar for each."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from greygate.pages import templates
from greygate.pages.units import NONE, display, figure, number

if TYPE_CHECKING:
    from greygate.hardware.comparing import Difference

LEFT = ("figure", "of", "unit", "says")  # columns of words
REACH = 0.1  # growth that fills half a bar where no figure changed by more


def rows(found: Sequence["Difference"]) -> list[dict[str, str]]:
    """The columns of `pages.summary.aligned`, in a person's units."""
    return [_row(one) for one in found]


def _row(one: "Difference") -> dict[str, str]:
    reach = max(abs(v) for v in (one.old, one.new, 0.0) if v is not None)
    factor, unit = display(one.unit, reach)
    cell = number if one.figure == "error" else figure
    old, new = (NONE if v is None else cell(v * factor) for v in (one.old, one.new))
    growth = NONE if not one.growth else f"{100 * one.growth:+.2f} %"
    return {
        "figure": one.figure.replace("_", " "),
        "of": one.where or "the network",
        "old": old,
        "new": new,
        "unit": unit,
        "worse by": growth,
        "says": f"WORSE: {one.says}" if one.worse else one.says,
    }


def page(found: Sequence["Difference"], old: str, new: str) -> str:
    """Make one self-contained HTML page. old, new: the folders as the user named them."""
    reach = max([REACH, *(abs(d.growth) for d in found if d.growth is not None)])
    cells = [_row(one) | _bar(one, reach) for one in found]
    for row in cells:
        row["growth"] = row["worse by"]
    title = f"greygate compare: {old} and {new}"
    return templates.render("compared.html", title=title, old=old, new=new, reach=reach, rows=cells)


def _bar(one: "Difference", reach: float) -> dict:
    """Where the bar of a figure lies, in per cent of its length, and whether it is a loss."""
    share = (one.growth or 0.0) / reach * 50
    return {"worse": one.worse, "more": share > 0, "left": f"{min(50, 50 + share):.2f}", "width": abs(round(share, 2))}
