"""Random legal programs, from a seed: every operation, format, rounding, overflow and symmetry the text allows."""

import math

import numpy as np

from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import (
    Affine,
    Clamp,
    Lookup,
    Product,
    Program,
    Select,
    Signal,
    State,
    Terminal,
    Threshold,
)
from greygate.emulator.tables import Symmetry, Table

FUNCTIONS = {
    Symmetry.ODD: ("tansig", math.tanh),
    Symmetry.EVEN: ("radbas", lambda x: math.exp(-x * x)),
    Symmetry.COMPLEMENT: ("logsig", lambda x: 1 / (1 + math.exp(-x))),
}


def make_table(name: str, symmetry: Symmetry, arg: Fix, out: Fix, shift: int, last: int, interpolated: bool) -> Table:
    """A sampled tansig, radbas or logsig whose answers all lie in `out`."""
    function, f = FUNCTIONS[symmetry]
    hi = min(out.hi, 1 << out.frac) if symmetry is Symmetry.COMPLEMENT else out.hi
    codes = (math.floor(f(i * 2.0 ** (shift - arg.frac)) * 2.0**out.frac + 0.5) for i in range(last + 1))
    points = tuple(min(hi, c) for c in codes)
    return Table(name, function, symmetry, shift, points, interpolated, arg, out, 0.0)


def random_program(seed: int, name: str | None = None) -> Program:
    """A program of a few vectors of a few elements that uses whatever the seed picks."""
    rng = np.random.default_rng(seed)

    def pick(*items):
        return items[rng.integers(len(items))]

    def fix() -> Fix:
        width = int(rng.integers(2, 25))
        return Fix(width, int(rng.integers(-2, width + 3)))

    def signal(kind: str, size: int | None = None, f: Fix | None = None) -> Signal:
        n = sum(map(len, (inputs, states, operations)))
        return Signal(f"{pick('', 'a.', 'net.sub.')}{kind}{n}", size or int(rng.integers(1, 5)), f or fix())

    inputs, states, operations, tables = [], [], [], []
    for _ in range(rng.integers(1, 3)):
        inputs.append(signal("u"))
    promised = [signal(f"s{i}_") for i in range(rng.integers(0, 4))]  # each gets an operation that feeds it
    delayed = [(promised or inputs)[rng.integers(len(promised or inputs))] for _ in range(rng.integers(0, 3))]
    known = inputs + promised

    def code(f: Fix) -> int:
        return int(rng.integers(f.lo, f.hi, endpoint=True))

    def initial(s: Signal) -> tuple[int, ...]:
        return tuple(code(s.fix) for _ in range(s.size))

    for i, s in enumerate(delayed):  # a state of an input, or a state of a state: a tapped delay line
        states.append(State(Signal(f"tap{i}", s.size, s.fix), s.name, initial(s)))
        known = [*known, states[-1].signal]
    if len(states) > 1 and rng.random() < 0.5:
        last = states[-1].signal
        states.append(State(Signal("tap_of_tap", last.size, last.fix), last.name, initial(last)))
        known = [*known, states[-1].signal]

    def affine(out: Signal) -> Affine:
        args = tuple(known[i] for i in rng.permutation(len(known))[: rng.integers(1, 4)])
        columns = sum(a.size for a in args)
        bits = int(rng.integers(2, 15))
        weights = rng.integers(-(1 << bits), 1 << bits, (out.size, columns), endpoint=True)
        weights = np.where(rng.random(weights.shape) < 0.3, 0, weights)
        weights = np.where(rng.random(weights.shape) < 0.2, 1 << rng.integers(0, bits, weights.shape), weights)
        room = bits + max(a.fix.width for a in args) + 2
        bias = rng.integers(-(1 << room), 1 << room, out.size)
        frac = out.fix.frac + np.minimum(rng.integers(-3, max(2, room - out.fix.width + 3), out.size), room)
        names = tuple(a.name for a in args)
        return Affine(out, names, weights, bias, frac, pick(*Rounding), pick(*Overflow))

    def lookup(out: Signal, arg: Signal) -> Lookup:
        symmetry = pick(*Symmetry)
        width = out.fix.width
        out = Signal(out.name, arg.size, Fix(width, int(rng.integers(0, max(1, width - 1)))))
        shift = int(rng.integers(0, arg.fix.width + 1))
        last = int(rng.integers(1, 40))
        tables.append(
            make_table(f"table{len(tables)}", symmetry, arg.fix, out.fix, shift, last, bool(rng.random() < 0.7))
        )
        return Lookup(out, arg.name, tables[-1].name)

    def operation(out: Signal) -> None:
        nonlocal known
        kind = rng.integers(7)
        arg = known[rng.integers(len(known))]
        alike = Signal(out.name, arg.size, out.fix)
        if kind == 0:
            lo, hi = sorted((code(arg.fix), code(arg.fix)))
            operations.append(Clamp(alike, arg.name, lo, hi, pick(*Rounding)))
        elif kind == 1:
            operations.append(Threshold(alike, arg.name, code(arg.fix), code(out.fix), code(out.fix)))
        elif kind in (2, 3):
            operations.append(lookup(out, arg))
        elif kind == 4:
            alike = [s.name for s in known if s.size == arg.size]
            args = (alike[rng.integers(len(alike))] for _ in range(3))
            operations.append(Select(Signal(out.name, arg.size, out.fix), *args, pick(*Rounding)))
        elif kind == 5:
            alike = [s for s in known if s.size == arg.size]
            one, other = (alike[rng.integers(len(alike))] for _ in range(2))
            out_fix = Fix(out.fix.width, min(out.fix.frac, one.fix.frac + other.fix.frac + 12))
            operations.append(Product(Signal(out.name, arg.size, out_fix), one.name, other.name, pick(*Rounding)))
        else:
            operations.append(affine(out))
        known = [*known, operations[-1].out]

    for _ in range(rng.integers(1, 6)):
        operation(signal("x"))
    for s in promised:
        operations.append(affine(Signal(f"{s.name}_next", s.size, s.fix)))
        states.append(State(s, operations[-1].out.name, initial(s)))
    shown = [known[i] for i in rng.permutation(len(known))[: rng.integers(1, 3)]] + [operations[-1].out]
    unique = {s.name: s for s in shown}.values()
    return Program(
        name=name or f"random{seed}",
        inputs=tuple(Terminal(s.name, s, "1", 1.0, 0.0) for s in inputs),
        states=tuple(states[i] for i in rng.permutation(len(states))),
        operations=tuple(operations),
        outputs=tuple(Terminal(f"y.{s.name}", s, "1", 1.0, 0.0) for s in unique),
        tables=tuple(tables),
    ).check()


def random_codes(program: Program, seed: int, steps: int) -> np.ndarray:
    """Input codes (steps, columns): uniform over each format, with its extremes and zero now and then."""
    rng = np.random.default_rng([seed, 1])
    columns = [(p.signal.fix.lo, p.signal.fix.hi) for p in program.inputs for _ in range(p.signal.size)]
    lo, hi = np.array(columns, np.int64).T
    codes = rng.integers(lo, hi, (steps, len(columns)), endpoint=True)
    special = rng.random(codes.shape)
    codes = np.where(special < 0.05, lo, codes)
    codes = np.where((special >= 0.05) & (special < 0.1), hi, codes)
    return np.where((special >= 0.1) & (special < 0.15), 0, codes)


def cylinder_program(name: str = "cylinder", seed: int = 0) -> Program:
    """The size of the real thing: two chambers, each 2-10-10-1 and a divider 2-20-1, 16 bits, pressures of 30 bits."""
    rng = np.random.default_rng(seed)
    x16, tanh16, sum16, pressure = Fix(16, 12), Fix(16, 15), Fix(16, 13), Fix(30, 28)
    table = make_table("tansig", Symmetry.ODD, sum16, tanh16, 9, 32, True)
    inputs = [Signal("u", 1, x16), Signal("x", 1, x16), Signal("v", 1, x16)]
    states, operations, outputs = [], [], []

    def affine(out, *args, scale=1.0):
        columns = sum(a.size for a in args)
        w = rng.normal(0, scale / math.sqrt(columns), (out.size, columns))
        frac = np.full(out.size, max(a.fix.frac for a in args) + 11)
        per_column = np.concatenate([np.full(a.size, a.fix.frac) for a in args])
        weights = np.round(w * 2.0 ** (frac[:, None] - per_column)).astype(np.int64)
        bias = np.round(rng.normal(0, 0.3 * scale, out.size) * 2.0**frac).astype(np.int64)
        operations.append(Affine(out, tuple(a.name for a in args), weights, bias, frac))
        return out

    def layer(name, size, *args):
        total = affine(Signal(f"{name}.sum", size, sum16), *args, scale=2.0)
        operations.append(Lookup(Signal(name, size, tanh16), total.name, "tansig"))
        return operations[-1].out

    spool = affine(
        Signal("spool_next", 1, x16), inputs[0], Signal("spool", 1, x16), Signal("spool_1", 1, x16), scale=0.7
    )
    states += [State(Signal("spool", 1, x16), spool.name, (0,)), State(Signal("spool_1", 1, x16), "spool", (0,))]
    for c in "ab":
        p = Signal(f"p_{c}", 1, pressure)
        hidden = layer(f"q{c}.h2", 10, layer(f"q{c}.h1", 10, spool, p))
        flow = affine(Signal(f"q{c}", 1, x16), hidden)
        divided = layer(f"d{c}.h", 20, flow, inputs[1], inputs[2])
        following = affine(Signal(f"p_{c}.next", 1, pressure), p, divided, scale=0.1)
        leak = operations[-1].weights
        leak[0, 0] = 2000  # p(k) = 0.98 p(k-1) + ...
        states.append(State(p, following.name, (1 << 27,)))
        outputs.append(Terminal(f"P_{c.upper()}", following, "Pa", 2e7, 0.0))
    ports = tuple(Terminal(s.name, s, "1", 1.0, 0.0) for s in inputs)
    return Program(name, ports, tuple(states), tuple(operations), tuple(outputs), (table,)).check()
