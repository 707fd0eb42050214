"""The simplest formula for what a plant leaves out, where no effect of the table is it.

    place += sum_k c_k phi_k(signals),    phi_k from a small grammar

First the place is chosen, and the one or two signals on which the term depends, by smooth functions of every signal in
every place; then the functions of these signals. All is judged by the cost that is saved on stretches of the recording
that the coefficients were not fitted to; of formulas that save nearly as much the simplest is taken. Each function is
linear in its coefficient, so a choice is one of columns (forced.py); a knee is refined by halving steps.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product

import numpy as np

from greygate.mismatch.entries import SENSOR
from greygate.mismatch.fit import NORMAL, Fit, flattened
from greygate.mismatch.forced import Forced, Place, sensors
from greygate.mismatch.halves import RIDGE, Halves
from greygate.mismatch.linearised import nothing
from greygate.mismatch.model import TINY
from greygate.plants.expressions import names

ONE = "1.0"  # the function of no signal
WORTH = 0.03  # of the misfit, that a further signal or a further term must save
LEAST = 0.01  # of the cost of the noise, that a misfit must have
ALIKE = WORTH / 3  # of the misfit, within which two formulas are equally good
BEST = 4  # signals of which pairs are tried
TERMS = 3  # of a formula, at most
SHARP = 20.0  # of the tanh that stands for a sign: 5 % of the largest value are 76 % of the sign
KNEES = (0.005, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7)  # of the largest value, where a tanh or a dead band bends
LEVELS = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9)  # of the range, at which something begins
REACHES = (
    0.03,
    0.06,
    0.1,
    0.15,
)  # of the range, to which a pull to a place reaches: from a notch to a third of the way
HILLS = 8  # that stand along a way, where any curve of it is asked for
REFINED = 4  # formulas of one number of terms, of which knees are refined
STEPS = 4  # in which a knee is refined: to a sixteenth of the distance of its grid
BINS, BINS_EACH = 4096, 8  # of a signal's range, over which errors are summed; of each period of a wave, at least
LOWEST = 2  # periods over the range: fewer are a curve
PEAKS = 2  # waves of a signal that are tried
CHANCE = 1e-3  # of so high a peak anywhere in a periodogram of noise
NUMBERS = "KNEE", "REACH"  # as they stand in a form
LONG, LONGEST = 3, 4  # what there is to read of a function with a number in it, or a cube; of a wave. Others: 1 or 2
KNOTS = 13  # of a curve
STIFF = 1e-3  # of the curvature of the cost by a knot: so much counts that a curve bends there


@dataclass(frozen=True)
class Shape:
    """Functions of one or two signals, with one coefficient each.

    forms: expressions, with KNEE and REACH where `numbers` stand that may move by `steps`. kind: what it does, in a
    word. weight: how much there is to read.
    """

    forms: tuple[str, ...]
    kind: str
    weight: int
    numbers: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()

    @property
    def texts(self) -> tuple[str, ...]:
        found = self.forms
        for name, number in zip(NUMBERS, self.numbers, strict=False):
            found = tuple(form.replace(name, f"{number:.5g}").replace("- -", "+ ") for form in found)
        return found


@dataclass(frozen=True)
class Formula:
    """A term of a place: a sum of shapes. share: of the misfit, that it takes on stretches it was not fitted to.

    as_well: the places and signals of which a term is not told apart from it.
    """

    place: Place
    shapes: tuple[Shape, ...]
    share: float
    as_well: tuple[tuple[Place, tuple[str, ...]], ...] = ()

    @property
    def texts(self) -> list[str]:
        return [text for shape in self.shapes for text in shape.texts]

    @property
    def depends_on(self) -> list[str]:
        return list(dict.fromkeys(name for text in self.texts for name in sorted(names([text]))))

    @property
    def kinds(self) -> list[str]:
        return list(dict.fromkeys(shape.kind for shape in self.shapes))

    @property
    def weight(self) -> int:
        return sum(shape.weight for shape in self.shapes)


@dataclass(frozen=True)
class Where:
    """A place, signals there, and the cost that their smooth functions save."""

    place: Place
    variables: tuple[str, ...]
    gain: float


@dataclass(frozen=True)
class Curve:
    """A term over one signal: at its knots the value with the ends of its 95 % interval, each (knots,)."""

    signal: str
    at: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Judge:
    """What sets of columns save on alternate stretches, with coefficients from the other ones (halves.py).

    columns: key -> (windows, rows).
    """

    def __init__(self, base: Fit, columns: Mapping[str, np.ndarray]):
        made = [nothing(base), *(column[:, :, None] for column in columns.values())]
        self._halves = Halves.of(base, np.concatenate(made, axis=2))
        self._at = {key: i for i, key in enumerate(columns)}
        self.plain = self._halves.saved([])

    def knows(self, keys: Iterable[str]) -> bool:
        return {*keys} <= {*self._at}

    def gain(self, keys: Iterable[str]) -> float:
        """The cost that these columns save beyond what the parameters alone do."""
        return self._halves.saved([self._halves.k + self._at[key] for key in dict.fromkeys(keys)]) - self.plain


class Finder:
    """Finds a formula for what the base of `forced` leaves."""

    def __init__(self, forced: Forced):
        self.forced = forced

    @cached_property
    def misfit(self) -> float:
        """Cost beyond that of the noise, and beyond what the parameters save."""
        squares = float(np.sum(self.forced.base.projected**2))
        return squares - self.forced.expected - Judge(self.forced.base, {}).plain

    def judge(self, place: Place, texts: Iterable[str]) -> Judge:
        return Judge(self.forced.base, {text: self.forced.column(place, text) for text in dict.fromkeys(texts)})

    def found(self) -> Formula | None:
        """The formula; None where there is no misfit, or no signal explains any."""
        if not (self.forced.places and self.misfit > LEAST * self.forced.expected):
            return None
        place, variables, gain = self.where
        if place[0].startswith(SENSOR):
            return Formula(place, (), gain / self.misfit)
        formula = self.written(place, self.pool(variables))
        return formula if formula is not None and formula.share > WORTH else None

    @property
    def where(self) -> tuple[Place, tuple[str, ...], float]:
        """The place, the signals, at most two, whose smooth functions save most there, and the cost that they save.

        The place may be a sensor at fault.
        """
        best = self.ranked[0]
        return best.place, best.variables, best.gain

    @cached_property
    def ranked(self) -> list["Where"]:
        """Places and the signals there, by what their smooth functions save beyond their price: the best first."""
        groups = {
            v: [*self._smooth(v), *(t for wave in self._waves(v) for t in wave.texts)] for v in self.forced.signals
        }
        found: list[Where] = []
        for place, variables in self.forced.places.items():
            judge = self.judge(place, [ONE, *(t for v in variables for t in groups[v])])
            alone = {v: judge.gain([ONE, *groups[v]]) for v in variables}
            found.append(Where(place, (), judge.gain([ONE])))
            found += [Where(place, (v,), gain) for v, gain in alone.items()]
            best = sorted(alone, key=lambda v: -alone[v])[:BEST]
            both = {pair: self._products(*pair) for pair in combinations(best, 2)}
            judge = self.judge(
                place, [ONE, *(t for v in best for t in groups[v]), *(t for p in both.values() for t in p)]
            )
            for (v, r), products in both.items():
                gain = judge.gain([ONE, *groups[v], *groups[r], *products])
                found.append(Where(place, (v, r), gain))
        found += self._sensors()
        worth = WORTH * self.misfit
        return sorted(found, key=lambda there: (len(there.variables) * worth - there.gain, there.place))

    def _sensors(self) -> list["Where"]:
        """What faults of each sensor save, less the price of a further term."""
        base = self.forced.base
        found: list[Where] = []
        columns: dict[str, dict[str, np.ndarray]] = {}
        for (place, name), column in sensors(base).items() if self.forced.told else ():
            rows = base.likelihood.rows(column[:, :, None], base.temper)
            columns.setdefault(place, {})[name] = base.likelihood.eliminate(rows, None, base.basis)[0][:, :, 0]
        for place, of in columns.items():
            gain = Judge(base, of).gain(of) - WORTH * self.misfit
            found.append(Where((place,), (place.removeprefix(SENSOR),), gain))
        return found

    @staticmethod
    def _products(v: str, r: str) -> list[str]:
        return [f"{v} * {r}", f"abs({v}) * {r}", f"{v} * abs({r})"]

    def _smooth(self, v: str) -> list[str]:
        """A few functions of a signal that any curve is like."""
        low, high = self._ends(v)
        z = f"(({v} - {(low + high) / 2!r}) / {(high - low) / 2!r})"
        bent = f"tanh({SHARP / max(-low, high)!r} * {v})" if low < 0 < high else f"{z}**4"
        centres = np.linspace(low, high, HILLS) if self.forced.is_place(v) else ()
        wide = (high - low) / (HILLS - 1)
        return [v, f"{z}**2", f"{z}**3", bent, *(f"exp(-(({v} - {at!r}) / {wide!r})**2)" for at in map(float, centres))]

    def _ends(self, v: str) -> tuple[float, float]:
        signal = self.forced.signals[v]
        return float(signal.min()), float(signal.max())

    def _waves(self, v: str) -> list[Shape]:
        """Sines of a signal at the highest peaks of the errors' periodogram over it."""
        signal, (low, high) = self.forced.signals[v], self._ends(v)
        at = np.minimum(((signal - low) / (high - low) * BINS).astype(int), BINS - 1)
        found = []
        for errors in self.forced.base.errors.T:
            binned = np.bincount(at, errors - errors.mean(), BINS)
            power = np.abs(np.fft.rfft(binned))[LOWEST : BINS // BINS_EACH] ** 2
            height = float(power.max() / (np.median(power) + TINY))
            if height > np.log2(len(power) / CHANCE):  # an exponential distribution has its median at log 2
                found.append((height, 2 * np.pi * (LOWEST + int(np.argmax(power))) / (high - low)))
        peaks = [f for _, f in sorted(found, reverse=True)[:PEAKS]]
        forms, step = (f"sin(KNEE * {v})", f"cos(KNEE * {v})"), np.pi / (high - low)
        return [Shape(forms, "periodic", LONGEST, (f,), (step,)) for f in peaks]

    def pool(self, variables: Sequence[str]) -> list[Shape]:
        """The functions of which a formula in these signals is made."""
        pool = [Shape((ONE,), "constant", 1)]
        for v in variables:
            pool += self._shapes(v)
        return pool + (self._pairs(*variables) if len(variables) == 2 else [])

    def _pairs(self, v: str, r: str) -> list[Shape]:
        """The functions of two signals."""
        found = [Shape((f"{v} * {r}",), "product", 2)]
        for one, other in ((v, r), (r, v)):
            found.append(Shape((f"{one}**2 * {other}",), "product", LONG))
            if self._ends(other)[0] >= 0:
                root = f"sqrt(abs({bare(other)}))"
                found.append(Shape((f"{one} * {root}",), "product", LONG))
                found.append(Shape((f"{one}**2 * {root}",), "product", LONGEST))
            if self._turns(one):
                sign = f"tanh({SHARP / max(map(abs, self._ends(one))):.4g} * {one})"
                found.append(Shape((f"abs({one}) * {other}",), "product", LONG))
                found.append(Shape((f"{sign} * {other}",), "product", LONGEST))
        return found

    def _turns(self, v: str) -> bool:
        """Whether a signal changes its sign."""
        low, high = self._ends(v)
        return low < 0 < high

    def _shapes(self, v: str) -> list[Shape]:
        """The functions of one signal."""
        low, high = self._ends(v)
        most, inside = max(-low, high), bare(v)
        found = [Shape((v,), "linear", 1), Shape((f"{v}**2",), "even", 2), Shape((f"{v}**3",), "odd", LONG)]
        if low < 0 < high:
            found += [Shape((f"abs({inside})",), "even", 2), Shape((f"{v} * abs({inside})",), "odd", 2)]
            band = f"(max({inside} - KNEE, 0.0) + min({inside} + KNEE, 0.0))"
            bent = {f"tanh({v} / KNEE)": "saturating", band: "threshold"}
            knees = [knee * most for knee in KNEES]
            found += [Shape((form,), kind, LONG, (knee,), (knee,)) for form, kind in bent.items() for knee in knees]
        else:
            found.append(Shape((f"sqrt(abs({inside}))",), "root", 2))
        levels = [low + level * (high - low) for level in LEVELS]
        sided = f"(max({inside}, KNEE) - KNEE)", f"(min({inside}, KNEE) - KNEE)"
        step = (high - low) / len(levels)
        found += [Shape((form,), "threshold", LONG, (level,), (step,)) for form in sided for level in levels]
        local = self._pulls(v, levels, step) if self.forced.is_place(v) else []
        return found + local + self._waves(v)

    def _pulls(self, v: str, levels: Sequence[float], step: float) -> list[Shape]:
        """What acts near a place alone, to both sides of it or towards it, as a magnet does or a notch."""
        low, high = self._ends(v)
        off = f"(({bare(v)} - KNEE) / REACH)"
        forms = f"exp(-{off}**2)", f"({bare(v)} - KNEE) * exp(-{off}**2)"
        numbers = [(level, reach * (high - low)) for reach in REACHES for level in levels]
        return [Shape((form,), "local", LONGEST, n, (step, n[1] / 2)) for form in forms for n in numbers]

    def written(self, place: Place, pool: list[Shape]) -> Formula | None:
        """The formula of the fewest terms from `pool` to which a further one adds little."""
        best, judge = None, self.judge(place, (t for shape in pool for t in shape.texts))
        for size in range(1, TERMS + 1):
            trials = self.trials(best, pool, size)
            if not trials:
                break
            if best and not judge.knows(best.texts):
                judge = self.judge(place, (t for shape in (*pool, *best.shapes) for t in shape.texts))
            tried = [Formula(place, tuple(t), judge.gain(x for s in t for x in s.texts) / self.misfit) for t in trials]
            tried += [self.refined(formula) for formula in self._hopeful(tried)]
            most = max(formula.share for formula in tried)
            if best and not self.worth(most, best.share):
                break
            near = [formula for formula in tried if self.alike(formula.share, most)]
            best = self.polished(min(near, key=lambda f: (f.weight, -f.share)))
        return best

    def trials(self, best: Formula | None, pool: Sequence[Shape], size: int) -> list[list[Shape]]:
        """The sums of so many shapes that are tried: those that add one to the `best` of before, and any two."""
        found = [[*best.shapes, s] for s in pool if s not in best.shapes] if best else [[s] for s in pool]
        return found + ([list(pair) for pair in combinations(pool, 2)] if size == 2 else [])

    def worth(self, share: float, before: float) -> bool:
        """Whether a formula with a further term, which takes `share`, is worth that term."""
        return share >= before + WORTH

    def polished(self, formula: Formula) -> Formula:
        """The formula with its knees as they stay."""
        return formula

    def alike(self, share: float, most: float) -> bool:
        """Whether a formula that takes this share is as good as the best."""
        return share >= most - ALIKE

    @staticmethod
    def _hopeful(tried: list[Formula]) -> list[Formula]:
        """The best formulas that differ in more than where they bend."""
        best: dict[tuple, Formula] = {}
        for formula in sorted(tried, key=lambda f: -f.share):
            best.setdefault(tuple(shape.forms for shape in formula.shapes), formula)
        return list(best.values())[:REFINED]

    def refined(self, formula: Formula, steps: Sequence[int] = range(1, STEPS + 1)) -> Formula:
        """The formula with each knee where most is saved. steps: how often the step is halved in each."""
        for i, shape in enumerate(formula.shapes):
            for halvings, (j, step) in product(steps, enumerate(shape.steps)):
                moved = [self._bent(formula, i, j, by / 2**halvings) for by in (-step, step)]
                formula = max([formula, *moved], key=lambda f: f.share)
        return formula

    def _bent(self, formula: Formula, i: int, j: int, by: float) -> Formula:
        shape = formula.shapes[i]
        numbers = *shape.numbers[:j], shape.numbers[j] + by, *shape.numbers[j + 1 :]
        shapes = (*formula.shapes[:i], replace(shape, numbers=numbers), *formula.shapes[i + 1 :])
        moved = replace(formula, shapes=shapes)
        return replace(moved, share=self.judge(formula.place, moved.texts).gain(moved.texts) / self.misfit)

    def coefficients(self, formula: Formula) -> np.ndarray:
        """Of its texts (n,): by the linearised fit to the whole recording."""
        columns = np.stack([self.forced.column(formula.place, text) for text in formula.texts], axis=2)
        units = np.array([self.forced.unit(formula.place, text) for text in formula.texts])
        return self._solved(columns)[len(self.forced.base.unknowns) :] * units

    def curve(self, formula: Formula) -> Curve | None:
        """What is missing over the signal of a formula, with no formula behind it; None where it has several.

        The plant's parameters are as the formula has them: what they could take as well is not in the band.
        """
        used = {*formula.depends_on}
        signals = [v for v in self.forced.places[formula.place] if names([v]) == used and bare(v) in formula.texts[-1]]
        if len(signals) != 1:
            return None
        (v,), forced, base = signals, self.forced, self.forced.base
        columns = np.stack([forced.column(formula.place, text) for text in formula.texts], axis=2)
        moved = base.slopes @ self._solved(columns)[: len(base.unknowns)]
        signal, at, size = forced.signals[v], self._knots(v), forced.size[formula.place]
        hats = [forced.changed(formula.place, size * np.interp(signal, at, hat)) for hat in np.eye(len(at))]
        flat, left = np.stack(hats, axis=2).reshape(-1, len(at)), (base.projected + moved).reshape(-1)
        normal = flat.T @ flat
        bend = np.diff(np.eye(len(at)), 2, axis=0)
        normal += STIFF * float(np.mean(np.diag(normal))) * bend.T @ bend
        covariance = np.linalg.pinv(normal, hermitian=True)
        value = -(covariance @ (flat.T @ left))
        wide = NORMAL * np.sqrt(np.diag(covariance) * max(1.0, float(np.mean((left + flat @ value) ** 2))))
        return Curve(v, at, value * size, (value - wide) * size, (value + wide) * size)

    def _knots(self, v: str) -> np.ndarray:
        """Where a curve may bend: as often as the signal is there, and close to 0 where it changes its sign."""
        low, high = self._ends(v)
        at = np.quantile(self.forced.signals[v], np.linspace(0.0, 1.0, KNOTS))
        if low < 0 < high:
            near = KNEES[1] * max(-low, high)
            at = np.append(at[np.abs(at) > 2 * near], [-near, near])
        return np.unique(at)

    def _solved(self, columns: np.ndarray) -> np.ndarray:
        """The step of the parameters, then of `columns` (windows, rows, n), of the linearised fit to all windows."""
        base = self.forced.base
        k, every = len(base.unknowns), np.concatenate([base.slopes, columns], axis=2)
        flat = flattened(every)
        normal, right = flat.T @ flat, -(flat.T @ base.projected.reshape(-1))
        normal[np.diag_indices(k)] += base.weight
        right[:k] -= base.weight * base.numbers
        scale = np.sqrt(np.maximum(np.diag(normal), TINY))
        return np.linalg.solve(normal / np.outer(scale, scale) + RIDGE * np.eye(len(right)), right / scale) / scale


def bare(signal: str) -> str:
    """A signal as it stands alone in the brackets of a function."""
    return signal.removeprefix("(").removesuffix(")")
