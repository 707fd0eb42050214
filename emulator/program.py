"""The integer program: what the hardware does in one step. Its normative text is docs/integer-program.md.

Declared here and nowhere else; the interpreter, the engine, the Verilog emitter and the report walk it.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from itertools import pairwise
from numbers import Integral, Real
from pathlib import Path
from typing import NamedTuple

import numpy as np

from greygate.errors import InputError
from greygate.files import replacing
from greygate.names import check_name, check_path, check_text, check_unit
from greygate.reading import Kind, listed, named, number, one_of, read_json, table, truth, whole

ACCUMULATOR_BITS = 62  # room for one more addition in int64
WIDTHS = range(2, 49)
FRACTIONS = range(-48, 61)
SIZES = range(1, (1 << 16) + 1)  # elements of a signal
LARGEST_SHIFT = 1 << 10  # of any width, fraction or shift in a file; what is legal is far below


class Fix(NamedTuple):
    """Two's complement of `width` bits, the sign counted; value = integer * 2^-frac."""

    width: int
    frac: int

    @property
    def lo(self) -> int:
        return -(1 << (self.width - 1))

    @property
    def hi(self) -> int:
        return (1 << (self.width - 1)) - 1

    @property
    def lsb(self) -> float:
        return 2.0**-self.frac

    def holds(self, *values: int) -> bool:
        """Whether all of these are codes of the format."""
        return all(isinstance(v, Integral) and self.lo <= v <= self.hi for v in values)

    def __str__(self) -> str:
        return f"Fix({self.width}, {self.frac})"


class Rounding(StrEnum):
    TRUNCATE = "truncate"
    HALF_UP = "half_up"
    HALF_EVEN = "half_even"


class Overflow(StrEnum):
    SATURATE = "saturate"
    WRAP = "wrap"


class Symmetry(StrEnum):
    """How a table answers a negative code from the answer to its absolute value."""

    ODD = "odd"  # f(-x) = -f(x): tansig
    EVEN = "even"  # f(-x) = f(x): radbas
    COMPLEMENT = "complement"  # f(-x) = 1 - f(x): logsig


class Op(StrEnum):
    AFFINE = "affine"
    TABLE = "table"
    CLAMP = "clamp"
    THRESHOLD = "threshold"
    SELECT = "select"


@dataclass(frozen=True)
class Signal:
    """A vector of `size` codes that share one format."""

    name: str
    size: int
    fix: Fix


@dataclass(frozen=True)
class Port:
    """An input or output of the program, and what its codes mean outside: value = code * lsb * scale + offset."""

    name: str
    signal: Signal
    unit: str
    scale: float
    offset: float

    def codes(self, values: np.ndarray) -> np.ndarray:
        """Physical values as codes, float64 of the same shape, before they are clipped to the format.

        Raises InputError for a value that is not finite.
        """
        values = np.asarray(values, float)
        if not np.isfinite(values).all():
            raise InputError(f"input {self.name}: a value is not finite; mend the recording")
        with np.errstate(over="ignore"):  # what is beyond float64 is beyond the format
            return np.floor((values - self.offset) / self.scale * 2.0**self.signal.fix.frac + 0.5)


class Clipped(NamedTuple):
    """Values of an input outside its format: how many, their share; the range that it holds and that was given."""

    count: int
    share: float
    holds: tuple[float, float]  # in the port's unit, as `given`
    given: tuple[float, float]


@dataclass(frozen=True)
class State:
    """The value that `source` had one step before; `initial` holds one code per element."""

    signal: Signal
    source: str
    initial: tuple[int, ...]


@dataclass(frozen=True)
class Table:
    """Half of a symmetric function as `points` at the codes 0, 2^shift, 2 * 2^shift, ...

    `worst_error` is the largest deviation from the true function over every input code, in output units.
    """

    name: str
    function: str
    symmetry: Symmetry
    shift: int
    points: tuple[int, ...]
    interpolated: bool
    arg: Fix
    out: Fix
    worst_error: float


@dataclass(frozen=True)
class Affine:
    """out = requantize(bias + weights @ concatenate(args)), exact until the one rounding; `frac` is per row."""

    out: Signal
    args: tuple[str, ...]
    weights: np.ndarray  # int64 (size, columns)
    bias: np.ndarray  # int64 (size,)
    frac: np.ndarray  # int64 (size,), fraction bits of each row's accumulator
    rounding: Rounding = Rounding.HALF_UP
    overflow: Overflow = Overflow.SATURATE
    op = Op.AFFINE


@dataclass(frozen=True)
class Lookup:
    """out = table(arg), element by element."""

    out: Signal
    arg: str
    table: str
    op = Op.TABLE


@dataclass(frozen=True)
class Clamp:
    """out = requantize(min(max(arg, lo), hi)); lo and hi are codes of the arg's format."""

    out: Signal
    arg: str
    lo: int
    hi: int
    rounding: Rounding = Rounding.HALF_UP
    op = Op.CLAMP


@dataclass(frozen=True)
class Threshold:
    """out = above if arg >= at else below; `at` is a code of the arg's format, the others of out's."""

    out: Signal
    arg: str
    at: int
    below: int
    above: int
    op = Op.THRESHOLD


@dataclass(frozen=True)
class Select:
    """out = requantize(above if condition >= 0 else below): a multiplexer, element by element, saturating."""

    out: Signal
    condition: str
    above: str
    below: str
    rounding: Rounding = Rounding.HALF_UP
    op = Op.SELECT


Operation = Affine | Lookup | Clamp | Threshold | Select
ROUNDED = Affine | Clamp | Select  # those whose results may saturate


def signed_width(magnitude: int) -> int:
    """The least two's complement width that holds every integer from -magnitude to +magnitude."""
    return int(magnitude).bit_length() + 1


@dataclass(frozen=True, eq=False)
class Program:
    """One step of a network on integers. Made by the compiler; `check` holds before and after every pass.

    docs/integer-program.md defines what each operation computes, to the bit.

    >>> program = compiled.program
    >>> program
    <Program lag: u Fix(18, 17) -> y Fix(19, 18); 1 operations, 1 states>
    """

    name: str
    inputs: tuple[Port, ...]
    states: tuple[State, ...]
    operations: tuple[Operation, ...]
    outputs: tuple[Port, ...]
    tables: tuple[Table, ...] = ()
    period: float = 1e-3  # s, for reports only
    notes: dict[str, str] = field(default_factory=dict)  # signal -> why it has its format

    def __repr__(self) -> str:
        inputs, outputs = (
            ", ".join(f"{p.name} {p.signal.fix}" for p in ports) for ports in (self.inputs, self.outputs)
        )
        counted = f"{len(self.operations)} operations, {len(self.states)} states"
        return f"<Program {self.name}: {inputs} -> {outputs}; {counted}>"

    @cached_property
    def signals(self) -> dict[str, Signal]:
        """Every signal by name: inputs, states, results, in that order."""
        return {s.name: s for s in self._declared()}

    @cached_property
    def table(self) -> dict[str, Table]:
        return {t.name: t for t in self.tables}

    def args(self, operation: Operation) -> tuple[str, ...]:
        if isinstance(operation, Select):
            return operation.condition, operation.above, operation.below
        return operation.args if isinstance(operation, Affine) else (operation.arg,)

    def accumulator_width(self, operation: Affine) -> int:
        """Width that no partial sum of any row can exceed, the rounding constant included. Proved, not measured."""
        largest = np.array(
            [-self.signals[a].fix.lo for a in operation.args for _ in range(self.signals[a].size)], object
        )
        weights, bias = (np.abs(part.astype(object)) for part in (operation.weights, operation.bias))
        magnitude = weights @ largest + bias
        shift = operation.frac - operation.out.fix.frac
        rounding = [1 << int(s - 1) if s > 0 else 0 for s in shift]
        return max(2, *(signed_width(int(m) + h) for m, h in zip(magnitude, rounding, strict=True)))

    def check(self) -> "Program":
        """Raise InputError unless the program is legal by docs/integer-program.md; return it."""
        self._check_names()
        for problem in self._problems():
            raise InputError(f"program {self.name}: {problem}")
        return self

    def _check_names(self) -> None:
        where = f"program {check_name(self.name, 'program')}:"
        for signal in self._declared():
            check_path(signal.name, f"{where} signal")
        for port in self.inputs + self.outputs:
            check_path(port.name, f"{where} port")
            check_unit(port.unit, f"{where} port {port.name}: unit")
        for t in self.tables:
            check_path(t.name, f"{where} table")
            check_text(t.function, f"{where} table {t.name}: function")
        for name, why in self.notes.items():
            check_text(why, f"{where} note on {check_path(name, f'{where} note on')}:")

    def _declared(self) -> list[Signal]:
        return [p.signal for p in self.inputs] + [s.signal for s in self.states] + [o.out for o in self.operations]

    def _problems(self) -> Iterator[str]:
        declared = self._declared()
        for kind, names in (
            ("signal", [s.name for s in declared]),
            ("input", [p.name for p in self.inputs]),
            ("output", [p.name for p in self.outputs]),
            ("table", [t.name for t in self.tables]),
        ):
            for name, count in Counter(names).items():
                if count > 1:
                    yield f"{kind} {name} is defined twice"
        if not self.inputs or not self.outputs:
            yield "needs at least one input and one output"
        if not (_is_finite(self.period) and self.period > 0):
            yield f"period {self.period} is not a time in seconds above 0"
        for s in declared:
            yield from _format_problems(f"signal {s.name}", s.fix)
            if s.size not in SIZES:
                yield f"signal {s.name}: size {s.size} is not in {SIZES.start}..{SIZES.stop - 1}"
        for port in (*self.inputs, *self.outputs):
            if not (_is_finite(port.scale) and port.scale and _is_finite(port.offset)):
                yield f"port {port.name}: scale {port.scale} or offset {port.offset} is not finite, or scale is 0"
        for t in self.tables:
            yield from _table_problems(t)
        known = {p.signal.name for p in self.inputs} | {s.signal.name for s in self.states}
        for o in self.operations:
            for arg in self.args(o):
                if arg not in known:
                    yield f"{o.out.name} reads {arg} before it is defined"
                    return
            yield from self._operation_problems(o)
            known.add(o.out.name)
        for state in self.states:
            source = self.signals.get(state.source)
            if source is None:
                yield f"state {state.signal.name}: its source {state.source} does not exist"
            elif (source.size, source.fix) != (state.signal.size, state.signal.fix):
                yield f"state {state.signal.name}: size or format differ from its source {state.source}"
            elif len(state.initial) != state.signal.size or not state.signal.fix.holds(*state.initial):
                yield f"state {state.signal.name}: initial codes do not fit"
        for port in self.outputs:
            if self.signals.get(port.signal.name) != port.signal:
                yield f"output {port.name} shows {port.signal.name}, which is not a signal of the program"

    def _operation_problems(self, o: Operation) -> Iterator[str]:
        if isinstance(o, Affine):
            if not o.args:
                yield f"{o.out.name} reads nothing; an AFFINE has at least one argument"
                return
            columns = sum(self.signals[a].size for a in o.args)
            if (
                o.weights.shape != (o.out.size, columns)
                or o.bias.shape != (o.out.size,)
                or o.frac.shape != (o.out.size,)
            ):
                yield f"{o.out.name}: weights {o.weights.shape}, bias or frac: not {o.out.size} rows of {columns}"
                return
            if any(part.dtype != np.int64 for part in (o.weights, o.bias, o.frac)):
                yield f"{o.out.name}: weights, bias or frac are not integers of 64 bits"
                return
            left = [o.out.fix.frac - int(f) for f in o.frac]
            if max(map(abs, left)) > ACCUMULATOR_BITS:
                yield f"{o.out.name}: a row's fraction is more than {ACCUMULATOR_BITS} bits from that of {o.out.fix}"
                return
            width = self.accumulator_width(o) + max(0, *left)
            if width > ACCUMULATOR_BITS:
                yield f"{o.out.name}: accumulator needs {width} bits, more than {ACCUMULATOR_BITS}"
            return
        for arg in map(self.signals.get, self.args(o)):
            if arg.size != o.out.size:
                yield f"{o.out.name}: size {o.out.size} differs from the {arg.size} of its argument {arg.name}"
        if isinstance(o, Select):
            yield from self._select_problems(o)
            return
        arg = self.signals[o.arg]
        if isinstance(o, Lookup):
            table = self.table.get(o.table)
            if table is None:
                yield f"{o.out.name}: table {o.table} does not exist"
            elif (table.arg, table.out) != (arg.fix, o.out.fix):
                yield f"{o.out.name}: formats differ from those of table {o.table}"
        elif isinstance(o, Clamp):
            width = arg.fix.width + max(0, o.out.fix.frac - arg.fix.frac)
            if width > ACCUMULATOR_BITS:
                yield f"{o.out.name}: needs {width} bits on the way, more than {ACCUMULATOR_BITS}"
            if not arg.fix.holds(o.lo, o.hi) or o.lo > o.hi:
                yield f"{o.out.name}: clamp [{o.lo}, {o.hi}] does not fit {arg.fix}"
        elif not (arg.fix.holds(o.at) and o.out.fix.holds(o.below, o.above)):
            yield f"{o.out.name}: threshold codes do not fit"

    def select_width(self, o: Select) -> int:
        """Width that holds both values at the finer fraction of the two, and the result's if that is finer still."""
        values = self.signals[o.above].fix, self.signals[o.below].fix
        frac = max(v.frac for v in values)
        return max(v.width + frac - v.frac for v in values) + max(0, o.out.fix.frac - frac)

    def _select_problems(self, o: Select) -> Iterator[str]:
        if self.select_width(o) > ACCUMULATOR_BITS:
            yield f"{o.out.name}: needs {self.select_width(o)} bits on the way, more than {ACCUMULATOR_BITS}"

    def encode(self, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Physical inputs {port: (..., N) or (..., N, size)} to codes (..., N, columns), clipped to the formats.

        `clipped` tells how many were. Raises InputError for a value that is not finite.
        """
        columns = []
        for port in self.inputs:
            codes = port.codes(values[port.name])
            codes = codes if port.signal.size > 1 else codes[..., None]
            columns.append(np.clip(codes, port.signal.fix.lo, port.signal.fix.hi).astype(np.int64))
        return np.concatenate(columns, axis=-1)

    def clipped(self, values: Mapping[str, np.ndarray]) -> dict[str, Clipped]:
        """What `encode` clips of these values, by the name of the input; an input that fits is not in it."""
        found = {}
        for port in self.inputs:
            codes, fix, given = port.codes(values[port.name]), port.signal.fix, np.asarray(values[port.name], float)
            count = int(np.count_nonzero((codes < fix.lo) | (codes > fix.hi)))
            if count:
                least, most = sorted(code * fix.lsb * port.scale + port.offset for code in (fix.lo, fix.hi))
                lowest, highest = float(given.min()), float(given.max())
                found[port.name] = Clipped(count, count / codes.size, (least, most), (lowest, highest))
        return found

    def decode(self, codes: np.ndarray) -> dict[str, np.ndarray]:
        """Output codes (..., N, columns) to physical values {port: (..., N) or (..., N, size)}."""
        values, start = {}, 0
        for port in self.outputs:
            part = codes[..., start : start + port.signal.size] * port.signal.fix.lsb * port.scale + port.offset
            values[port.name] = part if port.signal.size > 1 else part[..., 0]
            start += port.signal.size
        return values

    def save(self, path: Path | str) -> None:
        """Write the program as JSON that a person can read."""
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(_to_json(self), indent=1))

    @staticmethod
    def load(path: Path | str) -> "Program":
        """Read and check a program. Raises InputError for a file that is missing, truncated or not legal."""
        try:
            return _from_json(read_json(path, "compile the network again"), f"{path}:").check()
        except InputError as error:
            said = str(error)
            raise InputError(said if said.startswith(str(path)) else f"{path}: {said}") from None


def _is_finite(value: float) -> bool:
    return isinstance(value, Real) and abs(value) <= sys.float_info.max  # which nan and inf are not


def _format_problems(what: str, fix: Fix) -> Iterator[str]:
    if fix.width not in WIDTHS:
        yield f"{what}: width {fix.width} is not in {WIDTHS.start}..{WIDTHS.stop - 1}"
    if fix.frac not in FRACTIONS:
        yield f"{what}: fraction {fix.frac} is not in {FRACTIONS.start}..{FRACTIONS.stop - 1}; scale its port"


def _table_problems(table: Table) -> Iterator[str]:
    name, out = f"table {table.name}", table.out
    yield from _format_problems(name, table.arg)
    yield from _format_problems(name, out)
    if len(table.points) < 2 or out.frac < 0:
        yield f"{name}: needs two points, and a result's fraction that is not negative"
    if table.shift not in range(table.arg.width + 1):
        yield f"{name}: shift {table.shift} is not in 0..{table.arg.width}, the width of its argument"
    answers = {
        Symmetry.ODD: [-p for p in table.points],
        Symmetry.EVEN: [],
        Symmetry.COMPLEMENT: [(1 << out.frac) - p for p in table.points],
    }[table.symmetry]
    if not out.holds(*table.points, *answers):
        yield f"{name}: a point, or what its symmetry makes of it, does not fit {out}"
    if table.interpolated:
        width = table.shift + signed_width(max(abs(b - a) for a, b in pairwise(table.points)))
        if width > ACCUMULATOR_BITS:
            yield f"{name}: needs {width} bits between two points, more than {ACCUMULATOR_BITS}"


_KINDS = {kind.op: kind for kind in (Affine, Lookup, Clamp, Threshold, Select)}


def _to_json(value):
    if isinstance(value, Fix):
        return list(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple | list):
        return [_to_json(v) for v in value]
    if isinstance(value, dict):
        return {k: _to_json(v) for k, v in value.items()}
    if hasattr(value, "__dataclass_fields__"):
        head = {"op": value.op.value} if hasattr(value, "op") else {}
        return head | {k: _to_json(getattr(value, k)) for k in value.__dataclass_fields__}
    return value


_INTEGER = whole(-(1 << ACCUMULATOR_BITS), 1 << ACCUMULATOR_BITS)
_SMALL = whole(-LARGEST_SHIFT, LARGEST_SHIFT)


def _fix(value: object, where: str) -> Fix:
    parts = listed(_SMALL)(value, where)
    if len(parts) != 2:
        raise InputError(f"{where} has {len(parts)} numbers; give width and fraction")
    return Fix(*parts)


def _signal(value: object, where: str) -> Signal:
    return Signal(**table(value, where, {"name": check_path, "size": whole(SIZES.start, SIZES.stop - 1), "fix": _fix}))


def _port(value: object, where: str) -> Port:
    kinds = {"name": check_path, "signal": _signal, "unit": check_unit, "scale": number, "offset": number}
    port = Port(**table(value, where, kinds))
    if port.scale == 0:
        raise InputError(f"{where}.scale is 0; give how much a code stands for")
    return port


def _state(value: object, where: str) -> State:
    found = table(value, where, {"signal": _signal, "source": check_path, "initial": listed(_INTEGER)})
    return State(found["signal"], found["source"], tuple(found["initial"]))


def _table(value: object, where: str) -> Table:
    kinds = {
        "name": check_path,
        "function": check_text,
        "symmetry": one_of(Symmetry),
        "shift": _SMALL,
        "points": listed(_INTEGER),
        "interpolated": truth,
        "arg": _fix,
        "out": _fix,
        "worst_error": number,
    }
    found = table(value, where, kinds)
    return Table(**found | {"points": tuple(found["points"])})


_ENTRIES: dict[Op, dict[str, Kind]] = {
    Op.AFFINE: {
        "args": listed(check_path),
        "weights": listed(listed(_INTEGER)),
        "bias": listed(_INTEGER),
        "frac": listed(_SMALL),
        "rounding": one_of(Rounding),
        "overflow": one_of(Overflow),
    },
    Op.TABLE: {"arg": check_path, "table": check_path},
    Op.CLAMP: {"arg": check_path, "lo": _INTEGER, "hi": _INTEGER, "rounding": one_of(Rounding)},
    Op.THRESHOLD: {"arg": check_path, "at": _INTEGER, "below": _INTEGER, "above": _INTEGER},
    Op.SELECT: {"condition": check_path, "above": check_path, "below": check_path, "rounding": one_of(Rounding)},
}


def _operation(value: object, where: str) -> Operation:
    op = one_of(Op)(value.get("op") if isinstance(value, dict) else None, f"{where}.op")
    found = table(value, where, {"op": one_of(Op), "out": _signal, **_ENTRIES[op]})
    del found["op"]
    if op is Op.AFFINE:
        if len({len(row) for row in found["weights"]}) != 1:
            raise InputError(f"{where}.weights: its rows differ in length, or there are none; mend it")
        found |= {k: np.array(found[k], np.int64) for k in ("weights", "bias", "frac")}
        found["args"] = tuple(found["args"])
    return _KINDS[op](**found)


def _from_json(data: object, where: str) -> Program:
    kinds = {
        "name": check_name,
        "inputs": listed(_port),
        "states": listed(_state),
        "operations": listed(_operation),
        "outputs": listed(_port),
        "tables": listed(_table),
        "period": number,
        "notes": named(check_text),
    }
    found = table(data, where, kinds)
    if found["period"] <= 0:
        raise InputError(f"{where} period {found['period']} is not a time; give seconds above 0")
    return Program(**{k: tuple(v) if isinstance(v, list) else v for k, v in found.items()})
