"""The places in which a plant may lack an unnamed term, and the functions from which such a term is made.

They are declared in `[closure]` of a plant's file (docs/plants.md). mismatch/closure.py uses them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from greygate.errors import InputError, shown
from greygate.plants.expressions import check_expression, check_name, check_symbol, replaced
from greygate.reading import entry_of, listed, named, table, within

SEEN = ("seen_low_", "seen_high_")  # prefixes of a signal: its smallest and largest value along the recording
MOST = 100  # largest `k` of a library

Library = dict[str, str]
"""Name -> expression of unit size. Two libraries are joined as dictionaries are, by `|`; the order of declaration is
the order in which functions of equal worth are preferred."""


@dataclass(frozen=True)
class Place:
    """An equation or a definition in which a term may be missing.

    libraries: names of the libraries to try there. term: the expression with which a function `f` enters there.
    typical: size of a coefficient. reported: the place that a diagnosis names instead of this one.
    """

    libraries: tuple[str, ...]
    term: str = "f"
    typical: float = 1.0
    reported: str = ""


@dataclass(frozen=True)
class Closure:
    """The closure of a plant.

    signals: name in a library -> expression for which it stands. places: by the name of the equation or definition.
    """

    signals: Mapping[str, str] = field(default_factory=dict)
    libraries: Mapping[str, Library] = field(default_factory=dict)
    places: Mapping[str, Place] = field(default_factory=dict)


def check_closure(value: object, where: str) -> Closure:
    """A kind (`greygate.reading`): `[closure]` of a plant's file."""
    entries = {
        "signals": named(check_expression, check_symbol),
        "libraries": named(check_library, check_name),
        "places": named(_place, check_name),
    }
    return Closure(**table(value, where, {}, entries))


def check_library(value: object, where: str) -> Library:
    """A kind: `name = "expression"`, ...; with `k = [first, last]` one set for each k, whose names end in k.

    k goes from first to last in steps of 1: `k = [1, 3]`, `sin = "sin(k * x)"` makes sin1, sin2, sin3.
    """
    found = named(check_expression, check_name)
    if not (isinstance(value, dict) and "k" in value):
        return found(value, where)
    functions = found({name: text for name, text in value.items() if name != "k"}, where)
    return {
        f"{name}{int(k)}": replaced(text, {"k": repr(k)})
        for k in _steps(value["k"], entry_of(where, "k"))
        for name, text in functions.items()
    }


def _steps(value: object, where: str) -> list[int | float]:
    ends = listed(within(0.0, MOST, f"give 0 to {MOST}"))(value, where)
    if len(ends) != 2 or ends[0] > ends[1]:
        raise InputError(f"{where} {shown(value)} is not a range; write [first, last]")
    first = int(ends[0]) if ends[0].is_integer() else ends[0]
    return [first + i for i in range(int(ends[1] - first) + 1)]


_PLACE = {
    "term": check_expression,
    "typical": within(np.nextafter(0.0, 1.0), np.inf, "give a size above 0"),
    "reported": check_name,
}


def _place(value: object, where: str) -> Place:
    found = table(value, where, {"libraries": listed(check_name)}, _PLACE)
    return Place(**found | {"libraries": tuple(found["libraries"])})
