"""HDF5 in the other process: what lies in the file itself, and nothing that it points to outside."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import InputError, brought_by, shown
from greygate.foreign.child import DEEPEST, Room

HOPS = 20  # soft links behind one another
ATTRIBUTE = 1000  # bytes of an attribute that is read


def h5py_module() -> Any:
    """h5py, or InputError with what to install."""
    with brought_by("matlab", "h5py"):
        import h5py
    return h5py


class Contents:
    """The groups and datasets of an open file. Raises InputError for one whose data lie in another file."""

    def __init__(self, file: Any, room: Room):
        self.h5py, self.file, self.room = h5py_module(), file, room

    def items(self, group: Any) -> Iterator[tuple[str, Any]]:
        """(name, group or dataset) of each link that leads to one."""
        for name in group:
            self.room.take(0, name)
            item = self._linked(group, name, HOPS)
            if isinstance(item, self.h5py.Group | self.h5py.Dataset):
                yield name, item

    def _linked(self, group: Any, name: str, hops: int) -> Any:
        """What a link leads to, or None. A soft link is followed step by step, since any step may leave the file."""
        try:
            kind = group.id.links.get_info(name.encode("utf-8", "surrogateescape")).type
        except (KeyError, RuntimeError):  # nothing of that name
            return None
        if kind == self.h5py.h5l.TYPE_HARD:
            return group[name]
        if kind != self.h5py.h5l.TYPE_SOFT:
            raise InputError(f"{shown(name)} is a link to another file; copy what it holds into this one")
        path = group.id.links.get_val(name.encode("utf-8", "surrogateescape")).decode("utf-8", "surrogateescape")
        item = self.file if path.startswith("/") else group
        for step in path.split("/"):
            if step in ("", "."):
                continue
            item = self._linked(item, step, hops - 1) if hops and isinstance(item, self.h5py.Group) else None
        return item

    def values(self, item: Any, name: str) -> Any:
        """The values of a dataset."""
        layout = item.id.get_create_plist()
        if layout.get_layout() == self.h5py.h5d.VIRTUAL or layout.get_external_count():
            raise InputError(f"{shown(name)} keeps its data in other files; copy them into this one")
        if item.shape is None:
            return np.empty(0)
        self.room.take(max(item.size, item.size * item.dtype.itemsize // 8), name)
        return item[()]

    def attribute(self, item: Any, name: str, count: int = 1) -> Any:
        """A number or a text that an attribute holds, or an array of `count`; None where it is missing, or else."""
        if name not in item.attrs:
            return None
        told = item.attrs.get_id(name)
        if told.get_storage_size() > ATTRIBUTE or told.dtype.kind not in "fiubSUO":
            return None
        values = np.asarray(item.attrs[name]).reshape(-1)
        if len(values) != count:
            return None
        if count > 1:
            return values if values.dtype.kind in "fiu" else None
        value = values[0]
        if isinstance(value, bytes):
            return value.decode("utf-8", "replace")
        return value if isinstance(value, str | np.number | np.bool_) else None


def variables(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
    """(name, value) of each variable of a .mat file of MATLAB 7.3."""
    h5py = h5py_module()
    with h5py.File(path, "r") as file:
        inside = Contents(file, room)
        for name, item in inside.items(file):
            if not name.startswith("#"):
                yield name, _plain(inside, item, name, 0)


def _plain(inside: Contents, item: Any, name: str, depth: int) -> Any:
    h5py = inside.h5py
    if depth > DEEPEST:
        return None
    kind = inside.attribute(item, "MATLAB_class")
    if kind is not None and ("MATLAB_sparse" in item.attrs or "MATLAB_object_decode" in item.attrs):
        return None  # its places, or a number of an object
    if isinstance(item, h5py.Group):
        return {k: _plain(inside, v, k, depth + 1) for k, v in inside.items(item)}
    references = h5py.check_ref_dtype(item.dtype) is h5py.Reference
    if inside.attribute(item, "MATLAB_empty"):
        return "" if kind == "char" else np.empty((0, 0), object if kind == "cell" else float)
    if item.dtype.kind not in "fiubc" and not references and item.dtype.names != ("real", "imag"):
        return None
    value = np.asarray(inside.values(item, name))
    if item.dtype.names:
        return (value["real"] + 1j * value["imag"]).T
    if references:
        out = np.empty(value.shape, object)
        for at in np.ndindex(value.shape) if kind == "cell" else ():
            inside.room.take(0, name)
            out[at] = _plain(inside, inside.file[value[at]], name, depth + 1)
        return out.T if kind == "cell" else None
    if kind == "char":
        return "".join(map(chr, value.ravel(order="F").tolist()))
    return value.T
