"""The numbers of the integer program: formats, rounding and overflow, and how program.json holds integers.

docs/integer-program.md, "Numbers", is their normative text.
"""

from collections.abc import Iterator
from enum import StrEnum
from numbers import Integral
from typing import Annotated, Any, NamedTuple

import numpy as np

from greygate.errors import InputError
from greygate.names import LONGEST_NAME, LONGEST_TEXT, LONGEST_UNIT, PART, check_path, check_text, check_unit
from greygate.plain import Json, span
from greygate.reading import listed, whole

ACCUMULATOR_BITS = 62  # room for one more addition in int64
WIDTHS = range(2, 49)
FRACTIONS = range(-48, 61)
LARGEST_SHIFT = 1 << 10  # of any width, fraction or shift in a file; legal values are far below


Name = Annotated[str, check_path, Json(maxLength=LONGEST_NAME, pattern=rf"^{PART}(\.{PART})*$")]
Text = Annotated[str, check_text, Json(minLength=1, maxLength=LONGEST_TEXT)]
Unit = Annotated[str, check_unit, Json(minLength=1, maxLength=LONGEST_UNIT)]
_code, _shift = whole(-(1 << ACCUMULATOR_BITS), 1 << ACCUMULATOR_BITS), whole(-LARGEST_SHIFT, LARGEST_SHIFT)
_codes, _shifts = listed(_code), listed(_shift)
Code = Annotated[int, _code, span(-(1 << ACCUMULATOR_BITS), 1 << ACCUMULATOR_BITS)]
Shift = Annotated[int, _shift]
Bits = Annotated[int, _shift, span(0, ACCUMULATOR_BITS)]


def _matrix(value: object, where: str) -> np.ndarray:
    rows = listed(_codes)(value, where)
    if len({len(row) for row in rows}) != 1:
        raise InputError(f"{where}: its rows differ in length, or there are none; correct it")
    return np.array(rows, np.int64)


def _some(kind: Any) -> Json:
    return Json(type="array", items=kind, minItems=1)


Codes = Annotated[np.ndarray, lambda value, where: np.array(_codes(value, where), np.int64), _some(Code)]
Shifts = Annotated[np.ndarray, lambda value, where: np.array(_shifts(value, where), np.int64), _some(Shift)]
Matrix = Annotated[np.ndarray, _matrix, _some(Codes)]


class Fix(NamedTuple):
    """Two's complement of `width` bits, the sign counted; value = integer * 2^-frac."""

    width: Annotated[Shift, span(WIDTHS.start, WIDTHS.stop - 1)]
    frac: Annotated[Shift, span(FRACTIONS.start, FRACTIONS.stop - 1)]

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

    def problems(self, of: str) -> Iterator[str]:
        """What is not legal in this format of a signal or table."""
        if self.width not in WIDTHS:
            yield f"{of}: width {self.width} is not in {WIDTHS.start}..{WIDTHS.stop - 1}"
        if self.frac not in FRACTIONS:
            yield f"{of}: fraction {self.frac} is not in {FRACTIONS.start}..{FRACTIONS.stop - 1}; scale its port"

    def __str__(self) -> str:
        return f"Fix({self.width}, {self.frac})"


class Rounding(StrEnum):
    TRUNCATE = "truncate"
    HALF_UP = "half_up"
    HALF_EVEN = "half_even"


class Overflow(StrEnum):
    SATURATE = "saturate"
    WRAP = "wrap"


def signed_width(magnitude: int) -> int:
    """The least width in two's complement that holds every integer from -magnitude to +magnitude."""
    return int(magnitude).bit_length() + 1
