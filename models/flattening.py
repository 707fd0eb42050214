"""Flattening: a network of networks becomes one of layers only, and every name, shape and number is checked."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from numbers import Integral, Real
from typing import NoReturn, Protocol

import numpy as np

from greygate.errors import InputError, shown
from greygate.models.arithmetic import product
from greygate.models.layer import LARGEST_SIZE, LONGEST_DELAY, Connection, Layer, Port
from greygate.names import check_name, check_path, check_unit

Feed = tuple[str, int]  # a source, and how many steps late it is read


class Nested(Protocol):
    """What is read here of a `models.network.Network`, whose file stands above this one."""

    name: str
    inputs: list[Port]
    outputs: list[Port]
    connections: list[Connection]
    dt: float | None

    @property
    def modules(self) -> "Mapping[str, Layer | Nested]": ...


class Flattener:
    """Turns nested modules into layers: every port becomes a linear junction, then plain junctions are bypassed."""

    def __init__(self, network: Nested):
        self.top = network
        self.layers: dict[str, Layer] = {}
        self.feeds: dict[str, list[tuple[str, int, np.ndarray | None]]] = {}
        self.size: dict[str, int] = {}  # of each module and port of a network
        self.columns: dict[str, int] = {}  # of each port of a layer
        self.where = f"network {check_name(network.name, 'network')}:"
        self._collect(network, "")
        self._check_fed()

    def fail(self, message: str) -> NoReturn:
        raise InputError(f"{self.where} {message}")

    def _declare(self, sizes: dict[str, int], path: str, size: int, what: str) -> None:
        """Note the size of a signal, or of a layer's port, under a name of its own."""
        check_path(path, f"{self.where} {what}")
        if path in sizes:
            self.fail(f"the name {path} is used twice; rename one")
        if not isinstance(size, Integral) or not 1 <= size <= LARGEST_SIZE:
            self.fail(f"{what} {path}: its size {shown(size)} is not a whole number >= 1 and <= {LARGEST_SIZE}")
        sizes[path] = int(size)

    def wide(self, target: str) -> int:
        """Size of a connection's target. A layer's port may have the name of the module that feeds it."""
        return self.columns.get(target) or self.size[target]

    def _collect(self, network: Nested, prefix: str) -> None:
        dt = network.dt
        if dt is not None and not (isinstance(dt, Real) and math.isfinite(dt) and dt > 0):
            self.fail(f"{prefix}dt {shown(dt)} is no sample time; give seconds above 0")
        for port in network.inputs + network.outputs:
            self._port(port, prefix)
        for name, module in network.modules.items():
            path = prefix + check_path(name, f"{self.where} module name")
            if "__" in name:
                self.fail(f"module name {name!r}: use letters, digits and single underscores")
            if not isinstance(module, Layer):
                check_name(module.name, f"{self.where} module {path}: name")
                check_path(path, f"{self.where} module")  # it grows as modules nest, which bounds their depth
                self._collect(module, path + ".")
            else:
                self._layer(module, path)
        for connection in network.connections:
            self._connect(connection, network, prefix)

    def _port(self, port: Port, prefix: str) -> None:
        path = prefix + check_path(port.name, f"{self.where} port")
        self._declare(self.size, path, port.size, "port")
        check_unit(port.unit, f"{self.where} port {path}: unit")
        numbers = (port.scale, port.offset, port.initial, port.resolution)
        real = all(isinstance(v, Real) and math.isfinite(v) for v in numbers)
        if not real or port.scale == 0 or port.resolution < 0:
            self.fail(f"port {path}: scale, offset, initial, resolution must be finite, scale not 0")

    def _layer(self, layer: Layer, path: str) -> None:
        if layer.rows % layer.function.rows:
            per_neuron = f"it needs {layer.function.rows} for each neuron"
            self.fail(f"layer {path}: {layer.activation} has {layer.rows} rows; {per_neuron}")
        self._declare(self.size, path, layer.size, "layer")
        for port, w in layer.weights.items():
            if "." in check_path(port, f"{self.where} layer {path}: port") or port == "bias":
                self.fail(f"layer {path}: a port cannot be called {port}; use letters, digits and _, not bias")
            self._declare(self.columns, f"{path}.{port}", w.shape[1], "port")
        for port, w in (*layer.weights.items(), ("bias", layer.bias), ("initial", layer.initial)):
            rows = layer.size if port == "initial" else layer.rows
            if len(w) != rows:
                self.fail(f"layer {path}: {port} has {len(w)} rows where the layer has {rows}")
            if not np.isfinite(w).all():
                self.fail(f"layer {path}: {port} holds NaN or inf; train it again or mend the file")
        for port in layer.frozen - {"bias", *layer.weights}:
            self.fail(f"layer {path}: cannot freeze {port}, there is no such port")
        self.layers[path] = layer

    def _connect(self, c: Connection, network: Nested, prefix: str) -> None:
        called = f"connection {check_path(c.source, f'{self.where} connection from')} -> "
        called += check_path(c.target, f"{self.where} connection to")
        source = self._resolve(network, prefix, c.source, True)
        target = self._resolve(network, prefix, c.target, False)
        if not isinstance(c.delay, Real) or not 0 <= c.delay <= LONGEST_DELAY or c.delay != int(c.delay):
            self.fail(f"{called}: delay {shown(c.delay)} is not a whole number >= 0 and <= {LONGEST_DELAY}")
        gain = None
        if c.gain is not None:
            gain = np.atleast_2d(np.asarray(c.gain, float))
            if gain.size == 1 and self.wide(target) == self.size[source]:
                gain = float(gain[0, 0]) * np.eye(self.wide(target))
            if not np.isfinite(gain).all():
                self.fail(f"{called}: gain holds NaN or inf")
        have = (self.wide(target), self.size[source]) if gain is None else gain.shape
        if have != (self.wide(target), self.size[source]) or (gain is None and have[0] != have[1]):
            self.fail(
                f"{called}: {self.size[source]} signals into {self.wide(target)}"
                + (f" with a gain of {gain.shape}" if gain is not None else "; give a gain matrix")
            )
        self.feeds.setdefault(target, []).append((source, int(c.delay), gain))

    def _resolve(self, network: Nested, prefix: str, name: str, is_source: bool) -> str:
        ports = network.inputs if is_source else network.outputs
        if name in {p.name for p in ports}:
            return prefix + name
        is_module = name in network.modules and is_source
        module_name, port = (name, "") if is_module or "." not in name else name.rpartition(".")[::2]
        module = network.modules.get(module_name)
        if module is None:
            self.fail(f"connection names {prefix}{name}, which is neither a module nor a port here")
        if isinstance(module, Layer):
            if is_source and not port:
                return prefix + name
            if not is_source and port in module.weights:
                return prefix + name
        else:
            choices = [p.name for p in (module.outputs if is_source else module.inputs)]
            if not port and len(choices) == 1:
                return f"{prefix}{name}.{choices[0]}"
            if port in choices:
                return prefix + name
        self.fail(f"connection names {prefix}{name}: module {module_name} has no such port")

    def _check_fed(self) -> None:
        for target in [f"{n}.{p}" for n, layer in self.layers.items() for p in layer.weights]:
            if target not in self.feeds:
                self.fail(f"port {target} receives nothing; connect it or remove it")
        for port in self.top.outputs:
            if port.name not in self.feeds:
                self.fail(f"output {port.name} receives nothing; connect it")

    def _normalisations(self, network: Nested, prefix: str) -> Iterator[tuple[str, float, float]]:
        for name, module in network.modules.items():
            if not isinstance(module, Layer):
                path = f"{prefix}{name}."
                for p in module.inputs:
                    yield path + p.name, 1 / p.scale, -p.offset / p.scale
                for p in module.outputs:
                    yield path + p.name, p.scale, p.offset
                yield from self._normalisations(module, path)

    def flat(self) -> tuple[dict[str, Layer], list[Connection]]:
        """Modules and connections of the flat network."""
        modules, plain, connections = self._joined()
        connections |= {f"{n}.{p}": plain[f"{n}.{p}"] for n, layer in self.layers.items() for p in layer.weights}
        connections |= {port.name: plain[port.name] for port in self.top.outputs}
        traced = {target: self._traced(*feed, plain, modules) for target, feed in connections.items()}
        for target, (source, delay) in traced.items():
            if delay > LONGEST_DELAY:
                self.fail(f"{target} reads {source} {delay} steps late in all; make it at most {LONGEST_DELAY}")
        return modules, [Connection(source, target, delay) for target, (source, delay) in traced.items()]

    def _joined(self) -> tuple[dict[str, Layer], dict[str, Feed], dict[str, Feed]]:
        """All layers, including junctions; the feed that each plain port passes on; and the feeds of the junctions."""
        norm = {path: (a, b) for path, a, b in self._normalisations(self.top, "")}
        top_inputs, top_outputs = {p.name for p in self.top.inputs}, {p.name for p in self.top.outputs}
        modules = dict(self.layers)
        plain: dict[str, Feed] = {}
        connections: dict[str, Feed] = {}
        for target, feeds in self.feeds.items():
            a, b = norm.get(target, (1.0, 0.0))
            source, delay, gain = feeds[0]
            alone = len(feeds) == 1 and gain is None and (a, b) == (1.0, 0.0)
            if alone and not (target in top_outputs and (delay or source in top_inputs)):
                plain[target] = (source, delay)
                continue
            junction = target if target not in top_outputs else f"{target}_out"
            if junction in modules:
                self.fail(f"module {junction}: the sum at output {target} needs this name; rename it")
            weights = {}
            for i, (source, delay, gain) in enumerate(feeds):
                weights[f"in{i}"] = a * (np.eye(self.wide(target)) if gain is None else gain)
                connections[f"{junction}.in{i}"] = (source, delay)
            bias = np.full(self.wide(target), b)
            modules[junction] = Layer(weights, bias, frozen=frozenset(weights) | {"bias"})
            plain[target] = (junction, 0)
        for path in norm:
            if path not in self.feeds:
                self.fail(f"port {path} receives nothing; connect it")
        return modules, plain, connections

    def _traced(self, source: str, delay: int, plain: dict[str, Feed], modules: dict[str, Layer]) -> Feed:
        """The layer or input that a signal comes from through plain ports, and how late in all."""
        seen: set[str] = set()
        while source in plain and source not in modules:
            if source in seen:
                self.fail(f"a loop without a layer through {source}")
            seen.add(source)
            source, extra = plain[source]
            delay += extra
        return source, delay

    def started(
        self, layers: Mapping[str, Layer], rest: Mapping[str, np.ndarray], feeds: Mapping[str, Feed]
    ) -> dict[str, Layer]:
        """The layers, in order of evaluation, each junction with the output before step 0 that its sources give it."""
        found, start = dict(layers), dict(rest)
        for name, layer in layers.items():
            if name not in self.layers:
                parts = (product(w, start[feeds[f"{name}.{p}"][0]]) for p, w in layer.weights.items())
                found[name] = replace(layer, initial=layer.bias + sum(parts))
                start[name] = found[name].initial
        return found
