"""Reads the bytes of a file from anywhere: only a plain file of bounded size is read, whatever its name leads to."""

import errno
import os
import stat
from io import BufferedIOBase
from pathlib import Path

from greygate.errors import InputError
from greygate.system import UNBLOCKED

CHUNK = 1 << 20  # bytes read at a time
LARGEST = 1 << 26  # bytes: a hundred times the largest file that greygate writes, except recordings


def contents(path: Path | str, most: int = LARGEST) -> bytes:
    """Return all bytes of a plain file.

    Raises OSError for a folder, for a pipe or a device, which may never end, and for more than `most` bytes.
    """
    with open(os.open(path, os.O_RDONLY | UNBLOCKED), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "is not a plain file", str(path))
        data = bounded(file, most) if status.st_size <= most else None
        if data is None:
            raise OSError(errno.EFBIG, f"is larger than {most} bytes", str(path))
        return data


def bounded(file: BufferedIOBase, most: int) -> bytes | None:
    """Return the rest of an open file, or None if it has more than `most` bytes.

    It takes memory only for what it reads.
    """
    parts, size = [], 0
    while part := file.read(CHUNK):
        parts.append(part)
        if (size := size + len(part)) > most:
            return None
    return b"".join(parts)


def without_entities(text: bytes, path: Path | str) -> None:
    """Raises InputError for XML that declares entities, which may unpack to anything."""
    if b"<!" in text.replace(b"<!--", b"").replace(b"<![CDATA[", b""):
        raise InputError(f"{path}: has a <!DOCTYPE or <!ENTITY; write the model without")
