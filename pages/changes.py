"""A page that shows by how much training moved each weight (thesis figures 5.14 to 5.16)."""

from pathlib import Path

import numpy as np

from greygate.models.adaptation import weight_changes
from greygate.models.network import Network
from greygate.pages import figures, templates


def draw_changes(before: Network, after: Network, path: Path | str) -> dict[str, np.ndarray]:
    """Write a page with one picture of `weight_changes(before, after)`, and return them."""
    changes = weight_changes(before, after)
    title = f"{after.name}: how training changed each weight"
    templates.write(templates.render("changes.html", title=title, picture=figures.weight_changes(changes)), path)
    return changes
