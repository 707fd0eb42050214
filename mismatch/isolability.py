"""What a rig's sensors and a recording's motion can show, before anything is explained.

Each effect moves the predicted channels in a direction; what the parameters and the windows' beginnings can take up of
it is not seen. Two effects whose directions are then parallel cannot be told apart by this recording.
"""

from dataclasses import dataclass

import numpy as np

from greygate.mismatch.effects import Effect
from greygate.mismatch.search import Hypothesis, Search

ALIKE = 0.995  # cosine of the angle between two directions from which on they are one
SEEN = 5.0  # standard deviations that an effect of its typical size must move the channels together


@dataclass(frozen=True)
class Isolability:
    """groups: effects that cannot be told apart. unseen: effects of typical size that do not show, and how little.

    weak: combinations of parameters of which the recording says less than the data sheet, with their singular value.
    """

    groups: list[list[str]]
    unseen: dict[str, float]
    weak: list[tuple[float, dict[str, float]]]

    def lines(self) -> list[str]:
        """What a person reads."""
        out = [f"not told apart: {', '.join(group)}" for group in self.groups]
        out += [
            f"hardly shows: {name}, {size:.2g} of the noise at its typical size" for name, size in self.unseen.items()
        ]
        for value, parts in self.weak:
            parts_ = " ".join(f"{weight:+.2f} {symbol}" for symbol, weight in parts.items())
            out.append(f"left to the data sheet: {parts_} (singular value {value:.2g})")
        return out or ["every effect shows, and no two are alike"]


def isolability(search: Search) -> Isolability:
    """Of the effects of `search` on its recording, with the data sheet's plant and the recorded inputs."""
    problem = search.screen
    fit = problem.fit(search.unknowns(Hypothesis()), iterations=0)
    slopes = fit.slopes.reshape(-1, len(fit.unknowns))
    _, values, rights = np.linalg.svd(slopes, full_matrices=False) if slopes.shape[1] else (None, [], [])
    basis, _ = np.linalg.qr(slopes)
    directions, unseen = {}, {}
    for key, effect in search.effects.items():
        columns = _first(search, problem, fit, effect)
        if columns is None:
            continue
        columns = columns - basis @ (basis.T @ columns)
        size = float(np.sqrt(np.max(np.sum(columns**2, axis=0))))
        if size < SEEN:
            unseen[key] = size
        else:
            directions[key] = np.linalg.qr(columns)[0]
    groups: list[list[str]] = []
    for key, direction in directions.items():
        for group in groups:
            if any(_cosine(direction, directions[other]) > ALIKE for other in group):
                group.append(key)
                break
        else:
            groups.append([key])
    symbols = [u.symbol for u in fit.unknowns]
    weak = [
        (float(value), {s: float(w) for s, w in zip(symbols, right, strict=True) if abs(w) > 0.3})
        for value, right in zip(values, rights, strict=True)
        if value < 1.0
    ]
    ids = [list(dict.fromkeys(search.effects[key].id for key in group)) for group in groups]
    return Isolability([group for group in ids if len(group) > 1], unseen, weak)


def _first(search: Search, problem, fit, effect: Effect) -> np.ndarray | None:
    """An effect's columns, (rows, n), of the first shape of its grid."""
    for _, _, columns in search.directions(problem, fit, effect):
        return columns.reshape(-1, columns.shape[2])
    return None


def _cosine(one: np.ndarray, other: np.ndarray) -> float:
    """Of the smallest angle between two spaces."""
    return float(np.linalg.svd(one.T @ other, compute_uv=False)[0])
