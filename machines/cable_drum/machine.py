"""The cable-drum sensor in the catalogue."""

from greygate.machines.cable_drum.augmentation import Slip
from greygate.machines.cable_drum.plant import SAMPLE_TIME
from greygate.machines.cable_drum.study import SCENARIOS, TRAINING, VALIDATED, records, train_snn
from greygate.machines.entry import Entry, Machine

MACHINE = Machine(
    place=3,
    augmented={"cable_drum": Slip},
    networks=(
        Entry(
            "cable_drum",
            "Cable-drum sensor: position error of a carriage from the drum's encoder alone",
            train_snn,
            records,
            TRAINING,
            SCENARIOS,
            SAMPLE_TIME,
            {"thesis": {name: {"e": 1e-6 * um} for name, um in VALIDATED.items()}},
            row=5,
        ),
    ),
)
