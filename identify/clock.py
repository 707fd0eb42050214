"""Seconds of the processor, which a work takes in all of its processes: a busy machine does not make them more."""

import os
import tempfile
import weakref
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from time import process_time, time


class Clock:
    """Seconds that this process and its workers have taken since it was made.

    Each notes its own in a file. A worker on another computer does not see that file: it counts seconds of the wall.
    """

    def __init__(self) -> None:
        number, name = tempfile.mkstemp(prefix="greygate-")
        os.close(number)
        self.file, self.began = Path(name), time()
        weakref.finalize(self, _gone, self.file)
        self.note()

    def __setstate__(self, state: dict) -> None:
        self.__dict__ = state  # of a worker, which leaves the file

    def note(self) -> None:
        """Write down what this process has taken so far."""
        with suppress(OSError):
            file = os.open(self.file, os.O_WRONLY | os.O_APPEND)
            try:
                os.write(file, f"{os.getpid()} {process_time()!r}\n".encode())
            finally:
                os.close(file)

    def spent(self) -> float:
        """Seconds by now, but for what other processes have not noted yet."""
        self.note()
        seconds: dict[str, list[float]] = {}
        try:
            for line in self.file.read_text(encoding="ascii").splitlines():
                process, at = line.split()
                seconds.setdefault(process, []).append(float(at))
        except (OSError, ValueError):
            return time() - self.began
        return sum(of[-1] - of[0] for of in seconds.values())


@dataclass(frozen=True)
class Deadline:
    """at: seconds of a clock. sharing: processes that run side by side towards it."""

    clock: Clock | None = None
    at: float = inf
    sharing: int = 1

    @property
    def left(self) -> float:
        """Seconds for this process alone."""
        return inf if self.clock is None or self.at == inf else (self.at - self.clock.spent()) / self.sharing


def _gone(file: Path) -> None:
    with suppress(OSError):
        file.unlink()
