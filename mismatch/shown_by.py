"""Which of several recordings shows an effect: each of them alone, and all of them without it.

The fit of all recordings is linearised; the windows of some of them alone then give all unknowns anew. An effect is
shown by them where the 95 % interval of one of its sizes holds no zero.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from greygate.mismatch.fit import NORMAL, Fit, flattened
from greygate.mismatch.intervals import WIDER
from greygate.mismatch.model import TINY

SHOWN = 1.0  # half widths of the interval by which a size is off zero
RIDGE = 1e-9  # of curvature, for what does not act in these windows
FIGURES = 3  # of a margin in diagnosis.json


@dataclass(frozen=True)
class Shown:
    """By how many half widths of its interval an effect is off zero, by name of a recording.

    alone: by that recording alone. without: by all the others.
    """

    alone: dict[str, float]
    without: dict[str, float]

    @property
    def by(self) -> list[str]:
        """The recordings that show the effect alone."""
        return [name for name, margin in self.alone.items() if margin > SHOWN]

    @property
    def only(self) -> str:
        """The one recording that shows it, where the others together do not; else empty."""
        by = self.by
        return by[0] if len(by) == 1 and self.without[by[0]] <= SHOWN else ""

    def __str__(self) -> str:
        by = self.by
        if self.only:
            return f"only {self.only} shows it"
        if not by:
            return "no recording shows it alone"
        if len(by) == len(self.alone):
            return "every recording shows it"
        return f"{' and '.join(by)} show{'s' if len(by) == 1 else ''} it alone"

    def as_dict(self) -> dict:
        return {
            name: {"alone": _rounded(self.alone[name]), "without": _rounded(self.without[name])} for name in self.alone
        }


def shown_by(fit: Fit, symbols: Collection[str]) -> Shown | None:
    """What each recording says of the unknowns `symbols`; None where there is one recording."""
    model, of = fit.likelihood.model, fit.likelihood.recording
    names = [run.name for run in model.recording.runs]
    if len(names) < 2:
        return None
    alone = {name: margin(fit, symbols, of == k) for k, name in enumerate(names)}
    return Shown(alone, {name: margin(fit, symbols, of != k) for k, name in enumerate(names)})


def margin(fit: Fit, symbols: Collection[str], windows: np.ndarray) -> float:
    """By how many half widths of its interval the surest of the unknowns is off nothing, by `windows` (bool) alone."""
    flat, errors = flattened(fit.slopes[windows]), fit.projected[windows].reshape(-1)
    normal = flat.T @ flat + np.diag(fit.weight + RIDGE)
    scale = np.sqrt(np.diag(normal))
    bread = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    numbers = fit.numbers - bread @ (flat.T @ errors + fit.weight * fit.numbers)
    spread = max(1.0, float(np.mean(errors**2))) * fit.widened(symbols)
    half = NORMAL * WIDER * np.sqrt(np.maximum(np.diag(bread) * spread, TINY))
    nothing = fit.likelihood.model.values
    away = [
        abs(numbers[j] - u.number(nothing[u.symbol])) / half[j]
        for j, u in enumerate(fit.unknowns)
        if u.symbol in symbols
    ]
    return max(away, default=0.0)


def _rounded(value: float) -> float:
    return float(f"{value:.{FIGURES}g}")
