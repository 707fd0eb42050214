"""A diagnosis as its page reads it: the residual of each fit, with the variables on which it may depend."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.fit import Fit
from greygate.mismatch.locate import signals
from greygate.mismatch.model import Model
from greygate.mismatch.runs import whole
from greygate.mismatch.several import by_rule, modelled
from greygate.mismatch.verdict import Verdict
from greygate.pages.figures import APART

PIECE = 100  # samples of a window in pictures of the residual, if a rig restarts;
FEWEST_PIECE, PIECES = 10, 20  # at least; and no more than such a part of the recording
SETTLED = 0.3  # share of such a window after which its pressures count
SKIP = 5  # such windows at the beginning, in which unmeasured states settle;
SKIP_PART = 8  # but no more than such a part of all
PARTS = (6, 240)  # of a variable's range, in pictures of the residual: fewest and most
FEW = 2000  # points
FAR = 100.0  # times the largest reading, beyond which a simulation that diverges is not drawn
FEWEST = 5  # points in a part that is drawn


@dataclass(frozen=True)
class Residual:
    """Recorded minus simulated for every predicted channel, with the variables on which it may depend.

    errors: name -> (points,), SI; the name gives channel and kind. units: of errors and variables. variables: name ->
    (points,), SI. Points are samples. If the rig restarts, they are windows of `PIECE` samples: for a position the
    growth rate of its error, for any other channel its mean error.
    """

    errors: Mapping[str, np.ndarray]
    variables: Mapping[str, np.ndarray]
    units: Mapping[str, str]


def residuals(result: Diagnosis, fits: Sequence[Fit]) -> list[Residual]:
    """The residual of each fit on identify.csv."""
    rig, recording = result.rig, result.calibrated.likelihood.model.recording
    piece = max(min(PIECE, recording.samples // PIECES), FEWEST_PIECE) if rig.window else None
    first = min(SKIP, recording.samples // piece // SKIP_PART) if piece else 0
    model = modelled(rig, recording, result.corrected.likelihood.model.effects, piece)
    kept = whole(model.pieces, piece)[1] if piece else slice(None)
    variables, units = signals(model)
    found = []
    for fit in fits:
        left = model.target - near(model.predict(known(model, fit)), model.target)
        errors, kinds = {}, {}
        for i, channel in enumerate(rig.predict):
            unit = rig.channels[channel].unit
            if piece is None:
                errors[f"{channel} left"], kinds[f"{channel} left"] = left[:, i], unit
                continue
            rows = left[kept, i].reshape(-1, piece)[first:]
            if model.plant.states[channel].rate if channel in model.plant.states else False:
                clock = (np.arange(piece) - (piece - 1) / 2) * rig.dt
                name, values, unit = f"{channel} drifts", rows @ clock / (clock @ clock), f"{unit}/s"
            else:
                name, values = f"{channel} left", rows[:, round(SETTLED * piece) :].mean(axis=1)
            errors[name], kinds[name] = values, unit
        if piece is None:
            points = variables
        else:
            points = {n: v[kept].reshape(-1, piece).mean(axis=1)[first:] for n, v in variables.items()}
        found.append(Residual(errors, points, {**units, **kinds}))
    return found


def known(model: Model, fit: Fit) -> dict[str, float]:
    """A fit's values for the parameters of `model`."""
    return {**model.values, **{s: v for s, v in fit.values.items() if s in model.values}}


def near(predicted: np.ndarray, target: np.ndarray) -> np.ndarray:
    """`predicted` as it can be drawn: FAR away at most, where a simulation diverges."""
    far = FAR * (float(np.abs(target).max()) or 1.0)
    return np.clip(np.nan_to_num(predicted, nan=far), -far, far)


def edges_of(values: np.ndarray, parts: int) -> np.ndarray:
    """Edges of equal parts of the range that holds nearly all values."""
    low, high = np.percentile(values, (0.5, 99.5))
    apart = high - low > APART * abs(high)
    return np.linspace(low, high if apart else low + (abs(low) or 1.0), parts + 1)


def part_of(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Number of the part in which each value lies, the last edge within; below 0 or beyond where it lies in none."""
    return np.digitize(x, edges) - 1 - (x == edges[-1])


def parts_of(x: np.ndarray) -> int:
    return int(np.clip(len(x) // (15 if len(x) < FEW else 80), *PARTS))


def binned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(middle of each part of x, quartiles of y there (parts, 3)); only parts that hold enough."""
    edges = edges_of(x, parts_of(x))
    which = part_of(x, edges)
    middles, quartiles = [], []
    for k in range(len(edges) - 1):
        inside = y[which == k]
        if len(inside) >= FEWEST:
            middles.append((edges[k] + edges[k + 1]) / 2)
            quartiles.append(np.percentile(inside, (25, 50, 75)))
    return np.array(middles), np.array(quartiles).reshape(-1, 3)


def dependence(x: np.ndarray, y: np.ndarray) -> float:
    """Share of the variance of y that its mean over parts of x explains, minus the share that chance explains."""
    parts = parts_of(x)
    which = np.clip(np.digitize(x, edges_of(x, parts)), 0, parts + 1)
    count = np.bincount(which, minlength=parts + 2)
    mean = np.bincount(which, y, minlength=parts + 2) / np.maximum(count, 1)
    total, used = float(np.var(y)), int((count > 0).sum())
    if total == 0.0 or len(y) <= used:
        return 0.0
    share = float(np.sum(count * (mean - np.mean(y)) ** 2) / (total * len(y)))
    return max(1.0 - (1.0 - share) * (len(y) - 1) / (len(y) - used), 0.0)


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis as its page reads it."""

    result: Diagnosis

    @cached_property
    def found(self) -> dict:
        """Content of diagnosis.json."""
        return self.result.as_dict()

    @property
    def title(self) -> str:
        return self.result.rig.folder.resolve().name

    @cached_property
    def changed(self) -> bool:
        """Whether the diagnosis corrects more than parameters within their tolerances."""
        return self.result.verdict != Verdict.CONSISTENT and (self.result.best.size > 0 or bool(self.found["effects"]))

    @cached_property
    def fits(self) -> dict[str, Fit]:
        """The fits to draw: "calibrated", and "corrected" if it differs."""
        fits = {"calibrated": self.result.calibrated}
        return fits | ({"corrected": self.result.corrected} if self.changed else {})

    @cached_property
    def played(self) -> tuple[str, Model, dict[str, np.ndarray]]:
        """(name, model, "data sheet" and each of `fits` -> predicted channels, by the rig's rule) of a recording.

        It is holdout.csv where there is one.
        """
        result, rig = self.result, self.result.rig
        held = rig.held_out()
        model = modelled(rig, held or rig.to_explain(), result.corrected.likelihood.model.effects)
        values = {"data sheet": {}, **{kind: fit.values for kind, fit in self.fits.items()}}
        if held and "corrected" in values:
            values["corrected"] = result.elsewhere
        predicted = {kind: by_rule(model, there, rig.settle if held else 0)[0] for kind, there in values.items()}
        return ("holdout" if held else "identify"), model, predicted

    @cached_property
    def residuals(self) -> dict[str, Residual]:
        """The residual of each of `fits` on identify.csv."""
        return dict(zip(self.fits, residuals(self.result, list(self.fits.values())), strict=True))

    @cached_property
    def depends_on(self) -> list[str]:
        """The variables on which the mismatch depends, according to the diagnosis."""
        variables = self.residuals["calibrated"].variables
        return [v for place in self.found["where"] for v in place["depends_on"] if v in variables]
