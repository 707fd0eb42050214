"""The other process for Parquet: numbers, booleans and times of its columns, one column at a time."""

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, brought_by, shown
from greygate.foreign.child import Read, Room

BATCH = 1 << 16  # rows unpacked at a time
SECONDS = {"s": 1, "ms": 10**-3, "us": 10**-6, "ns": 10**-9}


def parquet() -> Read:
    """What reads a Parquet file; the unit of a field in its metadata. A time stamp counts from the first one."""
    modules: dict[str, Any] = sys.modules
    modules.setdefault("pandas", None)  # pyarrow would import it late
    with brought_by("parquet", "pyarrow"):
        import pyarrow
        import pyarrow.compute
        import pyarrow.fs
        import pyarrow.parquet

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        file = pyarrow.parquet.ParquetFile(path, page_checksum_verification=True)
        rows, names = file.metadata.num_rows, Counter(file.schema_arrow.names)
        for field in file.schema_arrow:
            kind, types = field.type, pyarrow.types
            while types.is_dictionary(kind):
                kind = kind.value_type
            moment = types.is_timestamp(kind) or types.is_time(kind) or types.is_duration(kind)
            number = types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)
            if not moment and not number and not types.is_boolean(kind):
                yield field.name, {"header": field.name, "left": str(kind)}
                continue
            if names[field.name] > 1:
                raise InputError(f"two columns are called {shown(field.name)}; rename one of them")
            room.take(rows, field.name)
            whole = pyarrow.int32() if types.is_time32(kind) else pyarrow.int64()
            wanted = whole if moment else kind if types.is_integer(kind) else pyarrow.float64()
            values = _values(file, field.name, rows, wanted, np.int64 if moment else wanted.to_pandas_dtype())
            told = {k.decode(errors="replace"): v.decode(errors="replace") for k, v in (field.metadata or {}).items()}
            unit = told.get("unit") or told.get("units") or ""
            if moment:
                values, unit = (values - values[:1]) * SECONDS[kind.unit], "s"
            if types.is_boolean(kind):
                unit = unit or "1"
            yield field.name, {"header": field.name, "unit": unit, "values": values}

    return read


def _values(file: Any, name: str, rows: int, wanted: Any, kind: Any) -> np.ndarray:
    """The `rows` values of a column; of numbers of floating point, one that is missing is nan."""
    found, at = np.empty(rows, kind), 0
    for batch in file.iter_batches(BATCH, columns=[name], use_threads=False):
        part = batch.column(0)
        part = part.dictionary_decode() if hasattr(part, "dictionary_decode") else part
        if part.null_count and found.dtype.kind != "f":
            missing = at + int(np.flatnonzero(part.is_null())[0])
            raise InputError(f"column {shown(name)}: sample {missing} is missing; cut the recording, or fill it in")
        part = part.cast(wanted).to_numpy(zero_copy_only=False)
        found[at : at + len(part)] = part
        at += len(part)
    if at != rows:
        raise ValueError(f"column {name} has {at} rows of {rows}")
    return found
