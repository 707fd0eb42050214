"""The gates that a claim passes before a diagnosis makes it; what fails is dropped, and the diagnosis says why.

1. The interval of an effect's size holds no zero, and a parameter outside its tolerance lies outside it.
2. The recording excites the effect: at its found size it does more than a gain, an offset or nothing would do.
3. Its e-value, on halves of the recording that its fit did not see, bears the name among all on offer (`evidence`).
   Where the noise is coloured, and so what is fast weighs most, the squared error of the run is smaller with it, too.
4. The corrected simulation is on no block worse than the calibrated one, nor that than the data sheet (`blocks`).

A fit that fails the fourth gate is fitted again to what the simulation is judged by: its error in the run of the rig's
rule, as it is. If that fails too, the effect goes whose loss costs least.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from greygate.mismatch.blocks import MORE, Judge, Loss
from greygate.mismatch.coloured import Coloured
from greygate.mismatch.effects import GENERAL, Effect
from greygate.mismatch.evidence import Evidence, borne_out, evidence
from greygate.mismatch.excitation import SEEN, unexcited
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.intervals import interval, least_share, margin
from greygate.mismatch.model import TINY
from greygate.mismatch.search import TOLERANCE, Hypothesis, Search
from greygate.mismatch.several import modelled
from greygate.progress import Progress, silent

DITHER = 0.4  # of a step: noise so large leaves exp(-2 (pi 0.4)^2), 4 %, of the error that steps make
PERCENT = 100
ALONE = 0.1  # of what an effect saves beside another: what it saves without that one is at least so much, mostly
LITTLE = 0.05  # of the calibrated plant's squared error, that two which undo each other must take together
SHARE = 0.02  # of the calibrated plant's squared error, that a name must take alone where no noise is told,
OWN = 0.1  # or of what the others leave of it
HERTZ = "Hz"
ON_BOUND = 1e-6  # relative distance from a bound within which a value lies on it
REFIT = 6  # iterations of a fit to the run itself, which begins near


@dataclass
class Claims:
    """What is left after the gates.

    best, fit: the hypothesis and its fit. calibrated: the fit without effects. refused: one sentence for each claim
    that was dropped or fitted again. evidence, shares: of every effect and parameter that is left, what speaks for it
    and the share of the calibrated plant's squared error that goes with it alone. only_with: name of one -> those
    without which it explains next to nothing, as they do without it. without: name of one -> the fit without it.
    """

    best: Hypothesis
    fit: Fit
    calibrated: Fit
    refused: list[str] = field(default_factory=list)
    evidence: dict[str, Evidence] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)
    only_with: dict[str, list[str]] = field(default_factory=dict)
    without: dict[str, Fit] = field(default_factory=dict)


# -- the first two gates ---------------------------------------------------------------------------------------------


def unborne(search: Search, hypothesis: Hypothesis, fit: Fit) -> dict[str, str]:
    """Key of an effect or symbol of a parameter -> why it is no claim; the least sure first."""
    out = {}
    sure = {key: margin(search.effects[key], fit) for key in hypothesis.effects}
    for key in sorted(sure, key=lambda key: sure[key]):
        effect = search.effects[key]
        if not sure[key] > 1.0 and not least_share(effect, fit):
            out[key] = "the interval of its size holds 0"
        elif why := unexcited(effect, fit.likelihood.model, fit.values):
            out[key] = why
        elif slight := [f.symbol for f in effect.free if f.least and _within(fit, f.symbol)[1] < f.least]:
            out[key] = f"{effect.means}, but by {fit.values[slight[0]]:.2g} of that alone: some other curve"
        elif effect.table == str(GENERAL) and not possible(search, Hypothesis((key,)), fit):
            out[key] = "at the size that fits, it is as large as it can be at all: something else"
        elif not _influence(effect, fit) > SEEN:
            out[key] = "at the size that fits, it changes nothing that the sensors show"
        elif _rounded([effect], fit):
            out[key] = "it moves every channel by less than half a step of what is recorded: it smooths the steps"
    for symbol in hypothesis.released:
        sheet = search.sheet[symbol]
        value, (low, high) = fit.values[symbol], _within(fit, symbol)
        if abs(value - sheet.value) <= sheet.reach or low <= sheet.value <= high:
            out[symbol] = "it does not lie outside its tolerance for certain"
    return out


def possible(search: Search, hypothesis: Hypothesis, fit: Fit) -> bool:
    """Whether the fit runs, no strength lies on its physical bound, and no overtone is larger than its wave."""
    if not np.isfinite(fit.cost):
        return False
    effects = [search.effects[key] for key in hypothesis.effects]
    sizes = [[np.hypot(fit.values[sine], fit.values[cosine]) for sine, cosine in e.wave.values()] for e in effects]
    if any(overtones and max(overtones) > fundamental for fundamental, *overtones in filter(None, sizes)):
        return False  # then it is a wave of the overtone's period
    free = [f for effect in effects for f in effect.strengths]
    return not any(b and np.isclose(fit.values[f.symbol], b, rtol=ON_BOUND) for f in free for b in (f.low, f.high))


def _within(fit: Fit, symbol: str) -> list[float]:
    return interval(fit.values[symbol], fit.deviation(symbol))


def _influence(effect: Effect, fit: Fit) -> float:
    """The squared change of the errors, in units of noise, that the effect makes at its found size."""
    change = fit.likelihood.errors(_undone([effect], fit), fit.shifts) - fit.errors
    return float(np.sum(np.square(np.nan_to_num(change, nan=np.inf))))


def _undone(effects: Iterable[Effect], fit: Fit) -> dict[str, float]:
    """The values of a fit, without some effects."""
    values = dict(fit.values)
    for effect in effects:
        if effect.frees:
            values |= {f.symbol: fit.likelihood.model.values[f.symbol] for f in effect.free}
        else:
            values |= {f.symbol: 0.0 for f in effect.strengths}
    return values


def _rounded(effects: Iterable[Effect], fit: Fit) -> bool:
    """Whether effects move each channel by less than half a step of it, or of an input of its unit.

    Noise of DITHER of a step or more carries what is smaller over the steps: then the steps hide nothing.
    """
    model = fit.likelihood.model
    with_, without = (model.predict({**model.values, **v}) for v in (fit.values, _undone(effects, fit)))
    moved = np.sqrt(np.mean((with_ - without) ** 2, axis=0))
    channels = model.rig.channels

    def step(name: str) -> float:
        alike = (channels[n] for n in (name, *model.rig.inputs) if channels[n].unit == channels[name].unit)
        size = max(channel.resolution for channel in alike)
        return size if channels[name].noise < DITHER * size else 0.0

    steps = [step(name) for name in model.rig.predict]
    return bool(np.all(moved < np.array(steps) / 2))


# -- the fourth ------------------------------------------------------------------------------------------------------


def fitted_by_rule(search: Search, hypothesis: Hypothesis, fit: Fit) -> Fit | None:
    """The hypothesis fitted to the error of the run by the rig's rule, as it is; None where `fit` is that already.

    An autoregression weighs fast errors most, and short windows forget slow ones; this weighs them as they are.
    """
    likelihood = fit.likelihood
    coloured = isinstance(likelihood, Coloured) and likelihood.order
    return _to_the_run(search, hypothesis, fit) if coloured or likelihood.model.window != search.rig.window else None


def fitted_beside(claims: Claims) -> Fit:
    """What is claimed, fitted beside the parameters of the calibrated plant, as they are.

    Where the recording says too little of these, they may move to where a run goes astray.
    """
    had = {u.symbol for u in claims.calibrated.unknowns}
    new = [u for u in claims.fit.unknowns if u.symbol not in had or np.isinf(u.prior)]
    values = {**claims.fit.values, **{s: v for s, v in claims.calibrated.values.items() if s in had}}
    return claims.fit.likelihood.fit(new, values, iterations=REFIT)


def _to_the_run(search: Search, hypothesis: Hypothesis, fit: Fit) -> Fit | None:
    """The same for any fit, each channel weighed by what is left in it; None where it cannot be run.

    Weighed by the sensors' noise, where something is missing the channel of least noise would count for all.
    """
    likelihood = fit.likelihood
    if isinstance(likelihood, Coloured):
        white = likelihood.learnt(likelihood.residual(fit.values), 0)
        again = Likelihood.fit(white, search.unknowns(hypothesis), fit.values)
    else:
        model = modelled(search.rig, likelihood.model.recording, likelihood.model.effects).as_recorded()
        again = Likelihood(model).fit(search.unknowns(hypothesis), fit.values, tempered=True, iterations=REFIT)
    return again if np.isfinite(again.cost) else None


def calibrated_to_the_run(search: Search, judge: Judge, fit: Fit) -> Fit:
    """The calibrated plant `fit`, or that fitted to the run itself where it errs less on blocks not learnt from."""
    again = _to_the_run(search, Hypothesis(), fit)
    if again is None or not (1.0 + MORE) ** 2 * judge.total(again) < judge.total(fit):
        return fit
    return fit.likelihood.fit(fit.unknowns, again.values, iterations=0)


def no_worse(judge: Judge, calibrated: Fit) -> Fit:
    """The calibrated plant, or its data sheet where that errs less on blocks not learnt from."""
    worse = judge.total(calibrated) > (1.0 + MORE) ** 2
    return calibrated.likelihood.fit(calibrated.unknowns, iterations=0) if worse else calibrated


def held_to_tolerance(search: Search, claims: Claims) -> Claims:
    """`claims` beside something unexplained, which draws parameters: none is taken beyond its tolerance any more.

    Neither is it in what is fitted by this search from now on.
    """
    search.within = TOLERANCE
    plain, less = Hypothesis(), Hypothesis(claims.best.effects)
    judge = Judge(claims.fit.likelihood)
    calibrated = search.fit(claims.calibrated.likelihood, plain, claims.calibrated.values)
    calibrated = no_worse(judge, calibrated_to_the_run(search, judge, calibrated))
    fit = search.fit(claims.fit.likelihood, less, claims.fit.values) if less.size else calibrated
    return replace(claims, best=less, fit=fit, calibrated=calibrated)


def earned(
    search: Search,
    calibrated: Fit,
    best: Hypothesis,
    fit: Fit,
    refit: Callable[[Hypothesis, Fit], Fit] | None = None,
    progress: Progress = silent,
) -> Claims:
    """The part of `best` that passes every gate, and the calibrated plant, no worse than its data sheet.

    refit: gives the fit of a smaller hypothesis, from that of a larger one; by default on the likelihood of `fit`.
    """
    refit = refit or (lambda less, from_: search.fit(from_.likelihood, less, from_.values))
    judge = Judge(fit.likelihood)
    claims = Claims(best, fit, calibrated)
    progress("holding the calibrated plant against its data sheet")
    _calibrated(search, judge, claims)
    _through(search, judge, claims, refit, progress)
    if claims.best.size or best.size < 2:
        return claims
    # beside others each of them failed; one may be borne out alone, the best fit first
    singles = {name: Hypothesis((name,)) for name in best.effects}
    singles |= {name: Hypothesis((), (name,)) for name in best.released}
    fits = {name: refit(single, fit) for name, single in singles.items()}
    for name in sorted(fits, key=lambda name: fits[name].cost):
        alone = Claims(singles[name], fits[name], claims.calibrated)
        _through(search, judge, alone, refit, progress)
        if alone.best.size:
            others = [why for why in claims.refused if not why.startswith(f"{named(search, name)} is not claimed")]
            return replace(alone, refused=others + alone.refused)
    return claims


def _through(search: Search, judge: Judge, claims: Claims, refit: Callable, progress: Progress) -> None:
    """Take from `claims` what fails a gate, until all that is left passes each."""
    while claims.best.size:
        if failed := unborne(search, claims.best, claims.fit):
            name, why = next(iter(failed.items()))
            claims.refused.append(f"{named(search, name)} is not claimed: {why}")
            progress(f"dropping {name}")
            claims.best = claims.best.without(name)
            claims.fit = refit(claims.best, claims.fit)
            continue
        if _unsupported(search, judge, claims, refit) or _smoothing(search, claims, refit):
            continue
        if _undoing(search, judge, claims, refit):
            continue
        progress(f"holding blocks out of {claims.best}")
        losses = judge.losses(claims.calibrated, claims.fit)
        if not losses:
            break
        again = fitted_by_rule(search, claims.best, claims.fit)
        sound = again if again and not unborne(search, claims.best, again) else None
        if sound and not judge.losses(claims.calibrated, sound):
            claims.refused.append(f"{claims.best} is fitted again to the run itself: before, {_worst(losses)}")
            claims.fit = sound
            break
        _dropped(search, claims, refit, losses)


def _unsupported(search: Search, judge: Judge, claims: Claims, refit: Callable) -> bool:
    """Whether the effect or parameter of least evidence was dropped, as not all that are named are borne out."""
    names = (*claims.best.effects, *claims.best.released)
    fits = {name: refit(claims.best.without(name), claims.fit) for name in names}
    if len(names) == 1 and claims.calibrated.likelihood.model is claims.fit.likelihood.model:
        fits = {name: min(fit, claims.calibrated, key=lambda f: f.cost) for name, fit in fits.items()}
    claims.without = fits
    claims.shares = {n: judge.share(claims.calibrated, fits[n], claims.fit) for n in names}
    useless = min(names, key=lambda n: claims.shares[n])
    if why := _useless(judge, claims, useless):
        return _drop(search, claims, useless, fits, why)
    candidates = len({effect.id for effect in search.effects.values()}) + len(search.toleranced)
    for exact in (False, True):  # what a linearised fit does not bear out is fitted in full before it counts
        claims.evidence = {n: _evidence(search, claims, n, exact) for n in names}
        if borne_out(claims.evidence, candidates) == set(names):
            return False
    name = min(names, key=lambda n: claims.evidence[n].log_e)
    found = f"an e-value of {claims.evidence[name]}, for one of {candidates} candidates"
    return _drop(search, claims, name, fits, f"what its fit did not see gives it {found}")


def _useless(judge: Judge, claims: Claims, name: str) -> str:
    """Why a name takes too little of the squared error of the run; empty where it takes enough, or noise is told.

    A noise that remembers weighs fast errors most. Where none is told, even a little of the slow ones is told from it.
    """
    likelihood, share = claims.fit.likelihood, claims.shares[name]
    if not likelihood.expected:
        less = claims.without[name]
        enough = share >= SHARE or judge.share(less, less, claims.fit) >= OWN
        return "" if enough else f"with it the squared error of the run is smaller by {max(share, 0.0):.1%} only"
    return "with it the squared error of the run is no smaller" if likelihood.remembers and share <= 0.0 else ""


def _evidence(search: Search, claims: Claims, name: str, exact: bool) -> Evidence:
    """What speaks for one name; what was looked for at every frequency of the recording pays for all of them."""
    found = evidence(claims.without[name], claims.fit, _wider(search, claims, name), exact)
    lines = name in search.effects and any(f.whole and f.unit == HERTZ for f in search.effects[name].free)
    if not claims.fit.likelihood.expected:
        found = replace(found, least=0.0)  # a colour that is fitted hides in one half what it is in the other
    return replace(found, log_e=found.log_e - float(np.log(len(claims.fit.errors) / 2))) if lines else found


def _smoothing(search: Search, claims: Claims, refit: Callable) -> bool:
    """Whether two were dropped that together smooth the steps of what is recorded.

    Each of them moves the channels (a lag, and a channel that comes early), but both together by less than the steps.
    """
    for one, other in combinations(claims.best.effects, 2):
        if _rounded([search.effects[one], search.effects[other]], claims.fit):
            why = "together they move every channel by less than half a step of what is recorded: they smooth the steps"
            claims.refused.append(f"{named(search, one)} and {named(search, other)} are not claimed: {why}")
            claims.best = claims.best.without(one).without(other)
            claims.fit = refit(claims.best, claims.fit)
            return True
    return False


def _undoing(search: Search, judge: Judge, claims: Claims, refit: Callable) -> bool:
    """Whether two that undo each other were dropped, as little is left of both; `claims.only_with` keeps the others.

    Each of the two saves next to nothing without the other one: only their difference explains something.
    """
    claims.only_with = {}
    saved = {name: fit.cost - claims.fit.cost for name, fit in claims.without.items()}
    for one, other in combinations(saved, 2):
        less = claims.best.without(one).without(other)
        without = refit(less, claims.without[one])
        both = without.cost - claims.fit.cost
        if max(both - saved[one] - ALONE * saved[other], both - saved[other] - ALONE * saved[one]) >= 0.0:
            continue
        if judge.share(claims.calibrated, without, claims.fit) < LITTLE:
            pair = f"{named(search, one)} and {named(search, other)}"
            claims.refused.append(f"{pair} are not claimed: one undoes the other, and little is left of both")
            claims.best, claims.fit = less, without
            return True
        claims.only_with.setdefault(one, []).append(other)
        claims.only_with.setdefault(other, []).append(one)
    return False


def _drop(search: Search, claims: Claims, name: str, fits: Mapping[str, Fit], why: str) -> bool:
    """Go on without the effect or parameter, with the fit of the rest."""
    claims.refused.append(f"{named(search, name)} is not claimed: {why}")
    claims.best, claims.fit = claims.best.without(name), fits[name]
    return True


def _wider(search: Search, claims: Claims, name: str) -> float:
    """By how much errors that depend on each other widen what is found; a noise that remembers has that in it."""
    return 1.0 if claims.fit.likelihood.remembers else claims.fit.widened(_symbols(search, name))


def _symbols(search: Search, name: str) -> list[str]:
    """The unknowns of an effect, or of a parameter whose tolerance is lifted."""
    return [f.symbol for f in search.effects[name].free] if name in search.effects else [name]


def _dropped(search: Search, claims: Claims, refit: Callable, losses: list[Loss]) -> None:
    """Drop the effect or parameter whose loss costs least."""
    names = (*claims.best.effects, *claims.best.released)
    fits = {name: refit(claims.best.without(name), claims.fit) for name in names}
    name = min(fits, key=lambda n: fits[n].cost)
    claims.refused.append(f"{named(search, name)} is not claimed: with it, {_worst(losses)}")
    claims.best, claims.fit = claims.best.without(name), fits[name]


def _calibrated(search: Search, judge: Judge, claims: Claims) -> None:
    """Fit a calibrated plant again that is worse than its data sheet, all blocks together; or take the data sheet."""
    before = judge.total(claims.calibrated)
    if before <= (1.0 + MORE) ** 2:
        return
    again, why = (
        fitted_by_rule(search, Hypothesis(), claims.calibrated),
        f"{PERCENT * (before - 1):.2g} % more squared error",
    )
    if again is not None and judge.total(again) <= 1.0:
        claims.refused.append(f"the parameters are fitted again to the run itself: before, {why} than the data sheet")
    else:
        again = claims.calibrated.likelihood.fit(claims.calibrated.unknowns, iterations=0)
        claims.refused.append(f"the parameters are left as on the data sheet: fitted, {why} where not learnt from")
    if not claims.best.size:
        claims.fit = again
    claims.calibrated = again


def named(search: Search, key: str) -> str:
    """An effect, or a parameter whose tolerance is lifted, as a reader knows it."""
    return search.effects[key].id if key in search.effects else f"{key} outside its tolerance"


def _worst(losses: list[Loss]) -> str:
    ranked = sorted(losses, key=lambda loss: -loss.after / max(loss.before, TINY))
    more = f" ({len(losses)} such blocks and channels)" if len(losses) > 1 else ""
    return f"{ranked[0]}{more}"
