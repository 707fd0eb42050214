"""The one exception that a user's mistake raises, and the one way files and folders are written."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 480  # characters of a message: about six lines of a terminal


class InputError(ValueError):
    """Something the user gave is wrong. The message is one line: what, where, what to do.

    What the message quotes from a file may hold anything: characters that do not print are escaped, and a message
    that is too long loses its middle. The command line prints it to stderr and exits with 2; nothing has been written
    by then.
    """

    def __init__(self, message: str):
        super().__init__(_one_line(str(message)))


def _one_line(text: str) -> str:
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    if len(line) <= LONGEST:
        return line
    half = LONGEST // 2 - 2  # the head says where, the tail what to do
    return f"{line[:half]} … {line[-half:]}"


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it over `path` only if the block succeeds.

    Raises InputError when the folder is missing or cannot be written.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise InputError(f"{path.parent}: cannot write here ({error.strerror}); choose another folder") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def replacing_folder(path: Path | str, marker: str) -> Iterator[Path]:
    """Yield a temporary folder beside `path`; rename it to `path` only if the block succeeds.

    A folder that stands there is replaced if it holds `marker`, a file that only greygate writes, or nothing.
    Raises InputError for any other folder, or where none can be made.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: a file of that name is in the way; choose another folder")
    if path.exists() and any(path.iterdir()) and not (path / marker).exists():
        raise InputError(f"{path}: holds other files (no {marker}); choose an empty or a new folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    except OSError as error:
        raise InputError(f"{path}: cannot make this folder ({error.strerror}); choose another") from None
    try:
        yield temporary
        temporary.chmod(0o755)
        if path.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
            path.rename(old)
            temporary.rename(path)
            shutil.rmtree(old)
        else:
            temporary.rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
