"""Radial basis function networks: Gaussian neurons of a distance, k-means centres, recursive least squares.

    y_hat(k) = sum_i w_i exp(-|(phi(k) - c_i) / s_i|^2) + b

The squared distance is expanded, |(phi - c)/s|^2 = phi^2 . 1/s^2 - phi . 2c/s^2 + |c/s|^2, so that it is a sum over
taps and their squares. It takes one `square` for each tap, whatever the number of neurons, and one `negexp` for each
neuron. In hardware each of them is a lookup with one argument, and no two signals are multiplied.
"""

from collections.abc import Sequence

import numpy as np
from scipy.cluster.vq import ClusterError, kmeans2
from scipy.spatial.distance import cdist

from greygate.errors import InputError
from greygate.models.families.regression import Taps, regressors, tapped
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

OVERLAP = 3.0  # of neighbouring neurons: a width over the distance to the nearest centres
VARIANCE = 1e8  # of weights before the first row, normalised: as good as unknown


def radial(
    name: str, inputs: Taps, output: Port, feedback: Sequence[int], centres: np.ndarray, widths: np.ndarray
) -> Network:
    """Gaussian neurons on the taps of `noe`, their output weights zero.

    centres: (neurons, taps), normalised as the ports. widths: s, (neurons, taps) or a shape that broadcasts to it.
    Trained with a teacher it is a NARX network, without one a NOE network.
    Raises InputError for other shapes, widths that are not positive, and taps as in `noe`.
    """
    taps = tapped(name, inputs, output, feedback)
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
    name: str = "rbf",
) -> Network:
    """Identify a radial network as NARX: centres by k-means, widths by their neighbours, output by least squares.

    Moody, Darken 1989. A width is OVERLAP times the root mean square distance to the two nearest centres, with each
    tap divided by its standard deviation. Recursive least squares over all rows find the output weights. `train` can
    then move centres and widths too.
    Raises InputError as `regressors`, and if there are not more different rows than neurons.
    """
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
    widths = OVERLAP * np.sqrt(np.mean(apart**2, axis=1, keepdims=True)) if neurons > 1 else np.full((1, 1), OVERLAP)
    network = radial(name, inputs, output, feedback, centres * spread, widths * spread)
    distance = cdist(phi.matrix / spread, centres) / widths.T
    theta = recursive_least_squares(np.column_stack([np.exp(-(distance**2)), np.ones(len(distance))]), phi.target)
    return network.with_parameters({"sum.kernels": theta[None, :-1], "sum.bias": theta[-1:]}).flatten()


def recursive_least_squares(rows: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """theta (size,) that minimises sum_i (y_i - phi_i' theta)^2 + |theta|^2 / VARIANCE, rows phi (N, size) one by one.

    The covariance is kept as its square root (Potter's form, Bierman 1977), so it stays positive definite.
    """
    theta, root = np.zeros(rows.shape[1]), np.sqrt(VARIANCE) * np.eye(rows.shape[1])
    for phi, y in zip(rows, targets, strict=True):
        seen = root.T @ phi
        total = 1.0 + seen @ seen
        gain = root @ seen / total
        theta += gain * float(y - phi @ theta)
        root -= np.outer(gain, seen) / (1 + np.sqrt(1.0 / total))
    return theta
