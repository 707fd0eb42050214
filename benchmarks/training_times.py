"""Training times of the thesis's networks beside the thesis's.

Networks of the thesis's sizes, epochs and samples; where a plant is still to come (chapter 7) the record is a stand-in
of the same length, so that only the time says something. CPU seconds of both threads together; wall time beside it.
"""

import time
from collections.abc import Callable

import numpy as np

from greygate.machines.asymmetric_cylinder import study as second
from greygate.machines.benchmark_systems.plant import b1, b1_input, b2, b2_input
from greygate.machines.valve_cylinder import study as first
from greygate.models.accuracy import free_run_rms
from greygate.models.adaptation import adopt
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.plants.excitation import prms

from .shared import stopwatch

TAKES = "two minutes"
THREADS = "all"
ROWS: list[dict[str, str]] = []  # of the table, in its order


def row(what: str, thesis: str, reached: str, epochs: int | None = None, cpu: float | None = None, wall=None) -> None:
    """Keep one row, and print it. cpu, wall: s, None where it was not timed."""
    times = {name: "" if value is None else f"{value:.1f} s" for name, value in (("cpu", cpu), ("wall", wall))}
    found = {"network": what, "thesis": thesis, **times, "epochs": "" if epochs is None else str(epochs)}
    ROWS.append({**found, "reached": reached})
    print(" | ".join(ROWS[-1].values()), flush=True)


def timed(what: str, thesis: str, work: Callable[[], Trained], figure: Callable[[Trained], str]) -> Trained:
    """Keep a row: ours in CPU and wall seconds, the epochs that were used, the error that was reached."""
    wall, cpu = stopwatch(), stopwatch(time.process_time)
    fit = work()
    wall, cpu = wall(), cpu()
    row(what, thesis, figure(fit), len(fit.history) - 1, cpu, wall)
    return fit


def regressions() -> None:
    """Tables 3.3 and 3.4: NARX, and NOE from its weights."""
    for name, hidden, taps, plant, signal, epochs, thesis in (
        ("B1, 10", (10,), ((1,), (1, 2)), b1, b1_input, 500, ("57 s, 1.11e-6", "57 s, 1.38e-6")),
        ("B1, 30", (30,), ((1,), (1, 2)), b1, b1_input, 500, ("98 s, 6.43e-10", "63 s, 7.4e-10")),
        ("B2, 20 + 10", (20, 10), ((1, 2), (1, 2, 3)), b2, b2_input, 1000, ("64 s, 1.04e-7", "190 s, 8.57e-8")),
    ):
        u = signal()
        record = Record({"u": u}, {"y": plant(u)})
        network = noe("noe", {Port("u"): taps[0]}, Port("y"), taps[1], hidden=hidden, bypass=False)
        _narx_noe(name, nguyen_widrow(network, seed=0), record, (epochs, 50), thesis)


def slip() -> None:
    """Tables 7.2 and 7.3, #9: three taps of position and speed, 30 neurons, 9776 samples; a stand-in for the rig."""
    x = np.cumsum(prms(9776, -0.01, 0.01, (20, 200), seed=0))
    v = np.diff(x, prepend=0.0) / 0.01
    e = np.zeros(len(x))
    for k in range(1, len(x)):
        e[k] = 0.99 * e[k - 1] + 0.02 * np.tanh(2 * v[k]) * (1 + 0.2 * np.sin(x[k]))
    inputs = {Port("x", scale=float(np.abs(x).max())): (0, 1, 2), Port("v"): (0, 1, 2)}
    network = noe("noe", inputs, Port("e"), (1,), hidden=(30,), bypass=False)
    record = Record({"x": x, "v": v}, {"e": e})
    _narx_noe("drum, 30", nguyen_widrow(network, seed=0), record, (100, 10), ("29 s", "428 s"), shown=False)


def _narx_noe(name, network, record, epochs, thesis, shown=True) -> None:
    def squares(fit: Trained) -> str:
        return f"MSE {2 * fit.history[-1]:.2e}" if shown else ""

    narx = timed(f"NARX {name}", thesis[0], lambda: train(network, [record], teacher=True, epochs=epochs[0]), squares)
    timed(f"NOE {name}", thesis[1], lambda: train(narx.network, [record], epochs=epochs[1]), squares)


def bars(network: Network, records: dict[str, Record]) -> str:
    found = {name: [v / 1e5 for v in free_run_rms(network, record).values()] for name, record in records.items()}
    return ", ".join(f"{name} {a:.3g} / {b:.3g} bar" for name, (a, b) in found.items())


def first_machine() -> None:
    """Tables 5.3 and 5.4."""
    figures = first.train_srnn()[1]
    seconds, (a, b) = figures["seconds"], figures["trained"]["training"]
    row("flow network", "< 7 min", f"{figures['flow_rms']:.3g} of Q_max", wall=seconds["flow"])
    reached = f"training {a:.3g} / {b:.3g} bar"
    row("SRNN, 10,001 samples", "85 min, 0.190 / 0.598 bar", reached, wall=seconds["srnn"])


def second_machine() -> None:
    """Table 5.7; and the same from random weights, which the thesis says fail (5.4.3)."""
    records, epochs = {"training": second.records()["training"]}, second.THESIS_EPOCHS
    start = adopt(second.assemble(), second.first_machine(), second.ADOPTED)
    starts = [("adopted weights", start, "835 min, 1.232 / 1.720 bar")]
    starts += [(f"random weights, seed {seed}", second.assemble(seed), '"totally fail"') for seed in range(3)]
    row("adopted weights, before", "18.980 / 22.064 bar", bars(start, records), 0)
    for label, network, thesis in starts:
        timed(
            f"{label}, 50,001 samples",
            thesis,
            lambda network=network: second.fit(network, epochs),
            lambda fit: bars(fit.network, records),
        )


def every() -> dict:
    for study in (regressions, slip, first_machine, second_machine):
        study()
    return {"rows": ROWS}


PARTS = {"all": every}
