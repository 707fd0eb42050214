"""Makes a Python of Linux lack what Windows lacks: POSIX modules, and calls of `os` and `signal`. Locks are msvcrt's.

A process that finds this folder in PYTHONPATH imports it before all else.
"""

import asyncio  # what it imports of POSIX is another module on Windows, as with the next
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import types
from contextlib import suppress

with suppress(ImportError):  # of the tests' own packages
    import platformdirs  # noqa: F401
    import serial.serialposix

    serial.serialposix.os = types.SimpleNamespace(**vars(os))  # on Windows pyserial opens a port by other calls

MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty")
CALLS = {
    os: ("O_NOFOLLOW", "O_NONBLOCK", "getuid", "geteuid", "fork", "forkpty", "sched_getaffinity", "chown", "mkfifo"),
    signal: ("SIGXCPU", "pthread_kill", "pthread_sigmask", "alarm", "setitimer"),
}


def locking(handle: int, mode: int, size: int, flock=fcntl.flock, kind=fcntl.LOCK_EX | fcntl.LOCK_NB) -> None:
    """As msvcrt.locking with LK_NBLCK: PermissionError where another has the lock."""
    try:
        flock(handle, kind)
    except BlockingIOError:
        raise PermissionError(13, "Permission denied") from None


KEPT = asyncio, shutil, subprocess, tempfile  # imported before
stand_in = types.ModuleType("msvcrt")
stand_in.LK_NBLCK, stand_in.locking = 2, locking
sys.modules |= {name: None for name in MODULES} | {"msvcrt": stand_in}
os.supports_effective_ids = set()
for module, names in CALLS.items():
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
