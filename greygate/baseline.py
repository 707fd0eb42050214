"""A linear model beside a network, so that its error has a measure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from greygate.machines.identification import initialised
from greygate.models.accuracy import free_run_rms
from greygate.models.families.regression import noe
from greygate.models.network import Network
from greygate.models.training.levenberg import narx_noe
from greygate.models.training.record import Record

EPOCHS = 40
ORDER = 2  # of the linear model: its least that can swing


def linear_rms(network: Network, learnt: Sequence[Record], judged: Mapping[str, Record]) -> dict[str, dict[str, float]]:
    """RMS error in free run by record and output, in its unit, of an output-error model of order 2 on the same ports.

    learnt: the records that the network was trained on; where they settle, the state before each is estimated.
    """
    found: dict[str, dict[str, float]] = {name: {} for name in judged}
    inputs = {port: range(ORDER + 1) for port in network.inputs}
    for output in network.outputs:
        model = noe("linear", inputs, output, range(1, ORDER + 1))
        settles = any(r.skip for r in learnt)
        trained = narx_noe(
            model, [_of(r, output.name) for r in learnt], epochs=EPOCHS, estimate_initial=settles
        ).network
        for name, record in judged.items():
            found[name] |= free_run_rms(trained, initialised(trained, _of(record, output.name)))
    return found


def _of(record: Record, output: str) -> Record:
    return replace(record, targets={output: record.targets[output]}, initial={})
