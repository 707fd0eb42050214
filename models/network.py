"""The float network: named modules and ports, joined by connections with delays. Training, float runs and the compiler
all walk it.

A `Layer` is `activation(sum over ports of W @ input + bias)`. A `Network` joins layers and other networks by
connections, each with a delay z^-d and a gain. Every loop must hold a delay of at least one step. `flatten` gives the
same network as layers alone, each port fed by exactly one signal: the form on which everything else works.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import MappingProxyType
from typing import Self

import numpy as np

from greygate.errors import InputError
from greygate.models import sampling, storage
from greygate.models.flattening import Flattener
from greygate.models.layer import Connection, Layer, Port


@dataclass
class Network:
    """Modules joined by connections; itself a module of another network.

    meaning: name of the library function that it stands for (families/library.py), which the compiler may emit instead.
    dt: sample time [s] of what it was made for; None where that is not known, or all the same to it.

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
    dt: float | None = None

    def __repr__(self) -> str:
        inputs, outputs = (", ".join(f"{p.name} [{p.unit}]" for p in ports) for ports in (self.inputs, self.outputs))
        size = sum(v.size for v in self.parameters().values())
        return f"<Network {self.name}: {inputs} -> {outputs}; {len(self.layers())} layers, {size} parameters>"

    # ---- building

    def add(
        self, name: str, module: "Layer | Network", feeds: Mapping[str, str | tuple[str, int]] = MappingProxyType({})
    ) -> None:
        """Add a module. feeds: port -> its source, or (source, delay). Raises InputError if the name is taken."""
        if name in self.modules or name in {p.name for p in self.inputs + self.outputs}:
            raise InputError(f"network {self.name}: the name {name} is used twice; rename one")
        self.modules[name] = module
        for port, feed in feeds.items():
            source, delay = (feed, 0) if isinstance(feed, str) else feed
            self.connect(source, f"{name}.{port}", delay)

    def connect(self, source: str, target: str, delay: int = 0, gain: float | np.ndarray | None = None) -> None:
        """Let `target` receive gain @ source(k - delay); several connections to one port add up."""
        self.connections.append(Connection(source, target, delay, gain))

    def port(self, name: str) -> Port:
        """The input or output of that name."""
        return next(p for p in self.inputs + self.outputs if p.name == name)

    # ---- walking

    def layers(self) -> dict[str, Layer]:
        """Every layer by its path, `module.module.layer`."""
        found: dict[str, Layer] = {}
        for name, module in self.modules.items():
            if isinstance(module, Layer):
                found[name] = module
            else:
                found |= {f"{name}.{path}": layer for path, layer in module.layers().items()}
        return found

    def neurons(self) -> int:
        """How many neurons its layers have that are not linear."""
        return sum(layer.size for layer in self.layers().values() if not layer.is_linear)

    def sample_time(self) -> float | None:
        """Its `dt`, or else that of a module [s]; None where nothing says it. Raises InputError where two differ."""
        of = {f"module {name}": m.sample_time() for name, m in self.modules.items() if isinstance(m, Network)}
        found = [(who, dt) for who, dt in (("it", self.dt), *of.items()) if dt is not None]
        for who, dt in found[1:]:
            if not sampling.same(dt, found[0][1]):
                told = f"{found[0][0]} was made for {sampling.spoken(found[0][1])}, {who} for {sampling.spoken(dt)}"
                raise InputError(f"network {self.name}: {told}; train both on recordings of one sample time")
        return found[0][1] if found else None

    def parameters(self) -> dict[str, np.ndarray]:
        """Every weight matrix `layer.port` and bias `layer.bias`."""
        return {
            f"{path}.{port}": w
            for path, layer in self.layers().items()
            for port, w in (*layer.weights.items(), ("bias", layer.bias))
        }

    def with_parameters(self, values: Mapping[str, np.ndarray]) -> "Network":
        """The same network with other values for the parameters named."""

        def rebuilt(network: Network, prefix: str) -> Network:
            modules: dict[str, Layer | Network] = {}
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
        """Layer names of a flat network, each after the layers that it reads without delay.

        Raises InputError naming the layers of a loop that has no delay.
        """
        needs: dict[str, set[str]] = {name: set() for name in self.modules}
        for c in self.connections:
            reader = c.target.rpartition(".")[0]
            if c.delay == 0 and c.source in needs and reader:
                needs[reader].add(c.source)
        place = {name: k for k, name in enumerate(self.modules)}
        sorter, done = TopologicalSorter(needs), dict[str, None]()
        with suppress(CycleError):  # it goes on up to the loop
            sorter.prepare()
        while ready := sorted(sorter.get_ready(), key=place.__getitem__):
            done |= dict.fromkeys(ready)
            sorter.done(*ready)
        if waiting := {n: read - done.keys() for n, read in needs.items() if n not in done}:
            raise InputError(
                f"network {self.name}: a loop without delay through {' -> '.join(_loop(waiting))}; "
                "give one of its connections delay >= 1"
            )
        return list(done)

    def check(self) -> "Network":
        """Raise InputError unless every name, shape and number is right and every loop has a delay; return self."""
        self.flatten()
        return self

    # ---- one form for all that follows

    def flatten(self) -> "Network":
        """The same network with layers only: each port has one connection without gain, and names are joined by dots.

        Sums of several connections, gains and inner normalisations become frozen linear layers; plain ports vanish.
        """
        flattener = Flattener(self)
        layers, connections = flattener.flat()
        ports = replace(self, inputs=list(self.inputs), outputs=list(self.outputs), meaning="", dt=self.sample_time())
        flat = replace(ports, modules={**layers}, connections=connections)
        in_order = {name: layers[name] for name in flat.order()}
        return replace(flat, modules={**flattener.started(in_order, flat.rest(), flat.feeds())})

    def rest(self) -> dict[str, np.ndarray]:
        """Of a flat network: every input and layer before step 0, (size,), normalised."""
        inputs = {p.name: np.full(p.size, p.rest) for p in self.inputs}
        return inputs | {name: layer.initial for name, layer in self.layers().items()}

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

    save = storage.save

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a saved network; every name and shape is checked. Raises InputError saying what is wrong and where."""
        return storage.load(cls, path)


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
        self._flat, self._layers = flat, flat.layers()
        self._order = flat.order()
        self._feeds = flat.feeds()
        as_array = (lambda v: v) if self.xp is np else (lambda v: self.xp.as_tensor(v, dtype=self.xp.float64))
        self._values = {n: as_array((parameters or {}).get(n, np.asarray(v))) for n, v in values.items()}
        given = {p.name: np.full(p.size, p.normalised(initial[p.name])) for p in flat.inputs if p.name in initial}
        start = flat.rest() | dict(initial) | given
        sizes = {p.name: p.size for p in flat.inputs} | {n: layer.size for n, layer in self._layers.items()}
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
        now = {p.name: p.normalised(inputs[p.name]) for p in self._flat.inputs}

        def feed(target):
            source, delay = self._feeds[target]
            return now[source] if delay == 0 else self._past[source][delay - 1]

        for name in self._order:
            layer = self._layers[name]
            n = self._values[f"{name}.bias"]
            for port in layer.weights:
                n = n + feed(f"{name}.{port}") @ self._values[f"{name}.{port}"].T
            now[name] = layer.function.value(self.xp, n)
        outputs = {p.name: feed(p.name) * p.scale + p.offset for p in self._flat.outputs}
        for name, past in self._past.items():
            if past:
                self._past[name] = [now[name], *past[:-1]]
        return {n: v for n, v in now.items() if n in self._layers} | outputs if trace else outputs


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
