"""Linear models of given orders: ARX, FIR, ARMAX, OE and BJ (thesis table 3.1)."""

from collections.abc import Sequence
from dataclasses import replace
from time import monotonic

import numpy as np

from greygate.errors import InputError
from greygate.models.families.regression import Regressors, Taps, noe, regressors
from greygate.models.network import Port
from greygate.models.training.levenberg import Outcome, Trained, train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

from .noise import box_jenkins, narmax, with_measured

SAME = 1e-9  # a regressor is collinear if the others explain it up to this residual, relative to its size
INSIDE = 0.98  # radius into which the poles of an unstable start are drawn

# ---- networks


def faults(phi: Regressors) -> list[str]:
    """Reasons why the weights are not unique, a sentence each: constant or collinear regressors, too few rows."""
    found = []
    rows, columns = phi.matrix.shape
    if rows <= columns + 1:
        return [f"{rows} rows for {columns} taps and a bias: record longer or lower the orders"]
    centred = phi.matrix - phi.matrix.mean(0)
    size = np.abs(phi.matrix).max(0)
    constant = np.abs(centred).max(0) <= 1e-12 * np.maximum(size, 1e-300)
    signals = {tap: tap.rpartition("_z")[0] for tap in phi.taps}
    for name in dict.fromkeys(signals.values()):
        of = [i for i, tap in enumerate(phi.taps) if signals[tap] == name]
        if constant[of].all():
            found.append(f"{name} is constant, which is no excitation: vary it or leave it out")
    known: list[int] = []
    scaled = centred / np.where(constant, 1.0, np.linalg.norm(centred, axis=0))
    triangle = np.asarray(np.linalg.qr(scaled, mode="r"))
    for i in np.flatnonzero(~constant).tolist():
        column, basis = triangle[:, i], triangle[:, known]
        share = np.linalg.lstsq(basis, column, rcond=None)[0] if known else np.zeros(0)
        if np.linalg.norm(column - basis @ share) > SAME:
            known.append(i)
            continue
        others = [phi.taps[j] for j, s in zip(known, share, strict=True) if abs(s) > 1e-6]
        found.append(f"{phi.taps[i]} is collinear with {', '.join(others)}: leave one out or excite more richly")
    return found


def arx(records: Sequence[Record], inputs: Taps, output: Port, feedback: Sequence[int], name: str = "arx") -> Trained:
    """Least-squares solution of y(k) = sum b_d u(k-d) + sum a_d y(k-d) + bias + e(k).

    Linear fits omit the rows with taps before the start of a record. Raises InputError as `regressors`, and naming the
    regressors whose weights are not unique.
    """
    began = monotonic()
    phi = regressors(records, inputs, output, feedback)
    if found := faults(phi):
        raise InputError(f"{name}: {'; '.join(found)}")
    solution = np.linalg.lstsq(np.column_stack([phi.matrix, np.ones(len(phi.target))]), phi.target)[0]
    weights = {f"sum.{tap}": np.array([[w]]) for tap, w in zip(phi.taps, solution[:-1], strict=True)}
    network = noe(name, inputs, output, feedback).with_parameters(weights | {"sum.bias": solution[-1:]})
    objective = Objective(network, with_full_taps(records, inputs, feedback), teacher=True)
    loss = objective.squares(objective.theta) / (2 * objective.samples)
    return Trained(objective.unpack(objective.theta), Outcome.CONVERGED, (loss,), monotonic() - began)


def fir(records: Sequence[Record], inputs: Taps, output: Port, name: str = "fir") -> Trained:
    """Least-squares solution of y(k) = sum b_d u(k-d) + bias + e(k), as `arx`."""
    return arx(records, inputs, output, (), name)


def armax(
    records: Sequence[Record],
    inputs: Taps,
    output: Port,
    feedback: Sequence[int],
    noise: Sequence[int],
    name: str = "armax",
) -> Trained:
    """`arx` with the noise e(k) + sum c_d e(k-d), trained from the ARX solution. Raises as `arx`."""
    start = arx(records, inputs, output, feedback, name).network
    network = narmax(name, inputs, output, feedback, noise).with_parameters(start.parameters())
    given = [with_measured(r, network) for r in with_full_taps(records, inputs, (*feedback, *noise))]
    return train(network, given, teacher=True, epochs=300)


def oe(records: Sequence[Record], inputs: Taps, output: Port, feedback: Sequence[int], name: str = "oe") -> Trained:
    """y_hat(k) = sum b_d u(k-d) + sum a_d y_hat(k-d) + bias with the least error in free run.

    It is trained from the ARX solution. The free run starts from rest, so a record that does not should `skip` its
    beginning. If the ARX solution is unstable, its poles are first drawn inside the unit circle. Raises as `arx`.
    """
    weights = _stable(arx(records, inputs, output, feedback, name).network.parameters(), output, feedback)
    start = noe(name, inputs, output, feedback).with_parameters(weights)
    return train(start, with_full_taps(records, inputs, feedback), epochs=300)


def bj(
    records: Sequence[Record],
    inputs: Taps,
    output: Port,
    feedback: Sequence[int],
    noise: Sequence[int],
    shaping: Sequence[int],
    name: str = "bj",
) -> Trained:
    """`oe` with a noise filter beside it (`box_jenkins`), trained from the OE solution. Raises as `arx`."""
    network = box_jenkins(oe(records, inputs, output, feedback, name).network, noise, shaping)
    given = [with_measured(r, network) for r in with_full_taps(records, inputs, (*feedback, *noise, *shaping))]
    return train(network, given, epochs=300)


def _stable(weights: dict[str, np.ndarray], output: Port, feedback: Sequence[int]) -> dict[str, np.ndarray]:
    """The weights; if a pole lies outside, a_d is multiplied by radius^d, which draws every pole in by that radius."""
    own = {d: f"sum.{output.name}_z{d}" for d in feedback}
    polynomial = np.zeros(max(feedback, default=0) + 1)
    polynomial[0] = 1.0
    for d, port in own.items():
        polynomial[d] = -weights[port][0, 0]
    largest = np.abs(np.roots(polynomial)).max(initial=0.0)
    radius = INSIDE / largest if largest >= 1 else 1.0
    return weights | {port: weights[port] * radius**d for d, port in own.items()}


def with_full_taps(records: Sequence[Record], inputs: Taps, delays: Sequence[int]) -> list[Record]:
    """The records, each counted from its first sample whose taps all lie within it."""
    deepest = max([*(d for taps in inputs.values() for d in taps), *delays], default=0)
    return [replace(r, skip=max(r.skip, deepest)) for r in records]
