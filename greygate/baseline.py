"""A linear model beside a network, so that its error has a measure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from greygate.machines.identification import initialised
from greygate.models.accuracy import free_run_rms
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import narx_noe
from greygate.models.training.record import Record
from greygate.sensors import own_sensors

EPOCHS = 40
FEEDBACK = (1, 2)  # of the linear model: the least that can swing


def linear(inputs: Sequence[Port], output: Port, records: Sequence[Record], taps: Sequence[int] = (0, 1, 2)) -> Network:
    """An output-error model of order 2, trained as ARX first. taps: of every input."""
    model = noe("linear", dict.fromkeys(inputs, taps), output, FEEDBACK)
    return narx_noe(model, records, epochs=EPOCHS, estimate_initial=any(r.skip for r in records)).network


def linear_rms(network: Network, learnt: Sequence[Record], judged: Mapping[str, Record]) -> dict[str, dict[str, float]]:
    """RMS error in free run by record and output, in its unit, of a linear model on the network's ports.

    learnt: the records that the network was trained on; where they settle, the state before each is estimated.
    """
    found: dict[str, dict[str, float]] = {name: {} for name in judged}
    for output in network.outputs:
        model = linear(network.inputs, output, [of_one(r, output.name) for r in learnt])
        for name, record in judged.items():
            one = of_one(record, output.name)
            found[name] |= free_run_rms(model, initialised(model, own_sensors(model, one).undone(one)))
    return found


def of_one(record: Record, output: str) -> Record:
    """The record with that target alone, and no state but of its inputs."""
    initial = {n: v for n, v in record.initial.items() if n in record.inputs}
    offset, gain = record.own_offset & {output}, record.own_gain & {output}
    targets = {output: record.targets[output]}
    return replace(record, targets=targets, initial=initial, own_offset=offset, own_gain=gain)
