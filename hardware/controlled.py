"""PI, predictive control and the network that imitates it on any machine: float, fixed point, Verilog in the loop."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, NotRequired, TypedDict

import numpy as np

from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.control.choices import Case, Method, Place
from greygate.control.imitation import ImitatedAll
from greygate.control.learning import LEARNING, Learnt, imitated, learnt
from greygate.control.loop import Controller, Run
from greygate.control.own import Machine, ranged
from greygate.control.stepping import Emulated, Floating
from greygate.control.tuning import SAMPLES, TUNING, predicted, proportional
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import making, scratch, writing
from greygate.hardware.in_loop import clocked
from greygate.hardware.verify import Case as Built
from greygate.models.training.record import Record
from greygate.plain import Count, json_text, plain
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent

WIDTHS = (12, 14, 16, 18, 20, 22, 24)  # bits, the narrowest first
FINER = 2  # bits that weights have beyond
GROWTH = 1.05  # times the error of float in closed loop, the mean over days, that fixed point may come to
DAYS = 4  # references and days on which that is asked, each with and without a load


class Tracked(TypedDict):
    """An output's error [its unit]."""

    rms: float
    worst: float


class ControlCase(TypedDict):
    """A run of one controller."""

    errors: Annotated[dict[str, Tracked], "Output -> its error."]
    limits: Annotated[dict[str, Count], "Limit -> samples in which it was broken."]
    microseconds: NotRequired[float]


class Imitating(TypedDict):
    """The network that imitates. apart: case -> its error over the predictive controller's."""

    apart: dict[str, float]
    matches: bool
    neurons: Count
    said: str
    bits: NotRequired[Count]
    clocks: NotRequired[float]
    differing_bits: NotRequired[Count]
    compared_bits: NotRequired[Count]


class Controlled(TypedDict):
    """Controllers on a machine."""

    machine: str
    period_s: float
    units: Annotated[dict[str, str], "Tracked output -> its unit."]
    horizon: NotRequired[Count]
    rows: Annotated[dict[str, dict[str, ControlCase]], "Controller -> what disturbs -> its run."]
    network: NotRequired[Imitating]


@dataclass
class Table:
    """found: what a command prints. last: the runs of the last controller, by case. network: where one was learnt."""

    found: Controlled
    last: dict[Case, Run] = field(default_factory=dict)
    network: Learnt | None = None
    program: Program | None = None


def table(machine: Machine, method: Method, place: Place, progress: Progress = silent) -> Table:
    """Every controller up to the one asked for: PI, predictive, network, and that in fixed point and in Verilog.

    Raises InputError where fixed point or Verilog is asked for without the network.
    """
    if place is not Place.FLOAT and method is not Method.NETWORK:
        raise InputError(f"{method} runs in float; only the imitating network is compiled: take network")
    units = {p.name: p.unit for p in machine.signals if p.name in machine.tracked}
    done = Table({"machine": machine.name, "period_s": machine.period, "units": units, "rows": {}})
    pi = proportional(machine, progress)
    _row(done, machine, "PI", pi, progress)
    if method is Method.PI:
        return done
    tuning = machine.run(pi, Case.LOAD, TUNING, SAMPLES)
    machine = ranged(machine, tuning)
    expert = predicted(machine, tuning, progress)
    done.found["horizon"] = expert.ahead
    _row(done, machine, "predictive", expert, progress)
    if method is Method.NETWORK:
        done.network = learnt(machine, expert, progress)
        _network(done, machine, done.network, place, progress)
    return done


def _row(done: Table, machine: Machine, name: str, controller: Controller, progress: Progress) -> None:
    done.last = {}
    for case in Case:
        progress(f"{name}, {case}")
        done.last[case] = machine.run(controller, case, None)
    done.found["rows"][name] = {str(case): _figures(machine, run) for case, run in done.last.items()}


def _figures(machine: Machine, run: Run) -> ControlCase:
    errors: dict[str, Tracked] = {}
    for name, error in zip(machine.tracked, run.error.T, strict=True):
        errors[name] = {"rms": float(np.sqrt(np.mean(error**2))), "worst": float(np.abs(error).max())}
    micro = 1e6 * float(np.median(run.seconds))
    return {"errors": errors, "limits": dict(run.violations), "microseconds": micro}


def _network(done: Table, machine: Machine, found: Learnt, place: Place, progress: Progress) -> None:
    _row(done, machine, "network, float", imitated(machine, Floating(found.network), found.ahead), progress)
    told: Imitating = {
        "apart": dict(found.apart), "matches": found.matches, "neurons": found.network.neurons(), "said": found.said,
    }  # fmt: skip
    done.found["network"] = told
    if place is Place.FLOAT:
        return
    done.program, told["bits"] = fixed(machine, found, progress)
    _row(done, machine, "network, fixed", imitated(machine, Emulated(done.program), found.ahead), progress)
    if place is Place.EMULATOR:
        return
    progress("building the Verilog")
    with ExitStack() as stack:
        folder = stack.enter_context(scratch())
        (design,) = stack.enter_context(clocked([Built(done.program, {})], folder, progress))
        _row(done, machine, "network, Verilog", imitated(machine, design, found.ahead), progress)
        told["clocks"] = design.clocks / design.steps
        told["differing_bits"], told["compared_bits"] = design.differing, design.compared


def read_and_answered(machine: Machine, found: Learnt) -> dict[str, Record]:
    """What the network reads and answers in every case, on references that it learnt on."""
    records = {}
    days = [*((str(case), case, machine) for case in Case), ("shocked", Case.LOAD, replace(machine, shocked=True))]
    for seed, (name, case, day) in enumerate(days, LEARNING):
        noted = _Noted(imitated(machine, Floating(found.network), found.ahead))
        day.run(noted, case, seed, SAMPLES)
        records[name] = noted.record()
    return records


class _Noted:
    """An imitating network that drives, and what it read and answered."""

    def __init__(self, imitated: ImitatedAll):
        self.imitated, self.ahead = imitated, imitated.ahead

    def reset(self) -> None:
        self.imitated.reset()
        self.rows: list[tuple[Mapping[str, float], np.ndarray]] = []

    def __call__(self, measured: Mapping[str, float], before: np.ndarray, reference: np.ndarray) -> np.ndarray:
        answer = self.imitated(measured, before, reference)
        self.rows.append((self.imitated.inputs(measured, before, reference), answer))
        return answer

    def record(self) -> Record:
        read, answers = zip(*self.rows, strict=True)
        targets = dict(zip(self.imitated.drives, np.array(answers).T, strict=True))
        return Record({n: np.array([row[n] for row in read]) for n in read[0]}, targets)


def fixed(machine: Machine, found: Learnt, progress: Progress = silent) -> tuple[Program, int]:
    """The narrowest program that tracks as float does in closed loop, and its width; else the one that tracks best."""
    records = read_and_answered(machine, found)

    def costs(network: Floating | Emulated) -> np.ndarray:
        own = imitated(machine, network, found.ahead)
        days = [(case, seed) for case in (Case.NOMINAL, Case.LOAD) for seed in range(LEARNING, LEARNING + DAYS)]
        return np.array([machine.cost(machine.run(own, case, seed, SAMPLES)) for case, seed in days])

    floating = costs(Floating(found.network))
    tries: list[tuple[float, int, Program]] = []
    for width in WIDTHS:
        progress(f"fixed point of {width} bits")
        formats = Formats(width, FINER)
        try:
            made = compile_network(found.network, records, formats, ranged_on=[*records], period=machine.period)
        except InputError:  # a sum is too wide
            if not tries:
                raise
            break
        grown = float(np.mean(costs(Emulated(made.program)) / floating))
        tries.append((grown, width, made.program))
        if grown <= GROWTH:
            break
    best = min(tries[-1:] if tries[-1][0] <= GROWTH else tries, key=lambda t: t[0])
    return best[2], best[1]


def checked(machine: Machine, out: Path) -> None:
    """Raise InputError where the results of a machine cannot be written to a folder."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is not a folder; give another one")
    storable(machine)


def storable(machine: Machine) -> None:
    """Raise InputError where a signal of a machine has no header in a recording."""
    ports = [*machine.signals, *machine.drives]
    _ = Recording(machine.period, {p.name: np.zeros(1) for p in ports}, {p.name: p.unit for p in ports}).header


def driven(machine: Machine, run: Run) -> Recording:
    """A run as a recording: signals, inputs and what the outputs were to be."""
    units = {p.name: p.unit for p in (*machine.signals, *machine.drives)}
    units |= {f"reference_{n}": units[n] for n in machine.tracked}
    channels = dict(run.signals) | {p.name: v for p, v in zip(machine.drives, run.input.T, strict=True)}
    channels |= {f"reference_{n}": run.signals[n] - e for n, e in zip(machine.tracked, run.error.T, strict=True)}
    return Recording(machine.period, channels, units)


def written(machine: Machine, done: Table, out: Path) -> None:
    """CASE.csv of the last controller; of a network itself and, to be compiled with, what it reads and answers."""
    with making(out), writing(out):
        for case, run in done.last.items():
            driven(machine, run).write_csv(out / f"{case}.csv")
        if done.network is None:
            return
        network, records = done.network.network, read_and_answered(machine, done.network)
        network.save(out / network.name, json_text(plain(done.found)))
        units = {p.name: p.unit for p in (*network.inputs, *network.outputs)}
        for name, record in records.items():
            channels = {**record.inputs, **record.targets}
            Recording(machine.period, channels, units).write_csv(out / f"{network.name}_{name}.csv")
