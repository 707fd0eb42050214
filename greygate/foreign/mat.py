"""The other process for .mat files, of MATLAB 4 to 7.3. Objects, functions and struct arrays are left out."""

import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError
from greygate.foreign.child import Read, Room, served
from greygate.foreign.hdf5 import h5py_module, variables


def mat() -> Read:
    """What reads a .mat file of any version."""
    from scipy.io import loadmat, whosmat

    with suppress(InputError):  # only a file of 7.3 needs it, which says so
        h5py_module()

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        with path.open("rb") as file:
            head = file.read(520)
            if head[:10] == b"MATLAB 7.3" or head[512:520] == b"\x89HDF\r\n\x1a\n":
                yield from variables(path, room)
                return
            file.seek(0)
            for name, shape, _ in whosmat(file):
                room.take(int(np.prod([float(n) for n in shape])), name)
            file.seek(0)
            found = loadmat(file, struct_as_record=True)
        for name in list(found):
            value = _plain(found.pop(name))
            if not name.startswith("__"):
                yield name, value

    return read


def _plain(value: Any) -> Any:
    """A struct as a dictionary, a text as str, cells as an array of objects, a matrix of characters as one of texts."""
    if isinstance(value, np.ndarray) and value.dtype.names:
        return {n: _plain(value.reshape(-1)[0][n]) for n in value.dtype.names} if value.size == 1 else None
    if isinstance(value, np.ndarray) and value.dtype == object:
        out = np.empty(value.shape, object)
        for at in np.ndindex(value.shape):
            out[at] = _plain(value[at])
        return out
    if isinstance(value, np.ndarray) and value.dtype.kind in "US":
        rows = value.reshape(-1)
        return "".join(rows[:1].tolist()) if rows.size < 2 else _plain(rows.astype(object))  # a matrix of characters
    if isinstance(value, np.ndarray) and value.dtype.kind in "iub" and value.dtype.itemsize <= 4:
        return value.astype(float)  # MATLAB stores whole numbers of any class so
    return value


if __name__ == "__main__":
    sys.exit(served({"mat": mat}, *sys.argv[1:]))
