"""Library networks become the logic that they stand for: multiplexers and comparators for saturated tanh.

A module whose `meaning` names a library network (models/families/library.py), and whose weights are still those of the
library, is replaced by the form below that computes its function exactly. That is proved twice: its inputs stay within
the library's stated range on every record; and for every code that the tested signal can have in the finished program,
the library network and the exact form differ by no more than the library's stated worst error. In a gap the library
network itself is off its function; there the exact form has to equal the function. A module that fails keeps its
network, and a remark says why. Networks that were trained (sine, flow, ...) have no exact form and stay as they are.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from greygate.compiler.ranges import ranges, sums
from greygate.emulator.program import Affine, Program, Threshold
from greygate.models.families.library import LibraryNetwork, recalled, rounded_up
from greygate.models.network import Layer, Network
from greygate.models.training.record import Record

FEW = 64  # codes up to which a signal's are listed one by one
MANY = 1 << 17  # codes up to which all are tried; of more, only those about zero, since tanh is saturated elsewhere
OTHERS = 5  # values of every other port that each code is tried with


def _form(network: Network, layers: Mapping[str, tuple[Layer, Mapping[str, str]]]) -> Network:
    """The exact form with the ports of the library network: layers {name: (layer, {port: source})}, the last is y."""
    form = Network(network.name, network.inputs, network.outputs, dt=network.dt)
    for name, (layer, sources) in layers.items():
        form.add(name, replace(layer, frozen=frozenset({*layer.weights, "bias"})))
        for port, source in sources.items():
            form.connect(source, f"{name}.{port}")
    form.connect(name, network.outputs[0].name)
    return form


def _switch(network: Network) -> Network:
    weights = {"s": [[1.0], [0.0], [0.0]], "u1": [[0.0], [1.0], [0.0]], "u2": [[0.0], [0.0], [1.0]]}
    return _form(network, {"out": (Layer(weights, np.zeros(3), "select"), {p: p for p in weights})})


def _xor(network: Network) -> Network:
    """sgn is told by two comparators: x >= 0 and x <= 0. Equal signs: their difference is neither below nor above 0."""
    layers = {}
    for u in ("u1", "u2"):
        for name, w in ((f"{u}_up", 1.0), (f"{u}_down", -1.0)):
            layers[name] = Layer({u: [[w]]}, [0.0], "hardlim"), {u: u}
    signs = {"u1_up": 1.0, "u1_down": -1.0, "u2_up": -1.0, "u2_down": 1.0}
    for name, w in (("not_less", 1.0), ("not_more", -1.0)):
        layers[name] = Layer({p: [[w * v]] for p, v in signs.items()}, [0.0], "hardlim"), {p: p for p in signs}
    both = Layer({"not_less": [[-2.0]], "not_more": [[-2.0]]}, [3.0], "hardlims")
    layers["out"] = both, {"not_less": "not_less", "not_more": "not_more"}
    return _form(network, layers)


def _sign(network: Network) -> Network:
    return _form(network, {"out": (Layer({"x": [[1.0]]}, [0.0], "hardlims"), {"x": "x"})})


def _zero_region(network: Network) -> Network:
    layers = network.layers()
    limits = {n: (layers[n], {"x": "x"}) for n in ("above", "below")}
    both = Layer({"above": [[2.0]], "below": [[2.0]]}, [-3.0], "hardlims")
    return _form(network, limits | {"out": (both, {"above": "above", "below": "below"})})


def _absolute(network: Network) -> Network:
    return _form(network, {"out": (Layer({"x": [[1.0], [1.0], [-1.0]]}, np.zeros(3), "select"), {"x": "x"})})


# name -> its exact form, and which layers (the condition of a select) see the sign of which port
FORMS: dict[str, tuple[Callable[[Network], Network], Mapping[str, str]]] = {
    "switch_1": (_switch, {"out": "s"}),
    "switch_2": (_switch, {"out": "s"}),
    "xor": (_xor, {"u1_up": "u1", "u1_down": "u1", "u2_up": "u2", "u2_down": "u2"}),
    "sign": (_sign, {"out": "x"}),
    "zero_region": (_zero_region, {}),  # comparators already: exact for every number
    "absolute": (_absolute, {"out": "x"}),
}


@dataclass(frozen=True)
class Replaced:
    """A module that stands in its exact form."""

    meaning: str
    name: str
    entry: LibraryNetwork
    form: Network


def use_meanings(
    network: Network, records: Sequence[Record], refused: Mapping[str, str] | None = None
) -> tuple[Network, dict[str, Replaced], dict[str, str]]:
    """Replace every module that has an exact form. Returns the network, what was replaced, and remarks on the rest.

    refused: path -> remark of modules that keep their network. Paths are those of modules, "" for the network itself.
    """
    remarks, replaced = dict(refused or {}), {}
    found: dict = {}

    def seen(path: str, module: Network, port: str) -> tuple[float, float]:
        if not found:
            flat = network.flatten()
            found.update(feeds=flat.feeds(), ranges=ranges(flat, list(records)))
        target = next(c.target for c in module.connections if c.source == port)
        r = found["ranges"][found["feeds"][_join(path, target)][0]]
        return r.low, r.high

    def visit(module: Network, path: str) -> Network:
        if module.meaning and path not in remarks:
            name, entry = recalled(module.meaning)
            if name in FORMS:
                if not same(module, entry.network):
                    remarks[path] = "stays: its weights are no longer those of the library"
                for port, (low, high) in entry.ranges.items():
                    least, most = seen(path, module, port)
                    if least < low - 1e-9 or most > high + 1e-9:
                        cure = entry.cure if port in entry.gaps else f"give it reach={rounded_up(max(-least, most), 3)}"
                        why = f"stays: {port} reaches {least:.4g}..{most:.4g}, beyond its range {low:g}..{high:g}"
                        remarks.setdefault(path, f"{why}; {cure}")
                if path in remarks:
                    return module
                form = FORMS[name][0](module)
                last = form.connections[-1].source
                form.modules[last] = replace(form.layers()[last], initial=module.layers()[last].initial)
                replaced[path] = Replaced(module.meaning, name, entry, form)
                return form
        inner = {n: visit(m, _join(path, n)) if isinstance(m, Network) else m for n, m in module.modules.items()}
        return replace(module, modules=inner)

    return visit(network, ""), replaced, remarks


def same(module: Network, library: Network) -> bool:
    """Is this the library's network: its ports, connections, activations and weights, to the bit."""
    ours, theirs = module.layers(), library.layers()
    return (
        (module.inputs, module.outputs, module.connections) == (library.inputs, library.outputs, library.connections)
        and {n: v.activation for n, v in ours.items()} == {n: v.activation for n, v in theirs.items()}
        and all(
            v.weights.keys() == theirs[n].weights.keys()
            and all(np.array_equal(w, theirs[n].weights[p]) for p, w in v.weights.items())
            and np.array_equal(v.bias, theirs[n].bias)
            for n, v in ours.items()
        )
    )


def prove(
    program: Program, network: Network, replaced: Mapping[str, Replaced]
) -> tuple[dict[str, str], dict[str, str]]:
    """Try library network against exact form on every code that the tested signals can have in the program.

    network: the flat one that the program was quantized from. Returns what was proved and what was refused, a remark
    for each path. A layer that is no longer there is dead, or that of an equal module answers for it: those of every
    module of its kind are then tried as well.
    """
    proved, refused = {}, {}
    present = {
        path: {_join(path, n): port for n, port in FORMS[r.name][1].items() if _join(path, n) in network.modules}
        for path, r in replaced.items()
    }
    for path, r in replaced.items():
        tested = dict(present[path])
        if len(tested) < len(FORMS[r.name][1]):
            for other, kin in replaced.items():
                tested |= present[other] if kin.name == r.name else {}
        count, worst, at, inside = 0, 0.0, "", {}
        for layer, port in tested.items():
            values = sign_values(program, network, layer) * (-1 if layer.endswith("_down") else 1)
            low, high = r.entry.ranges[port]
            values = values[(values >= low) & (values <= high)]
            if not len(values):
                continue
            count += len(values)
            off, right = _differences(r, port, values)
            gap = np.any([(a < values) & (values < b) for a, b in r.entry.gaps.get(port, ())], axis=0)
            error = np.where(gap, right, off)
            if error.max() > worst:
                worst, at = error.max(), f"{port} = {values[error.argmax()]:.4g}"
            if gap.any():
                inside[port] = values[gap], off[gap]
        if worst > r.entry.worst_error * (1 + 1e-6) + 1e-9:
            refused[path] = f"stays: it is not told what {at}, a code of this program, means; {r.entry.cure}"
        elif count:
            proved[path] = f"became logic: within {worst:.3g} of its library form on all {count} codes tested"
            proved[path] += "".join(_inside(r, port, *found) for port, found in inside.items())
        else:
            proved[path] = "became logic: the same for every number"
    return proved, refused


def _inside(r: Replaced, port: str, values: np.ndarray, off: np.ndarray) -> str:
    """What is to be said of codes inside the gap, where `off` is by how much the library form misses the function."""
    larger = max(abs(v) for gap in r.entry.gaps[port] for v in gap) / np.abs(values).min()
    return (
        f", but for {len(values)} inside its gap, where the tanh form is off by up to {off.max():.3g} (at {port} = "
        f"{values[off.argmax()]:.4g}) and the logic is right; so is tanh with a gain, or a signal, "
        f"{rounded_up(larger, 3)} times as large"
    )


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _differences(r: Replaced, port: str, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Deviations of the library network, and of the function, from the exact form at values of one port: the largest
    whatever the others carry, (N,) each; inf where the function has no answer."""
    others = {p: v for p, v in r.entry.ranges.items() if p != port}
    off, right = np.zeros((2, len(values)))
    grid = replace(r.entry, ranges=others).grid(OTHERS) if others else {}
    for combination in zip(*grid.values(), strict=True) if others else [()]:
        inputs = {p: np.full((len(values), 1), v) for p, v in zip(grid, combination, strict=True)}
        inputs[port] = values[:, None]
        exact = r.form.run(inputs)["y"][:, 0]
        off = np.maximum(off, np.abs(r.entry.network.run(inputs)["y"][:, 0] - exact))
        answer = r.entry.function(**{p: v[:, 0] for p, v in inputs.items()})
        right = np.maximum(right, np.nan_to_num(np.abs(answer - exact), nan=np.inf))
    return off, right


def sign_values(program: Program, network: Network, layer: str) -> np.ndarray:
    """What the sum of which a hard limit or a select takes the sign can be in the program, exactly."""
    own = network.layers()[layer]
    part, rows = next(iter(sums(layer, own).items()))
    summed = next((o for o in program.operations if isinstance(o, Affine) and o.out.name == part), None)
    if summed is not None:
        return np.unique(np.concatenate([_sum_values(program, summed, row) for row in range(summed.out.size)]))
    feeds, weight, bias = network.feeds(), 0.0, float(own.bias[rows][0])
    for port, w in own.weights.items():
        if w[rows].any():  # only one signal; more would have made a sum
            name, delay = feeds[f"{layer}.{port}"]
            weight += float(w[rows][0, 0])
    source = f"{name}.z{delay}" if delay else name
    lsb = weight * program.signals[source].fix.lsb
    return lsb * signal_codes(program, source, round(-bias / lsb)) + bias


def signal_codes(program: Program, signal: str, about: int = 0) -> np.ndarray:
    """Codes that a signal can have: the two answers of a threshold, those of a state's source; else those its format
    has, or `MANY` of them about one and the two ends."""
    state = next((s for s in program.states if s.signal.name == signal), None)
    if state is not None:
        return np.unique(np.concatenate([signal_codes(program, state.source, about), state.initial]))
    operation = next((o for o in program.operations if o.out.name == signal), None)
    if isinstance(operation, Threshold):
        return np.unique([operation.below, operation.above])
    fix = program.signals[signal].fix
    near = np.arange(max(fix.lo, about - MANY // 2), min(fix.hi, about + MANY // 2) + 1)
    return np.unique(np.r_[fix.lo, near, fix.hi])


def _sum_values(program: Program, o: Affine, row: int) -> np.ndarray:
    """What the accumulator of one row can be; as in `signal_codes` those about zero, if they are many."""
    args = [a for a in o.args for _ in range(program.signals[a].size)]
    columns = [(a, int(w)) for a, w in zip(args, o.weights[row], strict=True) if w]
    bias, lsb = int(o.bias[row]), 2.0 ** -int(o.frac[row])
    codes = [signal_codes(program, a) for a, _ in columns]
    if math.prod(len(c) for c in codes) <= FEW:
        totals = [sum(w * int(x) for (_, w), x in zip(columns, xs, strict=True)) for xs in product(*codes)]
        return lsb * np.unique(bias + np.array(totals))
    step = math.gcd(*(w for _, w in columns))  # every sum is bias + step * something
    reach = sum(abs(w) * -program.signals[a].fix.lo for a, w in columns) // step
    about = np.arange(-min(reach, MANY // 2), min(reach, MANY // 2) + 1)
    return lsb * np.r_[bias - step * reach, bias % step + step * about, bias + step * reach].astype(float)
