"""What benchmarks share: commands, time, folders, options of the command line."""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from .made import ROOT

GREYGATE = str(Path(sys.executable).with_name("greygate"))
VERILATOR = ("g++", "make", "perl")  # with which it builds simulations
PEERS = ROOT / "build" / "peers" / "bin" / "python"

Limit = Annotated[float, "seconds of processor time for each tool"]
Jobs = Annotated[int, "processes"]
Peers = Annotated[Path, "interpreter with benchmarks/peers.txt; `make peers` sets up that of the default"]


def say(*what: object, sep: str = " ") -> None:
    """Tell the user how far it is."""
    print(*what, sep=sep, file=sys.stderr, flush=True)


@contextmanager
def scratch(prefix: str = "") -> Iterator[Path]:
    """A folder while it is needed."""
    with tempfile.TemporaryDirectory(prefix=prefix) as folder:
        yield Path(folder)


def stopwatch(clock: Callable[[], float] = time.perf_counter) -> Callable[..., float]:
    """What tells the seconds since, rounded to so many digits where they are given."""
    began = clock()
    return lambda digits=None: clock() - began if digits is None else round(clock() - began, digits)


def taken(work: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> list[float]:
    """Seconds of each call."""
    found = []
    for _ in range(repeats):
        watch = stopwatch(clock)
        work()
        found.append(watch())
    return found


def told(*words: object) -> dict:
    """What a command of greygate prints as JSON."""
    done = subprocess.run([GREYGATE, *map(str, words), "--json"], capture_output=True, text=True)
    if not done.stdout:
        sys.exit(done.stderr)
    return json.loads(done.stdout)


def versions(tools: list[str]) -> list[str]:
    """The first line that each says of its version."""
    asked = ([tool, "--version"] for tool in tools)
    return [subprocess.run(a, capture_output=True, text=True, check=True).stdout.splitlines()[0] for a in asked]
