"""What fixed point costs networks of the catalogue, and whether the Verilog agrees with the emulator, bit by bit.

RMS error of every record in float and in words of 12, 16 and 18 bits, in the unit of each output; where the catalogue
gives weights and neurons bits beyond the word (`finer`), at 16 bits also without them; and of what pruning left.
Then both architectures at 16 bits in Verilator on the network's scenarios.
"""

from functools import partial

from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.hardware.build import Project
from greygate.machines.catalog import CATALOG
from greygate.machines.kept import ALLOWED
from greygate.machines.source import Source
from greygate.models.accuracy import float_error, rms
from greygate.project import compile_project, verify_project

from .shared import scratch

TAKES = "not timed"

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
    with scratch() as folder:
        compile_project(Source(name), folder / name)
        project = Project.open(folder / name)
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


def judged(name: str) -> dict:
    return {"rms": errors(name), "verified": verified(name)}


PARTS = {name: partial(judged, name) for name in CATALOG}
