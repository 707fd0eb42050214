"""The way from a recording to a verdict: calibrate, search, let every claim be earned, and look where none is.

A diagnosis claims an effect only where its evidence is strong and little is left unexplained. Where structure stays in
the errors that no effect of the table explains, the verdict is `unexplained`.
"""

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.adequacy import dependent
from greygate.mismatch.blocks import Judge
from greygate.mismatch.claims import REFIT, Claims, earned, held_to_tolerance, named
from greygate.mismatch.closure import closure, left_beside
from greygate.mismatch.coloured import Coloured, remaining
from greygate.mismatch.coloured_selection import ColouredSelection
from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.effects import Effect
from greygate.mismatch.excitation import excited
from greygate.mismatch.fit import Fit, Likelihood
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.noise import Noise, learnt
from greygate.mismatch.rig import Rig
from greygate.mismatch.ruled_out import ruled_out
from greygate.mismatch.search import WITHIN, Hypothesis, Search
from greygate.mismatch.selection import PART, STRUCTURE, Selection, complete, inflation, promised, structure
from greygate.mismatch.several import by_rule, modelled
from greygate.mismatch.verdict import Verdict
from greygate.plants.expressions import names
from greygate.plants.plant import Plant
from greygate.plants.recording import run_name
from greygate.progress import Progress, silent

SHARE = 0.99  # of what can be explained: an effect that explains so much is all that is missing,
ADEQUATE = 4.0  # where the squared errors are at most so many times those that the told noise makes
SOME = 0.1  # of the squared error in free run, likewise where no noise is told
CLOSED = PART  # of the misfit, that a fitted term must take, as a name must: what takes less does harm elsewhere
NOISES = 3  # noises under which a recording is explained, at most: each is what the explanation before it left
OPEN_VERDICTS = Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED
BLOWN = 100.0  # times what was recorded: a run that is so far off diverges, and nothing can be read from it


@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge
def diagnose(rig: Rig, effects: Mapping[str, Effect] | None = None, progress: Progress = silent) -> Diagnosis:
    """Explain the recording `rig.folder`/identify.csv; holdout.csv serves for the report alone.

    effects: those to be tried, by key; by default all that are known for the rig. Raises InputError where a recording
    or the table of effects cannot serve.

    >>> force = 60.0 * np.repeat(np.random.default_rng(2).standard_normal(30), 40)
    >>> real = axis.with_parameters(viscous=500.0)  # the data sheet of `load_rig` says 400, up to 10 % off
    >>> x = simulate(real, {"force": force}, sample_time=5e-3)["x"]
    >>> x = x + 2e-6 * np.random.default_rng(3).standard_normal(1200)
    >>> columns = np.column_stack([np.arange(1200) * 5e-3, force, x])
    >>> np.savetxt("rig/identify.csv", columns, delimiter=",", header="t,force,x", comments="")
    >>> found = diagnose(rig)
    >>> str(found.verdict), list(found.as_dict()["parameters"])
    ('parameter_error', ['viscous'])
    """
    began = time.perf_counter()
    recording = rig.to_explain()
    effects = table.known(rig, recording) if effects is None else effects
    progress("compiling the plant")
    search = Search(rig, recording, effects, free_run=Likelihood if rig.stated else Coloured)
    search.effects, not_shown = excited(search.final.model, search.effects)
    offered = {effect.id for effect in search.effects.values()}
    not_shown |= {name: why for name, why in table.unmet(rig, recording).items() if name not in offered}
    progress("calibrating")
    result = (_of_stated_noise if rig.stated else _of_coloured_noise)(search, progress)
    result.not_shown = not_shown
    if result.verdict == Verdict.MISSING_PHYSICS and _faults(search, result.best):
        result.verdict = Verdict.RECORDING_FAULT
    if result.verdict == Verdict.CONSISTENT:
        progress("bounding what is not there")
        result.not_larger_than = ruled_out(search, result.corrected, not_shown)
    progress("predicting the recordings")
    result.fits = fits(result, recording)
    if diverging := [c for c, rms in result.fits["identify"].items() if _diverges(rms["corrected"], recording[c])]:
        raise InputError(
            f"{rig.folder}: the simulation of {', '.join(diverging)} diverges, whatever the parameters; check the "
            "values and units in rig.toml, or restart it in windows of window_s"
        )
    if result.verdict == Verdict.UNEXPLAINED and len(recording.runs) > 1:
        result.alone = _each_alone(rig, effects, progress)
    result.seconds = time.perf_counter() - began
    return result


def _faults(search: Search, best: Hypothesis) -> bool:
    """Whether only faults of the recording are claimed."""
    return bool(best.effects) and all(search.effects[key].fault for key in best.effects)


def _each_alone(rig: Rig, effects: Mapping[str, Effect], progress: Progress) -> dict[str, dict]:
    """By its name, what each of several recordings says alone: one may show what the others lack."""
    out = {}
    for file in rig.identify:
        progress(f"asking {file} alone")
        try:
            found = diagnose(replace(rig, identify=(file,), holdout=()), effects).as_dict()
        except InputError:  # too short alone, or a run that diverges
            continue
        out[run_name(file)] = {key: found[key] for key in ("verdict", "effects")}
    return out


def _diverges(rms: float, recorded: np.ndarray) -> bool:
    return not rms <= BLOWN * np.max(np.abs(recorded))


def _of_stated_noise(search: Search, progress: Progress) -> Diagnosis:
    """Explain with the noise that was told, and once more where the recording shows another."""
    found = _explained(search, progress)
    if search.moved_between(found.corrected, iterations=REFIT):
        progress("searching again: inputs moved between the samples")
        found = _explained(search, progress)
    noise = shown_noise(found.corrected)
    if noise.as_told:
        return replace(found, noise=noise)
    for _ in range(NOISES):
        progress("searching again: the noise is not as rig.toml tells it")
        again = _explained(search.under(noise), progress)
        before, noise = noise, shown_noise(again.corrected)
        if noise.swollen or (again.verdict == Verdict.CONSISTENT and dependent(again.corrected)):
            break  # what is slow and far too large, or what the machine's own motion foretells, is no noise
        if not before.swollen:
            return replace(again, noise=noise)
    search.under(Noise.told(len(search.rig.predict)))
    return replace(found, noise=None)


def shown_noise(fit: Fit) -> Noise:
    """The noise, in units of what rig.toml tells, that a fit leaves."""
    likelihood, model = copy.copy(fit.likelihood), fit.likelihood.model
    likelihood.noise = Noise.told(len(model.rig.predict))
    return learnt(likelihood.errors(fit.values, fit.shifts), model.window or len(likelihood.sigma), model.pieces)


def _explained(search: Search, progress: Progress) -> Diagnosis:
    search.within = WITHIN
    base = search.base(search.screen)
    short = Selection(search, search.screen, base, progress)
    best, current = short.rivalled(*short.forward(Hypothesis(), short.plain, base))
    if not complete(current):
        best, current = short.paired(best, current, base)
    best, current = short.settled(*short.backward(best, current))
    selection, costs = short, short.costs
    if best.size and complete(current):
        longer, chosen, corrected = short.over(search.final, best, current)
        if {search.effects[key].id for key in chosen.effects} != {search.effects[key].id for key in best.effects}:
            chosen, corrected = longer.settled(chosen, corrected)  # the exchanges that were made are not those of it
        best, costs = chosen, longer.costs
        if best.size == 1 and not longer.done(best, corrected):  # a second effect that long windows alone show
            more, fit = longer.backward(*longer.forward(best, corrected, corrected))
            if more != best:
                selection, best, current, corrected = longer, more, fit, fit
    else:
        corrected = search.fit(search.final, best, current.values)
    claimed, fit = best, corrected
    if best.size and _open(corrected, current) and selection.explained(current) < PART:
        plain = search.fit(search.final, Hypothesis(), short.plain.values)
        if _open(plain, short.plain):  # then it is unexplained, whatever part of `best` would pass the gates
            claimed, fit = Hypothesis(), plain
    claims = earned(search, short.plain, claimed, fit, progress=progress)
    if claimed != best:
        names = " + ".join(named(search, key) for key in (*best.effects, *best.released))
        claims.refused.append(f"{names} is not claimed: it takes {selection.explained(current):.0%} of what is missing")
    if claims.best != best:
        selection, current = short, search.fit(search.screen, claims.best, claims.fit.values)
        costs = {**short.costs, claims.best: current.cost}
    best, corrected = claims.best, claims.fit
    left, explained = structure(corrected), selection.explained(current)
    unfinished = _open(corrected, current)
    per_sample = corrected.cost / corrected.likelihood.count
    verdict = _verdict(best, unfinished, explained, per_sample, faults=_faults(search, best))
    missing = verdict == Verdict.MISSING_PHYSICS
    unlike = _unlike(search, best, lambda: unfinished or _pays(search, best, corrected)) if missing else ""
    verdict = Verdict.PARTLY_EXPLAINED if unlike else verdict
    if verdict in OPEN_VERDICTS:
        progress("calibrating to the run itself")
        claims = held_to_tolerance(search, claims)
        if claims.best != best:
            current = search.fit(search.screen, claims.best, claims.fit.values)
            costs, explained = {**short.costs, claims.best: current.cost}, short.explained(current)
            verdict, unlike = (verdict, unlike) if explained >= PART else (Verdict.UNEXPLAINED, "")
        best, corrected = claims.best, claims.fit
        left = structure(corrected)
    if verdict == Verdict.PARTLY_EXPLAINED and _carries_not_over(search, claims):
        verdict, best, unlike = Verdict.UNEXPLAINED, Hypothesis(), ""
    unknown: dict = {}
    if verdict in OPEN_VERDICTS and not unlike:
        progress("looking for the equation")
        found = closure(search)
        refused = _no_term(claims, *found)
        share = 0.0 if refused else _taken(found[0])
        # what any smooth term does as well is no name, and several names that leave something are such a term
        if verdict == Verdict.UNEXPLAINED or share >= explained or best.size > 1:
            verdict, best = Verdict.UNEXPLAINED, Hypothesis()
            unknown, corrected = _unknown(search, claims, *found, refused)
            left = structure(corrected)
        else:
            unknown = {"where": left_beside(search, best, corrected.values)}
    rivals = {hypothesis: cost / inflation(current) for hypothesis, cost in costs.items()}
    rivals |= {hypothesis: rivals[best] for hypothesis in short.unfitted if best in rivals and hypothesis not in rivals}
    return Diagnosis(
        search.rig, verdict, best, claims.calibrated, corrected, rivals, left, explained, search, unknown, left=unlike,
        refused=claims.refused, evidence=claims.evidence, shares=claims.shares, only_with=claims.only_with,
    )  # fmt: skip


def _unlike(search: Search, best: Hypothesis, more: Callable[[], bool]) -> str:
    """Why a smooth curve that is claimed is another one, in words; empty where none is claimed, or that one.

    It is another where a second curve or a constant is claimed in the same equation: together they are the beginning of
    a series. more: whether something is left that a further term would take.
    """
    effects = [search.effects[key] for key in best.effects]
    curves = [effect for effect in effects if effect.smooth]
    if not curves:
        return ""
    series = [e for e in effects if (e.smooth or not e.depends_on) and set(e.equations) & set(curves[0].equations)]
    if len(series) < 2 and not more():
        return ""
    return f"what acts in {', '.join(curves[0].equations)} is not quite {curves[0].id}, but a curve that is like it"


def _pays(search: Search, best: Hypothesis, fit: Fit) -> bool:
    """Whether a further effect or parameter promises a gain that is evidence."""
    return promised(search.scores(fit.likelihood, fit, best), fit) > 1.0


def _of_coloured_noise(search: Search, progress: Progress) -> Diagnosis:
    selection = ColouredSelection(search, progress)
    best, fit = selection.backward(*selection.forward(Hypothesis(), selection.plain, selection.plain))

    def refit(less: Hypothesis, from_: Fit) -> Fit:
        starts = [from_, *(found for h, found in selection.fits.items() if h == less)]
        return min((search.fit(from_.likelihood, less, start.values) for start in starts), key=lambda f: f.cost)

    claims = earned(search, selection.plain, best, fit, refit, progress)
    if claims.best not in selection.fits:
        selection.fits[claims.best] = claims.fit
    best, fit = claims.best, claims.fit
    left = goes_on = _goes_on(fit)
    explained = removed(claims.calibrated, fit)
    verdict = _verdict(best, bool(left), explained, np.inf, SOME)
    if verdict == Verdict.MISSING_PHYSICS and (unlike := _unlike(search, best, lambda: False)):
        verdict, left = Verdict.PARTLY_EXPLAINED, unlike
    unexplained = {}
    if verdict in OPEN_VERDICTS:
        claims = held_to_tolerance(search, claims)
        if claims.best != best:
            explained = removed(claims.calibrated, claims.fit)
            verdict = verdict if explained >= PART else Verdict.UNEXPLAINED
        best, fit = claims.best, claims.fit
        selection.fits.setdefault(best, fit)
        if left == goes_on:
            left = goes_on = _goes_on(fit) or left
    if verdict == Verdict.PARTLY_EXPLAINED and _carries_not_over(search, claims):
        verdict = Verdict.UNEXPLAINED
    if verdict == Verdict.UNEXPLAINED:
        best, fit = Hypothesis(), claims.calibrated
        left = _goes_on(fit) or left
        unexplained = {"where": [_likeliest(search, selection.fits, left, best)]}
    elif verdict == Verdict.PARTLY_EXPLAINED and left == goes_on:
        unexplained = {"where": [_likeliest(search, selection.fits, f"left beside it: {left}", best)]}
    return Diagnosis(
        search.rig, verdict, best, claims.calibrated, fit, {h: f.cost for h, f in selection.fits.items()}, {},
        explained, search, unexplained, left=left, refused=claims.refused, evidence=claims.evidence,
        shares=claims.shares, only_with=claims.only_with,
    )  # fmt: skip


def _open(corrected: Fit, current: Fit) -> bool:
    """Whether structure is left over long windows (`corrected`) and over short ones (`current`)."""
    return max(structure(corrected).values()) > STRUCTURE and not complete(current)


def _verdict(
    best: Hypothesis, open_: bool, explained: float, left: float, part: float = PART, faults: bool = False
) -> Verdict:
    """open_: whether structure is left. left: squared errors over those of the noise, infinite where none is told.

    faults: whether nothing but faults of the recording are claimed: what those leave is of the machine, however large
    they are.
    """
    if open_ and (faults or explained < SHARE or left > ADEQUATE):
        return Verdict.PARTLY_EXPLAINED if best.effects and explained >= part else Verdict.UNEXPLAINED
    if best.effects:
        return Verdict.MISSING_PHYSICS
    return Verdict.PARAMETER_ERROR if best.size else Verdict.CONSISTENT


def _taken(unknown: dict) -> float:
    """The share of the misfit that a term takes there: all, where it is a sensor, which has no term."""
    return (unknown.get("effect") or {}).get("confidence", 1.0)


def _no_term(claims: Claims, unknown: dict, closed: Fit | None) -> str:
    """Why the term that `closure` found (with `closed`, the fit with it) is none; empty where it is one, or none is."""
    if closed is None:
        return ""
    if _taken(unknown) < CLOSED:
        return f"it takes {_taken(unknown):.0%} of the misfit"
    judge, halves = Judge(closed.likelihood), Judge(closed.likelihood, halves=True)
    losses = judge.losses(claims.calibrated, closed) or judge.throughout(claims.calibrated, closed)
    losses = losses or halves.losses(claims.calibrated, closed)
    return f"with it {losses[0]}" if losses else ""


def _carries_not_over(search: Search, claims: Claims) -> bool:
    """Whether what is claimed beside something unexplained is refused: learnt from one half, it spoils the other.

    Or, with its parameters held to their tolerances, it no longer passes the gate of blocks.
    """
    judges = (Judge(claims.fit.likelihood, halves) for halves in (True, False))
    losses = next((found for judge in judges if (found := judge.losses(claims.calibrated, claims.fit))), [])
    if losses:
        names = " + ".join(named(search, key) for key in (*claims.best.effects, *claims.best.released))
        claims.refused.append(f"{names} is not claimed: something is left, and with it {losses[0]}")
    return bool(losses)


def _unknown(search: Search, claims: Claims, unknown: dict, closed: Fit | None, refused: str) -> tuple[dict, Fit]:
    """(where and effect of what no effect explains; the fit with a term for it, if one is worth it).

    unknown, closed: what `closure` found. refused: why its term is none.
    """
    if closed is not None and not refused:
        return unknown, closed
    if refused:
        claims.refused.append(f"no term is fitted: {refused}")
        for place in unknown["where"]:
            place["regime"] = "no function of the signals that was tried takes what is left"
    plain = claims.calibrated
    # its values as they are: fitted anew to long windows, they may predict worse
    return {**unknown, "effect": None}, search.final.fit(plain.unknowns, plain.values, iterations=0)


def _goes_on(fit: Fit) -> str:
    """What the innovations of a free run go with; where they go with nothing, what its errors go with."""
    likelihood = fit.likelihood
    assert isinstance(likelihood, Coloured)
    if not likelihood.order:
        likelihood = likelihood.ordered(likelihood.residual(fit.values))
        fit = replace(fit, likelihood=likelihood, errors=likelihood.errors(fit.values, fit.shifts))
    return dependent(fit) or remaining(fit)


def removed(calibrated: Fit, corrected: Fit) -> float:
    """The share of the squared error in free run that a correction removes, in the mean over channels."""

    def squared(fit: Fit) -> np.ndarray:
        assert isinstance(fit.likelihood, Coloured)
        return np.mean(fit.likelihood.residual(fit.values) ** 2, axis=0)

    before, after = squared(calibrated), squared(corrected)
    return float(np.mean(1.0 - after / np.maximum(before, TINY)))


def _likeliest(search: Search, fitted: Mapping[Hypothesis, Fit], left: str, best: Hypothesis) -> dict:
    """The equation of what is missing beside `best`: where the effect acts that comes nearest, else of a channel."""
    more = (h for h in fitted if h.size == best.size + 1 and {*best.effects} < {*h.effects})
    added = ((*({*h.effects} - {*best.effects}),)[0] for h in sorted(more, key=lambda h: fitted[h].cost))
    nearest = [(search.effects[key].equations, search.effects[key].depends_on) for key in added]
    plant, whole = search.rig.plant, [(search.rig.predict, ())]
    for places, depends_on in (*nearest, *whole):
        for place in places:
            if equation := _equation(plant, place):
                return {"equation": equation, "depends_on": list(depends_on), "regime": left}
    return {"equation": search.rig.predict[0], "depends_on": [], "regime": left}


def _equation(plant: Plant, place: str) -> str:
    """The equation or definition of that name, or that makes a channel of that name, or that uses such an input."""
    made = {**{e.state: name for name, e in plant.equations.items()},
            **{d.symbol: name for name, d in plant.definitions.items()}}  # fmt: skip
    if place in plant.equations or place in plant.definitions:
        return place
    sums = {**{n: e.terms for n, e in plant.equations.items()}, **{n: d.terms for n, d in plant.definitions.items()}}
    using = (name for name, terms in sums.items() if place in names(terms.values()))
    return made.get(place) or next(using, "")


def fits(result: Diagnosis, identify) -> dict:
    """RMS error of every predicted channel by the comparison rule: of the data sheet's plant, calibrated, corrected.

    Of several recordings, all together and each alone.
    """
    rig = result.rig
    recordings = {"identify": identify}
    if held_out := rig.held_out():
        recordings["holdout"] = held_out
    out = {}
    for name, recording in recordings.items():
        model = modelled(rig, recording, result.corrected.likelihood.model.effects)
        kinds = {"simulation": {}, "calibrated": result.calibrated.values, "corrected": result.corrected.values}
        skip = rig.settle if name == "holdout" else 0
        if name == "holdout":
            kinds["corrected"] = result.elsewhere
        ran = {kind: by_rule(model, values, skip) for kind, values in kinds.items()}
        parts = {name: slice(None)}
        if len(model.pieces) > 1:
            files = {run.name: Path(run.source).name for run in recording.runs}
            names = (run if run not in recordings else files[run] for run in files)
            parts |= dict(zip(names, model.pieces, strict=True))
        for part, piece in parts.items():
            out[part] = {
                channel: {
                    **{kind: _rms(model, *ran[kind], piece, i) for kind in kinds}, "unit": rig.channels[channel].unit,
                }
                for i, channel in enumerate(rig.predict)
            }  # fmt: skip
    return out


def _rms(model: Model, predicted: np.ndarray, counts: np.ndarray, piece: slice, channel: int) -> float:
    """The RMS error of a channel over the samples of `piece` that count."""
    error = (predicted[piece] - model.target[piece])[counts[piece]]
    return float(np.sqrt(np.mean(error**2, axis=0))[channel])
