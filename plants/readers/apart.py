"""The other process for recordings (`greygate.foreign`): each reader gives columns as dictionaries.

header, values, and where the format has them: unit, time (own times, s) and time_unit; or left: what it is instead.
"""

import re
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.foreign.child import Read, Room, served
from greygate.foreign.hdf5 import Contents, h5py_module
from greygate.foreign.mat import mat
from greygate.plants.readers import arrow, labview, mdf, messages

MISSING = {  # type -> what netCDF fills in for a number that was never written; a byte has none
    "f4": 9.969209968386869e36, "f8": 9.969209968386869e36, "i2": -32767, "u2": 65535, "i4": -2147483647,
    "u4": 4294967295, "i8": -9223372036854775806, "u8": 18446744073709551614,
}  # fmt: skip
NPY = re.compile(r"\{'descr': '([<>|=][fiub]\d+)', 'fortran_order': (?:True|False), 'shape': \(([\d, ]*)\),? ?\}")
DEEP = 20  # groups in one another


def hdf5() -> Read:
    """What reads HDF5 and netCDF: vectors, in groups too, with the attributes of CF (cfconventions.org)."""
    h5py = h5py_module()

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        with h5py.File(path, "r") as file:
            inside = Contents(file, room)
            for name, item in inside.items(file):
                yield from _tree(inside, name, item, 0)

    return read


def _tree(inside: Contents, name: str, item: Any, depth: int) -> Iterator[tuple[str, Any]]:
    """The vectors of a group or a dataset, and `NAME@unit` beside each."""
    if isinstance(item, inside.h5py.Group):
        if depth < DEEP:
            yield name, dict(pair for k, v in inside.items(item) for pair in _tree(inside, k, v, depth + 1))
        return
    if item.shape is None or item.size < 2:
        return
    if item.dtype.kind not in "fiubc" or item.size != max(item.shape):
        yield f"{name}@left", " x ".join(map(str, item.shape)) if item.dtype.kind in "fiubc" else "no numbers"
        return
    if inside.h5py.check_enum_dtype(item.dtype) is not None:
        return
    yield name, _physical(inside, np.asarray(inside.values(item, name)).reshape(-1), item, name)
    unit = inside.attribute(item, "unit") or inside.attribute(item, "units")
    if isinstance(unit, str):
        yield f"{name}@unit", unit.partition(" since ")[0]


def _physical(inside: Contents, values: np.ndarray, item: Any, name: str) -> np.ndarray:
    """Stored values as the attributes of CF say: missing ones are nan, others scaled."""
    told = {
        key: inside.attribute(item, key)
        for key in ("scale_factor", "add_offset", "_FillValue", "missing_value", "valid_min", "valid_max")
    }
    if inside.attribute(item, "_Unsigned") == "true" and values.dtype.kind == "i":
        values = values.view(values.dtype.str.replace("i", "u"))
    for key, value in told.items():
        if isinstance(value, str) or (key in item.attrs and value is None):
            raise InputError(f"{shown(name)}: its {key} is no number; save the values themselves")
    bad = np.zeros(len(values), bool)
    fill = MISSING.get(item.dtype.str[1:])
    if fill is not None and item.fillvalue == np.array(fill).astype(item.dtype):
        bad |= values == item.fillvalue.astype(values.dtype)
    if "valid_range" in item.attrs:
        if (span := inside.attribute(item, "valid_range", 2)) is None:
            raise InputError(f"{shown(name)}: its valid_range is no pair of numbers; save the values themselves")
        bad |= (values < span[0]) | (values > span[1])
    for key in ("_FillValue", "missing_value"):
        if told[key] is not None:
            bad |= values == np.asarray(told[key]).astype(values.dtype)
    if told["valid_min"] is not None:
        bad |= values < told["valid_min"]
    if told["valid_max"] is not None:
        bad |= values > told["valid_max"]
    if told["scale_factor"] is not None or told["add_offset"] is not None:
        scale, offset = (
            float(told[k]) if told[k] is not None else usual for k, usual in (("scale_factor", 1), ("add_offset", 0))
        )
        values = values * scale + offset
    return np.where(bad, np.nan, values) if bad.any() else values


def npz() -> Read:
    """What reads the arrays of numbers that `numpy.savez` wrote; numpy's own reader would have to compile a header."""
    "".encode("cp437")  # of the names in an archive: loaded before no other file may be opened

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        with path.open("rb") as raw, zipfile.ZipFile(raw) as file:
            for info in file.infolist():
                room.take(info.file_size // 8, info.filename)
                data = file.read(info)
                name, values = info.filename.removesuffix(".npy"), _array(data)
                yield (name, values) if values is not None else (f"{name}@left", "no numbers")

    return read


def _array(data: bytes) -> np.ndarray | None:
    """The array of a .npy file (numpy.org/doc/stable/reference/generated/numpy.lib.format.html); None of no numbers."""
    wide = data[6:7] > b"\x01"
    size = int.from_bytes(data[8 : 12 if wide else 10], "little")
    start = (12 if wide else 10) + size
    told = NPY.fullmatch(data[start - size : start].decode("latin-1").strip())
    if told is None:
        return None
    shape = tuple(int(n) for n in told[2].replace(" ", "").split(",") if n)
    return np.frombuffer(data, told[1], offset=start).reshape(shape)  # in any order: a matrix is left out


READERS: dict[str, Callable[[], Read]] = {
    "mat": mat,
    "npz": npz,
    "hdf5": hdf5,
    "mdf": mdf.mdf,
    "parquet": arrow.parquet,
    "tdms": labview.tdms,
    "mcap": messages.mcap,
}

if __name__ == "__main__":
    sys.exit(served(READERS, *sys.argv[1:]))
