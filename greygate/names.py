"""Checks names, units, lines of text and file names that a user or a file gives.

Each `check_` takes the value and the place where it stands, and returns the value, or raises InputError in one line.
Code that writes a name (into Verilog, a path, a page) escapes it once more.
"""

import re
import unicodedata
from pathlib import Path
from typing import TypeGuard

from greygate.errors import InputError, shown

LONGEST_NAME = 100  # characters: a program's name and a signal's name together still fit into a file name
LONGEST_UNIT = 40  # characters
LONGEST_TEXT = 500  # characters of a note, a title or a scenario
LONGEST_FILE = 238  # characters: file systems take 255, of which `..greygate-commit` (files.py) takes 17

KEYWORDS = frozenset(Path(__file__).with_name("keywords.txt").read_text(encoding="utf-8").split())
"""Of Verilog-2005, and those of SystemVerilog that tools trip over."""
CORE_PORTS = (
    "clk",
    "rst",
    "s_axis_tdata",
    "s_axis_tvalid",
    "s_axis_tready",
    "m_axis_tdata",
    "m_axis_tvalid",
    "m_axis_tready",
)
CORE_NAMES = (
    *CORE_PORTS,
    "DEPTH",
    "en",
    "skid",
    "stream",
    "sample",
    "start",
    "done",
    "ready",
    "result",
    "stage",
    "unused",
)
"""What the core of every design has already: no signal is called so."""

PART = r"[A-Za-z_][A-Za-z0-9_]*"

_PART = re.compile(PART)
_FILE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_RESERVED = re.compile(
    r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE
)  # Windows reserves these, with any suffix
_SIGNS = frozenset(" ^*/()+-−⁺⁻.,·⋅×%‰°'′″_")  # in a unit, beside letters and digits
_RIGHT_TO_LEFT = ("R", "AL", "AN")  # letters and digits that change the order in which the following text is shown


def check_name(value: object, where: str) -> str:
    """The name of a network or a program, which its files have too: letters a to z, digits and _."""
    if not (_short(value, LONGEST_NAME) and _PART.fullmatch(value)):
        raise InputError(
            f"{where} {shown(value)}: a name has letters a to z, digits and _, no digit first, at most {LONGEST_NAME} "
            "of them; rename it"
        )
    return check_file_name(value, where)


def check_path(value: object, where: str) -> str:
    """A port's, module's, signal's or table's name: as `check_name`, or several such joined by dots."""
    if not (_short(value, LONGEST_NAME) and all(map(_PART.fullmatch, value.split(".")))):
        raise InputError(
            f"{where} {shown(value)}: a name has letters a to z, digits and _, no digit first, or several such words "
            f"with a dot between, at most {LONGEST_NAME} characters; rename it"
        )
    return value


def check_unit(value: object, where: str) -> str:
    """A unit such as m/s^2, N m, 1, °C, µm or %; 1 for none."""
    if not (_short(value, LONGEST_UNIT) and value == value.strip() and all(map(_in_unit, value))):
        raise InputError(
            f"{where} {shown(value)}: a unit has letters, digits and signs such as ^ * / ( ) %, at most {LONGEST_UNIT} "
            "of them; write 1 for none"
        )
    return value


def check_text(value: object, where: str) -> str:
    """One line that people read, such as the name of a scenario: visible characters and spaces."""
    if not (_short(value, LONGEST_TEXT) and value.isprintable()):
        raise InputError(
            f"{where} {shown(value)}: a text is one line of visible characters, at most {LONGEST_TEXT}; correct it"
        )
    return value


def check_file_name(value: object, where: str) -> str:
    """The name of a file or folder, without a path; it is checked wherever a name is joined to a path."""
    if (
        not (_short(value, LONGEST_FILE) and _FILE.fullmatch(value))
        or value.endswith(".")
        or _RESERVED.fullmatch(value)
    ):
        raise InputError(
            f"{where} {shown(value)}: not a file name on every system (letters a to z, digits, _ - and dots, no "
            "folder); rename it"
        )
    return value


def _short(value: object, longest: int) -> TypeGuard[str]:
    return isinstance(value, str) and 0 < len(value) <= longest


def _in_unit(c: str) -> bool:
    letter = unicodedata.category(c)[0] in "LN" and unicodedata.bidirectional(c) not in _RIGHT_TO_LEFT
    return letter or c in _SIGNS
