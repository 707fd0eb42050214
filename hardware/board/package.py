"""The folder that `greygate board` writes: Verilog, pins, makefile and bench of one network on one board.

Names that come from a network are those of `emit`, which Verilog holds; nothing else of a file stands in a template.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from greygate import rtl
from greygate.compiler.verilog import render
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.hardware.board.benches import core_bench, output_codes, port_bench
from greygate.hardware.board.boards import BAUD, BOARDS, FLAGS, PLLS, PORTS, Board
from greygate.hardware.board.frames import seed, width
from greygate.hardware.families import FAMILIES
from greygate.names import check_file_name

SCENARIO, FRAMES = "scenario.hex", "frames.hex"  # what the benches read
BAUD_ERROR = 0.02  # relative: sampled in its middle, the tenth bit of a byte bears 5 % of both ends together


@dataclass(frozen=True)
class Package:
    """One program on one board.

    core: file name -> text, as `emit` made it. mhz: of the core. tick: clocks between two steps, or 0.
    codes: inputs (N, columns) of a scenario, for the benches.
    """

    program: Program
    core: Mapping[str, str]
    board: Board
    port: str
    mhz: float
    baud: int
    tick: int
    codes: np.ndarray

    @property
    def name(self) -> str:
        return self.program.name

    @cached_property
    def dividers(self) -> dict[str, int] | None:
        """Of the PLL; None if the oscillator is the clock. Raises InputError if it makes no such frequency."""
        if self.mhz == self.board.oscillator_mhz:
            return None
        found = PLLS[self.board.pll](self.board.oscillator_mhz, self.mhz)
        if found is None:
            raise InputError(
                f"--mhz {self.mhz:g}: the PLL of this board does not make it of {self.board.oscillator_mhz:g} MHz; "
                f"give another, such as {self.board.clock_mhz:g}"
            )
        return found

    @cached_property
    def clocks_per_bit(self) -> int:
        """Of the UART. Raises InputError for a baud rate that the clock cannot give."""
        found = round(self.mhz * 1e6 / self.baud)
        if found < 4 or abs(self.mhz * 1e6 / found / self.baud - 1) > BAUD_ERROR:
            raise InputError(f"--baud {self.baud}: a clock of {self.mhz:g} MHz does not give it; try {BAUD} or 115200")
        return found

    @cached_property
    def pins(self) -> list[tuple[str, str]]:
        """(port of the top, pin), the clock first."""
        inputs, outputs = PORTS[self.port]
        found = [(p, self.board.pins[p]) for p in ("clk", *inputs, *outputs, *FLAGS)]
        return found + [(port, pin) for port, (pin, _) in self.board.held.items()]

    @property
    def suffix(self) -> str:
        """Of the bitstream."""
        return self.board.toolchain.bitstream if self.board.toolchain else "bit"

    @property
    def constraints(self) -> str:
        """Suffix of the file of pins."""
        return self.board.toolchain.constraints if self.board.toolchain else "xdc"

    @property
    def script(self) -> str:
        """What Yosys does, from the folder of the package."""
        assert self.board.toolchain is not None
        files = " ".join(f"rtl/{name}" for name in self.sources)
        synth = FAMILIES[self.board.toolchain.family].synth.format(top=f"{self.name}__top")
        return f"read_verilog {files}; {synth} -json {self.name}.json"

    @property
    def place(self) -> list[str]:
        """The arguments of nextpnr, from the folder of the package."""
        chain = self.board.toolchain
        assert chain is not None
        files = {
            "json": "json",
            chain.constraints: chain.constraints,
            chain.textual.replace("config", "textcfg"): chain.textual,
        }
        named = [word for option, suffix in files.items() for word in (f"--{option}", f"{self.name}.{suffix}")]
        report = ["--report", f"{self.name}__report.json"]
        return [*self.board.part, *named, "--freq", f"{self.mhz:g}", "--seed", "1", *report]

    @cached_property
    def blocks(self) -> dict[str, str]:
        """File name -> text of the blocks of the port and of the wrappers."""
        names = ("greygate_crc", "greygate_frame", f"greygate_{self.port}", "greygate_last")
        return {f"{name}.v": rtl.block(name).read_text(encoding="utf-8") for name in names}

    @property
    def sources(self) -> list[str]:
        """The Verilog of the design, the top first."""
        own = [f"{self.name}__{part}.v" for part in ("top", "port")]
        core = [name for name in self.core if name.endswith(".v")]
        return [*own, *core, *(name for name in self.blocks if name != "greygate_last.v")]

    def files(self) -> dict[str, str]:
        """Path -> text of every file of the package. Raises InputError for options or names that do not fit."""
        context, name = self.context(), self.name
        texts = {
            f"rtl/{name}__top.v": "top.v",
            f"rtl/{name}__port.v": "port.v",
            f"rtl/{name}__axis.v": "axis.v",
            f"rtl/{name}__axis_last.v": "axis_last.v",
            f"{name}.{self.constraints}": f"pins.{self.constraints}",
            f"{name}.core": "fusesoc.core",
            "Makefile": "Makefile",
            "README.md": "README.md",
        }
        if self.board.toolchain is None:
            texts["build.tcl"] = "build.tcl"
        found = {path: render(t, context, __package__) for path, t in texts.items()}
        copied = {file: text for file, text in self.core.items() if file.endswith(".v")} | self.blocks
        for file, text in copied.items():
            check_file_name(file, f"program {name}: file")
            if f"rtl/{file}" in found:
                raise InputError(f"{name}: two modules would be called {file[:-2]}; rename an operation or a table")
            found[f"rtl/{file}"] = text
        found[f"rtl/{name}.f"] = "\n".join(self.sources) + "\n"
        bits = self.clocks_per_bit if self.port == "uart" else 0
        bench, found[SCENARIO] = core_bench(self.program, self.codes, SCENARIO)
        line, found[FRAMES] = port_bench(self.program, self.codes, self.port, bits, FRAMES)
        return found | {f"bench/{name}__bench.v": bench, f"bench/{name}__port_bench.v": line}

    def context(self) -> dict[str, Any]:
        """What the templates read."""
        board, (inputs, outputs) = self.board, PORTS[self.port]
        wires = {flag: f"{flag}_high" if flag in board.inverted else flag for flag in FLAGS}
        chain = board.toolchain
        return {
            "name": self.name,
            "title": board.title,
            "port": self.port,
            "in_w": width(self.program.inputs),
            "out_w": width(self.program.outputs),
            "seed": seed(self.program),
            "tick": self.tick,
            "baud": self.baud,
            "clocks_per_bit": self.clocks_per_bit if self.port == "uart" else 0,
            "clock_mhz": self.mhz,
            "oscillator_mhz": board.oscillator_mhz,
            "pll": board.pll if self.dividers else None,
            "dividers": self.dividers,
            "inputs": inputs,
            "outputs": output_codes(self.program),
            "pin_outputs": (*outputs, *FLAGS, *board.held),
            "inverted": [flag for flag in FLAGS if flag in board.inverted],
            "held": [(port, level) for port, (_, level) in board.held.items()],
            "connections": [(p, p) for p in (*inputs, *outputs)] + list(wires.items()),
            "pins": self.pins,
            "constraints": self.constraints,
            "suffix": self.suffix,
            "toolchain": chain,
            "flow": chain.flow if chain else "vivado",
            "part": board.part[0],
            "place": " ".join(self.place) if chain else "",
            "script": self.script if chain else "",
            "nextpnr_options": quoted([*board.part, "--freq", f"{self.mhz:g}"]),
            "yosys_options": quoted(["-dsp"] if chain and "-dsp" in self.script else []),
            "load": board.load,
            "sources": self.sources,
            "listings": (SCENARIO, FRAMES),
        }


def quoted(words: Sequence[str]) -> str:
    """A list in YAML."""
    return "[" + ", ".join(f'"{word}"' for word in words) + "]"


def board(name: str) -> Board:
    """The board of that name. Raises InputError if there is none."""
    if name not in BOARDS:
        *others, last = BOARDS
        raise InputError(f"board {name!r} does not exist; choose {', '.join(others)} or {last}")
    return BOARDS[name]


def write(package: Package, folder: Path) -> None:
    """Write every file of the package into a folder that is there."""
    for path, text in package.files().items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(text.encode())
