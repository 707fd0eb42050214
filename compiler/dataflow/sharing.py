"""Which tables of the parallel architecture serve several operations of a step, one after the other.

A unit answers an operation from the clock in which its argument stands until that of the next operation stands. What
reads such an answer is done by then, and takes its own result at that clock, because the answer does not stay.
"""

from greygate.compiler.dataflow import Dataflow
from greygate.compiler.verilog import LOOKUP_CLOCKS, shared_tables
from greygate.emulator.program import Lookup, Operation


def units(core: Dataflow) -> list[list[Lookup]]:
    """The lookups, a list for each unit, in the order in which the unit serves them."""
    tables = shared_tables(core.program)
    found: list[list[Lookup]] = []
    lookups = [o for o in core.program.operations if isinstance(o, Lookup)]
    for o in sorted(lookups, key=lambda o: core.since[o.arg]):
        free = [u for u in found if tables[u[0].table] is tables[o.table] and _gives_way(core, u[-1], o)]
        if free:
            min(free, key=lambda u: abs(max(p.out.size for p in u) - o.out.size)).append(o)
        else:
            found.append([o])
    return found


def _gives_way(core: Dataflow, before: Lookup, after: Lookup) -> bool:
    """Whether all who read the answers to `before` are done with them when those to `after` take their place."""
    program, name = core.program, before.out.name
    if core.since[after.arg] <= core.since[before.arg]:
        return False
    if name in {p.signal.name for p in program.outputs} | {s.source for s in program.states}:
        return False
    gone = core.since[after.arg] + LOOKUP_CLOCKS
    return all(not isinstance(o, Lookup) and core.since[o.out.name] <= gone for o in readers(core, name))


def readers(core: Dataflow, name: str) -> list[Operation]:
    """The operations that read a signal."""
    return [o for o in core.program.operations if name in o.args]
