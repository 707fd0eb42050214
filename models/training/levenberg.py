"""Levenberg-Marquardt for any network, feedback included, with exact derivatives through time."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import cache
from io import BytesIO
from pathlib import Path
from threading import Event
from time import monotonic
from zipfile import BadZipFile

import numpy as np
import scipy.linalg
from threadpoolctl import ThreadpoolController

from greygate.contents import contents
from greygate.errors import InputError
from greygate.files import replacing
from greygate.models.network import Network
from greygate.models.training.problem import Problem, Record, held_out

CONTINUITY = (1.0, 1e1, 1e2, 1e3)  # weights of the gaps, one multiple-shooting stage each
SAVE_EVERY = 10.0  # s between checkpoints
RUNAWAY = 10.0  # times the loss of predicting zero: a free run that ends above it has diverged
EXACT = 1e-24  # of the loss of predicting zero: rounding is all that is left
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


@dataclass(frozen=True)
class Fit:
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


class _Whole:
    """A network on its records, with decay, and modules of it on records of their own, over one theta."""

    def __init__(self, main: Problem, network: Network, decay: float | Mapping[str, float], rehearse: Mapping):
        self.main = main
        self.decay = self._decay(decay)
        self.parts = []
        place = main.slices()
        for path, record in rehearse.items():
            part = Problem(_module(network, path), [record])
            index = np.concatenate([place[f"{path}.{n}"] for n in part.slices()])
            moving = np.flatnonzero(main.variable[index[part.free]] >= 0)
            self.parts.append((part, index, moving, main.variable[index[part.free]][moving]))

    def _decay(self, decay: float | Mapping[str, float]) -> np.ndarray:
        """D's diagonal over the variables; initial states do not decay."""
        place = self.main.slices()
        size = sum(map(len, place.values()))
        diagonal = np.zeros(len(self.main.theta))
        if not isinstance(decay, Mapping):
            diagonal[:size] = decay
        else:
            for name in decay:
                if name not in place and not any(n.startswith(name + ".") for n in place):
                    raise InputError(f"decay names {name}, which is no module, layer or parameter of the network")
            for name, columns in place.items():  # the longest name that fits counts
                fits = [d for d in decay if name == d or name.startswith(d + ".")]
                diagonal[columns] = decay[max(fits, key=len)] if fits else 0.0
        if not ((diagonal >= 0) & np.isfinite(diagonal)).all():
            raise InputError(f"decay {decay}: give finite numbers from 0 on; a negative one rewards large weights")
        return diagonal[self.main.free]

    def loss(self, theta: np.ndarray) -> float:
        """J = (1/2N) (sum e^2 + rehearsal's weighted sum e^2 + theta' D theta); inf where a run diverges."""
        squares = self.main.squares(theta) + sum(part.squares(theta[index]) for part, index, _, _ in self.parts)
        if self.decay.any():
            squares += float(self.decay @ theta[self.main.free] ** 2)
        return squares / (2 * self.main.samples)

    def normal_equations(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        hessian, gradient = self.main.normal_equations(theta)
        for part, index, moving, where in self.parts:
            h, g = part.normal_equations(theta[index])
            np.add.at(hessian, np.ix_(where, where), h[np.ix_(moving, moving)])
            np.add.at(gradient, where, g[moving])
        hessian.ravel()[:: len(hessian) + 1] += self.decay
        return hessian, gradient + self.decay * theta[self.main.free]


def _module(network: Network, path: str) -> Network:
    for name in path.split("."):
        network = getattr(network, "modules", {}).get(name)
        if not isinstance(network, Network):
            raise InputError(f"cannot rehearse {path}: {name} is not a network with ports of its own")
    return network


@dataclass
class _Progress:
    """Where a training stands: all that a checkpoint keeps."""

    theta: np.ndarray
    best: np.ndarray
    damping: float = 1e-3
    growth: float = 2.0
    history: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)

    def save(self, path: Path, key: str) -> None:
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, key=key, **{f.name: getattr(self, f.name) for f in fields(self)})

    @staticmethod
    def load(path: Path, key: str) -> "_Progress":
        try:
            with np.load(BytesIO(contents(path))) as data:
                if str(data["key"]) != key:
                    raise InputError(
                        f"{path}: a checkpoint of other records, options or weights; remove it or give another path"
                    )
                values = {f.name: data[f.name] for f in fields(_Progress)}
        except InputError:
            raise
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise InputError(f"{path}: not a readable checkpoint ({error}); remove it") from None
        return _Progress(**{n: v if v.ndim and n in ("theta", "best") else v.tolist() for n, v in values.items()})


def train(
    network: Network,
    records: Sequence[Record],
    *,
    teacher: bool = False,
    epochs: int = 100,
    decay: float | Mapping[str, float] = 0.0,
    rehearse: Mapping[str, Record] | None = None,
    goal: float = 0.0,
    seconds: float = np.inf,
    tolerance: float = 1e-7,
    free: Mapping | None = None,
    tied: Sequence[Sequence[str]] = (),
    bounds: Mapping[str, tuple] | None = None,
    held: Sequence[Record] = (),
    tail: float = 0.0,
    patience: int = 20,
    estimate_initial: bool = False,
    shooting: int | None = None,
    checkpoint: Path | str | None = None,
    keep: bool = False,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    """Levenberg-Marquardt (Levenberg 1944, Marquardt 1963; Nielsen's damping). The trained network is flat.

    teacher, free, tied, estimate_initial, shooting: as for `Problem`. After multiple shooting, whose gaps are closed
    step by step, the free run is trained once more.
    decay: D of the loss, one number for every free weight (biases included), or {module, layer or parameter: number}.
    rehearse: module path -> a record of its own ports, weighted by `Record.weight`: parts that were right stay right
    where `records` do not reach.
    bounds: {parameter: (low, high)}, numbers or arrays of its shape.
    held, tail: records, and the share at the end of each training record, that are not trained on; the weights of the
    lowest error there are kept, and `patience` epochs without a lower one end the training.
    goal: stop at this loss. tolerance: relative fall over ten epochs below which it has converged.
    checkpoint: a file that is written now and then, and taken up if it is there; a finished training removes it, or
    with `keep` leaves it to whoever saves the result first.
    progress: called with (epoch, loss). Ctrl-C keeps the best weights so far. Raises InputError as `Problem`.

    >>> start = lag.with_parameters({"memory.y": np.array([[0.5]])})
    >>> fit = train(start, [record])
    >>> fit.outcome.name, fit.network.parameters()["memory.y"].round(6)
    ('CONVERGED', array([[0.9]]))
    """
    began = monotonic()
    if epochs < 0:
        raise InputError(f"epochs {epochs}: give a number from 0 on")
    if np.isnan(seconds):
        raise InputError(f"seconds {seconds}: give a number")
    used, judged = held_out(network, records, tail, held)
    options = {"teacher": teacher, "free": free, "tied": tied}
    count = len(records) if tail else 0
    judge = [Problem(network, judged[:count], teacher, estimate_initial=estimate_initial)] if count else []
    judge += [Problem(network, judged[count:], teacher)] if held else []

    def climb(problem: Problem, goal: float, epochs: int, checkpoint: Path | str | None) -> Fit:
        whole = _Whole(problem, network, decay, rehearse or {})
        left = seconds - (monotonic() - began)
        path = Path(checkpoint) if checkpoint else None
        return _Climb(whole, judge, count > 0, bounds or {}, patience).run(
            epochs, goal, left, tolerance, path, keep, progress
        )

    with blas().limit(limits=1, user_api="blas"):  # two BLAS threads are slower than one on matrices this small
        fit = None
        if shooting is not None:
            problem = Problem(network, used, **options, estimate_initial=estimate_initial, shooting=shooting)
            for problem.continuity in CONTINUITY:
                fit = climb(problem, 0.0, max(epochs // len(CONTINUITY), 1), None)
                if fit.outcome in (Outcome.INTERRUPTED, Outcome.TIME):
                    break
            used = [
                replace(r, initial=r.initial | i) for r, i in zip(used, problem.initial(problem.theta), strict=True)
            ]
        if fit is None or fit.outcome not in (Outcome.INTERRUPTED, Outcome.TIME):
            problem = Problem(fit.network if fit else network, used, **options, estimate_initial=estimate_initial)
            fit = climb(problem, goal, epochs, checkpoint)
    return replace(fit, seconds=monotonic() - began, remarks=(*fit.remarks, *problem.remarks()))


@cache
def blas() -> ThreadpoolController:
    """The BLAS libraries that are loaded; finding them takes milliseconds."""
    return ThreadpoolController()


class _Climb:
    """One descent of Levenberg-Marquardt from the problem's theta."""

    def __init__(
        self, whole: _Whole, judge: Sequence[Problem], tails: bool, bounds: Mapping[str, tuple], patience: int
    ):
        self.whole, self.judge, self.tails, self.patience = whole, judge, tails, patience
        problem = self.problem = whole.main
        if not len(problem.free):
            raise InputError(f"network {problem.flat.name}: nothing to train; every parameter is frozen or held")
        low, high = np.full(len(problem.theta), -np.inf), np.full(len(problem.theta), np.inf)
        place = problem.slices()
        for name, (lo, hi) in bounds.items():
            if name not in place:
                raise InputError(f"bounds name {name}, which is no parameter of the network")
            if not np.isin(place[name], problem.free).all():
                raise InputError(
                    f"bounds on {name}, which is frozen, held or tied to another; bound the one that moves"
                )
            if any(np.size(b) not in (1, len(place[name])) for b in (lo, hi)):
                raise InputError(f"bounds on {name}: give two numbers, or arrays of its shape")
            low[place[name]], high[place[name]] = np.ravel(lo), np.ravel(hi)
        if (low > high).any():
            raise InputError("bounds: a lower bound lies above its upper bound")
        self.low, self.high = low[problem.free], high[problem.free]
        problem.theta = problem.moved(
            problem.theta, np.clip(problem.theta[problem.free], self.low, self.high) - problem.theta[problem.free]
        )

    def key(self) -> str:
        """What must be equal for a checkpoint to fit: records, options and start."""
        whole = self.whole
        found = hashlib.sha256(repr([p.fingerprint() for p in (self.problem, *self.judge)]).encode())
        for array in (whole.decay, self.low, self.high):
            found.update(array.tobytes())
        found.update(repr([part.fingerprint() for part, *_ in whole.parts]).encode())
        return found.hexdigest()[:16]

    def held(self, theta: np.ndarray) -> float:
        """Mean squared error on tails, from the state their record starts from, and on held-out records, from rest."""
        total = sum(
            p.squares(p.taking(self.problem, theta, states=self.tails and i == 0)) for i, p in enumerate(self.judge)
        )
        return total / sum(p.samples for p in self.judge)

    def step(self, theta: np.ndarray, hessian: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray | None:
        """The damped Gauss-Newton step within the bounds; None where there is none."""
        x = theta[self.problem.free]
        stuck = ((x <= self.low) & (gradient > 0)) | ((x >= self.high) & (gradient < 0))
        moving = np.flatnonzero(~stuck)
        h = hessian[np.ix_(moving, moving)] if stuck.any() else hessian
        damped = h.copy()  # Levenberg's identity, scaled: Marquardt's diagonal gets stuck where neurons are redundant
        damped.ravel()[:: len(h) + 1] += damping * (np.trace(h) / max(len(h), 1) + 1e-300)
        try:
            factor = scipy.linalg.cho_factor(damped, overwrite_a=True, check_finite=False)
        except scipy.linalg.LinAlgError:
            return None
        step = np.zeros(len(x))
        step[moving] = -scipy.linalg.cho_solve(factor, gradient[moving], check_finite=False)
        step = np.clip(x + step, self.low, self.high) - x
        return step if np.isfinite(step).all() else None

    def run(self, epochs, goal, seconds, tolerance, checkpoint, keep, progress) -> Fit:
        began = saved = monotonic()
        whole, problem = self.whole, self.problem
        at = _Progress(problem.theta.copy(), problem.theta.copy())
        key = self.key() if checkpoint else ""
        resumed = bool(checkpoint and checkpoint.exists())
        if resumed:
            at = _Progress.load(checkpoint, key)
            begun = len(at.history) - 1
        else:
            at.history.append(whole.loss(at.theta))
            if self.judge:
                at.held.append(self.held(at.theta))
        outcome = Outcome.EPOCHS if np.isfinite(whole.loss(at.theta)) else Outcome.DIVERGED
        floor = EXACT * problem.power
        if at.history[-1] <= max(goal, floor):
            outcome = Outcome.REACHED if goal else Outcome.CONVERGED
        try:
            while outcome is Outcome.EPOCHS and len(at.history) <= epochs:
                outcome = self.epoch(at) or outcome
                if outcome is not Outcome.EPOCHS:
                    break
                if progress:
                    progress(len(at.history) - 1, at.history[-1])
                if at.history[-1] <= max(goal, floor):
                    outcome = Outcome.REACHED if goal else Outcome.CONVERGED
                elif len(at.history) > 10 and at.history[-11] - at.history[-1] < tolerance * at.history[-1]:
                    outcome = Outcome.CONVERGED
                elif self.judge and len(at.held) - 1 - int(np.argmin(at.held)) >= self.patience:
                    outcome = Outcome.EARLY
                elif STOP.is_set():
                    outcome = Outcome.INTERRUPTED
                elif monotonic() - began > seconds:
                    outcome = Outcome.TIME
                if checkpoint and monotonic() - saved > SAVE_EVERY:
                    at.save(checkpoint, key)
                    saved = monotonic()
        except KeyboardInterrupt:
            outcome = Outcome.INTERRUPTED
        if checkpoint and (keep or outcome in (Outcome.INTERRUPTED, Outcome.TIME)):
            at.save(checkpoint, key)
        elif checkpoint:
            checkpoint.unlink(missing_ok=True)
        problem.theta = at.best
        if outcome in (Outcome.EPOCHS, Outcome.STALLED) and not at.history[-1] <= RUNAWAY * problem.power:
            outcome = Outcome.DIVERGED
        if outcome not in (Outcome.INTERRUPTED, Outcome.TIME) and self.judge and not np.isfinite(min(at.held)):
            outcome = Outcome.DIVERGED
        return Fit(
            problem.unpack(at.best),
            outcome,
            tuple(at.history),
            monotonic() - began,
            held=tuple(at.held),
            remarks=(f"resumed at epoch {begun}",) if resumed else (),
            initial=tuple(problem.initial(at.best)) if problem.estimate_initial else (),
        )

    def epoch(self, at: _Progress) -> Outcome | None:
        """Take one step that lowers the loss, raising the damping until there is one."""
        whole, problem, loss = self.whole, self.problem, at.history[-1]
        hessian, gradient = whole.normal_equations(at.theta)
        while True:
            step = self.step(at.theta, hessian, gradient, at.damping)
            if step is not None:
                trial = problem.moved(at.theta, step)
                value = whole.loss(trial)
                expected = -float(gradient @ step + 0.5 * step @ (hessian @ step)) / problem.samples
                ratio = (loss - value) / expected if expected > 0 else -1.0
                if value < loss:
                    break
            at.damping *= at.growth
            at.growth *= 2
            if at.damping > 1e12:
                small = np.linalg.norm(gradient) < 1e-6 * np.sqrt(loss) * len(gradient)
                return Outcome.CONVERGED if small else Outcome.STALLED
        at.theta, at.growth = trial, 2.0
        at.damping = max(at.damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 1e-15)
        at.history.append(value)
        if self.judge:
            at.held.append(self.held(trial))
        if not self.judge or at.held[-1] <= min(at.held):
            at.best = trial
        return None


def narx_noe(network: Network, records: Sequence[Record], narx_epochs: int = 200, **options) -> Fit:
    """Series-parallel training first, then free run from its weights (thesis 3.2; Norgaard 2000). options: of `train`.

    Where the NARX weights diverge in free run, multiple shooting leads there, in windows of a twentieth of the shortest
    record, unless shooting was asked for and has been tried by then. A network that feeds no output back has nothing to
    learn first.
    """
    feeds = network.flatten().feeds()
    shown = {feeds[p.name][0] for p in network.outputs}
    if not any(source in shown and delay for source, delay in feeds.values()):
        return train(network, records, **options)
    names = ("decay", "free", "tied", "bounds", "seconds", "progress", "held", "tail")
    shared = {n: v for n, v in options.items() if n in names}
    path = options.get("checkpoint")
    if path:
        shared["checkpoint"] = f"{path}.narx"
    narx = train(network, records, teacher=True, epochs=narx_epochs, patience=narx_epochs, **shared)
    if narx.outcome in (Outcome.INTERRUPTED, Outcome.TIME):
        return narx
    if "seconds" in options:
        options["seconds"] -= narx.seconds
    noe = train(narx.network, records, **options)
    lengths = [len(r) for r in held_out(network, records, options.get("tail", 0.0), ())[0]]
    window, spent = max(min(lengths) // 20, 2), narx.seconds + noe.seconds
    if noe.outcome is Outcome.DIVERGED and not options.get("shooting") and 2 * window <= max(lengths):
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
    fit: Fit
    score: float


def multistart(
    fit: Callable[[int], Fit],
    score: Callable[[Network], float],
    seeds: Sequence[int],
    jobs: int = 2,
    progress: Callable[[Start], None] | None = None,
) -> list[Start]:
    """Fit from every seed, `jobs` at a time, and rank by `score`: an error on records that no fit has seen.

    Ctrl-C ends the starts under way and ranks what there is. Raises InputError if no start was finished.
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
                if progress:
                    progress(done[-1])
        except KeyboardInterrupt:
            STOP.set()
            pool.shutdown(cancel_futures=True)
            done += [f.result() for f in waiting if f.done() and not f.cancelled() and f.result() not in done]
        finally:
            STOP.clear()
    if not done:
        raise InputError("no start was finished; give seeds, or more time")
    return sorted(done, key=lambda start: (start.score, start.seed))
