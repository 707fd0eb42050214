"""The integer program: what the hardware does in one step. Its normative text is docs/integer-program.md.

Declared here and nowhere else; the interpreter, the engine, the Verilog emitter and the report walk it.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from greygate.errors import InputError
from greygate.files import replacing

ACCUMULATOR_BITS = 62  # room for one more addition in int64


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
    """One step of a network on integers. Made by the compiler; `check` holds before and after every pass."""

    name: str
    inputs: tuple[Port, ...]
    states: tuple[State, ...]
    operations: tuple[Operation, ...]
    outputs: tuple[Port, ...]
    tables: tuple[Table, ...] = ()
    period: float = 1e-3  # s, for reports only
    notes: dict[str, str] = field(default_factory=dict)  # signal -> why it has its format

    @cached_property
    def signals(self) -> dict[str, Signal]:
        """Every signal by name: inputs, states, results, in that order."""
        parts = [p.signal for p in self.inputs] + [s.signal for s in self.states]
        return {s.name: s for s in parts + [o.out for o in self.operations]}

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
        magnitude = np.abs(operation.weights).astype(object) @ largest + np.abs(operation.bias).astype(object)
        shift = operation.frac - operation.out.fix.frac
        rounding = [1 << int(s - 1) if s > 0 else 0 for s in shift]
        return max(2, *(signed_width(int(m) + h) for m, h in zip(magnitude, rounding, strict=True)))

    def check(self) -> "Program":
        """Raise InputError unless the program is legal by docs/integer-program.md; return it."""
        for problem in self._problems():
            raise InputError(f"program {self.name}: {problem}")
        return self

    def _problems(self) -> Iterator[str]:
        declared = [p.signal for p in self.inputs] + [s.signal for s in self.states] + [o.out for o in self.operations]
        names = [s.name for s in declared]
        for name in {n for n in names if names.count(n) > 1}:
            yield f"signal {name} is defined twice"
        for s in declared:
            if s.fix.width < 2 or s.fix.width > 48:
                yield f"signal {s.name}: width {s.fix.width} is not in 2..48"
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
            elif len(state.initial) != state.signal.size or not all(
                state.signal.fix.lo <= v <= state.signal.fix.hi for v in state.initial
            ):
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
            width = self.accumulator_width(o) + max(0, int(np.max(o.out.fix.frac - o.frac)))
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
            else:
                yield from _table_problems(table)
        elif isinstance(o, Clamp):
            width = arg.fix.width + max(0, o.out.fix.frac - arg.fix.frac)
            if width > ACCUMULATOR_BITS:
                yield f"{o.out.name}: needs {width} bits on the way, more than {ACCUMULATOR_BITS}"
            if o.lo > o.hi or o.lo < arg.fix.lo or o.hi > arg.fix.hi:
                yield f"{o.out.name}: clamp [{o.lo}, {o.hi}] does not fit {arg.fix}"
        elif not (
            arg.fix.lo <= o.at <= arg.fix.hi
            and o.out.fix.lo <= o.below <= o.out.fix.hi
            and o.out.fix.lo <= o.above <= o.out.fix.hi
        ):
            yield f"{o.out.name}: threshold codes do not fit"

    def select_width(self, o: Select) -> int:
        """Width that holds both values at the finer fraction of the two, and the result's if that is finer still."""
        values = self.signals[o.above].fix, self.signals[o.below].fix
        frac = max(v.frac for v in values)
        return max(v.width + frac - v.frac for v in values) + max(0, o.out.fix.frac - frac)

    def _select_problems(self, o: Select) -> Iterator[str]:
        if self.select_width(o) > ACCUMULATOR_BITS:
            yield f"{o.out.name}: needs {self.select_width(o)} bits on the way, more than {ACCUMULATOR_BITS}"

    def encode(self, values: dict[str, np.ndarray]) -> np.ndarray:
        """Physical inputs {port: (..., N) or (..., N, size)} to codes (..., N, columns), clipped to the formats."""
        columns = []
        for port in self.inputs:
            v = np.asarray(values[port.name], float)
            v = v if port.signal.size > 1 else v[..., None]
            codes = np.floor((v - port.offset) / port.scale * 2.0**port.signal.fix.frac + 0.5)
            columns.append(np.clip(codes, port.signal.fix.lo, port.signal.fix.hi).astype(np.int64))
        return np.concatenate(columns, axis=-1)

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
            return _from_json(json.loads(Path(path).read_text())).check()
        except (OSError, KeyError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: not a readable program ({error}); compile the network again") from None


def _table_problems(table: Table) -> Iterator[str]:
    if len(table.points) < 2 or table.shift < 0 or table.out.frac < 0:
        yield f"table {table.name}: needs two points, a shift and a result's fraction that are not negative"
        return
    answers = {
        Symmetry.ODD: [-p for p in table.points],
        Symmetry.EVEN: [],
        Symmetry.COMPLEMENT: [(1 << max(table.out.frac, 0)) - p for p in table.points],
    }[table.symmetry]
    if not all(table.out.lo <= p <= table.out.hi for p in (*table.points, *answers)):
        yield f"table {table.name}: a point, or what its symmetry makes of it, does not fit {table.out}"


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


def _from_json(data: dict) -> Program:
    def signal(d):
        return Signal(d["name"], d["size"], Fix(*d["fix"]))

    def port(d):
        return Port(d["name"], signal(d["signal"]), d["unit"], d["scale"], d["offset"])

    def operation(d):
        d = dict(d)
        kind = _KINDS[Op(d.pop("op"))]
        d["out"] = signal(d["out"])
        if kind is Affine:
            d |= {k: np.array(d[k], np.int64) for k in ("bias", "frac")}
            d["weights"] = np.array(d["weights"], np.int64).reshape(d["out"].size, -1)
            d |= {"args": tuple(d["args"]), "overflow": Overflow(d["overflow"])}
        if "rounding" in d:
            d["rounding"] = Rounding(d["rounding"])
        return kind(**d)

    def table(d):
        formats = {"arg": Fix(*d["arg"]), "out": Fix(*d["out"])}
        return Table(**(d | formats | {"points": tuple(d["points"]), "symmetry": Symmetry(d["symmetry"])}))

    return Program(
        name=data["name"],
        inputs=tuple(port(d) for d in data["inputs"]),
        states=tuple(State(signal(d["signal"]), d["source"], tuple(d["initial"])) for d in data["states"]),
        operations=tuple(operation(d) for d in data["operations"]),
        outputs=tuple(port(d) for d in data["outputs"]),
        tables=tuple(table(d) for d in data["tables"]),
        period=data["period"],
        notes=data["notes"],
    )
