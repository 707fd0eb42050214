"""Hypotheses on what a plant leaves out, scored cheaply and fitted in full, one effect after another.

A hypothesis is a set of effects and, at most, one parameter whose tolerance is lifted. A screen over short windows
ranks the hypotheses, for there even a wrong model stays near the recording. The final fit is over longer windows.
"""

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from types import MappingProxyType
from typing import TypedDict

import numpy as np

from greygate.mismatch.coloured import Coloured
from greygate.mismatch.cores import each
from greygate.mismatch.effects import Effect, Free, fitting
from greygate.mismatch.fit import STEP, Fit, Leading, Likelihood, Unknown, tame
from greygate.mismatch.linearised import Normal, index, nothing, pair_gains, released_gains, saving, solve
from greygate.mismatch.model import BEGINS, BLUR, EARLY, MOST_EARLY, TIMING, TINY, Model
from greygate.mismatch.noise import Noise
from greygate.mismatch.rig import FEWEST, IN, Rig
from greygate.mismatch.runs import bent
from greygate.mismatch.scales import memory, span
from greygate.mismatch.several import modelled
from greygate.plants.expressions import names
from greygate.plants.outside import Local
from greygate.plants.recording import Recording
from greygate.progress import Budget, cut

SHORT, SHORT_SHARES = 40, (0.1, 2.0)  # samples of a window in the screen; of the memory of the fastest channel
LONG_WINDOW, LONG_SHARES = 100, (0.25, 5.0)  # in the final fit: two integrators' errors stay below the noise so far
WITHIN, TOLERANCE = 4.0, 2.0  # standard deviations within which a toleranced parameter is fitted; its tolerance
RELEASED = 20.0  # times or part of its value, or times its plus_minus, within which a released parameter is fitted
EXACT, FARTHEST = 0.01, 0.05  # of a sample, RMS and at most: the uncertainty of the instant at which an input acts
MOVED = 4.0  # standard deviations, by which inputs must act early to have moved between the samples;
MIDDLE, SPREAD = MOST_EARLY / 2, MOST_EARLY * 12**-0.5  # then they are early by any part, up to the most, alike
ROUGH = 2.0  # of cost: a fit that only ranks stops when a step gains less
SLACK, LAST_SLACK = 5e-3, 1e-3  # of the cost beyond that of noise: likewise; of any other fit
ADDED, LATE = "offset", "delay"  # the filters that add a constant, and that move all in time
TIMELESS = "dead_zone", "skew", "saturation", "quantum"  # filters without memory: before a delay or behind it, alike
LOST = 0.3  # of a channel's spread, above which its error says that the run is elsewhere
LED = (1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of the recording: to so much a lost run is fitted first
EARLIER = (1 / 64, 1 / 32, *LED)  # what sticks sees few places in so little
ALL: Mapping = MappingProxyType({})  # options of a fit: to the end
LONG = 1.5  # of the travel: the longest period of a wave
WAVES = 2.0  # periods of a scan for each cycle over the travel: neighbours differ by half a cycle
FEWEST_WAVES = 4  # periods of a scan, at least
PERIOD_SCALE = 1e-3  # of its typical value: a period is known that well, for its phase adds up along the travel
SHAPE_SCALE = 0.1  # of its typical value: the step in which another shape parameter is fitted
GUESSES = (0.3, 1.0, 3.0)  # times its typical value, at which a parameter of the plant that becomes free is tried
SECANT_REACH = 3.0  # times the point to which a secant is drawn, beyond which it says nothing
UNBOUNDED = 1e3  # standard deviations that a released parameter may go in the linearised fit: no bound in practice
PLACES = 3  # after the point, of a share
SHAPES = 4  # numbers of a shape that no fit moves, from which fits start: far off, the likeliest is seldom the best
SHORTER = 0.7  # of a window in which the steps of a simulator from outside are not exact
BELOW = 0.5  # of the noise, by which longer steps may err in the screen
SOLVED_PAIRS = 4  # times the pairs that are wanted are solved within bounds, after a ranking without bounds


class Roughly(TypedDict):
    """Options of `Likelihood.fit`."""

    tempered: bool
    iterations: int
    enough: float


ROUGHLY: Roughly = {
    "tempered": True,
    "iterations": 4,
    "enough": ROUGH,
}  # a fit of the data sheet's plant, where effects can be compared


@dataclass(frozen=True)
class Hypothesis:
    """What a plant may lack. effects: keys of the table. released: parameters whose tolerance is lifted."""

    effects: tuple[str, ...] = ()
    released: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " + ".join((*self.effects, *(f"{s} outside its tolerance" for s in self.released))) or "nothing"

    @property
    def size(self) -> int:
        return len(self.effects) + len(self.released)

    def plus(self, other: "Hypothesis") -> "Hypothesis":
        return Hypothesis((*self.effects, *other.effects), (*self.released, *other.released))

    def without(self, name: str) -> "Hypothesis":
        """The same less one effect or released parameter."""
        return Hypothesis(*(tuple(n for n in names if n != name) for names in (self.effects, self.released)))


@dataclass(frozen=True)
class Score:
    """gain: the cost that a linearised fit saves. values: where the full fit starts.

    others: where it starts, too, if its shape is a number that no fit moves.
    """

    hypothesis: Hypothesis
    gain: float
    values: Mapping[str, float]
    others: tuple[Mapping[str, float], ...] = ()


class Search:
    """All hypotheses on one recording of one rig.

    noise: of every likelihood; by default as rig.toml tells it, or as every fit leaves it where that tells none.
    within: standard deviations that a parameter with a tolerance may go.
    """

    def __init__(
        self,
        rig: Rig,
        recording: Recording,
        effects: Mapping[str, Effect],
        noise: Noise | None = None,
    ):
        self.rig = rig
        self.effects = fitting(rig.plant, rig.datasheet, effects)
        self.travel = max((float(np.ptp(recording[name])) for name in rig.inputs), default=0.0)
        self.sheet = rig.uncertain()
        self.toleranced = list(self.sheet)

        self.part = self  # where hypotheses are compared: stretches of the recording, where all of it is too dear
        self.final, self.screen = self._likelihoods(recording)
        self.within = WITHIN
        self.budget, self.untried = Budget(), dict[str, None]()  # what there was no time for
        self.checked = False  # whether its columns are what rig.toml says (`misread`)
        self.unseen = False  # whether the held-out recording decides nothing
        self.between = False  # whether inputs moved between the samples
        self.leading: dict[tuple, Leading] = {}  # of a recording in windows
        self.fits: dict[Hypothesis, Fit] = {}  # of rivals, kept for experiments that tell them apart
        if noise is not None:
            self.under(noise)

    def _likelihoods(self, recording: Recording) -> tuple[Likelihood, Likelihood]:
        """Over longer windows and over shorter ones; of a free run, which is one window, both are the same."""
        rig = self.rig
        longest = rig.window
        if not longest:
            free_run = (Likelihood if rig.stated else Coloured)(modelled(rig, recording, self.effects))
            return free_run, free_run
        if isinstance(rig.plant.outside, Local):
            rig = replace(rig, plant=replace(rig.plant, outside=rig.plant.outside.near(recording.channels)))
        memories = [memory(run[name]) for run in recording.runs for name in rig.predict]

        long, short = (
            min(span(samples, memories, shares, FEWEST), longest)
            for samples, shares in ((LONG_WINDOW, LONG_SHARES), (SHORT, SHORT_SHARES))
        )
        final, screen = (modelled(rig, recording, self.effects, window) for window in (long, short))
        while long > short and not _exact(final):
            long = max(round(long * SHORTER), short)
            final = modelled(rig, recording, self.effects, long)
        screen = _in_fewer_steps(screen)
        return Likelihood(final), Likelihood(screen)

    @property
    def starts(self) -> dict[str, float]:
        """Unknown that says how far a state begins off its reading -> one standard deviation of that."""
        return {key: found for model in self.final.model.each for key, found in model.unsure.items()}

    @property
    def kept(self) -> set[str]:
        """What a fit takes from the one before."""
        return {*self.toleranced, TIMING, EARLY, BLUR, *self.starts}

    @property
    def noise(self) -> Noise:
        return self.final.noise

    @property
    def searched(self) -> float:
        """The share of the recording that is the part in which hypotheses are compared."""
        part, whole = (s.final.model.recording.samples for s in (self.part, self))
        return round(part / whole, PLACES)

    def over(self, recording: Recording) -> "Search":
        """The same search in another recording, whose likelihoods are its own."""
        other = copy.copy(self)
        other.part = other
        other.final, other.screen = self._likelihoods(recording)
        return other

    def take(self, other: "Search") -> None:
        """What another search has learnt, or was given."""
        self.under(other.noise)
        self.effects, self.within, self.between = other.effects, other.within, other.between

    def in_part(self, fit: Fit) -> Fit:
        """A fit to the whole recording, as it is in the part that is searched."""
        part = self.part.final
        return fit if _over(fit, part) else part.fit(self.part.begun(fit.unknowns), fit.values, iterations=0)

    def in_whole(self, fit: Fit) -> Fit:
        """A fit to the part that is searched, fitted to the whole recording."""
        return fit if _over(fit, self.final) else self.final.fit(self.begun(fit.unknowns), fit.values)

    def begun(self, unknowns: Iterable[Unknown]) -> list[Unknown]:
        """Unknowns with the begins of this search's recordings in the place of those of others."""
        own = [Unknown(key, 0.0, deviation, 1.0) for key, deviation in self.starts.items()]
        return [*(u for u in unknowns if not u.symbol.startswith(BEGINS)), *own]

    def under(self, noise: Noise) -> "Search":
        """This search with another noise; fits of the one before are no longer comparable."""
        self.final.noise = self.screen.noise = noise
        self.leading = {}
        return self

    def skips(self, hypothesis: Hypothesis) -> bool:
        """Whether there is no time left for a hypothesis; it is noted."""
        return self.left_out(str(hypothesis))

    def left_out(self, what: str) -> bool:
        """Whether there is no time left for something; it is noted."""
        if self.budget.over:
            self.untried[what] = None
        return self.budget.over

    # -- unknowns ----------------------------------------------------------------------------------------------------

    def unknowns(self, hypothesis: Hypothesis, within: float | None = None) -> list[Unknown]:
        """What a hypothesis leaves free. within: by default that of this search."""
        found, within = [], within or self.within
        for symbol in self.toleranced:
            p = self.sheet[symbol]
            scale = p.reach / 2
            if symbol in hypothesis.released:
                low, high = sorted((p.value / RELEASED, p.value * RELEASED))
                if p.plus_minus:  # it may have either sign
                    low, high = p.value - RELEASED * p.reach, p.value + RELEASED * p.reach
                found.append(Unknown(symbol, p.value, scale, np.inf, low, high))
            else:
                reach = within * scale
                found.append(Unknown(symbol, p.value, scale, 1.0, p.value - reach, p.value + reach))
        if TIMING in self.final.model.values:
            own = self.final.model.each[0].early_by
            scale, reach = max(EXACT * self.rig.dt, own), max(FARTHEST * self.rig.dt, 2 * own)
            found.append(Unknown(TIMING, 0.0, scale, 1.0, -reach, reach))
        found = self.begun(found)
        if self.between:
            found.append(Unknown(EARLY, MIDDLE, SPREAD, 1.0, 0.0, MOST_EARLY))
        if self.final.model.finer and any("a" in self.effects[key].depends_on for key in hypothesis.effects):
            found.append(Unknown(BLUR, 0.0, 1.0, 2.0))
        for key in hypothesis.effects:
            for f in self.effects[key].free:
                if not f.whole and f.symbol not in (u.symbol for u in found):
                    found.append(self._unknown(f))
        return found

    def _unknown(self, f: Free) -> Unknown:
        origin = f.typical if f.shape else 0.0
        if f.shape and f.scan == "wave":
            longest = max(min(f.high, LONG * self.travel), f.low)
            return Unknown(f.symbol, origin, PERIOD_SCALE * f.typical, np.inf, f.low, longest)
        return Unknown(f.symbol, origin, f.typical * (SHAPE_SCALE if f.shape else 1.0), np.inf, f.low, f.high)

    def constants(self, hypothesis: Hypothesis) -> dict[str, float]:
        return {s: v for key in hypothesis.effects for s, v in self.effects[key].set.items()}

    def places(self, symbol: str) -> list[str]:
        """The equations in which a parameter acts; where no effect names an equation, those that use what it makes."""
        named = {place for effect in self.effects.values() for place in effect.equations}
        plant = self.rig.plant
        texts: dict[str, tuple[str, Iterable[str]]]  # place -> (what it makes, its expressions)
        texts = {name: (d.symbol, d.terms.values()) for name, d in plant.definitions.items()}
        for name, e in plant.equations.items():
            state = plant.states[e.state]
            bounds = [b for b in (state.low, state.high) if isinstance(b, str)]
            texts[name] = (e.state, (*e.texts, *bounds))
        found, new, seen = [], [symbol.partition(IN)[0]], set()
        while new:
            used = new.pop()
            for place, (makes, expressions) in texts.items():
                if place in seen or used not in names(expressions):
                    continue
                seen.add(place)
                if place in named:
                    found.append(place)
                else:
                    new.append(makes)
        return sorted(found, key=list(texts).index)

    # -- cheap scores ------------------------------------------------------------------------------------------------

    def candidates(self, given: Hypothesis) -> list[Hypothesis]:
        """What may be added to a hypothesis."""
        out = [Hypothesis((key,)) for key, effect in self.effects.items() if self.joined(given, effect)]
        if not given.released:
            out += [Hypothesis((), (s,)) for s in self.toleranced]
        return out

    def joined(self, given: Hypothesis, effect: Effect) -> bool:
        """Whether an effect may stand beside the given ones.

        It is no other form of one of them, shares no parameter with them, and filters none of their inputs, unless one
        of both only adds a constant there, or one delays it and the other has no memory.
        """
        others = [self.effects[key] for key in given.effects]
        symbols = {f.symbol for other in others for f in other.free}
        filtered = [(name, kind) for other in others for name, kind in _shaped(other)]
        return (
            effect.id not in (other.id for other in others)
            and not symbols & {f.symbol for f in effect.free}
            and all(
                name != same or (kind == LATE and other in TIMELESS) or (other == LATE and kind in TIMELESS)
                for name, kind in _shaped(effect)
                for same, other in filtered
            )
        )

    def scores(self, fit: Fit, given: Hypothesis) -> list[Score]:
        """What every candidate promises to save, by a fit linearised at `fit`; best first."""
        candidates = [c for c in self.candidates(given) if not self.skips(given.plus(c))]
        plain = saving(fit) if candidates else 0.0

        def best(candidate: Hypothesis) -> list[Score] | None:
            with cut():
                found = sorted(self._promises(fit, candidate, plain), key=lambda s: -s.gain)
                more = [s.values for s in found[1:SHAPES] if s.gain > 0] if self._stays(candidate) else ()
                return [replace(s, others=tuple(more)) for s in found[:1]]
            return None  # for want of time

        ranked = []
        for candidate, found in zip(candidates, each(best, candidates), strict=True):
            ranked += [score for score in found or () if score.gain > 0]
            if found is None:
                self.untried[str(given.plus(candidate))] = None
        return sorted(ranked, key=lambda s: -s.gain)

    def _stays(self, candidate: Hypothesis) -> bool:
        """Whether a shape of a candidate is one of several numbers, which no fit moves to another."""
        free = (f for key in candidate.effects for f in self.effects[key].free)
        return any(f.shape and f.whole and len(f.guess) > 1 for f in free)

    def pairs(self, fit: Fit, count: int) -> list[Score]:
        """The `count` pairs that together promise most at `fit`, where each alone may promise little.

        A pair is of two effects, or of an effect and a parameter whose tolerance is lifted: `count` of each kind.
        """
        effects, blocks = [e for e in self.effects.values() if self.joined(Hypothesis(), e)], []
        with cut():
            blocks = [(effect, *found) for effect in effects for found in self.directions(fit, effect)]
        if not blocks:
            return []
        normal = Normal.of(fit, np.concatenate([b[-1] for b in blocks], axis=2))
        widths = [b[-1].shape[2] for b in blocks]
        gains = pair_gains(normal, widths)
        two, beside = [], []
        for one, other in combinations(effects, 2):
            if self.joined(Hypothesis((one.key,)), other):
                mine, others = (np.flatnonzero([b[0] is e for b in blocks]) for e in (one, other))
                part = gains[np.ix_(mine, others)]
                if not part.size:
                    continue  # one of them has no shape that this travel could show
                i, j = np.unravel_index(np.argmax(part), part.shape)
                two.append((part[i, j], (mine[i], others[j]), ""))
        for symbol in self.toleranced:
            gains = released_gains(normal, widths, index(fit, symbol))
            for effect in effects:
                mine = np.flatnonzero([b[0] is effect for b in blocks])
                if mine.size:
                    i = mine[np.argmax(gains[mine])]
                    beside.append((gains[i], (i,), symbol))
        plain = saving(fit)

        def most(found: list) -> list[Score]:
            out = []
            for _, at, symbol in sorted(found, key=lambda pair: pair[0], reverse=True)[: SOLVED_PAIRS * count]:
                values, gain = self._within(fit, [blocks[i] for i in at], symbol)
                hypothesis = Hypothesis(tuple(blocks[i][0].key for i in at), (symbol,) if symbol else ())
                out.append(Score(hypothesis, gain - plain, values))
            return sorted(out, key=lambda score: -score.gain)[:count]

        return most(two) + most(beside)

    def _promises(self, fit: Fit, candidate: Hypothesis, plain: float) -> Iterable[Score]:
        """Of a candidate in each of its shapes. plain: the cost that the unknowns save without it."""
        if candidate.released:
            values, gain = self._within(fit, [], candidate.released[0])
            yield Score(candidate, gain - plain, values)
            return
        effect = self.effects[candidate.effects[0]]
        for found in self.directions(fit, effect):
            values, gain = self._within(fit, [(effect, *found)])
            yield Score(candidate, gain - plain, values)

    def _within(
        self, fit: Fit, blocks: Sequence[tuple[Effect, dict, dict, np.ndarray]], released: str = ""
    ) -> tuple[dict, float]:
        """(values, gain) of the linearised fit of some effects, each in one shape, within all bounds.

        released: a parameter whose tolerance is lifted beside them.
        """
        weight, room, prior = fit.weight, fit.room, 0.0
        if released:
            j = index(fit, released)
            weight, prior = weight.copy(), float(weight[j] * fit.numbers[j] ** 2)
            weight[j], room[j] = 0.0, (-UNBOUNDED, UNBOUNDED)
        reach, columns = [], [nothing(fit)]
        for effect, _, point, made in blocks:
            strengths = effect.strengths
            reach += [(0.0, SECANT_REACH)] if point else [(f.low / f.typical, f.high / f.typical) for f in strengths]
            columns.append(made)
        bounds = np.concatenate([room, np.reshape(reach, (-1, 2))])
        step, gain = solve(fit, np.concatenate(columns, axis=2), bounds, weight)
        values, at = {}, len(fit.unknowns)
        if released:
            values[released] = fit.unknowns[j].value(fit.numbers[j] + step[j])
        for effect, shape, point, made in blocks:
            size = step[at : (at := at + made.shape[2])]
            if point:
                found = {s: v * float(size[0]) for s, v in point.items()}
            else:
                found = {f.symbol: f.typical * float(x) for f, x in zip(effect.strengths, size, strict=True)}
            limits = {f.symbol: (f.low, f.high) for f in effect.free}
            values |= {**shape, **{s: float(np.clip(v, *limits[s])) for s, v in found.items()}}
        return values, gain + prior

    def directions(self, fit: Fit, effect: Effect) -> Iterable[tuple[dict, dict, np.ndarray]]:
        """(shape, point, columns) for every shape on the effect's grid: how the effect moves the errors there.

        columns: (windows, rows, n), from which the windows' shifts are eliminated. They are slopes, one for each
        strength, where `point` is empty; else one secant from no effect to the sizes `point`.
        """
        likelihood, (rough, gives, base) = fit.likelihood, fit.rough
        add = None if self.points(effect) != [{}] else likelihood.model.added(effect, fit.values)
        answer = rough.model.answering(effect, fit.values, fit.shifts * likelihood.local_scale)

        def answered(adds: Callable[[Mapping[str, float]], np.ndarray], size: Mapping[str, float]) -> np.ndarray:
            return likelihood.rows(tame(-likelihood.white(adds(size))), fit.temper)

        for shape in self._shapes(effect):
            values = {**fit.values, **effect.set, **shape}
            for point in self.points(effect):
                if answer and point:
                    columns = answered(answer, {**effect.set, **shape, **point})[:, :, None]
                elif answer:
                    null = {**effect.set, **shape, **{f.symbol: 0.0 for f in effect.strengths}}
                    made = [answered(answer, {**null, f.symbol: STEP * f.typical}) / STEP for f in effect.strengths]
                    columns = np.stack(made, axis=2)
                elif point:
                    moved = gives({**values, **point}, fit.shifts)
                    columns = likelihood.rows(tame(moved - base), fit.temper)[:, :, None]
                elif add is not None:
                    null = {f.symbol: 0.0 for f in effect.strengths}
                    made = [add({**shape, **null, f.symbol: f.typical}) for f in effect.strengths]
                    columns = likelihood.rows(-likelihood.white(np.stack(made, axis=2)), fit.temper)
                else:
                    start = {**values, **{f.symbol: 0.0 for f in effect.strengths}}
                    unknowns = [self._unknown(f) for f in effect.strengths]
                    yield shape, point, fit.by(unknowns, start)
                    continue
                yield shape, point, likelihood.eliminate(columns, None, fit.basis)[0]

    def points(self, effect: Effect) -> list[dict[str, float]]:
        """Sizes of an effect at which it is simulated, where its slope at no effect says too little; else {}."""
        guesses = {f.symbol: f.guess for f in effect.strengths if f.guess}
        if not guesses:
            if effect.frees:
                return [{f.symbol: f.typical * m for f in effect.strengths} for m in GUESSES]
            return [{}]
        return [dict(zip(guesses, values, strict=True)) for values in product(*guesses.values())]

    def _shapes(self, effect: Effect) -> list[dict[str, float]]:
        grids: dict[str, Iterable[float]] = {}
        for f in effect.free:
            if not f.shape:
                continue
            if f.scan == "wave":
                longest = min(f.high, LONG * self.travel)
                if longest <= f.low:
                    return []
                first, last = 1.0 / longest, 1.0 / f.low
                count = max(int((last - first) * self.travel * WAVES), FEWEST_WAVES)
                grids[f.symbol] = 1.0 / np.linspace(first, last, count)
            else:
                grids[f.symbol] = f.guess or (f.typical,)
        return [dict(zip(grids, map(float, v), strict=True)) for v in product(*grids.values())]

    # -- full fits ---------------------------------------------------------------------------------------------------

    def base(self, likelihood: Likelihood, values: Mapping[str, float] | None = None) -> Fit:
        """The fit of the plant without any effect, its parameters near the data sheet; it begins there, or at `values`.

        Where it shows that inputs moved between the samples, all further fits allow for that.
        """
        known = {s: v for s, v in (values or {}).items() if s in self.toleranced}
        fit = self.led(likelihood.fit(self.unknowns(Hypothesis(), TOLERANCE), known, **ROUGHLY), **ROUGHLY)
        return self.base(likelihood, values) if self.moved_between(fit, **ROUGHLY) else fit

    def moved_between(self, fit: Fit, **how) -> bool:
        """Whether a fit is the first to show that inputs moved between the samples: from now on fits allow for that.

        Nothing acts before its cause: an input that seems to did move in between. A delay that the fit lacks may hide
        that, so any is allowed beside it here. how: as for `led`.
        """
        if self.between or not self.rig.window or not self.rig.inputs or not np.isfinite(fit.cost):
            return False
        if fit.values[TIMING] < -MOVED * EXACT * self.rig.dt:
            self.between = True
            return True
        others = [u for u in fit.unknowns if u.symbol != TIMING]
        free = Unknown(TIMING, 0.0, self.rig.dt), Unknown(EARLY, 0.0, SPREAD, np.inf, 0.0, MOST_EARLY)
        again = fit.likelihood.fit([*others, *free], fit.values, fit.shifts, **{**how, "enough": ROUGH})
        self.between = again.values[EARLY] > MOVED * again.deviation(EARLY)
        return self.between

    @property
    def leads(self) -> bool:
        """Whether a fit may be led from the data sheet: of a plant whose runs are cheap."""
        return self.rig.plant.outside is None

    def lost(self, fit: Fit) -> bool:
        """Whether a free run does not follow the recording: a channel errs by three tenths of what it moves."""
        return not self.rig.window and not np.all(_astray(fit) <= LOST)

    def led(self, fit: Fit, **how) -> Fit:
        """A fit, or a better one that is led from the recording's beginning to its end, if its run is lost.

        What turns over once too often has come to another valley; over a short time there is one valley. how: options
        of `Likelihood.fit` with which `fit` was made, and the last part of the way is.
        """
        if self.budget.over or not self.lost(fit):
            return fit
        return min(fit, self._led(fit, LED, ROUGHLY, **how), key=lambda f: float(np.sum(_astray(f))))

    def from_the_sheet(self, fit: Fit) -> Fit:
        """A fit of the same that is led from the data sheet, where an effect does nothing.

        In windows, each of which begins anew, it goes on from where that ends.
        """
        return self._led(fit, (1.0,) if self.rig.window else EARLIER)

    def _led(self, fit: Fit, shares: Sequence[float], way: Mapping = ALL, **how) -> Fit:
        """A fit of the same from the data sheet, and from the recording's beginning to its end.

        way, how: options of the fits on the way, and of the last.
        """
        likelihood, unknowns, values = fit.likelihood, fit.unknowns, dict(fit.fixed)
        pieces = likelihood.model.pieces
        for share in shares:
            later = np.concatenate([np.arange(p.stop - p.start) >= share * (p.stop - p.start) for p in pieces])
            values = likelihood.without(later).fit(unknowns, values, **way).values
        return likelihood.fit(unknowns, values, **how)

    def fit(
        self, likelihood: Likelihood, hypothesis: Hypothesis, values: Mapping[str, float], shifts=None, **options
    ) -> Fit:
        """The full fit of a hypothesis, from `values` on."""
        free = {f.symbol for key in hypothesis.effects for f in self.effects[key].free}
        kept = free | self.kept
        start = {s: v for s, v in values.items() if s in kept}
        start.update(self.constants(hypothesis))
        if likelihood is self.screen and likelihood is not self.final:
            options = {"enough": ROUGH, "slack": SLACK, **options}
        options = {"slack": LAST_SLACK, **options}
        model = likelihood.model
        over = id(model.recording), model.window, *model.locals
        leading = self.leading.setdefault(over, Leading(model.recording))
        return likelihood.fit(self.unknowns(hypothesis), start, shifts, leading=leading, **options)


def _off(model: Model, longer: Model) -> float:
    """By how much longer steps err in the windows of a model, in units of the noise: in the worst channel, RMS.

    What a shift of where a window begins does, too, is no error.
    """
    sigma = np.array([model.rig.channels[name].sigma for name in model.rig.predict])
    return float(np.max(bent(longer.predict(model.values) - model.predict(model.values), model.window) / sigma))


def _exact(model: Model) -> bool:
    """Whether the steps of a simulator from outside err by less than the noise, where a model is in windows.

    A step errs by what twice of it changes.
    """
    twice = [longer for longer in model.longer() if 2 * longer.steps == model.steps] if model.plant.outside else []
    return all(_off(model, longer) <= 1.0 for longer in twice)


def _in_fewer_steps(model: Model) -> Model:
    """The model of a simulator from outside in the longest steps that err by less than the noise in its windows."""
    longer = model.longer() if model.plant.outside else ()
    return next((one for one in longer if _off(model, one) <= BELOW), model)


def _over(fit: Fit, likelihood: Likelihood) -> bool:
    """Whether a fit is over the recording of a likelihood."""
    return fit.likelihood.model.recording is likelihood.model.recording


def _shaped(effect: Effect) -> list[tuple[str, str]]:
    """(a signal that an effect filters by more than a constant, the kind of filter)."""
    kinds = ((name, text.split()[0]) for name, text in effect.filters.items())
    return [(name, kind) for name, kind in kinds if kind != ADDED]


def _astray(fit: Fit) -> np.ndarray:
    """How much each channel's error moves over how much the channel does (channels,), inf where the run diverges."""
    with np.errstate(invalid="ignore", over="ignore"):
        error, target = fit.likelihood.residual(fit.values), fit.likelihood.model.target
        return np.nan_to_num(np.std(error, axis=0) / (np.std(target, axis=0) + TINY), nan=np.inf, posinf=np.inf)
