"""A listing for people: the program as text, with a line for each input, state, row, element, output and table.

Numbers are codes. The word behind a shift names its rounding (docs/integer-program.md).
"""

from collections.abc import Callable, Iterator

from greygate.compiler.targets import Target
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Program, Select, Signal, Terminal, Threshold
from greygate.emulator.tables import Lines, Table

LONGEST = 8  # initial codes that are shown


def listing(program: Program) -> dict[str, str]:
    """File name -> text."""
    return {f"{program.name}.txt": "\n".join(_lines(program)) + "\n"}


def _lines(program: Program) -> Iterator[str]:
    yield f"program {program.name}: a step every {program.period:g} s"
    yield from ("", *(f"input {_terminal(p)}" for p in program.inputs))
    if program.states:
        yield ""
    for s in program.states:
        more = ", ..." if len(s.initial) > LONGEST else ""
        initial = ", ".join(map(str, s.initial[:LONGEST])) + more
        yield f"state {_signal(s.signal)} = {s.source} one step before; at first {initial}"
    for o in program.operations:
        yield from ("", f"{o.op.value} {_signal(o.out)}", *(f"    {line}" for line in _BODY[o.op](program, o)))
    yield from ("", *(f"output {_terminal(p)}" for p in program.outputs))
    yield from ("", *map(_table, program.tables)) if program.tables else ()


def _signal(s: Signal) -> str:
    return f"{s.name}[{s.size}] {s.fix}"


def _terminal(p: Terminal) -> str:
    offset = f" + {p.offset:g}" if p.offset else ""
    return f"{p.name}: {_signal(p.signal)}, value = code * {p.signal.fix.lsb * p.scale:g}{offset} {p.unit}"


def _table(t: Table | Lines) -> str:
    if isinstance(t, Lines):
        octaves = ", ".join(f"2^{shift}" for shift in t.shifts)
        return (
            f"table {t.name}: {t.function} from {t.arg} to {t.out}, {t.symmetry}, {t.entries} lines over segments of "
            f"{octaves} codes by octaves, the first of 2^{t.start}; worst error {t.worst_error:g}"
        )
    way = "a line between two" if t.interpolated else "the nearest"
    return (
        f"table {t.name}: {t.function} from {t.arg} to {t.out}, {t.symmetry}, {len(t.points)} points, {1 << t.shift} "
        f"codes apart, {way}; worst error {t.worst_error:g}"
    )


def _shifted(shift: int) -> str:
    return f">> {shift}" if shift >= 0 else f"<< {-shift}"


def _affine(program: Program, o: Affine) -> Iterator[str]:
    columns = [f"{a}[{k}]" for a in o.args for k in range(program.signals[a].size)]
    for r, (weights, bias, frac) in enumerate(zip(o.weights.tolist(), o.bias.tolist(), o.frac.tolist(), strict=True)):
        terms = [f"{w:+d} {column}" for w, column in zip(weights, columns, strict=True) if w]
        total = " ".join([*terms, f"{bias:+d}"] if bias or not terms else terms)
        yield f"[{r}] = ({total}) {_shifted(frac - o.out.fix.frac)}, {o.rounding}, {o.overflow}"


def _lookup(program: Program, o: Lookup) -> Iterator[str]:
    yield f"= {o.table}({o.arg})"


def _clamp(program: Program, o: Clamp) -> Iterator[str]:
    shift = _shifted(program.signals[o.arg].fix.frac - o.out.fix.frac)
    yield f"= ({o.arg}, at least {o.lo}, at most {o.hi}) {shift}, {o.rounding}, {o.overflow}"


def _threshold(program: Program, o: Threshold) -> Iterator[str]:
    yield f"= {o.above} if {o.arg} >= {o.at} else {o.below}"


def _select(program: Program, o: Select) -> Iterator[str]:
    above, below = (f"({a}) {_shifted(program.signals[a].fix.frac - o.out.fix.frac)}" for a in (o.above, o.below))
    yield f"= {above} if {o.condition} >= 0 else {below}, {o.rounding}, {o.overflow}"


_BODY: dict[Op, Callable] = {
    Op.AFFINE: _affine,
    Op.TABLE: _lookup,
    Op.CLAMP: _clamp,
    Op.THRESHOLD: _threshold,
    Op.SELECT: _select,
}
TARGET = Target(lambda program, design: listing(program))
