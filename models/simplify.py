"""Architecture simplification: a structured network becomes a generic one that computes the same (thesis 3.3)."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from greygate.models.arithmetic import product, xp
from greygate.models.network import Connection, Layer, Network


class Graph:
    """A flat network in a form for rewriting: layers by name, and the source of each port."""

    def __init__(self, flat: Network):
        self.flat = flat
        self.layers = flat.layers()
        self.feeds = flat.feeds()

    def sources(self, name: str) -> dict[str, tuple[str, int]]:
        """port -> (source, delay) of one layer."""
        return {p: self.feeds[f"{name}.{p}"] for p in self.layers[name].weights}

    def readers(self, name: str) -> list[tuple[str, str, int]]:
        """(layer, port, delay) of every read of a signal by a layer."""
        return [(n, p, d) for n in self.layers for p, (s, d) in self.sources(n).items() if s == name]

    def shown(self) -> set[str]:
        return {self.feeds[p.name][0] for p in self.flat.outputs}

    def drop(self, name: str) -> None:
        for port in self.layers.pop(name).weights:
            del self.feeds[f"{name}.{port}"]

    def rewrite(self, name: str, terms: list[tuple[str, int, np.ndarray, bool]], bias: np.ndarray) -> None:
        """Give a layer new terms (source, delay, weights, frozen); terms on one source and delay become one port."""
        layer = self.layers[name]
        for port in layer.weights:
            del self.feeds[f"{name}.{port}"]
        merged: dict[tuple[str, int], tuple[np.ndarray, bool]] = {}
        for source, delay, w, frozen in terms:
            before, still = merged.get((source, delay), (0.0, True))
            merged[source, delay] = (before + w, still and frozen)
        weights, frozen_ports = {}, set(layer.frozen & {"bias"})
        for (source, delay), (w, frozen) in merged.items():
            port = source.replace(".", "_") + (f"_z{delay}" if delay else "")
            weights[port] = w
            self.feeds[f"{name}.{port}"] = (source, delay)
            if frozen:
                frozen_ports.add(port)
        self.layers[name] = replace(layer, weights=weights, bias=bias, frozen=frozenset(frozen_ports))

    def terms(self, name: str) -> list[tuple[str, int, np.ndarray, bool]]:
        layer = self.layers[name]
        return [(s, d, layer.weights[p], p in layer.frozen) for p, (s, d) in self.sources(name).items()]

    def network(self) -> Network:
        connections = [Connection(s, target, d) for target, (s, d) in self.feeds.items()]
        flat = replace(self.flat, modules={**self.layers}, connections=connections)
        flat.modules = {n: self.layers[n] for n in flat.order()}
        return flat.check()


def multiplications(network: Network) -> int:
    """Number of weights that need a multiplier: all except 0, 1 and -1."""
    return sum(_cost(w) for layer in network.flatten().layers().values() for w in layer.weights.values())


def parameter_count(network: Network) -> int:
    """Number of parameters of a network: weights and biases that are not zero."""
    return sum(int(np.count_nonzero(v)) for v in network.parameters().values())


def _cost(w: np.ndarray) -> int:
    return int(np.count_nonzero((w != 0) & (np.abs(w) != 1)))


def merge_linear(network: Network, always: bool = False) -> Network:
    """Multiply linear layers into the weights of those that read them, gains and normalisations included.

    A layer is merged if that costs no further multiplication (a bottleneck such as 10 -> 1 -> 20 neurons stays). With
    `always`, it is merged wherever that is possible. A sum that a product reads as it is stays one.
    """
    g = Graph(network.flatten())
    changed = True
    while changed:
        changed = False
        for name in list(g.layers):
            layer, readers = g.layers[name], g.readers(name)
            if not layer.is_linear or name in g.shown() or any(r == name for r, _, _ in readers) or not readers:
                continue
            start = g.flat.rest() | {n: part.initial for n, part in g.layers.items()}
            before = layer.bias + sum(product(w, start[s]) for s, _, w, _ in g.terms(name))
            if any(d for _, _, d in readers) and not np.allclose(before, layer.initial, rtol=0, atol=1e-15):
                continue
            if not _copies(layer) and _multiplied(g, name):
                continue
            inner = g.terms(name)
            now = sum(_cost(w) for _, _, w, _ in inner) + sum(_cost(g.layers[r].weights[p]) for r, p, _ in readers)
            then = sum(_cost(product(g.layers[r].weights[p], w)) for r, p, _ in readers for _, _, w, _ in inner)
            if then > now and not always:
                continue
            for reader in {r for r, _, _ in readers}:
                terms, bias = [], g.layers[reader].bias
                for s, d, w, frozen in g.terms(reader):
                    if s != name:
                        terms.append((s, d, w, frozen))
                        continue
                    bias = bias + product(w, layer.bias)
                    terms += [(s2, d + d2, product(w, w2), frozen and frozen2) for s2, d2, w2, frozen2 in inner]
                g.rewrite(reader, terms, bias)
            g.drop(name)
            changed = True
    return g.network()


def _copies(layer: Layer, rows: np.ndarray | slice = slice(None)) -> str:
    """The port that rows of a layer are, element by element; "" if they are a sum."""
    read = [(p, w[rows]) for p, w in layer.weights.items() if w[rows].any()]
    plain = len(read) == 1 and not layer.bias[rows].any() and np.array_equal(read[0][1], np.eye(layer.size))
    return read[0][0] if plain else ""


def _multiplied(g: Graph, name: str) -> bool:
    """Whether a product reads the signal as it is, or a copy of it."""
    for reader, port, _ in g.readers(name):
        layer = g.layers[reader]
        if layer.activation == "product" and port in [_copies(layer, rows) for rows in _rows(layer)]:
            return True
        if layer.is_linear and reader != name and _copies(layer) == port and _multiplied(g, reader):
            return True
    return False


def fold_constants(network: Network) -> Network:
    """Add neurons with a constant output to the biases of the layers that read them, and drop terms that are zero."""
    g = Graph(network.flatten())
    order, changed = g.flat.order(), True
    while changed:
        changed = False
        for name in order:
            layer, readers = g.layers[name], g.readers(name)
            value = layer.function.value(xp, layer.bias)
            moved = np.any([np.zeros(layer.rows, bool), *(w.any(axis=1) for w in layer.weights.values())], axis=0)
            constant = ~moved[_rows(layer)].any(axis=0)
            if any(delay for _, _, delay in readers):
                constant &= value == layer.initial
            for reader, port, _ in readers:
                target = g.layers[reader]
                w = target.weights[port]
                gone = constant & w.any(axis=0)
                if gone.any():
                    changed = True
                    weights = target.weights | {port: np.where(gone, 0.0, w)}
                    bias = target.bias + product(w[:, gone], value[gone])
                    g.layers[reader] = replace(target, weights=weights, bias=bias)
    return remove_dead(g.network())


def remove_dead(network: Network) -> Network:
    """Remove neurons that no output depends on, and terms that are zero."""
    g = Graph(network.flatten())
    alive = {n: np.full(layer.size, n in g.shown()) for n, layer in g.layers.items()}
    waiting = [n for n in g.layers if n in g.shown()]
    while waiting:
        name = waiting.pop()
        rows = _rows(g.layers[name])[:, alive[name]].ravel()
        for port, (source, _) in g.sources(name).items():
            read = g.layers[name].weights[port][rows].any(axis=0)
            if source in alive and (read & ~alive[source]).any():
                alive[source] = alive[source] | read
                waiting.append(source)
    for name, layer in list(g.layers.items()):
        if not alive[name].any():
            g.drop(name)
            continue
        rows, weights = _rows(layer)[:, alive[name]].ravel(), {}
        for port, (source, _) in g.sources(name).items():
            w = layer.weights[port][rows]
            weights[port] = w[:, alive[source]] if source in alive else w
            if not w.any():
                del weights[port], g.feeds[f"{name}.{port}"]
        g.layers[name] = replace(
            layer,
            weights=weights,
            bias=layer.bias[rows],
            initial=layer.initial[alive[name]],
            frozen=layer.frozen & {"bias", *weights},
        )
    return g.network()


def _rows(layer: Layer) -> np.ndarray:
    """(rows per neuron, neurons): the rows of each neuron's sums, of which most neurons have one."""
    return np.arange(layer.rows).reshape(-1, layer.size)


def share_equal(network: Network) -> Network:
    """Replace layers that compute the same from the same sources by one layer."""
    g = Graph(network.flatten())
    seen: dict[tuple, str] = {}
    for name in g.flat.order():
        layer = g.layers[name]
        terms = sorted((s, d, w.tobytes()) for s, d, w, _ in g.terms(name))
        key = (layer.activation, layer.bias.tobytes(), layer.initial.tobytes(), tuple(terms))
        first = seen.setdefault(key, name)
        if first == name or name in g.shown():
            continue
        for target, (source, delay) in list(g.feeds.items()):
            if source == name:
                g.feeds[target] = (first, delay)
        g.drop(name)
        for reader in {r for r, _, _ in g.readers(first)}:
            g.rewrite(reader, g.terms(reader), g.layers[reader].bias)
    return g.network()


SIMPLIFICATIONS: tuple[Callable[[Network], Network], ...] = (remove_dead, fold_constants, merge_linear, share_equal)


def simplify(network: Network) -> Network:
    """Make the generic network: apply every simplification in order."""
    for rewrite in SIMPLIFICATIONS:
        network = rewrite(network)
    return network
