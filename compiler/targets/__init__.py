"""What an integer program can be written as: every module of this folder is a target, and bears the target's name.

Such a module has one `TARGET`. The target is registered nowhere else: `emit`, the choices of the command line, what
compile.json may name, `verify` and `synthesize` ask here.
"""

import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

from greygate.errors import InputError

if TYPE_CHECKING:  # the command line needs the names at once, and numpy only when it works
    from greygate.emulator.program import Program

BOTH = ("parallel", "folded")  # written unless the user chooses, in the order in which they are reported
MULTIPLIERS = range(1, 257)  # that a target which shares multipliers may be given


def named() -> tuple[str, ...]:
    """Every target of the folder: BOTH first, then the others by name."""
    return (*BOTH, *sorted({module.name for module in pkgutil.iter_modules(__path__)} - {*BOTH}))


NAMES = named()


class Register(NamedTuple):
    """Where a design keeps the code of one element of a state."""

    path: str  # below the top, such as "x" or "memory[3]"
    low: int = 0  # the lowest bit of the code in it
    alone: bool = False  # nothing else stands in it: a wider register holds the code with its sign extended


@dataclass(frozen=True)
class Target:
    """files: (program, multipliers) -> {file name: text}; raises InputError for what it cannot write."""

    files: Callable[["Program", int], dict[str, str]]


@dataclass(frozen=True)
class Architecture(Target):
    """A target in Verilog. `emit` adds the building blocks of rtl/ and the list of sources, Verilator simulates it.

    registers: program -> where it keeps the states, a register for each element, in the order of the program.
    """

    registers: Callable[["Program"], list[Register]]


def target(name: str) -> Target:
    """The target of that name. Raises InputError if there is none."""
    if name not in NAMES:
        raise InputError(f"architecture {name!r} does not exist; choose {', '.join(NAMES[:-1])} or {NAMES[-1]}")
    return import_module(f"{__name__}.{name}").TARGET


def architecture(name: str) -> Architecture:
    """The target of that name, which is Verilog. Raises InputError if it is not, or does not exist."""
    found = target(name)
    if not isinstance(found, Architecture):
        raise InputError(f"{name} is no Verilog, so it cannot be simulated or synthesized; choose {' or '.join(BOTH)}")
    return found
