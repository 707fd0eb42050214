"""Levenberg-Marquardt for any network, feedback included, with exact derivatives through time."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import partial
from io import BytesIO
from pathlib import Path
from threading import Event
from time import monotonic
from zipfile import BadZipFile

import numpy as np
import scipy.linalg

from greygate.contents import contents
from greygate.errors import InputError
from greygate.files import replacing
from greygate.models.cores import blas
from greygate.models.network import Network
from greygate.models.training.gauss_newton import Nielsen, bounded, search
from greygate.models.training.loss import Decay, Loss
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record, held_out, listed
from greygate.models.training.remarks import remarks
from greygate.progress import Progress, silent

CONTINUITY = (1.0, 1e1, 1e2, 1e3)  # weights of the gaps, one multiple-shooting stage each
SAVE_EVERY = 10.0  # s between checkpoints
RUNAWAY = 10.0  # times the loss of predicting zero: a free run that ends above it has diverged
EXACT = 1e-24  # of the loss of predicting zero: rounding is all that is left
SHOTS = 20  # windows of the shortest record, where `narx_noe` must shoot
WINDOW = 10  # epochs over which the fall of the loss is judged
FLAT = 1e-6  # of the residuals' root mean square: a mean slope below it is a minimum, as far as rounding can tell
TINY = 1e-300  # keeps the damping of an all-zero Jacobian positive
STOP = Event()  # ends every training under way in other threads, as Ctrl-C does in this one


class Outcome(Enum):
    """How a training ended, as a sentence."""

    CONVERGED = "The loss no longer falls: converged."
    REACHED = "The loss that was asked for is reached."
    EPOCHS = "All epochs are used; the loss was still falling."
    EARLY = "The held-out error no longer falls: stopped, with the weights of its lowest."
    TIME = "Out of time; these are the best weights so far."
    INTERRUPTED = "Interrupted; these are the best weights so far."
    STALLED = "No step lowers the loss: stalled at a point that may be no minimum."
    DIVERGED = (
        "The free run diverges; the weights are the best so far. Start from a NARX fit, smaller weights or shooting."
    )


CUT_SHORT = (Outcome.INTERRUPTED, Outcome.TIME)  # these leave a checkpoint, to be taken up


@dataclass(frozen=True)
class Trained:
    """A trained network, flat.

    history: loss J after each epoch, J = (1/2N) sum e^2 + (1/2N) theta' D theta, normalised.
    held: mean squared error on the held-out records after each epoch. remarks: why the records may not do, a sentence
    each. initial: with `estimate_initial`, the state before each record, as for `Record.initial`.
    """

    network: Network
    outcome: Outcome
    history: tuple[float, ...]
    seconds: float
    held: tuple[float, ...] = ()
    remarks: tuple[str, ...] = ()
    initial: tuple[dict[str, np.ndarray], ...] = ()


def train(
    network: Network,
    records: Sequence[Record] | Record,
    *,
    teacher: bool = False,
    epochs: int = 100,
    decay: Decay = 0.0,
    rehearse: Mapping[str, Record] | None = None,
    goal: float = 0.0,
    seconds: float = np.inf,
    tolerance: float = 1e-7,
    free: Mapping | None = None,
    tied: Sequence[Sequence[str]] = (),
    bounds: Mapping[str, tuple] | None = None,
    held: Sequence[Record] | Record = (),
    tail: float = 0.0,
    patience: int = 20,
    estimate_initial: bool = False,
    shooting: int | None = None,
    checkpoint: Path | str | None = None,
    keep: bool = False,
    clock: Callable[[], float] = monotonic,
    progress: Progress = silent,
) -> Trained:
    """Train a network by Levenberg-Marquardt (Levenberg 1944, Marquardt 1963). The trained network is flat.

    teacher, free, tied, estimate_initial, shooting: as for `Objective`. After multiple shooting, which closes the gaps
    in stages, the network is trained once more in free-run simulation.
    decay: D of the loss, one number for every free weight (biases included), or {module, layer or parameter: number};
    of a parameter also an array of its shape.
    rehearse: {module path: a record of its own ports}, weighted by `Record.weight`: a module that was right stays right
    where `records` do not reach.
    bounds: {parameter: (low, high)}, numbers or arrays of its shape, in normalised units.
    held: held-out records. tail: the share at the end of each training record that is held out. What is held out is not
    trained on: the weights with the lowest error there are returned, and `patience` epochs without a lower one end the
    training.
    goal: the loss at which to stop. seconds: of `clock`, after which to stop. tolerance: the training has converged
    when ten epochs lower the loss relatively by less.
    checkpoint: a file that is written every ten seconds, and from which the training resumes if it exists. A finished
    training removes it; with `keep` it stays, for whoever must save the result first.
    progress: told every epoch. Ctrl-C ends the training; the best weights so far are returned.
    Raises InputError as `Objective`, and for options that make no sense.

    >>> start = lag.with_parameters({"memory.y": np.array([[0.5]])})
    >>> fit = train(start, [record])
    >>> fit.outcome.name, fit.network.parameters()["memory.y"].round(6)
    ('CONVERGED', array([[0.9]]))
    """
    began = clock()
    records, held = listed(records), listed(held)
    if epochs < 0:
        raise InputError(f"epochs {epochs}: give a number from 0 on")
    if np.isnan(seconds):
        raise InputError(f"seconds {seconds}: give a number")
    used, judged = held_out(network, records, tail, held)
    posed = partial(Objective, teacher=teacher, free=free, tied=tied, estimate_initial=estimate_initial)
    count = len(records) if tail else 0
    judges = [Objective(network, judged[:count], teacher, estimate_initial=estimate_initial)] if count else []
    judges += [Objective(network, judged[count:], teacher)] if held else []

    def descend(objective: Objective, epochs: int, goal: float = 0.0, checkpoint: Path | str | None = None) -> Trained:
        loss = Loss(objective, network, decay, rehearse or {})
        left = seconds - (clock() - began)
        trainer = LevenbergMarquardt(loss, judges, count > 0, bounds or {}, patience, tolerance, progress, clock)
        return trainer.run(epochs, goal, left, Path(checkpoint) if checkpoint else None, keep)

    with blas().limit(limits=1, user_api="blas"):  # two BLAS threads are slower than one on matrices this small
        found = None
        if shooting is not None:
            objective = posed(network, used, shooting=shooting)
            for objective.continuity in CONTINUITY:
                found = descend(objective, max(epochs // len(CONTINUITY), 1))
                if found.outcome in CUT_SHORT:
                    break
            initial = objective.initial(objective.theta)
            used = [replace(r, initial={**r.initial, **i}) for r, i in zip(used, initial, strict=True)]
        if found is None or found.outcome not in CUT_SHORT:
            objective = posed(found.network if found else network, used)
            found = descend(objective, epochs, goal, checkpoint)
    return replace(found, seconds=clock() - began, remarks=(*found.remarks, *remarks(objective)))


def stands(lowest: Sequence[float], window: int, tolerance: float) -> bool:
    """Whether the lowest loss so far, by epoch, has fallen relatively by less than `tolerance` in the last `window`."""
    return len(lowest) > window and lowest[-1 - window] - lowest[-1] < tolerance * lowest[-1]


def _bounds(objective: Objective, bounds: Mapping[str, tuple]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest value of each variable (len(objective.free),), in normalised units."""
    low, high = np.full(len(objective.theta), -np.inf), np.full(len(objective.theta), np.inf)
    place = objective.slices()
    for name, (lo, hi) in bounds.items():
        if name not in place:
            raise InputError(f"bounds name {name}, which is no parameter of the network")
        if not np.isin(place[name], objective.free).all():
            raise InputError(
                f"bounds on {name}, which is frozen, not free or tied to another; bound the one that moves"
            )
        if any(np.size(b) not in (1, len(place[name])) for b in (lo, hi)):
            raise InputError(f"bounds on {name}: give two numbers, or arrays of its shape")
        low[place[name]], high[place[name]] = np.ravel(lo), np.ravel(hi)
    if (low > high).any():
        raise InputError("bounds: a lower bound lies above its upper bound")
    return low[objective.free], high[objective.free]


@dataclass
class Checkpoint:
    """Where a training stands: theta, the best theta so far, the damping, and loss and held-out error by epoch."""

    theta: np.ndarray
    best: np.ndarray
    damping: Nielsen = field(default_factory=Nielsen)
    history: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)

    def save(self, path: Path, key: str) -> None:
        """Write it as NPZ. key: of the training it belongs to."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values |= {"damping": self.damping.value, "growth": self.damping.growth}
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, key=key, **values)

    @staticmethod
    def load(path: Path, key: str) -> "Checkpoint":
        """Read what `save` wrote. Raises InputError for another key and for a file that is no checkpoint."""
        try:
            with np.load(BytesIO(contents(path))) as data:
                if str(data["key"]) != key:
                    raise InputError(
                        f"{path}: a checkpoint of other records, options or weights; remove it or give another path"
                    )
                damping, growth, history, held = (data[n].tolist() for n in ("damping", "growth", "history", "held"))
                return Checkpoint(data["theta"], data["best"], Nielsen(damping, growth), history, held)
        except InputError:
            raise
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise InputError(f"{path}: not a readable checkpoint ({error}); remove it") from None


class LevenbergMarquardt:
    """One descent of a loss from its objective's theta, within bounds.

    judges: objectives on what is held out; the first one is on the tails of the training records if `tails`.
    The other arguments are those of `train`.
    """

    def __init__(
        self,
        loss: Loss,
        judges: Sequence[Objective],
        tails: bool,
        bounds: Mapping[str, tuple],
        patience: int,
        tolerance: float,
        progress: Progress,
        clock: Callable[[], float] = monotonic,
    ):
        self.loss, self.judges, self.tails = loss, judges, tails
        self.patience, self.tolerance, self.progress, self.clock = patience, tolerance, progress, clock
        objective = self.objective = loss.objective
        if not len(objective.free):
            raise InputError(f"network {objective.flat.name}: nothing to train; no parameter is free")
        self.low, self.high = _bounds(objective, bounds)
        start = objective.theta[objective.free]
        objective.theta = objective.moved(objective.theta, np.clip(start, self.low, self.high) - start)

    def run(self, epochs: int, goal: float, seconds: float, checkpoint: Path | None, keep: bool) -> Trained:
        """Descend until one of the stops of `train`."""
        began, saved = self.clock(), monotonic()
        key = self._key() if checkpoint else ""
        resumed = checkpoint if checkpoint and checkpoint.exists() else None
        at = Checkpoint.load(resumed, key) if resumed else self._start()
        remarks = (f"resumed at epoch {len(at.history) - 1}",) if resumed else ()
        goal, reached = max(goal, EXACT * self.objective.power), Outcome.REACHED if goal else Outcome.CONVERGED
        outcome = Outcome.EPOCHS if np.isfinite(self.loss(at.theta)) else Outcome.DIVERGED
        if at.history[-1] <= goal:
            outcome = reached
        try:
            while outcome is Outcome.EPOCHS and len(at.history) <= epochs:
                if failed := self._epoch(at):
                    outcome = failed
                    break
                self.progress(f"epoch {len(at.history) - 1} of {epochs}, loss {at.history[-1]:.3g}")
                if at.history[-1] <= goal:
                    outcome = reached
                elif stands(at.history, WINDOW, self.tolerance):
                    outcome = Outcome.CONVERGED
                elif self.judges and len(at.held) - 1 - int(np.argmin(at.held)) >= self.patience:
                    outcome = Outcome.EARLY
                elif STOP.is_set():
                    outcome = Outcome.INTERRUPTED
                elif self.clock() - began > seconds:
                    outcome = Outcome.TIME
                if checkpoint and monotonic() - saved > SAVE_EVERY:
                    at.save(checkpoint, key)
                    saved = monotonic()
        except KeyboardInterrupt:
            outcome = Outcome.INTERRUPTED
        if checkpoint and (keep or outcome in CUT_SHORT):
            at.save(checkpoint, key)
        elif checkpoint:
            checkpoint.unlink(missing_ok=True)
        return self._ended(at, outcome, self.clock() - began, remarks)

    def _key(self) -> str:
        """What must be equal for a checkpoint to fit: records, options and start."""
        found = hashlib.sha256(repr([o.fingerprint() for o in (self.objective, *self.judges)]).encode())
        for array in (self.loss.decay, self.low, self.high):
            found.update(array.tobytes())
        found.update(repr([part.fingerprint() for part, *_ in self.loss.parts]).encode())
        return found.hexdigest()[:16]

    def _start(self) -> Checkpoint:
        theta = self.objective.theta
        held = [self._judged(theta)] if self.judges else []
        return Checkpoint(theta.copy(), theta.copy(), history=[self.loss(theta)], held=held)

    def _judged(self, theta: np.ndarray) -> float:
        """Mean squared error on tails, from the state their record starts from, and on held-out records, from rest."""
        total = sum(
            judge.squares(judge.taking(self.objective, theta, states=self.tails and i == 0))
            for i, judge in enumerate(self.judges)
        )
        return total / sum(judge.samples for judge in self.judges)

    def _epoch(self, at: Checkpoint) -> Outcome | None:
        """Take one step that lowers the loss. If there is none: how the training ended."""
        hessian, gradient = self.loss.normal_equations(at.theta)
        loss = at.history[-1]

        def attempt(damping: float) -> tuple[np.ndarray, float, float] | None:
            """(theta, loss, fall of the loss relative to what the linear model predicts) of a step that lowers it."""
            step = self._step(at.theta, hessian, gradient, damping)
            if step is None:
                return None
            theta = self.objective.moved(at.theta, step)
            value = self.loss(theta)
            predicted = -float(gradient @ step + 0.5 * step @ (hessian @ step)) / self.objective.samples
            ratio = (loss - value) / predicted if predicted > 0 else -1.0
            return (theta, value, ratio) if value < loss else None

        found = search(attempt, at.damping)
        if found is None:
            flat = np.linalg.norm(gradient) < FLAT * np.sqrt(loss) * len(gradient)
            return Outcome.CONVERGED if flat else Outcome.STALLED
        at.theta, value, ratio = found
        at.damping.fall(ratio)
        at.history.append(value)
        if self.judges:
            at.held.append(self._judged(at.theta))
        if not self.judges or at.held[-1] <= min(at.held):
            at.best = at.theta
        return None

    def _step(self, theta: np.ndarray, hessian: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray | None:
        """The damped Gauss-Newton step within the bounds; None where there is none."""

        def solved(moving: np.ndarray) -> np.ndarray:
            damped = (hessian[np.ix_(moving, moving)] if len(moving) < len(hessian) else hessian).copy()
            # Levenberg's identity, times the mean diagonal: Marquardt's diagonal stalls where neurons are redundant
            damped.ravel()[:: len(moving) + 1] += damping * (np.trace(damped) / max(len(moving), 1) + TINY)
            factor = scipy.linalg.cho_factor(damped, check_finite=False)
            return -scipy.linalg.cho_solve(factor, gradient[moving], check_finite=False)

        x = theta[self.objective.free]
        try:
            step = bounded(x, gradient, self.low, self.high, solved) - x
        except scipy.linalg.LinAlgError:
            return None
        return step if np.isfinite(step).all() else None

    def _ended(self, at: Checkpoint, outcome: Outcome, seconds: float, remarks: tuple[str, ...]) -> Trained:
        objective = self.objective
        objective.theta = at.best
        if outcome in (Outcome.EPOCHS, Outcome.STALLED) and not at.history[-1] <= RUNAWAY * objective.power:
            outcome = Outcome.DIVERGED
        if outcome not in CUT_SHORT and self.judges and not np.isfinite(min(at.held)):
            outcome = Outcome.DIVERGED
        initial = tuple(objective.initial(at.best)) if objective.estimate_initial else ()
        network = objective.unpack(at.best)
        return Trained(network, outcome, tuple(at.history), seconds, tuple(at.held), remarks, initial)


def narx_noe(network: Network, records: Sequence[Record] | Record, narx_epochs: int = 200, **options) -> Trained:
    """Train the one-step prediction, then from its weights the free-run simulation (thesis 3.2; Norgaard 2000).

    options: of `train`. Where the free-run simulation diverges from the NARX weights, it is trained by multiple
    shooting, in windows of a twentieth of the shortest record, unless `options` ask for shooting: then that was tried.
    A network that feeds no output back is trained by `train` alone.
    """
    records = listed(records)
    feeds = network.flatten().feeds()
    shown = {feeds[p.name][0] for p in network.outputs}
    if not any(source in shown and delay for source, delay in feeds.values()):
        return train(network, records, **options)
    names = ("decay", "free", "tied", "bounds", "seconds", "clock", "progress", "held", "tail")
    shared = {n: v for n, v in options.items() if n in names}
    path = options.get("checkpoint")
    if path:
        shared["checkpoint"] = f"{path}.narx"
    narx = train(network, records, teacher=True, epochs=narx_epochs, patience=narx_epochs, **shared)
    if narx.outcome in CUT_SHORT:
        return narx
    if "seconds" in options:
        options["seconds"] -= narx.seconds
    noe = train(narx.network, records, **options)
    lengths = [len(r) for r in held_out(network, records, options.get("tail", 0.0), ())[0]]
    window, spent = max(min(lengths) // SHOTS, 2), narx.seconds + noe.seconds
    shot = options.get("shooting") or any(r.own_offset or r.own_gain for r in records)
    if noe.outcome is Outcome.DIVERGED and not shot and 2 * window <= max(lengths):
        left = options.get("seconds", np.inf) - noe.seconds
        again = {"shooting": window, "seconds": left, "checkpoint": path and f"{path}.shooting"}
        noe = train(narx.network, records, **options | again)
        spent += noe.seconds
    if noe.outcome is Outcome.DIVERGED:
        noe = replace(noe, network=narx.network)
    return replace(noe, seconds=spent)


@dataclass(frozen=True)
class Start:
    """One start of `multistart`: its seed, what came of it, and its score (lower is better; inf where it diverged)."""

    seed: int
    fit: Trained
    score: float


def multistart(
    fit: Callable[[int], Trained],
    score: Callable[[Network], float],
    seeds: Sequence[int],
    jobs: int = 2,
    progress: Progress = silent,
) -> list[Start]:
    """Train from every seed, `jobs` at a time, and rank by `score`: an error on records that no training has seen.

    fit: seed -> what came of it. progress: told when a start is done. Ctrl-C ends the starts under way; those that are
    done are ranked. Raises InputError if no start was finished.
    """
    done: list[Start] = []

    def run(seed: int) -> Start:
        found = fit(seed)
        value = score(found.network)
        return Start(seed, found, float(value) if np.isfinite(value) else np.inf)

    with blas().limit(limits=1, user_api="blas"), ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(run, seed) for seed in seeds]
        try:
            for future in as_completed(waiting):
                done.append(future.result())
                progress(f"seed {done[-1].seed}: score {done[-1].score:.3g}, {len(done)} of {len(waiting)} starts done")
        except KeyboardInterrupt:
            STOP.set()
            pool.shutdown(cancel_futures=True)
            done += [f.result() for f in waiting if f.done() and not f.cancelled() and f.result() not in done]
        finally:
            STOP.clear()
    if not done:
        raise InputError("no start was finished; give seeds, or more time")
    return sorted(done, key=lambda start: (start.score, start.seed))
