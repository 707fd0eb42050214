"""The pump-controlled cylinder in the catalogue."""

from greygate.machines.entry import Entry, Machine
from greygate.machines.pump_cylinder.study import REFERENCES, SCENARIOS, TRAINING, records, train_srnn

MACHINE = Machine(
    place=4,
    networks=(
        Entry(
            "pump_cylinder",
            "Pump-controlled cylinder: chamber pressures from pump speeds and position, without a pressure sensor",
            train_srnn,
            records,
            TRAINING,
            SCENARIOS,
            references=REFERENCES,
            row=3,
        ),
    ),
)
