"""A model that an FMU holds, in C: variables that are doubles, and three functions, which `fmi/instance.h` calls."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass


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
    sources: file name -> C, in which `model_initialize`, `model_outputs` and `model_advance` are defined.
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

    @property
    def variables(self) -> tuple[Variable, ...]:
        """In the order of their references, which begin at 1; 0 is the time."""
        return (*self.inputs, *self.parameters, *self.outputs, *self.seen)

    def header(self, token: str) -> str:
        """The text of model.h. token: of the FMU, which a simulator shows before it gets an instance."""
        return "\n".join(self._header(token)) + "\n"

    def _header(self, token: str) -> Iterator[str]:
        yield f"/* The model {self.name} as its FMU sees it: inputs, parameters, outputs, all of them doubles. */"
        yield from ("#ifndef MODEL_H", "#define MODEL_H", "")
        yield from (f'#include "{name}"' for name in self.includes)
        yield from ("#include <stdint.h>", "")
        yield f'#define MODEL_TOKEN "{token}"'
        for what in ("inputs", "parameters"):
            yield f"#define MODEL_{what.upper()} {len(getattr(self, what))}"
        yield f"#define MODEL_VALUES {len(self.variables)}"
        yield f"#define MODEL_PERIOD {self.period!r} /* s */"
        yield from ("", "typedef struct", "{", "    double value[MODEL_VALUES];")
        yield from (f"    {line}" for line in self.state)
        yield from ("} model;", "", "/* Every value at its start. */", "void model_start(model *m);")
        yield from ("", "/* Begin at a time, with the parameters that are set. */")
        yield "void model_initialize(model *m, double time);"
        yield from ("", "/* Compute the outputs from state and inputs. */", "void model_outputs(model *m);")
        yield from ("", "/* From one time to another with the inputs held; 1 where a state is no longer finite. */")
        yield from ("int model_advance(model *m, double from, double to);", "", "#endif")

    def starts(self) -> str:
        """`model_start` in C."""
        lines = [f"    m->value[{i}] = {float(v.start or 0.0)!r}; /* {i + 1} */" for i, v in enumerate(self.variables)]
        return "\n".join(["void model_start(model *m)", "{", *lines, "}", ""])
