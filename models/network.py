"""The float network: named modules, ports, connections with delays. Declared here; training, emulation in float and
the compiler all walk it.

A `Layer` is `activation(sum over ports of W @ input + bias)`. A `Network` joins layers and other networks by
connections, each with a delay z^-d and a gain. Every loop must hold a delay of at least one step. `flatten` gives the
same network as layers alone, each port fed by exactly one signal: the form on which everything else works.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from pathlib import Path

import numpy as np
import safetensors.numpy
import tomli_w

from greygate.errors import InputError, shown
from greygate.files import read_all, replacing_all
from greygate.models.arithmetic import product
from greygate.names import check_name, check_path, check_text, check_unit
from greygate.reading import Kind, anything, array, entry_of, listed, named, number, read_toml, table, whole

LONGEST_DELAY = 500  # steps
LARGEST_SIZE = 4096  # signals of a port, neurons of a layer
# Each takes the array namespace (numpy or torch) and the pre-activation n.
ACTIVATIONS = {
    "tansig": lambda xp, n: xp.tanh(n),
    "logsig": lambda xp, n: 0.5 + 0.5 * xp.tanh(0.5 * n),
    "linear": lambda xp, n: n,
    "hardlim": lambda xp, n: xp.where(n >= 0, xp.ones_like(n), xp.zeros_like(n)),
    "hardlims": lambda xp, n: xp.where(n >= 0, xp.ones_like(n), -xp.ones_like(n)),
    "satlin": lambda xp, n: xp.clip(n, 0.0, 1.0),
    "radbas": lambda xp, n: xp.exp(-n * n),
    "square": lambda xp, n: n * n,
    "negexp": lambda xp, n: xp.exp(-abs(n)),
    "select": lambda xp, n: _select(xp, n),
}


def _select(xp, n):
    """Rows of n in three parts: where the first is not negative the second, else the third."""
    size = n.shape[-1] // 3
    return xp.where(n[..., :size] >= 0, n[..., size : 2 * size], n[..., 2 * size :])


@dataclass(frozen=True)
class Port:
    """Where a signal enters or leaves a network: inside stands (value - offset) / scale.

    value: `unit` (SI). `initial`: what the port carried before the first step, in `unit`. `resolution`: of the sensor,
    in `unit`, 0 if it is not known; the hardware's input codes are then no coarser and no finer.

    >>> u, y = Port("u", "V", scale=2.0), Port("y", "m", scale=1e-3)
    >>> u.scale  # what 2 V are inside: 1
    2.0
    """

    name: str
    unit: str = "1"
    scale: float = 1.0
    offset: float = 0.0
    size: int = 1
    initial: float = 0.0
    resolution: float = 0.0


@dataclass(frozen=True)
class Layer:
    """activation(sum_p weights[p] @ input_p + bias).

    weights: port -> (rows, n). bias: (rows,). initial: (size,), its output before the first step. A neuron is a row;
    only `select`, a multiplexer, has three rows a neuron: condition, value where it is >= 0, value else.
    frozen: names of ports (or "bias") that training leaves as they are.

    >>> memory = Layer({"u": [[0.08]], "y": [[0.9]]}, [0.0])
    >>> memory.size, memory.activation
    (1, 'linear')
    """

    weights: dict[str, np.ndarray]
    bias: np.ndarray
    activation: str = "linear"
    initial: np.ndarray | float = 0.0
    frozen: frozenset[str] = frozenset()

    def __post_init__(self):
        bias = np.atleast_1d(np.asarray(self.bias, float))
        object.__setattr__(self, "bias", bias)
        object.__setattr__(self, "weights", {p: np.atleast_2d(np.asarray(w, float)) for p, w in self.weights.items()})
        object.__setattr__(self, "initial", np.broadcast_to(np.asarray(self.initial, float), self.size))
        object.__setattr__(self, "frozen", frozenset(self.frozen))

    @property
    def rows(self) -> int:
        """Sums that it forms."""
        return len(self.bias)

    @property
    def size(self) -> int:
        """Neurons, which are its outputs."""
        return len(self.bias) // 3 if self.activation == "select" else len(self.bias)


@dataclass(frozen=True)
class Connection:
    """target(k) receives gain @ source(k - delay). Names: `port`, `module` or `module.port`.

    >>> feedback = Connection("memory", "memory.y", delay=1)
    >>> feedback.delay
    1
    """

    source: str
    target: str
    delay: int = 0
    gain: float | np.ndarray | None = None


@dataclass
class Network:
    """Modules joined by connections; itself a module of another network.

    meaning: name of the library function that it stands for (families/library.py), which the compiler may emit instead.

    >>> lag = Network("lag", [u], [y], {"memory": memory}, [feedback])
    >>> lag.connect("u", "memory.u")
    >>> lag.connect("memory", "y")
    >>> lag
    <Network lag: u [V] -> y [m]; 1 layers, 3 parameters>
    >>> lag.run({"u": np.array([2.0, 0.0])})["y"]  # m
    array([8.0e-05, 7.2e-05])
    """

    name: str
    inputs: list[Port] = field(default_factory=list)
    outputs: list[Port] = field(default_factory=list)
    modules: dict[str, "Layer | Network"] = field(default_factory=dict)
    connections: list[Connection] = field(default_factory=list)
    meaning: str = ""

    def __repr__(self) -> str:
        inputs, outputs = (", ".join(f"{p.name} [{p.unit}]" for p in ports) for ports in (self.inputs, self.outputs))
        size = sum(v.size for v in self.parameters().values())
        return f"<Network {self.name}: {inputs} -> {outputs}; {len(self.layers())} layers, {size} parameters>"

    # ---- building

    def add(self, name: str, module: "Layer | Network") -> None:
        """Add a module. Raises InputError if the name is taken."""
        if name in self.modules or name in {p.name for p in self.inputs + self.outputs}:
            raise InputError(f"network {self.name}: the name {name} is used twice; rename one")
        self.modules[name] = module

    def connect(self, source: str, target: str, delay: int = 0, gain: float | np.ndarray | None = None) -> None:
        """Let `target` receive gain @ source(k - delay); several connections to one port add up."""
        self.connections.append(Connection(source, target, delay, gain))

    def port(self, name: str) -> Port:
        """The input or output of that name."""
        return next(p for p in self.inputs + self.outputs if p.name == name)

    # ---- walking

    def layers(self) -> dict[str, Layer]:
        """Every layer by its path, `module.module.layer`."""
        found = {}
        for name, module in self.modules.items():
            if isinstance(module, Layer):
                found[name] = module
            else:
                found |= {f"{name}.{path}": layer for path, layer in module.layers().items()}
        return found

    def parameters(self) -> dict[str, np.ndarray]:
        """Every weight matrix `layer.port` and bias `layer.bias`."""
        return {
            f"{path}.{port}": w
            for path, layer in self.layers().items()
            for port, w in (*layer.weights.items(), ("bias", layer.bias))
        }

    def with_parameters(self, values: Mapping[str, np.ndarray]) -> "Network":
        """The same network with other values for the parameters named."""

        def rebuilt(network, prefix):
            modules = {}
            for name, module in network.modules.items():
                path = f"{prefix}{name}"
                if isinstance(module, Network):
                    modules[name] = rebuilt(module, path + ".")
                    continue
                weights = {p: values.get(f"{path}.{p}", w) for p, w in module.weights.items()}
                modules[name] = replace(module, weights=weights, bias=values.get(f"{path}.bias", module.bias))
            return replace(network, modules=modules)

        return rebuilt(self, "").check()

    def order(self) -> list[str]:
        """Layer names of a flat network so that each follows what it reads without delay.

        Raises InputError naming the layers of a loop that has no delay.
        """
        needs = {name: set() for name in self.modules}
        for c in self.connections:
            if c.delay == 0 and c.source in needs and "." in c.target:
                needs[c.target.rpartition(".")[0]].add(c.source)
        done: list[str] = []
        waiting = dict(needs)
        while waiting:
            ready = [n for n, deps in waiting.items() if deps.isdisjoint(waiting)]
            if not ready:
                raise InputError(
                    f"network {self.name}: a loop without delay through {' -> '.join(_loop(waiting))}; "
                    "give one of its connections delay >= 1"
                )
            for name in ready:
                done.append(name)
                del waiting[name]
        return done

    def check(self) -> "Network":
        """Raise InputError unless every name, shape and number is right and every loop has a delay; return self."""
        self.flatten()
        return self

    # ---- one form for all that follows

    def flatten(self) -> "Network":
        """The same network with layers alone: each port fed by one connection without gain, names joined by dots.

        Sums of several connections, gains and inner normalisations become frozen linear layers; plain ports vanish.
        """
        return _Flattener(self).network()

    def feeds(self) -> dict[str, tuple[str, int]]:
        """Of a flat network: `layer.port` or output -> (source, delay)."""
        return {c.target: (c.source, c.delay) for c in self.connections}

    # ---- running

    def run(
        self,
        inputs: Mapping[str, np.ndarray],
        initial: Mapping[str, float] | None = None,
        parameters: Mapping | None = None,
        trace: bool = False,
    ) -> dict:
        """Run over a sequence (N,) or a batch of sequences (B, N), in physical units; vector ports add a last axis.

        initial: other values before the first step, by input port (its unit) or layer path (normalised; of a layer also
        (steps, size), oldest first).
        parameters: replaces parameters by name; give torch tensors to get torch results with gradients.
        trace: return every layer's signal too. Raises InputError for inputs that are missing or not finite.
        """
        runner = Runner(self, initial, parameters)
        signals = {p.name: _as_signal(p, inputs, runner.xp) for p in self.inputs}
        lengths = {v.shape[-2] for v in signals.values()}
        if len(lengths) != 1 or 0 in lengths:
            raise InputError(f"network {self.name}: inputs have lengths {sorted(lengths)}; give one length, not zero")
        steps = [runner.step({n: v[..., k, :] for n, v in signals.items()}, trace) for k in range(lengths.pop())]
        batch = next(iter(signals.values())).shape[:-2]  # constants and initial values are the same in all of it
        stacked = {
            n: runner.xp.stack([runner.xp.broadcast_to(s[n], (*batch, v.shape[-1])) for s in steps], -2)
            for n, v in steps[0].items()
        }
        return {n: v[..., 0] if v.shape[-1] == 1 else v for n, v in stacked.items()}

    # ---- on disk

    def save(self, path: Path | str, figures: str = "") -> None:
        """Write `path`.toml, which a person can read, and `path`.safetensors with the numbers; all or nothing.

        figures: text of `path`.json, if it goes with them. `load` sees all of one writing, wherever it was broken off.
        """
        tensors = safetensors.numpy.save({n: np.ascontiguousarray(v) for n, v in self.parameters().items()})
        with replacing_all(_files(path)) as (text, numbers, more):
            text.write_text(tomli_w.dumps(_to_toml(self)), encoding="utf-8")
            numbers.write_bytes(tensors)
            if figures:
                more.write_text(figures, encoding="utf-8")

    @staticmethod
    def load(path: Path | str) -> "Network":
        """Read a saved network; every name and shape is checked. Raises InputError saying what is wrong and where."""
        toml, numbers, _ = files = _files(path)
        try:
            found = dict(zip(files, read_all(files), strict=True))
            for file in (toml, numbers):
                if found[file] is None:
                    raise InputError(f"{file}: no such file; a network is NAME.toml beside NAME.safetensors")
            data = read_toml(toml, "save the network again", found[toml])
            tensors = safetensors.numpy.load(found[numbers])
        except InputError:
            raise
        except (OSError, ValueError, KeyError, TypeError, RecursionError, safetensors.SafetensorError) as error:
            raise InputError(f"{path}: not a readable network ({error}); save it again") from None
        try:
            network = _Reader(tensors).network(data, f"{toml}:", "").check()
        except InputError as error:
            said = str(error)
            raise InputError(said if said.startswith(str(path)) else f"{toml}: {said}") from None
        if tensors:
            raise InputError(f"{numbers}: holds {shown(min(tensors))}, which {toml.name} does not name")
        return network


class Runner:
    """A network under way: `step` takes one sample of every input and gives one of every output."""

    def __init__(self, network: Network, initial: Mapping | None = None, parameters: Mapping | None = None):
        flat = network.flatten()
        initial = initial or {}
        known = {p.name for p in flat.inputs} | set(flat.modules)
        for name in initial:
            if name not in known:
                raise InputError(f"network {network.name}: no input or layer {name} to give an initial value")
        values = flat.parameters()
        for name, value in (parameters or {}).items():
            if name not in values or tuple(value.shape) != values[name].shape:
                raise InputError(f"network {network.name}: no parameter {name} of shape {tuple(value.shape)}")
        self.xp = _namespace(parameters or {})
        self._flat = flat
        self._order = flat.order()
        self._feeds = flat.feeds()
        as_array = (lambda v: v) if self.xp is np else (lambda v: self.xp.as_tensor(v, dtype=self.xp.float64))
        self._values = {n: as_array((parameters or {}).get(n, np.asarray(v))) for n, v in values.items()}
        start = {p.name: np.full(p.size, (initial.get(p.name, p.initial) - p.offset) / p.scale) for p in flat.inputs}
        start |= {n: initial.get(n, layer.initial) for n, layer in flat.modules.items()}
        sizes = {p.name: p.size for p in flat.inputs} | {n: layer.size for n, layer in flat.modules.items()}
        deepest = dict.fromkeys(start, 0)
        for source, delay in self._feeds.values():
            deepest[source] = max(deepest[source], delay)
        self._past = {}  # newest first
        for name, deep in deepest.items():
            value = np.atleast_2d(np.asarray(start[name], float))[-deep:] if deep else np.zeros((0, 1))
            past = np.broadcast_to(value, (deep, sizes[name]))[::-1]
            self._past[name] = [as_array(v.copy()) for v in past]

    def step(self, inputs: Mapping, trace: bool = False) -> dict:
        """inputs: port -> (..., size), physical. Returns port -> (..., size), physical (and every layer, if traced)."""
        now = {p.name: (inputs[p.name] - p.offset) / p.scale for p in self._flat.inputs}

        def feed(target):
            source, delay = self._feeds[target]
            return now[source] if delay == 0 else self._past[source][delay - 1]

        for name in self._order:
            layer = self._flat.modules[name]
            n = self._values[f"{name}.bias"]
            for port in layer.weights:
                n = n + feed(f"{name}.{port}") @ self._values[f"{name}.{port}"].T
            now[name] = ACTIVATIONS[layer.activation](self.xp, n)
        outputs = {p.name: feed(p.name) * p.scale + p.offset for p in self._flat.outputs}
        for name, past in self._past.items():
            if past:
                self._past[name] = [now[name], *past[:-1]]
        return {n: v for n, v in now.items() if n in self._flat.modules} | outputs if trace else outputs


def _namespace(parameters: Mapping):
    if any(type(v).__module__.startswith("torch") for v in parameters.values()):
        import torch  # only where gradients are asked for: it takes seconds to import

        return torch
    return np


def _as_signal(port: Port, inputs: Mapping, xp):
    if port.name not in inputs:
        raise InputError(f"input {port.name} [{port.unit}] is missing; given: {', '.join(inputs) or 'nothing'}")
    value = inputs[port.name]
    value = np.asarray(value, float) if xp is np else xp.as_tensor(value, dtype=xp.float64)
    if not bool(xp.isfinite(value).all()):
        raise InputError(f"input {port.name}: holds NaN or inf; mend the recording")
    if port.size == 1:
        value = value[..., None]
    if value.shape[-1] != port.size:
        raise InputError(f"input {port.name}: {value.shape[-1]} columns where {port.size} are declared")
    return value


def _loop(waiting: dict[str, set]) -> list[str]:
    """Layers along one loop among those that wait for each other."""
    path = [next(iter(waiting))]
    while True:
        following = sorted(waiting[path[-1]] & waiting.keys())[0]
        if following in path:
            return [*path[path.index(following) :], following][::-1]
        path.append(following)


class _Flattener:
    """Turns nested modules into layers: every port becomes a linear junction, then plain junctions are bypassed."""

    def __init__(self, network: Network):
        self.top = network
        self.layers: dict[str, Layer] = {}
        self.feeds: dict[str, list[tuple[str, int, np.ndarray | None]]] = {}
        self.size: dict[str, int] = {}  # of each module and port of a network
        self.columns: dict[str, int] = {}  # of each port of a layer
        self.where = f"network {check_name(network.name, 'network')}:"
        self._collect(network, "")
        self._check_fed()

    def fail(self, message: str):
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
        """Size of what a connection leads to. A layer's port may bear the name of the module that feeds it."""
        return self.columns.get(target) or self.size[target]

    def _collect(self, network: Network, prefix: str) -> None:
        for port in network.inputs + network.outputs:
            self._port(port, prefix)
        for name, module in network.modules.items():
            path = prefix + check_path(name, f"{self.where} module name")
            if "__" in name:
                self.fail(f"module name {name!r}: use letters, digits and single underscores")
            if isinstance(module, Network):
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
        if layer.activation not in ACTIVATIONS:
            self.fail(f"layer {path}: unknown activation {shown(layer.activation)}; known: {', '.join(ACTIVATIONS)}")
        if layer.activation == "select" and layer.rows % 3:
            self.fail(f"layer {path}: select has {layer.rows} rows; it needs three for each neuron")
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

    def _connect(self, c: Connection, network: Network, prefix: str) -> None:
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

    def _resolve(self, network: Network, prefix: str, name: str, is_source: bool) -> str:
        ports = network.inputs if is_source else network.outputs
        if name in {p.name for p in ports}:
            return prefix + name
        whole = name in network.modules and is_source
        module_name, port = (name, "") if whole or "." not in name else name.rpartition(".")[::2]
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

    def _normalisations(self, network: Network, prefix: str) -> Iterator[tuple[str, float, float]]:
        for name, module in network.modules.items():
            if isinstance(module, Network):
                path = f"{prefix}{name}."
                for p in module.inputs:
                    yield path + p.name, 1 / p.scale, -p.offset / p.scale
                for p in module.outputs:
                    yield path + p.name, p.scale, p.offset
                yield from self._normalisations(module, path)

    def network(self) -> Network:
        norm = {path: (a, b) for path, a, b in self._normalisations(self.top, "")}
        top_inputs, top_outputs = {p.name for p in self.top.inputs}, {p.name for p in self.top.outputs}
        modules, plain = dict(self.layers), {}
        connections: dict[str, tuple[str, int]] = {}
        for target, feeds in self.feeds.items():
            a, b = norm.get(target, (1.0, 0.0))
            source, delay, gain = feeds[0]
            if (
                len(feeds) == 1
                and gain is None
                and (a, b) == (1.0, 0.0)
                and not (target in top_outputs and (delay or source in top_inputs))
            ):
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

        def trace_back(source: str, delay: int, seen=()) -> tuple[str, int]:
            while source in plain and source not in modules:
                if source in seen:
                    self.fail(f"a loop without a layer through {source}")
                seen = (*seen, source)
                source, extra = plain[source]
                delay += extra
            return source, delay

        for name, layer in self.layers.items():
            for port in layer.weights:
                connections[f"{name}.{port}"] = plain[f"{name}.{port}"]
        for port in self.top.outputs:
            connections[port.name] = plain[port.name]
        traced = {target: trace_back(*feed) for target, feed in connections.items()}
        for target, (source, delay) in traced.items():
            if delay > LONGEST_DELAY:
                self.fail(f"{target} reads {source} {delay} steps late in all; make it at most {LONGEST_DELAY}")
        flat = Network(
            self.top.name,
            list(self.top.inputs),
            list(self.top.outputs),
            modules,
            [Connection(source, target, delay) for target, (source, delay) in traced.items()],
        )
        order = flat.order()
        start = {p.name: np.full(p.size, (p.initial - p.offset) / p.scale) for p in flat.inputs}
        feeds = flat.feeds()
        for name in order:  # a junction before the first step is what its sources were
            layer = flat.modules[name]
            if name not in self.layers:
                sources = {p: feeds[f"{name}.{p}"][0] for p in layer.weights}
                before = {s: start[s] if s in start else flat.modules[s].initial for s in sources.values()}
                initial = layer.bias + sum(product(w, before[sources[p]]) for p, w in layer.weights.items())
                flat.modules[name] = layer = replace(layer, initial=initial)
            start[name] = layer.initial
        flat.modules = {n: flat.modules[n] for n in order}
        return flat


def _files(path: Path | str) -> list[Path]:
    """What is written together: structure, numbers, and the figures of a training."""
    return [Path(path).with_suffix(suffix) for suffix in (".toml", ".safetensors", ".json")]


def _to_toml(network: Network) -> dict:
    modules = {}
    for name, module in network.modules.items():
        if isinstance(module, Network):
            modules[name] = _to_toml(module)
            continue
        modules[name] = {
            "activation": module.activation,
            "rows": module.rows,
            "ports": {p: w.shape[1] for p, w in module.weights.items()},
            "initial": module.initial.tolist(),
            "frozen": sorted(module.frozen),
        }
    connections = []
    for c in network.connections:
        entry = {"from": c.source, "to": c.target, "delay": c.delay}
        if c.gain is not None:
            entry["gain"] = np.asarray(c.gain).tolist()
        connections.append(entry)
    ports = {
        kind: [{k: getattr(p, k) for k in p.__dataclass_fields__} for p in getattr(network, kind)]
        for kind in ("inputs", "outputs")
    }
    meaning = {"meaning": network.meaning} if network.meaning else {}
    return {"name": network.name, **meaning, **ports, "modules": modules, "connections": connections}


_PORT: dict[str, Kind] = {"name": check_path}
_PORT_OPTIONS: dict[str, Kind] = {
    "unit": check_unit, "scale": number, "offset": number, "size": whole(1, LARGEST_SIZE), "initial": number,
    "resolution": number,
}  # fmt: skip
_CONNECTION: dict[str, Kind] = {"from": check_path, "to": check_path, "delay": whole(0, LONGEST_DELAY)}
_LAYER: dict[str, Kind] = {
    "activation": check_text,
    "rows": whole(1, 3 * LARGEST_SIZE),
    "ports": named(whole(1, LARGEST_SIZE)),
    "initial": array,
    "frozen": listed(check_path),
}


class _Reader:
    """Makes a network of what its TOML says, and takes its numbers out of `tensors`."""

    def __init__(self, tensors: dict[str, np.ndarray]):
        self.tensors = tensors

    def network(self, data: object, where: str, prefix: str) -> Network:
        ports = listed(lambda entry, where: Port(**table(entry, where, _PORT, _PORT_OPTIONS)))
        connections = listed(lambda entry, where: table(entry, where, _CONNECTION, {"gain": array}))
        entries = {"name": check_name, "inputs": ports, "outputs": ports, "modules": named(anything)}
        found = table(data, where, entries | {"connections": connections}, {"meaning": check_text})
        network = Network(found["name"], found["inputs"], found["outputs"], meaning=found.get("meaning", ""))
        for name, entry in found["modules"].items():
            path = check_path(prefix + name, f"{where} module")
            place = entry_of(where, f"modules.{name}")
            if isinstance(entry, dict) and "modules" in entry:
                network.modules[name] = self.network(entry, place, f"{path}.")
            else:
                network.modules[name] = self.layer(entry, place, path)
        for c in found["connections"]:
            gain = c.get("gain")
            network.connect(c["from"], c["to"], c["delay"], gain if gain is None or gain.ndim else float(gain))
        return network

    def layer(self, entry: object, where: str, path: str) -> Layer:
        said = table(entry, where, _LAYER)
        if "bias" in said["ports"]:
            raise InputError(f"{where}.ports: bias is no port's name, every layer has a bias; rename the port")
        values = {}
        for port, columns in {**said["ports"], "bias": None}.items():
            shape = (said["rows"],) if port == "bias" else (said["rows"], columns)
            found = self.tensors.pop(f"{path}.{port}", np.zeros(0))
            if found.shape != shape or found.dtype.kind != "f":
                raise InputError(
                    f"layer {path}: {port} should have shape {shape}, the file holds {found.shape} of {found.dtype}"
                )
            values[port] = found
        bias, initial = values.pop("bias"), said["initial"]
        size = said["rows"] // 3 if said["activation"] == "select" else said["rows"]
        if initial.shape not in ((), (1,), (size,)):
            raise InputError(f"{where}.initial has shape {initial.shape}; give {size} numbers")
        return Layer(values, bias, said["activation"], initial, frozenset(said["frozen"]))
