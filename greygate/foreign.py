"""Reads .mat files, HDF5 and MDF in a process of its own: a damaged file may crash their libraries.

A variable becomes a dictionary (struct), an array of objects (cells), a text, or an array of numbers. Objects,
functions and struct arrays are left out.
"""

import io
import json
import os
import resource
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from greygate import children
from greygate.errors import InputError, one_line

LARGEST = 2 << 30  # bytes of a file
MEMORY = 16 << 30  # bytes of address space that reading may take; a file may be compressed a thousandfold
SECONDS = 300.0  # that reading may take
DEEPEST = 20  # of structs and cells in one another
ARRAY, CELLS = "array", "cells"  # how an array is told from other things in JSON


def read_mat(path: Path | str) -> dict[str, Any]:
    """The variables of a .mat file. Raises InputError for a file that is none, or that crashes its reader."""
    return _apart(Path(path), "mat")


def read_hdf5(path: Path | str) -> dict[str, Any]:
    """The datasets of an HDF5 file, groups as dictionaries; `NAME@unit` is its attribute `unit` or `units`.

    Raises InputError as `read_mat`.
    """
    return _apart(Path(path), "hdf5")


def read_mdf(path: Path | str) -> dict[str, Any]:
    """The channels of an MDF file with numbers; `NAME@unit` and `NAME@time` (s) beside them. Raises as `read_mat`."""
    return _apart(Path(path), "mdf")


def _apart(path: Path, kind: str) -> dict[str, Any]:
    """Read it in another process."""
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST >> 30} GiB; save less of it")
        path.open("rb").close()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; check the path") from None
    with tempfile.TemporaryDirectory() as folder:
        command = children.python("-m", "greygate.foreign", kind, str(path.resolve()), folder)
        try:
            done = children.ran(command, timeout=SECONDS)
        except children.TimeoutExpired:
            raise InputError(f"{path}: is not read within {SECONDS:g} s; save less of it") from None
        if done.returncode:
            why = one_line(" ".join(done.stdout.split()))[:150] or "its reader crashed: it is damaged"
            raise InputError(f"{path}: cannot be read ({why})")
        told = json.loads((Path(folder) / "names.json").read_text(encoding="utf-8"))
        return {name: _built(value, Path(folder)) for name, value in told.items()}


def _built(value: Any, folder: Path) -> Any:
    """A value from what the other process wrote."""
    if isinstance(value, str):
        return value
    kind, content = value
    if kind == ARRAY:
        return np.load(folder / f"{content}.npy", allow_pickle=False)
    if kind == CELLS:
        shape, inner = content
        found = np.empty(len(inner), object)
        for k, one in enumerate(inner):
            found[k] = _built(one, folder)
        return found.reshape(shape)
    return {name: _built(inner, folder) for name, inner in content.items()}


# -- in the other process --------------------------------------------------------------------------------------------


def _main(kind: str, path: str, folder: str) -> int:
    """Write names.json and the arrays; say on stdout why not."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        with open(path, "rb") as file:
            head = file.read(520)
        newer = head[:10] == b"MATLAB 7.3" or head[512:520] == b"\x89HDF\r\n\x1a\n"
        readers = {"hdf5": _datasets, "mdf": _measured, "mat": _v73 if newer else _v5}
        found = readers[kind](path)
        arrays: dict[str, np.ndarray] = {}
        told = {name: kept for name, value in found.items() if (kept := _written(value, arrays, 0)) is not None}
        for name, array in arrays.items():
            np.save(Path(folder) / f"{name}.npy", array, allow_pickle=False)
        (Path(folder) / "names.json").write_text(json.dumps(told), encoding="utf-8")
    except Exception as error:  # a damaged file fails in many ways
        print(f"{error}" or type(error).__name__, flush=True)
        os._exit(1)  # what the libraries left half open may fail once more
    return 0


def _written(value: Any, arrays: dict[str, np.ndarray], depth: int) -> Any:
    """A value as JSON, its arrays put aside; None for what is left out."""
    if depth > DEEPEST:
        return None
    if isinstance(value, str):
        return value
    if isinstance(value, dict):
        inner = {str(k): kept for k, v in value.items() if (kept := _written(v, arrays, depth + 1)) is not None}
        return ["struct", inner]
    if isinstance(value, np.ndarray) and value.dtype == object:
        kept = [_written(v, arrays, depth + 1) for v in value.reshape(-1)]
        return [CELLS, [list(value.shape), [k if k is not None else "" for k in kept]]]
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        name = f"a{len(arrays)}"
        arrays[name] = value
        return [ARRAY, name]
    return None


def _v5(path: str) -> dict[str, Any]:
    from scipy.io import loadmat

    found = loadmat(io.BytesIO(Path(path).read_bytes()), struct_as_record=True, mat_dtype=True)
    return {k: _plain(v) for k, v in found.items() if not k.startswith("__")}


def _plain(value: Any) -> Any:
    """A struct as a dictionary, a text as str, cells as an array of objects."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        return {n: _plain(value.reshape(-1)[0][n]) for n in value.dtype.names} if value.size == 1 else None
    if isinstance(value, np.ndarray) and value.dtype == object:
        out = np.empty(value.shape, object)
        for at in np.ndindex(value.shape):
            out[at] = _plain(value[at])
        return out
    if isinstance(value, np.ndarray) and value.dtype.kind in "US":
        return "".join(value.reshape(-1)[:1].tolist())
    return value


def _measured(path: str) -> dict[str, Any]:
    try:
        import asammdf
    except ImportError:
        raise InputError("asammdf is not installed; pip install 'greygate[mdf]'") from None
    found: dict[str, Any] = {}
    with asammdf.MDF(path) as file:
        for signal in file.iter_channels(skip_master=True):
            samples = np.asarray(signal.samples)
            if samples.dtype.kind in "fiu" and samples.ndim == 1 and len(samples) > 1:
                name = next(
                    n for k in range(1, 10**6) if (n := f"{signal.name}_{k}" if k > 1 else signal.name) not in found
                )
                found[name] = samples
                found[f"{name}@time"] = np.asarray(signal.timestamps, float)
                found[f"{name}@unit"] = signal.unit or ""
    return found


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise InputError("h5py is not installed; pip install 'greygate[matlab]'") from None
    return h5py


def _datasets(path: str) -> dict[str, Any]:
    h5py = _h5py()

    def plain(group: Any, depth: int = 0) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, item in group.items() if depth <= DEEPEST else ():
            if isinstance(item, h5py.Group):
                found[name] = plain(item, depth + 1)
            elif item.dtype.kind in "fiub":
                found[name] = np.asarray(item[()])
                unit = item.attrs.get("unit", item.attrs.get("units"))
                unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
                if isinstance(unit, str):
                    found[f"{name}@unit"] = unit
        return found

    with h5py.File(path, "r") as file:
        return plain(file)


def _v73(path: str) -> dict[str, Any]:
    h5py = _h5py()
    with h5py.File(path, "r") as file:

        def plain(item: Any, depth: int = 0) -> Any:
            if depth > DEEPEST:
                return None
            if isinstance(item, h5py.Group):
                return {k: plain(v, depth + 1) for k, v in item.items()}
            kind = item.attrs.get("MATLAB_class", b"")
            kind = kind.decode() if isinstance(kind, bytes) else str(kind)
            if item.attrs.get("MATLAB_empty", 0):
                return "" if kind == "char" else np.empty((0, 0), object if kind == "cell" else float)
            value = item[()]
            if kind == "cell":
                out = np.empty(value.shape, object)
                for at in np.ndindex(value.shape):
                    out[at] = plain(file[value[at]], depth + 1)
                return out.T
            if kind == "char":
                return "".join(map(chr, np.asarray(value).ravel(order="F").tolist()))
            return np.asarray(value).T

        return {k: plain(v) for k, v in file.items() if not k.startswith("#")}


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))
