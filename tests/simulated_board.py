"""A board in simulation: the port of a package in Verilator, its UART behind a pseudo terminal, bit by bit."""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from greygate.children import PIPE, started
from greygate.errors import InputError
from greygate.files import scratch
from greygate.hardware.verify import OPTIONS, run_logged, runtime_cache, simulator_environment

DRIVER = Path(__file__).with_name("simulated_board.cpp")


def build(package: Path | str, folder: Path | str, clocks_per_bit: int, tick: int | None = None) -> Path:
    """Build the simulation of a package with a UART, in `folder`; return the program. Raises InputError if that fails.

    clocks_per_bit: of the line, instead of those that its baud rate has on the board: few of them simulate faster.
    tick: clocks between two steps, instead of those of the package.
    """
    package, folder = Path(package).resolve(), Path(folder).resolve()
    names = [path.stem for path in (package / "rtl").glob("*.f")]
    if len(names) != 1 or not re.fullmatch(r"\w+", names[0]):
        raise InputError(f"{package}: not a folder that greygate board wrote")
    (name,) = names
    files = (package / "rtl" / f"{name}.f").read_text(encoding="utf-8").split()
    sources = [str(package / "rtl" / file) for file in files if file != f"{name}__top.v"]
    environment = simulator_environment()
    ticks = [] if tick is None else [f"-GTICK={tick}"]
    command = [
        *("verilator", "--cc", "--exe", "--quiet", "--prefix", "Vport", "--top-module", f"{name}__port", "-Mdir", "."),
        *("-o", "simulated", f"-GCLOCKS_PER_BIT={clocks_per_bit}", *ticks, "-O3", "--x-assign", "fast", "-Wno-lint"),
        *(str(DRIVER), *sources),
    ]
    run_logged(command, folder / "verilator.log", environment, folder)
    for path in runtime_cache(environment, waves=False).glob("verilated*.o"):  # as `verify` left it
        shutil.copy(path, folder)
    make = ["make", "-j", str(os.cpu_count() or 1), "-f", "Vport.mk", *OPTIONS, "OPT_FAST=-O2"]
    run_logged(make, folder / "make.log", environment, folder)
    return folder / "simulated"


@contextmanager
def simulated_board(package: Path | str, clocks_per_bit: int = 24, flip: int = 0) -> Iterator[str]:
    """Build and run the simulation; yield the path of its terminal.

    flip: turn over a bit in one of so many bytes on the line, in either direction; 0: none.
    """
    with scratch() as temporary:
        program = build(package, temporary, clocks_per_bit)
        with running(program, clocks_per_bit, flip) as terminal:
            yield terminal


@contextmanager
def running(program: Path, clocks_per_bit: int, flip: int = 0) -> Iterator[str]:
    """Run a simulation that was built; yield the path of its terminal."""
    command = [str(program), str(clocks_per_bit), *([str(flip)] if flip else [])]
    with started(command, stdout=PIPE) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
