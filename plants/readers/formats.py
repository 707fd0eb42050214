"""The formats of recordings: what reads a file, by the ending of its name; every reader gives columns."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError
from greygate.foreign import apart
from greygate.plants.readers.columns import Column
from greygate.plants.readers.units import converted

CLOCKS = {"t", "time", "t_s", "time_s"}  # channels that repeat the times of others
APART = "greygate.plants.readers.apart"  # the module that the other process runs


def _vectors(path: Path, kind: str) -> list[Column]:
    """Vectors of MATLAB or HDF5, in groups or structs too; one struct alone stands for its fields.

    `units` may be a struct: name -> unit; of HDF5 the attribute `unit` or `units` counts.
    """
    return _tree(apart(path, kind, APART), path)


def _tree(found: Mapping[str, Any], path: Path) -> list[Column]:
    vectors = {k: v for k, v in found.items() if isinstance(v, np.ndarray) and v.dtype != object}
    structs = [v for k, v in found.items() if isinstance(v, Mapping) and k != "units"]
    if not vectors and len(structs) == 1:
        return _tree({**{k: v for k, v in found.items() if k == "units"}, **structs[0]}, path)
    units = found.get("units")
    units = units if isinstance(units, Mapping) else {}
    columns = [
        Column(name, v.ravel(), _text(found.get(f"{name}@unit", units.get(name))))
        for name, v in vectors.items()
        if v.size > 1 and v.size == max(v.shape)
    ]
    if not columns:
        raise InputError(f"{path}: holds no vectors; save each channel, and the time t, as a vector")
    return columns


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value.strip() else None


def _columns(path: Path, kind: str) -> list[Column]:
    """Channels with their units and their own times, as the other formats have them."""
    found = []
    for told in apart(path, kind, APART).values():
        time, unit = told.get("time"), told.get("time_unit") or "s"
        if time is not None and unit != "s":
            time, _ = converted(time.astype(float), unit, f"{path}: time of {told['header']}", "s")
        found.append(Column(told["header"], told["values"], _text(told["unit"]), time))
    return _one_clock(found)


def _one_clock(found: list[Column]) -> list[Column]:
    """Without a channel that merely repeats the own time of the others. T is a temperature or a torque."""
    if all(c.time is None for c in found):
        return found
    return [c for c in found if c.header == "T" or c.header.lower() not in CLOCKS or not _rises(c.values)] or found


def _rises(values: np.ndarray) -> bool:
    return bool((values[1:] > values[:-1]).all())


FORMATS = {
    ".mat": "mat",
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), "hdf5"),
    ".parquet": "parquet",
    **dict.fromkeys((".mf4", ".mdf", ".dat"), "mdf"),
    ".tdms": "tdms",
    ".mcap": "mcap",
}
"""Ending of a file's name -> its format."""


def columns(path: Path) -> list[Column]:
    """The columns of a file. Raises InputError for a file that is none of its format."""
    kind = FORMATS[path.suffix.lower()]
    found = (_vectors if kind in ("mat", "hdf5") else _columns)(path, kind)
    if not found:
        raise InputError(f"{path}: holds no channel of numbers with two samples or more")
    return found
