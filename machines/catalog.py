"""The networks that come with greygate, by name: how each is trained, on what it is judged, what others reached."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from greygate.errors import InputError
from greygate.machines.asymmetric_cylinder import study as asymmetric_cylinder
from greygate.machines.belt_drive import study as belt_drive
from greygate.machines.benchmark_systems import study as benchmark_systems
from greygate.machines.cable_drum import study as cable_drum
from greygate.machines.measured import identification as measured
from greygate.machines.measured import studies
from greygate.machines.pruned import Kept
from greygate.machines.pump_cylinder import study as pump_cylinder
from greygate.machines.valve_cylinder import study as valve_cylinder
from greygate.models.network import Network
from greygate.models.training.record import Record

TRAINED = measured.TRAINED


@dataclass(frozen=True)
class Entry:
    """One network of the catalogue.

    train: (progress) -> (network, figures). records: scenarios by name, the training ones first; the first one sets
    the ranges of the fixed-point formats. scenarios: those on which hardware is compared with the emulator.
    references: source -> scenario -> output -> published RMSE in the output's unit, or a pair (best, worst).
    prune: the network's own pruning; what it came to is kept in the package.
    finer: of `Formats`; 2 where pressures are pure integrals: the fewest bits with which a word of 16 costs the
    asymmetric cylinder's training record less than 5 %.
    """

    name: str
    title: str
    train: Callable[[Callable[[str], None] | None], tuple[Network, dict]]
    records: Callable[[], Mapping[str, Record]]
    training: tuple[str, ...]
    scenarios: tuple[str, ...]
    period: float = 1e-3
    references: Mapping[str, Mapping] = field(default_factory=dict)
    prune: Kept | None = None
    finer: int = 0

    def network(self) -> Network:
        """The trained network that is kept in the package."""
        return Network.load(TRAINED / self.name)

    def save(self, network: Network, figures: dict, folder: Path = TRAINED) -> None:
        """Write NAME.toml, NAME.safetensors and NAME.json (the figures)."""
        network.save(folder / self.name, json.dumps(figures, indent=2) + "\n")


def _measured(
    study: measured.Study, title: str, training: tuple[str, ...], scenarios: tuple[str, ...], **references: Mapping
) -> Entry:
    """A study on a measured recording."""

    def identify(progress):
        result = measured.identify(study, progress=progress)
        return result.network, result.figures

    return Entry(study.name, title, identify, study.records, training, scenarios, study.period, references)


def _pressures(bar: Mapping[str, tuple[float, float]], scenarios: Sequence[str]) -> dict[str, dict[str, float]]:
    """Published RMSE of chambers A and B in Pa, of those scenarios that have one."""
    return {name: {"p_a": 1e5 * bar[name][0], "p_b": 1e5 * bar[name][1]} for name in scenarios if name in bar}


def _benchmark(name: str, title: str) -> Entry:
    """Benchmark system of the thesis 3.6, as found from its first seed."""
    system, thesis = benchmark_systems.SYSTEMS[name], benchmark_systems.THESIS[name]

    def records() -> dict[str, Record]:
        return {"training": system.record(system.excite(0)), "test": system.record(system.test)}

    return Entry(
        name,
        title,
        lambda progress: benchmark_systems.identify(system, 0, progress),
        records,
        ("training",),
        ("training", "test"),
        period=1.0,
        references={"thesis": {"training": {"y": thesis["mse"] ** 0.5}, "test": {"y": thesis["rmse"]}}},
        prune=Kept(name, records, partial(benchmark_systems.prune, system, 0)),
    )


CATALOG = {
    entry.name: entry
    for entry in (
        Entry(
            "valve_cylinder",
            "Valve-controlled cylinder: chamber pressures from valve voltage and position",
            valve_cylinder.train_srnn,
            valve_cylinder.records,
            ("training",),
            valve_cylinder.SCENARIOS,
            finer=2,
            prune=Kept("valve_cylinder", valve_cylinder.records, valve_cylinder.prune),
            references={"thesis": _pressures(valve_cylinder.THESIS, valve_cylinder.SCENARIOS)},
        ),
        Entry(
            "asymmetric_cylinder",
            "Asymmetric cylinder, another machine: the valve-controlled cylinder's network adapted to it",
            asymmetric_cylinder.adapt,
            asymmetric_cylinder.records,
            ("training",),
            asymmetric_cylinder.SCENARIOS,
            finer=2,
            references={"thesis": _pressures(asymmetric_cylinder.THESIS, asymmetric_cylinder.SCENARIOS)},
        ),
        Entry(
            "cable_drum",
            "Cable-drum sensor: position error of a carriage from the drum's encoder alone",
            cable_drum.train_snn,
            cable_drum.records,
            cable_drum.TRAINING,
            cable_drum.SCENARIOS,
            cable_drum.SAMPLE_TIME,
            {"thesis": {name: {"e": 1e-6 * cable_drum.THESIS[name]} for name in ("validation", "home")}},
        ),
        Entry(
            "pump_cylinder",
            "Pump-controlled cylinder: chamber pressures from pump speeds and position, without a pressure sensor",
            pump_cylinder.train_srnn,
            pump_cylinder.records,
            pump_cylinder.TRAINING,
            pump_cylinder.SCENARIOS,
            references=pump_cylinder.REFERENCES,
        ),
        Entry(
            "belt_drive",
            "Timing-belt drive: position error of the carriage from the motor's encoder, by a machine of eight experts",
            belt_drive.train_machine,
            belt_drive.records,
            ("training", "boundaries"),
            belt_drive.SCENARIOS,
            period=belt_drive.rig.SAMPLE_TIME,
            references={
                "thesis": {
                    name: {"e": 1e-6 * um}
                    for name, um in zip(belt_drive.SCENARIOS, belt_drive.THESIS["fnn"]["overall"], strict=True)
                }
            },
        ),
        _measured(
            studies.MTS,
            "Servo-hydraulic test machine, measured: displacement from command",
            ("chirp_0A", "15Hz0A"),
            ("chirp_1A", "15Hz1A"),
        ),
        _measured(
            studies.CRANE,
            "Hydraulic crane actuator, measured: oil pressure from valve opening",
            ("train",),
            ("train", "test"),
            published={"test": {"p_oil": (0.33, 0.50)}},
        ),
        _measured(
            studies.EMPS,
            "Linear axis (EMPS), measured: position from motor force",
            ("train",),
            ("train", "test"),
            published={"test": {"position": 2.64e-3}},
        ),
        _measured(
            studies.TANKS,
            "Cascaded tanks with overflow, measured: level from pump voltage",
            ("train",),
            ("train", "test"),
            published={"test": {"y": (0.18, 0.45)}},
        ),
        _measured(
            studies.CED,
            "Coupled electric drives, measured: pulley speed from motor voltage",
            ("low", "high"),
            ("low_test", "high_test"),
            published={"low_test": {"z": 0.0969}, "high_test": {"z": 0.0731}},
        ),
        _benchmark("b2", "Benchmark system 2 of the thesis: Narendra and Parthasarathy's fourth plant"),
    )
}

PLANTS = ("valve_cylinder", "asymmetric_cylinder", "pump_cylinder", "belt_drive", "cable_drum")
"""The thesis's machines, chapters 5 to 7 and 4."""


def entry(name: str) -> Entry:
    """The entry of that name. Raises InputError naming those there are."""
    if name not in CATALOG:
        raise InputError(f"no network is called {name!r}; there are {', '.join(CATALOG)}, or give a NAME.toml file")
    return CATALOG[name]
