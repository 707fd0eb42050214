"""The other process of `greygate.foreign`: reads a file within limits, and writes what it found into a folder."""

import errno
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from greygate.errors import InputError, shown
from greygate.system import limit, memory_limit

RATIO = 50  # times its size that a file may unpack to; recordings of measured signals pack 2 to 20 times
FLOOR = 128 << 20  # bytes that any file may unpack to, however small: 1.6 million samples of ten channels
MOST = 4 << 30  # bytes that no file may exceed unpacked: half of the memory of a small computer
COPIES = 3  # of what it unpacks to: memory that reading may take
SLACK = 256 << 20  # bytes of memory beside
ARRAYS = 20_000  # variables or channels; a vehicle's largest recordings have some thousands
_SPEECHLESS = ("without exception set", "without setting an exception")  # C code that had no memory left to say so
LEAST = 32  # numbers that an array counts for at least: its name and place take memory too
SECONDS = 6.0  # of computing that reading may take, and
SECONDS_MB = 3.0  # more for each megabyte of the file
DEEPEST = 20  # of structs and cells in one another
ARRAY, CELLS, STRUCT = "array", "cells", "struct"  # how they are told from a text in JSON
DAMAGED, REFUSED, MEMORY, FULL, UNBOUND = 1, 3, 4, 5, 6  # exit codes
UNLIMITED = "GREYGATE_UNLIMITED"  # set by who trusts a file on a system that sets no limits
UNBOUND_WORD = "without limits"

Read = Callable[[Path, "Room"], Iterable[tuple[str, Any]]]
"""Reads a file within some room: (name, value) of each variable."""


def seconds(size: int) -> float:
    """How long the reader of a file of `size` bytes may compute, in s."""
    return SECONDS + SECONDS_MB * size / 1e6


class Room:
    """What a file of some size may unpack to. Readers take from it before they unpack."""

    def __init__(self, size: int):
        self.size, self.bytes = size, min(MOST, max(FLOOR, RATIO * size))
        self.used = self.arrays = 0

    def take(self, count: int, name: str) -> None:
        """Count an array of `count` numbers, as 8 bytes each. Raises InputError where there is no room for it."""
        self.arrays += 1
        if self.arrays > ARRAYS:
            raise InputError(f"holds more than {ARRAYS} channels or variables; save fewer")
        self.more(max(int(count), LEAST) if count >= 0 else MOST, name)

    def more(self, count: int, name: str) -> None:
        """Count `count` numbers more of the same array."""
        self.used += 8 * count
        if self.used > self.bytes:
            times = f"{RATIO} times its size" if self.bytes == RATIO * self.size else f"{self.bytes >> 20} MiB"
            raise InputError(
                f"unpacks to more than {times}, by {shown(name)} to {self.used / 2**20:.0f} MiB; save less of it, or "
                "without compression"
            )


def served(readers: Mapping[str, Callable[[], Read]], kind: str, source: str, folder: str) -> int:
    """Write told.json and the arrays of a file into a folder; say on stdout why not.

    readers: kind -> what imports all that the reader needs, and gives it.
    """
    path, code = Path(source), DAMAGED
    warnings.simplefilter("ignore")
    tempfile.tempdir = folder
    told: list = []
    names = set()
    try:
        room = Room(path.stat().st_size)
        read = readers[kind]()
        bound = limit(room.size + SLACK + COPIES * room.bytes, seconds(room.size), SLACK + 2 * room.bytes)
        if not bound and not os.environ.get(UNLIMITED):
            return UNBOUND
        asked = _locked(path, folder)
        with (Path(folder) / "arrays").open("wb") as file:
            arrays = _Arrays(file)
            for name, value in read(path, room):
                if name in names:
                    raise InputError(f"two of its channels or variables are called {shown(name)}; rename one of them")
                names.add(name)
                if (kept := _written(value, arrays, name)) is not None:
                    told.append([name, kept])
        if asked:
            raise InputError(f"asks for {asked[0]}; what a file says is never run")
        (Path(folder) / "told.json").write_text(json.dumps(told), encoding="utf-8", newline="\n")
        print("" if bound else UNBOUND_WORD)
        return 0
    except InputError as error:
        why, code = str(error), REFUSED
    except MemoryError:
        why, code = _most(), MEMORY
    except SystemError as error:
        why, code = f"{error}", DAMAGED
        if any(words in why for words in _SPEECHLESS):
            why, code = _most(), MEMORY
    except ImportError as error:
        why, code = f"{error}", DAMAGED
        if memory_limit() is not None:
            why, code = _most(), MEMORY
    except OSError as error:
        why = error.strerror or f"{error}"
        code = FULL if error.errno in (errno.ENOSPC, errno.EDQUOT) else DAMAGED
    except Exception as error:  # a damaged file fails in many ways
        why = f"{error}" or type(error).__name__
    print(why, flush=True)
    os._exit(code)  # what the libraries left half open may fail once more


def _most() -> str:
    return f"the {(memory_limit() or sys.maxsize) >> 20} MiB that reading it may take"


_CODE = {  # events of Python that run code or start a program, or speak to another computer
    *("compile", "exec", "marshal.loads", "marshal.load", "pickle.find_class", "ctypes.dlopen", "code.__new__"),
    *("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "os.forkpty", "subprocess.Popen", "pty.spawn"),
    *("socket.connect", "socket.bind", "socket.sendto", "urllib.Request", "webbrowser.open"),
}


def _locked(path: Path, folder: str) -> list[str]:
    """From here on nothing is compiled, run or connected to, and no file is opened but this and those in the folder.

    Returns what was asked for, which is filled as it comes: a library may pass over a refusal.
    """
    asked: list[str] = []

    def refuse(event: str, arguments: tuple) -> None:
        if event in _CODE:
            asked.append("code to be run")
            raise PermissionError(errno.EPERM, "it asks for code to be run")
        if event == "open" and not isinstance(arguments[0], int):
            name = os.path.abspath(os.fsdecode(arguments[0]))
            if name not in (str(path), folder) and not name.startswith(folder + os.sep):
                raise PermissionError(errno.EPERM, "it asks for another file")

    sys.addaudithook(refuse)
    return asked


class _Arrays:
    """Arrays one behind the other in a file. One that comes again is not written again."""

    def __init__(self, file: BinaryIO):
        self.file, self.last, self.count = file, (np.empty(0), 0), 0

    def put(self, array: np.ndarray) -> list:
        self.count += 1
        if self.count > 2 * ARRAYS:  # a channel has values and times
            raise InputError(f"holds more than {2 * ARRAYS} arrays, in cells too; save fewer")
        if self.last[0] is not array:
            self.last = array, self.file.tell()
            self.file.write(np.ascontiguousarray(array).data)
        return [ARRAY, [self.last[1], array.dtype.str, list(array.shape)]]


def _written(value: Any, arrays: _Arrays, name: str, depth: int = 0) -> Any:
    """A value as JSON, its arrays put aside; None for what is left out. Raises InputError for a complex vector."""
    if depth > DEEPEST:
        return None
    if isinstance(value, str):
        return value
    if isinstance(value, dict):
        kept = {str(k): _written(v, arrays, f"{name}.{k}"[-60:], depth + 1) for k, v in value.items()}
        return [STRUCT, {k: v for k, v in kept.items() if v is not None}]
    if isinstance(value, np.ndarray) and value.dtype == object:
        cells = [_written(v, arrays, name, depth + 1) for v in value.reshape(-1)]
        return [CELLS, [list(value.shape), [c if c is not None else "" for c in cells]]]
    if not isinstance(value, np.ndarray):
        return None
    if value.dtype.kind == "c" and 1 < value.size == max(value.shape):
        raise InputError(f"{name}: holds complex numbers; save its real and its imaginary part, each by itself")
    return arrays.put(value) if value.dtype.kind in "fiub" else None
