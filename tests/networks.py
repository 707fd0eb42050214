"""Networks that several tests use: a small one, and random ones with nested modules, feedback, every activation."""

from pathlib import Path

import numpy as np
import scipy.io

from greygate.models.activations import ACTIVATIONS
from greygate.models.network import Layer, Network, Port

TAME = tuple(
    a for a, f in ACTIVATIONS.items() if a not in ("square", "product") and not f.steep
)  # they diverge in a loop


def delay_line() -> Network:
    """One layer that reads its input, that of two steps before, and itself: small enough to work out by hand."""
    network = Network("line", [Port("u", "V", scale=2.0, offset=1.0, initial=5.0)], [Port("y", "m", scale=10.0)])
    network.add("sum", Layer({"now": [[1.0]], "old": [[0.5]], "own": [[0.25]]}, [0.1], initial=0.2))
    network.connect("u", "sum.now")
    network.connect("u", "sum.old", delay=2)
    network.connect("sum", "sum.own", delay=1)
    network.connect("sum", "y")
    return network


def recorded_line(folder: Path) -> None:
    """Write a recording as r.mat, another as a.csv, and the delay line as `line`."""
    t = np.arange(300) * 1e-3
    scipy.io.savemat(folder / "r.mat", {"t": t, "u": np.sin(40 * t), "y": np.cos(40 * t)})
    rows = "".join(f"{k * 1e-3:.3f},{k % 5},{k % 3}\n" for k in range(200))
    (folder / "a.csv").write_text("t_s,u_V,y_m\n" + rows)
    delay_line().save(folder / "line")


def random_network(seed: int, nested: bool = True, activations: tuple[str, ...] = TAME) -> Network:
    """A legal network with feedback, tame enough not to diverge. The seed names it."""
    rng = np.random.default_rng(seed)

    def ports(prefix, count):
        return [
            Port(
                f"{prefix}{i}",
                "1",
                scale=float(rng.choice([1.0, 0.5, 3.0])),
                offset=float(rng.choice([0.0, 0.2])),
                size=int(rng.integers(1, 3)),
                initial=float(rng.choice([0.0, 0.1])),
            )
            for i in range(count)
        ]

    def fill(network: Network, depth: int) -> None:
        sources = {p.name: p.size for p in network.inputs}
        names = [f"m{i}" for i in range(rng.integers(2, 6))]
        layers = {}
        for name in names:
            if depth and rng.random() < 0.3:
                inner = Network(name, ports("i", 1), ports("o", 1))
                fill(inner, depth - 1)
                network.add(name, inner)
                before = rng.choice(list(sources))
                size = inner.inputs[0].size
                network.connect(before, f"{name}.i0", int(rng.integers(0, 3)), _gain(rng, size, sources[before]))
                sources[name] = inner.outputs[0].size
                continue
            size = int(rng.integers(1, 5))
            layers[name] = size
            reads = {}
            for i in range(rng.integers(1, 4)):
                feedback = rng.random() < 0.4
                source = str(rng.choice([*layers, *sources] if feedback else list(sources)))
                width = layers.get(source) or sources[source]
                delay = int(rng.integers(1, 4)) if source in layers else int(rng.integers(0, 3))
                reads[f"p{i}"] = (source, width, delay)
            norm = 0.8 / np.sqrt(sum(w for _, w, _ in reads.values()) * len(reads))
            activation = str(rng.choice(activations))
            rows = size * ACTIVATIONS[activation].rows
            weights = {p: norm * rng.uniform(-1, 1, (rows, w)) for p, (_, w, _) in reads.items()}
            if rng.random() < 0.2:
                weights = {p: w * (rng.random(w.shape) < 0.5) for p, w in weights.items()}
            network.add(
                name,
                Layer(
                    weights,
                    rng.uniform(-0.3, 0.3, rows) * (rng.random() < 0.7),
                    activation,
                    initial=rng.uniform(-0.2, 0.2, size) * (rng.random() < 0.5),
                    frozen=frozenset({"bias"} if rng.random() < 0.2 else ()),
                ),
            )
            for p, (source, width, delay) in reads.items():
                gain = _gain(rng, width, width) if rng.random() < 0.3 else None
                network.connect(source, f"{name}.{p}", delay, gain)
            if rng.random() < 0.2:
                source = str(rng.choice(list(sources)))
                port = next(iter(reads))
                network.connect(source, f"{name}.{port}", 1, _gain(rng, reads[port][1], sources[source]))
            sources[name] = size
        for p in network.outputs:
            source = str(rng.choice([n for n in sources if n in names]))
            network.connect(source, p.name, int(rng.random() < 0.2), _gain(rng, p.size, sources[source]))

    network = Network(f"random_{seed}", ports("u", int(rng.integers(1, 3))), ports("y", int(rng.integers(1, 3))))
    fill(network, int(nested))
    return network


def _gain(rng, rows: int, columns: int):
    if rows == columns and rng.random() < 0.5:
        return float(rng.uniform(-0.5, 0.5))
    return rng.uniform(-0.4, 0.4, (rows, columns))


def random_inputs(network: Network, steps: int, seed: int) -> dict[str, np.ndarray]:
    """One sequence for every input, within twice its scale."""
    rng = np.random.default_rng(seed)
    found = {}
    for p in network.inputs:
        value = p.offset + p.scale * rng.uniform(-1.5, 1.5, (steps, p.size))
        found[p.name] = value[:, 0] if p.size == 1 else value
    return found
