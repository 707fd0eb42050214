"""The section on what a narrower or wider word would cost."""

from markupsafe import Markup

from greygate.pages import figures
from greygate.pages.figures import Curve


def context(study: dict) -> dict | None:
    """A picture per output; None where no other width was tried."""
    if not study["widths"]["width"]:
        return None
    return {"scenarios": study["scenarios"], "widths": study["widths"], "pictures": pictures(study["widths"])}


def pictures(widths: dict) -> dict[str, Markup]:
    """The curve RMSE(fixed)/RMSE(float) over word width, one picture per output, one line per scenario."""
    outputs = list(dict.fromkeys(label for r in widths["ratio"].values() for label in r))
    low, high = figures.span([v for r in widths["ratio"].values() for c in r.values() for v in c], log=True)
    found = {}
    for label in outputs:
        curves = [r[label] for r in widths["ratio"].values()]
        found[label] = figures.chart(
            [Curve(widths["width"], c, f"series{i % 5} dots") for i, c in enumerate(curves)],
            x="word width [bit]",
            y="RMSE fixed / float",
            y_log=True,
            x_limits=(widths["width"][0] - 0.3, widths["width"][-1] + 0.3),
            y_limits=(min(low, 0.8), max(high, 2.0)),
            x_ticks=[w for w in widths["width"] if w % 2 == 0],
            levels=[(1.0, "")],
            marks=[widths["word"]] if widths["word"] else [],
            width={1: 1160, 2: 575}.get(len(outputs), 380),
            height=220,
        )
    return found
