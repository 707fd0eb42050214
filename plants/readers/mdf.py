"""The other process for MDF 3 and 4: raw samples, whose conversions are computed here.

asammdf hands formulas to numexpr and sympy, which run any Python that they hold; neither exists in this process.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from greygate.errors import InputError, brought_by, shown
from greygate.foreign.child import Read, Room
from greygate.plants.expressions import parse

NUMBERS = {3: {0, 1, 2, 3, *range(9, 17)}, 4: set(range(6))}  # major version -> types of data
COMPLEX = {15, 16}  # of version 4
TIME = 1  # what a master counts, of version 4
ALL_INVALID, SOME_INVALID = 1, 2  # flags of version 4
MASTERS = {0: "nothing", 2: "an angle", 3: "a distance", 4: "an index"}
KINDS = {  # major version -> number of a conversion -> what it does
    3: {0: "linear", 1: "interpolated", 2: "table", 6: "polynomial", 7: "exp", 8: "log", 9: "rational", 10: "formula",
        11: "text", 12: "text", 65535: "none"},
    4: {0: "none", 1: "linear", 2: "rational", 3: "formula", 4: "interpolated", 5: "table", 6: "ranges",
        7: "text", 8: "text", 9: "text", 10: "text", 11: "text"},
}  # fmt: skip


def mdf() -> Read:
    """What reads an MDF file: channels with numbers, their units and their own times."""
    MDF = _asammdf()

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        options = {"process_bus_logging": False, "use_display_names": False}
        with MDF(path, **options) as file:
            major = 4 if file.version >= "4" else 3
            kept = [_unconverted(group) for group in file.groups]
            taken: dict[str, int] = {}
            for number in file.virtual_groups:
                yield from _group(file, number, major, kept, taken, room)

    return read


def _asammdf() -> Any:
    """asammdf's reader, without what evaluates text."""

    def refused(*_: Any, **__: Any) -> None:
        raise InputError("asks for a formula to be run; save its channels converted")

    numexpr = ModuleType("numexpr")
    numexpr.__dict__.update(evaluate=refused, __version__="0")
    sys.modules.update({"numexpr": numexpr, "sympy": None})  # type: ignore[dict-item]
    with brought_by("mdf", "asammdf", "pandas"):
        import pandas  # noqa: F401  asammdf imports it late
        from asammdf import MDF
    return MDF


def _unconverted(group: Any) -> list[Any]:
    """The conversions of a group's channels, which have none any more, and no attachment either."""
    found = [channel.conversion for channel in group.channels]
    for channel in group.channels:
        channel.conversion = None
        if hasattr(channel, "attachment"):
            channel.attachment = None
    return found


def _group(
    file: Any, number: int, major: int, kept: list[list[Any]], taken: dict[str, int], room: Room
) -> Iterator[tuple[str, Any]]:
    """The channels that share a master. taken: name -> how often it was given."""
    wanted = [
        (group, k)
        for group, channels in file.included_channels(number)[number].items()
        for k in channels
        if _numeric(file.groups[group], k, major)
    ]
    if not wanted:
        return
    master = file.masters_db.get(number)
    clock = file.groups[number].channels[master] if master is not None else None
    if clock is not None and major == 4 and clock.sync_type != TIME:
        counts = MASTERS.get(clock.sync_type, "something else")
        raise InputError(f"{shown(clock.name)}: the channels beside it are over {counts}, not time; leave them out")
    if clock is not None and major == 4 and clock.flags & ALL_INVALID:
        raise InputError(f"{shown(clock.name)}: is a time that is flagged invalid; leave out the channels beside it")
    for group, k in wanted:
        room.take(file.groups[group].channel_group.cycles_nr, file.groups[group].channels[k].name)
    signals = file.select([(None, group, k) for group, k in wanted], raw=True)
    time = None
    while signals:
        (group, k), signal = wanted[len(wanted) - len(signals)], signals.pop(0)
        channel, conversion = file.groups[group].channels[k], kept[group][k]
        if len(signal.samples) < 2 or signal.samples.ndim != 1 or signal.samples.dtype.kind not in "fiub":
            continue
        values = _converted(signal.samples, conversion, channel.name, major)
        if values is None:
            continue
        found: dict[str, Any] = {"header": _once(channel.name, taken), "unit": _unit(conversion, channel)}
        if clock is not None:
            if time is None:
                time = _converted(signal.timestamps, kept[number][master], clock.name, major)
                if time is None:
                    raise InputError(f"{shown(clock.name)}: is a time in words; save it as numbers")
            found |= {"time": time, "time_unit": _unit(kept[number][master], clock)}
        flags = channel.flags if major == 4 else 0
        if flags & ALL_INVALID:
            continue
        if flags & SOME_INVALID and signal.invalidation_bits is not None:
            valid = ~np.asarray(signal.invalidation_bits, bool)
            if valid.sum() < 2:
                continue
            values = values[valid]
            found |= {"time": time[valid]} if time is not None else {}
        yield found["header"], found | {"values": values}


def _numeric(group: Any, k: int, major: int) -> bool:
    """Whether a channel holds one number a sample."""
    channel = group.channels[k]
    if major == 4 and channel.data_type in COMPLEX:
        raise InputError(f"{shown(channel.name)}: holds complex numbers; save real and imaginary part by themselves")
    return channel.data_type in NUMBERS[major] and not group.channel_dependencies[k]


def _unit(conversion: Any, channel: Any) -> str:
    return str(getattr(conversion, "unit", "") or getattr(channel, "unit", "") or "")


def _once(name: str, taken: dict[str, int]) -> str:
    """The name, or `name_2`, `name_3`, ... where it was given before."""
    given = name
    while given in taken:
        taken[name] += 1
        given = f"{name}_{taken[name]}"
    taken[given] = 1
    return given


# -- conversions -----------------------------------------------------------------------------------------------------


def _converted(x: np.ndarray, conversion: Any, name: str, major: int) -> np.ndarray | None:
    """Raw samples as numbers with a unit; None where they stand for texts. Raises InputError for a kind not known."""
    kind = KINDS[major].get(conversion.conversion_type) if conversion is not None else "none"
    if conversion is None or kind == "none":
        return x
    if kind == "text":
        return None
    if kind == "formula":
        return _formula(x, conversion.formula, name)
    if kind == "linear":
        a, b = conversion["a"], conversion["b"]
        return x if (a, b) == (1, 0) else x * a + b if b else x * a
    if kind is None:
        raise InputError(f"{shown(name)}: has a conversion that is not known; save it converted")
    whole, x = x.dtype.kind != "f", x.astype(float)
    with np.errstate(all="ignore"):
        if kind in ("interpolated", "table", "ranges"):
            return _looked_up(x, conversion, kind, name, major, whole)
        p = [0.0, *(float(conversion[f"P{k}"]) for k in range(1, 8 if kind in ("exp", "log") else 7))]
        if kind == "rational":
            if p[1] == p[3] == p[4] == p[5] == 0:
                return x * (p[2] / p[6]) if p[2] != p[6] else x
            if p[2] == p[3] == p[4] == p[6] == 0:
                return x * (p[1] / p[5]) if p[1] != p[5] else x
            return (p[1] * x**2 + p[2] * x + p[3]) / (p[4] * x**2 + p[5] * x + p[6])
        if kind == "polynomial":
            return (p[2] - p[4] * (x - p[5] - p[6])) / (p[3] * (x - p[5] - p[6]) - p[1])
        function = np.exp if kind == "exp" else np.log
        if p[4] == 0:
            return function(((x - p[7]) * p[6] - p[3]) / p[1]) / p[2]
        if p[1] == 0:
            return function((p[3] / (x - p[7]) - p[6]) / p[4]) / p[5]
    raise InputError(f"{shown(name)}: has a conversion that is not defined; save it converted")


def _looked_up(x: np.ndarray, conversion: Any, kind: str, name: str, major: int, whole: bool) -> np.ndarray:
    """A value from a table of values, or of ranges, whose ends belong to them for whole numbers."""
    told = conversion.__getitem__
    keys = ("lower", "upper", "phys") if kind == "ranges" else ("raw", "phys")
    count = conversion.ref_param_nr if major == 3 else conversion.val_param_nr // len(keys)
    columns = [np.array([float(told(f"{key}_{k}")) for k in range(count)]) for key in keys]
    first, last = columns[0], columns[-1]
    if not count or (np.diff(first) <= 0).any():
        raise InputError(f"{shown(name)}: the table of its conversion does not ascend; save it converted")
    if kind == "interpolated":
        return np.interp(x, first, last)
    if kind == "table":  # the nearest; of two as near, the lower
        above = np.clip(np.searchsorted(first, x), 0, count - 1)
        below = np.maximum(above - 1, 0)
        return np.where(np.abs(x - first[above]) >= np.abs(x - first[below]), last[below], last[above])
    at = np.searchsorted(first, x, side="right") - 1
    inside = (at >= 0) & (x <= columns[1][at] if whole else x < columns[1][at])
    return np.where(inside, last[at], float(told("default")))


def _formula(x: np.ndarray, text: str, name: str) -> np.ndarray:
    """What a formula of X or X1 makes of the samples; it is parsed as any other expression here."""
    try:
        tree = parse(re.sub(r"\bln\s*\(", "log(", text.lower()))  # asammdf writes every x as X
        if not {*tree.names} <= {"x", "x1"}:
            raise InputError("it has other variables than X")
        if re.search(r"\blog\s*\(", text.lower()):
            raise InputError("log is to the base e or 10")
    except InputError as error:
        raise InputError(
            f"{shown(name)}: its conversion is a formula that is not read ({error}); save it converted"
        ) from None
    values = np.asarray(tree.over({"x": x.astype(float), "x1": x.astype(float)}), float)
    return np.broadcast_to(values, x.shape)
