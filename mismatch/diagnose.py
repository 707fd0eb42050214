"""The way from a recording to a verdict: calibrate, search, let every claim be earned, and look where none is.

A diagnosis claims an effect only where its evidence is strong and little is left unexplained. Where structure stays in
the errors that no effect of the table explains, the verdict is `unexplained`.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.adequacy import dependent
from greygate.mismatch.blocks import MORE, Judge
from greygate.mismatch.claims import (
    REFIT,
    Claims,
    earned,
    fitted_beside,
    fitted_by_rule,
    held_to_tolerance,
    named,
    unborne,
)
from greygate.mismatch.closure import closure, left_beside
from greygate.mismatch.coloured_selection import selected
from greygate.mismatch.cores import on_one_thread
from greygate.mismatch.diagnosis import DETAIL, Diagnosis, lasting
from greygate.mismatch.effects import Effect
from greygate.mismatch.excitation import excited
from greygate.mismatch.fit import Fit
from greygate.mismatch.given import rig_of, tried
from greygate.mismatch.held_out import no_better
from greygate.mismatch.misread import check
from greygate.mismatch.model import TINY, Model
from greygate.mismatch.noise import Noise
from greygate.mismatch.rig import Rig
from greygate.mismatch.ruled_out import ruled_out
from greygate.mismatch.search import WITHIN, Hypothesis, Search
from greygate.mismatch.selection import EVIDENCE, PART, STRUCTURE, Found, Selection, shown_noise
from greygate.mismatch.several import by_rule, modelled
from greygate.mismatch.stretches import pieces, stretches
from greygate.mismatch.verdict import LEAST_SURE, Verdict
from greygate.mismatch.words import lines
from greygate.plants.expressions import names
from greygate.plants.plant import Plant
from greygate.plants.recording import run_name
from greygate.progress import Budget, OutOfTime, Progress, silent

SHARE = 0.99  # of what can be explained: an effect that explains so much is all that is missing,
ADEQUATE = 4.0  # where the squared errors are at most so many times those that the told noise makes
DRAWN = 0.1  # of the squared error without it, that a parameter leaves at least which something unexplained drew
ALIKE = 0.95  # of what can be explained: a name that takes so much is not replaced by the same in other words
CLOSED = PART  # of the misfit, that a fitted term must take, as a name must: what takes less does harm elsewhere
NOISES = 3  # noises under which a recording is explained, at most: each is what the explanation before it left
OPEN_VERDICTS = Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED
LED_BACK = 4  # iterations: each leads a numbers' prior all the way where the run is linear
MORE_OF_IT = 3  # times as much of a recording as before is searched, where what was searched hides something
GRACE = 0.2  # of the time that there was: so much longer the gates may take that a claim passes
AFTER = "what follows the search"  # in words, where there is no time for it
BLOWN = 100.0  # times what was recorded: a run that is so far off diverges, and nothing can be read from it


@on_one_thread
@np.errstate(over="ignore", invalid="ignore")  # a trial may diverge
def diagnose(
    rig: Rig | Plant,
    recording: Any = None,
    *,
    effects: Mapping[str, Effect] | None = None,
    progress: Progress = silent,
    budget: Budget | None = None,
    seconds: float = math.inf,
    unseen: bool = False,
    **told: Any,
) -> Diagnosis:
    """Explain the recording `rig.folder`/identify.csv; holdout.csv may say no (`held_out`). `print` what it finds.

    recording: of a plant in the place of a rig, which a `Simulator` is, too: a Recording, what `read_recording` takes,
    or a list of such, which are explained together; its channels have the plant's names and units. told: what rig.toml
    says of a rig, `tolerance` (parameter -> relative), `plus_minus`, `noise_rms` and `resolution` (parameter or channel
    -> in its unit), `predict`, `window_s`, and `holdout`, further recordings (`given.rig_of`).
    effects: those to be tried, by key; by default all that are known for the rig. progress: gets a line of text for
    each thing that begins, such as `print`. seconds, budget: when it is over, fits end where they are, no further
    hypothesis is tried, and the diagnosis names those that were left out; what is not tested soon then is no claim.
    unseen: whether holdout.csv judges what is made of the diagnosis: then it is reported on, and decides nothing.
    Raises InputError where a recording or the table of effects cannot serve.

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
    budget = budget or Budget(seconds)
    if isinstance(rig, Plant):
        rig = rig_of(rig, recording, **told)
        tried(rig)
    elif recording is not None or told:
        raise InputError(f"{rig.folder}: a rig has its recordings and what rig.toml says of them; give these there")
    recording = rig.to_explain()
    effects = table.known(rig, recording) if effects is None else effects
    progress("compiling the plant")
    search = Search(rig, recording, effects)
    search.budget, search.unseen = budget, unseen
    if some := stretches(search):
        search.part = search.over(some)
    search.effects, not_shown = excited(search.part.final.model, search.effects)
    offered = {effect.id for effect in search.effects.values()}
    not_shown |= {name: why for name, why in table.unmet(rig, recording).items() if name not in offered}
    progress("calibrating")
    result = _diagnosed(search, progress)
    result.not_shown, result.words, result.told = not_shown, lines, rig.stated and not rig.heard
    if result.verdict == Verdict.MISSING_PHYSICS and _faults(search, result.best):
        result.verdict = Verdict.RECORDING_FAULT
    if result.verdict == Verdict.CONSISTENT and not search.left_out("how large what is not there may be"):
        progress("bounding what is not there")
        result.not_larger_than = ruled_out(search.part, search.in_part(result.corrected), not_shown)
    progress("predicting the recordings")
    result.fits = fits(result, recording)
    if diverging := [c for c, rms in result.fits["identify"].items() if _diverges(rms["corrected"], recording[c])]:
        raise InputError(
            f"{rig.title}: the simulation of {', '.join(diverging)} diverges, whatever the parameters; check the "
            "values and units, or restart it in windows of window_s"
        )
    if result.verdict == Verdict.UNEXPLAINED and len(recording.runs) > 1:
        result.alone = _each_alone(search, effects, progress)
    result.seconds = time.perf_counter() - began
    return result


def _faults(search: Search, best: Hypothesis) -> bool:
    """Whether only faults of the recording are claimed."""
    return bool(best.effects) and all(search.effects[key].fault for key in best.effects)


def _each_alone(search: Search, effects: Mapping[str, Effect], progress: Progress) -> dict[str, dict]:
    """By its name, what each of several recordings says alone, while there is time: one may show what is new."""
    rig, out = search.rig, {}
    for file in rig.identify:
        if search.budget.over:
            search.untried[f"{file} alone"] = None
            continue
        progress(f"asking {file} alone")
        try:
            one = replace(rig, identify=(file,), holdout=())
            found = diagnose(one, effects=effects, budget=search.budget).as_dict()
        except InputError:  # too short alone, or a run that diverges
            continue
        out[run_name(file)] = {key: found[key] for key in ("verdict", "effects")}
    return out


def _diverges(rms: float, recorded: np.ndarray) -> bool:
    return not rms <= BLOWN * np.max(np.abs(recorded))


@dataclass(frozen=True)
class State:
    """What is known between two steps of a diagnosis; each step gives a new one.

    found: what is claimed, with its fits. claims: what the gates left. explained: the share of what can be explained
    that `found` explains. left: what it leaves, in words, where the noise does not say that. unlike: why a smooth curve
    that is claimed is another one. unknown: where something is missing that no effect explains, and a term for it.
    supported, had: what the search found before the gates, and its values.
    """

    search: Search
    selection: Selection
    progress: Progress
    found: Found
    claims: Claims
    verdict: Verdict = Verdict.CONSISTENT
    explained: float = 0.0
    left: str = ""
    unlike: str = ""
    unknown: dict = field(default_factory=dict)
    supported: Hypothesis = field(default_factory=Hypothesis)
    had: Mapping[str, float] = field(default_factory=dict)

    @property
    def open(self) -> bool:
        """Whether something is left that the claims do not explain."""
        return self.verdict in OPEN_VERDICTS

    def unclaimed(self) -> "State":
        """The same without a claim: nothing on offer explains what is left."""
        return replace(self, found=replace(self.found, best=Hypothesis()), verdict=Verdict.UNEXPLAINED, unlike="")


def _diagnosed(search: Search, progress: Progress) -> Diagnosis:
    """Explain with the noise that was told, if any, and once more where the recording shows another.

    Where it does, what is left beside names may be that noise: no equation is looked for before.
    """
    state = _gated(search, progress)
    if not search.budget.over and search.moved_between(state.found.fit, iterations=REFIT):
        progress("searching again: inputs moved between the samples")
        state = _gated(search, progress)
    waits = state.verdict == Verdict.PARTLY_EXPLAINED and _other(shown_noise(state.found.fit))
    found = _diagnosis(state if waits else _ended(state))
    noise = shown_noise(found.corrected)
    if noise is None or noise.as_told:
        return replace(found, noise=noise)
    shown = None
    for _ in range(0 if search.budget.over else NOISES):
        progress("searching again: the noise is not as rig.toml tells it")
        again = _explained(search.under(noise), progress)
        if found.best.size and not again.best.size and search.left_out("the noise that the recording shows"):
            shown = noise
            break  # what was found had its time, what was not had not
        before, noise = noise, shown_noise(again.corrected)
        assert noise is not None  # it was told
        if noise.swollen or (again.verdict == Verdict.CONSISTENT and dependent(again.corrected)):
            break  # what is slow and far too large, or what the machine's own motion foretells, is no noise
        if not before.swollen:
            return replace(again, noise=noise)
    search.under(Noise.told(len(search.rig.predict)))
    return replace(_diagnosis(_ended(state)) if waits else found, noise=shown)


def _other(noise: Noise | None) -> bool:
    """Whether it is a sensor's, and another than was told."""
    return noise is not None and not noise.as_told and not noise.swollen


def _explained(search: Search, progress: Progress) -> Diagnosis:
    """The steps of a diagnosis, once, with the noise that the search has now."""
    return _diagnosis(_ended(_gated(search, progress)))


def _gated(search: Search, progress: Progress) -> State:
    """The names that the gates leave."""
    search.within = WITHIN
    with search.budget.searching():
        selection, found = _searched(search, progress)
    try:
        with search.budget.held(GRACE):
            state = _confident(_claimed(_supported(search, selection, found, progress)))
    except OutOfTime:
        return _unmoved(_judged(_untested(search, selection, progress)))
    for step in (_regained, _spared, _lasting, _led_back):
        state = _in_time(step, state)
    return state


def _ended(state: State) -> State:
    """With an equation for what is left, and without what spoils a held-out recording."""
    for step in (_closed, _held_out):
        state = _in_time(step, state)
    return state


def _in_time(step: Callable[[State], State], state: State) -> State:
    """The state after a step; that before it, where there is no time for the step; a gate may take more."""
    search = state.search
    try:
        if step in (_spared, _held_out) or not search.left_out(AFTER):
            with search.budget.held(GRACE):
                return step(state)
    except OutOfTime:
        search.left_out(AFTER)
    return state


def _diagnosis(state: State) -> Diagnosis:
    found, claims, selection = state.found, state.claims, state.selection
    return Diagnosis(
        state.search.rig, state.verdict, found.best, claims.calibrated, found.fit, selection.rivals(found),
        selection.structure(found.fit), state.explained, state.search, state.unknown, left=state.unlike or state.left,
        refused=claims.refused, evidence=claims.evidence, shares=claims.shares, only_with=claims.only_with,
        only_like=bool(state.unlike),
    )  # fmt: skip


def _searched(search: Search, progress: Progress) -> tuple[Selection, Found]:
    """What the recording supports; of its stretches so many that they leave nothing hidden which all of it shows."""
    for times in count(1):
        if search.part is search and times == 1 and (cut := pieces(search)):
            search.part = search.over(cut)
        part = search.part
        part.take(search)
        selection = selected(part, progress)
        if not search.checked:
            check(part, selection.start)
            search.checked = True
        found = selection.searched()
        if part is search:
            break
        search.take(part)
        progress("fitting to the whole recording")
        whole = replace(found, fit=search.fit(search.final, found.best, found.fit.values))
        hidden = not selection.open(found) and max(selection.structure(whole.fit).values(), default=0.0) > STRUCTURE
        if not hidden or search.left_out("more of the recording"):
            return selection, whole
        progress("searching in more of the recording")
        some = stretches(search, MORE_OF_IT**times)
        search.part = search.over(some) if some else search
    return selection, found


def _untested(search: Search, selection: Selection, progress: Progress) -> State:
    """Nothing is claimed, for there was no time to test it."""
    plain = _as_it_runs(search, selection.plain)
    found = Found(Hypothesis(), plain, plain, selection)
    tried = {h: fit for h, fit in selection.fits.items() if h.size}
    claims = Claims(Hypothesis(), plain, plain)
    if tried:
        best = min(tried, key=lambda h: tried[h].cost)
        claims.refused.append(f"{_named(search, best)} is not claimed: there was no time to test it")
        paid = selection.plain.cost - tried[best].cost > EVIDENCE
        return State(search, selection, progress, found, claims, supported=best if paid else Hypothesis())
    return State(search, selection, progress, found, claims)


def _as_it_runs(search: Search, calibrated: Fit) -> Fit:
    """The calibrated plant over all of the recording, or its data sheet where the run of that errs less."""
    fit = search.final.fit(calibrated.unknowns, calibrated.values, iterations=0)
    judge = Judge(fit.likelihood)
    before, after = (np.mean(judge.errors(values) ** 2, axis=0) for values in ({}, fit.values))
    better = np.mean(after / np.maximum(before, TINY)) <= 1.0
    return fit if better else search.final.fit(calibrated.unknowns, iterations=0)


def _unmoved(state: State) -> State:
    """Beside something unexplained no value is another than the data sheet's that there was no time to test."""
    claims = state.claims
    if not state.open:
        return state
    sheet = claims.calibrated.likelihood.fit(claims.calibrated.unknowns, iterations=0)
    why = "the parameters are left as on the data sheet: there was no time to test others"
    return _written(state, replace(claims, calibrated=sheet, fit=sheet, refused=[*claims.refused, why]))


def _supported(search: Search, selection: Selection, found: Found, progress: Progress) -> State:
    """What the gates leave of what the recording supports."""
    claimed = selection.claimable(found)
    plain, fit = search.in_whole(selection.plain), search.in_whole(claimed.fit)
    claims = earned(search, plain, claimed.best, fit, selection.refit, progress)
    if claimed is not found:
        share = found.of.explained(found, selection.plain)
        claims.refused.append(f"{_named(search, found.best)} is not claimed: it takes {share:.0%} of what is missing")
    again = selection.again(found, claims)
    return State(search, selection, progress, again, claims, supported=found.best, had=found.fit.values)


def _claimed(state: State) -> State:
    """The verdict, and the claims that the run on unseen blocks bears."""
    for step in (_judged, _held_to_tolerance, _carried_over, _worn):
        state = step(state)
    return state


def _judged(state: State) -> State:
    """The verdict by what the claims explain and what they leave."""
    search, selection, found = state.search, state.selection, state.found
    explained = found.of.explained(found, state.claims.calibrated)
    left, faults = selection.left(found.fit), _faults(search, found.best)
    open_ = selection.open(found, left) or _missed(state)
    verdict = _verdict(found.best, open_, explained, selection.excess(found), faults)
    state = replace(state, verdict=verdict, explained=explained, left=left)
    if verdict != Verdict.MISSING_PHYSICS:
        return state
    unlike = _unlike(search, found.best, lambda: open_ or selection.promises(found))
    return replace(state, verdict=Verdict.PARTLY_EXPLAINED, unlike=unlike) if unlike else state


def _missed(state: State) -> bool:
    """Whether nothing is claimed where something paid in the search, and long windows show that something is left.

    Short ones, in which little shows, do not make that consistent.
    """
    left = max(state.selection.structure(state.found.fit).values(), default=0.0) > STRUCTURE
    return bool(left and state.supported.size and not state.found.best.size)


def _held_to_tolerance(state: State) -> State:
    """Beside something unexplained no parameter goes beyond its tolerance, which that may draw.

    That draws none where all that is left is no larger than the told noise, and without the parameter far more were.
    """
    if not state.open:
        return state
    search, claims = state.search, state.claims
    state.progress("calibrating to the run itself")
    held = held_to_tolerance(search, claims)
    if claims.best.released and not state.unlike and state.selection.excess(state.found) <= 1.0:
        judge = Judge(claims.fit.likelihood)
        if judge.total(claims.fit) < DRAWN * judge.total(held.fit):
            search.within = WITHIN
            return state
    state = _written(state, held)
    state = replace(state, left=state.selection.left(state.found.fit) or state.left)
    return state if state.explained >= PART else replace(state, verdict=Verdict.UNEXPLAINED, unlike="")


def _written(state: State, claims: Claims) -> State:
    """The same with what was fitted again; the share that is explained is that of what is written."""
    found = state.selection.again(state.found, claims)
    return replace(state, claims=claims, found=found, explained=found.of.explained(found, claims.calibrated))


def _carried_over(state: State) -> State:
    """Beside something unexplained a claim must carry over from one half of the recording to the other."""
    partly = state.verdict == Verdict.PARTLY_EXPLAINED
    return state.unclaimed() if partly and _carries_not_over(state.search, state.claims) else state


def _worn(state: State) -> State:
    """The last word has the run on blocks not learnt from: a correction that is no better there is taken back.

    It is fitted again to the run itself first, as it is, and then beside the parameters of the calibrated plant.
    """
    search, best, claims = state.search, state.found.best, state.claims
    if not best.size or state.verdict == Verdict.UNEXPLAINED:
        return state
    judge = Judge(claims.fit.likelihood)
    if not (why := _no_better(judge, claims.calibrated, claims.fit)):
        return state

    def earns(fit: Fit) -> bool:
        return not unborne(search, best, fit) and not _no_better(judge, claims.calibrated, fit)

    if (again := fitted_by_rule(search, best, claims.fit)) and earns(again):
        return _written(state, replace(claims, fit=again))
    if earns(alone := fitted_beside(claims)):
        return _written(state, replace(claims, fit=_in_all(claims, alone)))
    return _judged(_reduced(state, Hypothesis(), f"{_named(search, best)} is taken back: {why}"))


def _in_all(claims: Claims, alone: Fit) -> Fit:
    """A fit of what is claimed alone as one of all its unknowns, whose intervals are those of all."""
    return alone.likelihood.fit(claims.fit.unknowns, alone.values, alone.shifts, iterations=0)


def _no_better(judge: Judge, calibrated: Fit, fit: Fit) -> str:
    """Why a correction is not worn in place of the calibrated plant, nor that of the data sheet; empty where it is.

    What linearised fits show is fitted again before it counts.
    """
    why = ""
    for exact in (False, True):
        why = judge.no_better(calibrated, fit, exact)
        if judge.total(fit, exact) > (1.0 + MORE) ** 2:
            why = "with it the run errs more than with the data sheet where not learnt from"
        if not why:
            break
    return why


def _reduced(state: State, less: Hypothesis, why: str) -> State:
    """The same with fewer claims, not judged yet."""
    claims, selection = state.claims, state.selection
    fit = selection.refit(less, claims.fit) if less.size else claims.calibrated
    claims = replace(claims, best=less, fit=fit, refused=[*claims.refused, why])
    return replace(_written(state, claims), unlike="", left="")


def _confident(state: State) -> State:
    """Beside something left no name stands that, or another in its place, is less sure than all else, or takes no more
    of the error than no model is exact by; where nothing is left, none that is less sure and without which all is said.

    One stays beside which alone surer ones are borne out: something is there, whatever it is called.
    """
    while state.found.best.effects and state.verdict in (Verdict.PARTLY_EXPLAINED, Verdict.MISSING_PHYSICS):
        sure, shares = _diagnosis(state).placed, state.claims.shares
        key = min(sure, key=lambda key: sure[key] if sure[key] < LEAST_SURE else 1.0 + shares.get(key, 1.0))
        why = f"it came nearest, with a confidence of {sure[key]:.2g}"
        if sure[key] >= LEAST_SURE:
            best = state.found.best
            slight = shares.keys() <= {*best.effects, *best.released} and shares.get(key, 1.0) < DETAIL
            if state.verdict == Verdict.MISSING_PHYSICS or len(sure) == 1 or not slight:  # or its share is another's
                break
            why = f"it takes {shares[key]:.2%} of the error, beside what is left"
        reduced = _reduced(state, state.found.best.without(key), f"{named(state.search, key)} is not claimed: {why}")
        less = _claimed(reduced)
        if less.verdict == Verdict.UNEXPLAINED and max(sure.values()) >= LEAST_SURE:
            break
        if state.verdict == Verdict.MISSING_PHYSICS and less.verdict != Verdict.MISSING_PHYSICS:
            break
        state = less
    return state


def _regained(state: State) -> State:
    """What the recording supported and a gate refused is asked once more beside what is left of the claims.

    A companion that has gone since may have stood in its way.
    """
    for key in state.supported.effects:
        search, best = state.search, state.found.best
        if not (state.open and best.effects) or key in best.effects or search.skips(Hypothesis((key,))):
            continue
        more = best.plus(Hypothesis((key,)))
        fit = search.fit(state.claims.fit.likelihood, more, {**state.had, **state.claims.fit.values})
        claims = earned(
            search, search.in_whole(state.selection.plain), more, fit, state.selection.refit, state.progress
        )
        if claims.best != more:
            continue
        kept = [why for why in state.claims.refused if not why.startswith(f"{named(search, key)} is not claimed")]
        again = replace(state, found=state.selection.again(state.found, claims), claims=replace(claims, refused=kept))
        again = _confident(_claimed(again))
        state = again if key in again.found.best.effects else state
    return state


def _spared(state: State) -> State:
    """Parameters that were left as on the data sheet stay so beside a claim, if the run on unseen blocks errs less so.

    They make up for what no model is exact by.
    """
    search, best, claims = state.search, state.found.best, state.claims
    if not best.effects or np.any(claims.calibrated.numbers):
        return state
    judge, alone = Judge(claims.fit.likelihood), fitted_beside(claims)
    if unborne(search, best, alone) or not judge.total(alone) < judge.total(claims.fit):
        return state
    return _written(state, replace(claims, fit=_in_all(claims, alone)))


def _lasting(state: State) -> State:
    """Consistent is only what holds on blocks that were not learnt from, too.

    The data sheet's values have learnt from none. A free run that they lead elsewhere tells nothing of that: there a
    trifle does so, too.
    """
    fit = state.found.fit
    likelihood = fit.likelihood
    if state.verdict != Verdict.CONSISTENT or not np.any(fit.numbers):
        return state
    if state.search.lost(likelihood.fit(fit.unknowns, iterations=0)):
        return state
    over = next((why for halves in (False, True) if (why := Judge(likelihood, halves).overfitted(state.found.fit))), "")
    return replace(state, verdict=Verdict.UNEXPLAINED, left=over) if over else state


def _led_back(state: State) -> State:
    """What a free run knows together only, such as mass, force and friction, is led back to the data sheet.

    Along a long run the slopes of a fit are too coarse to show that nothing changes there.
    """
    fit = state.found.fit
    if state.open or state.search.rig.window:
        return state
    again = fit.likelihood.fit(fit.unknowns, fit.values, fit.shifts, iterations=LED_BACK, both=True)
    fit = min(fit, again, key=lambda f: f.cost)
    claims = state.claims if state.found.best.size else replace(state.claims, calibrated=fit)
    return replace(state, claims=claims, found=replace(state.found, fit=fit))


def _closed(state: State) -> State:
    """Where something is missing that no effect explains, and a term for it.

    What any smooth term does as well is no name.
    """
    if not state.open:
        return state
    search, found, claims = state.search, state.found, state.claims
    state.progress("looking for the equation")
    unknown, closed = closure(search.part, state.selection.calibrated)
    refused = _no_term(search.in_part(claims.calibrated), unknown, closed)
    share = 0.0 if refused else _taken(unknown)
    outdone = state.selection.outdone(found.best, state.explained, share, found.fit, closed)
    outdone = outdone and not _alike(search, found.best, state.explained, unknown)
    if state.verdict != Verdict.UNEXPLAINED and not outdone:
        return replace(state, unknown={"where": left_beside(search, found.best, found.fit.values)})
    if found.best.size:
        nearest = f"it came nearest, and takes {max(state.explained, 0.0):.1%} of what is missing"
        nearest += f", a term without a name {share:.1%}" if outdone else ""
        claims.refused.append(f"{_named(search, found.best)} is not claimed: {nearest}")
    unknown, fit = _unknown(search, claims, unknown, closed, refused)
    unknown["where"] = unknown["where"] or left_beside(search, Hypothesis(), fit.values)
    kept = state.left if state.verdict == Verdict.UNEXPLAINED else ""  # else it is what the names left
    state = replace(state.unclaimed(), unknown=unknown, left=state.selection.left(fit) or kept)
    return replace(state, found=replace(state.found, fit=fit))


def _alike(search: Search, best: Hypothesis, explained: float, unknown: dict) -> bool:
    """Whether a term without a name is what is named: of the same signals in one equation, where that explains most."""
    effects = [search.effects[key] for key in best.effects]
    if len(effects) != 1 or effects[0].smooth or explained < ALIKE:
        return False
    plant = search.rig.plant
    signals = names(effects[0].terms.values()) & {*plant.states, *plant.inputs}
    return any(
        place["equation"] in effects[0].equations and signals == {*place["depends_on"]} for place in unknown["where"]
    )


def _held_out(state: State) -> State:
    """What is worn does not make the held-out recording worse; it is fitted otherwise before it is taken back.

    What is a fault of one recording alone need not be in another.
    """
    search, best, claims, fit = state.search, state.found.best, state.claims, state.found.fit
    term = (state.unknown.get("effect") or {}) if not best.size else {}
    if search.unseen or not (best.size or term) or _faults(search, best):
        return state

    def why(fit: Fit) -> str:
        return no_better(search, claims.calibrated, fit, lasting(search, best, fit))

    if not (no := why(fit)):
        return state
    taken = f"{_named(search, best)} is taken back: {no}"
    try:
        return _otherwise(state, term, no, taken, why)
    except OutOfTime:
        search.left_out(AFTER)
        with search.budget.held(math.inf):  # what makes it worse does not stay for want of time
            return _bared(state, no) if term else _judged(_reduced(state, Hypothesis(), taken))


def _otherwise(state: State, term: dict, no: str, taken: str, why: Callable[[Fit], str]) -> State:
    """What is worn in place of that which makes the held-out recording worse."""
    search, best, claims = state.search, state.found.best, state.claims
    if term:
        return _bared(state, no)
    judge = Judge(claims.fit.likelihood)
    for other in filter(None, (fitted_by_rule(search, best, state.found.fit), fitted_beside(claims))):
        if not (why(other) or unborne(search, best, other) or _no_better(judge, claims.calibrated, other)):
            return _written(state, replace(claims, fit=other))
    return _held_out(_closed(_lasting(_judged(_reduced(state, Hypothesis(), taken)))))


def _bared(state: State, no: str) -> State:
    """The same without its term that has no name."""
    claims = state.claims
    refused = replace(claims, refused=[*claims.refused, f"no term is fitted: {no}"])
    found = replace(state.found, fit=_bare(state.search, claims))
    return replace(state, claims=refused, unknown={**state.unknown, "effect": None}, found=found)


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


def _verdict(best: Hypothesis, open_: bool, explained: float, left: float, faults: bool = False) -> Verdict:
    """open_: whether structure is left. left: squared errors over those of the noise, infinite where none is told.

    faults: whether nothing but faults of the recording are claimed: what those leave is of the machine, however large
    they are.
    """
    if open_ and (faults or explained < SHARE or left > ADEQUATE):
        return Verdict.PARTLY_EXPLAINED if best.effects and explained >= PART else Verdict.UNEXPLAINED
    if best.effects:
        return Verdict.MISSING_PHYSICS
    return Verdict.PARAMETER_ERROR if best.size else Verdict.CONSISTENT


def _named(search: Search, hypothesis: Hypothesis) -> str:
    return " + ".join(named(search, key) for key in (*hypothesis.effects, *hypothesis.released))


def _taken(unknown: dict) -> float:
    """The share of the misfit that a term takes there: all, where it is a sensor, which has no term; none nowhere."""
    return (unknown.get("effect") or {}).get("confidence", 1.0) if unknown["where"] else 0.0


def _no_term(calibrated: Fit, unknown: dict, closed: Fit | None) -> str:
    """Why the term that `closure` found (with `closed`, the fit with it) is none; empty where it is one, or none is."""
    if closed is None:
        return ""
    if _taken(unknown) < CLOSED:
        return f"it takes {_taken(unknown):.0%} of the misfit"
    judge, halves = Judge(closed.likelihood), Judge(closed.likelihood, halves=True)
    losses = judge.losses(calibrated, closed) or judge.throughout(calibrated, closed)
    losses = losses or halves.losses(calibrated, closed)
    return f"with it {losses[0]}" if losses else ""


def _carries_not_over(search: Search, claims: Claims) -> bool:
    """Whether what is claimed beside something unexplained is refused: learnt from one half, it spoils the other.

    Or, with its parameters held to their tolerances, it no longer passes the gate of blocks.
    """
    judges = (Judge(claims.fit.likelihood, halves) for halves in (True, False))
    losses = next((found for judge in judges if (found := judge.losses(claims.calibrated, claims.fit))), [])
    if losses:
        what = _named(search, claims.best)
        claims.refused.append(f"{what} is not claimed: something is left, and with it {losses[0]}")
    return bool(losses)


def _unknown(search: Search, claims: Claims, unknown: dict, closed: Fit | None, refused: str) -> tuple[dict, Fit]:
    """(where and effect of what no effect explains; the fit with a term for it, if one is worth it).

    unknown, closed: what `closure` found. refused: why its term is none.
    """
    if closed is not None and not refused:
        return unknown, closed
    if refused:
        claims.refused.append(f"no term is fitted: {refused}")
        regime = "no function of the signals that was tried takes what is left"
        bare = [{key: place[key] for key in ("equation", "depends_on")} for place in unknown["where"]]
        unknown = {**unknown, "where": [{**place, "regime": regime} for place in bare]}
    return {**unknown, "effect": None}, _bare(search, claims)


def _bare(search: Search, claims: Claims) -> Fit:
    """The calibrated plant, its values as they are: fitted anew to long windows, they may predict worse."""
    plain = claims.calibrated
    return search.final.fit(plain.unknowns, plain.values, iterations=0)


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
            labels = (run if run not in recordings else files[run] for run in files)
            parts |= dict(zip(labels, model.pieces, strict=True))
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
