"""Builds a network from the operations of another tool's graph.

Every value of such a graph is a `Value`: a constant, or an affine function of signals that the network has. Affine
operations on it cost nothing; an activation becomes a layer. So a chain of scalings, sums, slices and matrix products
before a tanh is one layer, with the weights of all of them.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from greygate.errors import InputError, shown
from greygate.models.activations import ACTIVATIONS
from greygate.models.network import Layer, Network, Port
from greygate.names import CORE_NAMES, KEYWORDS, LONGEST_NAME, check_name, check_path, check_unit

Number = float | np.ndarray
ROUNDED = 2.0**-44  # below the step of any word; above what float64 rounds, of values up to some hundred
SAME = 1e-12  # of the largest number of a row: what scalings on the way leave of equality
WIDE = 1 << 20  # of limits: scaled to 0 and 1, a value between them would lose more than 20 of its 53 bits
POSITIVE = {"logsig", "negexp", "normal", "rsqrt", "softfall"}  # never 0, however small
SMALL = 1e-75  # below what these are, so that the product of four is still a float
SORTED = 16  # numbers: they take a multiplexer for each pair
MOST = 1 << 22  # weights of one value: a matrix of 2,048 by 2,048
_NAMED = re.compile(r"\s*(\S+?)\s*(?:\[([^\]]*)\])?\s*")  # of a port, with its unit
Signal = tuple[str, int]
"""(module or input port, delay in steps)."""
Activate = Callable[["Value", str], "Value"]
"""An activation of a value, with a name for its layers."""


@dataclass(frozen=True)
class Value:
    """bias + sum of weights[signal] @ signal, of `shape`; its elements in row-major order."""

    shape: tuple[int, ...]
    bias: np.ndarray
    weights: Mapping[Signal, np.ndarray]

    @property
    def size(self) -> int:
        return len(self.bias)

    @property
    def numbers(self) -> int:
        """How many numbers it holds, those of its weights too."""
        return self.size * (1 + sum(w.shape[1] for w in self.weights.values()))

    @property
    def constant(self) -> np.ndarray | None:
        """The array that it is, if it reads no signal."""
        return None if self.weights else self.bias.reshape(self.shape)

    def rows(self, places: np.ndarray) -> "Value":
        """The elements at `places`, an array of indices, in its shape."""
        _room(places.size * (1 + sum(w.shape[1] for w in self.weights.values())))
        flat = places.reshape(-1)
        return Value(places.shape, self.bias[flat], {s: w[flat] for s, w in self.weights.items()})

    def moved(self, how: Callable[[np.ndarray], np.ndarray]) -> "Value":
        """Its elements in other places: what `how` does to an array of this shape."""
        return self.rows(how(np.arange(self.size).reshape(self.shape)))

    def late(self, delay: int) -> "Value":
        """What it was so many steps before."""
        return Value(self.shape, self.bias, {(s, d + delay): w for (s, d), w in self.weights.items()})

    def times(self, factor: np.ndarray | float) -> "Value":
        """Element by element, with NumPy's broadcasting."""
        shape = np.broadcast_shapes(self.shape, np.shape(factor))
        wide = self.moved(lambda x: np.broadcast_to(x, shape))
        by = np.broadcast_to(np.asarray(factor, float), shape).reshape(-1)
        return Value(shape, wide.bias * by, {s: w * by[:, None] for s, w in wide.weights.items()})

    def plus(self, other: "Value") -> "Value":
        """Element by element, with NumPy's broadcasting."""
        shape = np.broadcast_shapes(self.shape, other.shape)
        one, two = (v.moved(lambda x: np.broadcast_to(x, shape)) for v in (self, other))
        weights = {s: np.array(w) for s, w in one.weights.items()}
        for s, w in two.weights.items():
            weights[s] = weights[s] + w if s in weights else w
        return Value(shape, one.bias + two.bias, weights)

    def summed(self, axes: Sequence[int] = (), keep: bool = False) -> "Value":
        """The sum along some axes, along all if none is named. keep: they stay, with one element."""
        count = len(self.shape)
        chosen = sorted({a % count for a in axes}) if axes else list(range(count))
        rest = [k for k in range(count) if k not in chosen]
        size = int(np.prod([self.shape[k] for k in chosen]))
        flat = self.moved(lambda i: i.transpose(*rest, *chosen).reshape(-1, size))
        shape = [1 if k in chosen else n for k, n in enumerate(self.shape) if keep or k not in chosen]
        return flat.linear(np.ones((1, size))).moved(lambda i: i.reshape(shape))

    def mean(self, axes: Sequence[int] = (), keep: bool = False) -> "Value":
        """As `summed`, of the mean."""
        total = self.summed(axes, keep)
        return total.times(total.size / self.size)

    def parts(self, lengths: Sequence[int], axis: int) -> list["Value"]:
        """Pieces of such lengths along an axis; the last one has what is left."""
        ends = np.minimum(np.cumsum([0, *lengths]), self.shape[axis]).tolist()
        return [taken(self, range(a, b), axis) for a, b in pairwise(ends)]

    def linear(self, matrix: np.ndarray) -> "Value":
        """The last axis n becomes m: matrix (m, n) @ each."""
        m, n = matrix.shape
        count = self.size // n
        _room(count * m * (1 + sum(w.shape[1] for w in self.weights.values())))
        weights = {s: (matrix @ w.reshape(count, n, -1)).reshape(count * m, -1) for s, w in self.weights.items()}
        return Value((*self.shape[:-1], m), (self.bias.reshape(count, n) @ matrix.T).reshape(-1), weights)


def word(text: str) -> str:
    """A name of another tool as letters, digits and _, no digit first; "" if it has none of these."""
    plain = re.sub(r"_+", "_", re.sub(r"\W", "_", text, flags=re.ASCII)).strip("_")
    return f"n{plain}" if plain[:1].isdigit() else plain


def titled(path: Path | str) -> str:
    """A network's name by that of its file, longer by a word where no design could have it, as `wire`."""
    name = word(Path(path).stem)[:LONGEST_NAME] or "network"
    return f"{name}_network" if name in KEYWORDS or name in CORE_NAMES else name


def _room(count: int) -> None:
    """Raise InputError for what takes too much memory: dense matrices are for small networks."""
    if count > MOST:
        raise InputError(f"its result has {count} weights; at most {MOST} are taken")


def constant(array: object) -> Value:
    """A value that reads no signal."""
    found = np.asarray(array, float)
    return Value(found.shape, found.reshape(-1), {})


def joined(values: Sequence[Value], axis: int) -> Value:
    """Values one behind the other along an axis, as np.concatenate."""
    _room(sum(v.numbers for v in values))
    starts = np.cumsum([0, *(v.size for v in values)])
    places = np.concatenate(
        [start + np.arange(v.size).reshape(v.shape) for v, start in zip(values, starts, strict=False)], axis
    )
    signals = [s for v in values for s in v.weights]
    width = {s: w.shape[1] for v in values for s, w in v.weights.items()}
    weights = {
        s: np.concatenate([v.weights.get(s, np.zeros((v.size, width[s]))) for v in values])
        for s in dict.fromkeys(signals)
    }
    whole = Value((int(starts[-1]),), np.concatenate([v.bias for v in values]), weights)
    return whole.rows(places)


def stacked(values: Sequence[Value], axis: int) -> Value:
    """As np.stack."""
    return joined([v.moved(lambda i: np.expand_dims(i, axis)) for v in values], axis)


class Builder:
    """A network under construction.

    inputs: ports, or names of ports without unit and scale. Names of layers are made from hints, and kept unique.
    """

    def __init__(self, name: str, inputs: Sequence[Port | str], outputs: Sequence[Port | str]):
        check_name(name, "network")
        self.inputs, self.outputs = ([port(p) for p in ports] for ports in (inputs, outputs))
        if not self.inputs or not self.outputs:
            raise InputError(f"network {name}: has no {'input' if self.outputs else 'output'}; name one")
        self.network = Network(name, self.inputs, self.outputs)
        self._initial: dict[str, np.ndarray] = {}
        self._made: dict[str, tuple[Value, str]] = {}  # a layer -> the sum that it reads, its activation
        self._ends: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._inverses: dict[str, Value] = {}  # the same -> 1 by it
        self._roots: dict[str, Value] = {}  # a layer that is a square root -> of what

    def input(self, ports: Sequence[Port], shape: Sequence[int]) -> Value:
        """The ports of an input tensor, in their units, side by side."""
        parts = [Value((p.size,), np.full(p.size, p.offset), {(p.name, 0): p.scale * np.eye(p.size)}) for p in ports]
        whole = joined(parts, 0)
        if whole.size != int(np.prod(shape)):
            names = ", ".join(p.name for p in ports)
            raise InputError(f"inputs {names}: {whole.size} numbers, the model takes {list(shape)}; name one port each")
        return whole.moved(lambda x: x.reshape(tuple(shape)))

    def window(self, ports: Sequence[Port], shape: Sequence[int], axis: int) -> Value:
        """The last samples of the ports along that axis of an input tensor, the one of this step at its end."""
        rest = [n for k, n in enumerate(shape) if k != axis]
        now = self.input(ports, rest)
        return stacked([now.late(delay) for delay in reversed(range(shape[axis]))], axis)

    def state(self, hint: str, initial: np.ndarray) -> tuple[str, Value]:
        """(its name, what it was one step before); `keep` says what it becomes."""
        name, values = self._free(hint), np.asarray(initial, float)
        flat = values.reshape(-1)
        self.network.modules[name] = Layer({}, flat)  # its place in the order; `keep` fills it
        self._initial[name] = flat
        return name, Value(values.shape, np.zeros(flat.size), {(name, 1): np.eye(flat.size)})

    def keep(self, name: str, value: Value) -> None:
        """The value of this step becomes the state."""
        if value.size != len(self._initial[name]):
            raise InputError(f"state {name}: {len(self._initial[name])} elements become {value.size}")
        del self.network.modules[name]
        self._layer(name, value.bias, value.weights, "linear", self._initial[name])

    def activated(self, value: Value, activation: str, hint: str) -> Value:
        """A layer of that activation; a constant stays one."""
        name = self._free(hint)
        self._layer(name, value.bias, value.weights, activation)
        return Value(value.shape, np.zeros(value.size), {(name, 0): np.eye(value.size)})

    def selected(self, condition: Value, above: Value, below: Value, hint: str) -> Value:
        """Where the condition is 0 or more, `above`; else `below`."""
        three = joined([v.moved(np.ravel) for v in (condition, above, below)], 0)
        name = self._free(hint)
        self._layer(name, three.bias, three.weights, "select")
        return Value(above.shape, np.zeros(above.size), {(name, 0): np.eye(above.size)})

    def chosen(self, condition: Value, above: Value, below: Value, hint: str) -> Value:
        """As `selected`, with NumPy's broadcasting."""
        given = (condition, above, below)
        shape = np.broadcast_shapes(*(v.shape for v in given))
        one, two, three = (v.moved(lambda i: np.broadcast_to(i, shape)) for v in given)
        return self.selected(one, two, three, hint)

    def maximum(self, a: Value, b: Value, hint: str) -> Value:
        return self.chosen(a.plus(b.times(-1.0)), a, b, hint)

    def minimum(self, a: Value, b: Value, hint: str) -> Value:
        return self.chosen(b.plus(a.times(-1.0)), a, b, hint)

    def at_least(self, a: Value, b: Value, hint: str) -> Value:
        """1 where a >= b, else 0."""
        return self.activated(a.plus(b.times(-1.0)), "hardlim", hint)

    def largest(self, value: Value, axes: Sequence[int], keep: bool, hint: str) -> Value:
        """The maximum along some axes, along all if none is named. keep: they stay, with one element."""
        return self.along(value, axes, keep, lambda a, b: self.maximum(a, b, hint))

    def place(self, value: Value, axis: int, keep: bool, hint: str) -> Value:
        """The index of the maximum along an axis, the first of equal ones."""
        best, *others = (taken(value, [k], axis) for k in range(value.shape[axis]))
        at = constant(np.zeros(best.shape))
        for k, other in enumerate(others, 1):
            ahead = best.plus(other.times(-1.0))
            at = self.chosen(ahead, at, constant(float(k)), hint)
            best = self.chosen(ahead, best, other, hint)
        return at if keep else at.moved(lambda i: np.squeeze(i, axis))

    def ordered(self, value: Value, axis: int, hint: str) -> list[Value]:
        """The elements along an axis, the least first. Raises InputError for more than SORTED."""
        found = [taken(value, [k], axis) for k in range(value.shape[axis])]
        if len(found) > SORTED:
            raise InputError(f"sorts {len(found)} numbers; at most {SORTED} can be carried")
        for last in range(len(found) - 1, 0, -1):
            for k in range(last):
                a, b = found[k : k + 2]
                found[k : k + 2] = self.minimum(a, b, hint), self.maximum(a, b, hint)
        return found

    def multiplied(self, value: Value, axes: Sequence[int], keep: bool, hint: str) -> Value:
        """The product along some axes, as `largest`."""
        return self.along(value, axes, keep, lambda a, b: self.product(a, b, hint))

    def equal(self, a: Value, b: Value, hint: str) -> Value:
        """1 where both are the same, else 0; what ROUNDED sets apart is the same: a floor is a difference of two."""
        near = self.at_least(a.plus(constant(ROUNDED)), b, hint).plus(self.at_least(b.plus(constant(ROUNDED)), a, hint))
        return near.plus(constant(-1.0))

    @staticmethod
    def along(value: Value, axes: Sequence[int], keep: bool, how: Callable[[Value, Value], Value]) -> Value:
        """What `how` makes of two, of all along some axes, in a tree; as `largest`."""
        count = len(value.shape)
        chosen = sorted({a % count for a in axes}) if axes else list(range(count))
        rest = [k for k in range(count) if k not in chosen]
        size = int(np.prod([value.shape[k] for k in chosen]))
        found = value.moved(lambda i: i.transpose(*rest, *chosen).reshape(-1, size))
        while found.shape[1] > 1:
            half = found.shape[1] // 2
            one, other, odd = found.parts([half, half, found.shape[1]], 1)
            found = joined([how(one, other), odd], 1) if odd.size else how(one, other)
        shape = [1 if k in chosen else n for k, n in enumerate(value.shape) if keep or k not in chosen]
        return found.moved(lambda i: i.reshape(shape))

    def ends(self, value: Value) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of each element, whatever enters; they may be infinite."""
        for name, (read, activation) in self._made.items():
            if name not in self._ends:
                self._ends[name] = self._image(read, activation)
        return self._sum_ends(value)

    def _sum_ends(self, value: Value) -> tuple[np.ndarray, np.ndarray]:
        low, high = value.bias, value.bias
        for (name, _), w in value.weights.items():
            a, b = self._ends.get(name, (np.full(w.shape[1], -np.inf), np.full(w.shape[1], np.inf)))
            low = low + (_times(np.maximum(w, 0), a) + _times(np.minimum(w, 0), b)).sum(1)
            high = high + (_times(np.maximum(w, 0), b) + _times(np.minimum(w, 0), a)).sum(1)
        return low, high

    def _image(self, read: Value, activation: str) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of a layer: those of its activation, or of the sums that it reads."""
        rows = ACTIVATIONS[activation].rows
        parts = read.parts([read.size // rows] * rows, 0)
        if activation == "linear":
            return self._sum_ends(read)
        if rows == 1:
            least, most = ACTIVATIONS[activation].image
            least = SMALL if least == 0 and activation in POSITIVE else least
            return np.full(read.size, least), np.full(read.size, most)
        ends = [self._sum_ends(part) for part in parts]
        if activation == "product":
            corners = [_times(one, other) for one in ends[0] for other in ends[1]]
            low, high = np.min(corners, 0), np.max(corners, 0)
            factor = _multiple(*parts)  # of a square
            return np.where(factor > 0, np.maximum(low, 0), low), np.where(factor < 0, np.minimum(high, 0), high)
        (_, (above, top), (below, bottom)), (condition, one, other) = ends, parts
        beyond = other.plus(one.times(-1.0))  # where the condition rises with what is above less below, it is a maximum
        rising = _multiple(condition, one) > 0, _multiple(condition, other) < 0
        largest = _multiple(condition, beyond) < 0
        above = np.where(rising[0], np.maximum(above, 0), above)
        below = np.where(rising[1], np.maximum(below, 0), below)
        low = np.where(largest, np.maximum(above, below), np.minimum(above, below))
        return low, np.maximum(top, bottom)

    def root(self, value: Value, hint: str) -> Value:
        """The square root of what is never negative."""
        found = self.activated(value, "root", hint)
        ((name, _),) = found.weights
        low, high = (np.sqrt(end) for end in self.ends(value))
        self._ends[name], self._roots[name] = (low.ravel(), high.ravel()), value
        return found

    def positive(self, value: Value) -> Value:
        """A layer of which it is known that it is never 0 or below."""
        ((name, _),) = value.weights
        self._ends[name] = np.full(value.size, SMALL), np.full(value.size, np.inf)
        return value

    def inverse_of_root(self, value: Value) -> Value | None:
        """1 by a value whose elements are multiples of one square root, which is there already; else None."""
        if len(value.weights) != 1 or value.bias.any():
            return None
        (((name, delay), w),) = value.weights.items()
        if name not in self._roots or delay or ((w != 0).sum(1) != 1).any():
            return None
        at = np.argmax(w != 0, 1)
        factor = w[np.arange(len(w)), at].reshape(value.shape)
        if name not in self._inverses:
            self._inverses[name] = self.activated(self._roots[name].moved(np.ravel), "rsqrt", name)
        return self._inverses[name].rows(at.reshape(value.shape)).times(1 / factor)

    def named(self, name: str, value: Value, activation: str) -> None:
        """A layer of that name, which others may have read before it was there."""
        self._layer(name, value.bias, value.weights, activation)

    # -- functions ---------------------------------------------------------------------------------------------------

    def rectified(self, value: Value, slope: Number = 0.0, hint: str = "relu") -> Value:
        """The value where it is positive, else `slope` times it."""
        return self.selected(value, value, value.times(slope), hint)

    def clipped(self, value: Value, low: Number | None, high: Number | None, hint: str = "clip") -> Value:
        """Limited on one side or on both, to numbers or arrays of them."""
        if low is not None and high is not None:
            if not np.all(np.greater(high, low)):
                raise InputError(f"{hint}: limits {low} and {high}; the lower one comes first")
            if np.max(high - low) <= WIDE:
                unit = value.plus(constant(np.negative(low))).times(1.0 / (high - low))
                return self.activated(unit, "satlin", hint).times(high - low).plus(constant(low))
        for end, sign in ((low, 1.0), (high, -1.0)):
            if end is not None:
                inside = value.plus(constant(np.negative(end))).times(sign)
                value = value.plus(constant(np.zeros(np.shape(end))))
                value = self.selected(inside, value, constant(np.broadcast_to(end, value.shape)), hint)
        return value

    def product(self, a: Value, b: Value, hint: str = "product") -> Value:
        """Two signals multiplied, element by element, with NumPy's broadcasting."""
        if (factor := b.constant) is not None:
            return a.times(factor)
        if (factor := a.constant) is not None:
            return b.times(factor)
        shape, name = np.broadcast_shapes(a.shape, b.shape), self._free(hint)
        two = joined([v.moved(lambda i: np.broadcast_to(i, shape).ravel()) for v in (a, b)], 0)
        self._layer(name, two.bias, two.weights, "product")
        size = int(np.prod(shape))
        return Value(shape, np.zeros(size), {(name, 0): np.eye(size)})

    def bilinear(self, a: Value, of: Callable[[np.ndarray], Value], hint: str) -> Value:
        """What is linear in a signal and in another: of(e) is the result where the first is a unit vector e."""
        total: Value | None = None
        for k, unit in enumerate(np.eye(a.size)):
            part = of(unit)
            read = np.any([np.any(w, 1) for w in (part.bias[:, None], *part.weights.values())], 0)
            at = np.flatnonzero(read)
            product = self.product(a.rows(np.full(len(at), k)), part.moved(np.ravel).rows(at), hint)
            places = np.zeros(part.size, int)
            places[at] = 1 + np.arange(len(at))
            wide = joined([constant(np.zeros(1)), product], 0).rows(places.reshape(part.shape))
            total = wide if total is None else total.plus(wide)
        return constant(0.0) if total is None else total

    def matmul(self, a: Value, b: Value, hint: str) -> Value:
        """As NumPy's; of two signals a sum of products."""
        if a.constant is not None or b.constant is not None:
            return matmul(a, b)
        one = a.moved(lambda i: i[..., None])  # (..., n, k, 1)
        other = b.moved(lambda i: i[:, None] if i.ndim == 1 else i[..., None, :, :])  # (..., 1, k, m)
        found = self.product(one, other, hint).summed([-2])
        return found.moved(lambda i: i[..., 0]) if len(b.shape) == 1 else found

    def power(self, value: Value, exponent: int, hint: str = "power") -> Value:
        """Multiplied by itself so many times, 0 or more."""
        if exponent == 0:
            return constant(np.ones(value.shape))
        half = self.power(value, exponent // 2, hint) if exponent > 1 else value
        even = self.product(half, half, hint) if exponent > 1 else value
        return self.product(value, even, hint) if exponent > 1 and exponent % 2 else even

    # -- recurrent cells ---------------------------------------------------------------------------------------------

    def rnn(self, x: Value, h: Value, w: Sequence[np.ndarray], act: Activate, hint: str) -> Value:
        """h = act(W_x x + b_x + W_h h + b_h). w: W_x, W_h, b_x, b_h."""
        return act(x.linear(w[0]).plus(h.linear(w[1])).plus(constant(w[2] + w[3])), hint)

    def gru(
        self,
        x: Value,
        h: Value,
        w: Sequence[np.ndarray],
        hint: str,
        after: bool = True,
        acts: Sequence[Activate] = (),
    ) -> Value:
        """Gates r, z, n in this order, as torch has them. after: the reset gate acts behind the product with W_h.

        acts: of the gates and of n; sigmoid and tanh if not given.
        """
        gate, inner_act = acts or (self.act("logsig"), self.act("tansig"))
        n = h.shape[-1]
        of_x, of_h = x.linear(w[0]).plus(constant(w[2])), h.linear(w[1]).plus(constant(w[3]))

        r, z = (gate(_part(of_x, k, n).plus(_part(of_h, k, n)), f"{hint}_{g}") for k, g in ((0, "r"), (1, "z")))
        if after:
            inner = self.product(r, _part(of_h, 2, n), f"{hint}_reset")
        else:
            reset = self.product(r, h, f"{hint}_reset")
            inner = reset.linear(w[1][2 * n :]).plus(constant(w[3][2 * n :]))
        new = inner_act(_part(of_x, 2, n).plus(inner), f"{hint}_n")
        kept = self.product(z, h.plus(new.times(-1.0)), f"{hint}_update")
        return self.activated(new.plus(kept), "linear", f"{hint}_h")

    def lstm(
        self,
        x: Value,
        h: Value,
        c: Value,
        w: Sequence[np.ndarray],
        hint: str,
        acts: Sequence[Activate] = (),
        peep: Sequence[np.ndarray] | None = None,
        coupled: bool = False,
    ) -> tuple[Value, Value]:
        """(h, c); gates i, f, g, o in this order, as torch has them.

        acts: of the gates, of g and of c; sigmoid, tanh and tanh if not given. peep: weights of c in i, o and f.
        coupled: f is 1 - i.
        """
        gate, entering, leaving = acts or (self.act("logsig"), self.act("tansig"), self.act("tansig"))
        n = c.shape[-1]
        total = x.linear(w[0]).plus(h.linear(w[1])).plus(constant(w[2] + w[3]))
        of_i, of_f, of_g, of_o = (_part(total, k, n) for k in range(4))
        seen = [constant(np.zeros(n))] * 2 if peep is None else [c.times(peep[k]) for k in (0, 2)]
        i = gate(of_i.plus(seen[0]), f"{hint}_i")
        f = i.times(-1.0).plus(constant(1.0)) if coupled else gate(of_f.plus(seen[1]), f"{hint}_f")
        kept = self.product(f, c, f"{hint}_kept")
        added = self.product(i, entering(of_g, f"{hint}_g"), f"{hint}_added")
        cell = self.activated(kept.plus(added), "linear", f"{hint}_c")
        o = gate(of_o if peep is None else of_o.plus(cell.times(peep[1])), f"{hint}_o")
        return self.product(o, leaving(cell, f"{hint}_tanh"), f"{hint}_shown"), cell

    def act(self, kind: str) -> Activate:
        """The activation of that name, or relu."""
        if kind == "relu":
            return lambda x, hint: self.rectified(x, 0.0, hint)
        return lambda x, hint: self.activated(x, kind, hint)

    # -- the end -----------------------------------------------------------------------------------------------------

    def output(self, ports: Sequence[Port], value: Value) -> None:
        """The ports of an output tensor, in their units, side by side."""
        if value.size != sum(p.size for p in ports):
            names = ", ".join(p.name for p in ports)
            raise InputError(
                f"outputs {names}: the model gives {list(value.shape)}, {value.size} numbers; name one port each"
            )
        start = 0
        for p in ports:
            part = value.rows(start + np.arange(p.size))
            inside = part.plus(constant(-p.offset)).times(1.0 / p.scale)
            name = self._free(f"{p.name}_sum")
            self._layer(name, inside.bias, inside.weights, "linear", np.full(p.size, p.rest))
            self.network.connect(name, p.name)
            start += p.size

    def finished(self) -> Network:
        """The network, checked. Raises InputError for a state that nothing feeds."""
        return self.network.check()

    def _layer(
        self,
        name: str,
        bias: np.ndarray,
        weights: Mapping[Signal, np.ndarray],
        activation: str,
        initial: np.ndarray | float = 0.0,
    ) -> None:
        """Add a layer that reads the signals; one that reads none would be a constant, and reads 0 times an input."""
        if not weights:
            first = self.inputs[0]
            weights = {(first.name, 0): np.zeros((len(bias), first.size))}
        ports = {}
        for k, signal in enumerate(weights):
            inner = re.sub(r"\W", "_", f"{signal[0]}_z{signal[1]}" if signal[1] else signal[0])
            ports[signal] = inner if len(name) + len(inner) < LONGEST_NAME else f"from_{k}"
        layer = Layer({ports[s]: w for s, w in weights.items()}, bias, activation, initial)
        if name not in self._initial:
            self._made[name] = Value((len(bias),), bias, weights), activation
        self.network.modules[name] = layer
        for (source, delay), inner in ports.items():
            self.network.connect(source, f"{name}.{inner}", delay)

    def _free(self, hint: str) -> str:
        """A name for a layer, made from a hint."""
        plain = word(hint) or "layer"
        plain = plain if "_" in plain else f"{plain}_layer"  # so it is no keyword of a target's language
        taken = {*self.network.modules, *(p.name for p in (*self.inputs, *self.outputs))}
        plain = plain[:60].rstrip("_")
        name, k = plain, 2
        while name in taken:
            name, k = f"{plain}_{k}", k + 1
        return name


def _times(w: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """w * bound, and 0 where w is 0 even if the bound is infinite."""
    with np.errstate(invalid="ignore"):
        return np.where((w == 0) | (bound == 0), 0.0, w * bound)


def _multiple(one: Value, other: Value) -> np.ndarray:
    """The number of each element by which `one` is `other`; 0 where it is no multiple."""
    both = joined([v.moved(np.ravel) for v in (one, other)], 0)
    a, b = np.split(np.hstack([both.bias[:, None], *both.weights.values()]), 2)
    power = (b * b).sum(1)
    factor = (a * b).sum(1) / np.where(power, power, 1.0)
    same = np.abs(a - factor[:, None] * b).max(1) <= SAME * np.abs(a).max(1)
    return np.where(same, factor, 0.0)


def _part(value: Value, k: int, n: int) -> Value:
    """The k-th n elements of the last axis."""
    return value.moved(lambda i: i[..., k * n : (k + 1) * n])


def matmul(a: Value, b: Value) -> Value:
    """As NumPy's, where one of them is constant."""
    for matrix in (a.constant, b.constant):
        if matrix is not None and matrix.size > int(np.prod(matrix.shape[-2:])):
            raise InputError(
                f"several matrices at once, {list(matrix.shape)}, are not carried; write one product for each"
            )
    if (matrix := b.constant) is not None:
        matrix = matrix.reshape(matrix.shape[-2:])
        out = a.linear(np.atleast_2d(matrix.T))
        return out if matrix.ndim > 1 else out.moved(lambda i: i[..., 0])
    matrix = a.constant
    assert matrix is not None, "one of them is constant"
    if len(b.shape) == 1:
        return b.linear(np.atleast_2d(matrix))
    turned = b.moved(lambda i: np.swapaxes(i, -1, -2))
    return turned.linear(matrix).moved(lambda i: np.swapaxes(i, -1, -2))


def taken(x: Value, places: Sequence[int] | np.ndarray | int, axis: int) -> Value:
    """As np.take."""
    return x.moved(lambda i: np.take(i, places, axis))


def port(given: Port | str) -> Port:
    """The port of a text such as "u [V]" or "u". Raises InputError for a name or a unit that no port can have."""
    if isinstance(given, Port):
        return given
    if not isinstance(given, str):
        raise InputError(f"port {shown(given)}: give a Port, or a name and its unit, such as 'p_a [Pa]'")
    if (found := _NAMED.fullmatch(given)) is None:
        raise InputError(f"port {shown(given)}: write a name and its unit, such as 'p_a [Pa]'")
    return Port(check_path(found[1], "port"), check_unit((found[2] or "1").strip(), f"port {found[1]}: unit"))
