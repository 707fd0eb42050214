"""Standard library networks: modules whose weights are known, by name (thesis 3.4 and 7.4.2; Dolen 2000).

Switches, logic and limits are constructed. The others are small tanh networks, which were trained once and are kept in
`trained/library` (`python -m benchmarks library` trains them again). Each network states the function it
stands for, the range of its ports and a bound of its error there. Its name is its `Network.meaning`, from which the
compiler emits a multiplexer or a comparator instead (compiler/meaning.py). Constructed weights are frozen.
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from decimal import ROUND_CEILING, Context, Decimal, localcontext
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.models.families.blocks import flow_rate
from greygate.models.network import Layer, Network, Port

TRAINED = Path(__file__).parents[1] / "trained" / "library"
ERRORS = TRAINED / "errors.json"  # name -> worst error of each trained network
SATURATED = 15.0  # tanh is 1 to 2e-13 from here on
PASSED = 100.0  # a signal divided by it passes the linear part of tanh (kappa of 3.4, 1/0.01 of 3.7)
ANY = (-math.inf, math.inf)
FAR = 10.0  # end of the grid where a range has no end
DENSE = {1: 20_001, 2: 401, 3: 41}  # points of each axis, by the number of ports
ROUNDING = 1e-15  # relative rounding error of a few float operations


@dataclass(frozen=True)
class LibraryNetwork:
    """A library network with its function, its ranges and its worst error.

    function: the exact answer to arrays given by port name, NaN where it is not defined. text: the function in a line.
    ranges: port -> (low, high), in the port's unit. gaps: port -> open intervals of its range in which the network
    changes from one value to the other. worst_error: the largest deviation from the function over the ranges, without
    the gaps. cure: advice against values in the gaps. hardware: its operations.
    """

    network: Network
    function: Callable[..., np.ndarray]
    text: str
    ranges: Mapping[str, tuple[float, float]]
    worst_error: float
    hardware: str
    gaps: Mapping[str, tuple[tuple[float, float], ...]] = field(default_factory=dict)
    cure: str = ""

    def grid(self, points: int | None = None) -> dict[str, np.ndarray]:
        """Every combination of `points` values of each port, including the ends of its range and of its gaps."""
        axes = []
        for port, (low, high) in self.ranges.items():
            axis = np.linspace(max(low, -FAR), min(high, FAR), points or DENSE[len(self.ranges)])
            for a, b in self.gaps.get(port, ()):
                axis = np.append(axis[(axis <= a) | (axis >= b)], (a, b))
            axes.append(np.unique(axis))
        return {p: v.ravel() for p, v in zip(self.ranges, np.meshgrid(*axes), strict=True)}


# ---- constructed


def _network(name: str, inputs: str, layers: Mapping[str, tuple[Layer, Mapping[str, str]]]) -> Network:
    """A network of frozen layers {name: (layer, {port: source})}, of which the last is the output `y`."""
    network = Network(name, [Port(i) for i in inputs.split()], [Port("y")])
    for layer_name, (layer, sources) in layers.items():
        network.add(layer_name, replace(layer, frozen=frozenset({*layer.weights, "bias"})), sources)
    network.connect(layer_name, "y")
    return network


def _positive(name: str, **values: float) -> None:
    for key, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"library network {name}: {key} = {value} must be a positive number")


def _passing_error(reach: float) -> float:
    """Error of a tanh that passes a signal, and of a saturated gate that is not quite 1, times 10 and 100."""
    return reach * (1 - PASSED * math.tanh(1 / PASSED) + 2 * PASSED * 10 * (1 - math.tanh(SATURATED)))


def switch_1(reach: float = 1.0) -> LibraryNetwork:
    """Switching network type 1 (3.4), kappa = 100: y = u1 for s = 1, u2 for s = -1. reach: largest |u1|, |u2|."""
    _positive("switch_1", reach=reach)
    k, r = PASSED, PASSED * reach
    gates = Layer({"u1": [[1 / r], [0.0]], "u2": [[0.0], [1 / r]], "s": [[k], [k]]}, [-k, k], "tansig")
    out = Layer({"gates": [[r, r]], "s": [[-r]]}, [0.0])
    layers = {"gates": (gates, {"u1": "u1", "u2": "u2", "s": "s"}), "out": (out, {"gates": "gates", "s": "s"})}
    return LibraryNetwork(
        _network("switch_1", "u1 u2 s", layers),
        lambda u1, u2, s: np.select([s == 1, s == -1], [u1, u2], np.nan),
        "u1 for s = 1, u2 for s = -1",
        {"u1": (-reach, reach), "u2": (-reach, reach), "s": (-1, 1)},
        _passing_error(reach),
        "1 multiplexer",
        {"s": ((-1, 1),)},
        "put library network sign before s, or take switch_2",
    )


def _chosen(u1: np.ndarray, u2: np.ndarray, s: np.ndarray) -> np.ndarray:
    return np.where(s >= 0, u1, u2)


def switch_2(gain: float = 1e6, reach: float = 1.0) -> LibraryNetwork:
    """Switching network type 2 (3.5 to 3.7): y = u1 for s >= 0, u2 for s < 0.

    In the thesis it is a recurrent layer whose third neuron feeds the other two one update later. Here that neuron
    stands before them, so that y answers within the step. Its bias is 15 instead of 0: at s = 0 it says "not negative",
    while the thesis's switch gives 0, neither u1 nor u2. Between -30/gain and 0 it changes its value, and y is far
    off. gain: 1e5 in the thesis. reach: largest magnitude of u1 and u2.
    """
    _positive("switch_2", gain=gain, reach=reach)
    r = PASSED * reach
    gate = Layer({"s": [[gain]]}, [SATURATED], "tansig")
    values = Layer({"u1": [[1 / r], [0.0]], "u2": [[0.0], [1 / r]], "gate": [[10.0], [10.0]]}, [-10.0, 10.0], "tansig")
    layers = {
        "gate": (gate, {"s": "s"}),
        "values": (values, {"u1": "u1", "u2": "u2", "gate": "gate"}),
        "out": (Layer({"values": [[r, r]], "gate": [[-r]]}, [0.0]), {"values": "values", "gate": "gate"}),
    }
    return LibraryNetwork(
        _network("switch_2", "u1 u2 s", layers),
        _chosen,
        "u1 for s >= 0, else u2",
        {"u1": (-reach, reach), "u2": (-reach, reach), "s": ANY},
        _passing_error(reach),
        "1 multiplexer",
        {"s": ((-2 * SATURATED / gain, 0.0),)},
    )


def xor(gain: float = 1e5) -> LibraryNetwork:
    """Exclusive or (3.8, 3.9): y = -1 where sgn(u1) = sgn(u2), else 1. The sign of 0 is 0, which equals only itself.

    Up to about 0.55/gain the network takes a value for 0. gain: K of the thesis, at least 100.
    """
    if not 100 <= gain < math.inf:
        raise InputError(f"library network xor: gain = {gain} is below 100 or not finite")
    signs = Layer({"u1": [[gain], [0.0]], "u2": [[0.0], [gain]]}, [0.0, 0.0], "tansig")
    compared = Layer({"signs": [[gain, -gain], [gain, -gain]]}, [-gain / 2, gain / 2], "tansig")
    layers = {
        "signs": (signs, {"u1": "u1", "u2": "u2"}),
        "compared": (compared, {"signs": "signs"}),
        "out": (Layer({"compared": [[1.0, -1.0]]}, [1.0]), {"compared": "compared"}),
    }
    gap = math.atanh(0.5 + 20 / gain) / gain
    return LibraryNetwork(
        _network("xor", "u1 u2", layers),
        lambda u1, u2: np.where(np.sign(u1) == np.sign(u2), -1.0, 1.0),
        "-1 if sgn(u1) = sgn(u2), else 1; sgn(0) = 0",
        {"u1": ANY, "u2": ANY},
        0.0,
        "7 comparators",
        dict.fromkeys(("u1", "u2"), ((-gap, 0.0), (0.0, gap))),
    )


def sign(gain: float = 1e6) -> LibraryNetwork:
    """y = 1 for x >= 0, -1 for x < 0, by one tanh neuron; its bias of 15 decides x = 0."""
    _positive("sign", gain=gain)
    layers = {"out": (Layer({"x": [[gain]]}, [SATURATED], "tansig"), {"x": "x"})}
    return LibraryNetwork(
        _network("sign", "x", layers),
        lambda x: np.where(x >= 0, 1.0, -1.0),
        "1 for x >= 0, else -1",
        {"x": ANY},
        1 - math.tanh(SATURATED),
        "1 comparator",
        {"x": ((-2 * SATURATED / gain, 0.0),)},
    )


def zero_region(threshold: float = 1e-3) -> LibraryNetwork:
    """Zero-region detector (7.4.2): y = 1 for |x| <= threshold, else -1, by two hard limits; it drives a switch."""
    _positive("zero_region", threshold=threshold)
    layers = {
        "above": (Layer({"x": [[1.0]]}, [threshold], "hardlim"), {"x": "x"}),
        "below": (Layer({"x": [[-1.0]]}, [threshold], "hardlim"), {"x": "x"}),
        "out": (Layer({"above": [[2.0]], "below": [[2.0]]}, [-3.0]), {"above": "above", "below": "below"}),
    }
    return LibraryNetwork(
        _network("zero_region", "x", layers),
        lambda x: np.where(np.abs(x) <= threshold, 1.0, -1.0),
        f"1 for |x| <= {threshold:g}, else -1",
        {"x": ANY},
        0.0,
        "3 comparators",
    )


def absolute(reach: float = 1.0) -> LibraryNetwork:
    """y = |x| for |x| <= reach, by two saturating neurons."""
    _positive("absolute", reach=reach)
    layers = {
        "halves": (Layer({"x": [[1 / reach], [-1 / reach]]}, [0.0, 0.0], "satlin"), {"x": "x"}),
        "out": (Layer({"halves": [[reach, reach]]}, [0.0]), {"halves": "halves"}),
    }
    ranges, error = {"x": (-reach, reach)}, ROUNDING * reach
    return LibraryNetwork(_network("absolute", "x", layers), lambda x: np.abs(x), "|x|", ranges, error, "1 multiplexer")


def limiter(lo: float = 0.0, hi: float = 1.0) -> LibraryNetwork:
    """y = min(hi, max(x, lo)), by one saturating neuron, or a multiplexer in the network if lo is -inf or hi is inf."""
    if not lo < hi or (lo == -math.inf and hi == math.inf):
        raise InputError(f"library network limiter: lo = {lo}, hi = {hi}; give lo < hi, one of them may be infinite")
    span, text, error = hi - lo, f"min({hi:g}, max(x, {lo:g}))", ROUNDING * (abs(lo) + abs(hi))
    layers = {
        "part": (Layer({"x": [[1 / span]]}, [-lo / span], "satlin"), {"x": "x"}),
        "out": (Layer({"part": [[span]]}, [lo]), {"part": "part"}),
    }
    if math.isinf(span):
        end, side, text = (lo, 1.0, f"max(x, {lo:g})") if math.isinf(hi) else (hi, -1.0, f"min(x, {hi:g})")
        chosen = Layer({"x": [[side], [1.0], [0.0]]}, [-side * end, 0.0, end], "select")
        layers, error = {"out": (chosen, {"x": "x"})}, 0.0
    return LibraryNetwork(
        _network("limiter", "x", layers), lambda x: np.clip(x, lo, hi), text, {"x": ANY}, error, "1 clamp"
    )


def gaussian() -> LibraryNetwork:
    """y = exp(-x^2 / 2), by one radial neuron."""
    layers = {"out": (Layer({"x": [[1 / math.sqrt(2)]]}, [0.0], "radbas"), {"x": "x"})}
    network = _network("gaussian", "x", layers)
    function, text = (lambda x: np.exp(-(x**2) / 2)), "exp(-x^2 / 2)"
    return LibraryNetwork(network, function, text, {"x": ANY}, ROUNDING, "1 table look-up")


# ---- trained


Function = tuple[Callable[..., np.ndarray], str, Mapping[str, tuple[float, float]]]  # of ports; in words; ranges
FUNCTIONS: dict[str, Function] = {
    "divider": (
        lambda omega, gamma: omega / (gamma + 1), "omega / (gamma + 1)", {"omega": (-1, 1), "gamma": (-0.9, 0.9)}
    ),
    "square": (lambda x: x * x, "x^2", {"x": (-1, 1)}),
    "product": (lambda x1, x2: x1 * x2, "x1 x2", {"x1": (-1, 1), "x2": (-1, 1)}),
    "sine": (lambda x: np.sin(x), "sin(x)", {"x": (-math.pi, math.pi)}),
    "cosine": (lambda x: np.cos(x), "cos(x)", {"x": (-math.pi, math.pi)}),
    "arccosine": (lambda x: np.arccos(x), "arccos(x)", {"x": (-1, 1)}),
    "square_root": (lambda x: np.sqrt(x), "sqrt(x)", {"x": (0.01, 1)}),
}  # fmt: skip
"""On which a network was trained; `divider` is that of 5.3.2.2."""


def _tables(network: Network) -> str:
    return f"{sum(v.size for v in network.layers().values() if v.activation == 'tansig')} table look-ups"


def _trained(name: str) -> Callable[[], LibraryNetwork]:
    """Builder of a network of `FUNCTIONS`."""

    def build() -> LibraryNetwork:
        network = Network.load(TRAINED / name)
        return LibraryNetwork(network, *FUNCTIONS[name], _stored_error(name), _tables(network))

    return build


def _stored_error(name: str) -> float:
    return json.loads(ERRORS.read_text())[name]


def flow(lap: float = 0.0) -> LibraryNetwork:
    """Flow into a chamber through a valve (5.3.2.1; A.1, A.4, A.6), normalised, from a trained zero-lapped one.

        y = f(u + lap) sqrt(1 - p) - f(lap - u) sqrt(p),   f(x) = max(x, 0)

    u: spool in [-1, 1], p: pressure over that of the supply. lap: share of the spool's stroke; 0 for a zero-lapped
    valve, positive for an under-lapped one (then |u| <= 1 - lap), negative for an over-lapped one. With a lap, limiters
    compute the opening of each edge exactly, and the trained network reads these; its worst error is then a bound.
    """
    if not -0.9 <= lap <= 0.9:
        raise InputError(f"library network flow: lap = {lap} is not within -0.9..0.9 of the stroke")
    network, error = Network.load(TRAINED / "flow"), _stored_error("flow")
    reach, p = 1 - max(lap, 0.0), (0.01, 0.99)

    def function(u, p):
        return flow_rate(np.maximum(u + lap, 0), p) + flow_rate(np.minimum(u - lap, 0), p)

    text = "f(u + lap) sqrt(1 - p) - f(lap - u) sqrt(p), f(x) = max(x, 0)"
    if lap:
        trained, span = network, 1 + min(lap, 0.0)
        network = Network("flow", [Port("u"), Port("p")], [Port("y")])
        fixed = frozenset({"u", "bias"})
        edges = Layer({"u": [[1 / span], [-1 / span]]}, [lap / span, lap / span], "satlin", frozen=fixed)
        network.add("openings", edges, {"u": "u"})  # to the supply, to the tank
        parts = {"supply": [span, 0], "tank": [0, -span]} if lap > 0 else {"either": [span, -span]}
        for name, gain in parts.items():
            network.add(name, trained)
            network.connect("openings", f"{name}.u", gain=np.array([gain], float))
            network.connect("p", f"{name}.p")
            network.connect(name, "y")
        error *= len(parts)
    return LibraryNetwork(network, function, text, {"u": (-reach, reach), "p": p}, error, _tables(network))


# ---- the library

CONSTRUCTED = (switch_1, switch_2, xor, sign, zero_region, absolute, limiter, gaussian)
LIBRARY: dict[str, Callable[..., LibraryNetwork]] = {
    **{build.__name__: build for build in CONSTRUCTED},
    "divider": _trained("divider"),
    "flow": flow,
    **{name: _trained(name) for name in FUNCTIONS},
}


def entry(name: str, **args: float) -> LibraryNetwork:
    """The entry of a library network. Raises InputError for a name or an argument that does not exist."""
    if name not in LIBRARY:
        raise InputError(f"no library network is called {name!r}; there are {', '.join(LIBRARY)}")
    try:
        found = LIBRARY[name](**args)
    except TypeError:
        raise InputError(
            f"library network {name}: does not take {', '.join(args)}; see greygate.models.families.library"
        ) from None
    given = ", ".join(f"{k}={float(v)!r}" for k, v in args.items())
    return replace(found, network=replace(found.network, meaning=f"{name}({given})" if given else name))


def library(name: str, **args: float) -> Network:
    """A library network, ready to be added to another, such as `library("switch_2", gain=1e7)`."""
    return entry(name, **args).network


def recalled(meaning: str) -> tuple[str, LibraryNetwork]:
    """The name and the entry to which `Network.meaning` belongs. Raises InputError if it names no library network."""
    match = re.fullmatch(r"(\w+)(?:\((.*)\))?", meaning)
    try:
        if match is None:
            raise ValueError("write NAME or NAME(option=number)")
        pairs = [part.split("=") for part in match[2].split(", ")] if match[2] else []
        return match[1], entry(match[1], **{k: float(v) for k, v in pairs})
    except (TypeError, ValueError) as error:
        raise InputError(f"meaning {meaning!r} names no library network; remove it ({error})") from None


def rounded_up(value: float, digits: int) -> str:
    """The least number with this many digits that is not below value."""
    with localcontext(Context(prec=digits, rounding=ROUND_CEILING)):
        return f"{float(+Decimal(repr(float(value)))):g}"
