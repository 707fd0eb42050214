"""Fails or kills a command at the n-th time that it touches the disk below a folder.

A fork of the test process runs the command, so that its imports are paid once and a kill leaves what it would leave.
"""

import builtins
import contextlib
import ctypes
import errno
import io
import json
import os
import sys
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from greygate import cli, files, system

KILLED = 99
LEAVING = ("unlink", "remove", "rmdir", "flock")  # after which a name may be left that a rerun removes


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code (KILLED: by the shim), stderr, and the touch at which the shim struck, if it did.

    touch: what it was, such as "rename out". touches: how many there were.
    """

    code: int
    error: str
    touch: str | None
    touches: int


class Shim:
    """Counts touches of the disk below `root`; strikes at the n-th: "fail" says that the disk is full, "kill" ends."""

    def __init__(self, root: Path, at: int, how: str):
        self.root, self.at, self.how = str(root), at, how
        self.count, self.touch = 0, None

    def strikes(self, what: str, path, folder: int | None = None) -> bool:
        if isinstance(path, int):
            path = os.readlink(f"/proc/self/fd/{path}")
        elif folder is not None:
            path = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), os.fsdecode(path))
        if not os.path.abspath(os.fsdecode(path)).startswith(self.root):
            return False
        self.count += 1
        if self.count == self.at:
            self.touch = f"{what} {os.path.basename(path)}"
        return self.count == self.at

    def strike(self, path) -> None:
        if self.how == "kill":
            os._exit(KILLED)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), *([] if isinstance(path, int) else [str(path)]))

    def wrapped(self, module, name: str) -> None:
        real = getattr(module, name)

        def call(path, *arguments, **options):
            if self.strikes(name.strip("_"), path, options.get("dir_fd")):
                self.strike(path)
            return real(path, *arguments, **options)

        setattr(module, name, call)

    def install(self) -> None:
        os.fsync = lambda handle: None  # slow, and a kill of the process alone loses nothing that it wrote
        for name in ("mkdir", "rmdir", "unlink", "remove", "rename", "replace", "chmod", "fsync"):
            self.wrapped(os, name)
        self.wrapped(system.fcntl, "flock")
        self.wrapped(files, "exchange")
        opened, made = io.open, os.open

        def open_file(path, mode="r", *arguments, **options):
            if mode in ("r", "rb"):
                return opened(path, mode, *arguments, **options)
            if self.strikes("open", path):
                self.strike(path)
            return _File(opened(path, mode, *arguments, **options), path, self)

        def open_handle(path, flags, *arguments, **options):
            if flags & os.O_CREAT and self.strikes("create", path):
                self.strike(path)
            return made(path, flags, *arguments, **options)

        io.open = builtins.open = open_file
        os.open = open_handle


class _File:
    """A file whose writes may go through by half."""

    def __init__(self, file, path, shim: Shim):
        self._file, self._path, self._shim = file, path, shim

    def write(self, data):
        if self._shim.strikes("write", self._path):
            self._file.write(data[: len(data) // 2])
            self._file.flush()
            self._shim.strike(self._path)
        return self._file.write(data)

    def __getattr__(self, name):
        return getattr(self._file, name)

    def __enter__(self):
        return self

    def __exit__(self, *raised):
        self._file.close()


def unforked(arguments: list) -> None:
    """`greygate ARGUMENTS` in this process, so that its forks find what it imports."""
    sys_argv, sys.argv = sys.argv, ["greygate", *map(str, arguments)]
    quiet = io.StringIO()
    with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet), contextlib.suppress(SystemExit):
        cli.run()
    sys.argv = sys_argv


def struck(arguments: list, root: Path, at: int, how: str, before: Callable[[], None] = lambda: None) -> Ended:
    """`greygate ARGUMENTS` in a fork, where `before` runs first. Past the last touch it runs to its end unharmed."""
    out, into = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of Python 3.12, that a thread may hold a lock
        child = os.fork()
    if child == 0:
        _run(arguments, Shim(root, at, how), into, before)
    os.close(into)
    with open(out) as file:
        said = file.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return Ended(**json.loads(said)) if code != KILLED else Ended(KILLED, "", "killed", 0)


def _run(arguments: list, shim: Shim, into: int, before: Callable[[], None]) -> None:
    code, error = 70, io.StringIO()
    try:
        sys.argv = ["greygate", *map(str, arguments)]
        before()
        shim.install()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(error):
            cli.run()
    except SystemExit as ended:
        code = ended.code or 0
    except BaseException:
        error.write(traceback.format_exc())
    ended = {"code": code, "error": error.getvalue(), "touch": shim.touch, "touches": shim.count}
    os.write(into, json.dumps(ended).encode())
    os._exit(0)


def without_exchange() -> None:
    """As on a system or a file system that cannot swap two names."""
    files.exchange = lambda one, other: False


def libc_has_exchange() -> bool:
    return hasattr(ctypes.CDLL(None), "renameat2")
