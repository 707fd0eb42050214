"""The timing-belt drive in the catalogue."""

from greygate.machines.belt_drive.axis import position
from greygate.machines.belt_drive.plant import SAMPLE_TIME
from greygate.machines.belt_drive.study import SCENARIOS, THESIS, records, train_machine
from greygate.machines.entry import Entry, Machine

MACHINE = Machine(
    place=5,
    controlled={"belt_drive": position},
    networks=(
        Entry(
            "belt_drive",
            "Timing-belt drive: position error of the carriage from the motor's encoder, by a machine of eight experts",
            train_machine,
            records,
            ("training", "boundaries"),
            SCENARIOS,
            period=SAMPLE_TIME,
            references={
                "thesis": {name: {"e": 1e-6 * um} for name, um in zip(SCENARIOS, THESIS["fnn"]["overall"], strict=True)}
            },
            row=4,
        ),
    ),
)
