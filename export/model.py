"""A model that an FMU holds, in C: variables that are doubles, and three functions, which `fmi/instance.h` calls."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from greygate.compiler.verilog import render


@dataclass(frozen=True)
class Variable:
    """A quantity of the model, in `unit`. start: its value before anybody sets it; None where it is computed."""

    name: str
    unit: str
    start: float | None = None
    meaning: str = ""


@dataclass(frozen=True)
class Model:
    """What `fmi.write` packs.

    name: a C identifier. period: s between two steps of its own. discrete: whether its signals change only there.
    seen: computed quantities that are no outputs. state: the lines in C that declare what it keeps from step to step.
    sources: file name -> C, in which `model_initialize`, `model_outputs` and `model_advance` are defined. resources:
    place -> file of another FMU that it holds; then `model_end` is defined, too.
    """

    name: str
    meaning: str
    period: float
    discrete: bool
    inputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    seen: tuple[Variable, ...]
    state: tuple[str, ...]
    includes: tuple[str, ...]
    sources: Mapping[str, str]
    resources: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def variables(self) -> tuple[Variable, ...]:
        """In the order of their references, which begin at 1; 0 is the time."""
        return (*self.inputs, *self.parameters, *self.outputs, *self.seen)

    def header(self, token: str) -> str:
        """The text of model.h. token: of the FMU, which a simulator shows before it gets an instance."""
        return render("model.h", {"m": self, "token": token}, "greygate.export")

    @property
    def starts(self) -> list[float]:
        """Of each variable, the value at the start."""
        return [float(v.start or 0.0) for v in self.variables]
