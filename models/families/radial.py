"""Radial basis function networks: Gaussian neurons of a distance, k-means centres, recursive least squares.

    y_hat(k) = sum_i w_i exp(-|(phi(k) - c_i) / s_i|^2) + b

The squared distance is expanded, |(phi - c)/s|^2 = phi^2 . 1/s^2 - phi . 2c/s^2 + |c/s|^2, so that it is a sum over
taps and their squares. It takes one `square` for each tap, whatever the number of neurons, and one `negexp` for each
neuron. In hardware each of them is a lookup with one argument, and no two signals are multiplied.
"""

from collections.abc import Sequence
from time import monotonic

import numpy as np
from scipy.cluster.vq import ClusterError, kmeans2
from scipy.spatial.distance import cdist

from greygate.errors import InputError
from greygate.models.families.regression import Taps, regressors, with_full_taps
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import Outcome, Trained
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record


def radial(
    name: str,
    inputs: Taps,
    output: Port,
    feedback: Sequence[int],
    centres: np.ndarray,
    widths: np.ndarray,
) -> Network:
    """Gaussian neurons on the taps of `regression`, their output weights zero.

    centres: (neurons, taps), normalised as the ports. widths: s, (neurons, taps) or a shape that broadcasts to it.
    Trained with a teacher it is a NARX network, without one a NOE network.
    Raises InputError for other shapes, widths that are not positive, and taps as in `regression`.
    """
    taps = {f"{port.name}_z{d}": (port.name, d) for port, delays in inputs.items() for d in delays}
    taps |= {f"{output.name}_z{d}": ("sum", d) for d in feedback}
    if any(d < (source == "sum") for source, d in taps.values()):
        raise InputError(f"network {name}: taps {', '.join(taps)}; an input's start at 0, the output's own at 1")
    centres = np.atleast_2d(np.asarray(centres, float))
    if centres.shape[1] != len(taps) or not (np.asarray(widths) > 0).all():
        raise InputError(f"network {name}: centres {centres.shape} for {len(taps)} taps; widths must be positive")
    precision = 1 / np.broadcast_to(widths, centres.shape) ** 2
    squares = dict(zip(taps, np.eye(len(taps))[:, :, None], strict=True))
    cross = dict(zip(taps, (-2 * precision * centres).T[:, :, None], strict=True))
    network = Network(name, list(inputs), [output])
    network.add("squares", Layer(squares, np.zeros(len(taps)), "square", frozen=frozenset({*taps, "bias"})))
    kernels = {"squares": precision, **cross}
    network.add("kernels", Layer(kernels, (precision * centres**2).sum(1), "negexp"))
    network.add("sum", Layer({"kernels": np.zeros((1, len(centres)))}, [0.0], initial=output.rest))
    for port, (source, delay) in taps.items():
        network.connect(source, f"squares.{port}", delay)
        network.connect(source, f"kernels.{port}", delay)
    network.connect("squares", "kernels.squares")
    network.connect("kernels", "sum.kernels")
    network.connect("sum", output.name)
    return network.check()


def rbf(
    records: Sequence[Record],
    inputs: Taps,
    output: Port,
    feedback: Sequence[int],
    neurons: int,
    seed: int = 0,
    overlap: float = 3.0,
    name: str = "rbf",
) -> Trained:
    """Identify a radial network as NARX: centres by k-means, widths by their neighbours, output by least squares.

    Moody, Darken 1989. A width is `overlap` times the root mean square distance to the two nearest centres, with each
    tap divided by its standard deviation. `RecursiveLeastSquares` over all rows finds the output weights. `train` can
    then move centres and widths too.
    Raises InputError as `regressors`, and if there are not more different rows than neurons.
    """
    began = monotonic()
    phi = regressors(records, inputs, output, feedback)
    if not 0 < neurons < len(np.unique(phi.matrix, axis=0)):
        raise InputError(f"network {name}: {neurons} neurons for fewer rows that differ; take fewer or record longer")
    spread = phi.matrix.std(0)
    spread[spread <= 1e-12] = 1.0
    try:
        centres, _ = kmeans2(phi.matrix / spread, neurons, iter=50, minit="++", missing="raise", rng=seed)
    except ClusterError:
        raise InputError(f"network {name}: the rows form fewer than {neurons} clusters; take fewer neurons") from None
    apart = np.sort(cdist(centres, centres), axis=1)[:, 1:3]
    widths = overlap * np.sqrt(np.mean(apart**2, axis=1, keepdims=True)) if neurons > 1 else np.full((1, 1), overlap)
    network = radial(name, inputs, output, feedback, centres * spread, widths * spread)
    estimator = RecursiveLeastSquares(neurons + 1)
    distance = cdist(phi.matrix / spread, centres) / widths.T
    for row, target in zip(np.exp(-(distance**2)), phi.target, strict=True):
        estimator.update(np.append(row, 1.0), target)
    weights = {"sum.kernels": estimator.theta[None, :-1], "sum.bias": estimator.theta[-1:]}
    objective = Objective(network.with_parameters(weights), with_full_taps(records, inputs, feedback), teacher=True)
    loss = objective.squares(objective.theta) / (2 * objective.samples)
    return Trained(objective.unpack(objective.theta), Outcome.CONVERGED, (loss,), monotonic() - began)


class RecursiveLeastSquares:
    """Minimises sum_i f^(k-i) (y_i - phi_i' theta)^2 + f^k |theta - start|^2 / variance over theta after each sample.

    forgetting f: 1 weighs all samples alike; below 1, the last 1 / (1 - f) count most and theta follows a plant that
    changes. variance: of the start, in theta's units squared. The covariance is kept as its square root (Potter's form,
    Bierman 1977), so it stays positive definite. One update costs O(size^2).
    """

    def __init__(self, size: int, forgetting: float = 1.0, variance: float = 1e8, start: np.ndarray | float = 0.0):
        if not 0 < forgetting <= 1 or variance <= 0:
            raise InputError(f"recursive least squares: forgetting {forgetting} in (0, 1] and variance {variance} > 0")
        self.theta = np.array(np.broadcast_to(np.asarray(start, float), size))
        self.forgetting = forgetting
        self._root = np.sqrt(variance) * np.eye(size)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of theta for errors of variance one, (size, size)."""
        return self._root @ self._root.T

    def update(self, phi: np.ndarray, y: float) -> float:
        """Learn one sample, phi (size,), and return its error before the update.

        Raises InputError for a sample that is not finite.
        """
        error = float(y - phi @ self.theta)
        if not np.isfinite(error):
            raise InputError("recursive least squares: a sample holds NaN or inf; leave it out")
        seen = self._root.T @ phi
        total = self.forgetting + seen @ seen
        gain = self._root @ seen / total
        self.theta += gain * error
        self._root -= np.outer(gain, seen) / (1 + np.sqrt(self.forgetting / total))
        self._root /= np.sqrt(self.forgetting)
        return error
