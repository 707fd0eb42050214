"""Starts every other process of greygate: tools, readers, simulations, and workers that share a task.

What is started here imports no Python from the folder it runs in, which may be a stranger's, and ends with whoever
started it, together with what it started in turn, even if that was killed.
"""

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from subprocess import DEVNULL as DEVNULL
from subprocess import PIPE as PIPE
from subprocess import STDOUT as STDOUT
from subprocess import CompletedProcess
from subprocess import Popen as Popen
from subprocess import TimeoutExpired as TimeoutExpired
from threading import Thread
from typing import Any, Final, Literal

from greygate.system import Tree, outlived

SAFE = "PYTHONSAFEPATH"  # if it is set, Python puts neither the current folder nor that of a script on its path
SEARCHED = "PYTHONPATH"
KILLED = "a process of the work was killed twice, for lack of memory perhaps; give fewer --jobs, or free memory"
DIED: Final = object()  # instead of the result of a task whose process was killed twice

_running: dict[Popen, Tree] = {}


def python(*words: str) -> list[str]:
    """The command of a Python that imports nothing from the folder in which it runs."""
    return [sys.executable, "-P", *words]


@contextmanager
def started(
    command: Sequence[str],
    *,
    cwd: Path | str | None = None,
    env: Mapping[str, str] | None = None,
    stdin: Any = DEVNULL,
    stdout: Any = None,
    stderr: Any = None,
    safe: bool = True,
) -> Iterator[Popen[str]]:
    """Start a command in a session of its own; after the block it and all that it started are killed.

    env: variables beside our own. safe: False for a program that the user names, which may import from where it is.
    Raises FileNotFoundError if there is no such program.
    """
    variables = {**os.environ, **(env or {})}
    variables = _safe(variables) if safe else variables
    program = shutil.which(command[0], path=variables.get("PATH"))
    if program is None:
        raise FileNotFoundError(2, "no such program", command[0])
    options = {"cwd": cwd, "env": variables, "stdin": stdin, "stdout": stdout, "stderr": stderr}
    tree = Tree(
        [os.path.abspath(program), *command[1:]], {**options, "text": True, "encoding": "utf-8", "errors": "replace"}
    )
    process = tree.process
    _running[process] = tree
    try:
        yield process
    finally:
        tree.kill()
        for stream in filter(None, (process.stdin, process.stdout, process.stderr)):
            with suppress(OSError):
                stream.close()
        process.wait()
        del _running[process]
        tree.close()


def ran(
    command: Sequence[str],
    *,
    timeout: float | None = None,
    cwd: Path | str | None = None,
    env: Mapping[str, str] | None = None,
) -> CompletedProcess[str]:
    """Run a command to its end and keep what it prints.

    timeout: seconds after which it and all that it started are killed and TimeoutExpired is raised.
    """
    with started(command, cwd=cwd, env=env, stdout=PIPE, stderr=PIPE) as process:
        said, complained = process.communicate(timeout=timeout)
    return CompletedProcess(list(command), process.returncode, said, complained)


def stop() -> None:
    """Kill all that runs. Whoever waits for it in another thread goes on with an error."""
    for process in list(_running):
        kill(process)


def kill(process: Popen) -> None:
    """Kill a process that was `started`, with all that it started."""
    if (tree := _running.get(process)) is not None:
        tree.kill()


def _safe(variables: Mapping[str, str]) -> dict[str, str]:
    """The variables, with which Python imports nothing from the current folder."""
    found = dict(variables) | {SAFE: "1", "PYTHONIOENCODING": "utf-8"}
    if SEARCHED in found:  # an empty entry is the current folder
        found[SEARCHED] = os.pathsep.join(filter(os.path.isabs, found[SEARCHED].split(os.pathsep)))
    return found


# -- workers ---------------------------------------------------------------------------------------------------------


def workers(jobs: int | None, tasks: Iterable[Callable[[], Any]], in_order: bool = True) -> Iterator[Any]:
    """Yield the results of tasks that run in `jobs` processes, or on the backend that joblib's configuration names.

    in_order: else as they come. Where a process is killed, its task is tried once more, alone; DIED is its result if
    that is killed too. All others go on in new processes.
    """
    left: dict[int, Callable[[], Any]] = dict(enumerate(tasks))
    found: dict[int, Any] = {}
    after, suspected = 0, list[int]()
    with tempfile.TemporaryDirectory(prefix="greygate-") as place_of, _safely():
        begun = Path(place_of, "begun")
        while left:
            alone = suspected.pop(0) if suspected else None
            now = left if alone is None else {alone: left[alone]}
            begun.write_bytes(b"")
            with closing(_passed(jobs, {k: partial(_noted, str(begun), k, task) for k, task in now.items()})) as passed:
                while True:
                    try:
                        place, result = next(passed)
                    except StopIteration:
                        break
                    except _broken():
                        if alone is None:
                            noted = {int(line) for line in begun.read_text(encoding="ascii").split()}
                            suspected = [k for k in left if k in noted] or list(left)
                            break
                        place, result = alone, DIED
                    del left[place]
                    if not in_order:
                        yield result
                        continue
                    found[place] = result
                    while after in found:
                        yield found.pop(after)
                        after += 1


def _passed(jobs: int | None, tasks: Mapping[int, Callable[[], Any]]) -> Generator[tuple[int, Any]]:
    """(place, result) of each task, as they come. Raises what `_broken` names where a process is killed."""
    import joblib
    from joblib._parallel_backends import LokyBackend

    backend = joblib.parallel.get_active_backend()[0]
    kind: Literal["generator_unordered", "list"]
    kind = "generator_unordered" if getattr(backend, "supports_return_generator", False) else "list"
    watched = {"initializer": follow, "initargs": (os.getpid(),)} if isinstance(backend, LokyBackend) else {}
    parallel = joblib.Parallel(jobs, return_as=kind, **watched)
    yield from parallel(joblib.delayed(_placed)(place, task) for place, task in tasks.items())


def _placed(place: int, task: Callable[[], Any]) -> tuple[int, Any]:
    return place, task()


def _noted(begun: str, place: int, task: Callable[[], Any]) -> Any:
    """Run a task; first tell the one who may have to find out whose process was killed."""
    with suppress(OSError):  # a worker of another computer
        file = os.open(begun, os.O_WRONLY | os.O_APPEND)
        try:
            os.write(file, b"%d\n" % place)
        finally:
            os.close(file)
    return task()


def _broken() -> type[Exception]:
    """What joblib raises where a process was killed."""
    from joblib.externals.loky import BrokenProcessPool

    return BrokenProcessPool


def follow(parent: int) -> None:
    """End this process when its parent has ended, however that was."""

    def watch() -> None:
        outlived(parent)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


@contextmanager
def _safely() -> Iterator[None]:
    """Let what libraries start within the block import nothing from the current folder."""
    before = {name: os.environ[name] for name in (SAFE, SEARCHED) if name in os.environ}
    os.environ.update(_safe(os.environ))
    try:
        yield
    finally:
        os.environ.pop(SAFE, None)
        os.environ.update(before)
