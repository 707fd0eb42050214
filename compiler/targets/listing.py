"""A listing for people: the program as text, with a line for each input, state, row, element, output and table.

Numbers are codes. The word behind a shift names its rounding (docs/integer-program.md).
"""

from collections.abc import Iterator

from greygate.compiler.targets import Target
from greygate.compiler.verilog import render
from greygate.emulator.program import Affine, Program

LONGEST = 8  # initial codes that are shown


def listing(program: Program) -> dict[str, str]:
    """File name -> text."""
    return {f"{program.name}.txt": render("listing.txt", {"program": program, "rows": _rows, "longest": LONGEST})}


def _rows(program: Program, o: Affine) -> Iterator[str]:
    columns = [f"{a}[{k}]" for a in o.args for k in range(program.signals[a].size)]
    for r, (weights, bias, frac) in enumerate(zip(o.weights.tolist(), o.bias.tolist(), o.frac.tolist(), strict=True)):
        terms = [f"{w:+d} {column}" for w, column in zip(weights, columns, strict=True) if w]
        total = " ".join([*terms, f"{bias:+d}"] if bias or not terms else terms)
        shift = frac - o.out.fix.frac
        yield f"[{r}] = ({total}) {f'>> {shift}' if shift >= 0 else f'<< {-shift}'}, {o.rounding}, {o.overflow}"


TARGET = Target(lambda program, design: listing(program))
