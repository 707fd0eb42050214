"""First-order training: gradient descent by back-propagation through time, real-time recurrent learning, Adam, L-BFGS.

These methods are for networks too large for Levenberg-Marquardt, whose normal equations grow with the square of the
weights, and RTRL is for learning while samples arrive. Elsewhere `levenberg.train` is faster and reaches a lower loss.

Every function takes these options of `train` by name: teacher, free, tied, decay, held, tail, patience, epochs, goal,
seconds, progress. tolerance: the training has converged when a hundred epochs lower the loss relatively by less.
The gradient comes from one sweep back through time; where no sample depends on another, it comes from torch, for all
samples at once. After Ctrl-C and after divergence the best weights so far are returned. Every function raises
InputError as `Objective` does, and for a rate that is not positive.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import monotonic

import numpy as np

from greygate.errors import InputError
from greygate.models.activations import ACTIVATIONS
from greygate.models.cores import blas
from greygate.models.network import Network
from greygate.models.training.kernels import LANES, SELECT, Tables, forward, kernel, sensitivities, slopes_at
from greygate.models.training.levenberg import STOP, Outcome, Trained, stands
from greygate.models.training.loss import Decay, Loss
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record, held_out
from greygate.models.training.remarks import remarks
from greygate.progress import Progress, silent

RUNAWAY = 10.0  # times the first loss, or that of predicting zero if larger: beyond it a training has diverged
SCALE = 1e8  # the first loss that L-BFGS sees: where y's <= 1e-10, torch sees no curvature
RISE, GROWTH, SHRINK = 1.04, 1.05, 0.7  # of gradient descent: loss that a step may reach, rate after a fall, a rise
SHORTER = 200  # steps it tries, each shorter, before it stays
WINDOW = 100  # epochs over which the fall of the loss is judged


def gradient_descent(
    network: Network, records: Sequence[Record], rate: float = 0.1, momentum: float = 0.9, **options
) -> Trained:
    """Back-propagation through time over all records at once (Werbos 1990) with momentum (Polyak 1964).

    rate: of the first step along the gradient of J, in the normalised units of the ports. A step that would raise the
    loss by more than 4 % is taken anew without momentum at 0.7 times the rate; one that lowers it raises the rate by
    5 % (Vogl et al. 1988; MATLAB's traingdx). options: see the module.
    """
    descent = _Descent(network, records, **options)
    speed, now = np.zeros(descent.size), rate

    def epoch(x: np.ndarray) -> np.ndarray:
        nonlocal speed, now
        before, downhill = descent.loss(x), -descent.gradient(x)
        speed = momentum * speed + now * downhill
        for _ in range(SHORTER):
            if (loss := descent.loss(x + speed)) <= RISE * before:
                now *= GROWTH if loss < before else 1.0
                return x + speed
            now *= SHRINK
            speed = now * downhill
        return x

    return descent.run(epoch, rate)


def rtrl(network: Network, records: Sequence[Record], rate: float = 0.01, **options) -> Trained:
    """Real-time recurrent learning (Williams, Zipser 1989): the weights move after every sample, records in turn.

    The forward sensitivities go on as they stand, though the weights have moved: exact as the rate goes to zero.
    rate: of the step along the gradient of half the sample's squared error. options: see the module.
    """
    descent = _Descent(network, records, **options)
    objective = descent.objective

    def epoch(x: np.ndarray) -> np.ndarray:
        theta = descent.theta(x)
        objective.learn_online(theta, rate, descent.diagonal / objective.samples)
        return theta[objective.free]

    return descent.run(epoch, rate)


def adam(
    network: Network,
    records: Sequence[Record],
    rate: float = 1e-3,
    batch: int | None = None,
    seed: int = 0,
    **options,
) -> Trained:
    """Adam (Kingma, Ba 2015) of torch. options: see the module.

    batch: samples a step, drawn anew from `seed` in every epoch; all of them if None. Raises InputError for a batch
    where samples depend on each other through feedback: there `teacher=True` makes them independent.
    """
    torch = _torch()
    descent = _Descent(network, records, **options)
    if batch is not None and (not isinstance(descent.engine, _Static) or batch < 1):
        raise InputError(
            f"network {network.name}: batch {batch} needs samples that do not depend on each other, and at least one; "
            "leave batch out, or train with teacher=True"
        )
    point = torch.zeros(descent.size, dtype=torch.float64)
    optimiser = torch.optim.Adam([point], lr=rate)
    rng = np.random.default_rng(seed)

    def take(gradient: np.ndarray) -> None:
        point.grad = torch.as_tensor(gradient)
        optimiser.step()

    def epoch(x: np.ndarray) -> np.ndarray:
        point.copy_(torch.as_tensor(x))
        if batch is None:
            take(descent.gradient(x))
        else:
            order = rng.permutation(descent.engine.samples)
            for i in range(0, len(order), batch):
                take(descent.estimate(point.numpy(), order[i : i + batch]))
        return point.numpy().copy()

    return descent.run(epoch, rate)


def lbfgs(network: Network, records: Sequence[Record], memory: int = 20, **options) -> Trained:
    """L-BFGS (Liu, Nocedal 1989) of torch with a strong Wolfe line search over all records. options: see the module."""
    torch = _torch()
    descent = _Descent(network, records, **options)
    scale = SCALE / max(descent.loss(descent.start), np.finfo(float).tiny)
    point = torch.zeros(descent.size, dtype=torch.float64)
    optimiser = torch.optim.LBFGS(
        [point],
        max_iter=1,
        max_eval=25,
        history_size=memory,
        tolerance_grad=0.0,
        tolerance_change=0.0,
        line_search_fn="strong_wolfe",
    )

    def closure() -> float:
        x = point.numpy()
        value = descent.loss(x)
        point.grad = torch.as_tensor(scale * descent.gradient(x) if np.isfinite(value) else np.zeros(descent.size))
        return scale * value if np.isfinite(value) else 1e30  # the line search cannot read inf

    def epoch(x: np.ndarray) -> np.ndarray:
        point.copy_(torch.as_tensor(x))
        optimiser.step(closure)
        return point.numpy().copy()

    return descent.run(epoch)


def _torch():
    import torch  # only where it is asked for: it takes seconds to import

    return torch


@dataclass
class _Descent:
    """The loss of one training over its variables x, and the loop that every method shares."""

    network: Network
    records: Sequence[Record]
    teacher: bool = False
    free: Mapping | None = None
    tied: Sequence[Sequence[str]] = ()
    decay: Decay = 0.0
    held: Sequence[Record] = ()
    tail: float = 0.0
    patience: int = 100
    epochs: int = 1000
    goal: float = 0.0
    seconds: float = np.inf
    tolerance: float = 1e-7
    progress: Progress = silent

    def __post_init__(self):
        self.began = monotonic()
        if any(r.own_offset or r.own_gain for r in (*self.records, *self.held)):
            raise InputError(
                f"network {self.network.name}: an offset or a gain of a recording's own is found by `train` alone"
            )
        used, judged = held_out(self.network, self.records, self.tail, self.held)
        self.objective = _Swept(self.network, used, self.teacher, self.free, tied=self.tied)
        self.judge = Objective(self.network, judged, self.teacher) if judged else None
        self.engine = _Static(self.objective) if self.objective.is_static else self.objective
        self.start = self.objective.theta[self.objective.free]
        self.size = len(self.start)
        self.diagonal = Loss(self.objective, self.network, self.decay, {}).decay  # D's diagonal, (size,)
        self._at, self._loss, self._gradient = np.full(self.size, np.nan), np.inf, None  # of the last evaluation

    def theta(self, x: np.ndarray) -> np.ndarray:
        variable = self.objective.variable
        return np.where(variable >= 0, x[variable], self.objective.theta)

    def loss(self, x: np.ndarray) -> float:
        """J = (1/2N) (sum e^2 + x'Dx); inf where the run diverges."""
        if not np.array_equal(x, self._at):
            with np.errstate(over="ignore", invalid="ignore"):
                value = (self.engine.squares(self.theta(x)) + float(self.diagonal @ x**2)) / (
                    2 * self.objective.samples
                )
            self._at, self._loss, self._gradient = x.copy(), value if np.isfinite(value) else np.inf, None
        return self._loss

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """dJ/dx."""
        self.loss(x)
        if self._gradient is None:
            self._gradient = self._of(x, self.engine.gradient(self.theta(x)))
        return self._gradient

    def estimate(self, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """dJ/dx from these samples alone."""
        assert isinstance(self.engine, _Static), "samples that depend on one another cannot be taken alone"
        theta = self.theta(x)
        self._at[:] = np.nan
        self.engine.squares(theta, rows)
        return self._of(x, self.engine.gradient(theta) * (self.engine.samples / len(rows)))

    def _of(self, x: np.ndarray, along_theta: np.ndarray) -> np.ndarray:
        moving = self.objective.variable >= 0
        sums = np.bincount(self.objective.variable[moving], along_theta[moving], self.size)
        return (sums + self.diagonal * x) / self.objective.samples

    def score(self, x: np.ndarray, loss: float) -> float:
        """The best weights have the lowest: mean squared error on what is held out, or the loss if nothing is."""
        return self.judge.squares(self.theta(x)) / self.judge.samples if self.judge else loss

    def run(self, epoch: Callable[[np.ndarray], np.ndarray], rate: float = 1.0) -> Trained:
        """Descend until one of the stops. epoch: maps x to the next x."""
        if not rate > 0:
            raise InputError(f"rate {rate:g}: give a positive one")
        x = best = self.start
        said = remarks(self.objective)
        with blas().limit(limits=1, user_api="blas"):  # two BLAS threads are slower than one on small matrices
            history = [self.loss(x)]
            scores = [self.score(x, history[0])]
            lowest = [history[0]]
            ceiling = RUNAWAY * max(history[0], self.objective.power)
            outcome = Outcome.EPOCHS if np.isfinite(history[0]) else Outcome.DIVERGED
            if history[0] <= self.goal:
                outcome = Outcome.REACHED
            leader = 0
            try:
                while outcome is Outcome.EPOCHS and len(history) <= self.epochs:
                    before, x = x, epoch(x)
                    loss = self.loss(x)
                    if not loss <= ceiling:
                        outcome = Outcome.DIVERGED
                        break
                    history.append(loss)
                    lowest.append(min(lowest[-1], loss))
                    scores.append(self.score(x, loss))
                    if scores[-1] < scores[leader]:
                        best, leader = x, len(scores) - 1
                    self.progress(f"epoch {len(history) - 1} of {self.epochs}, loss {loss:.3g}")
                    if loss <= self.goal:
                        outcome = Outcome.REACHED
                    elif self.judge and len(scores) - 1 - leader >= self.patience:
                        outcome = Outcome.EARLY
                    elif np.array_equal(x, before) or stands(lowest, WINDOW, self.tolerance):
                        outcome = Outcome.CONVERGED
                    elif STOP.is_set():
                        outcome = Outcome.INTERRUPTED
                    elif monotonic() - self.began > self.seconds:
                        outcome = Outcome.TIME
            except KeyboardInterrupt:
                outcome = Outcome.INTERRUPTED
        if outcome is Outcome.EPOCHS and lowest[-1] == history[0] < history[-1]:
            outcome = Outcome.DIVERGED
        if outcome is Outcome.DIVERGED and np.isfinite(history[0]):
            said.append(f"rate {rate:g} is too large for this start: lower it")
        held = tuple(scores) if self.judge else ()
        network = self.objective.unpack(self.theta(best))
        return Trained(network, outcome, tuple(history), monotonic() - self.began, held, tuple(said))


class _Swept(Objective):
    """An objective whose gradient is swept back through time: no Jacobian, time and memory in proportion to N."""

    @property
    def is_static(self) -> bool:
        """Whether no sample depends on what the network gave at another."""
        return not (self.tables.row_of >= 0).any()

    def gradient(self, theta: np.ndarray) -> np.ndarray:
        """J'e over theta. Call after `squares` at the same theta (it uses that run)."""
        found = np.zeros(len(theta))
        for w in self.windows:
            error = w.weight * (w.now[self.depth :, self.tables.rows[self.tables.shown]] - w.target)
            error[: w.skip] = 0.0
            _back(self.tables, theta, w.now, w.past, self.forced, error, found)
        return found

    def learn_online(self, theta: np.ndarray, rate: float, decay: np.ndarray) -> None:
        """Move theta after every sample of every record (RTRL). decay: of each variable."""
        room = np.zeros(len(self.free))
        for w in self.windows:
            step = rate * w.weight
            _learn(self.tables, theta, w.now, w.past, self.forced, w.target, w.skip, step, decay, self.variable, room)


class _Static:
    """A static objective in torch, all samples at once; `squares` and `gradient` as those of `_Swept`."""

    def __init__(self, objective: _Swept):
        self.torch, self.tables = _torch(), objective.tables
        t, windows = objective.tables, objective.windows

        def joined(parts):
            return self.torch.as_tensor(np.concatenate(list(parts)))

        self.given = {
            (source, delay): joined(
                w.past[t.depth - delay + w.skip : len(w.past) - delay, source : source + width] for w in windows
            )
            for source, width, delay, _ in t.links.tolist()
            if delay or source < t.n_inputs
        }
        self.target = joined(w.target[w.skip :] for w in windows)
        self.weight = joined(np.full((len(w.target) - w.skip, 1), w.weight) for w in windows)
        self.samples = len(self.target)

    def squares(self, theta: np.ndarray, rows: np.ndarray | None = None) -> float:
        """Weighted sum of squared errors, of these samples or all."""
        used = slice(None) if rows is None else self.torch.as_tensor(rows)
        self.at = self.torch.tensor(theta, requires_grad=True)
        error = self._outputs(used) - self.target[used]
        self.total = (self.weight[used] * error * error).sum()
        return self.total.item()

    def gradient(self, theta: np.ndarray) -> np.ndarray:
        """J'e over theta. Call after `squares` at the same theta (it uses that run)."""
        (0.5 * self.total).backward()
        return self.at.grad.numpy()

    def _outputs(self, rows):
        torch, t, kinds = self.torch, self.tables, list(ACTIVATIONS.values())
        signals: dict = {}
        layers, count = t.layers.tolist(), len(self.target[rows])
        for (first, size, kind, bias, lo), (*_, hi) in pairwise(layers):
            links = t.links[lo:hi].tolist()
            n = self.at[bias : bias + size * kinds[kind].rows].expand(count, -1)
            if links:
                x = [self.given[s, d][rows] if (s, d) in self.given else signals[s] for s, _, d, _ in links]
                w = [self.at[o : o + n.shape[1] * width].view(-1, width) for _, width, _, o in links]
                n = torch.addmm(n, torch.cat(x, 1), torch.cat(w, 1).T)
            signals[first] = kinds[kind].value(torch, n)
        return torch.cat([signals[e] for e in t.rows[t.shown].tolist() if e in signals], 1)


@kernel(fastmath={"contract", "reassoc"})
def _back(t: Tables, theta, now, past, forced, error, gradient):  # pragma: no cover - compiled
    """gradient += d/d theta of sum(error * output), swept back through all steps; error: (N, outputs)."""
    ring = t.depth + 1
    adjoint = np.zeros((ring, now.shape[1]))
    slopes, active = np.empty((now.shape[1], LANES)), np.zeros((now.shape[1], LANES), np.int64)
    twins = np.empty_like(slopes)  # a product's, which no network of this benchmark has
    delta = np.empty(now.shape[1])
    for k in range(len(error) - 1, -1, -1):
        a, at = adjoint[k % ring], t.depth + k
        for j in range(len(t.shown)):
            a[t.rows[t.shown[j]]] += error[k, j]
        lane = k % LANES
        if lane == LANES - 1 or k == len(error) - 1:
            slopes_at(t.layers, t.links, theta, at - lane, lane + 1, now, past, slopes, twins, active)
        for layer in range(len(t.layers) - 2, -1, -1):
            first, size, kind, bias, lo = t.layers[layer]
            acts = False
            for o in range(size):
                delta[o] = a[first + o] * slopes[first + o, lane]
                acts |= delta[o] != 0.0
            if not acts:
                continue
            for o in range(size):
                gradient[bias + active[first + o, lane]] += delta[o]
            for c in range(lo, t.layers[layer + 1, 4]):
                source, width, delay, w = t.links[c]
                signals = now[at] if delay == 0 else past[at - delay]
                goes_on = source >= t.n_inputs and (delay == 0 or (not forced[source] and k >= delay))
                back = adjoint[(k - delay) % ring]
                if width == 1 and kind != SELECT:  # one tap to all neurons: contiguous in theta
                    total = 0.0
                    for o in range(size):
                        gradient[w + o] += delta[o] * signals[source]
                        total += delta[o] * theta[w + o]
                    if goes_on:
                        back[source] += total
                    continue
                for o in range(size):
                    v = w + active[first + o, lane] * width
                    for i in range(width):
                        gradient[v + i] += delta[o] * signals[source + i]
                    if goes_on:
                        for i in range(width):
                            back[source + i] += delta[o] * theta[v + i]
        a[:] = 0.0


@kernel()
def _learn(
    t: Tables, theta, now, past, forced, target, skip, rate, decay, variable, room
):  # pragma: no cover - compiled
    """Run over a record; after step k theta moves by -rate (e dy/d theta + decay theta), sensitivities as they stand.

    variable: column of theta -> its variable, or -1. decay, room: (variables,). Ends early where the run diverges.
    """
    carried = np.zeros((t.depth + 1, len(t.rows), len(theta)))
    jacobian = np.zeros((1, len(t.shown), len(theta)))
    for k in range(len(target)):
        end = t.depth + k + 1
        if forward(t.layers, t.links, t.n_inputs, t.depth, theta, now[k:end], past[k:end], forced) < 1:
            theta[:] = np.nan
            return
        sensitivities(
            t.layers, t.links, t.n_inputs, t.depth, t.rows, t.row_of, t.layer_of, t.reaches, t.spans, t.shown,
            theta, now, past, carried, k, k + 1, jacobian,
        )  # fmt: skip
        if k < skip:
            continue
        room[:] = 0.0
        for j in range(len(t.shown)):
            e = now[end - 1, t.rows[t.shown[j]]] - target[k, j]
            for p in range(len(theta)):
                if variable[p] >= 0:
                    room[variable[p]] += e * jacobian[0, j, p]
        for p in range(len(theta)):
            if variable[p] >= 0:
                theta[p] -= rate * (room[variable[p]] + decay[variable[p]] * theta[p])
