"""Regression networks on tapped delay lines (thesis table 3.1) and their linear counterparts.

    y_hat(k) = W_lin phi(k) + W_out tansig( ... tansig(W phi(k) + b) ... ) + b_out
    phi(k) = inputs u_i(k - d), the output's past (k - d), prediction errors e(k - d) = y(k - d) - y_hat(k - d)

One network is two models: `train(..., teacher=True)` feeds back the measured output, `teacher=False` the network's own:

    built by                     teacher=True     teacher=False    linear: hidden=()
    noe (narx is the same)       NARX             NOE              ARX, OE
    narmax (nbj is the same)     NARMAX           NBJ              ARMAX
    nfir                         NFIR             NFIR             FIR

A network with e among its regressors has the measured output as a further input; `with_measured` adds it to a record. A
free run has no measurement, so e = 0 there; `free_run` makes that network. `box_jenkins` adds a noise filter instead.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from time import monotonic

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import Outcome, Trained, train
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record

Taps = Mapping[Port, Sequence[int]]
Named = Taps | Mapping[str, Sequence[int]]  # a name alone is a port without unit and scale
SAME = 1e-9  # a regressor is collinear if the others explain it up to this residual, relative to its size
INSIDE = 0.98  # radius into which the poles of an unstable start are drawn

# ---- networks


def regression(
    name: str,
    inputs: Named,
    output: Port | str,
    feedback: Sequence[int] = (),
    noise: Sequence[int] = (),
    hidden: Sequence[int] | int = (),
    seed: int = 0,
    *,
    linear_loop: bool = False,
    bypass: bool = True,
    activation: str = "tansig",
) -> Network:
    """A network on the taps u(k-d), d in `inputs[port]` >= 0, and y(k-d), e(k-d), d in `feedback` and `noise` >= 1.

    Several inputs are several ports; several outputs are one port of that size, and each reads the past of all. A name
    stands for a port without unit and scale.
    hidden: neurons of each hidden layer, or of the only one; () gives the linear model of the same orders. Taps need
    not be neighbours: with wider spacing, a slow plant that is sampled fast does not need large weights that cancel.
    linear_loop: the first hidden layer reads only the inputs (Hammerstein form). Then the only loop is linear, so the
    free run is stable if its poles are.
    bypass: the taps of the hidden layers also reach the output directly (not in the thesis's networks).
    The network starts as y(k) = y(k - feedback[0]) if the output reads that tap. Hidden weights are drawn from `seed`
    at a size that keeps tansig near linear. Raises InputError for a tap that would look ahead or close a loop without
    delay.
    """
    hidden = (hidden,) if isinstance(hidden, int) else hidden
    inputs, output = {_port(p): _delays(name, "inputs", d) for p, d in inputs.items()}, _port(output)
    feedback, noise = _delays(name, "feedback", feedback), _delays(name, "noise", noise)
    taps = {f"{port.name}_z{d}": (port.name, d) for port, delays in inputs.items() for d in delays}
    taps |= {f"{output.name}_z{d}": ("sum", d) for d in feedback} | {f"e_z{d}": ("e", d) for d in noise}
    sizes = {port.name: port.size for port in inputs} | dict.fromkeys(("sum", "e"), output.size)
    if any(d < (source in ("sum", "e")) for source, d in taps.values()):
        raise InputError(f"network {name}: taps {', '.join(taps)}; an input's start at 0, the output's own at 1")
    rng = np.random.default_rng(seed)
    network = Network(name, list(inputs), [output])
    last = {port: tap for port, tap in taps.items() if not (linear_loop and tap[0] in ("sum", "e"))}
    direct = {port: tap for port, tap in taps.items() if bypass or not hidden or port not in last}
    fed = {port: sizes[source] for port, (source, _) in last.items()}
    for depth, size in enumerate(hidden, 1):
        layer, fan_in = f"hidden{depth}", sum(fed.values())
        weights = {port: rng.normal(size=(size, n)) / np.sqrt(fan_in) for port, n in fed.items()}
        network.add(layer, Layer(weights, rng.normal(size=size), activation))
        for port, (source, delay) in last.items():
            network.connect(source, f"{layer}.{port}", delay)
        fed, last = {layer: size}, {layer: (layer, 0)}
    weights = {port: np.zeros((output.size, sizes[source])) for port, (source, _) in direct.items()}
    if feedback and f"{output.name}_z{feedback[0]}" in direct:
        weights[f"{output.name}_z{feedback[0]}"] = np.eye(output.size)
    if hidden:
        weights |= {port: 0.01 * rng.normal(size=(output.size, n)) for port, n in fed.items()}
    network.add("sum", Layer(weights, np.zeros(output.size), initial=output.rest))
    for port, (source, delay) in (direct | last).items():
        network.connect(source, f"sum.{port}", delay)
    network.connect("sum", output.name)
    if noise:
        _measure(network, "e", "sum")
    return network.check()


def _port(given: Port | str) -> Port:
    return Port(given) if isinstance(given, str) else given


def _delays(name: str, argument: str, given: Sequence[int]) -> Sequence[int]:
    """Raises InputError, naming the argument, for what is no list of delays."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(f"network {name}: {argument} {given!r} is no list of delays; write ({given},) for one delay")
    return given


def noe(
    name: str,
    inputs: Named,
    output: Port | str,
    feedback: Sequence[int],
    hidden: Sequence[int] | int = (),
    seed: int = 0,
    linear_loop: bool = False,
    **options,
) -> Network:
    """Network on inputs and the output's past: NARX if trained with a teacher, else NOE. options: of `regression`."""
    return regression(name, inputs, output, feedback, (), hidden, seed, linear_loop=linear_loop, **options)


narx = noe


def narmax(
    name: str,
    inputs: Named,
    output: Port | str,
    feedback: Sequence[int],
    noise: Sequence[int],
    hidden: Sequence[int] | int = (),
    seed: int = 0,
    **options,
) -> Network:
    """Network on inputs, the output's past and errors: NARMAX if trained with a teacher, else NBJ (of table 3.1).

    Records need the measured output as an input: `with_measured`. options: of `regression`.
    """
    return regression(name, inputs, output, feedback, noise, hidden, seed, **options)


nbj = narmax


def nfir(
    name: str, inputs: Named, output: Port | str, hidden: Sequence[int] | int = (), seed: int = 0, **options
) -> Network:
    """Network on inputs only, which has no loop and so is always stable. options: of `regression`."""
    return regression(name, inputs, output, (), (), hidden, seed, **options)


def box_jenkins(plant: Network, noise: Sequence[int], shaping: Sequence[int]) -> Network:
    """y_hat(k) = w(k) + sum_d p_d v(k-d) + sum_d q_d e(k-d), v = y - w, e = y - y_hat; w: the plant's free run.

    Box, Jenkins 1970: y = w + (C/D) e with C = 1 + q_1 z^-1 + ... (d in `noise`) and D = 1 - p_1 z^-1 - ... (d in
    `shaping`), which share no pole with the plant. plant: a network of one output, such as `noe` builds. It feeds back
    its own output, so train without a teacher, on records `with_measured`. The weights of the filter start at zero.
    Raises InputError for a delay below 1 or a plant of several outputs.
    """
    if [p.size for p in plant.outputs] != [1] or min((*noise, *shaping), default=1) < 1:
        raise InputError(f"network {plant.name}: a noise filter needs one scalar output and delays of 1 or more")
    flat = plant.flatten()
    output = plant.outputs[0]
    source, delay = flat.feeds()[output.name]
    network = replace(flat, name=plant.name, outputs=[output])
    network.connections = [c for c in flat.connections if c.target != output.name]
    taps = {f"v_z{d}": ("v", d) for d in shaping} | {f"e_z{d}": ("e", d) for d in noise}
    weights = {"plant": [[1.0]]} | {port: [[0.0]] for port in taps}
    network.add("predicted", Layer(weights, [0.0], initial=output.rest, frozen={"plant", "bias"}))
    for port, (name, d) in ({"plant": (source, delay)} | taps).items():
        network.connect(name, f"predicted.{port}", d)
    network.connect("predicted", output.name)
    for name, of in (("v", source), ("e", "predicted")):
        if any(tap[0] == name for tap in taps.values()):
            _measure(network, name, of)
    return network.check()


def free_run(network: Network) -> Network:
    """The network that needs no measurement: y_hat stands for y, so every e is 0 and its taps vanish.

    Layers that read a measured output are removed, with all that reads them. A network without such layers is returned
    flat and otherwise unchanged.
    """
    flat = network.flatten()
    measured = {_measured(p).name for p in flat.outputs} & {p.name for p in flat.inputs}
    gone = {c.target.rpartition(".")[0] for c in flat.connections if c.source in measured}
    kept = [c for c in flat.connections if not {c.source, c.target.rpartition(".")[0]} & (gone | measured)]
    targets = {c.target for c in kept}
    modules: dict[str, Layer | Network] = {}
    for name, layer in flat.layers().items():
        if name not in gone:
            weights = {p: w for p, w in layer.weights.items() if f"{name}.{p}" in targets}
            modules[name] = replace(layer, weights=weights, frozen=layer.frozen & {*weights, "bias"})
    inputs = [p for p in flat.inputs if p.name not in measured]
    return replace(flat, inputs=inputs, modules=modules, connections=kept).check()


def with_measured(record: Record, network: Network) -> Record:
    """The record with those targets as further inputs that the network asks for, as `NAME_measured`."""
    asked = {p.name for p in network.inputs}
    given = {_measured(p).name: record.targets[p.name] for p in network.outputs if _measured(p).name in asked}
    return replace(record, inputs={**record.inputs, **given})


def _measured(output: Port) -> Port:
    return replace(output, name=f"{output.name}_measured")


def _measure(network: Network, name: str, of: str) -> None:
    """Add layer `name`: measured output less layer `of`, at this step."""
    port = _measured(network.outputs[0])
    one = np.eye(port.size)
    if port not in network.inputs:
        network.inputs.append(port)
    frozen = {"measured", "model", "bias"}
    network.add(name, Layer({"measured": one, "model": -one}, np.zeros(port.size), frozen=frozen))
    network.connect(port.name, f"{name}.measured")
    network.connect(of, f"{name}.model")


# ---- the regression matrix


@dataclass(frozen=True)
class Regressors:
    """phi(k), normalised as in the network: matrix (M, T), target (M,), taps: name of each column, `u_z1`."""

    taps: tuple[str, ...]
    matrix: np.ndarray
    target: np.ndarray

    def faults(self) -> list[str]:
        """Reasons why the weights are not unique, a sentence each: constant or collinear regressors, too few rows."""
        found = []
        rows, columns = self.matrix.shape
        if rows <= columns + 1:
            return [f"{rows} rows for {columns} taps and a bias: record longer or lower the orders"]
        centred = self.matrix - self.matrix.mean(0)
        size = np.abs(self.matrix).max(0)
        constant = np.abs(centred).max(0) <= 1e-12 * np.maximum(size, 1e-300)
        signals = {tap: tap.rpartition("_z")[0] for tap in self.taps}
        for name in dict.fromkeys(signals.values()):
            of = [i for i, tap in enumerate(self.taps) if signals[tap] == name]
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
            others = [self.taps[j] for j, s in zip(known, share, strict=True) if abs(s) > 1e-6]
            found.append(f"{self.taps[i]} is collinear with {', '.join(others)}: leave one out or excite more richly")
        return found


def regressors(records: Sequence[Record], inputs: Taps, output: Port, feedback: Sequence[int] = ()) -> Regressors:
    """The regression matrix: rows k of every record, from the first one with all taps inside it (and from `skip`).

    Raises InputError for a signal that is missing, has another length or is not finite, and for too short records.
    """
    delays = [*(d for taps in inputs.values() for d in taps), *feedback]
    taps = [(port, d) for port, ds in inputs.items() for d in ds] + [(output, d) for d in feedback]
    rows, targets = [], []
    for record in records:
        y = _signal(record.targets, output)
        signals = {port.name: _signal(record.inputs, port) for port in inputs} | {output.name: y}
        for name, s in signals.items():
            if len(s) != len(y):
                raise InputError(f"input {name}: {len(s)} samples where {output.name} has {len(y)}")
        start = max([record.skip, *delays])
        if start < len(y):
            rows.append(np.stack([signals[p.name][start - d : len(y) - d] for p, d in taps], axis=1))
            targets.append(y[start:])
    if not rows:
        deepest = max(delays, default=0)
        raise InputError(f"output {output.name}: no record is longer than the deepest tap, {deepest}; lower the orders")
    return Regressors(tuple(f"{p.name}_z{d}" for p, d in taps), np.concatenate(rows), np.concatenate(targets))


def _signal(signals: Mapping[str, np.ndarray], port: Port) -> np.ndarray:
    if port.name not in signals:
        raise InputError(f"signal {port.name} [{port.unit}] is missing; given: {', '.join(signals) or 'nothing'}")
    value = port.normalised(np.asarray(signals[port.name], float))
    if value.ndim != 1:
        raise InputError(f"signal {port.name}: {value.shape}; give one number a sample")
    bad = np.flatnonzero(~np.isfinite(value))
    if len(bad):
        raise InputError(
            f"signal {port.name}: NaN or inf at sample {bad[0]} ({len(bad)} in all); repair or cut the record"
        )
    return value


# ---- linear models, the baselines for a network


def arx(records: Sequence[Record], inputs: Taps, output: Port, feedback: Sequence[int], name: str = "arx") -> Trained:
    """Least-squares solution of y(k) = sum b_d u(k-d) + sum a_d y(k-d) + bias + e(k).

    Linear fits omit the rows with taps before the start of a record. Raises InputError as `regressors`, and naming the
    regressors whose weights are not unique.
    """
    began = monotonic()
    phi = regressors(records, inputs, output, feedback)
    if faults := phi.faults():
        raise InputError(f"{name}: {'; '.join(faults)}")
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


def with_full_taps(records: Sequence[Record], inputs: Taps, delays: Sequence[int]) -> list[Record]:
    """The records, each counted from its first sample whose taps all lie within it."""
    deepest = max([*(d for taps in inputs.values() for d in taps), *delays], default=0)
    return [replace(r, skip=max(r.skip, deepest)) for r in records]


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
