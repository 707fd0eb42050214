"""A design of a build as a folder for FuseSoC, Vivado and Quartus, with benches in Verilog and in cocotb."""

from pathlib import Path
from typing import TypedDict

from greygate.compiler.emit import emitted
from greygate.compiler.verilog import lane_width, render
from greygate.emulator.program import Terminal
from greygate.errors import InputError
from greygate.files import replacing_folder
from greygate.hardware.board.benches import core_bench
from greygate.hardware.board.frames import width
from greygate.hardware.build import Project

PART, DEVICE = "xc7a35tcsg324-1", "5CSEMA5F31C6"  # of two common boards; an argument of the scripts replaces them
SCENARIO = "bench/scenario.hex"
LATER = r"build/.*|bench/(__pycache__/.*|\w+\.(xml|vcd|fst))|\w+\.rpt|fusesoc\.conf|\.Xil/.*|vivado.*"  # of the tools
FOLDED = "folded"  # unless another is asked for: the smaller one


class ExportedCore(TypedDict):
    """A core for FuseSoC."""

    out: str
    core: str
    architecture: str
    files: list[str]


def export_fusesoc(project: Project, out: Path | str, architecture: str | None = None) -> ExportedCore:
    """Write one design of a build as such a folder, completely or not at all; what it holds.

    Raises InputError for an architecture that the build has not, and for Verilog that was changed.
    """
    usual = FOLDED if FOLDED in project.designs else project.designs[0]
    chosen = usual if architecture is None else architecture
    if chosen not in project.designs:
        raise InputError(f"{project.folder}: has no architecture {chosen!r}; it has {', '.join(project.designs)}")
    if edited := project.edited():
        raise InputError(f"{edited[0]}: is not the Verilog of program.json; compile again")
    program = project.program
    name, core = program.name, emitted(program, chosen, project.design)
    first = project.source.scenarios[0]
    bench, words = core_bench(program, project.scenarios((first,))[first].inputs, SCENARIO)
    context = {
        "name": name,
        "architecture": chosen,
        "sources": [file for file in core if file.endswith(".v")],
        "lanes": [*_lanes("sample", program.inputs), *_lanes("result", program.outputs)],
        "in_bytes": width(program.inputs) // 8,
        "part": PART,
        "device": DEVICE,
    }
    texts = {
        f"{name}.core": "core",
        f"{name}.sdc": "clock.sdc",
        "vivado.tcl": "vivado.tcl",
        "quartus.tcl": "quartus.tcl",
        "README.md": "README.md",
        f"bench/test_{name}.py": "cocotb.py",
        "bench/run.py": "run.py",
    }
    files = {path: render(template, context, "greygate.export") for path, template in texts.items()}
    files |= {f"rtl/{file}": text for file, text in core.items()}
    files |= {f"bench/{name}__bench.v": bench, SCENARIO: words}
    with replacing_folder(out, "export", LATER) as new:
        for path, text in files.items():
            (new / path).parent.mkdir(exist_ok=True)
            (new / path).write_text(text, encoding="utf-8", newline="\n")
    return {"out": str(out), "core": f"greygate::{name}:1.0.0", "architecture": chosen, "files": sorted(files)}


def _lanes(word: str, ports: tuple[Terminal, ...]) -> list[str]:
    """Which bytes of a word hold which port."""
    found, start = [], 0
    for p in ports:
        size = lane_width(p.signal) // 8
        for r in range(p.signal.size):
            name = p.name if p.signal.size == 1 else f"{p.name}[{r}]"
            step = f"step {p.signal.fix.lsb * p.scale:.9g}, offset {p.offset:.9g}, unit {p.unit or '1'}"
            found.append(f"{word}[{start}:{start + size}]: {name}, {p.signal.fix}, {step}")
            start += size
    return found
