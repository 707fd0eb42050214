"""A process apart that opens mutants of files: one engine for the fuzz of every parser.

The permitted endings are success and an `InputError` of one short line, within `LIMIT` seconds, without a warning,
without a file written, and within `MEMORY`.
"""

import multiprocessing
import os
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from malformed import Mutant, mutant

from greygate.errors import InputError

LIMIT = 5.0  # s of processor time; a mutant that takes more hangs
PATIENCE = 20.0  # s by the clock, after which the process is killed: other work may share the processor
MEMORY = 2 << 30  # bytes beyond what the process holds when it starts
LONGEST = 500  # characters of a message, the folder's name not counted
ROOT = Path(__file__).parent.parent


class Escape(BaseException):
    """A reader wrote, or started something."""


@dataclass(frozen=True)
class Ending:
    """How opening a mutant ended. kind: "accepted", "refused", or what is not permitted."""

    kind: str
    message: str = ""
    seconds: float = 0.0

    @property
    def permitted(self) -> bool:
        return self.kind in ("accepted", "refused")


_FORBIDDEN = ("os.system", "os.exec", "os.posix_spawn", "os.fork", "os.mkdir", "os.rename", "os.remove", "os.rmdir",
              "os.symlink", "os.link", "os.truncate", "os.chmod", "subprocess.Popen", "socket.connect",
              "shutil.rmtree", "ctypes.dlopen", "webbrowser.open")  # fmt: skip
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class _Guard:
    """An audit hook that lets nothing be written or started while it is armed, and tells what was tried."""

    def __init__(self):
        self.armed, self.tried = False, ""
        sys.addaudithook(self)

    def __call__(self, event: str, arguments: tuple) -> None:
        if not self.armed:
            return
        if event in _FORBIDDEN or (event == "open" and arguments[2] & _WRITING and arguments[0] != os.devnull):
            self.tried = f"{event} {arguments[0]!r}"[:LONGEST]
            raise Escape(self.tried)


def _serve(connection, folder: Path) -> None:
    """Open what comes through the connection, (entrance, files, guarded), in `folder`; answer with an `Ending`."""
    warnings.simplefilter("error")
    sys.dont_write_bytecode = True
    guard = _Guard()
    os.chdir(folder)
    while True:
        entrance, files, guarded = connection.recv()  # which imports what the entrance needs
        connection.send("begun")
        for old in folder.iterdir():
            shutil.rmtree(old) if old.is_dir() else old.unlink()
        for name, data in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
        with _little_memory() if guarded else nullcontext():
            guard.armed, guard.tried = guarded, ""
            ending = _open(entrance, folder, guard)
        connection.send(ending)


@contextmanager
def _little_memory() -> Iterator[None]:
    """No more than `MEMORY` beyond what the process holds."""
    try:
        import resource
    except ImportError:
        yield
        return
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (before, most))


def _open(entrance: Callable[[Path], None], folder: Path, guard: _Guard) -> Ending:
    start, kind, message = time.process_time(), "accepted", ""
    try:
        entrance(folder)
    except InputError as error:
        message = str(error).replace(str(folder), "FOLDER")
        kind = "refused" if len(message) <= LONGEST else "long message"
        if not message.isprintable():  # a line break, a control character, or what turns the direction of writing
            kind = "message with control characters"
    except BaseException as error:  # whatever it is, it is told
        guard.armed = False
        frames = [f for f in traceback.extract_tb(error.__traceback__) if _ours(Path(f.filename))]
        where = f"{Path(frames[-1].filename).name}:{frames[-1].name}" if frames else "?"
        kind, message = f"{type(error).__name__} in {where}", str(error)[:LONGEST]
    finally:
        guard.armed = False
    if guard.tried:
        kind, message = "escape", guard.tried
    seconds = time.process_time() - start
    return Ending(kind if seconds < LIMIT else f"hang ({kind})", message, seconds)


def _ours(path: Path) -> bool:
    """Whether the file is the product's."""
    return path.is_relative_to(ROOT) and not {"tests", ".venv"} & set(path.relative_to(ROOT).parts)


class Sandbox:
    """A process apart that opens files; one that hangs or crashes is replaced."""

    def __init__(self, patience: float = PATIENCE):
        self.patience, self._process = patience, None

    def open(self, entrance: Callable[[Path], None], files: Mapping[str, bytes], guarded: bool = True) -> Ending:
        """guarded: nothing may be written. Only for files of our own, which may fill caches, it is False."""
        if self._process is None:
            context = multiprocessing.get_context("spawn")
            self._connection, theirs = context.Pipe()
            self._folder = tempfile.TemporaryDirectory(prefix="greygate_fuzz_")
            self._process = context.Process(target=_serve, args=(theirs, Path(self._folder.name)), daemon=True)
            self._process.start()
            theirs.close()
        try:
            self._connection.send((entrance, dict(files), guarded))
            self._connection.recv()
            if self._connection.poll(self.patience if guarded else None):
                return self._connection.recv()
            ending = Ending("hang", f"no answer within {self.patience:g} s", self.patience)
        except (EOFError, ConnectionError):
            ending = Ending("crash", "the process ended")
        self.close()
        return ending

    def close(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None
            self._connection.close()
            self._folder.cleanup()


@dataclass
class Tally:
    """What became of the mutants of one parser.

    failures: kind of ending -> the smallest mutant that ended so, its message, how many there were.
    """

    mutants: int = 0
    accepted: int = 0
    refused: int = 0
    slowest: float = 0.0
    failures: dict[str, tuple[Mutant, str, int]] = field(default_factory=dict)

    def count(self, made: Mutant, ending: Ending) -> None:
        self.mutants += 1
        self.slowest = max(self.slowest, ending.seconds)
        if ending.permitted:
            setattr(self, ending.kind, getattr(self, ending.kind) + 1)
            return
        kept, message, times = self.failures.get(ending.kind, (made, ending.message, 0))
        if len(made.files[made.changed]) < len(kept.files[kept.changed]):
            kept, message = made, ending.message
        self.failures[ending.kind] = kept, message, times + 1

    def as_dict(self) -> dict:
        failed = {kind: times for kind, (_, _, times) in self.failures.items()}
        hangs = sum(times for kind, times in failed.items() if kind.startswith("hang"))
        return {
            "mutants": self.mutants,
            "accepted": self.accepted,
            "refused": self.refused,
            "tracebacks": sum(failed.values()) - hangs,
            "hangs": hangs,
            "slowest_s": round(self.slowest, 3),
        }


def campaign(
    box: Sandbox,
    entrance: Callable[[Path], None],
    seeds: list[dict[str, bytes]],
    targets: tuple[str, ...],
    mutants: int,
) -> Tally:
    """Open so many mutants of the seeds; the same ones every time."""
    tally = Tally()

    @settings(
        max_examples=mutants, derandomize=True, database=None, deadline=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.sampled_from(seeds), st.randoms(use_true_random=False))
    def probe(seed, rng):
        made = mutant(rng, seed, targets)
        tally.count(made, box.open(entrance, made.files))

    probe()
    return tally
