"""Which programs a user lets run: the SHA-256 of each that he gave `--trust` for, in a folder that is his alone.

A digest in a rig.toml says which program the rig means, and no more: whoever sends a rig can send one that fits.
"""

import os
from pathlib import Path

from greygate import caches
from greygate.errors import InputError


def give(digest: str) -> None:
    """Let a program run, from now on. Raises InputError where nothing can be kept."""
    place = _place(digest)
    try:
        place.parent.mkdir(exist_ok=True)
        place.touch()
    except OSError as error:
        raise InputError(
            f"{place}: cannot be written ({error.strerror}); set XDG_CACHE_HOME to a folder of yours"
        ) from None


def require(path: Path, digest: str) -> None:
    """Raises InputError where the user has not trusted this program."""
    if not _place(digest).is_file():
        raise InputError(f"{path}: an FMU is a program and runs with your rights; if you trust its maker, give --trust")


def _place(digest: str) -> Path:
    return (caches.folder() or Path(os.devnull)) / "trusted" / digest
