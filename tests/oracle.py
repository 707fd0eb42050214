"""docs/integer-program.md in Python integers, which have no greatest. Shares no arithmetic with the emulators."""

from typing import NamedTuple

import numpy as np

from greygate.emulator.interpreter import Run
from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Product, Program, Select, Threshold
from greygate.emulator.tables import Lines, Symmetry, Table


class Answer(NamedTuple):
    """Rows of codes, one a step: outputs, states after the step, every signal; saturations per signal."""

    outputs: list[list[int]]
    states: list[list[int]]
    trace: dict[str, list[list[int]]]
    saturations: dict[str, int]


def shifted(a: int, s: int, rounding: Rounding) -> int:
    """a * 2^-s, rounded by the table of "Requantize"."""
    if s <= 0:
        return a << -s
    if rounding is Rounding.TRUNCATE:
        return a >> s
    if rounding is Rounding.HALF_UP:
        return (a + 2 ** (s - 1)) >> s
    return (a + 2 ** (s - 1) - 1 + ((a >> s) & 1)) >> s


def requantize(a: int, F: int, out: Fix, rounding: Rounding, overflow: Overflow) -> tuple[int, int]:
    """(code, saturations: 0 or 1)."""
    v = shifted(a, F - out.frac, rounding)
    lo, hi = -(2 ** (out.width - 1)), 2 ** (out.width - 1) - 1
    if lo <= v <= hi:
        return v, 0
    if overflow is Overflow.SATURATE:
        return (lo if v < lo else hi), 1
    low = v % 2**out.width
    return (low - 2**out.width if low > hi else low), 1


def lookup(table: Table | Lines, x: int) -> int:
    """The section "Lookup", line by line."""
    if isinstance(table, Lines):
        y = on_line(table, x)
    else:
        y = on_points(table, abs(x))
    if x < 0:
        y = {Symmetry.ODD: -y, Symmetry.EVEN: y, Symmetry.COMPLEMENT: 2**table.out.frac - y}[table.symmetry]
    assert table.out.lo <= y <= table.out.hi
    return y


def on_points(table: Table, a: int) -> int:
    n, points, shift = len(table.points) - 1, table.points, table.shift
    i, r = a >> shift, a & (2**shift - 1)
    half = 2 ** (shift - 1) if shift else 0
    if i >= n:
        return points[n]
    if table.interpolated:
        return points[i] + (((points[i + 1] - points[i]) * r + half) >> shift)
    return points[(a + half) >> shift]


def on_line(t: Lines, x: int) -> int:
    s = 1 if x < 0 else 0
    m = -x - 1 if s else x
    first, left, o = 0, 0, 0
    while o < len(t.shifts) - 1 and m >= 2 ** (t.start + o):
        first += (2 ** (t.start + o) - left) // 2 ** t.shifts[o]
        left = 2 ** (t.start + o)
        o += 1
    i, p = divmod(m - left, 2 ** t.shifts[o])
    i, p = first + i, p // 2 ** t.drops[o] + (s if t.drops[o] == 0 else 0)
    if i >= len(t.bases):
        i, p = len(t.bases) - 1, 2 ** (t.shifts[o] - t.drops[o])
    half = 2 ** (t.slope_frac - 1) if t.slope_frac else 0
    return (t.bases[i] * 2 ** (t.slope_frac - t.guard) + t.slopes[i] * p + half) // 2**t.slope_frac


def operate(program: Program, o, value: dict[str, list[int]]) -> tuple[list[int], int]:
    """(result, saturations) of one operation."""
    fix, done = {name: s.fix for name, s in program.signals.items()}, []
    if isinstance(o, Affine):
        x = [code for arg in o.args for code in value[arg]]
        rows = zip(o.weights.tolist(), o.bias.tolist(), o.frac.tolist(), strict=True)
        for weights, bias, frac in rows:
            acc = bias + sum(w * code for w, code in zip(weights, x, strict=True))
            done.append(requantize(acc, frac, o.out.fix, o.rounding, o.overflow))
    elif isinstance(o, Lookup):
        done = [(lookup(program.table[o.table], code), 0) for code in value[o.arg]]
    elif isinstance(o, Clamp):
        for code in value[o.arg]:
            limited = min(max(code, o.lo), o.hi)
            done.append(requantize(limited, fix[o.arg].frac, o.out.fix, o.rounding, Overflow.SATURATE))
    elif isinstance(o, Threshold):
        done = [(o.above if code >= o.at else o.below, 0) for code in value[o.arg]]
    elif isinstance(o, Product):
        exact = [one * other for one, other in zip(value[o.one], value[o.other], strict=True)]
        frac = fix[o.one].frac + fix[o.other].frac
        done = [requantize(code, frac, o.out.fix, o.rounding, Overflow.SATURATE) for code in exact]
    else:
        assert isinstance(o, Select)
        for r, code in enumerate(value[o.condition]):
            name = o.above if code >= 0 else o.below
            done.append(requantize(value[name][r], fix[name].frac, o.out.fix, o.rounding, Overflow.SATURATE))
    return [code for code, _ in done], sum(count for _, count in done)


def perform(program: Program, codes: list[list[int]]) -> Answer:
    """Every step of the program over input codes, a row a step."""
    rounded = [o.out.name for o in program.operations if isinstance(o, Affine | Clamp | Product | Select)]
    answer = Answer([], [], {name: [] for name in program.signals}, dict.fromkeys(rounded, 0))
    now = {s.signal.name: list(s.initial) for s in program.states}
    for row in codes:
        value, rest = dict(now), list(row)
        for port in program.inputs:
            value[port.signal.name], rest = rest[: port.signal.size], rest[port.signal.size :]
        for o in program.operations:
            value[o.out.name], count = operate(program, o, value)
            if o.out.name in answer.saturations:
                answer.saturations[o.out.name] += count
        now = {s.signal.name: value[s.source] for s in program.states}
        answer.outputs.append([code for p in program.outputs for code in value[p.signal.name]])
        answer.states.append([code for s in program.states for code in now[s.signal.name]])
        for name, codes_now in value.items():
            answer.trace[name].append(codes_now)
    return answer


def differing_bits(program: Program, answer: Answer, run: Run) -> int:
    """Bits in which a traced run differs from the answer: of outputs, states, every signal and every count."""
    pairs = [(answer.trace[name], run.trace[name]) for name in program.signals]
    pairs += [(answer.outputs, run.outputs), (list(answer.saturations.values()), list(run.saturations.values()))]
    pairs += [(answer.states, run.states)] if program.states else []
    both = ((np.array(a, np.int64), np.array(b, np.int64)) for a, b in pairs)
    assert answer.saturations.keys() == run.saturations.keys()
    return sum(int(np.bitwise_count((a ^ b).view(np.uint64)).sum()) for a, b in both)
