"""A network for one nonlinear term: one of the library where the term is that function, else one that is trained."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.stats import qmc

from greygate.identify.expert.decisions import Log
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import LibraryNetwork, entry
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

CURVES = ("flow", "square_root")  # library networks that a term may be as it stands
SAME = 1e-6  # of the size of a term: what a library function may differ from it
SIZES = (4, 8, 12, 20)  # neurons, in the order of trying
GOAL = 2e-3  # of a term's largest value, RMS: a network that misses it is given more neurons
MOST_SIGNALS = 4
POINTS = 2500
MARGIN = 0.1  # of the range on record, by which a part is trained beyond it
EPOCHS = 150

Function = Callable[[Mapping[str, np.ndarray]], np.ndarray]


@dataclass(frozen=True)
class Part:
    """network: from ports named as the signals to `y`; the term is size * y of the signals over `scales`.

    rehearsal: what it learnt, in its own ports. of_library: whether it is a library network.
    """

    network: Network
    scales: Mapping[str, float]
    size: float
    rehearsal: Record
    of_library: bool = False


def part(
    name: str,
    function: Function,
    on_record: Mapping[str, np.ndarray],
    ends: Mapping[str, Sequence[float]],
    step: int,
    log: Log,
) -> Part:
    """The network of a term.

    function: of the signals by name, (N,). on_record: their values along the recordings. ends: sizes that the plant
    names, which a library function may take for 1. step: how many sizes to pass over. Raises nothing: a term that no
    network meets keeps the best one, and the log says by how much it misses.
    """
    return _of_library(name, function, on_record, ends, log) or _trained(name, function, on_record, step, log)


def _of_library(
    name: str, function: Function, on_record: Mapping[str, np.ndarray], ends: Mapping[str, Sequence[float]], log: Log
) -> Part | None:
    """The library network that is this term up to the sizes of its signals and of its answer."""
    for curve in CURVES:
        known = entry(curve)
        ports = list(known.ranges)
        if len(ports) != len(on_record):
            continue
        for order in permutations(on_record):
            pairs = zip(order, ports, strict=True)
            spans = [
                _spans(on_record[signal], known.ranges[port], [*ends[signal], _reach(on_record[signal])])
                for signal, port in pairs
            ]
            for scales in product(*spans):
                size = _ratio(known, function, dict(zip(order, scales, strict=True)))
                if size is None:
                    continue
                said = ", ".join(f"{s} over {v:.4g}" for s, v in zip(order, scales, strict=True))
                log("part", name, f"library network {curve} of {said}", f"the term is {size:.4g} times {known.text}")
                names = dict(zip(ports, order, strict=True))
                sizes = dict(zip(order, scales, strict=True))
                return Part(_renamed(known.network, names), sizes, size, _grid(known, names), of_library=True)
    return None


def _reach(values: np.ndarray) -> float:
    """The largest that a signal may become: of a term that looks alike in every size, such as a root."""
    return (1 + MARGIN) * float(np.abs(values).max())


def _spans(values: np.ndarray, within: tuple[float, float], ends: Sequence[float]) -> list[float]:
    """The sizes that bring what is on record into the range of a port, either way round."""
    span = np.array([values.min(), values.max()])
    sizes = [s for end in ends for s in (end, -end)]
    return [s for s in sizes if within[0] <= (span / s).min() and (span / s).max() <= within[1]]


def _ratio(known: LibraryNetwork, function: Function, scales: Mapping[str, float]) -> float | None:
    """The term over the library function, where that is one number over the whole range; None where it is not."""
    at = {port: v for port, v in known.grid(41).items()}
    ours = function({signal: scales[signal] * at[port] for signal, port in zip(scales, at, strict=True)})
    theirs = known.function(**at)
    size = float(ours @ theirs / (theirs @ theirs))
    return size if size and float(np.abs(ours - size * theirs).max()) <= SAME * float(np.abs(ours).max()) else None


def _renamed(network: Network, names: Mapping[str, str]) -> Network:
    """The network behind ports of other names."""
    outer = Network(network.name, [Port(n) for n in names.values()], [Port("y")])
    outer.add("library", network)
    for port, name in names.items():
        outer.connect(name, f"library.{port}")
    outer.connect("library", "y")
    return outer


def _grid(known: LibraryNetwork, names: Mapping[str, str]) -> Record:
    at = known.grid(41)
    return Record({names[port]: v for port, v in at.items()}, {"y": known.function(**at)})


def sampled(on_record: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Points of the recording, and as many spread over its box and a margin around it (Halton), (POINTS,) each."""
    count = len(next(iter(on_record.values())))
    seen = np.unique(np.linspace(0, count - 1, POINTS // 2).astype(int))
    spread = qmc.Halton(len(on_record), scramble=False).random(POINTS // 2 + 1)[1:]
    found = {}
    for column, (name, values) in zip(spread.T, on_record.items(), strict=True):
        low, high = float(values.min()), float(values.max())
        margin = MARGIN * (high - low)
        found[name] = np.append(values[seen], low - margin + (high - low + 2 * margin) * column)
    return found


def _trained(name: str, function: Function, on_record: Mapping[str, np.ndarray], step: int, log: Log) -> Part:
    points = sampled(on_record)
    answer = function(points)
    right = np.isfinite(answer)
    points, answer = {n: v[right] for n, v in points.items()}, answer[right]
    scales = {n: float(np.abs(v).max()) or 1.0 for n, v in points.items()}
    size = float(np.abs(answer).max()) or 1.0
    record = Record({n: v / scales[n] for n, v in points.items()}, {"y": answer / size})
    signals = ", ".join(points)
    best = None
    for neurons in SIZES[step:]:
        fit = train(feedforward(name, list(points), [neurons], 0), [record], epochs=EPOCHS, decay=1e-8)
        error = float(np.sqrt(2 * fit.history[-1]))
        best = (fit.network, error, neurons)
        if error <= GOAL:
            break
        log(
            "part",
            name,
            f"{neurons} neurons",
            f"RMS {error:.2g} of its size misses {GOAL:g}",
            undone=neurons != SIZES[-1],
        )
    assert best is not None, "there are sizes"
    network, error, neurons = best
    plain = feedforward(name, list(points), [neurons], 0).with_parameters(network.parameters())
    log("part", name, f"trained network of {signals}, {neurons} neurons",
        f"no library network is this term; RMS {error:.2g} of its size on the plant's own equation")  # fmt: skip
    return Part(plain, scales, size, record)
