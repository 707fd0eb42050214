"""The pendulum in the catalogue."""

from greygate.machines.entry import Entry, Machine
from greygate.machines.pendulum.study import SAMPLE_TIME, SAMPLES, records, train_pendulum

MACHINE = Machine(
    networks=(
        Entry(
            "pendulum",
            "Pendulum turned by a motor: its angle from the torque, friction learnt",
            train_pendulum,
            records,
            ("training",),
            tuple(SAMPLES),
            SAMPLE_TIME,
        ),
    )
)
