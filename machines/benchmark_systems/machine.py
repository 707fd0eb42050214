"""The benchmark systems of the thesis (3.6) in the catalogue: B2, as found from its first seed."""

from functools import partial

from greygate.machines.benchmark_systems.study import SYSTEMS, THESIS, identify, prune_weights
from greygate.machines.entry import Entry, Machine
from greygate.machines.kept import Kept
from greygate.models.training.record import Record

SYSTEM = SYSTEMS["b2"]


def records() -> dict[str, Record]:
    return {"training": SYSTEM.record(SYSTEM.excite(0)), "test": SYSTEM.record(SYSTEM.test)}


MACHINE = Machine(
    place=7,
    networks=(
        Entry(
            "b2",
            "Benchmark system 2 of the thesis: Narendra and Parthasarathy's fourth plant",
            partial(identify, SYSTEM, 0),
            records,
            ("training",),
            ("training", "test"),
            period=1.0,
            references={"thesis": {"training": {"y": THESIS["b2"]["mse"] ** 0.5}, "test": {"y": THESIS["b2"]["rmse"]}}},
            prune=Kept("b2", records, partial(prune_weights, SYSTEM, 0)),
        ),
    ),
)
