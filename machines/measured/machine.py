"""The machines with only measured recordings, in the catalogue."""

from collections.abc import Mapping

from greygate.identify.study import Study, identify
from greygate.machines.entry import Entry, Machine
from greygate.machines.measured.study import CED, CRANE, EMPS, MTS, TANKS
from greygate.models.network import Network
from greygate.progress import Progress


def _entry(
    study: Study, title: str, training: tuple[str, ...], scenarios: tuple[str, ...], **references: Mapping
) -> Entry:
    """A study on a measured recording."""

    def train(progress: Progress) -> tuple[Network, dict]:
        result = identify(study, progress=progress)
        return result.network, result.figures

    return Entry(study.name, title, train, study.records, training, scenarios, study.period, references)


MACHINE = Machine(
    place=6,
    networks=(
        _entry(
            MTS,
            "Servo-hydraulic test machine, measured: displacement from command",
            ("chirp_0A", "15Hz0A"),
            ("chirp_1A", "15Hz1A"),
        ),
        _entry(
            CRANE,
            "Hydraulic crane actuator, measured: oil pressure from valve opening",
            ("train",),
            ("train", "test"),
            published={"test": {"p_oil": (0.33, 0.50)}},
        ),
        _entry(
            EMPS,
            "Linear axis (EMPS), measured: position from motor force",
            ("train",),
            ("train", "test"),
            published={"test": {"position": 2.64e-3}},
        ),
        _entry(
            TANKS,
            "Cascaded tanks with overflow, measured: level from pump voltage",
            ("train",),
            ("train", "test"),
            published={"test": {"y": (0.18, 0.45)}},
        ),
        _entry(
            CED,
            "Coupled electric drives, measured: pulley speed from motor voltage",
            ("low", "high"),
            ("low_test", "high_test"),
            published={"low_test": {"z": 0.0969}, "high_test": {"z": 0.0731}},
        ),
    ),
)
