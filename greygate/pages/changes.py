"""A page that shows by how much training moved each weight (thesis figures 5.14 to 5.16)."""

from html import escape
from pathlib import Path

import numpy as np

from greygate.files import replacing
from greygate.models.adaptation import weight_changes
from greygate.models.network import Network
from greygate.pages import figures

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
{style}</head><body><main><h1>{title}</h1>
<figure><figcaption>Per cent of the weight before, logarithmic; blue rose, orange fell, red was zero.</figcaption>
{picture}</figure></main></body></html>
"""


def draw_changes(before: Network, after: Network, path: Path | str) -> dict[str, np.ndarray]:
    """Write a page with one picture of `weight_changes(before, after)`, and return them."""
    changes = weight_changes(before, after)
    style = Path(__file__).with_name("style.html").read_text()
    title = f"{escape(after.name)}: how training changed each weight"
    with replacing(path) as temporary:
        temporary.write_text(PAGE.format(title=title, style=style, picture=figures.weight_changes(changes)))
    return changes
