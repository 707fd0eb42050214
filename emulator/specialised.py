"""The engine's kernel with one program written into it: Python source that numba compiles.

Offsets, sizes, bounds and rounding are literals in it, weights and tables are constant arrays. A requantization is
`floor` of a sum whose terms were scaled by 2^-shift beforehand. That is exact: if the program proves that the unscaled
sum stays below 2^53, every partial sum is an integer times 2^-shift that float64 holds. Other sums are int64.
"""

from collections.abc import Callable

import numpy as np

from greygate.emulator.numbers import ACCUMULATOR_BITS, Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Op, Program, Select, Threshold
from greygate.emulator.tables import Lines, Symmetry, Table
from greygate.generated import load

EXACT_BITS = 53  # integers up to 2^53 are exact in float64
_LANES = 4  # float64 in a vector of the processor: signals of several elements are padded to fours
_CHAINS = 4  # a sum runs as this many partial sums: an addition lasts that many times longer than starting one


def compiled(program: Program) -> Callable:
    """Compile run(inputs, initial, outputs, states, saturations, trace): the last arguments of the engine's kernel."""
    return load("program", source(program)).run


def drop(value: Fix, out: Fix) -> int:
    """Fraction bits that a value loses on its way to `out`, at most ACCUMULATOR_BITS: more give the same result."""
    return min(value.frac - out.frac, ACCUMULATOR_BITS)


class _Writer:
    """Collects the constants and lines of one program's kernel; `first` is the place of each signal in the values."""

    def __init__(self, program: Program):
        self.program, self.first = program, {}
        self.constants: list[str] = []
        self.lines: list[str] = []
        self.elements = 0
        for name, signal in program.signals.items():
            self.first[name] = self.elements
            self.elements += self.padded(signal.size)

    @staticmethod
    def padded(size: int) -> int:
        return 1 if size == 1 else -(-size // _LANES) * _LANES

    def places(self, names) -> list[int]:
        """The places of all elements of these signals."""
        return [self.first[name] + i for name in names for i in range(self.program.signals[name].size)]

    def constant(self, name: str, values: np.ndarray) -> str:
        self.constants.append(f"{name} = np.array({values.tolist()}, np.{values.dtype})")
        return name

    def loop(self, size: int, *body: str) -> None:
        self.lines += [f"for r in range({size}):", *(f"    {line}" for line in body)]

    def fitted(self, n: int, out: str, overflow: Overflow) -> list[str]:
        """Bring y into the format of `out`, count it if it does not fit, and store it."""
        fix = self.program.signals[out].fix
        if overflow is Overflow.WRAP:
            result = f"z = ((np.int64(y) + {-fix.lo}) & {fix.hi - fix.lo}) + {fix.lo}"
        else:
            result = f"z = min(max(y, {fix.lo}), {fix.hi})"
        return [result, f"n{n} += y != z", f"v[{self.first[out]} + r] = z"]

    def affine(self, n: int, o: Affine) -> None:
        columns, padded = self.places(o.args), self.padded(o.out.size)
        rows = [(0, padded - o.out.size)]
        shift = np.pad(o.frac - o.out.fix.frac, rows)
        weights, bias = np.pad(o.weights.T, [(0, 0), *rows]), np.pad(o.bias, rows)
        exact = self.program.accumulator_width(o) < EXACT_BITS
        if exact:
            weights, bias = weights * 2.0**-shift, bias * 2.0**-shift
            if o.rounding is Rounding.HALF_UP:
                bias = bias + np.where(shift > 0, 0.5, 0.0)
        self.constant(f"W{n}", weights)
        terms = [f"{self.constant(f'B{n}', bias)}[r]"]
        for j, column in enumerate(columns):
            self.lines.append(f"x{j} = {f'v[{column}]' if exact else f'np.int64(v[{column}])'}")
            terms.append(f"W{n}[{j}, r] * x{j}")
        chains = [" + ".join(terms[i::_CHAINS]) for i in range(min(_CHAINS, len(terms)))]
        body = [f"y = ({') + ('.join(chains)})"]
        if exact:
            body.append(f"y = np.{'rint' if o.rounding is Rounding.HALF_EVEN else 'floor'}(y)")
        else:
            self.constant(f"S{n}", shift)
            body.append(f"y = {_shifted('y', f'S{n}[r]', o.rounding)}")
        self.loop(padded, *body, *self.fitted(n, o.out.name, o.overflow))

    def lookup(self, n: int, o: Lookup) -> None:
        t = self.program.table[o.table]
        body = self.on_lines(t, o) if isinstance(t, Lines) else self.on_points(t, o)
        if t.symmetry is not Symmetry.EVEN:
            lift = 1 << t.out.frac if t.symmetry is Symmetry.COMPLEMENT else 0
            body.append(f"y = {lift} - y if x < 0 else y")
        self.loop(self.padded(o.out.size), *body, f"v[{self.first[o.out.name]} + r] = y")

    def on_lines(self, t: Lines, o: Lookup) -> list[str]:
        """y by the section "Lookup", in int64: the octave by comparisons, the rest from constant arrays."""
        s = t.segments
        bases, slopes = (self.table(t, kind, np.array(part)) for kind, part in (("B", s.bases), ("C", s.slopes)))
        parts = zip("LFSR", (s.lefts, s.firsts, s.shifts, s.drops), strict=True)
        left, first, shift, drop = (f"{self.table(t, kind, np.array(part))}[o]" for kind, part in parts)
        lower, upper = s.halves
        return [
            f"x = np.int64(v[{self.first[o.arg]} + r])",
            "m = x ^ (x >> 63)",
            f"o = {' + '.join(['0', *(f'(m >= {n})' for n in s.lefts[1:])])}",
            f"place = m - {left}",
            f"i = {first} + (place >> {shift})",
            f"beyond = i > {len(s.bases) - 1}",
            f"i = {len(s.bases) - 1} if beyond else i",
            f"place = ((place & ((1 << {shift}) - 1)) >> {drop}) + (x < 0 and {drop} == 0)",
            f"place = 1 << ({shift} - {drop}) if beyond else place",
            f"y = ({bases}[i] + {upper} + (({slopes}[i] * place + {lower}) >> {s.below})) >> {s.guard}",
        ]

    def on_points(self, t: Table, o: Lookup) -> list[str]:
        """y for |x|, of the points or of the lines between them."""
        shift, last, half = t.shift, len(t.points) - 1, (1 << t.shift) >> 1
        end = min(last << shift, -t.arg.lo)
        # on the interval i, y = floor(start[i] + slope[i] * a), all times 2^-shift; the interval after the end is flat
        slope = [b - a for a, b in zip(t.points, (*t.points[1:], t.points[-1]), strict=True)]
        start = [(p << shift) + half - (d * i << shift) for i, (p, d) in enumerate(zip(t.points, slope, strict=True))]
        sums = [abs(s) + abs(d) * end for s, d in zip(start, slope, strict=True)]
        body = [f"x = v[{self.first[o.arg]} + r]", f"a = min(abs(x), {float(end)})"]
        if not t.interpolated:
            body.append(f"i = np.int32((a + {half}) * {2.0**-shift})")
            body.append(f"y = {self.table(t, 'P', np.array(t.points, float))}[np.uint64(i)]")
        elif max(sums) < 1 << EXACT_BITS:
            slopes = self.table(t, "D", np.array(slope, float) * 2.0**-shift)
            starts = self.table(t, "A", np.array(start, float) * 2.0**-shift)
            body.append(f"i = np.uint64(np.int32(a * {2.0**-shift}))")
            body.append(f"y = np.floor({starts}[i] + {slopes}[i] * a)")
        else:
            slopes = self.table(t, "D", np.array(slope))
            points = self.table(t, "P", np.array(t.points))
            body.append(f"i = np.int64(a) >> {shift}")
            body.append(f"y = {points}[i] + (({slopes}[i] * (np.int64(a) - (i << {shift})) + {half}) >> {shift})")
        return body

    def table(self, t, kind: str, values: np.ndarray) -> str:
        """The name of the table's constant array, which is declared once."""
        name = f"{kind}_{self.program.tables.index(t)}"
        if not any(line.startswith(f"{name} =") for line in self.constants):
            self.constant(name, values)
        return name

    def clamp(self, n: int, o: Clamp) -> None:
        shift = drop(self.program.signals[o.arg].fix, o.out.fix)
        x = f"min(max(np.int64(v[{self.first[o.arg]} + r]), {o.lo}), {o.hi})"
        # not padded: what stands in the padding could saturate
        self.loop(
            o.out.size, f"y = {_shifted(x, str(shift), o.rounding)}", *self.fitted(n, o.out.name, Overflow.SATURATE)
        )

    def threshold(self, n: int, o: Threshold) -> None:
        result = f"{o.above} if v[{self.first[o.arg]} + r] >= {o.at} else {o.below}"
        self.loop(self.padded(o.out.size), f"v[{self.first[o.out.name]} + r] = {result}")

    def select(self, n: int, o: Select) -> None:
        condition, above, below = (f"v[{self.first[a]} + r]" for a in o.args)

        def chosen(value: str, name: str) -> str:
            shift = drop(self.program.signals[name].fix, o.out.fix)
            return _shifted(f"np.int64({value})", str(shift), o.rounding)

        # not padded: what stands in the padding could saturate
        y = f"y = {chosen(above, o.above)} if {condition} >= 0 else {chosen(below, o.below)}"
        self.loop(o.out.size, y, *self.fitted(n, o.out.name, Overflow.SATURATE))


def _shifted(a: str, shift: str, rounding: Rounding) -> str:
    return f"shifted_{rounding.value}({a}, {shift})"


_WRITE: dict[Op, Callable] = {
    Op.AFFINE: _Writer.affine,
    Op.TABLE: _Writer.lookup,
    Op.CLAMP: _Writer.clamp,
    Op.THRESHOLD: _Writer.threshold,
    Op.SELECT: _Writer.select,
}


def source(program: Program) -> str:
    """Python source of `run` for the program."""
    w = _Writer(program)
    for n, o in enumerate(program.operations):
        w.lines.append(f"# {o.op}: {o.out.name!r}")
        _WRITE[o.op](w, n, o)
    counted = [n for n, o in enumerate(program.operations) if o.requantizes]
    into, out_of = w.places(s.signal.name for s in program.states), w.places(s.source for s in program.states)
    moved = f"{', '.join(f'v[{i}]' for i in into)} = {', '.join(f'v[{i}]' for i in out_of)}" if into else "pass"

    def lines(indent: int, texts) -> str:
        return "\n".join(" " * indent + text for text in texts)

    inputs = w.places(p.signal.name for p in program.inputs)
    outputs = w.places(p.signal.name for p in program.outputs)
    w.constant("ALL", np.array(w.places(program.signals)))
    return f"""import numpy as np
from numba import njit

{lines(0, w.constants)}
{_SHIFTS}

@njit(cache=True, nogil=True, error_model="numpy", fastmath={{"contract"}})
def run(inputs, initial, outputs, states, saturations, trace):
    v = np.zeros({w.elements})
{lines(4, (f"n{n} = 0" for n in counted))}
    for sequence in range(len(inputs)):
{lines(8, (f"v[{i}] = initial[sequence, {m}]" for m, i in enumerate(into)))}
        for k in range(inputs.shape[1]):
{lines(12, (f"v[{i}] = inputs[sequence, k, {c}]" for c, i in enumerate(inputs)))}
{lines(12, w.lines)}
{lines(12, (f"outputs[sequence, k, {c}] = np.int64(v[{i}])" for c, i in enumerate(outputs)))}
            if trace.shape[1]:
                for e in range(len(ALL)):
                    trace[sequence, k, e] = np.int64(v[ALL[e]])
            {moved}
            if states.shape[1]:
                pass
{lines(16, (f"states[sequence, k, {m}] = np.int64(v[{i}])" for m, i in enumerate(into)))}
{lines(4, (f"saturations[{n}] = n{n}" for n in counted))}
"""


_SHIFTS = """

@njit(inline="always")
def shifted_truncate(a, shift):
    return (a >> max(shift, 0)) << max(-shift, 0)


@njit(inline="always")
def shifted_half_up(a, shift):
    return ((a + ((1 << max(shift, 0)) >> 1)) >> max(shift, 0)) << max(-shift, 0)


@njit(inline="always")
def shifted_half_even(a, shift):
    some = shift > 0
    return ((a + ((1 << max(shift, 0)) >> 1) - some + ((a >> max(shift, 0)) & some)) >> max(shift, 0)) << max(-shift, 0)
"""
