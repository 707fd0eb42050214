"""Where compiled code is kept: what lies there is run, so the folder is the user's own and nobody else can write it."""

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from greygate.system import private, user, writable

NUMBA = "NUMBA_CACHE_DIR"  # where numba keeps what it compiles, instead of beside the source


def folder() -> Path | None:
    """`$XDG_CACHE_HOME/greygate` (`~/.cache` by default), else a folder in the temporary one; None: neither serves."""
    return next((place for place in _places() if _private(place)), None)


def keep_compiled() -> None:
    """Let numba keep what it compiles in `folder` where the package cannot be written and the user names no place."""
    beside = Path(__file__).parent
    tree = [place for place in (beside, beside / "__pycache__") if place.exists()]
    if os.environ.get(NUMBA) or all(map(writable, tree)):
        return
    if (place := folder()) is not None:
        os.environ[NUMBA] = str(place / "numba")
        if "numba" in sys.modules:
            sys.modules["numba"].config.CACHE_DIR = os.environ[NUMBA]


def _places() -> Iterator[Path]:
    with suppress(RuntimeError):  # a user without a home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "greygate"
    import tempfile

    with suppress(FileNotFoundError):  # nothing temporary can be written
        yield Path(tempfile.gettempdir()) / f"greygate-{user()}"


def _private(place: Path) -> bool:
    """Whether it is, or can be made, a folder of ours that others cannot write."""
    try:
        place.parent.mkdir(exist_ok=True)
        place.mkdir(mode=0o700, exist_ok=True)
        return private(place)
    except OSError:
        return False
