"""Position control of a machine: what is asked of it, by whom it is done, and where the loop runs.

A machine's folder gives a `Task`. The tuned PI controller and the network that imitates the predictive one are kept in
models/trained/control; `python -m benchmarks controllers NAME` makes both again, on trajectories of their own.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.control.choices import Case
from greygate.control.imitation import LAST, Imitated
from greygate.control.loop import Controller, Rig, Run, run
from greygate.control.pi import Proportional
from greygate.control.predictive import Limits
from greygate.control.stepping import Floating, Stepped
from greygate.emulator.program import Program
from greygate.models import sampling
from greygate.models.network import Network
from greygate.models.storage import TRAINED
from greygate.models.training.record import Record
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent
from greygate.reading import read_json

CONTROL = TRAINED / "control"
LEARNING = 100  # from where on trajectories and days of learning have their seeds


@dataclass(frozen=True)
class Task:
    """A machine under position control.

    tracked: signal of the rig that is judged [m]. period: s. drive: the input. preview: samples by which the imitating
    network sees ahead. reference: (seed, samples) -> (samples,) [m], from rest. rig: (case, seed, samples) -> the
    machine under way. predictive: the predictive controller. first: the PI controller before tuning. sensor: the
    network in place of sensors, online, and the input of it that brings the last drive ("" where it has none).
    imitator: the network before training. settle: samples before anything is judged.
    formats: of the program of the sensor; own_formats: of that of the imitating network. samples: of a run by default.
    units: of the signals of a run that a recording keeps. rounds: of DAgger.
    """

    name: str
    title: str
    tracked: str
    period: float
    drive: str
    limits: Limits
    preview: int
    reference: Callable[[int, int], np.ndarray]
    rig: Callable[[Case, int, int], Rig]
    predictive: Callable[[], Controller]
    first: Proportional
    sensor: Callable[[], Network]
    sensor_drive: str
    imitator: Callable[[int, int], Network]
    settle: int
    samples: int
    units: Mapping[str, str]
    rounds: int
    formats: Formats = field(default_factory=Formats)
    own_formats: Formats = field(default_factory=Formats)

    def run(self, controller: Controller, case: Case, seed: int, samples: int = 0, progress: Progress = silent) -> Run:
        """A closed loop on the trajectory and the day of that seed."""
        samples = samples or self.samples
        reference = self.reference(seed, samples)
        rig = self.rig(case, seed, samples)
        return run(rig, controller, reference, self.tracked, self.limits, self.period, progress=progress)

    def recording(self, done: Run) -> Recording:
        """The signals of a run, with the reference and the drive."""
        channels = {n: v for n, v in done.signals.items() if n in self.units}
        channels |= {"reference": done.signals[self.tracked] - done.error, self.drive: done.input}
        return Recording(self.period, channels, {"reference": self.units[self.tracked], **self.units}, self.name)

    # ---- the controllers

    def imitated(self, network: Stepped, sensor: Stepped) -> Imitated:
        return Imitated(network, sensor, self.preview, self.sensor_drive, self.drive)

    def floating(self, network: Network) -> Imitated:
        """Raises InputError for a network or a sensor of another sample time than the loop's."""
        both = network, self.sensor()
        for one in both:
            sampling.check(one, self.period, f"control of {self.name}", "train it on recordings of the loop")
        return self.imitated(*map(Floating, both))

    def network(self) -> Network:
        """The imitating network that is kept in the package."""
        return Network.load(CONTROL / self.name)

    def proportional(self) -> Proportional:
        """The PI controller as it was tuned."""
        found = read_json(CONTROL / f"{self.name}.json", f"run python -m benchmarks controllers {self.name}")
        return replace(self.first, **found["pi"])

    # ---- fixed point

    def programs(self, network: Network) -> tuple[Program, Program]:
        """Integer programs of the imitating network and of the sensor, ranged on what both read in two runs."""
        own: dict[str, Record] = {}
        sensors: dict[str, Record] = {}
        for seed, case in zip(range(LEARNING, LEARNING + 2), (Case.NOMINAL, Case.LOAD), strict=True):
            controller = _Noted(self.floating(network))
            self.run(controller, case, seed)
            own[case], sensors[case] = controller.records(network, self.sensor(), self.sensor_drive, self.drive)
        return tuple(
            compile_network(net, records, f, ranged_on=list(records), period=self.period).program
            for net, records, f in ((network, own, self.own_formats), (self.sensor(), sensors, self.formats))
        )  # type: ignore[return-value]


class _Noted:
    """An imitating network that drives, and what it and its sensor read and answered."""

    def __init__(self, imitated: Imitated):
        self.imitated, self.ahead = imitated, imitated.ahead

    def reset(self) -> None:
        self.imitated.reset()
        self.rows: list[dict[str, float]] = []

    def __call__(self, measured: Mapping[str, float], before: float, reference: np.ndarray) -> float:
        inputs = self.imitated.inputs(measured, before, reference)
        answer = self.imitated.network.step(inputs)[self.imitated.drive]
        self.rows.append({**inputs, "answer": answer})
        return answer

    def records(self, network: Network, sensor: Network, driven: str, drive: str) -> tuple[Record, Record]:
        columns = {n: np.array([row[n] for row in self.rows]) for n in self.rows[0]}
        own = Record({p.name: columns[p.name] for p in network.inputs}, {drive: columns["answer"]})
        given = {p.name: columns[LAST if p.name == driven else p.name] for p in sensor.inputs}
        return own, Record(given, {p.name: columns[p.name] for p in sensor.outputs})
