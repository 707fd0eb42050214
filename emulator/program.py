"""The integer program: what the hardware does in one step. Its normative text is docs/integer-program.md.

Only this module declares its parts, but for numbers (numbers.py) and tables (tables.py): the content of each part, the
kind of each field in program.json, the signals that it reads, and when it is legal. The interpreter, the engine, the
targets and the report use these declarations. A new operation is one class here, and one function in each of their
tables of operations.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Annotated, ClassVar, get_args

import numpy as np

from greygate.emulator.fields import record, to_json
from greygate.emulator.numbers import (
    ACCUMULATOR_BITS,
    Code,
    Codes,
    Fix,
    Matrix,
    Name,
    Overflow,
    Rounding,
    Shifts,
    Text,
    Unit,
    signed_width,
)
from greygate.emulator.tables import Lines, Table, read_tables
from greygate.errors import InputError
from greygate.files import replacing
from greygate.names import LONGEST_NAME, PART, check_name, check_path, check_text, check_unit
from greygate.plain import SOME, Count, Json, span
from greygate.reading import listed, one_of, read_json, whole

WORD = Json(maxLength=LONGEST_NAME, pattern=f"^{PART}$")
SIZES = range(1, (1 << 16) + 1)  # elements of a signal


class Op(StrEnum):
    AFFINE = "affine"
    TABLE = "table"
    CLAMP = "clamp"
    THRESHOLD = "threshold"
    SELECT = "select"
    PRODUCT = "product"


def _is_finite(value: float) -> bool:
    return isinstance(value, Real) and abs(value) <= sys.float_info.max  # False for nan and inf


@dataclass(frozen=True)
class Signal:
    """A vector of `size` codes that share one format."""

    name: Name
    size: Annotated[int, whole(SIZES.start, SIZES.stop - 1), span(SIZES.start, SIZES.stop - 1)]
    fix: Fix

    def problems(self) -> Iterator[str]:
        yield from self.fix.problems(f"signal {self.name}")
        if self.size not in SIZES:
            yield f"signal {self.name}: size {self.size} is not in {SIZES.start}..{SIZES.stop - 1}"


@dataclass(frozen=True)
class Terminal:
    """An input or output of the program, and the physical value of its codes: code * lsb * scale + offset."""

    name: Name
    signal: Signal
    unit: Unit
    scale: float
    offset: float

    def problems(self) -> Iterator[str]:
        if not (_is_finite(self.scale) and self.scale and _is_finite(self.offset)):
            yield f"port {self.name}: scale {self.scale} or offset {self.offset} is not finite, or scale is 0"

    def codes(self, values: np.ndarray) -> np.ndarray:
        """Physical values as codes, float64 of the same shape, before they are clipped to the format.

        Raises InputError for a value that is not finite.
        """
        values = np.asarray(values, float)
        if not np.isfinite(values).all():
            raise InputError(f"input {self.name}: a value is not finite; repair the recording")
        with np.errstate(over="ignore"):  # a code beyond float64 is beyond the format too
            return np.floor((values - self.offset) / self.scale * 2.0**self.signal.fix.frac + 0.5)

    def held(self, values: np.ndarray) -> np.ndarray:
        """Physical values as an input holds them: those of their codes within the format. Raises as `codes`."""
        return self.values(np.clip(self.codes(values), self.signal.fix.lo, self.signal.fix.hi))

    def values(self, codes: np.ndarray) -> np.ndarray:
        """Codes as physical values, of the same shape."""
        return codes * self.signal.fix.lsb * self.scale + self.offset


@dataclass(frozen=True)
class Clipped:
    """Values of an input outside its format: count and share, the range of the format and that of the values."""

    count: Count
    share: float
    holds: tuple[float, float]  # in the port's unit, as `given`
    given: tuple[float, float]


@dataclass(frozen=True)
class State:
    """The value that `source` had one step before; `initial` holds one code per element."""

    signal: Signal
    source: Name
    initial: Annotated[tuple[Code, ...], SOME, "A code of the signal's format for each element."]

    def problems(self, program: "Program") -> Iterator[str]:
        source = program.signals.get(self.source)
        if source is None:
            yield f"state {self.signal.name}: its source {self.source} does not exist"
        elif (source.size, source.fix) != (self.signal.size, self.signal.fix):
            yield f"state {self.signal.name}: size or format differ from its source {self.source}"
        elif len(self.initial) != self.signal.size or not self.signal.fix.holds(*self.initial):
            yield f"state {self.signal.name}: initial codes do not fit"


OfArgument = Annotated[Code, "In the argument's format."]
OfResult = Annotated[Code, "In the result's format."]


@dataclass(frozen=True)
class Affine:
    """out = requantize(bias + weights @ concatenate(args)), exact up to its single rounding; `frac` is per row."""

    out: Signal
    args: Annotated[tuple[Name, ...], SOME, "Signals whose elements are the columns."]
    weights: Annotated[Matrix, "A row for each element of the result."]  # int64 (size, columns)
    bias: Codes  # int64 (size,)
    frac: Annotated[Shifts, "Fraction bits of each row's sum."]  # int64 (size,)
    rounding: Rounding = Rounding.HALF_UP
    overflow: Overflow = Overflow.SATURATE
    op = Op.AFFINE
    requantizes = True

    def problems(self, program: "Program") -> Iterator[str]:
        if not self.args:
            yield f"{self.out.name} reads nothing; an AFFINE has at least one argument"
            return
        size, columns = self.out.size, sum(program.signals[a].size for a in self.args)
        if self.weights.shape != (size, columns) or self.bias.shape != (size,) or self.frac.shape != (size,):
            yield f"{self.out.name}: weights {self.weights.shape}, bias or frac: not {size} rows of {columns}"
            return
        if any(part.dtype != np.int64 for part in (self.weights, self.bias, self.frac)):
            yield f"{self.out.name}: weights, bias or frac are not integers of 64 bits"
            return
        left = [self.out.fix.frac - int(f) for f in self.frac]
        if max(map(abs, left)) > ACCUMULATOR_BITS:
            yield f"{self.out.name}: a row's fraction is more than {ACCUMULATOR_BITS} bits from that of {self.out.fix}"
            return
        width = program.accumulator_width(self) + max(0, *left)
        if width > ACCUMULATOR_BITS:
            yield f"{self.out.name}: accumulator needs {width} bits, more than {ACCUMULATOR_BITS}"


@dataclass(frozen=True)
class Elementwise:
    """An operation in which each element of the result depends only on the same element of each argument."""

    out: Signal
    reads: ClassVar[tuple[str, ...]] = ("arg",)  # the fields that name the arguments
    op: ClassVar[Op]
    requantizes: ClassVar[bool] = False  # whether a result is rounded and may saturate

    @property
    def args(self) -> tuple[str, ...]:
        return tuple(getattr(self, name) for name in self.reads)

    def problems(self, program: "Program") -> Iterator[str]:
        for arg in (program.signals[a] for a in self.args):
            if arg.size != self.out.size:
                yield f"{self.out.name}: size {self.out.size} differs from the {arg.size} of its argument {arg.name}"


@dataclass(frozen=True)
class Lookup(Elementwise):
    """out = table(arg)."""

    arg: Name
    table: Annotated[Name, "Name of a table with the formats of argument and result."]
    op = Op.TABLE

    def problems(self, program: "Program") -> Iterator[str]:
        yield from super().problems(program)
        table = program.table.get(self.table)
        if table is None:
            yield f"{self.out.name}: table {self.table} does not exist"
        elif (table.arg, table.out) != (program.signals[self.arg].fix, self.out.fix):
            yield f"{self.out.name}: formats differ from those of table {self.table}"


@dataclass(frozen=True)
class Clamp(Elementwise):
    """out = requantize(min(max(arg, lo), hi)); lo and hi are codes of the arg's format."""

    arg: Name
    lo: OfArgument
    hi: OfArgument
    rounding: Rounding = Rounding.HALF_UP
    op = Op.CLAMP
    overflow = Overflow.SATURATE
    requantizes = True

    def problems(self, program: "Program") -> Iterator[str]:
        yield from super().problems(program)
        arg = program.signals[self.arg].fix
        width = arg.width + max(0, self.out.fix.frac - arg.frac)
        if width > ACCUMULATOR_BITS:
            yield f"{self.out.name}: needs {width} bits on the way, more than {ACCUMULATOR_BITS}"
        if not arg.holds(self.lo, self.hi) or self.lo > self.hi:
            yield f"{self.out.name}: clamp [{self.lo}, {self.hi}] does not fit {arg}"


@dataclass(frozen=True)
class Threshold(Elementwise):
    """out = above if arg >= at else below; `at` is a code of the arg's format, the others of out's."""

    arg: Name
    at: OfArgument
    below: OfResult
    above: OfResult
    op = Op.THRESHOLD

    def problems(self, program: "Program") -> Iterator[str]:
        yield from super().problems(program)
        if not (program.signals[self.arg].fix.holds(self.at) and self.out.fix.holds(self.below, self.above)):
            yield f"{self.out.name}: threshold codes do not fit"


@dataclass(frozen=True)
class Select(Elementwise):
    """out = requantize(above if condition >= 0 else below): a multiplexer that saturates."""

    condition: Name
    above: Name
    below: Name
    rounding: Rounding = Rounding.HALF_UP
    op = Op.SELECT
    overflow = Overflow.SATURATE
    reads = ("condition", "above", "below")
    requantizes = True

    def problems(self, program: "Program") -> Iterator[str]:
        yield from super().problems(program)
        values = [program.signals[a].fix for a in (self.above, self.below)]
        frac = max(v.frac for v in values)  # the finer of the two holds both; that of the result may be finer still
        width = max(v.width + frac - v.frac for v in values) + max(0, self.out.fix.frac - frac)
        if width > ACCUMULATOR_BITS:
            yield f"{self.out.name}: needs {width} bits on the way, more than {ACCUMULATOR_BITS}"


@dataclass(frozen=True)
class Product(Elementwise):
    """out = requantize(one * other): two signals multiplied, exact up to a single rounding, saturated."""

    one: Name
    other: Name
    rounding: Rounding = Rounding.HALF_UP
    op = Op.PRODUCT
    overflow = Overflow.SATURATE
    reads = ("one", "other")
    requantizes = True

    def problems(self, program: "Program") -> Iterator[str]:
        yield from super().problems(program)
        one, other = (program.signals[a].fix for a in self.args)
        width = one.width + other.width + max(0, self.out.fix.frac - one.frac - other.frac)
        if width > ACCUMULATOR_BITS:
            yield f"{self.out.name}: needs {width} bits on the way, more than {ACCUMULATOR_BITS}"


Operation = Affine | Lookup | Clamp | Threshold | Select | Product
_KINDS = {kind.op: kind for kind in get_args(Operation)}


def _operations(value: object, where: str) -> tuple[Operation, ...]:
    def read(entry: object, where: str) -> Operation:
        op = one_of(Op)(entry.get("op") if isinstance(entry, dict) else None, f"{where}.op")
        return record(_KINDS[op])(entry, where)

    return tuple(listed(read)(value, where))


@dataclass(frozen=True, eq=False)
class Program:
    """One step of a network on integers, made by the compiler; `check` holds before and after every pass.

    docs/integer-program.md defines what each operation computes, to the bit.

    >>> program = compiled.program
    >>> program
    <Program lag: u Fix(18, 17) -> y Fix(19, 18); 1 operations, 1 states>
    """

    name: Annotated[str, check_name, WORD, "Also the name of the top module."]
    inputs: Annotated[tuple[Terminal, ...], SOME, "In the order of the input stream."]
    states: tuple[State, ...]
    operations: Annotated[tuple[Operation, ...], _operations, "In the order in which a step performs them."]
    outputs: Annotated[tuple[Terminal, ...], SOME, "In the order of the output stream."]
    tables: Annotated[tuple[Table | Lines, ...], read_tables] = ()
    period: Annotated[float, Json(exclusiveMinimum=0), "Seconds of a step, for reports only."] = 1e-3
    notes: Annotated[dict[Name, Text], "Signal -> why it has its format."] = field(default_factory=dict)

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
    def table(self) -> dict[str, Table | Lines]:
        return {t.name: t for t in self.tables}

    def accumulator_width(self, operation: Affine) -> int:
        """Width that no partial sum of any row, with its rounding constant, can exceed; it is proved, not measured."""
        return max(2, *self.row_widths(operation))

    def row_widths(self, operation: Affine) -> list[int]:
        """The same of each row."""
        sizes = [(self.signals[a].fix, self.signals[a].size) for a in operation.args]
        largest = np.array([-fix.lo for fix, size in sizes for _ in range(size)], object)
        weights, bias = (np.abs(part.astype(object)) for part in (operation.weights, operation.bias))
        shift = operation.frac - operation.out.fix.frac
        rounding = [1 << int(s - 1) if s > 0 else 0 for s in shift]
        return [signed_width(int(m) + h) for m, h in zip(weights @ largest + bias, rounding, strict=True)]

    def check(self) -> "Program":
        """Return the program; raise InputError if it is not legal by docs/integer-program.md."""
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
        parts: tuple[Signal | Terminal | Table | Lines, ...] = (*declared, *self.inputs, *self.outputs, *self.tables)
        for part in parts:
            yield from part.problems()
        known = {p.signal.name for p in self.inputs} | {s.signal.name for s in self.states}
        for o in self.operations:
            for arg in o.args:
                if arg not in known:
                    yield f"{o.out.name} reads {arg} before it is defined"
                    return
            yield from o.problems(self)
            known.add(o.out.name)
        for state in self.states:
            yield from state.problems(self)
        for port in self.outputs:
            if self.signals.get(port.signal.name) != port.signal:
                yield f"output {port.name} shows {port.signal.name}, which is not a signal of the program"

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
        """The values that `encode` clips, by the name of the input; only inputs with such values are listed."""
        found = {}
        for port in self.inputs:
            codes, fix, given = port.codes(values[port.name]), port.signal.fix, np.asarray(values[port.name], float)
            count = int(np.count_nonzero((codes < fix.lo) | (codes > fix.hi)))
            if count:
                least, most = sorted(port.values(np.array([fix.lo, fix.hi])).tolist())
                lowest, highest = float(given.min()), float(given.max())
                found[port.name] = Clipped(count, count / codes.size, (least, most), (lowest, highest))
        return found

    def decode(self, codes: np.ndarray) -> dict[str, np.ndarray]:
        """Output codes (..., N, columns) to physical values {port: (..., N) or (..., N, size)}."""
        values, start = {}, 0
        for port in self.outputs:
            part = port.values(codes[..., start : start + port.signal.size])
            values[port.name] = part if port.signal.size > 1 else part[..., 0]
            start += port.signal.size
        return values

    def save(self, path: Path | str) -> None:
        """Write the program as JSON that a person can read."""
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(to_json(self), indent=1), encoding="utf-8", newline="\n")

    @staticmethod
    def load(path: Path | str) -> "Program":
        """Read and check a program. Raises InputError for a file that is missing, truncated or not legal."""
        try:
            return record(Program)(read_json(path, "compile the network again"), f"{path}:").check()
        except InputError as error:
            said = str(error)
            raise InputError(said if said.startswith(str(path)) else f"{path}: {said}") from None
