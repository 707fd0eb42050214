"""What the JSON files of a build say: every entry is of the kind that it must be, or the file is refused.

A build may come from anywhere. Here its entries are checked, and nowhere else: none of them becomes a path but the
recordings, which are read as CSV, and the architectures, which are of a list.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path

from greygate.contents import contents
from greygate.errors import InputError

ARCHITECTURES = ("parallel", "folded")
FACTS = "compile.json"
MACS = range(1, 257)  # multipliers of the folded architecture
NUMBER, COUNT = "a finite number", "a whole number from 0 on"
PASS = {"name": str, "layers": COUNT, "parameters": COUNT, "multiplications": COUNT, "change": NUMBER, "remarks": [str]}
SHAPES = {  # of each file: a type, a list of one shape, {str: one shape}, {name: its shape}, or a tuple of choices
    FACTS: {
        "source": str,
        "recordings": {str: str},
        "title": str,
        "architectures": [ARCHITECTURES],
        "macs": MACS,
        "finer": range(33),
        "passes": [PASS],
        "pruning": list,
    },
    "verify.json": {
        str: {
            "clocks_per_step": (NUMBER, None),
            "seed": COUNT,
            "scenarios": {str: {"steps": COUNT, "differing_bits": (0, None), "mismatch": (str, None)}},
        }
    },
    "resources.json": {str: {str: (NUMBER, None)}},
}


def read_facts(folder: Path) -> dict:
    """compile.json of a build. Raises InputError where there is none, or it is not as `compile` writes it."""
    facts = _read(folder / FACTS, "compile")
    if facts is None:
        raise InputError(f"{folder}: no {FACTS} here; run greygate compile first")
    if not facts["architectures"] or len(set(facts["architectures"])) < len(facts["architectures"]):
        raise InputError(f"{folder / FACTS}: architectures: name one or both, each once; run greygate compile again")
    return facts


def read_hardware(folder: Path) -> dict | None:
    """verify.json of a build, or None. Raises InputError where it is not as `verify` writes it."""
    return _read(folder / "verify.json", "verify")


def read_resources(folder: Path) -> dict | None:
    """resources.json of a build, or None. Raises InputError where it is not as `synthesize` writes it."""
    return _read(folder / "resources.json", "synthesize")


def _read(path: Path, command: str) -> dict | None:
    try:
        found = json.loads(contents(path))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not readable ({error}); run greygate {command} again") from None
    if problem := misfit(found, SHAPES[path.name]):
        raise InputError(f"{path}: {problem}; run greygate {command} again")
    return found


def misfit(value: object, shape: object, name: str = "the file") -> str | None:
    """What in a value from JSON is not of its shape (see SHAPES), with its name; None where all is."""
    if isinstance(shape, tuple):
        fits = any(misfit(value, choice) is None for choice in shape)
        return None if fits else f"{name} is {_shown(value)}; it is one of {', '.join(map(_called, shape))}"
    if isinstance(shape, list) and isinstance(value, list):
        return _first(misfit(v, shape[0], f"{name}, {k + 1}") for k, v in enumerate(value))
    if isinstance(shape, Mapping) and isinstance(value, dict):
        if str in shape:
            return _first(misfit(v, shape[str], f"{name}, {_shown(k)}") for k, v in value.items())
        if odd := set(shape) ^ set(value):
            return f"{name} holds {_shown(min(odd))} that it should not, or lacks it"
        return _first(misfit(v, shape[k], k) for k, v in value.items())
    whole, number = type(value) is int, type(value) in (int, float)
    if shape is COUNT:
        fits = whole and value >= 0
    elif shape is NUMBER:
        fits = number and -math.inf < value < math.inf
    elif isinstance(shape, type):
        fits = type(value) is shape
    else:
        fits = (whole and value in shape) if isinstance(shape, range) else type(value) is type(shape) and value == shape
    return None if fits else f"{name} is {_shown(value)}; it is {_called(shape)}"


def _first(problems) -> str | None:
    return next((problem for problem in problems if problem), None)


def _called(shape: object) -> str:
    if isinstance(shape, range):
        return f"{shape.start} to {shape.stop - 1}"
    names = {str: "text", list: "a list", None: "null"}
    kinds = {list: "a list", dict: "a table"}
    return names.get(shape) if shape in (str, list, None) else kinds.get(type(shape)) or str(shape)


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
