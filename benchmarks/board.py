"""A network on a board: whole scenarios played through its port, bit by bit, and what the port and the board take.

Usage: python benchmarks/board.py [--bitstream BOARD]... [--design NAME]... [--json FILE]

The network is that of the valve cylinder: as the explorer builds it for the board's FPGA, and as the least design,
serial. The port is the one that the bitstream holds, in Verilator behind a
pseudo terminal, with as many clocks a bit as on the board. The port's own cells are those of Yosys for a core that is
not there; with --bitstream nextpnr places the whole board.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from made import stamp

from greygate import rtl
from greygate.compiler.targets import architecture
from greygate.emulator.program import Program
from greygate.hardware.board.frames import width
from greygate.hardware.board.make import make
from greygate.hardware.board.play import opened, play
from greygate.hardware.board.simulated import simulated_board
from greygate.hardware.build import Project
from greygate.hardware.tools import yosys

BOARD = "icebreaker"
NETWORK = "valve_cylinder"
REQUEST = "--max-error 1.05x --max-latency 20us --max-luts 1300 --max-dsps 3 --max-memories 12"  # 200 LUTs for a port
DESIGNS = {  # name -> options of greygate compile, scenarios that are played
    "folded": (f"--device up5k --architecture folded {REQUEST} --jobs 2", ("training", "v1", "v2")),
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
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
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


def measured(options: str, names: tuple[str, ...], boards: list[str]) -> dict:
    """What one design gives: the port, the scenarios played, the boards placed."""
    with tempfile.TemporaryDirectory() as folder:
        build, package = Path(folder, "build"), Path(folder, "package")
        words = [*NETWORK.split(), *options.split(), "--out", str(build)]
        command = [sys.executable, "-c", "from greygate.cli import run; run()", "compile", *words, "--json"]
        told = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout
        errors = [e for outputs in json.loads(told)["rmse"].values() for e in outputs.values()]
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
            begun = time.perf_counter()
            facts = make(project, board, Path(folder, board), bitstream=True)
            found["boards"][board] = facts | {"seconds": round(time.perf_counter() - begun, 1)}
            if "clocks" in found:
                found["boards"][board]["us_per_step"] = round(found["clocks"] / facts["clock_mhz"], 2)
            print(f"{board}: {found['boards'][board]}")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bitstream", action="append", default=[], help="board to place and route, too")
    parser.add_argument("--design", action="append", choices=DESIGNS, help="only these")
    parser.add_argument("--json", default=Path(__file__).parent / "results" / "board.json", type=Path)
    given = parser.parse_args()
    found = json.loads(given.json.read_text()) if given.json.exists() else {}
    for name in given.design or DESIGNS:
        print(name)
        options, names = DESIGNS[name]
        found[name] = measured(options, names, given.bitstream)
        given.json.write_text(json.dumps(found, indent=1) + "\n")
        stamp(given.json)


if __name__ == "__main__":
    main()
