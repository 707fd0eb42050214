"""The expert of thesis figures 3.1 and 3.3: proposes a structure, trains it, tests every step, and takes back what fails.

It decides on the end of each recording to train on, which no step is fitted to. Recordings to test on are judged once,
when all is decided.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import monotonic

import numpy as np

from greygate.compiler.pipeline import entropy_pruning
from greygate.compiler.prune import retrained
from greygate.compiler.saliency import obs, saliency_pruning
from greygate.compiler.simplify import parameter_count, simplify
from greygate.errors import InputError
from greygate.expert.decisions import Log
from greygate.expert.parts import Part
from greygate.expert.task import Task
from greygate.expert.wiring import Choices, Joined, Wiring
from greygate.models.accuracy import free_run_rms
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import narx_noe, train
from greygate.models.training.record import Record
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent, titled

JUDGED, TESTED = 0.25, 0.2  # shares at the end of each recording: for decisions, and to test where nothing else is given
GAIN = 0.98  # of the error before: what a step that adds something must reach
ALLOWED = 1.02  # of the error before: what a step that removes something may reach
TAPS, NEURONS = 4, (4, 8)
EPOCHS, REFIT, REMOVAL, LINEAR = 25, 15, 4, 40
DECAY = 1e-6
REHEARSAL = 1.0  # all samples of a part's own record count as much as the recordings


@dataclass(frozen=True)
class Built:
    """network, and figures by step; rms: who -> recording -> target -> RMS error, in its unit."""

    network: Network
    log: Log
    rms: Mapping[str, Mapping[str, Mapping[str, float]]]
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
        self.signals = {
            s: np.concatenate([self._known(n)[s][: self.ends[n]] for n in recordings]) for s in self._known(next(iter(recordings)))
        }  # fmt: skip
        self.sizes = {t: float(np.std(np.concatenate([r[t] for r in recordings.values()]))) or 1.0 for t in task.targets}
        self.parts: dict[str, Part] = {}
        self.states: Mapping[str, tuple[str, float]] = {}
        where = "the recordings given to test on" if tests else f"the last {TESTED:.0%} of each recording"
        log = self.log
        log("task", ", ".join(task.targets), f"predicted from {', '.join(task.inputs)}", f"{task.plant.name} has them so")
        log("task", "recordings", f"decisions by the last {JUDGED:.0%} of what is trained on", f"{where} are kept for the end")

    def _known(self, name: str) -> dict[str, np.ndarray]:
        """Every signal of a recording: as recorded or, where it is a state or a definition, as simulated."""
        recording = {**self.recordings, **self.tests}[name]
        return {**self.nominal[name], **self.task.signals(recording)}

    # ---- records

    def record(self, name: str) -> Record:
        recording = {**self.recordings, **self.tests}[name]
        found = self.task.record(recording)
        start = {
            layer: np.array([recording[s][0] / scale]) for layer, (s, scale) in self.states.items() if s in self.task.targets
        }  # fmt: skip
        return replace(found, initial={**found.initial, **start})

    def fitted(self) -> list[Record]:
        return [self.record(n).cut(0, head) for n, head in self.heads.items()]

    def judges(self) -> list[Record]:
        return [self.record(n).cut(0, self.ends[n], skip=head) for n, head in self.heads.items()]

    def error(self, network: Network, records: Sequence[Record]) -> float:
        """RMS over all records of the targets' errors, each over the deviation of its target; inf where it diverges."""
        found = [free_run_rms(network, r)[t] / self.sizes[t] for r in records for t in self.task.targets]
        return float(np.sqrt(np.mean(np.square(found))))

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
            joined.network, records, epochs=epochs, decay=DECAY, rehearse=rehearse, bounds=self._moving(joined),
            seconds=self.left(), progress=self.progress,
        )  # fmt: skip
        return joined.network.with_parameters(fit.network.parameters())

    def _moving(self, joined: Joined) -> Mapping[str, tuple]:
        return joined.bounds

    def left(self) -> float:
        return max(self.until - monotonic(), 1.0)

    def out_of_time(self) -> bool:
        return monotonic() > self.until

    def built(self) -> Network:
        best = self.trained(self.assembled())
        best = self.widened(best)
        network = self.smaller(best)
        return self.refitted(best.joined, network)

    def assembled(self) -> Candidate:
        """The plant's own equations as a network, with every input as it is best read."""
        self.progress("joining")
        joined = self.join(Choices())
        best = Candidate(joined, joined.network, Choices(), self.error(joined.network, self.fitted()))
        for name in self.task.inputs:
            if name not in self.task.plant.inputs or f"mean_{name}" not in joined.network.modules:
                continue
            choices = replace(best.choices, held=best.choices.held | {name})
            other = self.join(choices)
            error = self.error(other.network, self.fitted())
            held = error < best.error
            said = f"the plant's own error is {min(error, best.error):.3g} so and {max(error, best.error):.3g} otherwise"
            self.log("join", name, "held over a sample" if held else "straight from sample to sample", said)
            best = Candidate(other, other.network, choices, error) if held else best
        judged = self.error(best.network, self.judges())
        self.log("join", self.task.plant.name, f"{len(best.network.layers())} layers, {parameter_count(best.network)} parameters",
                 f"its equations ask for them; error {judged:.3g} of the deviation of the targets before training")  # fmt: skip
        return replace(best, error=judged)

    def trained(self, start: Candidate) -> Candidate:
        self.progress("training")
        network = self.train(start.joined, self.fitted())
        error = self.error(network, self.judges())
        worse = not error < start.error
        self.log("train", "the whole, in free run", f"{EPOCHS} epochs", f"error {start.error:.3g} to {error:.3g} where it did not learn", worse)  # fmt: skip
        return start if worse else Candidate(replace(start.joined, network=network), network, start.choices, error)

    def widened(self, best: Candidate) -> Candidate:
        """Other inputs, unknown terms and larger parts, one after the other; what gains nothing is undone."""
        if self.task.rates:
            wider = replace(best.choices, taps=TAPS)
            best = self.tried(best, wider, ", ".join(self.task.rates), f"each rate from {TAPS} differences")
        for place in self.places():
            for neurons in NEURONS:
                unknown = {**best.choices.unknown, place: neurons}
                before = best
                best = self.tried(best, replace(best.choices, unknown=unknown), place, f"an unknown term of {neurons} neurons")
                if best is before:
                    break
        trained = [n for n, p in self.parts.items() if not n.startswith("unknown") and "library" not in p.network.modules]
        if trained:
            best = self.tried(best, replace(best.choices, larger=1), ", ".join(trained), "more neurons")
        return best

    def places(self) -> list[str]:
        """Where a term may be missing: where the plant says so, else in every balance that is more than a rate."""
        plant = self.task.plant
        here = {*self.task.definitions, *self.task.equations.values()}
        if plant.closure.places:
            return [p for p in plant.closure.places if p in here]
        positions = {e.state for e in plant.equations.values() if list(e.terms.values())[0] in plant.states and len(e.terms) == 1}  # fmt: skip
        return [n for s, n in self.task.equations.items() if s not in positions]

    def tried(self, best: Candidate, choices: Choices, about: str, what: str) -> Candidate:
        """The candidate with other choices if it is better where it did not learn, else the one before."""
        if self.out_of_time():
            self.log("widen", about, f"{what} not tried", "the time is used up")
            return best
        self.progress(f"trying {what} ({about})")
        parts = self.parts
        if choices.larger != best.choices.larger:
            self.parts = {n: p for n, p in parts.items() if "library" in p.network.modules}
        try:
            joined = self.join(choices)
            known = best.network.parameters()
            same = {n: known[n] for n, v in joined.network.parameters().items() if n in known and known[n].shape == v.shape}
            joined.network = joined.network.with_parameters(same)
            network = self.train(joined, self.fitted())
        except InputError as error:
            self.parts, self.states = parts, best.joined.states
            self.log("widen", about, what, str(error), undone=True)
            return best
        error = self.error(network, self.judges())
        undone = not error < GAIN * best.error
        self.log("widen", about, what, f"error {best.error:.3g} to {error:.3g}" + (f", not below {GAIN:g} of it" if undone else ""), undone)  # fmt: skip
        if undone:
            self.parts, self.states = parts, best.joined.states
            return best
        return Candidate(replace(joined, network=network), network, choices, error)

    # ---- smaller

    def smaller(self, best: Candidate) -> Network:
        """The generic network without the neurons and weights that it can do without."""
        network = simplify(best.network)
        self.log("simplify", "linear layers", f"{len(network.layers())} layers of {len(best.network.flatten().layers())}", "the function stays the same")  # fmt: skip
        fitted, judges = self.fitted(), self.judges()
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
        counts = f"{network.neurons()} to {smaller.neurons()} neurons, {parameter_count(network)} to {parameter_count(smaller)} parameters"  # fmt: skip
        undone = not error <= ALLOWED * before
        self.log("prune", about, counts, f"error {before:.3g} to {error:.3g}; {kept} of {len(rounds)} rounds held, the others were undone", undone)  # fmt: skip
        return network if undone else smaller

    def refitted(self, joined: Joined, network: Network) -> Network:
        """The network that is decided on, trained on the whole of the recordings."""
        self.progress("training on the whole recordings")
        whole = [self.record(n).cut(0, end) for n, end in self.ends.items()]
        before = self.error(network, whole)
        held = {n: v != 0 for n, v in network.parameters().items()}
        fit = train(network, whole, epochs=REFIT, decay=DECAY, free=held, seconds=self.left(), progress=self.progress)
        after = self.error(fit.network, whole)
        undone = not after < before
        self.log("train", "the whole recordings", f"{REFIT} epochs", f"nothing is left to decide; error {before:.3g} to {after:.3g} on them", undone)  # fmt: skip
        return network if undone else fit.network

    # ---- test

    def scores(self, network: Network) -> dict[str, dict[str, dict[str, float]]]:
        """RMS by who, recording and target: the network, the plant's simulation, and linear models, on what was kept."""
        found: dict[str, dict[str, dict[str, float]]] = {"network": {}, "nominal": {}, "linear": {}}
        rivals = self.linear()
        for name, recording in {**self.recordings, **self.tests}.items():
            record = self.record(name)
            spans = {name: (0, self.ends[name])} if name in self.recordings else {name: (0, len(record))}
            if not self.tests:
                spans[f"{name} end"] = (self.ends[name], len(record))
            for label, (start, stop) in spans.items():
                cut = record.cut(0, stop, skip=start)
                found["network"][label] = free_run_rms(network, cut)
                found["nominal"][label] = {
                    t: float(np.sqrt(np.mean((self.nominal[name][t] - recording[t])[start:stop] ** 2))) for t in self.task.targets
                }  # fmt: skip
                found["linear"][label] = {t: v for rival in rivals for t, v in _plain_rms(rival, cut).items()}
        return found

    def linear(self) -> list[Network]:
        """A linear model of each target on two samples of every input and of itself: ARX, then output error."""
        self.progress("training a linear model to compare with")
        task, found = self.task, []
        for target in task.targets:
            taps = {Port(n, scale=float(np.abs(self.signals[n]).max()) or 1.0): (0, 1) for n in task.inputs}
            values = np.concatenate([r[target][: self.ends[n]] for n, r in self.recordings.items()])
            output = Port(target, task.plant.unit(target), self.sizes[target] * 3, offset=float(values.mean()), initial=float(values[0]))
            network = noe("linear", taps, output, (1, 2))
            records = [_plain(self.record(n).cut(0, end), target) for n, end in self.ends.items()]
            found.append(narx_noe(network, records, epochs=LINEAR, progress=titled(self.progress, target)).network)
        return found


def _plain(record: Record, target: str) -> Record:
    initial = {n: v for n, v in record.initial.items() if n in record.inputs}
    return replace(record, targets={target: record.targets[target]}, initial=initial)


def _plain_rms(network: Network, record: Record) -> dict[str, float]:
    return free_run_rms(network, _plain(record, network.outputs[0].name))
