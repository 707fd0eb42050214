"""The targets as which an integer program can be written: every module of this folder is one, and has its name.

Such a module has one `TARGET`. The target is registered nowhere else: `emit`, the command line, the check of
compile.json, `verify` and `synthesize` find it here.
"""

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, NamedTuple

from greygate.errors import InputError
from greygate.reading import one_of, whole

if TYPE_CHECKING:  # the command line needs the names at its start, and numpy only in a command
    from greygate.emulator.program import Program

BOTH = ("parallel", "folded")  # the default targets, in the order in which they are reported
MULTIPLIERS = range(1, 257)  # the numbers of multipliers that a target which shares them accepts
FACTORS = range(9, 19)  # widths of their widest factor
LARGEST = 1 << 16  # of any other number of a design


class Memory(StrEnum):
    """Where the words of a table are kept."""

    BLOCK = "block"  # block RAM
    LOGIC = "logic"  # LUTs, or the memory that a device makes of them


@dataclass(frozen=True)
class Design:
    """How a program is built: every choice that changes no bit of any answer. A target reads those that concern it.

    multipliers: of the folded target. factor: bits of their widest factor, for a longer one is multiplied in parts; an
    iCE40 multiplies 16 by 16 bits in one DSP, the others 18 by 18. memory: where tables are kept. dsps: the most
    multipliers that the parallel target may use for products; it builds the others of adders. adders: the most adders
    in a row between two registers of the parallel target, 0 for no register between them. channels: independent copies
    of the states that one pipelined core serves in turn.

    >>> Design(multipliers=2).memory
    <Memory.BLOCK: 'block'>
    """

    multipliers: Annotated[int, whole(MULTIPLIERS[0], MULTIPLIERS[-1])] = 4
    factor: Annotated[int, whole(FACTORS[0], FACTORS[-1])] = FACTORS[-1]
    memory: Annotated[Memory, one_of(Memory)] = Memory.BLOCK
    dsps: Annotated[int, whole(0, LARGEST)] = 0
    adders: Annotated[int, whole(0, LARGEST)] = 3
    channels: Annotated[int, whole(1, LARGEST)] = 1


def named() -> tuple[str, ...]:
    """Every target of the folder: BOTH first, then the others by name."""
    return (*BOTH, *sorted({module.name for module in pkgutil.iter_modules(__path__)} - {*BOTH}))


NAMES = named()


class Register(NamedTuple):
    """Where a design keeps the code of one element of a state."""

    path: str  # below the top, such as "x" or "memory[3]"
    low: int = 0  # the lowest bit of the code in it
    alone: bool = False  # the register holds only this code; if it is wider, the sign is extended


@dataclass(frozen=True)
class Target:
    """A target.

    files: (program, design) -> {file name: text}; it raises InputError for a program that it cannot write.
    """

    files: Callable[["Program", Design], dict[str, str]]


@dataclass(frozen=True)
class Architecture(Target):
    """A target in Verilog. `emit` adds the building blocks of rtl/ and the list of sources, Verilator simulates it.

    registers: (program, design) -> one register for each element of the states, in the order of the program. clocks:
    (program, design) -> clocks from one sample to the next where the bench never waits; a target without it is not
    explored. boot: (program, design) -> clocks after a reset until it is ready, where s_axis_tready does not say so
    before a sample is offered.
    """

    registers: Callable[["Program", Design], list[Register]]
    clocks: Callable[["Program", Design], int] | None = None
    boot: Callable[["Program", Design], int] | None = None


def target(name: str) -> Target:
    """The target of that name. Raises InputError if there is none."""
    if name not in NAMES:
        raise InputError(f"architecture {name!r} does not exist; choose {', '.join(NAMES[:-1])} or {NAMES[-1]}")
    return import_module(f"{__name__}.{name}").TARGET


def architecture(name: str) -> Architecture:
    """The Verilog target of that name. Raises InputError if it does not exist or is not Verilog."""
    found = target(name)
    if not isinstance(found, Architecture):
        raise InputError(f"{name} is not Verilog, so it cannot be simulated or synthesized; choose {' or '.join(BOTH)}")
    return found
