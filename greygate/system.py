"""What differs between Linux, macOS and Windows: locks, limits, process trees, rights. No other file asks for it.

Where a system cannot do what the others do, the call says so by its result or an error; it never does less in silence.
"""

import ctypes
import errno
import importlib
import mmap
import os
import signal
import stat
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from subprocess import Popen
from typing import Any


def _module(name: str) -> Any:
    """A module that only some systems have; None elsewhere."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


fcntl, msvcrt, resource = map(_module, ("fcntl", "msvcrt", "resource"))
LOCKS = fcntl is not None or msvcrt is not None
WINDOWS = os.name == "nt"
LACKING = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK)  # the file system does not offer the operation
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # linux/fcntl.h, linux/fs.h
UNBLOCKED = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)  # a pipe of that name blocks nobody
OWN = getattr(os, "O_NOFOLLOW", 0)  # what a link of that name leads to is not opened
WATCH = 0.5  # s between two looks of a worker at its parent
NO_LOCKS = "this Python has neither fcntl nor msvcrt, so no lock holds"

# -- files -----------------------------------------------------------------------------------------------------------


def taken(lock: Path) -> int | None:
    """Handle of the locked file, which still has its name then; None if another process holds the lock.

    Raises OSError if it cannot be made, or on a system without locks.
    """
    while True:
        if not OWN and lock.is_symlink():
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(lock))
        # opened for writing, since NFS locks only such files
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | OWN | UNBLOCKED, 0o644)
        try:
            _lock(handle)
            if os.path.samestat(os.fstat(handle), os.stat(lock)):
                return handle
        except FileNotFoundError:  # its holder has ended and removed it
            pass
        except BlockingIOError:
            os.close(handle)
            return None
        except OSError as error:
            if error.errno in LACKING:
                return handle
            os.close(handle)
            raise
        os.close(handle)


def _lock(handle: int) -> None:
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    elif msvcrt is not None:
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from error
    else:
        raise OSError(errno.EPERM, NO_LOCKS)


def release(handle: int, lock: Path) -> None:
    """Give back what was `taken`. Windows removes no open file, and no file that another process has opened since."""
    if fcntl is None:
        os.close(handle)
    with suppress(OSError):
        lock.unlink(missing_ok=True)
    if fcntl is not None:
        os.close(handle)


def exchange(one: Path, other: Path) -> bool:
    """Swap two names in one step; False if the system or the file system cannot do that."""
    swap = None if WINDOWS else getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if swap is None:
        return False
    if swap(AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in LACKING:
        return False
    raise OSError(code, os.strerror(code), str(other))


def sync(path: Path) -> None:
    """Sync a file or folder to the disk. Windows opens no folder: there its file system keeps the names in order."""
    if WINDOWS and path.is_dir():
        return
    handle = os.open(path, os.O_RDWR if WINDOWS else os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in LACKING:
            raise
    finally:
        os.close(handle)


def user() -> str:
    """What tells this user's folders from those of others."""
    return str(os.getuid()) if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")


def writable(place: Path) -> bool:
    """Whether this process may write there."""
    return os.access(place, os.W_OK, effective_ids=os.access in os.supports_effective_ids)


def private(folder: Path) -> bool:
    """Whether it is a folder of ours that others cannot write. Without POSIX rights: whether it lies in our home."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or not writable(folder):
        return False
    if not hasattr(os, "getuid"):
        return folder.resolve().is_relative_to(Path.home().resolve())
    return found.st_uid == os.getuid() and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


# -- limits ----------------------------------------------------------------------------------------------------------

OUT_OF_TIME = -int(getattr(signal, "SIGXCPU", 0)) or None  # exit code of a process that computed for too long


def limit(memory: int, seconds: float, written: int) -> bool:
    """Bound this process, never above a limit that is there already; whether the system holds it to all of them.

    memory: bytes beside what it takes now. seconds: of computing beside what it took. written: bytes of a file.
    """
    if resource is None:
        return False
    memory += _now()
    used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    wanted = {
        resource.RLIMIT_AS: memory, resource.RLIMIT_CPU: int(used + seconds) + 1, resource.RLIMIT_FSIZE: written,
        resource.RLIMIT_CORE: 0,
    }  # fmt: skip
    try:
        for what, most in wanted.items():
            soft, hard = resource.getrlimit(what)
            least = min(limit for limit in (most, soft, hard) if limit != resource.RLIM_INFINITY)
            resource.setrlimit(what, (least, hard))
    except (OSError, ValueError):
        return False
    return _refused(memory)


def _now() -> int:
    """Bytes of address space that this process takes; 2 GiB where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    except (OSError, ValueError):
        return 2 << 30


def _refused(memory: int) -> bool:
    """Whether the system refuses so many bytes: macOS takes the limit and does not hold to it."""
    try:
        mmap.mmap(-1, memory).close()
    except (OSError, MemoryError, OverflowError, ValueError):
        return True
    return False


def memory_limit() -> int | None:
    """Bytes that this process may take; None without a limit."""
    if resource is None:
        return None
    told = [most for most in resource.getrlimit(resource.RLIMIT_AS) if most != resource.RLIM_INFINITY]
    return min(told, default=None)


# -- processes -------------------------------------------------------------------------------------------------------

# Runs a command beside a pipe whose other end its starter alone holds: where that closes, the whole group is killed.
# It ends as the command ends, by the same signal if that was one.
SUPERVISOR = """
import os, resource, signal, sys
pipe, command = int(sys.argv[1]), sys.argv[2:]
def ended(*_):
    pid, status = os.waitpid(child, os.WNOHANG)
    if pid:
        code = os.waitstatus_to_exitcode(status)
        if code < 0:
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            if -code != signal.SIGKILL:
                signal.signal(-code, signal.SIG_DFL)
            os.kill(os.getpid(), -code)
        os._exit(code)
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCHLD])
signal.signal(signal.SIGCHLD, ended)
try:
    child = os.posix_spawn(
        command[0], command, os.environ, file_actions=[(os.POSIX_SPAWN_CLOSE, pipe)], setsigmask=[],
        setsigdef=[signal.SIGPIPE, signal.SIGXFSZ, signal.SIGINT],
    )
except OSError as error:
    sys.exit(f"{command[0]}: {error.strerror}")
nothing = os.open(os.devnull, os.O_RDWR)
for own in range(3):
    os.dup2(nothing, own)
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGCHLD])
os.read(pipe, 1)
os.killpg(0, signal.SIGKILL)
"""


class Tree:
    """A process and all that it starts in turn; they end together, and with this process, even if it is killed."""

    def __init__(self, command: Sequence[str], options: Mapping[str, Any]):
        self.process: Popen[str]
        self._held: list[Callable[[], object]] = []
        (self._in_job if WINDOWS else self._supervised)(command, options)

    def _supervised(self, command: Sequence[str], options: Mapping[str, Any]) -> None:
        read, held = os.pipe()
        self._held = [lambda: os.close(read), lambda: os.close(held)]
        whole = [sys.executable, "-I", "-S", "-c", SUPERVISOR, str(read), *command]
        try:
            self.process = Popen(whole, pass_fds=[read], start_new_session=True, **options)
        except BaseException:
            self.close()
            raise

    def _in_job(self, command: Sequence[str], options: Mapping[str, Any]) -> None:
        self.job = Job()
        self._held = [self.job.close]
        self.process = Popen(list(command), **options)
        try:
            self.job.take(self.process)
        except BaseException:
            self.process.kill()
            self.close()
            raise

    def kill(self) -> None:
        """Kill all of them."""
        if WINDOWS:
            self.job.kill()
        else:
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)

    def close(self) -> None:
        """Give back what held them together."""
        while self._held:
            self._held.pop()()


class _Limits(ctypes.Structure):
    """JOBOBJECT_EXTENDED_LIMIT_INFORMATION of winnt.h."""

    _fields_ = (
        ("times", ctypes.c_int64 * 2), ("flags", ctypes.c_uint32), ("working_set", ctypes.c_size_t * 2),
        ("active", ctypes.c_uint32), ("affinity", ctypes.c_size_t), ("classes", ctypes.c_uint32 * 2),
        ("counts", ctypes.c_uint64 * 6), ("memory", ctypes.c_size_t * 4),
    )  # fmt: skip


class Job:
    """A job object of Windows: what is in it ends when its handle is closed, and a process that ends closes its own."""

    KILL_ON_CLOSE, EXTENDED = 0x2000, 9  # JOB_OBJECT_LIMIT_KILL_ON_JOB_CLOSE, JobObjectExtendedLimitInformation

    def __init__(self) -> None:
        self.handle = ctypes.c_void_p(_kernel("CreateJobObjectW", ctypes.c_void_p, None, None))
        limits = _Limits(flags=self.KILL_ON_CLOSE)
        _kernel(
            "SetInformationJobObject", ctypes.c_int, self.handle, self.EXTENDED, ctypes.byref(limits),
            ctypes.sizeof(limits),
        )  # fmt: skip

    def take(self, process: Popen) -> None:
        """Put a process into it, before that has started another: Python needs longer to begin than this."""
        handle = ctypes.c_void_p(int(vars(process)["_handle"]))
        _kernel("AssignProcessToJobObject", ctypes.c_int, self.handle, handle)

    def kill(self) -> None:
        _kernel("TerminateJobObject", ctypes.c_int, self.handle, 1)

    def close(self) -> None:
        _kernel("CloseHandle", ctypes.c_int, self.handle)


def _kernel(name: str, kind: Any, *arguments: Any) -> Any:
    """Call a function of kernel32. Raises OSError where it fails, so that nothing runs without what it was to do."""
    library = vars(ctypes)["WinDLL"]("kernel32", use_last_error=True)
    function = getattr(library, name)
    function.restype = kind
    answer = function(*arguments)
    if not answer:
        code = vars(ctypes)["get_last_error"]()
        raise OSError(errno.EPERM, f"{name} failed (Windows error {code})")
    return answer


def outlived(parent: int) -> None:
    """Return when the parent of this process has ended, however that was."""
    if WINDOWS:
        synchronize, forever = 0x100000, 0xFFFFFFFF
        handle = ctypes.c_void_p(_kernel("OpenProcess", ctypes.c_void_p, synchronize, 0, parent))
        vars(ctypes)["WinDLL"]("kernel32").WaitForSingleObject(handle, forever)
        return
    while os.getppid() == parent:
        time.sleep(WATCH)


def cores() -> int:
    """How many cores this process may use: those that it is pinned to, where the system pins."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def again(thread: int, number: int) -> None:
    """Send a signal to a thread of this process; on Windows the main thread gets it where it computes."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(thread, number)
    else:
        importlib.import_module("_thread").interrupt_main(number)
