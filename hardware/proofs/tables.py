"""Every table answers every code as the program says: all codes are tried, which is a proof and no sample."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from greygate.compiler.verilog import render
from greygate.emulator.interpreter import lookup
from greygate.emulator.program import Program
from greygate.hardware.proofs.elaborated import Block, Proof, timed
from greygate.hardware.replay import simulate
from greygate.progress import Progress, silent

WIDEST = 22  # bits of an argument of which all codes are tried
LATEST = 8  # clocks after which an answer is still found
HOW = "simulation of every code of the argument"


def tables(
    files: Sequence[Path], program: Program, modules: Mapping[str, dict], progress: Progress = silent
) -> list[Proof]:
    """A proof for each table module of the design, all in one simulation. modules: of `elaborate`.

    A module has the ports clk, en, x and y, and SIZE neurons; each sees every code, and no two the same one at once.
    Its answer comes a fixed number of clocks later, which the simulation finds.
    """
    found = list(_instances(program, modules))
    known = [(t, block) for t, block in found if t.arg.width <= WIDEST]
    proofs = [
        Proof(
            f"table {t.name} equals the program",
            HOW,
            None,
            0.0,
            f"an argument of {t.arg.width} bits has too many codes",
        )
        for t, _ in found
        if t.arg.width > WIDEST
    ]
    if not known:
        return proofs
    with timed() as seconds:
        data = {f"wanted_{k}.hex": _answers(t) for k, (t, _) in enumerate(known)}
        results = simulate(files, render("tables.v", _context(known), "greygate.hardware"), data, progress=progress)
    for (t, block), result in zip(known, results, strict=True):
        wrong = min(result["wrong"])
        clocks = result["wrong"].index(wrong) + 1
        size = block.ports["x"] // t.arg.width
        figures = {"codes": 1 << t.arg.width, "neurons": size, "wrong": wrong, "clocks": clocks}
        code = result["first"][clocks - 1]
        why = (
            None if wrong == 0 else f"code {code - (1 << t.arg.width) * (code >> (t.arg.width - 1))} has another answer"
        )
        share = seconds[0] / len(known)
        proofs.append(Proof(f"table {t.name} equals the program", HOW, wrong == 0, share, why, figures))
    return proofs


def _instances(program: Program, modules: Mapping[str, dict]) -> Iterator[tuple]:
    """(table, its module with the parameters of the design) for every table module; once for each set of parameters."""
    named = {f"{program.name}_table_{t.name}".replace(".", "__"): t for t in program.tables}
    for name, module in modules.items():
        own = module["attributes"].get("hdlname", name).strip()
        if own in named:
            ports = {p: len(port["bits"]) for p, port in module["ports"].items()}
            yield named[own], Block(own, module.get("parameter_default_values", {}), ports)


def _answers(table) -> str:
    """The answer to each code, the codes in the order of their bits, as lines of hexadecimal."""
    width = table.arg.width
    codes = np.arange(1 << width, dtype=np.int64)
    codes = np.where(codes >> (width - 1), codes - (1 << width), codes)
    mask = (1 << table.out.width) - 1
    return "\n".join(map("{:x}".format, (lookup(table, codes) & mask).tolist())) + "\n"


def _context(known: Sequence[tuple]) -> dict:
    """Of a bench that counts, for each table and each delay of 1 to LATEST clocks, the answers that are not as wanted.

    Neuron n sees the code plus n.
    """
    found = [
        {
            **{"k": k, "a": t.arg.width, "w": t.out.width, "size": block.ports["x"] // t.arg.width},
            **{"module": block.name, "given": block.given()},
        }
        for k, (t, block) in enumerate(known)
    ]
    return {"tables": found, "latest": LATEST, "longest": max(1 << t["a"] for t in found) + LATEST}
