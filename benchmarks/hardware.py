"""What fixed point costs networks of the catalogue, and whether the Verilog agrees with the emulator, bit by bit.

    python benchmarks/hardware.py NAME ...

RMS error of every record in float and in words of 12, 16 and 18 bits, in the unit of each output; where the catalogue
gives weights and neurons bits beyond the word (`finer`), at 16 bits also without them; and of what pruning left.
Then both architectures at 16 bits in Verilator on the network's scenarios. Kept in results/hardware.json, by name.
"""

import sys
import tempfile
from functools import partial
from pathlib import Path

from made import keep
from threadpoolctl import threadpool_limits

from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.hardware.build import Project
from greygate.machines.catalog import CATALOG
from greygate.machines.kept import ALLOWED
from greygate.machines.source import Source
from greygate.models.accuracy import float_error, rms
from greygate.project import compile_project, verify_project

WIDTHS = (12, 16, 18)


def errors(name: str) -> dict:
    """Record -> "float" or bits of a word -> output -> RMS error."""
    source = Source(name)
    network, records = source.network(), source.records()
    found = {n: {"float": {o: rms(e) for o, e in float_error(network, r).items()}} for n, r in records.items()}
    words = {str(width): source.formats(width) for width in WIDTHS}
    if CATALOG[name].finer:
        words["16, finer 0"] = source.formats(16, 0)
    if prune := CATALOG[name].prune:
        words["pruned, 16"] = source.formats(16)
    for word, formats in words.items():
        own = partial(prune, allowed=ALLOWED) if prune and word.startswith("pruned") else None
        compiled = compile_network(
            network, records, formats, ranged_on=source.training, period=source.period, prune=own
        )
        for record, judged in records.items():
            found[record][word] = {o: rms(e) for o, e in fixed_error(compiled.program, judged).items()}
            if own:
                found[record]["pruned"] = {o: rms(e) for o, e in float_error(compiled.network, judged).items()}
    return found


def verified(name: str) -> dict:
    """Architecture -> clocks of a step, steps, and how many scenarios differ from the emulator in any bit."""
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder) / name
        compile_project(Source(name), where)
        project = Project.open(where)
        verify_project(project, seed=1)
        return {
            architecture: {
                "clocks": facts["clocks_per_step"],
                "steps": sum(s["steps"] for s in facts["scenarios"].values()),
                "scenarios": len(facts["scenarios"]),
                "differing": sum(s["mismatch"] is not None for s in facts["scenarios"].values()),
            }
            for architecture, facts in (project.hardware or {}).items()
        }


if __name__ == "__main__":
    with threadpool_limits(1, "blas"):
        for name in sys.argv[1:] or CATALOG:
            keep("hardware", name, {"rms": errors(name), "verified": verified(name)})
