"""Linear models of the same dynamics, each fitted under its own idea of the noise (Ljung 1999, chapter 4).

OE and FIR are fitted to their free run. ARX predicts one step from the measured output; ARMAX and BJ do, too, with a
model of the noise beside, which the free run then leaves out.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greygate.identify.ladder import ARMAX, ARX, LOOP, Form, Orders, own
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record

MEASURED, REST, PREDICTED, ERROR = "measured", "rest", "predicted", "error"  # an input, and layers, of a predictor
TAUGHT = 5  # epochs one step ahead, which make a linear model ARX


def taught(start: Network, pieces: Sequence[Record]) -> Trained:
    """The model as ARX: one step ahead from the measured output, a problem of least squares."""
    return train(start, pieces, teacher=True, epochs=TAUGHT)


def estimated(
    form: Form, orders: Orders, output: Port, start: Network, pieces: Sequence[Record], epochs: int, seconds: float
) -> Trained:
    """The linear model `start`, fitted one step ahead with the form's model of the noise: ARX, ARMAX or BJ.

    pieces: of the ports of `start`, with the initial state of its dynamics.
    """
    if form == ARX:
        return taught(start, pieces)
    begin = taught(start, pieces).network if form == ARMAX else start
    ahead = predictor(form, orders, start.inputs, output)
    ahead = ahead.with_parameters({n: v for n, v in begin.parameters().items() if n in ahead.parameters()})
    fit = train(ahead, [_measured(r, output, form) for r in pieces], epochs=epochs, seconds=seconds)
    found = fit.network.parameters()
    return replace(fit, network=start.with_parameters({n: found[n] for n in start.parameters()}), initial=())


def predictor(form: Form, orders: Orders, inputs: Sequence[Port], output: Port) -> Network:
    """What predicts one step of ARMAX or BJ: a network with the measured output as one more input.

    The layer LOOP has the weights of the linear model, by the same names. ARMAX: it reads the measured output and the
    errors of its own predictions. BJ: it runs free, and what it leaves is predicted from what it left and from errors.
    """
    taken = [p.name for p in (*inputs, output)]
    loop, measured, rest, predicted, error = (own(n, taken) for n in (LOOP, MEASURED, REST, PREDICTED, ERROR))
    network = Network("predictor", [*inputs, replace(output, name=measured)], [output])
    ports = {f"{p.name}_z{d}": (p.name, d) for p, delays in orders.inputs(inputs).items() for d in delays}
    past = {f"{error}_z{d}": (error, d) for d in orders.feedback}
    if form == ARMAX:
        ports |= {f"{output.name}_z{d}": (measured, d) for d in orders.feedback} | past
    else:
        ports |= {f"{output.name}_z{d}": (loop, d) for d in orders.feedback}
    network.add(loop, Layer({port: np.zeros((1, 1)) for port in ports}, [0.0], initial=output.rest), ports)
    shown = loop
    if form != ARMAX:
        _difference(network, rest, measured, loop)
        past |= {f"{rest}_z{d}": (rest, d) for d in orders.feedback}
        weights = {loop: np.ones((1, 1)), **{port: np.zeros((1, 1)) for port in past}}
        network.add(predicted, Layer(weights, [0.0], frozen={loop, "bias"}), {loop: loop, **past})
        shown = predicted
    _difference(network, error, measured, shown)
    network.connect(shown, output.name)
    return network.check()


def _difference(network: Network, name: str, of: str, less: str) -> None:
    """Layer `name`: the signal `of` less the signal `less`."""
    network.add(name, Layer({of: [[1.0]], less: [[-1.0]]}, [0.0], frozen={of, less, "bias"}), {of: of, less: less})


def _measured(record: Record, output: Port, form: Form) -> Record:
    """The record with the measured output as an input, too."""
    y, taken = record.targets[output.name], [*record.inputs, output.name]
    loop, measured = own(LOOP, taken), own(MEASURED, taken)
    initial = {n: v for n, v in record.initial.items() if n != loop or form != ARMAX} | {measured: float(y[0])}
    return replace(record, inputs={**record.inputs, measured: y}, initial=initial)
