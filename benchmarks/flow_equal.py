"""The flow network on equal terms: one error, one family, one Yosys script, and what else a design is bought with.

Ours parallel and pipelined, with weights rounded jointly; ours pipelined on plain weights; da4ml and alkaid, with its
default and its best solver, as they come; and both on our program's weights and formats. An interval is the clocks from
one sample to the next, a latency those from a sample to its result.
"""

from typing import Annotated

import numpy as np

from greygate.compiler.emit import emit
from greygate.compiler.explore.judge import Bound, Judge, Scale
from greygate.compiler.explore.trail import Maker
from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.targets import Design, architecture
from greygate.compiler.targets.pipelined import _Pipelined
from greygate.emulator.numbers import Fix
from greygate.emulator.program import Affine, Lookup, Program
from greygate.hardware.synthesis import synthesize

from . import shared
from .flow import arrays, flow
from .flow_designs import DESIGNS, PEER_WIDTH, WIDTHS, beside, smallest
from .made import store, stored
from .shared import scratch

TAKES = "ten minutes"
FAMILY = "xilinx"
SOLVERS = ("da4ml", "alkaid", "alkaid-mc")
WHOLE = 2  # bits of an argument of a peer's table: beyond 4, tanh is 1 to 10 bits


def terms(program: Program) -> dict:
    """What a design is bought with: bits of each input and of the output, weights other than zero."""
    sums = [o for o in program.operations if isinstance(o, Affine)]
    return {
        "edges": [*(p.signal.fix.width for p in program.inputs), *(p.signal.fix.width for p in program.outputs)],
        "weights": int(sum(np.count_nonzero(o.weights) for o in sums)),
    }


def ours(program: Program, name: str, design: Design, limit: float) -> dict:
    """Cells, interval and latency of a program as that architecture."""
    if name == "pipelined":
        core = _Pipelined(program, design)
        clocks = {"interval": core.interval, "latency": max(core.stage.values()) + 2}
    else:
        count = architecture(name).clocks
        assert count is not None
        clocks = dict.fromkeys(("interval", "latency"), count(program, design))
    with scratch() as folder:
        emit(program, folder, name, design)
        return terms(program) | clocks | synthesize(folder, program.name, FAMILY, limit=limit)


def plain(rms: float) -> tuple[Program, float]:
    """The shortest word with weights rounded one by one that keeps the error, and its error."""
    network, record = flow()
    compiled = compile_network(network, {"grid": record})
    judge = Judge(compiled.network, {"grid": record}, Bound(rms, Scale.UNIT, "", {"y": 1.0}))
    make = Maker(compiled.network, compiled.ranges, judge, compiled.program.period, [record])
    found = (make(Formats(width)) for width in WIDTHS)
    one = next(c for c in found if c is not None and c.error <= rms)
    return one.program, one.error


def for_peers(program: Program) -> dict[str, np.ndarray]:
    """Our weights, biases and formats, as flow_peers.py reads them; arguments of tables as short as full ones allow."""
    data, fixes = arrays(), [program.inputs[0].signal.fix]
    sums = [o for o in program.operations if isinstance(o, Affine)]
    for n, o in enumerate(sums, 1):
        fracs = np.concatenate([[program.signals[a].fix.frac] * program.signals[a].size for a in o.args])
        data[f"w{n}"] = np.ldexp(o.weights.astype(float), fracs[None, :] - o.frac[:, None])
        data[f"b{n}"] = np.ldexp(o.bias.astype(float), -o.frac)
        answers = [p.out.fix for p in program.operations if isinstance(p, Lookup) and p.arg == o.out.name]
        fixes += [_indexing(o.out.fix) if answers else o.out.fix, *answers]
    return data | {"fixes": np.array([(fix.width, fix.frac) for fix in fixes])}


def _indexing(fix: Fix) -> Fix:
    """The argument of a table with a word for every code: 13 bits in place of 15, which double its memory twice."""
    return Fix(1 + min(fix.width - 1 - fix.frac, WHOLE) + fix.frac, fix.frac)


def main(
    *rows: Annotated[str, "ours, plain, peers, equal"],
    limit: shared.Limit = 300.0,
    peers: shared.Peers = shared.PEERS,
) -> None:
    found = stored("flow_equal")
    rms, prices, design = DESIGNS["coarse"]

    def keep(name: str, row: dict) -> None:
        found[name] = row
        store("flow_equal", found)
        print(name, row, flush=True)

    best = smallest(rms, prices, design) if {*rows} != {"peers"} else None
    if best and (not rows or "ours" in rows):
        for name in ("parallel", "pipelined"):
            keep(f"ours {name}", {"rms": best.error} | ours(best.program, name, design, limit))
    if not rows or "plain" in rows:
        program, error = plain(rms)
        keep("ours pipelined, plain weights", {"rms": error} | ours(program, "pipelined", design, limit))
    for package in SOLVERS if peers.exists() else ():
        if best and (not rows or "equal" in rows):
            row = beside(peers, package, (FAMILY,), limit, for_peers(best.program))
            keep(f"{package}, our weights", terms(best.program) | {"interval": 1, **told(row)})
        if not rows or "peers" in rows:
            row = told(beside(peers, package, (FAMILY,), limit))
            sizes = sum(int(np.count_nonzero(arrays()[f"w{n}"])) for n in (1, 2, 3))
            keep(package, {"edges": [PEER_WIDTH] * 3, "weights": sizes, "interval": 1, **row})


def told(row: dict) -> dict:
    return {k: v for k, v in row.items() if k != FAMILY} | row[FAMILY]
