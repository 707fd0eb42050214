"""The expert of thesis figures 3.1 and 3.3: proposes a structure, trains it, tests each step, takes back what fails.

It decides on the end of each recording to train on, which no step is fitted to. Recordings to test on are judged once,
when all is decided.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from math import comb
from time import monotonic

import numpy as np

from greygate.compiler.pipeline import entropy_pruning
from greygate.errors import InputError
from greygate.identify.baseline import linear, of_one
from greygate.identify.expert.acting import acting
from greygate.identify.expert.decisions import Decision, Log
from greygate.identify.expert.diagnosed import READS, Corrected, asked, correct
from greygate.identify.expert.integration import SCHEMES, UNSTABLE
from greygate.identify.expert.parts import Part
from greygate.identify.expert.refined import refined
from greygate.identify.expert.task import Task
from greygate.identify.expert.wiring import Choices, Joined, Wiring, plain, poor
from greygate.mismatch.diagnose import OPEN_VERDICTS
from greygate.mismatch.rig import Rig
from greygate.models.accuracy import Errors, float_error, free_run_rms, rms
from greygate.models.network import Network, Port, Runner
from greygate.models.prune import retrained
from greygate.models.saliency import obs, saliency_pruning
from greygate.models.simplify import parameter_count, simplify
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.progress import Budget, Progress, silent

JUDGED, TESTED = 0.25, 0.2  # of each recording, its end: for decisions, and to test where nothing else is given
BLOCKS = 4  # of what is held out of each recording: a step must help in most of them
GAIN = 0.98  # of the error before: what a step that adds something must reach
EARNED = 0.9  # likewise of a term that nothing is known of: beyond what it was trained on it may do anything
CHANCE = 0.05  # probability that so many blocks are better by chance: below, such a term needs no more than others
ALLOWED = 1.02  # of the error before: what a step that removes something may reach
TAPS = 4
FEWER, MORE = 4, 8  # neurons of an unknown term
EPOCHS, REFIT, REMOVAL = 25, 15, 4
DECAY = 1e-6
HELD = 1.0  # tolerances that a parameter may be off beside something unexplained, which draws it
FINE, COARSE = 1e-3, 1e-2  # of the plant's motion: where no finer integration is tried, and what none may miss
DIAGNOSING = 2e9  # steps of states that a diagnosis simulates (`Model.work`), two minutes: it tries nothing further
ROUNDS, SLOPE = 24, 1e-7  # of Newton's method for a state before the first sample; of its scale, for a difference
HALVINGS = 8  # of a step of that, of which the best is taken: far from the end a product leads astray
ALIKE = 1.25  # of the least miss, within which the cheaper integration is as good
FEW = 4  # evaluations a sample, with which no more are tried where a part only comes near its term
EXERCISED = (0.85, 1.15)  # of an input, in an exercise
REHEARSAL = 10.0  # times as much as the recordings count all samples of what a part stands for


@dataclass(frozen=True)
class Built:
    """network, and figures by step; rms: who -> recording -> target -> RMS error, in its unit.

    diagnosis: what it was built after; None where there is none.
    """

    network: Network
    log: Log
    rms: Mapping[str, Errors]
    seconds: float
    diagnosis: Mapping | None = None


@dataclass(frozen=True)
class Candidate:
    """A network with the choices behind it, and its error on the ends of the recordings."""

    joined: Joined
    network: Network
    choices: Choices
    error: float


def build(
    plant: Plant | Rig,
    recordings: Mapping[str, Recording],
    tests: Mapping[str, Recording],
    sensors: Sequence[str] = (),
    targets: Sequence[str] = (),
    seconds: float = np.inf,
    progress: Progress = silent,
    diagnosis: Mapping | None = None,
) -> Built:
    """Build the network of a plant, or of a rig's, on recordings. tests: to judge the result on, else their ends.

    diagnosis: of the plant; else the recordings are diagnosed first, without the ends that decide.
    Raises InputError for a plant or recordings that no network can be made of.
    """
    began = monotonic()
    given = Task.of(plant, [*recordings.values(), *tests.values()], sensors, targets)
    log, known = Log(), given
    knees: Mapping[str, float] = {}
    if diagnosis is None:
        diagnosis = diagnosed(given, recordings, bool(tests), Budget(seconds / 2, DIAGNOSING), log, progress)
    if diagnosis is not None and _drawn(diagnosis):
        log("diagnose", given.plant.name, "the data sheet's values", "what is missing has no name, and draws others")
    elif diagnosis is not None:
        found = correct(given, [*recordings.values()], diagnosis)
        known = corrected_task(given, found, sensors, diagnosis, log)
        knees = found.knees
        within = HELD if diagnosis.get("verdict") in OPEN_VERDICTS else np.inf
        known = best_fit(known, given, recordings, bool(tests), found.own, log, progress, within)
    remains = diagnosis is None or diagnosis.get("verdict") in OPEN_VERDICTS

    said = len(log.decisions)

    def decided(task: Task) -> Decided:
        del log.decisions[said:]
        expert = Expert(task, given, recordings, tests, began + seconds, log, progress, remains)
        return Decided(expert, expert.decided(), log.decisions[said:])

    best = followed(decided, known, knees)
    if remains and known is not given and not best.expert.out_of_time():
        best = better(best, decided, given)
    log.decisions[said:] = best.log
    network = best.expert.smaller(best.expert.refitted(best.found))
    progress("training a linear model to compare with")
    return Built(network, log, best.expert.scores(network), monotonic() - began, diagnosis)


@dataclass(frozen=True)
class Decided:
    """What an expert found for a task, and its decisions."""

    expert: "Expert"
    found: Candidate
    log: list[Decision]

    def but(self, step: str, about: str, choice: str, reason: str, undone: bool = False) -> "Decided":
        """The same, with a decision that was made before all others."""
        return replace(self, log=[Decision(step, about, choice, reason, undone), *self.log])


def followed(decided: Callable[[Task], Decided], known: Task, knees: Mapping[str, float]) -> Decided:
    """What is decided of a task; where no integration follows it, of the same with softer knees."""
    try:
        return decided(known)
    except Unfollowed as problem:
        if (softer := softened(known, knees)) is None:
            raise
        what = ", ".join(f"{s} {softer.plant.parameters[s].value:.4g}" for s in knees)
        return decided(softer).but("soften", known.plant.name, what, f"the end of its interval; else {problem.why}")


def better(corrected: Decided, decided: Callable[[Task], Decided], given: Task) -> Decided:
    """What is decided of the data sheet's plant, where that is better: a diagnosis that leaves something open can lead
    astray.
    """
    try:
        plain = decided(given)
    except InputError as problem:
        return corrected.but("start", given.plant.name, "the data sheet's plant", problem.args[0], undone=True)
    errors = [one.found.error for one in (plain, corrected)]
    blocks = [one.expert.by_block(one.found.network) for one in (plain, corrected)]
    less = sum(a < b for a, b in zip(*blocks, strict=True))
    undone = not (errors[0] < GAIN * errors[1] and 2 * less > len(blocks[0]))
    where = f"less in {less} of {len(blocks[0])} blocks"
    why = f"error {errors[1]:.3g} from the diagnosed plant, {errors[0]:.3g} from this, {where}"
    return (corrected if undone else plain).but("start", given.plant.name, "the data sheet's plant", why, undone)


class Unfollowed(InputError):
    """No integration follows the plant. why: which term turns too fast, and by how much it is missed."""

    def __init__(self, plant: str, why: str):
        super().__init__(f"plant {plant}: no network of it: {why}; record faster, or soften what is steep")
        self.why = why


def softened(task: Task, knees: Mapping[str, float]) -> Task | None:
    """The task with what shapes its effects at the upper ends of their intervals; None where none is softer."""
    known = task.plant.parameters
    softer = {s: end for s, end in knees.items() if end > known[s].value}
    return replace(task, plant=task.plant.with_parameters(**softer)) if softer else None


def _drawn(diagnosis: Mapping) -> bool:
    """Whether a diagnosis leaves something open and names nothing: its values make up for that on one recording."""
    return diagnosis.get("verdict") in OPEN_VERDICTS and not diagnosis["effects"]


def parts_of(recordings: Mapping[str, Recording], tested: bool) -> tuple[dict[str, int], dict[str, int]]:
    """Samples of each recording: (to train on, of these those that no decision is made on)."""
    ends = {n: r.samples if tested else int((1 - TESTED) * r.samples) for n, r in recordings.items()}
    return ends, {n: int((1 - JUDGED) * end) for n, end in ends.items()}


def diagnosed(
    task: Task, recordings: Mapping[str, Recording], tested: bool, budget: Budget, log: Log, progress: Progress
) -> Mapping | None:
    """The diagnosis of what is trained on; None, with the reason in the log, where there is none."""
    _, heads = parts_of(recordings, tested)
    try:
        _, found = asked(task, [upto(r, heads[n]) for n, r in recordings.items()], budget, progress)
    except InputError as problem:
        log("diagnose", task.plant.name, "the data sheet as it is", f"no diagnosis: {problem}", undone=True)
        return None
    return found


def corrected_task(task: Task, found: Corrected, sensors: Sequence[str], diagnosis: Mapping, log: Log) -> Task:
    """The task of the plant as a diagnosis corrects it."""
    what = ", ".join(f"{s} {p['value']:.4g}" for s, p in diagnosis["parameters"].items()) or "the data sheet's values"
    log("diagnose", found.plant.name, what, f"the verdict is {diagnosis.get('verdict', 'told')}")
    for where, what, why in found.said:
        log("diagnose", where, what, why)
    reduced = diagnosis.get(READS) == list(task.inputs)
    made = Task.over(found.plant, task.step, task.inputs, () if reduced else sensors, task.targets)
    return replace(made, measured=task.measured, filters=found.filters, readings=found.readings)


def best_fit(
    task: Task, given: Task, recordings: Mapping[str, Recording], tested: bool, own: Mapping[str, str], log: Log,
    progress: Progress, within: float,
) -> Task:  # fmt: skip
    """The diagnosed task refined in free run, where that is better on what decides. given: that of the data sheet.

    within: tolerances that a parameter of it may be off.
    """
    ends, heads = parts_of(recordings, tested)
    fitted = [upto(r, heads[n]) for n, r in recordings.items()]
    judged = {n: upto(r, ends[n]) for n, r in recordings.items()}

    def left(task: Task) -> float:
        try:
            runs = {n: task.nominal(r) for n, r in judged.items()}
        except InputError:  # it diverges
            return np.inf
        errors = [rms(runs[n][t] - r[t], heads[n]) / (float(np.std(r[t])) or 1.0) for n, r in judged.items()
                  for t in task.targets]  # fmt: skip
        return float(np.sqrt(np.mean(np.square(errors))))

    best, before = task, left(task)
    for what, other in refined(task, given.plant.parameters, fitted, own, progress, within):
        error = left(other)
        undone = not error < GAIN * before
        moved = {s: p.value for s, p in other.plant.parameters.items() if p != best.plant.parameters.get(s)}
        values = ", ".join(f"{s} {v:.4g}" for s, v in moved.items())
        why = f"error {before:.3g} to {error:.3g} where it was not fitted"
        log("refine", task.plant.name, f"{what}: {values}", why, undone)
        best, before = (best, before) if undone else (other, error)
    return best


def upto(recording: Recording, stop: int) -> Recording:
    """The first samples of a recording."""
    cut = {c: v[:stop] for c, v in recording.channels.items()}
    return Recording(recording.dt, cut, recording.units, recording.source)


class Expert:
    """One building."""

    def __init__(
        self, task: Task, given: Task, recordings: Mapping[str, Recording], tests: Mapping[str, Recording],
        until: float, log: Log, progress: Progress, remains: bool = True,
    ):  # fmt: skip
        self.task, self.until, self.progress, self.log, self.remains = task, until, progress, log, remains
        self.recordings, self.tests = recordings, tests
        self.ends, self.heads = parts_of(recordings, bool(tests))
        self.nominal = {n: task.nominal(r) for n, r in {**recordings, **tests}.items()}
        self.given = self.nominal
        if given is not task:
            self.given = {n: given.nominal(r) for n, r in {**recordings, **tests}.items()}
        known = {n: self._known(n) for n in recordings}
        names = next(iter(known.values()))
        self.signals = {s: np.concatenate([known[n][s][: self.ends[n]] for n in known]) for s in names}
        measured = {t: np.concatenate([r[t][: self.ends[n]] for n, r in recordings.items()]) for t in task.targets}
        self.sizes = {t: float(np.std(v)) or 1.0 for t, v in measured.items()}
        self.parts: dict[str, Part] = {}
        self.begins: dict[str, dict] = {}
        where = "the recordings given to test on" if tests else f"the last {TESTED:.0%} of each recording"
        inputs, share = ", ".join(task.inputs), f"the last {JUDGED:.0%} of what is trained on"
        self.log("task", ", ".join(task.targets), f"predicted from {inputs}", f"{task.plant.name} has them so")
        self.log("task", "recordings", f"decisions by {share}", f"{where} are kept for the end")

    def _known(self, name: str) -> dict[str, np.ndarray]:
        """Every signal of a recording: as recorded or, where it is a state or a definition, as simulated."""
        recording = {**self.recordings, **self.tests}[name]
        return {**self.nominal[name], **self.task.signals(recording)}

    # ---- records

    def record(self, name: str) -> Record:
        """A recording as the network learns it: at its first sample the states that it predicts are as measured."""
        recording = {**self.recordings, **self.tests}[name]
        return replace(self.task.record(recording), initial=dict(self.begins.get(name, {})))

    def fitted(self) -> list[Record]:
        return [self.record(n).cut(0, head) for n, head in self.heads.items()]

    def judges(self) -> list[Record]:
        return [self.record(n).cut(0, self.ends[n], skip=head) for n, head in self.heads.items()]

    def by_block(self, network: Network) -> list[float]:
        """The error in each of the blocks that decide: parts of what is held out of each recording."""
        found = []
        for judge in self.judges():
            ends = np.linspace(judge.skip, len(judge), BLOCKS + 1).astype(int)
            pieces = [judge.cut(0, stop, skip=start) for start, stop in pairwise(ends.tolist())]
            found += [self.error(network, [piece]) for piece in pieces]
        return found

    def error(self, network: Network, records: Sequence[Record]) -> float:
        """RMS over all records of the targets' errors, each over the deviation of its target; inf where it diverges."""
        found = [free_run_rms(network, r)[t] / self.sizes[t] for r in records for t in self.task.targets]
        return float(np.sqrt(np.mean(np.square(found))))

    def scores(self, network: Network) -> dict[str, Errors]:
        """RMS error of the network, of the plant's own simulation as given and as diagnosed, and of linear models,
        by recording and target, in its unit.

        Of a recording that is learnt in part, its end apart.
        """
        found: dict[str, Errors] = {"network": {}, "nominal": {}, "corrected": {}, "linear": {}}
        learnt, targets = [self.record(n).cut(0, end) for n, end in self.ends.items()], self.task.targets
        rivals = {t: linear([of_one(r, t) for r in learnt]) for t in targets}
        for name, recording in {**self.recordings, **self.tests}.items():
            record, simulated = self.record(name), {"nominal": self.given[name], "corrected": self.nominal[name]}
            spans = {name: (0, self.ends.get(name, len(record)))}
            if name in self.recordings and not self.tests:
                spans[f"{name} end"] = (self.ends[name], len(record))
            for label, (start, stop) in spans.items():
                cut = record.cut(0, stop, skip=start)
                found["network"][label] = free_run_rms(network, cut)
                for who, run in simulated.items():
                    found[who][label] = {t: rms((run[t] - recording[t])[start:stop]) for t in targets}
                found["linear"][label] = {t: free_run_rms(rival, of_one(cut, t))[t] for t, rival in rivals.items()}
        return found

    # ---- exercises

    def exercises(self, network: Network) -> list[Record]:
        """Runs that nobody recorded, with a network's own answers: inputs mirrored, every second one smaller, larger.

        They keep what it does beyond the recordings while it is pruned. One on which it diverges is left out.
        """
        inputs = self.task.inputs
        signed = [n for n in inputs if self.signals[n].min() < 0 < self.signals[n].max()]
        turns = [dict.fromkeys(signed, -1.0), *(dict.fromkeys(inputs[::2], factor) for factor in EXERCISED)]
        found = []
        for name, head in self.heads.items():
            for turn in turns:
                record = self.record(name).cut(0, head // 2)
                moved = {n: v * turn.get(n, 1.0) for n, v in record.inputs.items()}
                first = {n: float(v[0]) for n, v in moved.items() if n in self.task.measured}
                record = replace(record, inputs=moved, initial={**record.initial, **first})
                with suppress(InputError):
                    found.append(replace(record, targets=_answers(network, record)))
        return found

    # ---- steps

    def join(self, choices: Choices) -> Joined:
        first = {n: float(next(iter(self.recordings.values()))[n][0]) for n in self.task.inputs}
        joined = Wiring(self.task, self.signals, first, choices, self.parts, self.log).join()
        self.begins = {n: self._begun(joined, n) for n in {**self.recordings, **self.tests}}
        first = self.begins[next(iter(self.recordings))]
        for path in joined.states:
            joined.network.modules[path] = replace(joined.network.layers()[path], initial=np.atleast_1d(first[path]))
        return joined

    def _begun(self, joined: Joined, name: str) -> dict[str, float | np.ndarray]:
        """What a network is before the first sample, so that its states are there as the recording's or the plant's."""
        recording, network = {**self.recordings, **self.tests}[name], joined.network
        found: dict[str, float | np.ndarray] = {n: float(recording[n][0]) for n in self.task.measured}
        for n, filters in self.task.filters.items():
            behind = Network(n, [Port(n)])
            acting(behind, n, network.port(n).scale, filters, float(recording[n][0]), self.task.step)
            found |= {path: layer.initial for path, layer in behind.layers().items()}
        wanted = {path: self.nominal[name][s][0] / size for path, (s, size) in joined.states.items()}
        return found | before(network, {n: recording[n][0] for n in self.task.inputs}, found, wanted)

    def train(self, joined: Joined, records: Sequence[Record], epochs: int = EPOCHS) -> Network:
        """The network trained in free run on these records, its parts rehearsed on what they stand for."""
        samples = sum(len(r) for r in records)
        rehearse = {n: replace(r, weight=REHEARSAL * samples / len(r)) for n, r in joined.rehearse.items()}
        fit = train(
            joined.network, records, epochs=epochs, decay=DECAY, rehearse=rehearse, bounds=joined.bounds,
            tied=joined.tied, seconds=self.left(), progress=self.progress,
        )  # fmt: skip
        return joined.network.with_parameters(fit.network.parameters())

    def left(self) -> float:
        return max(self.until - monotonic(), 1.0)

    def out_of_time(self) -> bool:
        return monotonic() > self.until

    def decided(self) -> Candidate:
        return self.widened(self.trained(self.assembled()))

    def assembled(self) -> Candidate:
        """The plant's own equations as a network, with every input as it is best read."""
        self.progress("joining")
        best = self.integrated()
        begins = self.begins
        for name in self.task.inputs:
            if name in self.task.measured or self.task.filters.get(name):
                continue
            choices = replace(best.choices, straight=best.choices.straight | {name})
            other = self.join(choices)
            error = self.error(other.network, self.fitted())
            straight = error < GAIN * best.error
            less, more = sorted((error, best.error))
            said = f"the plant's own error is {less:.3g} so and {more:.3g} otherwise"
            self.log("join", name, "straight from sample to sample" if straight else "held over a sample", said)
            if straight:
                best, begins = Candidate(other, other.network, choices, error), self.begins
        self.begins = begins
        judged = self.error(best.network, self.judges())
        size = f"{len(best.network.layers())} layers, {parameter_count(best.network)} parameters"
        why = f"its equations ask for them; error {judged:.3g} of the deviation of the targets before training"
        self.log("join", self.task.plant.name, size, why)
        return replace(best, error=judged)

    def integrated(self) -> Candidate:
        """The cheapest integration with which the network is the plant. Raises InputError where none is.

        Where a part is a network that only comes near its term, no integration can make up for that, but training may.
        """
        term, turns = self.task.fastest(self.signals)
        found: list[tuple[float, Choices]] = []
        near: list[str] = []
        for scheme in SCHEMES:
            if turns > UNSTABLE * scheme.substeps and scheme != SCHEMES[-1]:
                continue
            choices = Choices(scheme=scheme, straight=self.task.measured)
            network = self.join(choices).network
            found.append((self.away(network), choices))
            near = [plain(name) for name, module in network.modules.items() if isinstance(module, Network)]
            if found[-1][0] <= FINE or (near and scheme.evaluations >= FEW):
                break
        least = min(away for away, _ in found)
        away, choices = next(pair for pair in found if pair[0] <= max(FINE, ALIKE * least))
        why = f"{term} turns by {turns:.2g} in a sample of {self.task.step:g} s" if term else "no term of it is fast"
        missed = f"it misses the plant's own simulation by {away:.2g} of its motion"
        if not away <= COARSE and not (near and np.isfinite(away)):
            raise Unfollowed(self.task.plant.name, f"{why}, and with {choices.scheme} {missed}, {COARSE:g} is allowed")
        if not away <= COARSE:
            missed += f", because {', '.join(dict.fromkeys(near))} only come near their terms"
        self.log("join", "integration", str(choices.scheme), f"{why}; {missed}")
        joined = self.join(choices)
        return Candidate(joined, joined.network, choices, self.error(joined.network, self.fitted()))

    def away(self, network: Network) -> float:
        """By how much a network misses the plant's simulation: RMS over its motion, of the target it misses most."""
        found = []
        for name, head in self.heads.items():
            plant = {t: self.nominal[name][t][:head] for t in self.task.targets}
            missed = free_run_rms(network, replace(self.record(name).cut(0, head), targets=plant))
            found += [missed[t] / (float(np.std(plant[t])) or self.sizes[t]) for t in self.task.targets]
        return max(found)

    def trained(self, start: Candidate) -> Candidate:
        if not trainable(start.network):
            self.log("train", "the whole", "nothing", "every weight of it is the plant's own")
            return start
        self.progress("training")
        network = self.train(start.joined, self.fitted())
        error = self.error(network, self.judges())
        worse = not error < start.error
        why = f"error {start.error:.3g} to {error:.3g} where it did not learn"
        self.log("train", "the whole, in free run", f"{EPOCHS} epochs", why, worse)
        return start if worse else Candidate(replace(start.joined, network=network), network, start.choices, error)

    def widened(self, best: Candidate) -> Candidate:
        """Other inputs, freer values, unknown terms and larger parts; what gains nothing is undone.

        Each is attempted alone first: what gains most goes first, for what follows depends on it.
        """
        ways = self.ways()
        alone = {way.about: self.attempt(best, way) for way in (ways if len(ways) > 1 else ())}
        if alone:
            ways.sort(key=lambda way: alone[way.about].error)
            errors = ", ".join(f"{about} {attempt.error:.3g}" for about, attempt in alone.items())
            self.log("widen", "order", ", ".join(way.about for way in ways), f"alone the errors are {errors}")
        for i, way in enumerate(ways):
            before, best = best, self.tried(best, way, alone.get(way.about) if i == 0 else None)
            if way.place and best is not before:
                best = self.tried(best, _unknown(way.place, MORE))
        if not self.remains:
            self.log("widen", self.task.plant.name, "no unknown terms", "the diagnosis leaves nothing to explain")
        if trained := [n for n, p in self.parts.items() if not p.of_library]:
            best = self.tried(best, Way(", ".join(trained), "more neurons", lambda c: replace(c, larger=1)))
        return best

    def ways(self) -> list["Way"]:
        """To widen the network."""
        found = [_unknown(place, FEWER) for place in self.places()] if self.remains else []
        if rates := [rate for rate in self.task.rates if not poor(self.signals[rate])]:
            what = f"each rate from {TAPS} differences"
            found.append(Way(", ".join(rates), what, lambda c: replace(c, taps=TAPS)))
        what = "uncertain parameters within their tolerances"
        return [*found, Way("data sheet", what, lambda c: replace(c, free=True))]

    def places(self) -> list[str]:
        """Where a term may be missing: where the plant says so, else in every balance that is more than a rate."""
        plant = self.task.plant
        here = {*self.task.definitions, *self.task.equations.values()}
        if plant.closure.places:
            return [p for p in plant.closure.places if p in here]
        rates = [n for n, e in plant.equations.items() if all(term in plant.states for term in e.terms.values())]
        return [n for n in self.task.equations.values() if n not in rates]

    def attempt(self, best: Candidate, way: "Way") -> "Attempt":
        """The network of a candidate widened in one way and trained, if there is time."""
        if self.out_of_time():
            return Attempt(why="the time is used up")
        self.progress(f"trying {way.what} ({way.about})")
        choices, kept = way.change(best.choices), (self.parts, self.begins)
        if choices.larger != best.choices.larger:
            self.parts = {n: p for n, p in self.parts.items() if p.of_library}
        try:
            joined = self.join(choices)
            known, now = best.network.parameters(), joined.network.parameters()
            same = {n: known[n] for n, v in now.items() if n in known and known[n].shape == v.shape}
            joined.network = joined.network.with_parameters(same)
            network = self.train(joined, self.fitted())
            found = Candidate(replace(joined, network=network), network, choices, self.error(network, self.judges()))
            return Attempt(found, found.error, self.by_block(network), self.parts, self.begins)
        except InputError as problem:
            return Attempt(why=str(problem))
        finally:
            self.parts, self.begins = kept

    def tried(self, best: Candidate, way: "Way", attempt: "Attempt | None" = None) -> Candidate:
        """The candidate widened in one way if it is better where it did not learn, else the one before."""
        attempt = attempt or self.attempt(best, way)
        if attempt.found is None:
            self.log("widen", way.about, way.what, attempt.why, undone=True)
            return best
        of_best = self.by_block(best.network)
        fewer = sum(a < b for a, b in zip(attempt.blocks, of_best, strict=True))
        gain = EARNED if way.place and chance(fewer, len(of_best)) > CHANCE else GAIN
        undone = not (attempt.error < gain * best.error and 2 * fewer > len(of_best))
        why = f", not below {gain:g} of it" if not attempt.error < gain * best.error else ""
        said = f"error {best.error:.3g} to {attempt.error:.3g}{why}, less in {fewer} of {len(of_best)} blocks"
        self.log("widen", way.about, way.what, said, undone)
        if undone:
            return best
        self.parts, self.begins = attempt.parts, attempt.begins
        return attempt.found

    # ---- smaller

    def smaller(self, best: Candidate) -> Network:
        """The generic network without the neurons and weights that it can do without."""
        network = simplify(best.network)
        size = f"{len(network.layers())} layers of {len(best.network.flatten().layers())}"
        self.log("simplify", "linear layers", size, "the function stays the same")
        own = self.exercises(best.network)
        fitted, judges = [*self.fitted(), *own], [*self.judges(), *own]
        retrain = partial(retrained, records=fitted, epochs=REMOVAL, decay=DECAY)
        passes: dict[str, Callable] = {
            "neurons, by entropy": entropy_pruning(fitted, retrain, ALLOWED, held=judges),
            "weights, by optimal brain surgeon": saliency_pruning(fitted, obs, ALLOWED, held=judges, epochs=REMOVAL),
        }
        for about, prune in passes.items():
            if self.out_of_time():
                self.log("prune", about, "not tried", "the time is used up")
                continue
            self.progress(f"pruning {about}")
            network = self._pruned(network, prune, about, judges)
        return network

    def _pruned(self, network: Network, prune: Callable, about: str, judges: Sequence[Record]) -> Network:
        before = self.error(network, judges)
        smaller, rounds = prune(network)
        error = self.error(smaller, judges)
        kept = sum(r.kept for r in rounds)
        sizes = [f"{n.neurons()} neurons and {parameter_count(n)} parameters" for n in (network, smaller)]
        undone = not error <= ALLOWED * before
        why = f"error {before:.3g} to {error:.3g}, exercises included; of {len(rounds)} rounds {kept} held"
        self.log("prune", about, " to ".join(sizes), why, undone)
        return network if undone else smaller

    def refitted(self, best: Candidate) -> Candidate:
        """The structure that is decided on, trained on the whole of the recordings."""
        if not trainable(best.network):
            return best
        self.progress("training on the whole recordings")
        whole = [self.record(n).cut(0, end) for n, end in self.ends.items()]
        before = self.error(best.network, whole)
        network = self.train(replace(best.joined, network=best.network), whole, REFIT)
        after = self.error(network, whole)
        undone = not after < before
        why = f"the structure is decided; error {before:.3g} to {after:.3g}"
        self.log("train", "the whole recordings", f"{REFIT} epochs", why, undone)
        return best if undone else replace(best, network=network)


def chance(better: int, of: int) -> float:
    """The probability that so many blocks or more are better by chance alone."""
    return sum(comb(of, k) for k in range(better, of + 1)) / 2**of


@dataclass(frozen=True)
class Way:
    """To widen a network. about, what: it in words. place: where a term is added, if one is."""

    about: str
    what: str
    change: Callable[[Choices], Choices]
    place: str = ""


def _unknown(place: str, neurons: int) -> Way:
    def change(choices: Choices) -> Choices:
        return replace(choices, unknown={**choices.unknown, place: neurons})

    return Way(place, f"an unknown term of {neurons} neurons", change, place)


@dataclass(frozen=True)
class Attempt:
    """What came of a way to widen, or why nothing; parts, begins: of the expert with it."""

    found: Candidate | None = None
    error: float = np.inf
    blocks: Sequence[float] = ()
    parts: dict[str, Part] = field(default_factory=dict)
    begins: dict[str, dict] = field(default_factory=dict)
    why: str = ""


def before(
    network: Network,
    inputs: Mapping[str, float],
    initial: Mapping[str, float | np.ndarray],
    wanted: Mapping[str, float],
) -> dict[str, float | np.ndarray]:
    """The states before the first sample, by layer, normalised, after which they are as wanted: Newton's method.

    inputs: at the first sample. initial: of what is no state. Where no such states are found, the wanted ones.
    """
    flat, paths, goal = network.flatten(), [*wanted], np.array([*wanted.values()])

    def missed(at: np.ndarray) -> np.ndarray:
        runner = Runner(flat, {**initial, **dict(zip(paths, at, strict=True))})
        answer = runner.step({n: np.array([v]) for n, v in inputs.items()}, trace=True)
        return np.array([float(answer[path][0]) for path in paths]) - goal

    at, error = goal, missed(goal) if paths else goal
    for _ in range(ROUNDS if paths else 0):
        slopes = np.stack([(missed(at + SLOPE * row) - error) / SLOPE for row in np.eye(len(at))], axis=1)
        step = np.linalg.lstsq(slopes, error)[0]
        trials = [at - step / 2**k for k in range(HALVINGS)]
        trial, left = min(((t, missed(t)) for t in trials), key=lambda pair: np.abs(pair[1]).max())
        if not np.abs(left).max() < np.abs(error).max():
            break
        at, error = trial, left
    return dict(zip(paths, map(float, at), strict=True))


def _answers(network: Network, record: Record) -> dict[str, np.ndarray]:
    errors = float_error(network, record)
    return {n: record.targets[n] + e for n, e in errors.items()}


def trainable(network: Network) -> bool:
    """Whether training may move any weight."""
    return any({*layer.weights, "bias"} - layer.frozen for layer in network.layers().values())
