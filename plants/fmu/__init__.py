"""An FMU (FMI 2.0 or 3.0) as a plant. It is a program: it runs only for those who trust it, in a process of its own.

Of an FMU for model exchange the states are those of the plant, their rates are what the FMU says, and effects add to
them in the units of a rate: dry friction of a velocity in m/s^2. Of one for co-simulation, which steps itself, effects
act on inputs and sensors alone. Outputs that are no states are the plant's last states, without a balance.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

from greygate.errors import InputError, shown
from greygate.plants import units
from greygate.plants.fmu import loop, trust, unit
from greygate.plants.fmu.archive import Archive
from greygate.plants.outside import symbols
from greygate.plants.plant import Equation, Parameter, Plant, State
from greygate.plants.units.reading import scale

TIME, NONE = "t", "1"  # the symbol that a plant has for time; the unit of a plain number
REAL = ("Real", "Float64")
TOLERANCE = 0.2  # of a parameter of which nothing more is known
ROUGH = 0.5  # of the shortest time constant, that a step takes
SLOWEST = 1e-3  # s of a step, where nothing says how long one may be


@dataclass(frozen=True, eq=False)
class Simulated:
    """An FMU as an `Outside`.

    shown: the last of `stepped`, outputs that are no states. inputs: symbols of the FMU's, in its order. values:
    parameter -> the FMU's own. kind: the source of its loop. references: of what is shown. scales, settings: (factor,
    zero) of the plant's numbers over the FMU's, of what is shown and of parameters.
    """

    path: Path
    stepped: tuple[str, ...]
    forced: int
    shown: Collection[str]
    own: Collection[str]
    inputs: tuple[str, ...]
    values: Mapping[str, float]
    running: unit.Unit
    kind: str
    steps: bool
    fixed: bool
    whole: bool
    timed: bool
    references: Sequence[int]
    scales: Sequence[tuple[float, float]]
    settings: Sequence[tuple[float, float]]
    first: int = 0
    early: float = 0.0
    source: str = ""
    elements: Mapping[tuple[str, str], str] = field(default_factory=dict)
    coupled: Mapping[str, int] = field(default_factory=dict)

    @property
    def parameters(self) -> Collection[str]:
        return self.values.keys()

    def loop(self, text: str) -> unit.Loop:
        """What runs the plant of such a source."""
        return unit.Loop(self.running, self.kind, text)

    @contextmanager
    def lent(self, inputs: Sequence[str], values: Mapping[str, float], step: float) -> Iterator[tuple[Any, ...]]:
        own = [(float(values[s]) - zero) / factor for s, (factor, zero) in zip(self.values, self.settings, strict=True)]
        said = {
            "values": own, "columns": [list(inputs).index(s) for s in self.inputs], "shown": self.references,
            "scales": self.scales,
        }  # fmt: skip
        with self.running.lent() as process:
            yield process, said


def bundle(path: Path) -> dict[str, bytes]:
    """What a rig takes along of an FMU."""
    return {path.name: Archive.read(path).content}


def forces(plant: Plant) -> list[str]:
    """No input may stand in for another."""
    return []


def digest(path: Path) -> str:
    """SHA-256 of the program that `read` runs."""
    return Archive.read(path).digest


def read(path: Path, recorded: Mapping[str, str]) -> Plant:
    """The plant of an FMU. recorded: channel -> its unit, which holds where the FMU tells none.

    Raises InputError for a file that is no FMU, that is not trusted, does not run here or does not begin.
    """
    archive = Archive.read(path)
    trust.require(path, archive.digest)
    return _Reading(archive, recorded).plant()


class _Reading:
    """A plant while it is read from an FMU."""

    def __init__(self, archive: Archive, recorded: Mapping[str, str]):
        self.archive, self.recorded, self.about = archive, recorded, archive.about
        self.interface = self.about.modelExchange or self.about.coSimulation
        if self.interface is None:
            raise archive.wrong("is neither for model exchange nor for co-simulation; export it for one of them")
        if self.interface.needsExecutionTool:
            raise archive.wrong("needs the tool that made it (needsExecutionTool); export it as one that runs alone")
        self.stepped = self.about.modelExchange is None
        self.states = [] if self.stepped else [u.variable.derivative for u in self.about.derivatives]
        known = self.about.modelVariables
        self.inputs = [v for v in known if v.causality == "input"]
        self.settable = [v for v in known if v.causality == "parameter" and _real(v) and v.start is not None]
        outputs = [v for v in known if v.causality == "output" and _real(v) and v not in self.states]
        self.visible = outputs + [v for v in known if v.causality == "local" and _real(v) and v.name in recorded]
        self.visible = [v for v in self.visible if v not in self.states]
        for what, variables in (("an input", self.inputs), ("a state", self.states)):
            for v in variables:
                if v is None or not _real(v):
                    name = shown(v.name if v else "a state without a name")
                    raise archive.wrong(f"{name}, {what}, is no single number of double precision; only such are set")
        if not (self.states or self.visible):
            raise archive.wrong("has neither a state nor an output; export one that shows what it computes")
        every = [*self.states, *self.inputs, *self.settable, *self.visible]
        found = symbols([v.name for v in every], "variable", [TIME])
        self.symbols = {v.name: symbol for v, symbol in zip(every, found, strict=True)}

    def plant(self) -> Plant:
        running = unit.of(self.archive, self._facts())
        asked = running.asked
        visible = self._named(dict(asked["same"]))
        events = not self.stepped and self._eventful(asked)
        rates = {self._of(self.states[int(i)]): self._of(self.states[j]) for i, j in asked["rates"].items()}
        states = {self._of(v): self._state(v, x, rates) for v, x in zip(self.states, asked["start"], strict=False)}
        states |= {self._of(v): State(self._unit(v)) for v in visible}
        parameters = {self._of(v): self._parameter(v) for v in self.settable}
        equations = self._equations(rates, visible)
        own = [f"{name}.speed" for name, e in equations.items() if e.terms]
        outside = Simulated(
            self.archive.path, tuple(states), len(self.states), [self._of(v) for v in visible], own,
            tuple(self._of(v) for v in self.inputs), {s: p.value for s, p in parameters.items()}, running,
            loop.source(self.about.fmiMajorVersion, self.stepped, events, self._completes()),
            self.stepped, self.stepped, self.stepped or events, asked["timed"],
            [v.valueReference for v in visible], [self._scale(v)[:2] for v in visible],
            [self._scale(v)[:2] for v in self.settable],
        )  # fmt: skip
        return Plant(
            self.archive.path.stem, parameters, {self._of(v): self._unit(v) for v in self.inputs}, states, equations,
            outputs=tuple(states), step=self._step(asked["fastest"]), outside=outside,
        )  # fmt: skip

    def _of(self, variable: Any) -> str:
        return self.symbols[variable.name]

    # -- what the processes are told -----------------------------------------------------------------------------------

    def _facts(self) -> dict[str, Any]:
        """What a process has to know of the FMU; numbers as the FMU has them, scales to the plant's units."""
        groups = {
            "states": self.states, "inputs": self.inputs, "parameters": self.settable, "shown": self.visible,
            "rates": [] if self.stepped else [u.variable for u in self.about.derivatives],
        }  # fmt: skip
        references = {name: [v.valueReference for v in variables] for name, variables in groups.items()}
        begin = self.about.defaultExperiment
        return {
            **references,
            "version": self.about.fmiMajorVersion, "token": self.about.guid, "stepped": self.stepped,
            "identifier": self.interface.modelIdentifier, "indicators": self._indicators(),
            "from": float(begin.startTime or 0.0) if begin else 0.0, "values": [float(v.start) for v in self.settable],
            "directional": bool(self.interface.providesDirectionalDerivative),
            "scales": {"states": self._scales(self.states), "inputs": self._scales(self.inputs)},
        }  # fmt: skip

    def _scales(self, variables: Sequence[Any]) -> list[tuple[float, float]]:
        return [self._scale(v)[:2] for v in variables]

    def _indicators(self) -> int:
        newer = self.about.fmiMajorVersion == 3
        return 0 if self.stepped else len(self.about.eventIndicators) if newer else self.about.numberOfEventIndicators

    def _eventful(self, asked: Mapping[str, Any]) -> bool:
        return bool(self._indicators() or asked["next"] or any(v.variability == "discrete" for v in self.inputs))

    def _completes(self) -> bool:
        if self.stepped:
            return False
        if self.about.fmiMajorVersion == 3:
            return bool(self.interface.needsCompletedIntegratorStep)
        return not self.interface.completedIntegratorStepNotNeeded

    # -- what the plant has --------------------------------------------------------------------------------------------

    def _named(self, same: Mapping[str, int]) -> list[Any]:
        """Give states the names under which outputs show and a log has them; the outputs that are no states."""
        left = []
        for i, v in enumerate(self.visible):
            state = self.states[same[str(i)]] if str(i) in same else None
            both = state is not None and self._of(v) in self.recorded and self._of(state) in self.recorded
            if state is None or both or (v.unit and self._scale(v) != self._scale(state)):
                left.append(v)
            elif self._of(v) in self.recorded:  # by that name
                self.symbols[state.name] = self._of(v)
        return left

    def _state(self, variable: Any, start: float, rates: Mapping[str, str]) -> State:
        symbol = self._of(variable)
        text = self._unit(variable)
        if text == NONE and (position := next((x for x, v in rates.items() if v == symbol), None)):
            of = next(v for v in self.states if self._of(v) == position)
            found = units.powers(self._unit(of))
            text = units.written(units.times(found, {"s": Fraction(1)}, -1)) if found else NONE
        return State(text, initial=start, rate=rates.get(symbol))

    def _equations(self, rates: Mapping[str, str], visible: Sequence[Any]) -> dict[str, Equation]:
        found = {}
        for v in self.states:
            symbol = self._of(v)
            if symbol in rates:
                found[f"way_{symbol}"] = Equation(symbol, {"speed": rates[symbol]})
            else:
                found[f"{'motion' if symbol in rates.values() else 'balance'}_{symbol}"] = Equation(symbol, {})
        return found | {f"shown_{self._of(v)}": Equation(self._of(v), {}) for v in visible}

    def _parameter(self, variable: Any) -> Parameter:
        """Its tolerance ends where its values end."""
        factor, zero, text = self._scale(variable)
        value, of = float(variable.start), variable.declaredType
        ends = [getattr(variable, end) or (getattr(of, end) if of is not None else None) for end in ("min", "max")]
        reach = min([TOLERANCE * abs(value), *(abs(float(end) - value) for end in ends if end is not None)])
        converted = value * factor + zero
        tolerance = reach * abs(factor) / abs(converted) if converted else 0.0
        return Parameter(converted, text, tolerance, variable.description or "")

    def _unit(self, variable: Any) -> str:
        return self._scale(variable)[2]

    def _scale(self, variable: Any) -> tuple[float, float, str]:
        """(factor, zero, unit) of the plant's numbers over the FMU's; by the log where the FMU tells no unit."""
        of = variable.declaredType
        text = variable.unit or (of.unit if of is not None else None)
        try:
            if text:
                return scale(text, None)
        except InputError:  # a unit that nobody knows
            pass
        return 1.0, 0.0, self.recorded.get(self.symbols.get(variable.name, ""), NONE)

    def _step(self, fastest: float) -> float:
        """s of an integration step, or of one that the FMU is asked to take."""
        begin = self.about.defaultExperiment
        told = float(begin.stepSize) if begin and begin.stepSize else math.inf
        if self.stepped:
            return told if math.isfinite(told) else SLOWEST
        found = min(told, ROUGH / fastest if fastest > 0 else math.inf)
        return found if math.isfinite(found) else SLOWEST


def _real(variable: Any) -> bool:
    return variable.type in REAL and not variable.dimensions
