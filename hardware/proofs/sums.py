"""Each affine operation of the parallel architecture computes its matrix, without overflow, and rounds as it should.

The emitted module is read back: its adders give the weights of each sum and the exact range of each (affine.py). What
follows a sum, rounding and saturation, is proved by z3 for every value of the sum.
"""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np

from greygate.compiler.limits import clamps_behind
from greygate.emulator.interpreter import lookup
from greygate.emulator.numbers import Overflow, Rounding
from greygate.emulator.program import Affine as Operation
from greygate.emulator.program import Clamp, Lookup, Program
from greygate.errors import InputError
from greygate.hardware.proofs.accumulators import reachable
from greygate.hardware.proofs.affine import ADDERS, Affine, Module, Rest, Some, Unknown, Value, Vector, signed_bits
from greygate.hardware.proofs.elaborated import Proof, elaborate, timed
from greygate.progress import Progress, silent

FLAT = "flatten; opt_expr; opt_dff -nosdff; opt_clean"  # registers that hold are registers with an enable
HOW = "symbolic evaluation of the emitted adders"
SPARE = 4  # bits beyond what the widest number needs
MILLISECONDS = 60_000  # of z3, for one row


def sums(files: Sequence[Path], program: Program, progress: Progress = silent) -> list[Proof]:
    """Proofs of every affine operation that has a module of its own: matrix and rounding; and of all adders, overflow.

    files: of the design. None if its architecture has no such modules.
    """
    names = {f"{program.name}_{o.out.name.replace('.', '__')}.v" for o in program.operations}
    own = [path for path in files if path.name in names]
    if not own:
        return []
    blocks = [path for path in files if path.name.startswith("greygate_")]
    modules = elaborate([*own, *blocks], None, FLAT, progress)
    progress("adders")
    reach = reachable(program)
    found: list[Proof] = []
    rows: list[dict] = []
    wrong = None
    operations = [o for o in program.operations if isinstance(o, Operation)]
    with timed() as seconds:
        for o in operations:
            module = _module(program, o, modules, reach)
            if module is None:
                continue
            found.append(_operation(program, o, module))
            for name, (value, width) in module.sums().items():
                needed = signed_bits(value.lo, value.hi)
                fits = needed <= width or value.fits(width, False)
                row = {"operation": o.out.name, "signal": name, "lo": value.lo, "hi": value.hi, "width": width}
                rows.append(row | {"spare": width - needed})
                if not fits and wrong is None:
                    wrong = f"{o.out.name}: {name} takes {value.lo} to {value.hi}, which {width} bits do not hold"
    if rows:
        figures = {"adders": len(rows), "bits": sum(row["width"] for row in rows)}
        found.append(Proof("no adder overflows", HOW, wrong is None, seconds[0], wrong, figures, tuple(rows)))
    return found


def _module(program: Program, o: Operation, modules: Mapping[str, dict], reach: Mapping) -> Module | None:
    """The module of an operation; None if the architecture has none."""
    names = {name: name.replace(".", "__") for name in program.signals}
    json = modules.get(f"{program.name}_{names[o.out.name]}")
    if json is None:
        return None
    elements, ranges = {}, {}
    for a in dict.fromkeys(o.args):
        signal = program.signals[a]
        for k in range(signal.size):
            elements[f"{a}[{k}]"] = (names[a], k * signal.fix.width, signal.fix.width)
            ranges[f"{a}[{k}]"] = reach[a][k]
    return Module(json, elements, ranges)


def _operation(program: Program, o: Operation, module: Module) -> Proof:
    """Every row has the weights and the bias of the program, and is rounded as the program says."""
    what = f"{o.out.name}: {o.out.size} rows equal the matrix and its rounding"
    clamp = clamps_behind(program).get(o.out.name)
    if clamp:
        what += ", limited"
    with timed() as seconds:
        port = module.json["ports"][o.out.name.replace(".", "__")]["bits"]
        width, why, told, unshown = o.out.fix.width, None, 0, None
        for r in range(o.out.size):
            bits = port[r * width : (r + 1) * width]
            try:
                less = _row(o, r, expected(program, o, r), module, bits, clamp)
            except _Different as error:
                why = f"row {r}: {error}"
                break
            except _Unknown as error:
                unshown = f"row {r}: {error}"
                break
            told = max(told, less)
        if told and why is None:
            why = _alike(program, o, told)
    how = f"{HOW}, and z3 for the rounding"
    figures: dict[str, Any] = {"adders": len(module.sums())}
    if told:
        figures["low bits that its tables do not tell apart where it saturates"] = told
    return Proof(what, how, False if why else None if unshown else True, seconds[0], why or unshown, figures)


class _Different(Exception):
    """The row is not that of the program."""


class _Unknown(Exception):
    """Nothing could be shown of the row."""


def expected(program: Program, o: Operation, r: int) -> Affine:
    """bias + weights * elements of row r, as the program has it."""
    elements = [f"{a}[{k}]" for a in o.args for k in range(program.signals[a].size)]
    found = Affine({}, Fraction(int(o.bias[r])))
    for name, weight in zip(elements, o.weights[r].tolist(), strict=True):
        if weight:
            found = found + Affine({name: Fraction(weight)})
    return found


def _row(o: Operation, r: int, wanted: Affine, module: Module, bits: Sequence, clamp: Clamp | None) -> int:
    """Prove one row, limited by `clamp`. Returns how many low bits differ where it saturates, mostly 0."""
    try:
        import z3
    except ImportError:
        raise InputError("z3 is not installed; pip install greygate[proof]") from None
    from greygate.hardware.proofs.words import Words

    wanted = moving(wanted, module.reach)
    lo, hi = (int(v) for v in wanted.range(module.reach))
    shift = int(o.frac[r]) - o.out.fix.frac
    wide = max(signed_bits(lo, hi), o.out.fix.width) + abs(shift) + SPARE
    acc = z3.BitVec("acc", wide)
    solver = z3.Solver()
    solver.set("timeout", MILLISECONDS)
    solver.add(acc >= lo, acc <= hi)
    if step := gcd(*(int(w) for w in wanted.weights.values())):  # bits of the sum that never change
        same = (step & -step).bit_length() - 1
        solver.add(acc & ((1 << same) - 1) == int(wanted.const) & ((1 << same) - 1))
    rests: dict[Rest | Some, Any] = {}
    other: list[str] = []  # adders on the way that are no affine functions: what they take need not be the row's sum

    def cut(vector: Vector) -> Any:
        value = module.value(vector)
        if value is None:
            other.extend([module.name(vector)] if module.cells[vector[0]]["type"] in ADDERS else [])
            return None
        variable = z3.BitVec(f"{vector[0]}.{vector[1]}", module.width(vector))
        try:
            _relate(solver, acc, wanted, value, variable, rests, module.name(vector), module.reach)
        except _Different:
            if other:
                raise _Unknown(f"what adder {other[0]} computes is not known here") from None
            raise
        return variable

    try:
        given = Words(module, cut).word(bits)
    except NotImplementedError as error:
        raise _Unknown(f"a cell {error} after the sum is not known here") from None
    answer, beyond = _rounded(acc, shift, o)
    if clamp:
        least, most = (z3.BitVecVal(end, answer.size()) for end in (clamp.lo, clamp.hi))
        answer = z3.If(answer < least, least, z3.If(answer > most, most, answer))
    for told in (0, *range(o.out.fix.width)):
        same = z3.Extract(o.out.fix.width - 1, told, given) == z3.Extract(o.out.fix.width - 1, told, answer)
        if told:
            same = z3.And(same, z3.Or(beyond, given == answer))
        verdict = solver.check(z3.Not(same))
        if verdict == z3.unsat:
            return told
        if verdict == z3.unknown:
            raise _Unknown("z3 gave up")
        model = solver.model()
        sum_ = model.eval(acc, model_completion=True).as_signed_long()
        got, right = (model.eval(part, model_completion=True).as_signed_long() for part in (given, answer))
        if not z3.is_true(model.eval(beyond)):
            break
    if not _occurs(sum_, {r: model.eval(e, model_completion=True).as_long() for r, e in rests.items()}, wanted, module):
        raise _Unknown(f"a sum of {sum_} would be rounded to {got}, not {right}, if dropped bits could be any")
    raise _Different(f"a sum of {sum_} is rounded to {got}, not {right}")


def _occurs(total: int, rests: Mapping[Rest | Some, int], wanted: Affine, module: Module) -> bool:
    """Whether elements within their ranges give this sum, and dropped bits of these values."""
    import z3

    if not rests:
        return True
    solver, elements = z3.Solver(), {}
    solver.set("timeout", MILLISECONDS)
    for name, (lo, hi) in module.reach.items():
        elements[name] = z3.Int(name)
        solver.add(elements[name] >= lo, elements[name] <= hi)

    def number(name: Unknown) -> Any:
        if isinstance(name, str):
            return elements[name]
        weights, const = name.of
        low = (z3.Sum([w * number(n) for n, w in weights]) + const) % (1 << name.bits)
        return z3.If(low == 0, 0, 1) if isinstance(name, Some) else low

    solver.add(z3.Sum([int(w) * number(n) for n, w in wanted.weights.items()]) + int(wanted.const) == total)
    solver.add(*(number(rest) == value for rest, value in rests.items()))
    return solver.check() == z3.sat


def _relate(
    solver: Any,
    acc: Any,
    wanted: Affine,
    value: Value,
    variable: Any,
    rests: dict[Rest | Some, Any],
    name: str,
    reach: Mapping[str, tuple[int, int]],
) -> None:
    """Tell the solver what the vector has to do with the row's sum; raise _Different if nothing.

    rests: unknowns that stand for dropped bits -> their expressions; of these only the range is told.
    """
    import z3

    function = moving(value.function, reach)
    of_elements = Affine({n: w for n, w in function.weights.items() if isinstance(n, str)}, function.const)
    others = {n: w for n, w in function.weights.items() if not isinstance(n, str)}
    factor = _factor(of_elements, wanted) if of_elements.weights else Fraction(0)
    if factor is None:
        raise _Different(_first(function, wanted, name))
    const = function.const - factor * wanted.const
    size = max(v.denominator for v in (factor, const, *others.values()))
    left, right = size, int(factor * size)
    longest = max(acc.size() + abs(right).bit_length(), variable.size() + left.bit_length())
    longest = max(longest, *(n.bits + abs(int(w * size)).bit_length() + len(others) for n, w in others.items()), 0)
    longest += SPARE
    signed = value.fits(variable.size(), True)
    whole = (z3.SignExt if signed else z3.ZeroExt)(longest - variable.size(), variable)
    found = z3.SignExt(longest - acc.size(), acc) * right + int(const * size)
    for rest, w in others.items():
        expression = rests.setdefault(rest, z3.BitVec(f"rest {len(rests)}", 1 if isinstance(rest, Some) else rest.bits))
        found = found + z3.ZeroExt(longest - expression.size(), expression) * int(w * size)
    solver.add(whole * left == found)


def moving(function: Affine, reach: Mapping[str, tuple[int, int]]) -> Affine:
    """The function without the elements that are always 0, whatever their weights."""
    return Affine(
        {n: w for n, w in function.weights.items() if not (isinstance(n, str) and reach.get(n) == (0, 0))},
        function.const,
    )


def _factor(function: Affine, wanted: Affine) -> Fraction | None:
    """function = factor * wanted + a constant; None if there is no such factor."""
    if set(function.weights) != set(wanted.weights):
        return None
    factors = {function.weights[n] / wanted.weights[n] for n in wanted.weights}
    return factors.pop() if len(factors) == 1 else None


def _first(function: Affine, wanted: Affine, name: str) -> str:
    """The first weight in which a sum differs from the program."""
    scale = max(
        (function.weights[n] / w for n, w in wanted.weights.items() if n in function.weights), default=Fraction(1)
    )
    for n in dict.fromkeys((*wanted.weights, *function.weights)):
        given, right = function.weights.get(n, Fraction(0)) / scale, wanted.weights.get(n, Fraction(0))
        if given != right:
            return f"{name} has weight {given} of {n if isinstance(n, str) else 'a remainder'}, the program has {right}"
    return f"{name} is not the sum"


def _rounded(acc: Any, shift: int, o: Operation) -> tuple[Any, Any]:
    """(the code of the accumulator by docs/integer-program.md, whether it saturates)."""
    import z3

    if shift > 0:
        rest, half = acc & ((1 << shift) - 1), 1 << (shift - 1)
        quotient = acc >> shift
        up = {
            Rounding.TRUNCATE: z3.BoolVal(False),
            Rounding.HALF_UP: z3.UGE(rest, half),
            Rounding.HALF_EVEN: z3.Or(z3.UGT(rest, half), z3.And(rest == half, quotient & 1 == 1)),
        }[o.rounding]
        quotient = z3.If(up, quotient + 1, quotient)
    else:
        quotient = acc << -shift
    fix = o.out.fix
    beyond = z3.Or(quotient > fix.hi, quotient < fix.lo)
    if o.overflow is Overflow.SATURATE:
        quotient = z3.If(quotient > fix.hi, fix.hi, z3.If(quotient < fix.lo, fix.lo, quotient))
    return z3.Extract(fix.width - 1, 0, quotient), beyond


def _alike(program: Program, o: Operation, told: int) -> str | None:
    """Why codes that differ from a saturated one in `told` low bits do matter; None if no reader tells them apart."""
    name, fix = o.out.name, o.out.fix
    if name in {p.signal.name for p in program.outputs} | {s.source for s in program.states}:
        return f"its low {told} bits are not those of a saturated code, and an output or a state shows them"
    for other in program.operations:
        if name in other.args:
            if not isinstance(other, Lookup):
                return f"its low {told} bits are not those of a saturated code, and {other.out.name} reads them"
            table = program.table[other.table]
            for codes in (fix.hi - np.arange(1 << told), fix.lo + np.arange(1 << told)):
                if np.unique(lookup(table, codes.astype(np.int64))).size > 1:
                    return f"table {table.name} tells a code near {codes[0]} from the saturated one"
    return None
