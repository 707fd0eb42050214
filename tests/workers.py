"""What workers do in tests. They import this module alone, not all that a test file needs."""

import os
import signal
import time
from pathlib import Path

from greygate import children


def slept(file: str) -> None:
    """Start something, tell who is there, and go on for long."""
    with children.started(["sleep", "600"]) as process, open(file, "a") as out:
        out.write(f"{os.getpid()} {process.pid}\n")
        out.flush()
        time.sleep(600)


def killed(folder: Path, place: int, times: int) -> int:
    """Return the place; the process of place 1 is killed so many times before."""
    tried = folder / str(time.monotonic_ns())
    if place == 1 and len(list(folder.iterdir())) < times:
        tried.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return place


def killed_always(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)
