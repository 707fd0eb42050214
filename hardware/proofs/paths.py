"""Combinational paths of a module: which outputs change within a clock when an input does.

Bits are followed from each input through every cell but registers and the reads of a memory that wait for a clock.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from greygate.hardware.proofs.elaborated import elaborate
from greygate.progress import Progress, silent

FLAT = "flatten; opt; memory_dff; memory_collect; opt_clean"
REGISTERS = ("$dff", "$adff", "$sdff", "$aldff", "$ff", "$dlatch")  # and what else begins like them
CONTROL = ("clk", "rst")  # rst alone closes s_axis_tready in its own clock (docs/integer-program.md, "At the edges")


def paths(files: Sequence[Path], top: str, progress: Progress = silent) -> list[tuple[str, str]]:
    """(input, output) of each pair of ports of the top with a path between, but for clock and reset."""
    module = elaborate(files, top, FLAT, progress)[top]
    ports, reads = module["ports"], _reads(module["cells"])
    found = []
    for name, port in ports.items():
        if port["direction"] == "input" and name not in CONTROL:
            reached = _reached(port["bits"], reads)
            found += [(name, o) for o, p in ports.items() if p["direction"] == "output" and reached & {*p["bits"]}]
    return found


def _reads(cells: Mapping[str, Mapping]) -> dict[object, set]:
    """Bit -> the bits that follow it within a clock."""
    found: dict[object, set] = {}
    for cell in cells.values():
        if cell["type"].startswith(REGISTERS):
            continue
        ends = cell["connections"]
        outs = {b for p, bits in ends.items() if cell["port_directions"][p] == "output" for b in bits}
        ins = [b for p, bits in ends.items() if cell["port_directions"][p] == "input" for b in bits]
        if cell["type"].startswith("$mem"):
            if "0" not in cell["parameters"]["RD_CLK_ENABLE"]:
                continue
            ins = ends["RD_ADDR"]
        for bit in ins:
            found.setdefault(bit, set()).update(outs)
    return found


def _reached(bits: Sequence, reads: Mapping[object, set]) -> set:
    seen, open_ = {*bits}, [*bits]
    while open_:
        for bit in reads.get(open_.pop(), ()):
            if bit not in seen:
                seen.add(bit)
                open_.append(bit)
    return seen
