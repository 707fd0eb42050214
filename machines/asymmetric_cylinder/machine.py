"""The asymmetric cylinder in the catalogue."""

from greygate.machines.asymmetric_cylinder.study import SCENARIOS, THESIS, adapt, records
from greygate.machines.entry import Entry, Machine, pressures

MACHINE = Machine(
    place=2,
    networks=(
        Entry(
            "asymmetric_cylinder",
            "Asymmetric cylinder, another machine: the valve-controlled cylinder's network adapted to it",
            adapt,
            records,
            ("training",),
            SCENARIOS,
            finer=2,
            references={"thesis": pressures(THESIS, SCENARIOS)},
            row=2,
        ),
    ),
)
