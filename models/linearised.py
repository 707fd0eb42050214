"""A network about a point of its run: poles, and the frequency response from every input to every output."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greygate.models.activations import ACTIVATIONS
from greygate.models.layer import Layer
from greygate.models.network import Network
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record


@dataclass(frozen=True)
class Linearised:
    """x(k) = sum over d of taps[d] x(k - d) + drives[d] u(k - d), of small deviations, normalised.

    x: every layer's elements (X,), u: the inputs' (U,). taps: delay -> (X, X). drives: delay -> (X, U). shown: element
    of each output column. gains: (outputs, U) from normalised to the ports' units.
    """

    taps: dict[int, np.ndarray]
    drives: dict[int, np.ndarray]
    shown: np.ndarray
    gains: np.ndarray

    def poles(self) -> np.ndarray:
        """Eigenvalues of one step (P,), the slowest first; poles of 0, of what is only passed on, are left out."""
        late = {d: a for d, a in self.taps.items() if d}
        if not late:
            return np.zeros(0, complex)
        at_once = np.linalg.inv(np.eye(len(self.taps[0])) - self.taps[0])
        read = np.flatnonzero(np.any([a.any(axis=0) for a in late.values()], axis=0))
        size, deepest = len(read), max(late)
        step = np.eye(size * deepest, k=-size)
        for d, a in late.items():
            step[:size, size * (d - 1) : size * d] = (at_once @ a)[np.ix_(read, read)]
        found = np.linalg.eigvals(step)
        found = found[np.abs(found) > PASSED_ON]
        return found[np.lexsort((found.imag, -np.abs(found)))]

    def response(self, frequency: Sequence[float] | np.ndarray, period: float) -> np.ndarray:
        """Complex (F, outputs, U) at frequencies (F,) in Hz, in the output's unit per the input's. period: s."""
        found = np.empty((len(frequency), *self.gains.shape), complex)
        for i, z in enumerate(np.exp(-2j * np.pi * np.asarray(frequency) * period)):
            loop = np.eye(len(self.taps[0])) - sum(a * z**d for d, a in self.taps.items())
            driven = sum(b * z**d for d, b in self.drives.items())
            found[i] = np.linalg.solve(loop, driven)[self.shown] * self.gains
        return found


PASSED_ON = 1e-9  # modulus below which a pole is that of a value which is merely passed on


def linearised(network: Network, record: Record) -> Linearised | None:
    """The network about the means of its signals over a free run of the record; None where that run diverges.

    A limit, a switch or a table is taken as it is there. Raises InputError as `Objective`.

    >>> about = linearised(lag, record)
    >>> about.poles().round(6).tolist()
    [(0.9+0j)]
    """
    objective = Objective(network, [record])
    runs = objective.simulate(objective.theta)
    if runs is None:
        return None
    flat, elements = objective.flat, objective.elements()
    mean = runs[0][record.skip :].mean(axis=0)
    inputs = sum(p.size for p in flat.inputs)
    size = len(mean) - inputs
    feeds = flat.feeds()
    delays = sorted({0, *(d for _, d in feeds.values())})
    joined = {d: np.zeros((size, inputs + size)) for d in delays}
    for name, layer in flat.layers().items():
        sources = {port: feeds[f"{name}.{port}"] for port in layer.weights}
        at = {port: mean[elements[source]] for port, (source, _) in sources.items()}
        for slope, rows in _slopes(layer, at):
            for port, (source, delay) in sources.items():
                here = np.ix_(elements[name] - inputs, elements[source])
                joined[delay][here] += slope[:, None] * layer.weights[port][rows]
    columns = np.concatenate([elements[feeds[p.name][0]] for p in flat.outputs]) - inputs
    scales = [np.concatenate([np.full(p.size, p.scale) for p in ports]) for ports in (flat.outputs, flat.inputs)]
    return Linearised(
        {d: a[:, inputs:] for d, a in joined.items()},
        {d: a[:, :inputs] for d, a in joined.items()},
        columns,
        scales[0][:, None] / scales[1][None, :],
    )


def _slopes(layer: Layer, at: dict[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    """(slope of each neuron (size,), a row of weights that acts) where its ports stand at these values."""
    n = layer.bias + sum(layer.weights[port] @ value for port, value in at.items())
    kind = ACTIVATIONS[layer.activation]
    rows = np.arange(layer.size)
    if kind.lowered == "product":
        return [(n[layer.size :], rows), (n[: layer.size], rows + layer.size)]
    if kind.rows > 1:  # condition, value where that is >= 0, value else
        rows = rows + np.where(n[: layer.size] >= 0, layer.size, 2 * layer.size)
    y = kind.value(np, n)
    both = zip(y, n[rows], strict=True)
    return [(np.array([kind.slope(np, *(pair if kind.slope_reads_n else pair[:1])) for pair in both]), rows)]
