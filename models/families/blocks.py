"""Small networks from which structured networks are joined; each is trained on the function it stands for."""

from collections.abc import Sequence

import numpy as np

from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.progress import Progress, silent


def feedforward(
    name: str, inputs: Sequence[str], hidden: Sequence[int], seed: int, activation: str = "tansig"
) -> Network:
    """`hidden` layers of neurons between scalar ports and one linear output `y`, with the weights of Nguyen and Widrow.

    Nguyen, Widrow 1990: the neurons share the input range [-1, 1] among them.
    """
    rng = np.random.default_rng(seed)
    network = Network(name, [Port(i) for i in inputs], [Port("y")])
    sources = {i: (i, 1) for i in inputs}
    for depth, size in enumerate(hidden, 1):
        fan_in = sum(n for _, n in sources.values())
        w, bias = _shared_out(rng, size, fan_in)
        parts = np.split(w, np.cumsum([n for _, n in sources.values()])[:-1], axis=1)
        layer = f"hidden{depth}"
        feeds = {port: source for port, (source, _) in sources.items()}
        network.add(layer, Layer(dict(zip(sources, parts, strict=True)), bias, activation), feeds)
        sources = {layer: (layer, size)}
    (last, (_, size)) = next(iter(sources.items()))
    network.add("out", Layer({last: 0.3 * rng.normal(size=(1, size))}, [0.0]), {last: last})
    network.connect("out", "y")
    return network


def nguyen_widrow(network: Network, seed: int) -> Network:
    """Return the flat network with new weights: neurons of a sigmoid layer share its input range [-1, 1] (1990).

    Of H neurons with n inputs: |w_i| = 0.7 H^(1/n) in a random direction, b_i = +-|w_i| (2 i / (H - 1) - 1), i < H.

    A linear layer's weights on a sigmoid layer are drawn with deviation 0.3; frozen weights and all others stay. The
    networks of the thesis's benchmarks are `nguyen_widrow(noe(..., bypass=False), seed)`.
    """
    rng = np.random.default_rng(seed)
    flat = network.flatten()
    feeds, layers = flat.feeds(), flat.layers()
    values: dict[str, np.ndarray] = {}
    sigmoid = {n for n, layer in layers.items() if layer.function.is_sigmoid}
    for name, layer in layers.items():
        free = {p: w.shape[1] for p, w in layer.weights.items() if p not in layer.frozen}
        if name in sigmoid and free:
            w, bias = _shared_out(rng, layer.size, sum(free.values()))
            parts = np.split(w, np.cumsum(list(free.values()))[:-1], axis=1)
            values |= {f"{name}.{p}": part for p, part in zip(free, parts, strict=True)}
            values |= {} if "bias" in layer.frozen else {f"{name}.bias": bias}
        elif layer.is_linear:
            read = {p: n for p, n in free.items() if feeds[f"{name}.{p}"][0] in sigmoid}
            values |= {f"{name}.{p}": 0.3 * rng.normal(size=(layer.size, n)) for p, n in read.items()}
    return flat.with_parameters(values)


def _shared_out(rng: np.random.Generator, size: int, fan_in: int) -> tuple[np.ndarray, np.ndarray]:
    reach = 0.7 * size ** (1 / fan_in)
    w = rng.normal(size=(size, fan_in))
    w *= reach / np.linalg.norm(w, axis=1, keepdims=True)
    return w, reach * np.linspace(-1, 1, size) * np.sign(rng.normal(size=size))


def flow_rate(u: np.ndarray, p: np.ndarray, lap: float = 0.0) -> np.ndarray:
    """Flow into a chamber, normalised: u sqrt(1 - p) for u > 0, u sqrt(p) else (thesis 5.3.2.1).

    lap: of both edges, in the unit of u: > 0 closed centre (overlapped), < 0 open centre (underlapped).
    """
    return np.maximum(u - lap, 0) * np.sqrt(1 - p) - np.maximum(-u - lap, 0) * np.sqrt(p)


def flow_record(lap: float = 0.0) -> Record:
    """99 x 99 grid of spool in [-1, 1] and pressure in [0.01, 0.99]. lap: as for `flow_rate`."""
    u, p = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 99), np.linspace(0.01, 0.99, 99)))
    return Record({"u": u, "p": p}, {"y": flow_rate(u, p, lap)})


def divider_record() -> Record:
    """100 x 100 grid of omega in [-1, 1] and gamma in [-0.9, 0.9]."""
    omega, gamma = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 100), np.linspace(-0.9, 0.9, 100)))
    return Record({"omega": omega, "gamma": gamma}, {"y": omega / (gamma + 1)})


def fit_flow(seed: int, epochs: int = 800, progress: Progress = silent, lap: float = 0.0) -> Trained:
    """`Network Qa`: 2-10-10-1 on `flow_record` (table 5.3, #4). lap: as for `flow_rate`.

    `Network Qb` is its mirror: q_b(u, p) = -q_a(-u, p).
    """
    network = feedforward("flow", ["u", "p"], [10, 10], seed)
    return train(network, [flow_record(lap)], epochs=epochs, decay=1e-6, progress=progress)


def fit_divider(seed: int, epochs: int = 500, progress: Progress = silent) -> Trained:
    """`divider`: 2-20-1 on `divider_record`, omega / (gamma + 1) (5.3.2.2)."""
    network = feedforward("divider", ["omega", "gamma"], [20], seed)
    return train(network, [divider_record()], epochs=epochs, decay=1e-8, progress=progress)
