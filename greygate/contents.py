"""The bytes of a file that anyone may have sent: a plain file of bounded size, whatever its name leads to."""

import errno
import os
import stat
from io import BufferedIOBase
from pathlib import Path

CHUNK = 1 << 20  # bytes read at a time
LARGEST = 1 << 26  # bytes: a hundred times the largest file that greygate writes, but for recordings


def contents(path: Path | str, most: int = LARGEST) -> bytes:
    """All bytes of a plain file.

    Raises OSError for a pipe, a device or a folder, whose reading may never end, and beyond `most` bytes.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "is no plain file", str(path))
        data = bounded(file, most) if status.st_size <= most else None
        if data is None:
            raise OSError(errno.EFBIG, f"is larger than {most} bytes", str(path))
        return data


def bounded(file: BufferedIOBase, most: int) -> bytes | None:
    """The rest of an open file, or None where it is more than `most` bytes; memory grows with what is there."""
    parts, size = [], 0
    while part := file.read(CHUNK):
        parts.append(part)
        if (size := size + len(part)) > most:
            return None
    return b"".join(parts)
