"""Where a table begins in a text: below what instruments, loggers and spreadsheets write above it, and its times."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greygate.errors import InputError

CLOCKS = (
    "time", "times", "timestamp", "timestamps", "zeit", "elapsed", "seconds", "time_s", "x_value", "date", "datetime",
    "date time", "date/time",
)  # fmt: skip
"""Names that a column of times has, in small letters, beside t."""
NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
BLANKS = " "  # as a separator: any number of blanks and tabs
HIGHEST = 200  # lines that may stand above a table
LONGEST = 12  # characters of a unit
FEWEST = 2  # columns of a table
_LINE = re.compile(r"\r\n|\r|\n")
_SEP = re.compile(r'"?sep=([,;\t])"?\s*', re.I)  # the first line of a spreadsheet's CSV
_MARK = re.compile(r"\s*[#%]+\s*(?=[^\s,;])")  # of a comment, in which the names may stand
_DATE = re.compile(
    r"((?:19|20)\d\d-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?)\s*(Z|[+-]\d\d:?\d\d)?|"
    r"(\d{1,2}:\d\d:\d\d(?:[.,]\d{1,9})?)"
)


@dataclass(frozen=True)
class Layout:
    """above: lines above the names. separator: of the columns. text: from the names on. said: whether more is above
    than a spreadsheet's word on the separator.
    """

    above: int
    separator: str
    text: str
    said: bool


def layout(text: str) -> Layout | None:
    """Where the names stand: right above the first row of numbers, or above its row of units; None where they do not.

    No names may be numbers, and all these rows have as many cells: what is no table is left to who reads the first row.
    """
    lines = _LINE.split(text)[: HIGHEST + 1]
    first = next((k for k, line in enumerate(lines) if line.strip()), 0)
    told = _SEP.fullmatch(lines[first])
    for separator in [told[1]] if told else [";", "\t", ",", BLANKS]:
        rows = [(k, cells_of(_MARK.sub("", line), separator)) for k, line in enumerate(lines) if line.strip()]
        above = _names_at(rows, separator != ",")
        if above is not None:
            start = _beginning(text, above)
            marked = _MARK.match(text, start)
            said = any(line.strip() for line in lines[first + bool(told) : above])
            return Layout(above, separator, text[marked.end() if marked else start :], said)
    return None


def _beginning(text: str, line: int) -> int:
    """Where a line begins in a text, by its number from 0."""
    at = 0
    for _ in range(line):
        found = _LINE.search(text, at)
        assert found is not None  # it was split there
        at = found.end()
    return at


def cells_of(line: str, separator: str) -> list[str]:
    """The cells of one line, without blanks around; none where its quotes do not close."""
    if separator == BLANKS:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, strict=True), [])]
    except csv.Error:
        return []


def _names_at(rows: Sequence[tuple[int, list[str]]], commas: bool) -> int | None:
    """The line of the names. rows: (line, cells) of those that are not blank. commas: whether they may be decimal."""

    def value(cell: str) -> bool:
        return bool(NUMBER.fullmatch(cell) or (commas and DECIMAL_COMMA.fullmatch(cell)) or _DATE.fullmatch(cell))

    for i, (_, row) in enumerate(rows):
        full = row[:-1] if row and not row[-1] else row
        if len(full) < FEWEST or not all(map(value, full)):
            continue
        fit = [len(cells) - (not cells[-1]) == len(full) if cells else False for _, cells in rows[:i]]
        named = [fits and _are_names(cells[: len(full)]) for fits, (_, cells) in zip(fit, rows[:i], strict=True)]
        if i > 1 and named[i - 2] and named[i - 1]:  # of two rows of words the lower one has units, or who knows what
            return rows[i - 2][0] if _are_units(rows[i - 1][1]) else None
        return rows[i - 1][0] if i and named[i - 1] else None
    return None


def _are_names(cells: Sequence[str]) -> bool:
    return all(re.search(r"[^\W\d_]", cell) and cell.lower() not in ("nan", "inf", "-inf", "null") for cell in cells)


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a row between names and numbers has units; names that have theirs are none."""
    plain = not any(re.search(r"\w\s*[\[(/]", cell) and " " in cell for cell in cells)
    return plain and all(len(cell) <= LONGEST for cell in cells) and not {*map(str.lower, cells)} & {"t", *CLOCKS}


def seconds(cells: Sequence[str], where: str) -> list[str] | None:
    """Times of day, or dates with them (ISO 8601), in seconds since the first, as text; None where they are none.

    Raises InputError where some are not, or their zones differ.
    """
    if not cells or not _DATE.fullmatch(cells[0]):
        return None
    found = [_DATE.fullmatch(cell) for cell in cells]
    if (bad := next((k for k, each in enumerate(found) if each is None), None)) is not None:
        raise InputError(f"{where}: {cells[bad]!r} is no time as {cells[0]!r} is; write all of them alike")
    if len({each[1] is None for each in found if each}) > 1:
        raise InputError(f"{where}: some times have a date and some have none; write all of them alike")
    zones = {each[3] for each in found if each}
    if len(zones) > 1:
        raise InputError(f"{where}: times of the zones {' and '.join(sorted(map(str, zones)))}; write all in one")
    clocks = [(each[2] or each[4]).replace(",", ".") for each in found if each]
    clocks = [f"0{clock}" if clock[1] == ":" else clock for clock in clocks]
    days = [each[1] or "1970-01-01" for each in found if each]
    try:
        instants = np.array([f"{day}T{clock}" for day, clock in zip(days, clocks, strict=True)], "datetime64[ns]")
    except ValueError as error:
        raise InputError(f"{where}: is no time ({error}); write it as 2026-11-30T08:15:00.25") from None
    return [repr(float(ns) / 1e9) for ns in (instants - instants[0]).astype(np.int64)]
