"""One reader for every recording, `read_recording`: by the ending of a file's name, or from Python."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, shown
from greygate.foreign import apart
from greygate.plants.readers.columns import CLOCK_OF, Channel, Column, Told, channels, recording
from greygate.plants.recording import UNITS, Recording, read_csv
from greygate.plants.table import read_header, read_table, read_united
from greygate.plants.units.reading import SUFFIXES, converted
from greygate.progress import once
from greygate.reading import line, named, read_toml, table

FORMATS = {
    ".mat": "mat",
    ".npz": "npz",
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), "hdf5"),
    ".parquet": "parquet",
    **dict.fromkeys((".mf4", ".mdf", ".dat"), "mdf"),
    ".tdms": "tdms",
    ".mcap": "mcap",
}
"""Ending of a file's name -> its format."""
SIDECAR = ".units.toml"  # beside a recording: [units], and the name of the time
CLOCKS = {"t", "time", "t_s", "time_s"}  # channels that repeat the times of others
APART = "greygate.plants.readers.apart"  # the module that the other process runs
_STYLED = re.compile(r"[\[\](){}/:]| in |\S\s+\S")


def read_recording(
    source: Any,
    required: Mapping[str, str] | None = None,
    *,
    units: Mapping[str, str] | None = None,
    time: str | None = None,
    dt: float | None = None,
    resample: float | bool = False,
    bare: bool = False,
    told: Told | None = None,
) -> Recording:
    """Read a recording: a file by its ending, a frame of pandas or polars, or a dictionary of arrays.

    A header is `p_a_Pa`, `p_a [bar]`, `p_a (bar)`, `p_a / bar`; or a row of units follows; or NAME.units.toml beside
    the file says them. Units other than the house's are converted to SI.
    required: channel -> unit of those that must be there; they are converted to it. units: channel -> unit, which take
    precedence. time: the name of the time. dt: sample time in s, where there is no time. resample: True or a step in s.
    bare: a column without a unit is a plain number. told: gets a line for each conversion.
    Raises InputError for a format, a header, a unit or times that cannot be read in one way.

    >>> shaft = read_recording({"t": 1e-3 * np.arange(3), "n [rpm]": [0.0, 30.0, 60.0]})
    >>> shaft
    <Recording recording: n [rad/s]; 3 samples, one every 0.001 s>
    """
    path = Path(source) if isinstance(source, str | Path) else None
    if path is not None and not _styled(path, required or {}, units, time, resample):
        return read_csv(path, required, dt=dt, bare=bare)
    found = read_channels(source, required, units=units, time=time, dt=dt, unitless="1" if bare else None)
    name = str(path) if path is not None else "recording"
    for channel, unit in (required or {}).items():
        if channel not in {c.name for c in found}:
            raise InputError(
                f"{name}: channel {channel} [{unit}] is missing; it has {', '.join(c.name for c in found)}"
            )
    return recording(found, name, resample, told)


def is_recording(name: str) -> bool:
    """Whether a name is one of a recording's file, by its ending."""
    return name.removesuffix(".gz").endswith((".csv", *FORMATS))


def read_channels(
    source: Any,
    required: Mapping[str, str] | None = None,
    *,
    units: Mapping[str, str] | None = None,
    time: str | None = None,
    dt: float | None = None,
    unitless: str | None = None,
) -> list[Channel]:
    """The channels of a recording, each with its own times. unitless: the unit of a column that has none.

    Other arguments and errors: as of `read_recording`.
    """
    if not isinstance(source, str | Path):
        return channels(_of_python(source), "recording", units, required, dt, time, unitless)
    path = Path(source)
    beside, clock = _beside(path)
    columns = _of_format(path) if path.suffix.lower() in FORMATS else _of_csv(path)
    return channels(columns, str(path), {**beside, **(units or {})}, required, dt, time or clock, unitless)


def _styled(path: Path, required: Mapping[str, str], *asked: Any) -> bool:
    """Whether a file is anything but a CSV of the house's own form, in the units that are required."""
    if path.suffix.lower() in FORMATS or any(asked) or _sidecar(path).exists():
        return True
    header, second = read_header(path)
    if any(required.get(h) == "1" for h in header):
        return True
    if not header or header[0] not in ("t", "t_s", "k"):
        return any(_STYLED.search(h) for h in header) or (
            bool(header) and bool(header[0].lower() in ("time", "time_s") or CLOCK_OF.fullmatch(header[0]))
        )
    others = {} if header[0] == "k" else required
    return any(_STYLED.search(h) or _plain(h) or _other(h, others) for h in header) or second


def _plain(header: str) -> bool:
    """Whether a name ends in a unit that the house's own form has not."""
    parts = header.split("_")
    return any("_".join(parts[k:]) in SUFFIXES for k in range(1, len(parts)))


def _other(header: str, required: Mapping[str, str]) -> bool:
    """Whether a column's unit is another one than is required of it."""
    parts = header.split("_")
    found = ((required.get("_".join(parts[:k])), UNITS.get("_".join(parts[k:]))) for k in range(1, len(parts)))
    return any(wanted and unit and unit != wanted for wanted, unit in found)


def _of_csv(path: Path) -> list[Column]:
    _, second = read_header(path)
    found, units = read_united(path) if second else (read_table(path), None)
    return [
        Column(name, np.ascontiguousarray(found.values[:, k]), None if units is None else units[k])
        for k, name in enumerate(found.header)
    ]


def _sidecar(path: Path) -> Path:
    return path.parent / (path.name.removesuffix(".gz").rpartition(".")[0] + SIDECAR)


def _beside(path: Path) -> tuple[dict[str, str], str | None]:
    """(units, name of the time) of the file beside, if there is one."""
    place = _sidecar(path)
    if not place.exists():
        return {}, None
    told = table(read_toml(place, "name the units"), f"{place}:", {}, {"units": named(line, line), "time": line})
    return told.get("units", {}), told.get("time")


def _of_python(source: Any) -> list[Column]:
    """A mapping of names to arrays, or a frame with `columns`."""
    names = list(source) if isinstance(source, Mapping) else list(getattr(source, "columns", ()))
    if not names:
        raise InputError(f"{shown(type(source).__name__)} is no recording; give a path, a frame, or a dict of arrays")
    found = []
    for name in names:
        column = source[name]
        values = np.asarray(column.to_numpy() if hasattr(column, "to_numpy") else column)
        if values.dtype.kind == "M":
            values = (values - values[0]) / np.timedelta64(1, "s")
        if values.dtype.kind not in "fiu" or values.ndim != 1:
            raise InputError(f"column {shown(str(name))}: holds no vector of numbers; leave it out")
        found.append(Column(str(name), values))
    return found


def _vectors(path: Path, kind: str) -> list[Column]:
    """Vectors of MATLAB, numpy or HDF5, in groups or structs too; one struct alone stands for its fields.

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
    left = {k.removesuffix("@left"): v for k, v in found.items() if k.endswith("@left")}
    left |= {k: " x ".join(map(str, v.shape)) for k, v in vectors.items() if v.size > max(v.shape, default=1)}
    left |= {k: "a group" for k, v in found.items() if isinstance(v, Mapping) and k != "units"}
    _leave(path, left)
    return columns


def _leave(path: Path, left: Mapping[str, str]) -> None:
    """Say what is not read. left: name -> what it is."""
    if left:
        once(f"{path}: left out: {', '.join(f'{name} ({what})' for name, what in left.items())}")


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value.strip() else None


def _columns(path: Path, kind: str) -> list[Column]:
    """Channels with their units and their own times, as the other formats have them."""
    found, every = [], apart(path, kind, APART).values()
    _leave(path, {told["header"]: told["left"] for told in every if "left" in told})
    for told in (told for told in every if "left" not in told):
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


def _of_format(path: Path) -> list[Column]:
    """The columns of a file. Raises InputError for a file that is none of its format."""
    kind = FORMATS[path.suffix.lower()]
    found = (_vectors if kind in ("mat", "npz", "hdf5") else _columns)(path, kind)
    if not found:
        raise InputError(f"{path}: holds no channel of numbers with two samples or more")
    return found
