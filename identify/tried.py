"""Models, what became of each, and which one is surely better."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import binom

from greygate.identify.ladder import LINEAR, Form, Orders
from greygate.identify.study import parameters
from greygate.models.accuracy import rms
from greygate.models.network import Network

DECAY = 1e-3  # a prior: no normalised weight should be far above thirty deviations of one normalised error
STRONG = 3e-2  # the same for recordings whose noise would be learnt with DECAY
STATE = (0.03, 1.0, 1e-3)  # decays of a state space's neurons, whose signals are spread alike: they are worth more
SIMPLER = 1.03  # a model of fewer weights wins if no other is better by more than this factor: few blocks judge
SURE = 0.95  # that a network is better than every linear model, from which it is chosen
DRAWS = 2000  # resampled sets of segments, from which confidence and interval follow
SEGMENTS = 4  # of a held-out block: its errors are resampled in runs, because neighbours are alike


@dataclass(frozen=True)
class Model:
    """A model of the ladder. decay: D of the loss."""

    form: Form
    orders: Orders
    decay: float = DECAY

    @property
    def name(self) -> str:
        usual = STATE[0] if self.form.states else DECAY
        decay = (
            "" if self.decay == usual or not self.decay else ", strong decay" if self.decay > usual else ", weak decay"
        )
        return f"{self.form.name}, {self.orders}{decay}"

    @property
    def line(self) -> "Model":
        """The linear model from which it is grown."""
        return Model(LINEAR, self.orders, 0.0)


@dataclass(frozen=True)
class Tried:
    """What became of a model.

    networks: fold -> network. errors: fold -> errors (N,) over each of its held-out blocks, in the unit of the output,
    None where the free run diverges. seconds: that it took in all. safe: no network of it has a
    linear loop that grows, or strays.
    """

    model: Model
    rung: int
    networks: Mapping[int, Network]
    errors: Mapping[int, Sequence[np.ndarray | None]]
    seconds: float
    safe: bool = True

    @cached_property
    def parameters(self) -> int:
        return parameters(self.first)

    @property
    def first(self) -> Network:
        """As its first fold left it."""
        return next(iter(self.networks.values()))

    def blocks(self, folds: Iterable[int]) -> list[np.ndarray | None]:
        """Errors over the blocks that these folds hold out."""
        return [e for place in folds for e in self.errors[place]]

    @cached_property
    def error(self) -> float:
        """RMS error over everything that was held out; inf: diverges."""
        return self.over(self.errors)

    @cached_property
    def typical(self) -> float:
        """Geometric mean of the errors over each fold: a half-trained network may err wildly over one of them."""
        found = [self.over([place]) for place in self.errors]
        return float(np.exp(np.mean(np.log(np.maximum(found, np.finfo(float).tiny)))))

    def over(self, folds: Iterable[int]) -> float:
        """RMS error over the blocks of these folds; inf: diverges."""
        return pooled(self.blocks(folds))


def pooled(errors: Sequence[np.ndarray | None]) -> float:
    """RMS of errors; inf where one is None."""
    found = [e for e in errors if e is not None]
    return rms(np.concatenate(found)) if found and len(found) == len(errors) else np.inf


def segments(tried: Tried, folds: Sequence[int]) -> np.ndarray:
    """Mean squared errors of the segments of held-out blocks; inf where a free run diverges."""
    blocks = tried.blocks(folds)
    if not np.isfinite(tried.over(folds)):
        return np.full(SEGMENTS * len(blocks), np.inf)
    return segmented([e for e in blocks if e is not None])


def segmented(blocks: Iterable[np.ndarray]) -> np.ndarray:
    """Mean squared errors of the segments of blocks of errors (N,)."""
    return np.array([np.mean(s**2) for e in blocks for s in np.array_split(e, SEGMENTS)])


def draws(count: int) -> np.ndarray:
    """Sets of `count` segments, each drawn with replacement (DRAWS, count)."""
    return np.random.default_rng(0).integers(0, count, (DRAWS, count))


def sure_of(one: Tried, other: Tried, folds: Sequence[int]) -> float:
    """Share of the drawn sets of segments over which `one` errs less."""
    a, b = segments(one, folds), segments(other, folds)
    drawn = draws(len(a))
    return float(np.mean(a[drawn].mean(1) < b[drawn].mean(1)))


def surely(one: Tried, other: Tried, folds: Sequence[int]) -> bool:
    """Whether `one` is better: by its error over everything held out, or, where that is no worse, in nearly each fold.

    Of one stretch that is like no other the error says little, but that it is there: it is in the last fit. Either way
    it must be better by as much as a model of more weights has to be.
    """
    if SIMPLER * one.over(folds) < other.over(folds) and sure_of(one, other, folds) >= SURE:
        return True
    ratios = [other.over([place]) / one.over([place]) for place in folds]
    better = sum(ratio > 1.0 for ratio in ratios)
    as_good = one.over(folds) <= SIMPLER * other.over(folds) and float(np.median(ratios)) > SIMPLER
    return as_good and float(binom.sf(better - 1, len(folds), 0.5)) <= 1 - SURE


def interval(squares: np.ndarray) -> tuple[float, float]:
    """95 % of the RMS errors over drawn sets of segments, of mean squared errors `squares` (N,)."""
    found = np.sqrt(squares[draws(len(squares))].mean(1))
    low, high = np.quantile(found, (0.025, 0.975))
    return float(low), float(high)
