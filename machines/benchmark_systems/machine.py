"""The benchmark systems of the thesis (3.6) in the catalogue: B2, as found from its first seed."""

from functools import partial

from greygate.machines.benchmark_systems.study import B2, THESIS, identify, prune_weights
from greygate.machines.entry import Entry, Machine
from greygate.machines.kept import Kept
from greygate.models.training.record import Record


def records() -> dict[str, Record]:
    return {"training": B2.record(B2.excite(0)), "test": B2.record(B2.test)}


MACHINE = Machine(
    place=7,
    networks=(
        Entry(
            "b2",
            "Benchmark system 2 of the thesis: Narendra and Parthasarathy's fourth plant",
            partial(identify, B2, 0),
            records,
            ("training",),
            ("training", "test"),
            period=1.0,
            references={"thesis": {"training": {"y": THESIS["mse"] ** 0.5}, "test": {"y": THESIS["rmse"]}}},
            prune=Kept("b2", records, partial(prune_weights, B2, 0)),
        ),
    ),
)
