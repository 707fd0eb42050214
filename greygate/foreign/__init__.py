"""Reads the binary files of other tools in a process of its own: a damaged file may crash their libraries.

What a file unpacks to is bounded by its size, and checked before it is unpacked; the process has limits of memory and
computing, or the file is refused; while it reads, it runs no code, starts no program and opens no other file (`child`).
A variable becomes a dictionary (struct), an array of objects (cells), a text, or an array of numbers.
"""

import json
import stat
import tempfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from greygate import children
from greygate.errors import InputError, one_line
from greygate.foreign.child import ARRAY, CELLS, FULL, MEMORY, REFUSED, UNBOUND, UNBOUND_WORD, UNLIMITED, seconds
from greygate.progress import once
from greygate.system import OUT_OF_TIME, memory_limit

LARGEST = 2 << 30  # bytes of a file
WAITS = 600.0  # s that reading may take in all, on a busy machine or a slow disk
SPARE = {  # variables of the other process: little address space, and no code that HDF5 loads for a filter
    "OPENBLAS_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "2",
    "HDF5_PLUGIN_PRELOAD": "::",
}  # fmt: skip


def read_mat(path: Path | str) -> dict[str, Any]:
    """The variables of a .mat file. Raises InputError for a file that is none, or that crashes its reader."""
    return apart(Path(path), "mat", "greygate.foreign.mat")


def converted(data: bytes, opset: int, said: Path) -> bytes:
    """An ONNX model in a newer opset, by onnx's own converter. Raises InputError, with the path that is `said`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "old.onnx"
        path.write_bytes(data)
        try:
            return apart(path, f"{opset}", "greygate.foreign.opset")["model"].tobytes()
        except InputError as error:
            raise InputError(str(error).replace(str(path), str(said))) from None


def apart(path: Path, kind: str, module: str) -> dict[str, Any]:
    """What a reader of `module` (`child.served`) finds in a file, in another process.

    Raises InputError for a file that cannot be read, that unpacks to too much, or that asks for anything else.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: is no plain file; copy it into one")
        if status.st_size > LARGEST:
            raise InputError(f"{path}: larger than {LARGEST >> 30} GiB; save less of it")
        path.open("rb").close()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; check the path") from None
    try:
        with tempfile.TemporaryDirectory() as folder:
            _run(path, [module, kind, str(path.resolve()), folder], seconds(status.st_size))
            told = json.loads((Path(folder) / "told.json").read_text(encoding="utf-8"))
            with (Path(folder) / "arrays").open("rb") as arrays:
                made: dict[int, np.ndarray] = {}
                return {name: _built(value, arrays, made) for name, value in told}
    except OSError as error:
        raise InputError(f"{tempfile.gettempdir()}: {error.strerror or error}; {path} is unpacked there") from None


def _run(path: Path, words: list[str], most: float) -> None:
    """Run the other process. most: s of computing that it has."""
    try:
        done = children.ran(children.python("-m", *words), timeout=WAITS, env=SPARE)
    except children.TimeoutExpired:
        raise InputError(f"{path}: is not read within {WAITS:g} s; save less of it") from None
    why = one_line(" ".join(done.stdout.split()))[:300]
    match done.returncode:
        case 0:
            if why == UNBOUND_WORD:
                once(f"{path}: read without limits of memory and computing, as {UNLIMITED} says")
            return
        case _ if done.returncode == UNBOUND:
            raise InputError(
                f"{path}: this system bounds no memory of a process, and a damaged or forged file may take all "
                f"of it; save the recording as CSV, or set {UNLIMITED}=1 if you trust the file"
            )
        case _ if done.returncode == OUT_OF_TIME:
            raise InputError(f"{path}: is not read within {most:.0f} s of computing; save less of it")
        case _ if done.returncode == FULL:
            where = tempfile.gettempdir()
            raise InputError(f"{where}: {why}; {path} is unpacked there; free some of it, or set TMPDIR")
        case _ if done.returncode == MEMORY:
            raise InputError(f"{path}: needs more memory than {why}; save less of it, or without compression")
        case _ if done.returncode == REFUSED:
            raise InputError(f"{path}: {why}")
    if not why and (limit := memory_limit()) is not None:
        raise InputError(
            f"{path}: is not read within {limit >> 20} MiB of memory, the limit here (ulimit -v); raise it"
        )
    raise InputError(f"{path}: cannot be read ({why[:150] or 'its reader crashed: it is damaged'})")


def _built(value: Any, arrays: BinaryIO, made: dict[int, np.ndarray]) -> Any:
    """A value from what the other process wrote. made: place -> array; what is one there is one here."""
    if isinstance(value, str):
        return value
    kind, content = value
    if kind == ARRAY:
        place, dtype, shape = content
        if not np.prod(shape):  # it shares its place with the next
            return np.empty(shape, dtype)
        if place not in made:
            arrays.seek(place)
            made[place] = np.fromfile(arrays, np.dtype(dtype), int(np.prod(shape))).reshape(shape)
        return made[place]
    if kind == CELLS:
        shape, inner = content
        found = np.empty(len(inner), object)
        for k, one in enumerate(inner):
            found[k] = _built(one, arrays, made)
        return found.reshape(shape)
    return {name: _built(inner, arrays, made) for name, inner in content.items()}
