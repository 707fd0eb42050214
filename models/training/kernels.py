"""Forward run and exact forward sensitivities of any flat network, as two numba kernels that walk arrays.

The arrays (`Tables`) are the flat network and nothing more, so a changed network compiles nothing anew. Derivatives are
taken back through one step (reverse mode: few signals are carried over) and forward over the steps: with rows r for the
signals that are read with a delay or shown, `S_k[r] = dr/dtheta + sum_(d, q) c[d, r, q] S_(k-d)[q]`.
"""

import hashlib
import sys
from collections.abc import Callable, Mapping, Sequence
from inspect import getfile, signature
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np

from greygate.models import activations, scalars
from greygate.models.activations import ACTIVATIONS
from greygate.models.network import Layer, Network

KINDS = tuple(ACTIVATIONS)  # a layer's activation stands in `Tables.layers` as its place here
SELECT, PRODUCT = KINDS.index("select"), KINDS.index("product")
LANES = 32  # steps that are taken back at once: what a step costs beside its arithmetic is shared by so many
_SLOPE_READS_N = np.array([a.slope_reads_n for a in ACTIVATIONS.values()])  # by kind
_SOURCES = (activations, scalars, sys.modules[__name__])
_TEXT = hashlib.sha256(b"".join(Path(getfile(module)).read_bytes() for module in _SOURCES)).hexdigest()[:12]


def kernel(**options) -> Callable[[Callable], Callable]:
    """`numba.njit(**options)`, kept on disk under a name that changes with all that kernels inline from other files.

    Numba itself looks only at the file in which a function stands, and would go on with activations as they were. And
    it gives a function the arithmetic of whatever calls it first, but for one that says its own.
    """
    options = {"fastmath": False, **options}

    def compiled(function: Callable) -> Callable:
        function.__qualname__ += f"_{_TEXT}"
        return numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)

    return compiled


called = numba.njit(nogil=True, error_model="numpy", fastmath=False, forceinline=True)
"""Put in by LLVM: numba itself took half a minute for that."""


def _value_of(function: Callable) -> Callable:
    """A compiled function of a layer, by `function` of (scalars, n), in a loop that can be vectorized."""
    function = scalars.inlined(function)

    @called
    def values(kind, now, k, first, size):  # pragma: no cover - compiled
        for o in range(first, first + size):
            now[k, o] = function(scalars, now[k, o])

    return values


def _slope_of(function: Callable) -> Callable:
    """The same for the slopes, of (scalars, y) or (scalars, y, n)."""
    function, takes = scalars.inlined(function), len(signature(function).parameters)

    @called
    def of_y(kind, signals, sums, slopes):  # pragma: no cover - compiled
        for o in range(len(signals)):
            slopes[o] = function(scalars, signals[o])

    @called
    def of_both(kind, signals, sums, slopes):  # pragma: no cover - compiled
        for o in range(len(signals)):
            slopes[o] = function(scalars, signals[o], sums[o])

    return of_y if takes == 2 else of_both


def _values_of(a: int, b: int, c: int, one: Callable, two: Callable, three: Callable, four: Callable) -> Callable:
    """One function of four: of kinds below a, below b, below c, and of the rest."""

    @called
    def values(kind, now, k, first, size):  # pragma: no cover - compiled
        if kind < a:
            one(kind, now, k, first, size)
        elif kind < b:
            two(kind, now, k, first, size)
        elif kind < c:
            three(kind, now, k, first, size)
        else:
            four(kind, now, k, first, size)

    return values


def _slopes_of(a: int, b: int, c: int, one: Callable, two: Callable, three: Callable, four: Callable) -> Callable:
    @called
    def slopes_of(kind, signals, sums, slopes):  # pragma: no cover - compiled
        if kind < a:
            one(kind, signals, sums, slopes)
        elif kind < b:
            two(kind, signals, sums, slopes)
        elif kind < c:
            three(kind, signals, sums, slopes)
        else:
            four(kind, signals, sums, slopes)

    return slopes_of


def _chosen(parts: Sequence[Callable], none: Callable, of: Callable[..., Callable], first: int = 0) -> Callable:
    """One function of those of each kind, from `first` on, by quarters.

    none: where no kind is left.
    """
    if len(parts) < 2:
        return parts[0] if parts else none
    ends = [-(-len(parts) * k // 4) for k in range(5)]
    quarters = [_chosen(parts[a:b], none, of, first + a) for a, b in pairwise(ends)]
    return of(*(first + b for b in ends[1:4]), *quarters)


@called
def _no_value(kind, now, k, first, size):  # pragma: no cover - compiled
    raise ValueError("no such kind of activation")


@called
def _no_slope(kind, signals, sums, slopes):  # pragma: no cover - compiled
    raise ValueError("no such kind of activation")


_VALUES = [_no_value if k in (SELECT, PRODUCT) else _value_of(a.value) for k, a in enumerate(ACTIVATIONS.values())]
_values = _chosen([*_VALUES, _no_value], _no_value, _values_of)
"""Of (kind, signals, step, first element and size of a layer): in place, pre-activations become outputs."""
_slopes = _chosen([*(_slope_of(a.slope) for a in ACTIVATIONS.values()), _no_slope], _no_slope, _slopes_of)
"""Of (kind, signals, sums, slopes of a layer)."""


class Tables(NamedTuple):
    """A flat network as arrays. Elements: all inputs' components, then all layers' neurons in order of evaluation."""

    layers: np.ndarray  # (L, 5): first element, size, kind of activation, offset of the bias in theta, first connection
    links: np.ndarray  # (C, 4): first source element, source size, delay, offset of the matrix in theta
    n_inputs: int  # elements that are inputs
    depth: int  # longest delay
    rows: np.ndarray  # elements whose sensitivity is carried: read with a delay, or shown
    row_of: np.ndarray  # element -> row or -1
    layer_of: np.ndarray  # row -> its layer
    reaches: np.ndarray  # (R, L) bool: does layer l act on row r within a step
    spans: np.ndarray  # (R, 2): the parameters that can act on the row at all
    shown: np.ndarray  # output columns -> row


def tabulate(flat: Network, forced: frozenset[str] = frozenset()) -> tuple[Tables, list[str]]:
    """Arrays of a flat network, and the order of its parameters in theta (names as in `parameters()`).

    forced: outputs whose past is given (series-parallel training): their sensitivity is not carried.
    """
    order, feeds, layers = flat.order(), flat.feeds(), flat.layers()
    first, at = {}, 0
    for port in flat.inputs:
        first[port.name] = at
        at += port.size
    n_inputs = at
    for name in order:
        first[name] = at
        at += layers[name].size
    forced_layers = {feeds[f][0] for f in forced}
    carried = {s for s, d in feeds.values() if d > 0 and s in layers and s not in forced_layers}
    shown = [feeds[p.name][0] for p in flat.outputs]
    rows = [first[n] + i for n in order if n in carried or n in shown for i in range(layers[n].size)]
    row_of = np.full(at, -1)
    position = {n: i for i, n in enumerate(order)}
    owner = [n for n in order if n in carried or n in shown for _ in range(layers[n].size)]
    row_of[[r for r, n in zip(rows, owner, strict=True) if n in carried]] = [
        i for i, n in enumerate(owner) if n in carried
    ]
    within, ever = _acting(layers, order, feeds, forced_layers)
    reach = {n: [i for i, o in enumerate(shown) if n in ever[o]] or [0] for n in order}
    names, where = [], {}
    at_theta = 0
    for name in sorted(order, key=lambda n: sum(reach[n]) / len(reach[n])):  # what acts on one output stands together
        layer = layers[name]
        for part, size in [*((p, w.size) for p, w in layer.weights.items()), ("bias", layer.rows)]:
            names.append(f"{name}.{part}")
            where[names[-1]] = slice(at_theta, at_theta + size)
            at_theta += size
    heads: list[tuple[int, ...]] = []
    links: list[tuple[int, ...]] = []
    for name in order:
        layer = layers[name]
        heads.append((first[name], layer.size, KINDS.index(layer.activation), where[f"{name}.bias"].start, len(links)))
        for part, w in layer.weights.items():
            source, delay = feeds[f"{name}.{part}"]
            links.append((first[source], w.shape[1], delay, where[f"{name}.{part}"].start))
    heads.append((at, 0, 0, at_theta, len(links)))  # sentinel
    spans = []
    for n in owner:
        acting = [where[f"{m}.{port}"] for m in ever[n] for port in (*layers[m].weights, "bias")]
        spans.append((min(s.start for s in acting), max(s.stop for s in acting)))
    tables = Tables(
        np.array(heads, np.int64),
        np.array(links, np.int64).reshape(-1, 4),
        n_inputs,
        max((d for _, d in feeds.values()), default=0),
        np.array(rows, np.int64),
        row_of,
        np.array([position[n] for n in owner], np.int64),
        np.array([[m in within[n] for m in order] for n in owner]),
        np.array(spans, np.int64),
        np.array([rows.index(first[n] + i) for n in shown for i in range(layers[n].size)], np.int64),
    )
    return tables, names


def _acting(layers: Mapping[str, Layer], order: list[str], feeds: dict, forced: set[str]) -> tuple[dict, dict]:
    """The layers that act on each layer within a step; and within any number of steps, but not through `forced`."""
    within = {n: {n} for n in order}
    ever = {n: {n} for n in order}
    for name in order:
        for port in layers[name].weights:
            source, delay = feeds[f"{name}.{port}"]
            if delay == 0 and source in within:
                within[name] |= within[source]
    changed = True
    while changed:
        changed = False
        for name in order:
            size = len(ever[name])
            for port in layers[name].weights:
                source, delay = feeds[f"{name}.{port}"]
                if source in ever and not (delay > 0 and source in forced):
                    ever[name] |= ever[source]
            changed |= len(ever[name]) != size
    return within, ever


@kernel(inline="always")
def preactivation(links, lo, hi, theta, bias, row, k, now, past):  # pragma: no cover - compiled
    """Of one row, at row k of now and past."""
    n = theta[bias + row]
    for c in range(lo, hi):
        source, width, delay, w = links[c]
        w += row * width
        if delay == 0:
            for i in range(width):
                n += theta[w + i] * now[k, source + i]
        else:
            for i in range(width):
                n += theta[w + i] * past[k - delay, source + i]
    return n


@kernel()
def slopes_at(layers, links, theta, at, count, now, past, slopes, twins, active):  # pragma: no cover - compiled
    """For rows at to at + count - 1 of now: slopes[e, b], twins[e, b], active[e, b] (elements, LANES).

    slopes: derivative of each neuron's output by its pre-activation; active: the row of weights that acts on it. Of a
    product this is the first; twins: the derivative by the second.
    """
    y, n = np.empty(count), np.zeros(count)
    for layer in range(len(layers) - 1):
        first, size, kind, bias, lo = layers[layer]
        hi = layers[layer + 1, 4]
        for o in range(size):
            for b in range(count):
                y[b] = now[at + b, first + o]
                active[first + o, b] = o
            if kind == SELECT or _SLOPE_READS_N[kind]:
                for b in range(count):
                    n[b] = preactivation(links, lo, hi, theta, bias, o, at + b, now, past)
            if kind == SELECT:
                for b in range(count):
                    active[first + o, b] = o + (size if n[b] >= 0 else 2 * size)
            _slopes(kind, y, n, slopes[first + o, :count])
            if kind == PRODUCT:
                for b in range(count):
                    twins[first + o, b] = preactivation(links, lo, hi, theta, bias, o, at + b, now, past)
                    slopes[first + o, b] = preactivation(links, lo, hi, theta, bias, size + o, at + b, now, past)


@kernel()
def forward(layers, links, n_inputs, depth, theta, now, past, forced):  # pragma: no cover - compiled
    """Fill now[depth:, layer elements]; row depth + k is step k, rows before hold initial values.

    past: what delayed reads see, the same as `now` but for the elements in `forced`, whose measured values stand there.
    Returns the number of steps that were finite.
    """
    n_layers = len(layers) - 1
    for k in range(depth, len(now)):
        for layer in range(n_layers):
            first, size, kind, bias, lo = layers[layer]
            hi = layers[layer + 1, 4]
            for o in range(size):
                now[k, first + o] = theta[bias + o]
            for c in range(lo, hi):
                source, width, delay, w = links[c]
                if width == 1:  # one tap to all neurons: contiguous in theta
                    x = now[k, source] if delay == 0 else past[k - delay, source]
                    for o in range(size):
                        now[k, first + o] += theta[w + o] * x
                elif delay == 0:
                    for o in range(size):
                        n = now[k, first + o]
                        for i in range(width):
                            n += theta[w + o * width + i] * now[k, source + i]
                        now[k, first + o] = n
                else:
                    for o in range(size):
                        n = now[k, first + o]
                        for i in range(width):
                            n += theta[w + o * width + i] * past[k - delay, source + i]
                        now[k, first + o] = n
            if kind == SELECT:
                for o in range(size):
                    acts = o + (size if now[k, first + o] >= 0 else 2 * size)
                    now[k, first + o] = preactivation(links, lo, hi, theta, bias, acts, k, now, past)
            elif kind == PRODUCT:
                for o in range(size):
                    now[k, first + o] *= preactivation(links, lo, hi, theta, bias, size + o, k, now, past)
            else:
                _values(kind, now, k, first, size)
            for o in range(size):
                if not np.isfinite(now[k, first + o]):
                    return k - depth
        for e in range(n_inputs, now.shape[1]):
            if not forced[e]:
                past[k, e] = now[k, e]
    return len(now) - depth


@kernel(inline="always")
def _alike(spans, row, i):  # pragma: no cover - compiled
    """Whether the same parameters act on rows i to i + 3."""
    a, b = spans[row[i]]
    alike = True
    for j in range(i + 1, i + 4):
        alike &= spans[row[j], 0] == a and spans[row[j], 1] == b
    return alike


@kernel()
def _coupled(layers, links, depth, row_of, reaches):  # pragma: no cover - compiled
    """(delay, q) of every q whose past acts on row r within a step (R, most, 2), by delay, and how many (R,)."""
    n_rows, n_layers = reaches.shape
    acts = np.zeros((n_rows, depth, n_rows), np.bool_)
    for r in range(n_rows):
        for layer in range(n_layers):
            for c in range(layers[layer, 4], layers[layer + 1, 4]):
                source, width, delay, _ = links[c]
                if reaches[r, layer] and delay > 0 and row_of[source] >= 0:
                    for i in range(width):
                        acts[r, delay - 1, row_of[source + i]] = True
    pairs, count = np.zeros((n_rows, depth * n_rows, 2), np.int64), np.zeros(n_rows, np.int64)
    for r in range(n_rows):
        for delay in range(1, depth + 1):
            for q in range(n_rows):
                if acts[r, delay - 1, q]:
                    pairs[r, count[r], 0], pairs[r, count[r], 1] = delay, q
                    count[r] += 1
    return pairs, count


@kernel(inline="always")
def _carry(out, direct, carried, spans, lo, hi, n_theta, share, slot, row, count):  # pragma: no cover - compiled
    """out = direct + share[i] carried[slot[i], row[i]] for i < count, in this order; columns lo to hi and n_theta on.

    Four at a time, where one span serves.
    """
    for p in range(lo, hi):
        out[p] = direct[p]
    for p in range(n_theta, len(out)):
        out[p] = direct[p]
    i = 0
    while i < count:
        a, b = spans[row[i]]
        c0, s0 = share[i], carried[slot[i], row[i]]
        if i + 4 <= count and _alike(spans, row, i):  # `out` is read and written once for four
            c1, c2, c3 = share[i + 1], share[i + 2], share[i + 3]
            s1, s2 = carried[slot[i + 1], row[i + 1]], carried[slot[i + 2], row[i + 2]]
            s3 = carried[slot[i + 3], row[i + 3]]
            for p in range(a, b):
                out[p] = (((out[p] + c0 * s0[p]) + c1 * s1[p]) + c2 * s2[p]) + c3 * s3[p]
            for p in range(n_theta, len(out)):
                out[p] = (((out[p] + c0 * s0[p]) + c1 * s1[p]) + c2 * s2[p]) + c3 * s3[p]
            i += 4
        else:
            for p in range(a, b):
                out[p] += c0 * s0[p]
            for p in range(n_theta, len(out)):
                out[p] += c0 * s0[p]
            i += 1


@kernel(fastmath={"contract", "reassoc"})
def sensitivities(
    layers,
    links,
    n_inputs,
    depth,
    rows,
    row_of,
    layer_of,
    reaches,
    spans,
    shown,
    theta,
    now,
    past,
    carried,
    start,
    stop,
    jacobian,
):  # pragma: no cover - compiled
    """jacobian[k - start, j] = d(output j at step k)/d theta for start <= k < stop.

    carried: (depth + 1, R, P + X) ring of sensitivities, step k in slot k % (depth + 1); it passes from one call to the
    next. Before step 0 it holds zeros, but for X columns of the initial state, if that is to be estimated too.

    What acts within a step is taken back for LANES steps at once, then what earlier steps carry over is added in turn.
    """
    n_theta, n_rows = len(theta), len(rows)
    ring, lanes = depth + 1, min(LANES, stop - start)
    slopes = np.empty((now.shape[1], lanes))  # of all elements, and likewise:
    twins = np.empty((now.shape[1], lanes))  # by the second sum of a product
    active = np.zeros((now.shape[1], lanes), np.int64)  # the row of weights that acts
    adjoint = np.empty((now.shape[1], lanes))
    delta = np.empty((2 * now.shape[1], lanes))  # of a layer's neurons, and of the second sums of products
    total = np.empty(lanes)
    direct = np.zeros((lanes, n_rows, carried.shape[2]))  # d row / d theta within the step
    coupling = np.zeros((n_rows, depth, n_rows, lanes))  # c[d, r, q] of each row
    most = depth * n_rows
    share, slot, row = np.empty(most), np.empty(most, np.int64), np.empty(most, np.int64)
    pairs, coupled = _coupled(layers, links, depth, row_of, reaches)
    for k0 in range(start, stop, lanes):
        count = min(lanes, stop - k0)
        slopes_at(layers, links, theta, depth + k0, count, now, past, slopes, twins, active)
        for r in range(n_rows):
            direct[:count, r, spans[r, 0] : spans[r, 1]] = 0.0
            adjoint[: layers[layer_of[r] + 1, 0]] = 0.0
            adjoint[rows[r]] = 1.0
            for layer in range(layer_of[r], -1, -1):
                if not reaches[r, layer]:
                    continue
                first, size, kind, bias, lo = layers[layer]
                acts = False
                for o in range(size):
                    for b in range(count):
                        d = adjoint[first + o, b] * slopes[first + o, b]
                        delta[o, b] = d
                        acts |= d != 0.0
                acting = size
                if kind == PRODUCT:
                    acting = 2 * size
                    for o in range(size):
                        for b in range(count):
                            d = adjoint[first + o, b] * twins[first + o, b]
                            delta[size + o, b] = d
                            direct[b, r, bias + size + o] = d
                            acts |= d != 0.0
                if not acts:
                    continue
                for o in range(size):
                    for b in range(count):
                        direct[b, r, bias + active[first + o, b]] = delta[o, b]
                for c in range(lo, layers[layer + 1, 4]):
                    source, width, delay, w = links[c]
                    read, at = (now if delay == 0 else past), depth + k0 - delay
                    for i in range(width):
                        e = source + i
                        total[:] = 0.0
                        for o in range(acting):
                            if kind == SELECT:
                                for b in range(count):
                                    p = w + active[first + o, b] * width + i
                                    direct[b, r, p] = delta[o, b] * read[at + b, e]
                                    total[b] += delta[o, b] * theta[p]
                                continue
                            p = w + o * width + i
                            for b in range(count):
                                direct[b, r, p] = delta[o, b] * read[at + b, e]
                            for b in range(count):
                                total[b] += delta[o, b] * theta[p]
                        if delay == 0:
                            for b in range(count):
                                adjoint[e, b] += total[b]
                        elif row_of[e] >= 0:
                            for b in range(count):
                                coupling[r, delay - 1, row_of[e], b] += total[b]
        for b in range(count):
            k = k0 + b
            for r in range(n_rows):
                held = 0
                for i in range(coupled[r]):
                    delay, q = pairs[r, i]
                    if coupling[r, delay - 1, q, b] != 0.0:
                        share[held], slot[held], row[held] = coupling[r, delay - 1, q, b], (k - delay) % ring, q
                        coupling[r, delay - 1, q, b] = 0.0
                        held += 1
                out = carried[k % ring, r]
                _carry(out, direct[b, r], carried, spans, spans[r, 0], spans[r, 1], n_theta, share, slot, row, held)
            for j in range(len(shown)):
                lo, hi = spans[shown[j]]
                jacobian[k - start, j, lo:hi] = carried[k % ring, shown[j], lo:hi]
                jacobian[k - start, j, n_theta:] = carried[k % ring, shown[j], n_theta:]


portable_sensitivities = kernel()(sensitivities.py_func)  # type: ignore[attr-defined]  # numba keeps it
"""`sensitivities` to the same bits on every processor, more slowly: no term is contracted or added in another order."""
