"""The expert of thesis figures 3.1 and 3.3: proposes a structure, trains it, tests each step, takes back what fails.

It decides on the end of each recording to train on, which no step is fitted to. Recordings to test on are judged once,
when all is decided.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from time import monotonic

import numpy as np

from greygate.compiler.pipeline import entropy_pruning
from greygate.errors import InputError
from greygate.identify.baseline import linear, of_one
from greygate.identify.expert.decisions import Log
from greygate.identify.expert.parts import Part
from greygate.identify.expert.task import Task
from greygate.identify.expert.wiring import Choices, Joined, Wiring, poor
from greygate.models.accuracy import Errors, float_error, free_run_rms, rms
from greygate.models.network import Network
from greygate.models.prune import retrained
from greygate.models.saliency import obs, saliency_pruning
from greygate.models.simplify import parameter_count, simplify
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent

JUDGED, TESTED = 0.25, 0.2  # of each recording, its end: for decisions, and to test where nothing else is given
GAIN = 0.98  # of the error before: what a step that adds something must reach
ALLOWED = 1.02  # of the error before: what a step that removes something may reach
TAPS, NEURONS = 4, (4, 8)
EPOCHS, REFIT, REMOVAL = 25, 15, 4
DECAY = 1e-6
EXERCISED = (0.85, 1.15)  # of an input, in an exercise
REHEARSAL = 10.0  # times as much as the recordings count all samples of what a part stands for


@dataclass(frozen=True)
class Built:
    """network, and figures by step; rms: who -> recording -> target -> RMS error, in its unit."""

    network: Network
    log: Log
    rms: Mapping[str, Errors]
    seconds: float


@dataclass(frozen=True)
class Candidate:
    """A network with the choices behind it, and its error on the ends of the recordings."""

    joined: Joined
    network: Network
    choices: Choices
    error: float


def build(
    plant: Plant,
    recordings: Mapping[str, Recording],
    tests: Mapping[str, Recording],
    sensors: Sequence[str] = (),
    targets: Sequence[str] = (),
    seconds: float = np.inf,
    progress: Progress = silent,
) -> Built:
    """Build the network of a plant. recordings: to train on; tests: to judge the result on, else ends of the former.

    Raises InputError for a plant or recordings that no network can be made of.
    """
    began = monotonic()
    task = Task.of(plant, [*recordings.values(), *tests.values()], sensors, targets)
    expert = Expert(task, recordings, tests, began + seconds, progress)
    network = expert.built()
    progress("training a linear model to compare with")
    return Built(network, expert.log, expert.scores(network), monotonic() - began)


class Expert:
    """One building."""

    def __init__(
        self, task: Task, recordings: Mapping[str, Recording], tests: Mapping[str, Recording], until: float,
        progress: Progress,
    ):  # fmt: skip
        self.task, self.until, self.progress = task, until, progress
        self.log = Log()
        self.recordings, self.tests = recordings, tests
        shares = {n: len(r.time) if tests else int((1 - TESTED) * len(r.time)) for n, r in recordings.items()}
        self.ends = shares
        self.heads = {n: int((1 - JUDGED) * end) for n, end in shares.items()}
        self.nominal = {n: task.nominal(r) for n, r in {**recordings, **tests}.items()}
        known = {n: self._known(n) for n in recordings}
        names = next(iter(known.values()))
        self.signals = {s: np.concatenate([known[n][s][: self.ends[n]] for n in known]) for s in names}
        measured = {t: np.concatenate([r[t][: self.ends[n]] for n, r in recordings.items()]) for t in task.targets}
        self.sizes = {t: float(np.std(v)) or 1.0 for t, v in measured.items()}
        self.parts: dict[str, Part] = {}
        self.states: Mapping[str, tuple[str, float]] = {}
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
        """A recording as the network learns it: states that it predicts start as measured."""
        recording = {**self.recordings, **self.tests}[name]
        found, targets = self.task.record(recording), self.task.targets
        start = {path: np.array([recording[s][0] / size]) for path, (s, size) in self.states.items() if s in targets}
        return replace(found, initial={**found.initial, **start})

    def fitted(self) -> list[Record]:
        return [self.record(n).cut(0, head) for n, head in self.heads.items()]

    def judges(self) -> list[Record]:
        return [self.record(n).cut(0, self.ends[n], skip=head) for n, head in self.heads.items()]

    def error(self, network: Network, records: Sequence[Record]) -> float:
        """RMS over all records of the targets' errors, each over the deviation of its target; inf where it diverges."""
        found = [free_run_rms(network, r)[t] / self.sizes[t] for r in records for t in self.task.targets]
        return float(np.sqrt(np.mean(np.square(found))))

    def scores(self, network: Network) -> dict[str, Errors]:
        """RMS error of the network, the plant's own simulation and linear models, by recording and target, in its unit.

        Of a recording that is learnt in part, its end apart.
        """
        found: dict[str, Errors] = {"network": {}, "nominal": {}, "linear": {}}
        learnt, targets = [self.record(n).cut(0, end) for n, end in self.ends.items()], self.task.targets
        rivals = {t: linear([of_one(r, t) for r in learnt]) for t in targets}
        for name, recording in {**self.recordings, **self.tests}.items():
            record, simulated = self.record(name), self.nominal[name]
            spans = {name: (0, self.ends.get(name, len(record)))}
            if name in self.recordings and not self.tests:
                spans[f"{name} end"] = (self.ends[name], len(record))
            for label, (start, stop) in spans.items():
                cut = record.cut(0, stop, skip=start)
                found["network"][label] = free_run_rms(network, cut)
                found["nominal"][label] = {t: rms((simulated[t] - recording[t])[start:stop]) for t in targets}
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
                first = {n: float(v[0]) for n, v in moved.items()}
                record = replace(record, inputs=moved, initial={**record.initial, **first})
                with suppress(InputError):
                    found.append(replace(record, targets=_answers(network, record)))
        return found

    # ---- steps

    def join(self, choices: Choices) -> Joined:
        joined = Wiring(self.task, self.signals, choices, self.parts, self.log).join()
        self.states = joined.states
        return joined

    def train(self, joined: Joined, records: Sequence[Record], epochs: int = EPOCHS) -> Network:
        """The network trained in free run on these records, its parts rehearsed on what they stand for."""
        samples = sum(len(r) for r in records)
        rehearse = {n: replace(r, weight=REHEARSAL * samples / len(r)) for n, r in joined.rehearse.items()}
        fit = train(
            joined.network, records, epochs=epochs, decay=DECAY, rehearse=rehearse, bounds=joined.bounds,
            seconds=self.left(), progress=self.progress,
        )  # fmt: skip
        return joined.network.with_parameters(fit.network.parameters())

    def left(self) -> float:
        return max(self.until - monotonic(), 1.0)

    def out_of_time(self) -> bool:
        return monotonic() > self.until

    def built(self) -> Network:
        best = self.trained(self.assembled())
        best = self.widened(best)
        return self.smaller(self.refitted(best))

    def assembled(self) -> Candidate:
        """The plant's own equations as a network, with every input as it is best read."""
        self.progress("joining")
        choices = Choices(free=not self.join(Choices()).rehearse)
        joined = self.join(choices)
        best = Candidate(joined, joined.network, choices, self.error(joined.network, self.fitted()))
        for name in self.task.inputs:
            if name not in self.task.plant.inputs or f"mean_{name}" not in joined.network.modules:
                continue
            choices = replace(best.choices, held=best.choices.held | {name})
            other = self.join(choices)
            error = self.error(other.network, self.fitted())
            held = error < best.error
            less, more = sorted((error, best.error))
            said = f"the plant's own error is {less:.3g} so and {more:.3g} otherwise"
            self.log("join", name, "held over a sample" if held else "straight from sample to sample", said)
            best = Candidate(other, other.network, choices, error) if held else best
        judged = self.error(best.network, self.judges())
        size = f"{len(best.network.layers())} layers, {parameter_count(best.network)} parameters"
        why = f"its equations ask for them; error {judged:.3g} of the deviation of the targets before training"
        self.log("join", self.task.plant.name, size, why)
        return replace(best, error=judged)

    def trained(self, start: Candidate) -> Candidate:
        self.progress("training")
        network = self.train(start.joined, self.fitted())
        error = self.error(network, self.judges())
        worse = not error < start.error
        why = f"error {start.error:.3g} to {error:.3g} where it did not learn"
        self.log("train", "the whole, in free run", f"{EPOCHS} epochs", why, worse)
        return start if worse else Candidate(replace(start.joined, network=network), network, start.choices, error)

    def widened(self, best: Candidate) -> Candidate:
        """Other inputs, unknown terms and larger parts, one after the other; what gains nothing is undone."""
        if rates := [rate for rate in self.task.rates if not poor(self.signals[rate])]:
            wider = replace(best.choices, taps=TAPS)
            best = self.tried(best, wider, ", ".join(rates), f"each rate from {TAPS} differences")
        for place in self.places():
            for neurons in NEURONS:
                wider = replace(best.choices, unknown={**best.choices.unknown, place: neurons})
                before, best = best, self.tried(best, wider, place, f"an unknown term of {neurons} neurons")
                if best is before:
                    break
        if not best.choices.free:
            what = "uncertain parameters within their tolerances"
            best = self.tried(best, replace(best.choices, free=True), "data sheet", what)
        if trained := [n for n, p in self.parts.items() if not p.of_library]:
            best = self.tried(best, replace(best.choices, larger=1), ", ".join(trained), "more neurons")
        return best

    def places(self) -> list[str]:
        """Where a term may be missing: where the plant says so, else in every balance that is more than a rate."""
        plant = self.task.plant
        here = {*self.task.definitions, *self.task.equations.values()}
        if plant.closure.places:
            return [p for p in plant.closure.places if p in here]
        rates = [n for n, e in plant.equations.items() if all(term in plant.states for term in e.terms.values())]
        return [n for n in self.task.equations.values() if n not in rates]

    def tried(self, best: Candidate, choices: Choices, about: str, what: str) -> Candidate:
        """The candidate with other choices if it is better where it did not learn, else the one before."""
        if self.out_of_time():
            self.log("widen", about, f"{what} not tried", "the time is used up")
            return best
        self.progress(f"trying {what} ({about})")
        parts = self.parts
        if choices.larger != best.choices.larger:
            self.parts = {n: p for n, p in parts.items() if p.of_library}
        try:
            joined = self.join(choices)
            known, now = best.network.parameters(), joined.network.parameters()
            same = {n: known[n] for n, v in now.items() if n in known and known[n].shape == v.shape}
            joined.network = joined.network.with_parameters(same)
            network = self.train(joined, self.fitted())
        except InputError as problem:
            self.parts, self.states = parts, best.joined.states
            self.log("widen", about, what, str(problem), undone=True)
            return best
        error = self.error(network, self.judges())
        undone = not error < GAIN * best.error
        why = f", not below {GAIN:g} of it" if undone else ""
        self.log("widen", about, what, f"error {best.error:.3g} to {error:.3g}{why}", undone)
        if undone:
            self.parts, self.states = parts, best.joined.states
            return best
        return Candidate(replace(joined, network=network), network, choices, error)

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
        self.progress("training on the whole recordings")
        whole = [self.record(n).cut(0, end) for n, end in self.ends.items()]
        before = self.error(best.network, whole)
        network = self.train(replace(best.joined, network=best.network), whole, REFIT)
        after = self.error(network, whole)
        undone = not after < before
        why = f"the structure is decided; error {before:.3g} to {after:.3g}"
        self.log("train", "the whole recordings", f"{REFIT} epochs", why, undone)
        return best if undone else replace(best, network=network)


def _answers(network: Network, record: Record) -> dict[str, np.ndarray]:
    errors = float_error(network, record)
    return {n: record.targets[n] + e for n, e in errors.items()}
