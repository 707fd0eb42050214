"""The formats of recordings: what reads a file, by the ending of its name; every reader gives columns."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, one_line
from greygate.foreign import read_hdf5, read_mat, read_mdf
from greygate.plants.readers.columns import Column

LARGEST = 2 << 30  # bytes of a file


def of_mat(path: Path) -> list[Column]:
    """Vectors of MATLAB; one struct alone stands for its fields. `units` may be a struct: name -> unit."""
    return _tree(read_mat(path), path)


def of_hdf5(path: Path) -> list[Column]:
    """Vectors of HDF5, in groups too; the attribute `unit` or `units` of each."""
    return _tree(read_hdf5(path), path)


def _tree(found: Mapping[str, Any], path: Path) -> list[Column]:
    vectors = {k: v for k, v in found.items() if isinstance(v, np.ndarray) and v.dtype != object}
    structs = [v for k, v in found.items() if isinstance(v, Mapping) and k != "units"]
    if not vectors and len(structs) == 1:
        return _tree({**{k: v for k, v in found.items() if k == "units"}, **structs[0]}, path)
    units = found.get("units")
    units = units if isinstance(units, Mapping) else {}
    columns = [
        Column(name, v.ravel().astype(float), _text(found.get(f"{name}@unit", units.get(name))))
        for name, v in vectors.items()
        if v.size > 1 and v.size == max(v.shape)
    ]
    if not columns:
        raise InputError(f"{path}: holds no vectors; save each channel, and the time t, as a vector")
    return columns


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value.strip() else None


def of_parquet(path: Path) -> list[Column]:
    """Columns of Parquet; the unit of a field in its metadata. A time stamp counts from the first one."""
    with _module("parquet"):
        import pyarrow
        import pyarrow.parquet
    table = pyarrow.parquet.read_table(path)
    found = []
    for field, column in zip(table.schema, table.columns, strict=True):
        if pyarrow.types.is_timestamp(field.type):
            nanoseconds = column.cast(pyarrow.timestamp("ns")).cast(pyarrow.int64()).to_numpy()
            values = (nanoseconds - nanoseconds[0]) * 1e-9
        elif pyarrow.types.is_integer(field.type) or pyarrow.types.is_floating(field.type):
            values = column.to_numpy().astype(float)
        else:
            continue
        told = {k.decode(errors="replace"): v.decode(errors="replace") for k, v in (field.metadata or {}).items()}
        found.append(Column(field.name, values, told.get("unit") or told.get("units")))
    return found


def of_mdf(path: Path) -> list[Column]:
    """Channels of MDF3 and MDF4 with numbers, their units and their own times."""
    found = read_mdf(path)
    channels = [name for name in found if not name.endswith(("@unit", "@time"))]
    return _one_clock(
        [Column(n, found[n].astype(float), _text(found[f"{n}@unit"]), found[f"{n}@time"]) for n in channels]
    )


def of_tdms(path: Path) -> list[Column]:
    """Channels of LabVIEW's TDMS with their `unit_string`, and the time of a waveform."""
    with _module("tdms"):
        import nptdms
    found = []
    with nptdms.TdmsFile.open(path) as file:
        for group in file.groups():
            for channel in group.channels():
                values = np.asarray(channel[:])
                if values.dtype.kind not in "fiu" or len(values) < 2:
                    continue
                step = channel.properties.get("wf_increment")
                start = float(channel.properties.get("wf_start_offset", 0.0))
                time = None if not step else start + float(step) * np.arange(len(values))
                found.append(
                    Column(channel.name, values.astype(float), _text(channel.properties.get("unit_string")), time)
                )
    return found


def of_mcap(path: Path) -> list[Column]:
    """Numbers in messages of JSON, by topic and field, at their log times."""
    import json

    with _module("mcap"):
        from mcap.reader import make_reader
    series: dict[str, tuple[list[float], list[float]]] = {}
    other = set()
    with open(path, "rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding != "json":
                other.add(channel.message_encoding)
                continue
            topic = channel.topic.strip("/")
            for name, value in _numbers(json.loads(message.data), topic):
                times, values = series.setdefault(name, ([], []))
                times.append(message.log_time * 1e-9)
                values.append(value)
    if not series and other:
        raise InputError(f"{path}: its messages are in {', '.join(sorted(other))}; those in json are read")
    start = min((times[0] for times, _ in series.values()), default=0.0)
    found = [Column(n, np.array(v), None, np.array(t) - start) for n, (t, v) in series.items() if len(v) > 1]
    short = {c.header.rpartition("/")[2] for c in found}
    if len(short) == len(found):  # the topic tells nothing
        found = [Column(c.header.rpartition("/")[2], c.values, c.unit, c.time) for c in found]
    return _one_clock(found)


def _numbers(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(inner, f"{name}/{key}")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield name, float(value)


def _one_clock(found: list[Column]) -> list[Column]:
    """Without a channel that merely repeats the time of the others."""
    clocks = {"t", "time", "t_s", "time_s"}
    return [c for c in found if c.header.lower() not in clocks] or found


@contextmanager
def _module(extra: str) -> Iterator[None]:
    """An import that names the extra when it fails."""
    try:
        yield
    except ImportError as error:
        name = (error.name or extra).partition(".")[0]
        raise InputError(f"{name} is not installed; pip install 'greygate[{extra}]'") from None


FORMATS: dict[str, Callable[[Path], list[Column]]] = {
    ".mat": of_mat,
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), of_hdf5),
    ".parquet": of_parquet,
    **dict.fromkeys((".mf4", ".mdf", ".dat"), of_mdf),
    ".tdms": of_tdms,
    ".mcap": of_mcap,
}
"""Ending of a file's name -> what reads its columns."""


def columns(path: Path) -> list[Column]:
    """The columns of a file. Raises InputError for a file that is none of its format."""
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST >> 30} GiB; cut the recording")
        found = FORMATS[path.suffix.lower()](path)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or one_line(str(error))[:100]}; check the path") from None
    except MemoryError:
        raise InputError(f"{path}: needs more memory than there is; cut the recording") from None
    except Exception as error:  # a damaged file fails in many ways
        why = one_line(" ".join(str(error).split()))[:120] or type(error).__name__
        raise InputError(f"{path}: is no {path.suffix} file that can be read ({why})") from None
    if not found:
        raise InputError(f"{path}: holds no channel of numbers with two samples or more")
    return found
