"""A program run over inputs in physical units, bit for bit as the hardware does."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from greygate.emulator.engine import run
from greygate.emulator.numbers import Overflow
from greygate.emulator.program import Affine, Clipped, Program


@dataclass(frozen=True)
class Emulation:
    """What a program answered.

    outputs: port -> (N,) or (N, size), in the port's unit. saturations: signal -> events, of those that had any; an
    angle that loses whole turns is none.
    clipped: input port -> how many of its values lie outside the format, of those that have any.
    """

    outputs: dict[str, np.ndarray]
    saturations: dict[str, int]
    clipped: dict[str, Clipped]

    @property
    def steps(self) -> int:
        """N."""
        return len(next(iter(self.outputs.values())))


def emulate(program: Program, inputs: Mapping[str, np.ndarray]) -> Emulation:
    """Run an integer program, as docs/integer-program.md defines it, from its initial state.

    inputs: port -> (N,) or (N, size), in the port's unit. Raises InputError for a value that is not finite.

    >>> answer = emulate(program, record.inputs)
    >>> answer.steps, answer.saturations, answer.clipped
    (500, {}, {})
    >>> bool(np.abs(answer.outputs["y"] - record.targets["y"]).max() < 1e-6)  # m
    True
    """
    answer = run(program, program.encode(inputs), states=False)
    turns = {o.out.name for o in program.operations if isinstance(o, Affine) and _turns(o)}
    saturations = {name: count for name, count in answer.saturations.items() if count and name not in turns}
    return Emulation(program.decode(answer.outputs), saturations, program.clipped(inputs))


def _turns(operation: Affine) -> bool:
    return operation.overflow is Overflow.WRAP and operation.out.fix.frac == operation.out.fix.width - 1
