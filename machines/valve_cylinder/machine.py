"""The valve-controlled cylinder in the catalogue."""

from greygate.machines.entry import Entry, Machine, pressures
from greygate.machines.kept import Kept
from greygate.machines.valve_cylinder import warm
from greygate.machines.valve_cylinder.augmentation import Pressures
from greygate.machines.valve_cylinder.axis import position
from greygate.machines.valve_cylinder.study import SCENARIOS, THESIS, prune, records, train_srnn

MACHINE = Machine(
    place=1,
    augmented={"valve_hydraulic": Pressures},
    controlled={"valve_cylinder": position},
    networks=(
        Entry(
            "valve_cylinder",
            "Valve-controlled cylinder: chamber pressures from valve voltage and position",
            train_srnn,
            records,
            ("training",),
            SCENARIOS,
            finer=2,
            prune=Kept("valve_cylinder", records, prune),
            references={"thesis": pressures(THESIS, SCENARIOS)},
            row=1,
        ),
        Entry(
            "valve_cylinder_warm",
            "Worn valve-controlled cylinder at 20 to 60 degC: chamber pressures from voltage, position, temperature",
            warm.train_warm,
            warm.records,
            warm.TRAINING,
            warm.SCENARIOS,
            finer=2,
        ),
    ),
)
