"""Trains the library networks again (models/families/library.py), and prints their table of docs/library.md.

Each is trained from several seeds; that of the lowest error is kept in models/trained/library, with a bound of its
error.
"""

import json
import math
from collections.abc import Mapping

import numpy as np

from greygate.files import replacing
from greygate.models.families import library
from greygate.models.families.blocks import feedforward, fit_divider, fit_flow
from greygate.models.families.library import DENSE, FUNCTIONS, LIBRARY, LibraryNetwork, entry, rounded_up
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

TAKES = "minutes"
NEURONS = {"square": 3, "product": 4, "sine": 6, "cosine": 6, "arccosine": 8, "square_root": 6}
SEEDS = range(4)
POINTS = {1: 600, 2: 41}  # of each axis, by the number of ports


def errors(found: LibraryNetwork, at: Mapping[str, np.ndarray]) -> np.ndarray:
    """Deviation from the function at values given by port name, (N,)."""
    answer = found.network.run({p: v[:, None] for p, v in at.items()})["y"][:, 0]
    return np.abs(answer - found.function(**at))


def worst(found: LibraryNetwork, points: int | None = None) -> float:
    """The largest of them on the grid."""
    return float(errors(found, found.grid(points)).max())


def bound(found: LibraryNetwork, zooms: int = 6) -> float:
    """A bound of the error between grid points too, by finer and finer grids about the worst points of the grid."""
    at = found.grid()
    steps = {p: (high - low) / (DENSE[len(at)] - 1) for p, (low, high) in found.ranges.items()}
    largest = 0.0
    for _ in range(zooms):
        now = errors(found, at)
        largest = max(largest, float(now.max()))
        near = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * len(at)), -1).reshape(-1, len(at))
        chosen = np.argsort(now)[-100:]
        at = {
            p: np.clip((v[chosen, None] + step * offset).ravel(), *found.ranges[p])
            for (p, v), step, offset in zip(at.items(), steps.values(), near.T, strict=True)
        }
        steps = {p: step / 4 for p, step in steps.items()}
    return largest


def fitted(name: str, seed: int) -> Network:
    """Trained on Chebyshev points, which stand closer together at the ends of a range."""
    function, _, ranges = FUNCTIONS[name]
    points = -np.cos(np.linspace(0, np.pi, POINTS[len(ranges)]))
    axes = [(low + high) / 2 + (high - low) / 2 * points for low, high in ranges.values()]
    at = {p: v.ravel() for p, v in zip(ranges, np.meshgrid(*axes), strict=True)}
    network = feedforward(name, list(ranges), [NEURONS[name]], seed)
    network.inputs = [Port(p, scale=(high - low) / 2, offset=(low + high) / 2) for p, (low, high) in ranges.items()]
    record = Record(at, {"y": function(**at)})
    return train(network, [record], epochs=600, decay=1e-10, tolerance=1e-5).network


def main() -> None:
    networks = {"flow": fit_flow(seed=1).network, "divider": fit_divider(seed=0).network}
    for name in NEURONS:
        fits = [fitted(name, seed) for seed in SEEDS]
        networks[name] = min(fits, key=lambda n: worst(LibraryNetwork(n, *FUNCTIONS[n.name], 0.0, "")))
    for name, network in networks.items():
        network.save(library.TRAINED / name)
    _keep(dict.fromkeys(networks, 0.0))  # an entry reads it
    found = {name: float(rounded_up(bound(entry(name)), 3)) for name in networks}
    _keep(found)
    for name, error in found.items():
        print(f"{name}: worst error {error:.3g}")
    print(markdown())


def _keep(found: Mapping[str, float]) -> None:
    with replacing(library.ERRORS) as path:
        path.write_text(json.dumps(found, indent=1) + "\n")


def markdown() -> str:
    """The table of docs/library.md: a row for every library network with its default arguments."""
    rows = []
    for name in LIBRARY:
        e = entry(name)
        spans = []
        for port, (low, high) in e.ranges.items():
            gaps = "".join(f" without ({a:.2g}, {b:.2g})" for a, b in e.gaps.get(port, ()))
            span = "any" if math.isinf(high) else f"{low:.4g}..{high:.4g}"
            spans.append(f"{port} {span}{gaps}")
        rows.append([name, e.text, "; ".join(spans), rounded_up(e.worst_error, 2), e.hardware])
    lines = [["network", "y", "range", "worst error", "in hardware"], ["---"] * 5, *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"
