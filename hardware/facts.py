"""Reads the JSON files of a build, and refuses a file in which an entry is not of its kind.

A build may come from anywhere, and its entries are checked only here. Only two become paths: the recordings, which are
read as CSV, and the architectures, which must be names of targets.
"""

import os
from pathlib import Path

from greygate.compiler.tables import Form
from greygate.compiler.targets import NAMES, Design
from greygate.emulator.fields import record
from greygate.errors import InputError
from greygate.limits import FINER
from greygate.names import check_path, check_text
from greygate.reading import Kind, anything, line, listed, maybe, named, number, one_of, read_json, table, whole

FACTS = "compile.json"
PASS = {
    "name": line,
    **dict.fromkeys(("layers", "parameters", "multiplications"), whole(0)),
    "change": number,
    "remarks": listed(line),
}
SCENARIO = {"steps": whole(0), "differing_bits": maybe(whole(0, 0)), "mismatch": maybe(line)}
ARCHITECTURE = {
    "clocks_per_step": maybe(number),
    "seed": whole(0),
    "scenarios": named(lambda value, where: table(value, where, SCENARIO), line),
}
POINT = {
    **dict.fromkeys(("error", "microseconds", "period_ns", "memories"), number),
    **dict.fromkeys(("luts", "dsps", "clocks", "width", "finer"), whole(0)),
    "architecture": one_of(NAMES),
    "design": record(Design),
    **dict.fromkeys(("table_budget", "price"), number),
    "tables": one_of(Form),
    "signals": named(line, check_path),
    "weights": named(whole(0), check_path),
}
EXPLORED = {
    **dict.fromkeys(("device", "family", "error_in"), line),
    "request": named(maybe(number), line),
    **dict.fromkeys(("programs", "points"), whole(0)),
    "front": listed(lambda value, where: table(value, where, POINT)),
    "chosen": maybe(lambda value, where: table(value, where, POINT)),
    "why": line,
}
FILES: dict[str, Kind] = {
    FACTS: lambda value, where: table(
        value,
        where,
        {
            "source": line,
            "recordings": named(line, check_text),
            "title": check_text,
            "architectures": listed(one_of(NAMES)),
            "design": record(Design),
            "finer": whole(0, FINER),
            "passes": listed(lambda value, where: table(value, where, PASS)),
            "pruning": listed(anything),
        },
        {"learnt": whole(1), "explored": lambda value, where: table(value, where, EXPLORED)},
    ),
    "verify.json": named(lambda value, where: table(value, where, ARCHITECTURE), line),
    "resources.json": named(named(maybe(number), line), line),
}


def read_facts(folder: Path) -> dict:
    """Read compile.json of a build. Raises InputError if it is missing, or not as `compile` writes it."""
    facts = _read(folder / FACTS, "compile")
    if facts is None:
        raise InputError(f"{folder}: no {FACTS} here; run greygate compile first")
    if not facts["architectures"] or len(set(facts["architectures"])) < len(facts["architectures"]):
        raise InputError(f"{folder / FACTS}: architectures: name at least one, each once; run greygate compile again")
    return facts


def read_hardware(folder: Path) -> dict | None:
    """Read verify.json of a build, or return None. Raises InputError if it is not as `verify` writes it."""
    return _read(folder / "verify.json", "verify")


def read_resources(folder: Path) -> dict | None:
    """Read resources.json of a build, or return None. Raises InputError if it is not as `synthesize` writes it."""
    return _read(folder / "resources.json", "synthesize")


def _read(path: Path, command: str) -> dict | None:
    again = f"run greygate {command} again"
    if not os.path.exists(path):
        return None
    found = read_json(path, again)
    try:
        FILES[path.name](found, f"{path}:")
    except InputError as error:
        raise InputError(f"{error}; or {again}") from None
    return found
