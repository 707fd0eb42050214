"""An FMU that runs in processes of its own: they may crash or hang without taking this one with them."""

import atexit
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Lock, Timer
from typing import Any, BinaryIO, cast

import numpy as np

from greygate import children
from greygate.errors import InputError, shown
from greygate.plants.fmu.archive import Archive, quoted
from greygate.plants.fmu.pipe import receive, send
from greygate.progress import once

OPENING = 60.0  # s in which an FMU has to begin
FIRST = 120.0  # s for a first run with a source, which is compiled before
RUNNING, TIMES = 20.0, 20.0  # s for any later run, or so many times as long as the longest
CRASHES = 5  # in trials: after so many nobody waits for more
INSTANT = 0.05  # s in which a process that has ended gets its exit code

Arrays = Mapping[str, np.ndarray]

_units: dict[str, "Unit"] = {}


class Died(Exception):
    """The FMU's process has ended, or was ended because it hung."""


class Refused(InputError):
    """The FMU itself says no: to values of its parameters, perhaps."""


class Unit:
    """An FMU of one digest. about: what its description says. asked: what it said itself when it first ran."""

    def __init__(self, archive: Archive, about: Mapping[str, Any]):
        self.path, self._idle, self._lock = archive.path, list[_Process](), Lock()
        self.longest, self.ran, self.died, self.fine = 0.0, set[str](), 0, False
        self._stack = ExitStack()
        atexit.register(self._stack.close)
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="greygate-")))
        archive.unpack(folder)
        library = archive.library(folder, about["identifier"])
        self.about = {**about, "folder": str(folder), "library": str(library)}
        first = self._started()
        self.asked = first.opened
        self._idle.append(first)

    def _started(self) -> "_Process":
        process = _Process(self)
        try:
            process.opened, _ = process.ask({"ask": "open", "about": self.about}, {}, OPENING)
        except Died as error:
            raise InputError(f"{self.path}: {error} when it begins; run it in another tool to see why") from None
        return process

    @contextmanager
    def lent(self) -> Iterator["_Process"]:
        """A process that nobody else uses meanwhile."""
        with self._lock:
            process = self._idle.pop() if self._idle else None
        process = process or self._started()
        try:
            yield process
        finally:
            if process.living:
                with self._lock:
                    self._idle.append(process)

    def run(self, process: "_Process", said: Mapping[str, Any], arrays: Arrays) -> tuple[int, np.ndarray]:
        """(first sample that is not finite or -1, states). A trial in which the FMU dies is not finite from 0 on.

        Raises InputError where it dies in its first run, or again and again.
        """
        first = said["source"] not in self.ran
        began = time.monotonic()
        try:
            told, found = process.ask(said, arrays, FIRST if first else max(RUNNING, TIMES * self.longest))
        except Died as error:
            self.died += 1
            if not self.ran or self.died > CRASHES:
                raise InputError(
                    f"{self.path}: {error} while it is simulated; run it in another tool to see why"
                ) from None
            return 0, np.full((len(arrays["inputs"]), arrays["starts"].shape[1]), np.nan)
        except Refused:
            if not self.ran:
                raise
            return 0, np.full((len(arrays["inputs"]), arrays["starts"].shape[1]), np.nan)
        self.longest = max(self.longest, 0.0 if first else time.monotonic() - began)
        self.ran.add(said["source"])
        if told["failed"] >= 0 and told["logged"] and not self.fine:
            once(f"{self.path}: it says {shown(told['logged'])}")
        self.fine = self.fine or told["failed"] < 0
        return told["failed"], found["out"]


class _Process:
    """A process with an instance of an FMU."""

    opened: dict[str, Any]

    def __init__(self, unit: Unit):
        self.path, self._stack = unit.path, ExitStack()
        unit._stack.callback(self._stack.close)
        command = children.python("-m", "greygate.plants.fmu.child")
        self._process = self._stack.enter_context(
            children.started(command, stdin=children.PIPE, stdout=children.PIPE, stderr=children.DEVNULL)
        )
        self._to: BinaryIO = cast(Any, self._process.stdin).buffer
        self._from: BinaryIO = cast(Any, self._process.stdout).buffer
        self.living, self.expired = True, False

    def ask(self, said: Mapping[str, Any], arrays: Arrays, most: float) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Its answer within `most` s. Raises Died, and InputError where the FMU refuses."""
        late = Timer(most, self._expire)
        late.daemon = True
        late.start()
        try:
            send(self._to, said, arrays)
            told, found = receive(self._from)
        except (OSError, EOFError, ValueError):
            late.cancel()
            raise self._dead(most) from None
        except BaseException:
            self._end()
            raise
        finally:
            late.cancel()
        if "error" in told:
            problem = f"{self.path}: {quoted(told['error'])}"
            raise Refused(problem) if told["own"] else InputError(problem)
        return told, found

    def _end(self) -> None:
        self.living = False
        self._stack.close()

    def _expire(self) -> None:
        self.expired = True
        children.kill(self._process)

    def _dead(self, most: float) -> Died:
        code = None
        if not self.expired:
            try:
                code = self._process.wait(INSTANT)
            except children.TimeoutExpired:
                code = None
        self._end()
        if self.expired:
            return Died(f"does not answer within {most:g} s")
        return Died(f"crashes (signal {-code})" if code and code < 0 else f"ends its process (exit code {code})")


def of(archive: Archive, about: Mapping[str, Any]) -> Unit:
    """The running FMU of an archive: one in this process, whatever reads it."""
    key = archive.digest + repr(sorted(about.items()))
    if key not in _units:
        _units[key] = Unit(archive, about)
    return _units[key]


class Loop:
    """What runs a plant, in the process of an FMU. kind: the loop's source.

    at: (process, what `Simulated.lent` says to it).
    """

    def __init__(self, unit: Unit, kind: str, text: str):
        self.unit, self.kind, self.text = unit, kind, text

    def restarted(
        self, starts: np.ndarray, restarts: np.ndarray, reset: np.ndarray, inputs: np.ndarray, parameters: np.ndarray,
        low: np.ndarray, high: np.ndarray, rate: np.ndarray, h: float, substeps: int, out: np.ndarray, at: Any,
    ) -> int:  # fmt: skip
        process, of = at
        said = {**of, "ask": "run", "loop": self.kind, "source": self.text, "step": float(h), "substeps": int(substeps)}
        arrays = {
            "starts": np.asarray(starts, float), "restarts": np.asarray(restarts, np.int64), "reset": reset,
            "inputs": inputs, "parameters": parameters, "low": low, "high": high, "rate": rate,
        }  # fmt: skip
        failed, out[:] = self.unit.run(process, said, arrays)
        return failed
