"""A network on a board: whole scenarios played through its port, bit by bit, and what the port and the board take.

The network is that of the valve cylinder: as the explorer builds it for the board's FPGA, and as the least design,
serial. The port is the one that the bitstream holds, in Verilator behind a
pseudo terminal, with as many clocks a bit as on the board. The port's own cells are those of Yosys for a core that is
not there; with --bitstream nextpnr places the whole board.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from simulated_board import simulated_board

from greygate import rtl
from greygate.compiler.targets import architecture
from greygate.emulator.program import Program
from greygate.hardware.board.frames import width
from greygate.hardware.board.make import make
from greygate.hardware.board.play import opened, play
from greygate.hardware.build import Project
from greygate.hardware.tools import yosys

from .made import store, stored
from .shared import VERILATOR, scratch, stopwatch, told

TAKES = "ten minutes"
NEEDS = VERILATOR
BOARD = "icebreaker"
NETWORK = "valve_cylinder"
REQUEST = "--max-error 1.05x --max-latency 20us --max-luts 1300 --max-dsps 3 --max-memories 12"  # 200 LUTs for a port
DESIGNS = {  # name -> options of greygate, scenarios that are played
    "folded": (f"--target up5k --architecture folded {REQUEST} --jobs 2", ("training", "v1", "v2")),
    "serial": ("--architecture serial", ("v2",)),
}
CLOCKS_PER_BIT = 24  # of 1,000,000 baud at 24 MHz


def port_alone(program: Program) -> dict[str, int]:
    """iCE40 cells of UART, frame and check sum, as wide as the program needs them."""
    ends = [
        *(
            "input clk, input rst, input rxd, output txd",
            "output core_rst, output step, output overrun, output refused",
        ),
        f"output [{width(program.inputs) - 1}:0] sample, output sample_tvalid, input sample_tready",
        f"input [{width(program.outputs) - 1}:0] result, input result_tvalid, output result_tready, input limited",
    ]
    line = {name: name for name in ("clk", "rst", "talk", "tx_bit", "sent", "rx_bit", "heard", "eighth", "broken")}
    uart = line | {"rxd": "rxd", "txd": "txd"}
    core = {name: name for name in re.findall(r"(?:put) (?:\[\d+:0\] )?(\w+)", " ".join(ends[1:]))}
    frame = line | {{"sample": "sample_tdata", "result": "result_tdata"}.get(k, k): v for k, v in core.items()}
    text = f"module port ({', '.join(ends)});\nwire talk, tx_bit, sent, rx_bit, heard, eighth, broken;\n"
    for module, parameters, ports in (
        ("greygate_uart", f".CLOCKS({CLOCKS_PER_BIT})", uart),
        ("greygate_frame", f".IN_W({width(program.inputs)}), .OUT_W({width(program.outputs)}), .SEED(16'h1234)", frame),
    ):
        text += f"{module} #({parameters}) {module}_i ({', '.join(f'.{k}({v})' for k, v in ports.items())});\n"
    with scratch() as where:
        files = ["port.v", *(f"greygate_{name}.v" for name in ("uart", "frame", "crc"))]
        (where / "port.v").write_text(f"{text}endmodule\n")
        for name in files[1:]:
            (where / name).write_text(rtl.block(name[:-2]).read_text())
        script = f"read_verilog {' '.join(files)}; synth_ice40 -dsp -top port; tee -q -o stat stat -json"
        yosys(script, where)
        cells = json.loads((where / "stat").read_text())["design"]["num_cells_by_type"]
    return {"lut4": cells["SB_LUT4"], "flip_flops": sum(n for cell, n in cells.items() if cell.startswith("SB_DFF"))}


def played(project: Project, package: Path, names: tuple[str, ...]) -> dict[str, dict]:
    """Scenario -> what came of playing it, whole."""
    found = {}
    with simulated_board(package, CLOCKS_PER_BIT) as terminal:
        for name, scenario in project.scenarios(names).items():
            with opened(terminal, 1_000_000) as line:
                result = play(project.program, scenario.inputs, scenario.outputs, line)
            found[name] = asdict(result) | {"bits": result.samples * width(project.program.outputs)}
            print(f"{name}: {result.samples} samples, differing bits {result.differing_bits}, {result.seconds:.0f} s")
    return found


def measured(options: str, names: tuple[str, ...], boards: Sequence[str]) -> dict:
    """What one design gives: the port, the scenarios played, the boards placed."""
    with scratch() as folder:
        build, package = folder / "build", folder / "package"
        compiled = told("compile", NETWORK, *options.split(), "--out", build)
        errors = [e for outputs in compiled["rmse"].values() for e in outputs.values()]
        project = Project.open(build)
        make(project, BOARD, package)
        clocks = architecture(project.designs[0]).clocks
        found: dict = {"compile": f"{NETWORK} {options}", "port": port_alone(project.program)}
        found["error"] = round(max(e["fixed"] / e["float"] for e in errors), 4)  # times that of float
        if clocks is not None:
            found["clocks"] = clocks(project.program, project.design)
        print(f"error {found['error']} of float, {found.get('clocks')} clocks a step")
        print(f"port alone: {found['port']}")
        found |= {"played": played(project, package, names), "boards": {}}
        for board in boards:
            watch = stopwatch()
            facts = make(project, board, folder / board, bitstream=True)
            found["boards"][board] = facts | {"seconds": watch(1)}
            if "clocks" in found:
                found["boards"][board]["us_per_step"] = round(found["clocks"] / facts["clock_mhz"], 2)
            print(f"{board}: {found['boards'][board]}")
    return found


def main(
    *designs: Annotated[str, DESIGNS], bitstream: Annotated[Sequence[str], "boards to place and route, too"] = ()
) -> None:
    found = stored("board")
    for name in designs or DESIGNS:
        print(name)
        found[name] = measured(*DESIGNS[name], bitstream)
        store("board", found)
