"""Reads a module of Yosys's JSON word by word: which vectors are sums of the inputs, with which weights and ranges.

A vector of bits is followed to the cells that drive it. Sums, differences, shifts, sign extensions, slices, registers
keep it an affine function of the elements of the inputs. A register counts as a wire: when a value comes is another
matter. Bits that are dropped become unknowns of their own, `Rest` and `Some`, which vanish again where a sum of two
slices is exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

Vector = tuple[str, str]  # (cell, port), or ("", element) for an element of an input
Bit = int | str

REGISTERS = ("$dff", "$dffe", "$sdff", "$sdffe", "$sdffce", "$adff", "$adffe", "$aldff")
ADDERS = ("$add", "$sub", "$neg")
LINEAR = (*ADDERS, "$mul", "$pos", "$not", "$shl", "$sshl")


@dataclass(frozen=True)
class Rest:
    """The unknown: a function modulo 2^bits. Never equal to the Some of the same bits, as two named tuples would be."""

    of: "Key"
    bits: int


@dataclass(frozen=True)
class Some:
    """The unknown: 1 if that is not 0, else 0."""

    of: "Key"
    bits: int


Unknown = str | Rest | Some  # a str names an element
Key = tuple[tuple[tuple[Unknown, int], ...], int]  # weights and constant of a function modulo a power of two


@dataclass(frozen=True)
class Affine:
    """const + sum of weight * unknown, exactly; `weights` holds no zero. Unknowns: names of elements, Rest, Some."""

    weights: Mapping[Unknown, Fraction] = field(default_factory=dict)
    const: Fraction = Fraction(0)

    def __add__(self, other: "Affine") -> "Affine":
        names = dict.fromkeys((*self.weights, *other.weights))
        found = {n: self.weights.get(n, Fraction(0)) + other.weights.get(n, Fraction(0)) for n in names}
        return Affine({n: w for n, w in found.items() if w}, self.const + other.const)

    def times(self, factor: Fraction | int) -> "Affine":
        return Affine({n: w * factor for n, w in self.weights.items() if factor}, self.const * factor)

    @property
    def whole(self) -> bool:
        """Whether every weight is a whole number."""
        return all(v.denominator == 1 for v in (*self.weights.values(), self.const))

    def range(self, elements: Mapping[str, tuple[int, int]]) -> tuple[Fraction, Fraction]:
        """The least and the greatest value, exactly if all unknowns are elements. elements: the range of each."""
        lo = hi = self.const
        for n, w in self.weights.items():
            least, most = (
                (0, (1 << n.bits) - 1) if isinstance(n, Rest) else (0, 1) if isinstance(n, Some) else elements[n]
            )
            lo, hi = lo + min(w * least, w * most), hi + max(w * least, w * most)
        return lo, hi

    def modulo(self, bits: int) -> "Affine":
        """The function modulo 2^bits. Its weights must be whole."""
        size = 1 << bits
        weights = {n: int(w) % size for n, w in self.weights.items() if int(w) % size}
        const = int(self.const) % size
        if not weights:
            return Affine({}, Fraction(const))
        if len(weights) == 1 and isinstance(next(iter(weights)), Some):  # it takes two values
            (name, weight), *_ = weights.items()
            step = (const + weight) % size - const
            return Affine({name: Fraction(step)} if step else {}, Fraction(const))
        if shared := min((w & -w for n, w in weights.items() if isinstance(n, str)), default=1).bit_length() - 1:
            whole = Affine({n: Fraction(w) for n, w in weights.items()}, Fraction(const))
            low = whole.modulo(shared)  # no element has a part in these bits
            if low.weights.keys() <= weights.keys():
                above = (whole + low.times(-1)).times(Fraction(1, 1 << shared))
                return low + above.modulo(bits - shared).times(1 << shared)
        order = sorted(weights, key=repr)
        key = tuple((n, weights[n]) for n in order), const
        minus = tuple((n, size - weights[n]) for n in order), -const % size
        if bits == 1:
            return Affine({Some(key, 1): Fraction(1)})
        least = min(key, minus, key=repr)
        rest = Affine({Rest(least, bits): Fraction(1)})
        return rest if key == least else Affine({Some(least, bits): Fraction(size)}) + rest.times(-1)

    def some(self) -> "Affine | None":
        """1 where a function, as `modulo` gives it, is not 0, else 0; None if that is no affine function."""
        unknowns = [n for n in self.weights if not isinstance(n, str)]
        if len(unknowns) < len(self.weights):
            return None
        names = {(n.of, n.bits) for n in unknowns}
        if len(names) != 1:
            return None if names else Affine({}, Fraction(int(self.const != 0)))
        rest, some = Rest(*(name := names.pop())), Some(*name)
        weight, other = self.weights.get(rest, Fraction(0)), self.weights.get(some, Fraction(0))
        if not weight:  # it takes two values
            never, ever = int(self.const != 0), int(self.const + other != 0)
            return Affine({some: Fraction(ever - never)} if ever != never else {}, Fraction(never))
        negated = other == -weight * (1 << rest.bits)  # 0 where the remainder is 0, and only there
        return Affine({some: Fraction(1)}) if (negated or not other) and not self.const else None


def signed_bits(lo: int, hi: int) -> int:
    """Bits of the least two's complement that holds both."""
    return max((v if v >= 0 else ~v).bit_length() for v in (lo, hi)) + 1


class Value(NamedTuple):
    """A number that a vector holds: as a function, and its least and greatest value."""

    function: Affine
    lo: int
    hi: int

    def fits(self, width: int, signed: bool) -> bool:
        return signed_bits(self.lo, self.hi) <= width if signed else self.lo >= 0 and self.hi < 1 << width


def _nearest(value: Value, width: int) -> Value:
    """The value modulo 2^width that lies about 0, where only the remainder is known."""
    if value.fits(width, True) or value.fits(width, False):
        return value
    less = round(Fraction(value.lo + value.hi, 2 << width)) << width
    return Value(value.function + Affine({}, Fraction(-less)), value.lo - less, value.hi - less)


@dataclass
class Module:
    """A module after `proc` and `flatten`.

    json: as Yosys wrote it. elements: name of each element of an input -> (port, lowest bit, width); all are signed.
    ranges: what is known of an element; else it takes every code of its width.
    """

    json: dict
    elements: Mapping[str, tuple[str, int, int]]
    ranges: Mapping[str, tuple[int, int]]

    def __post_init__(self) -> None:
        self._found: dict[Vector, Value | None] = {}

    @cached_property
    def cells(self) -> dict[str, dict]:
        return self.json["cells"]

    @cached_property
    def drivers(self) -> dict[int, tuple[Vector, int]]:
        """Bit -> the vector that it is of, and its place there."""
        found: dict[int, tuple[Vector, int]] = {}
        for name, (port, low, width) in self.elements.items():
            for k, bit in enumerate(self.json["ports"][port]["bits"][low : low + width]):
                found.setdefault(bit, (("", name), k))
        for name, cell in self.cells.items():
            for port, bits in cell["connections"].items():
                if cell["port_directions"][port] == "output":
                    found |= {bit: ((name, port), k) for k, bit in enumerate(bits) if isinstance(bit, int)}
        return found

    @cached_property
    def names(self) -> dict[int, str]:
        """Bit -> the name of a wire that it is the lowest bit of, the shortest there is."""
        found: dict[int, str] = {}
        for name, net in sorted(self.json["netnames"].items(), key=lambda item: -len(item[0])):
            if net["bits"] and not net.get("hide_name"):
                found[net["bits"][0]] = name
        return found

    def name(self, vector: Vector) -> str:
        """The name of a vector's wire."""
        if not vector[0]:
            return vector[1]
        return self.names.get(self.cells[vector[0]]["connections"][vector[1]][0], vector[0])

    def width(self, vector: Vector) -> int:
        return len(self.cells[vector[0]]["connections"][vector[1]]) if vector[0] else self.elements[vector[1]][2]

    def origin(self, bit: Bit) -> tuple[Vector, int] | str:
        """The vector and the place that a bit comes from, through any registers; "0", "1" or "x" as they are.

        A bit of an input that has no element is "?" and its number.
        """
        while isinstance(bit, int):
            if bit not in self.drivers:
                return f"?{bit}"
            (name, port), k = self.drivers[bit]
            if not name or self.cells[name]["type"] not in REGISTERS:
                return (name, port), k
            bit = self.cells[name]["connections"]["D"][k]
        return bit

    def valued(self, function: Affine, lo: int | None = None, hi: int | None = None) -> Value:
        """A function with its range; lo, hi: what else is known of that."""
        least, most = function.range(self.reach)
        low, high = -(-least.numerator // least.denominator), most.numerator // most.denominator
        return Value(function, low if lo is None else max(lo, low), high if hi is None else min(hi, high))

    @cached_property
    def reach(self) -> dict[str, tuple[int, int]]:
        """The range of every element."""
        whole = {n: (-(1 << (w - 1)), (1 << (w - 1)) - 1) for n, (_, _, w) in self.elements.items()}
        return whole | dict(self.ranges)

    def value(self, vector: Vector) -> Value | None:
        """The number that a vector holds; None where it is no affine function, or does not fit its width."""
        if not vector[0]:
            return self.valued(Affine({vector[1]: Fraction(1)}))
        if vector not in self._found:
            self._found[vector] = None  # of a loop
            found, width = self._computed(self.cells[vector[0]]), self.width(vector)
            if found is not None and (found.fits(width, True) or found.fits(width, False)):
                self._found[vector] = found
        return self._found[vector]

    def sums(self) -> dict[str, tuple[Value, int]]:
        """Every adder of affine functions: the name of its wire -> (what it should hold, its width)."""
        found = {}
        for name, cell in self.cells.items():
            if cell["type"] in ADDERS and (value := self._computed(cell)) is not None and value.function.weights:
                found[self.name((name, "Y"))] = (value, self.width((name, "Y")))
        return found

    def _computed(self, cell: dict) -> Value | None:
        """What a cell computes, without regard to the width of its result."""
        kind, ends = cell["type"], cell["connections"]
        if kind in ("$reduce_or", "$reduce_bool"):
            return self._some(ends["A"])
        if kind not in LINEAR:
            return None
        width = len(ends["Y"])
        signed = all(int(cell["parameters"].get(f"{p}_SIGNED", "1"), 2) for p in "AB")
        shifts = kind in ("$shl", "$sshl")
        modular = [len(ends["A"]) >= width, len(ends.get("B", ())) >= width and not shifts]
        a = self.number(ends["A"], signed, modular[0])
        b = self.number(ends["B"], signed and not shifts, modular[1]) if "B" in ends else Value(Affine(), 0, 0)
        if a is None or b is None:
            return None
        found = self._linear(kind, a, b)
        return _nearest(found, width) if found and all(modular[: 2 if "B" in ends and not shifts else 1]) else found

    def _linear(self, kind: str, a: Value, b: Value) -> Value | None:
        if kind == "$mul":
            one, other = (a, b) if not b.function.weights else (b, a)
            return None if other.function.weights else self.valued(one.function.times(other.function.const))
        if kind in ("$shl", "$sshl"):
            return None if b.function.weights or b.lo < 0 else self.valued(a.function.times(1 << b.lo))
        if kind == "$add":
            return self.valued(a.function + b.function, a.lo + b.lo, a.hi + b.hi)
        if kind == "$sub":
            return self.valued(a.function + b.function.times(-1), a.lo - b.hi, a.hi - b.lo)
        if kind == "$pos":
            return a
        less = int(kind == "$not")
        return self.valued(a.function.times(-1) + Affine({}, Fraction(-less)), -a.hi - less, -a.lo - less)

    def _some(self, bits: Sequence[Bit]) -> Value | None:
        """1 if any of the bits is set: of the rest of a function."""
        found = self.number(bits, False, False)
        function = found.function.some() if found else None
        return Value(function, 0, 1) if function else None

    def number(self, bits: Sequence[Bit], signed: bool, modular: bool) -> Value | None:
        """The number that bits, the lowest first, stand for; None if they are no affine function.

        modular: any number that is the same modulo 2^(number of bits) will do.
        """
        found = [self.origin(bit) for bit in bits]
        total, at = Value(Affine(), 0, 0), 0
        while at < len(found):
            part, count = self._part(found[at:], signed, modular)
            if part is None:
                return None
            scaled = part.function.times(1 << at)
            total = Value(total.function + scaled, total.lo + (part.lo << at), total.hi + (part.hi << at))
            at += count
        return total

    def _part(self, found: list, signed: bool, modular: bool) -> tuple[Value | None, int]:
        """(the number of the lowest bits that come from one vector, or are constant; how many they are)."""
        if isinstance(found[0], str):
            count = next((k for k, at in enumerate(found) if not isinstance(at, str)), len(found))
            const = sum(1 << k for k in range(count) if found[k] == "1")
            if count == len(found) and (signed or modular) and found[-1] == "1":
                const -= 1 << count
            known = set(found[:count]) <= {"0", "1"}
            return (Value(Affine({}, Fraction(const)), const, const) if known else None), count
        vector, first = found[0]
        count = 0
        while count < len(found) and found[count] == (vector, first + count):
            count += 1
        value, above = self.value(vector), found[count:]
        if value is None:
            return None, count
        sign = (vector, first + count - 1)  # of bits that hold the whole range, be they all of the vector or not
        if above and all(bit == sign for bit in above) and value.fits(first + count, True):
            return self._dropped(value, first), len(found)
        if not above and modular:
            return self._dropped(value, first), count
        if not above and signed:
            return (self._dropped(value, first) if value.fits(first + count, True) else None), count
        if value.fits(first + count, False):
            return self._dropped(value, first), count
        shifted = self._dropped(value, first)
        if shifted is None or not shifted.function.whole:
            return None, count
        rest = shifted.function.modulo(count)
        return self.valued(rest, 0, (1 << count) - 1), count

    def _dropped(self, value: Value, bits: int) -> Value | None:
        """The number without its lowest bits."""
        if not bits:
            return value
        if not value.function.whole:
            return None
        rest = value.function.modulo(bits)
        function = (value.function + rest.times(-1)).times(Fraction(1, 1 << bits))
        return self.valued(function, value.lo >> bits, value.hi >> bits)
