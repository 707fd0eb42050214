"""A proved bound of |fixed - float| for networks without feedback, and a contraction for recurrent ones.

The error of fixed point has sources: the rounding of each input, each sum and each weight, and the worst error of each
table. Through the float network they reach the outputs with slopes that are known to lie in an interval. Everything is
computed for boxes of inputs, and the worst boxes are halved until time is over; the bound is that of the worst box.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greygate.emulator.engine import run
from greygate.emulator.interpreter import lookup
from greygate.emulator.numbers import Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Product, Program
from greygate.hardware.proofs.elaborated import Proof, timed
from greygate.models.accuracy import float_error
from greygate.models.activations import ACTIVATIONS
from greygate.models.arithmetic import xp
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

SECONDS = 10.0  # of halving boxes
MOST_BOXES = 200_000
AT_ONCE = 2048  # boxes
FLOAT = 1e-12  # relative allowance for float64 in the bound's own sums
OBSERVED = 50_000  # random inputs of the box, on which the error is also looked at
HOW = "interval arithmetic over float network and program together, boxes of inputs halved"


class Unfit(Exception):
    """Why no bound can be given, in words."""


Box = tuple[np.ndarray, np.ndarray]  # the least and the greatest of each element that a step begins from


def bounded(
    program: Program,
    network: Network,
    inputs: Mapping[str, tuple[float, float]],
    seconds: float = SECONDS,
    progress: Progress = silent,
) -> Proof:
    """The bound, in units of the outputs, and beside it the largest error observed on random inputs.

    inputs: the least and the greatest value of each, in its unit; the bound holds between them.
    """
    said = ", ".join(f"{lo:.6g} <= {name} <= {hi:.6g}" for name, (lo, hi) in inputs.items())
    what = f"bound of |fixed - float| for {said}"
    with timed() as spent:
        try:
            chain = Chain.of(program, network)
            box = _box(program, inputs)
            found, boxes = _search(chain, box, seconds, progress)
        except Unfit as error:
            return Proof(what, HOW, None, spent[0], str(error))
        seen = _observed(program, network, box)
        scale = [abs(p.scale) for p in program.outputs for _ in range(p.signal.size)]
        lsb = [p.signal.fix.lsb for p in program.outputs for _ in range(p.signal.size)]
        names = [p.name for p in program.outputs for _ in range(p.signal.size)]
        rows = tuple(
            {"output": n, "bound": b * s, "observed": o * s, "bound in LSB": b / q, "observed in LSB": o / q}
            for n, b, o, s, q in zip(names, found, seen, scale, lsb, strict=True)
        )
    worst = max(rows, key=lambda row: row["bound in LSB"])
    holds = bool(np.all(seen <= found))
    why = None if holds else "an observed error exceeds the bound: the float network is not that of the program"
    return Proof(what, HOW, holds, spent[0], why, {**worst, "boxes": boxes}, rows)


def contraction(program: Program) -> Proof:
    """For recurrent programs: whether a step brings any two states closer, in a weighted maximum norm.

    The slopes of a step, states to states, are bounded over all codes; if the matrix of the bounds has a spectral
    radius below 1, there is such a norm, errors die out, and the error of long runs is bounded.
    """
    what, how = "a step is a contraction", "bounds of the slopes of a step over all codes"
    with timed() as spent:
        try:
            radius = _radius(program)
        except Unfit as error:
            return Proof(what, how, None, spent[0], str(error))
    if radius < 1:
        return Proof(what, how, True, spent[0], None, {"spectral radius": radius})
    why = (
        f"the bounds have spectral radius {radius:.4g}, not below 1: the states may remember what the bounds cannot see"
    )
    return Proof(what, how, None, spent[0], why, {"spectral radius": radius})


@dataclass(frozen=True)
class Chain:
    """The operations of a program with the float weights that they were made of.

    weights: float matrix of each affine operation, columns as the program's; biases likewise. activation: of tables.
    """

    program: Program
    weights: dict[str, np.ndarray]
    biases: dict[str, np.ndarray]
    activation: dict[str, str]

    @classmethod
    def of(cls, program: Program, network: Network) -> "Chain":
        """Raises Unfit for feedback, an operation without a slope, or a program that is not of this network."""
        if loop := feedback(program):
            raise Unfit(f"{loop} depends on its own past: errors accumulate, and a bound needs a contraction")
        flat = network.flatten()
        layers, feeds = flat.layers(), flat.feeds()
        weights, biases, activation = {}, {}, {}
        for o in program.operations:
            if isinstance(o, Lookup):
                table = program.table[o.table]
                kind = ACTIVATIONS.get(table.function)
                if kind is None or not (kind.is_sigmoid or table.function == "square"):
                    raise Unfit(f"the slope of {table.function} is not bounded here")
                activation[o.out.name] = table.function
            elif isinstance(o, Affine):
                name = o.out.name.removesuffix(".n")
                if name not in layers:
                    raise Unfit(f"{o.out.name} is not a layer of the network: a narrowed state or another operation")
                columns = _columns(program, o, name, layers[name], feeds)
                weights[o.out.name], biases[o.out.name] = columns, layers[name].bias
            elif isinstance(o, Product):
                raise Unfit(f"{o.out.name} multiplies two signals, whose errors are not bounded here")
            elif not isinstance(o, Clamp):
                raise Unfit(f"{o.out.name} jumps, so that a small error may become a large one")
        return cls(program, weights, biases, activation)


def feedback(program: Program) -> str | None:
    """A state that depends on its own past; None if states only delay inputs and what follows from them."""
    reads = {o.out.name: {*o.args} for o in program.operations} | {s.signal.name: {s.source} for s in program.states}
    for state in program.states:
        seen, open_ = set(), [state.signal.name]
        while open_:
            for name in reads.get(open_.pop(), ()):
                if name == state.signal.name:
                    return name
                if name not in seen:
                    seen.add(name)
                    open_.append(name)
    return None


def _columns(program: Program, o: Affine, name: str, layer, feeds: dict) -> np.ndarray:
    """The float weights of a layer, in the order of the program's columns."""
    left = {port: (feeds[f"{name}.{port}"], w) for port, w in layer.weights.items()}
    parts = []
    for a in o.args:
        source, delay = _delayed(program, a)
        port = next((p for p, (feed, _) in left.items() if feed == (source, delay)), None)
        if port is None:
            raise Unfit(f"{o.out.name} reads {a}, which the float network does not")
        parts.append(left.pop(port)[1])
    if any(w.any() for _, w in left.values()):
        raise Unfit(f"{o.out.name} does not read everything that the float network does")
    return np.hstack(parts)


def _delayed(program: Program, name: str) -> tuple[str, int]:
    """(signal, delay) of a signal of the program."""
    sources = {s.signal.name: s.source for s in program.states}
    delay = 0
    while name in sources:
        name, delay = sources[name], delay + 1
    return name, delay


@dataclass(frozen=True)
class _Signal:
    """Over N boxes: the float value of each element in [lo, hi] (N, n), and its error as sums of sources.

    least, most: (N, n, sources) how much of each source arrives; a source is a number in [-1, 1].
    """

    lo: np.ndarray
    hi: np.ndarray
    least: np.ndarray
    most: np.ndarray

    def error(self) -> np.ndarray:
        """The bound of each element's error (N, n)."""
        return np.maximum(np.abs(self.least), np.abs(self.most)).sum(axis=2) * (1 + FLOAT)


def _search(chain: Chain, box: Box, seconds: float, progress: Progress) -> tuple[np.ndarray, int]:
    """(bound of each output in normalised units, boxes)."""
    lo, hi = box[0][None], box[1][None]
    bounds = _bounds(chain, lo, hi)
    until = time.perf_counter() + seconds
    while time.perf_counter() < until and len(lo) < MOST_BOXES:
        progress(f"{len(lo)} boxes")
        score = (bounds / bounds.max(axis=0)).max(axis=1)
        order = np.argsort(-score)[: max(1, min(AT_ONCE // 2, len(lo) // 4 + 1))]
        halves = _halved(lo[order], hi[order])
        new = _bounds(chain, *halves)
        keep = np.ones(len(lo), bool)
        keep[order] = False
        parent = np.concatenate([bounds[order]] * 2)  # a half is no worse than the whole
        lo, hi = (np.concatenate([old[keep], part]) for old, part in zip((lo, hi), halves, strict=True))
        bounds = np.concatenate([bounds[keep], np.minimum(new, parent)])
    return bounds.max(axis=0), len(lo)


def _box(program: Program, inputs: Mapping[str, tuple[float, float]]) -> Box:
    """The values that inputs, and their delayed codes, can have, normalised; in the order of `_leaves`."""
    ports = {p.signal.name: p for p in program.inputs}
    ends = []
    for name, _ in _leaves(program):
        port = ports.get(_delayed(program, name)[0])
        if port is None:
            raise Unfit(f"{name} delays what was computed; only delays of inputs are followed")
        fix = port.signal.fix
        given = sorted((v - port.offset) / port.scale for v in inputs[port.name])
        ends.append((max(given[0], fix.lo * fix.lsb), min(given[1], fix.hi * fix.lsb)))
    lo, hi = np.array(ends).T
    return lo, hi


def _leaves(program: Program) -> list[tuple[str, int]]:
    """Elements that a step begins from: of the inputs and of the states."""
    signals = [p.signal for p in program.inputs] + [s.signal for s in program.states]
    return [(s.name, k) for s in signals for k in range(s.size)]


def _halved(lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both halves of each box along its longest side."""
    side, rows = np.argmax(hi - lo, axis=1), np.arange(len(lo))
    middle = 0.5 * (lo + hi)[rows, side]
    left, right = hi.copy(), lo.copy()
    left[rows, side] = right[rows, side] = middle
    return np.concatenate([lo, right]), np.concatenate([left, hi])


def _bounds(chain: Chain, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    """The bound of each output's error in each box (N, outputs), in parts."""
    parts = [_step(chain, lo[k : k + AT_ONCE], hi[k : k + AT_ONCE]) for k in range(0, len(lo), AT_ONCE)]
    return np.concatenate(parts)


def _step(chain: Chain, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
    program = chain.program
    count = sum(s.size for s in program.signals.values()) * 2
    sources = _Sources(count)
    found: dict[str, _Signal] = {}
    leaves = _leaves(program)
    for name in dict.fromkeys(n for n, _ in leaves):
        at = [k for k, (n, _) in enumerate(leaves) if n == name]
        half = np.full((len(lo), len(at)), 0.5 * program.signals[name].fix.lsb)
        found[name] = _Signal(lo[:, at], hi[:, at], *sources.new(half))
    for o in program.operations:
        args = [found[a] for a in o.args]
        if isinstance(o, Affine):
            found[o.out.name] = _affine(chain, o, args, sources)
        elif isinstance(o, Lookup):
            found[o.out.name] = _table(chain, o, args[0], sources)
        elif isinstance(o, Clamp):
            found[o.out.name] = _clamp(program, o, args[0], sources)
    return np.concatenate([found[p.signal.name].error() for p in program.outputs], axis=1)


class _Sources:
    """Gives each new error a place of its own among `count`."""

    def __init__(self, count: int):
        self.count, self.used = count, 0

    def new(self, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(least, most) of new errors of that size (N, n), one for each element."""
        found = np.zeros((*size.shape, self.count))
        for k in range(size.shape[1]):
            found[:, k, self.used + k] = size[:, k]
        self.used += size.shape[1]
        return found, found


def _affine(chain: Chain, o: Affine, args: list[_Signal], sources: _Sources) -> _Signal:
    """Weights of the program carry the errors; what they differ from the float weights meets the float values."""
    name, out = o.out.name, o.out.fix
    lsbs = np.concatenate([[chain.program.signals[a].fix.lsb] * chain.program.signals[a].size for a in o.args])
    scale = 2.0 ** -o.frac.astype(float)
    fixed = o.weights * scale[:, None] / lsbs
    bias = o.bias * scale
    lo, hi = (np.concatenate([getattr(a, end) for a in args], axis=1) for end in ("lo", "hi"))
    exact, exact_bias = chain.weights[name], chain.biases[name]
    values = _times(exact, lo, hi)
    values = tuple(v + exact_bias for v in values)
    wrong = _times(fixed - exact, lo, hi)
    wrong = tuple(v + (bias - exact_bias) for v in wrong)
    middle = {Rounding.TRUNCATE: -0.5}.get(o.rounding, 0.0)
    rounding = np.where(o.frac > out.frac, 0.5 * out.lsb, 0.0)
    size = np.maximum(np.abs(wrong[0] + 2 * middle * rounding), np.abs(wrong[1] + 2 * middle * rounding)) + rounding
    least, most = (np.concatenate([getattr(a, end) for a in args], axis=1) for end in ("least", "most"))
    least, most = _carried(fixed, least, most)
    new, _ = sources.new(size)
    found = _Signal(*values, least + new, most + new)
    return found if _inside(found, o) else _saturated(found, o, chain)


def _inside(found: _Signal, o: Affine) -> bool:
    """Whether no code of the result can saturate."""
    out, error = o.out.fix, found.error()
    return bool(np.all(found.lo - error >= out.lo * out.lsb) and np.all(found.hi + error <= out.hi * out.lsb))


def _saturated(found: _Signal, o: Affine, chain: Chain) -> _Signal:
    """Where it may: only in front of a table, whose answers beyond the format are flat (`_table` allows for that)."""
    readers = [other for other in chain.program.operations if o.out.name in other.args]
    shown = o.out.name in {p.signal.name for p in chain.program.outputs}
    if o.overflow is Overflow.SATURATE and readers and not shown and all(isinstance(r, Lookup) for r in readers):
        return found
    out, error = o.out.fix, found.error()
    beyond = np.maximum(found.hi - out.hi * out.lsb, out.lo * out.lsb - found.lo) + error
    extra = np.where(beyond > 0, beyond, 0.0)
    return _Signal(
        found.lo,
        found.hi,
        found.least,
        np.concatenate([found.most[:, :, :-1], found.most[:, :, -1:] + extra[:, :, None]], axis=2),
    )


def _times(weights: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """weights @ [lo, hi] for each box."""
    up, down = np.maximum(weights, 0), np.minimum(weights, 0)
    return lo @ up.T + hi @ down.T, hi @ up.T + lo @ down.T


def _carried(weights: np.ndarray, least: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """weights @ what of each source arrives: (N, rows, sources)."""
    up, down = np.maximum(weights, 0), np.minimum(weights, 0)
    return up @ least + down @ most, up @ most + down @ least


def _table(chain: Chain, o: Lookup, arg: _Signal, sources: _Sources) -> _Signal:
    """The slope carries the error of the argument; then the table's own error, and what lies beyond the format."""
    table = chain.program.table[o.table]
    function, fix = ACTIVATIONS[table.function], table.arg
    error = arg.error()
    lo, hi = arg.lo - error, arg.hi + error
    slopes = _slopes(table.function, lo, hi)
    ends = [function.value(xp, v) for v in (arg.lo, arg.hi)]
    values = (np.minimum(*ends), np.maximum(*ends))
    if table.function == "square":
        values = (np.where((arg.lo <= 0) & (arg.hi >= 0), 0.0, values[0]), values[1])
    beyond = np.zeros_like(error)
    for end, outer in ((fix.hi * fix.lsb, hi), (fix.lo * fix.lsb, lo)):
        more = np.abs(function.value(xp, outer) - function.value(xp, np.full_like(outer, end)))
        beyond = np.maximum(beyond, np.where((outer > end) if end > 0 else (outer < end), more, 0.0))
    found = [slopes[0][:, :, None] * arg.least, slopes[0][:, :, None] * arg.most]
    found += [slopes[1][:, :, None] * arg.least, slopes[1][:, :, None] * arg.most]
    new, _ = sources.new(table.worst_error + beyond)
    return _Signal(*values, np.minimum.reduce(found) + new, np.maximum.reduce(found) + new)


def _slopes(name: str, lo: np.ndarray, hi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest slope of a function on each interval."""
    if name == "square":
        return 2 * lo, 2 * hi
    function = ACTIVATIONS[name]  # a sigmoid: the slope falls on both sides of 0
    nearest = np.where((lo <= 0) & (hi >= 0), 0.0, np.where(np.abs(lo) < np.abs(hi), lo, hi))
    farthest = np.where(np.abs(lo) > np.abs(hi), lo, hi)
    least, most = (function.slope(xp, function.value(xp, n)) for n in (farthest, nearest))
    return np.maximum(least - FLOAT, 0.0), most + FLOAT


def _clamp(program: Program, o: Clamp, arg: _Signal, sources: _Sources) -> _Signal:
    """A clamp passes an error on, or makes it smaller; then it rounds."""
    fix, out = program.signals[o.arg].fix, o.out.fix
    size = arg.error() + (0.5 * out.lsb if fix.frac > out.frac else 0.0)
    ends = o.lo * fix.lsb, o.hi * fix.lsb
    new, _ = sources.new(size)
    return _Signal(np.clip(arg.lo, *ends), np.clip(arg.hi, *ends), new, new)


def _observed(program: Program, network: Network, box: Box) -> np.ndarray:
    """The largest error of each output seen on random inputs of the box, normalised."""
    lo, hi = box
    rng = np.random.default_rng(0)
    inputs, at = {}, 0
    for p in program.inputs:
        n = p.signal.size
        values = rng.uniform(lo[at : at + n], hi[at : at + n], (OBSERVED, n)) * p.scale + p.offset
        inputs[p.name], at = values if n > 1 else values[:, 0], at + n
    nothing = {p.name: np.zeros((OBSERVED, *[p.size] * (p.size > 1))) for p in network.outputs}
    float_ = float_error(network, Record(inputs, nothing))  # from zero: the prediction itself
    fixed = program.decode(run(program, program.encode(inputs), states=False).outputs)
    skip = len(program.states)  # the delays fill up
    errors = []
    for p in program.outputs:
        difference = np.abs(np.asarray(fixed[p.name]) - np.asarray(float_[p.name]))[skip:] / abs(p.scale)
        errors += list(np.atleast_1d(difference.max(axis=0)))
    return np.array(errors)


def _radius(program: Program) -> float:
    """Spectral radius of the bounds of all slopes of a step, from states to states, over all codes."""
    states = [(s.signal.name, k) for s in program.states for k in range(s.signal.size)]
    if not states:
        return 0.0
    slope: dict[str, np.ndarray] = {}
    for name, signal in program.signals.items():
        slope[name] = np.zeros((signal.size, len(states)))
    for j, (name, k) in enumerate(states):
        slope[name][k, j] = 1.0
    for o in program.operations:
        args = [slope[a] for a in o.args]
        if isinstance(o, Affine):
            lsbs = np.concatenate([[program.signals[a].fix.lsb] * program.signals[a].size for a in o.args])
            weights = np.abs(o.weights * 2.0 ** -o.frac.astype(float)[:, None] / lsbs)
            slope[o.out.name] = weights @ np.vstack(args)
        elif isinstance(o, Lookup):
            slope[o.out.name] = _steepest(program, o) * args[0]
        elif isinstance(o, Clamp):
            slope[o.out.name] = args[0]
        elif any(a.any() for a in args):
            does = "multiplies by" if isinstance(o, Product) else "jumps with"
            raise Unfit(f"{o.out.name} {does} a state")
    step = np.vstack([slope[s.source] for s in program.states])
    return float(np.max(np.abs(np.linalg.eigvals(step))))


def _steepest(program: Program, o: Lookup) -> float:
    """The greatest slope of a table: of its function, or between the codes of its argument."""
    table = program.table[o.table]
    function = ACTIVATIONS.get(table.function)
    if function is not None and function.is_sigmoid:
        return float(_slopes(table.function, np.zeros(1), np.zeros(1))[1][0])
    codes = np.arange(table.arg.lo, table.arg.hi + 1)
    return float(np.max(np.abs(np.diff(lookup(table, codes)))) * table.out.lsb / table.arg.lsb)


STEPS = 1_000_000
TENTH = 10  # the last tenth of the run against the first, both of whole repetitions


def no_drift(
    program: Program, network: Network, record: Record, steps: int = STEPS, progress: Progress = silent
) -> Proof:
    """Run both over the record's inputs again and again; the mean error in the last tenth must be that of the first.

    They may differ by one LSB of the output. The states go on from one repetition to the next; there are at least ten,
    after one that is left out: it begins from the record's initial state, and the others with a jump of the inputs.
    """
    length = len(next(iter(record.inputs.values())))
    how = "emulator and float network on a scenario repeated"
    with timed() as seconds:
        times = max(TENTH, -(-steps // length))
        inputs = {p.name: np.concatenate([np.asarray(record.inputs[p.name])] * (times + 1)) for p in network.inputs}
        nothing = {p.name: np.zeros(((times + 1) * length, *[p.size] * (p.size > 1))) for p in network.outputs}
        progress("drift: float network")
        float_ = float_error(network, Record(inputs, nothing, record.initial))  # from zero: the prediction itself
        progress("drift: fixed point")
        fixed = program.decode(run(program, program.encode(inputs), states=False).outputs)
        moved, tenth = {}, times // TENTH * length
        for port in program.outputs:
            lsb = abs(port.signal.fix.lsb * port.scale)
            error = (np.asarray(fixed[port.name]) - np.asarray(float_[port.name]))[length:] / lsb
            first, last = (part.mean(axis=0) for part in (error[:tenth], error[-tenth:]))
            moved[port.name] = float(np.max(np.abs(last - first)))
    what = f"no drift over {times * length:,} steps in closed loop"
    worst = max(moved, key=lambda name: moved[name])
    holds = moved[worst] <= 1.0
    why = None if holds else f"{worst}: the mean error moved by {moved[worst]:.3g} LSB"
    rows = tuple({"output": name, "moved": value} for name, value in moved.items())
    return Proof(what, how, holds, seconds[0], why, {"mean error moved by, in LSB": moved[worst]}, rows)
