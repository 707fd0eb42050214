"""The float network: named modules, ports, connections with delays. Declared here; training, emulation in float and
the compiler all walk it.

A `Layer` is `activation(sum over ports of W @ input + bias)`. A `Network` joins layers and other networks by
connections, each with a delay z^-d and a gain. Every loop must hold a delay of at least one step. `flatten` gives the
same network as layers alone, each port fed by exactly one signal: the form on which everything else works.
"""

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import safetensors.numpy
import tomli_w

from greygate.errors import InputError
from greygate.files import read_all, replacing_all

LONGEST_DELAY = 500  # steps
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
    """target(k) receives gain @ source(k - delay). Names: `port`, `module` or `module.port`."""

    source: str
    target: str
    delay: int = 0
    gain: float | np.ndarray | None = None


@dataclass
class Network:
    """Modules joined by connections; itself a module of another network.

    meaning: name of the library function that it stands for (`models/library.py`), which the compiler may emit instead.
    """

    name: str
    inputs: list[Port] = field(default_factory=list)
    outputs: list[Port] = field(default_factory=list)
    modules: dict[str, "Layer | Network"] = field(default_factory=dict)
    connections: list[Connection] = field(default_factory=list)
    meaning: str = ""

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
            text.write_text(tomli_w.dumps(_to_toml(self)))
            numbers.write_bytes(tensors)
            if figures:
                more.write_text(figures)

    @staticmethod
    def load(path: Path | str) -> "Network":
        """Read a saved network; every name and shape is checked. Raises InputError saying what is wrong and where."""
        toml, numbers, _ = files = _files(path)
        try:
            found = dict(zip(files, read_all(files), strict=True))
            for file in (toml, numbers):
                if found[file] is None:
                    raise InputError(f"{file}: no such file; a network is NAME.toml beside NAME.safetensors")
            data = tomllib.loads(found[toml].decode())
            tensors = safetensors.numpy.load(found[numbers])
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, safetensors.SafetensorError) as error:
            raise InputError(f"{path}: not a readable network ({error}); save it again") from None
        try:
            network = _from_toml(data, tensors, "").check()
        except InputError:
            raise
        except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
            raise InputError(f"{toml}: {error!r}; a name is missing or a value of the wrong kind") from None
        if tensors:
            raise InputError(f"{numbers}: holds {sorted(tensors)[0]}, which {toml.name} does not name")
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
        self.fixed: dict[str, np.ndarray] = {}  # junction -> constant it adds
        self.feeds: dict[str, list[tuple[str, int, np.ndarray | None]]] = {}
        self.size = {p.name: p.size for p in network.inputs}
        self._collect(network, "")
        self._check_fed()

    def fail(self, message: str):
        raise InputError(f"network {self.top.name}: {message}")

    def _collect(self, network: Network, prefix: str) -> None:
        for port in network.inputs + network.outputs:
            numbers = (port.scale, port.offset, port.initial, port.resolution)
            if not all(map(math.isfinite, numbers)) or port.scale == 0 or port.resolution < 0:
                self.fail(f"port {prefix}{port.name}: scale, offset, initial, resolution must be finite, scale not 0")
            self.size[prefix + port.name] = port.size
        for name, module in network.modules.items():
            path = prefix + name
            if "__" in name or not all(part.isidentifier() for part in name.split(".")):
                self.fail(f"module name {name!r}: use letters, digits and single underscores")
            if isinstance(module, Network):
                self._collect(module, path + ".")
                continue
            if module.activation not in ACTIVATIONS:
                self.fail(f"layer {path}: unknown activation {module.activation!r}; known: {', '.join(ACTIVATIONS)}")
            if module.activation == "select" and module.rows % 3:
                self.fail(f"layer {path}: select has {module.rows} rows; it needs three for each neuron")
            for port, w in (*module.weights.items(), ("bias", module.bias), ("initial", module.initial)):
                rows = module.size if port == "initial" else module.rows
                if len(w) != rows:
                    self.fail(f"layer {path}: {port} has {len(w)} rows where the layer has {rows}")
                if not np.isfinite(w).all():
                    self.fail(f"layer {path}: {port} holds NaN or inf; train it again or mend the file")
            for port in module.frozen - {"bias", *module.weights}:
                self.fail(f"layer {path}: cannot freeze {port}, there is no such port")
            self.layers[path] = module
            self.size[path] = module.size
            self.size |= {f"{path}.{p}": w.shape[1] for p, w in module.weights.items()}
        for c in network.connections:
            source, target = (
                self._resolve(network, prefix, c.source, True),
                self._resolve(network, prefix, c.target, False),
            )
            if not 0 <= c.delay <= LONGEST_DELAY or c.delay != int(c.delay):
                self.fail(
                    f"connection {c.source} -> {c.target}: delay {c.delay} is not a whole number >= 0"
                    f" and <= {LONGEST_DELAY}"
                )
            gain = None
            if c.gain is not None:
                gain = np.atleast_2d(np.asarray(c.gain, float))
                if gain.size == 1 and self.size[target] == self.size[source]:
                    gain = float(gain[0, 0]) * np.eye(self.size[target])
                if not np.isfinite(gain).all():
                    self.fail(f"connection {c.source} -> {c.target}: gain holds NaN or inf")
            have = (self.size[target], self.size[source]) if gain is None else gain.shape
            if have != (self.size[target], self.size[source]) or (gain is None and have[0] != have[1]):
                self.fail(
                    f"connection {c.source} -> {c.target}: {self.size[source]} signals into {self.size[target]}"
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
            weights = {}
            for i, (source, delay, gain) in enumerate(feeds):
                weights[f"in{i}"] = a * (np.eye(self.size[target]) if gain is None else gain)
                connections[f"{junction}.in{i}"] = (source, delay)
            bias = np.full(self.size[target], b)
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
                initial = layer.bias + sum(w @ before[sources[p]] for p, w in layer.weights.items())
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


def _from_toml(data: dict, tensors: dict[str, np.ndarray], prefix: str) -> Network:
    network = Network(data["name"], [Port(**p) for p in data["inputs"]], [Port(**p) for p in data["outputs"]])
    network.meaning = data.get("meaning", "")
    for name, entry in data["modules"].items():
        path = prefix + name
        if "modules" in entry:
            network.modules[name] = _from_toml(entry, tensors, path + ".")
            continue
        shapes = {p: (entry["rows"], n) for p, n in entry["ports"].items()} | {"bias": (entry["rows"],)}
        values = {}
        for port, shape in shapes.items():
            values[port] = tensors.pop(f"{path}.{port}", None)
            found = None if values[port] is None else values[port].shape
            if found != shape:
                raise InputError(f"layer {path}: {port} should have shape {shape}, the file holds {found}")
        bias = values.pop("bias")
        network.modules[name] = Layer(
            values, bias, entry["activation"], np.array(entry["initial"]), frozenset(entry["frozen"])
        )
    for entry in data["connections"]:
        gain = entry.get("gain")
        network.connect(entry["from"], entry["to"], entry["delay"], np.array(gain) if isinstance(gain, list) else gain)
    return network
