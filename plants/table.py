"""Reads a table of numbers from a CSV file, plain or gzipped; every recording is read here."""

import csv
import gzip
import io
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from greygate.contents import bounded, contents
from greygate.errors import InputError
from greygate.plants.layout import BLANKS, CLOCKS, DECIMAL_COMMA, NUMBER, layout, seconds
from greygate.progress import once

LARGEST = 1e30  # in a cell: above any quantity; its eighth power, in correlations of squares, stays within float64
MOST_BYTES = 2**31  # of a file: a recording is far smaller, a device may never end
MOST_UNPACKED = 2**28  # bytes of a gzipped file: two seconds of unpacking; a larger one is taken for an attack
HEAD, FIRST = 1 << 18, 220  # bytes and lines in which the names and units of a table stand
SHOWN = 40  # characters of a cell that a message quotes

_PLAIN = b"0123456789+-.eE \r\n"  # the characters of a file of decimal numbers, beside its separator
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}")
_BRACKETED = re.compile(r"^[\[(](.*)[\])]$")  # a unit in a row of its own
_MARKS = (b"\xff\xfe", b"\xfe\xff")  # of UTF-16, as a spreadsheet saves "Unicode text"
_ZIP = b"PK\x03\x04"
WESTERN = set("ÄÖÜäöüßÀÂÆÇÈÉÊËÎÏÔŒÙÛàâæçèéêëîïôœùûÿ°µ²³·€§«»–’".encode("cp1252"))
"""Bytes that a spreadsheet writes in Germany or France; another byte shows that the file is in something else."""
_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class CsvTable:
    """A header and its rows of numbers.

    header: names of the columns, each once. cells: the text of each row, with decimal points. values: float64
    (rows, columns). lines: the line of the file on which each row ends; the first line has number 1.
    """

    path: Path
    header: list[str]
    cells: list[list[str]]
    values: np.ndarray
    lines: Sequence[int]

    def require_steps(self, steps: np.ndarray, off: np.ndarray, right: float, why: str = "is usual") -> None:
        """Raise InputError for the worst of the `steps` of the first column that are `off`; both (rows - 1,).

        A step that does not go forward is reported before all others. right: the wanted step, s; why: its reason.
        """
        still = np.flatnonzero(~(steps > 0))
        if not (still.size or off.any()):
            return
        far = np.where(off, np.abs(steps - right), 0.0)
        at = int(still[0]) if still.size else int((far > 0.99 * far.max()).argmax())  # the first of equals
        where = f"{self.path}: row {self.lines[at + 1]}, column {self.header[0]}"
        if still.size:
            raise InputError(
                f"{where} does not increase (from {self.cells[at][0]} to {self.cells[at + 1][0]}); "
                "sort the rows by time, and keep each time once"
            )
        raise InputError(
            f"{where}: step {steps[at]:.6g} s where {right:.6g} s {why}; fill gaps, and bring it to a uniform time: "
            f"greygate look {self.path} --resample auto --out FILE.csv"
        )


def read_table(path: Path | str, nan: bool = False) -> CsvTable:
    """The table in a CSV file: UTF-8, Windows-1252 or UTF-16 with its mark, a header, decimal numbers.

    Columns are separated by commas, semicolons, tabs or blanks; lines above the names are left out, and so is an empty
    last column. Decimal commas are read if a cell shows that they do not separate thousands; dates and times of day in
    a column of times count seconds from the first (`layout`). nan: cells may be `nan`, as at the end
    of the CSV that a diverging simulation writes. Raises InputError for anything else, naming the row as an editor
    numbers it.
    """
    return _read(Path(path), False, nan)[0]


def read_header(path: Path | str) -> tuple[list[str], bool]:
    """(the names of the columns, whether a row of units follows them: no cell of it is a number).

    Only the first lines are read. A file that is no table has no names; `read_table` says why.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(HEAD)
        if data.startswith(_GZIP):
            with gzip.open(path) as file:
                data = file.read(HEAD)
        wide = data[:2] in _MARKS
        text = data.decode("utf-16", "replace") if wide else _western(data) or data.decode("utf-8-sig", "replace")
        rows = _rows(Path(path), "\n".join(re.split(r"\r\n|\r|\n", text)[:FIRST])).rows
    except (OSError, EOFError, ValueError, zlib.error, InputError):
        return [], False
    names = [name.strip() for name in rows[0]]
    below = [cell.strip() for cell in rows[1]] if len(rows) > 1 else []
    written = len(below) == len(names) and any(below) and not any(NUMBER.fullmatch(c) for c in below)
    return names, written and all(re.search(r"[^\W\d_]|^[-%°]?$", c) for c in below) and "nan" not in map(
        str.lower, below
    )


def read_united(path: Path | str) -> tuple[CsvTable, list[str]]:
    """(the table, the units in the row below its names), as `read_table`."""
    return _read(Path(path), True, False)


def _read(path: Path, united: bool, nan: bool) -> tuple[CsvTable, list[str]]:
    found = _rows(path, _text(path))
    rows, separator = found.rows, found.separator
    if found.above:
        once(f"{path}: the lines above line {found.above + 1}, which has the names, are left out")
    if len(rows) > 1 and all(NUMBER.fullmatch(cell.strip()) for cell in rows[0]):
        raise InputError(f"{path}: the first row has numbers; write the names above, of each column: t,u [V],x [m]")
    header = _header(path, [name.strip() for name in rows.pop(0)])
    units = [_BRACKETED.sub(r"\1", cell.strip()) for cell in rows.pop(0)] if united else []
    lines = found.lines[1 + united :]
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(header):
            split = (
                ", or separate columns by semicolons if commas are decimal" if separator == "," and not united else ""
            )
            raise InputError(
                f"{path}: row {line} has {len(row)} cells, the header {len(header)}; correct the row{split}"
            )
    _dated(path, header, units, rows)
    plain = not united and _is_plain(found.text, separator)
    return CsvTable(path, header, *_numbers(path, header, rows, lines, plain, nan), lines), units


def _dated(path: Path, header: list[str], units: list[str], rows: list[list[str]]) -> None:
    """Put seconds in place of dates and times of day, in a column of times that has no other unit."""
    for k, name in enumerate(header):
        if (name != "t" and name.lower() not in CLOCKS) or not rows or ":" not in rows[0][k]:
            continue
        counted = seconds([row[k].strip() for row in rows], f"{path}: column {name}")
        if counted is None or (units and units[k] not in ("", "s", "-")):
            continue
        once(f"{path}: {name} counts seconds from {rows[0][k].strip()}")
        for row, cell in zip(rows, counted, strict=True):
            row[k] = cell


def _text(path: Path) -> str:
    data: bytes | None
    try:
        data = contents(path, MOST_BYTES)
        if data.startswith(_GZIP):
            with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
                data = bounded(file, MOST_UNPACKED)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(f"{path}: is not a complete gzip file ({error}); pack it again") from None
    except (OSError, ValueError) as error:  # ValueError: the path holds characters that no path may have
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read ({why}); check the path") from None
    if data is None:
        raise InputError(f"{path}: unpacks to more than {MOST_UNPACKED} bytes; unpack it, or cut the recording")
    wish = "save it as UTF-8 CSV"
    if data.startswith(_ZIP):
        raise InputError(f"{path}: is a zip archive, as a spreadsheet of Excel is; {wish}")
    if data[:2] in _MARKS and data[2:4] != b"\0\0":
        try:
            return data.decode("utf-16")
        except UnicodeDecodeError:
            raise InputError(f"{path}: is not a CSV text file in UTF-16; {wish}") from None
    if (at := data.find(b"\0")) >= 0:
        raise InputError(f"{path}: is not a CSV text file (byte {at} is 0); {wish}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if (text := _western(data)) is not None:
            once(f"{path}: is not UTF-8, so it is read as Windows-1252; save it as UTF-8 if a name is wrong")
            return text
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}: is not a CSV text file in UTF-8 (row {line}); {wish}") from None


def _western(data: bytes) -> str | None:
    """The text of bytes that are no UTF-8 and in Windows-1252 German, French or signs of units; None for others."""
    try:
        data.decode("utf-8-sig")
    except UnicodeDecodeError:
        other = set(data) - set(range(128))
        return data.decode("cp1252") if other <= WESTERN else None
    return None


@dataclass(frozen=True)
class Rows:
    """lines: on which each row ends. rows: cells of each that is not blank. text: from the names on.

    above: lines above the names that say something.
    """

    lines: list[int]
    rows: list[list[str]]
    separator: str
    text: str
    above: int = 0


def _rows(path: Path, text: str) -> Rows:
    """The rows of a table from its names on, which stand in the first of its lines, or where `layout` finds them."""
    begun = layout(text) if re.match(r"\s*(\"?sep=|[#%])", text, re.I) else None
    if begun is None:
        try:
            found = _split(path, text, 0, "")
        except InputError:
            if (begun := layout(text)) is None:
                raise
        else:
            plain = len(found.rows) < 2 or all(NUMBER.fullmatch(cell) for cell in found.rows[1])
            if plain or (begun := layout(text)) is None:
                return _cut(found)
    return _cut(_split(path, begun.text, begun.above, begun.separator, begun.said))


def _cut(found: Rows) -> Rows:
    """Without a last column that has no name and no cell, as a separator at the end of each line makes it."""
    rows = found.rows
    width = len(rows[0])
    last = 0 if rows[0][-1].strip() else 1
    if len(rows) > 1 and all(len(r) == width + 1 - last and not r[-1].strip() for r in rows[1:]):
        return replace(found, rows=[rows[0][: width - last], *(row[:-1] for row in rows[1:])], text="")
    return found


def _split(path: Path, text: str, above: int, separator: str, said: bool = False) -> Rows:
    """The rows of a text. above: lines above it. separator: of its columns, where that is known."""
    line = re.match(r"\s*([^\r\n]*)", text)
    first = line[1] if line else ""
    outside = re.sub(r'"[^"]*"', "", first)
    found = [separator] if separator else [s for s in ",;" if s in outside] or ["\t"]
    if len(found) > 1:
        raise InputError(f"{path}: commas and semicolons separate the header; use one of them in the whole file")
    reader = csv.reader(
        io.StringIO(text, newline=""), delimiter="\t" if found[0] == BLANKS else found[0], strict=found[0] != BLANKS
    )
    try:
        rows = [(reader.line_num + above, row) for row in reader if len(row) > 1 or (row and row[0].strip())]
    except csv.Error as error:
        raise InputError(
            f"{path}: is not a CSV text file (row {reader.line_num + above}: {error}); correct that row"
        ) from None
    if found[0] == BLANKS:
        rows = [(line_, [cell for part in row for cell in part.split()]) for line_, row in rows]
    if not rows:
        raise InputError(f"{path}: the file is empty; give a header row and samples")
    if len(rows[0][1]) < 2:
        raise InputError(
            f"{path}: the header has one column; begin with a row of names, a time and at least one channel, "
            "separated by commas"
        )
    return Rows([line for line, _ in rows], [row for _, row in rows], found[0], text, above if said else 0)


def _header(path: Path, names: list[str]) -> list[str]:
    known = set()
    for i, name in enumerate(names):
        if not name:
            raise InputError(f"{path}: column {i + 1} has no name; name it, or delete the surplus separator")
        if not name.isprintable():
            raise InputError(f"{path}: the name of column {i + 1}, {_quoted(name)}, does not print; rename it")
        if name in known:
            raise InputError(f"{path}: column {name} appears twice; rename or delete one of them")
        known.add(name)
    return names


def _is_plain(text: str, separator: str) -> bool:
    """Whether the rows hold only decimal numbers, signs and separators: no quotes, no second separator, no letters."""
    _, *body = re.split(r"[\r\n]", text.lstrip(), maxsplit=1)
    return bool(text) and not "".join(body).encode().translate(None, _PLAIN + separator.encode())


def _numbers(
    path: Path, header: list[str], rows: list[list[str]], lines: list[int], plain: bool, nan: bool
) -> tuple[list[list[str]], np.ndarray]:
    """(cells, values)."""
    if plain:  # then Python's own conversion of text to numbers accepts the same as `NUMBER`, and is much faster
        try:
            values = np.array(rows, dtype=np.float64).reshape(len(rows), len(header))
        except ValueError:
            plain = False
    if not plain:
        rows = [[cell.strip(" \t") for cell in row] for row in rows]
        if _proves_decimal_commas(rows):
            rows = [[_pointed(cell) for cell in row] for row in rows]
        values = np.array([[_number(cell, nan) for cell in row] for row in rows]).reshape(len(rows), len(header))
    with np.errstate(invalid="ignore"):
        bad = np.argwhere(~((np.abs(values) <= LARGEST) | (nan & np.isnan(values))))
    if bad.size:
        row, column = bad[0]
        what, wish = _problem(rows[row], column)
        raise InputError(
            f"{path}: row {lines[row]}, column {header[column]}: {_quoted(rows[row][column])} {what}; {wish}"
        )
    return rows, values


def _proves_decimal_commas(rows: list[list[str]]) -> bool:
    """Whether commas stand for decimal points: no cell has a point, and one comma cannot separate thousands."""
    marked = [cell for row in rows for cell in row if "," in cell or "." in cell]
    return all(map(DECIMAL_COMMA.fullmatch, marked)) and not all(map(_THOUSANDS.fullmatch, marked))


def _pointed(cell: str) -> str:
    return cell.replace(",", ".")


def _number(cell: str, nan: bool) -> float:
    """The number in the cell; inf, which no cell may hold, if there is none."""
    return float(cell) if NUMBER.fullmatch(cell) or (nan and cell == "nan") else np.inf


def _problem(row: list[str], column: int) -> tuple[str, str]:
    """(what is wrong with the cell, what to do)."""
    cell = row[column]
    if NUMBER.fullmatch(cell):
        return "is beyond any quantity", f"give numbers up to {LARGEST:g}, or repair the recording"
    if not cell:
        return "is an empty cell", "fill it, or cut the recording"
    if not any(map(NUMBER.fullmatch, row)) and not any("," in c for c in row):
        return "is not a finite number", "keep one header with the units in its names, and delete this row"
    if "," in cell:
        return "is not a finite number", "write decimal points, and no separators of thousands"
    if any(separator in cell for separator in ";\t"):
        return "is not a finite number", "separate every row as the header is separated"
    if cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return "is not a finite number", "repair or cut the recording"
    return "is not a finite number", "write plain digits with a decimal point, or repair or cut the recording"


def _quoted(text: str) -> str:
    return repr(text if len(text) <= SHOWN else text[:SHOWN] + "...")
