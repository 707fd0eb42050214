"""The one way files and folders are written: whole or not at all, and over nothing but what greygate wrote.

What is to be NAME is written as `.NAME.greygate-new` beside it, reaches the disk, and takes the name in one rename.
`.NAME.greygate-lock` is held meanwhile; a kill releases it, whatever is left of it. So whoever holds the lock knows
that other names of this form are of a writer that was killed, and removes them.

Where one rename is not enough (files that belong together; a folder on a file system that cannot exchange two names)
`.NAME.greygate-commit` is the journal: it appears when every new file is whole, and while it stands the new files
count. The next reader or writer finishes the renames and removes it.

A folder is greygate's only if its manifest.json says so; a file that it does not list, or that was changed since, is
never removed. Every OSError leaves here as an InputError.
"""

import ctypes
import errno
import fcntl
import hashlib
import json
import os
import re
import shutil
import stat
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from greygate.contents import contents
from greygate.errors import InputError, shown
from greygate.reading import line, named, read_json, table, whole
from greygate.version import __version__

MANIFEST = "manifest.json"
SCHEMA = 1  # of the manifest
PATIENCE = 5.0  # s that a writer or reader of files waits for another, who needs milliseconds
NAMED = 3  # files that a refusal names
OURS = re.compile(r"(.*/)?\.[^/]+\.greygate-(new|old|lock|commit)")
LACKING = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOLCK)  # the file system does not have that
AT_FDCWD, RENAME_EXCHANGE = -100, 2  # linux/fcntl.h, linux/fs.h

_staged: set[Path] = set()  # folders under way: what is written in them needs no care of its own


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a path to write; it takes the place of `path` only if the block succeeds. As `replacing_all`."""
    with replacing_all([path]) as (new,):
        yield new


@contextmanager
def replacing_all(paths: Sequence[Path | str], durable: bool = True) -> Iterator[list[Path]]:
    """Yield paths to write; those written take the places of `paths`, files of one folder, all of them or none.

    durable: they are on the disk when the block ends, whatever happens to the machine.
    Raises InputError where the folder is missing or cannot be written, `paths` holds a link, no file or one twice, or
    another process keeps writing them.
    """
    paths = [Path(p) for p in paths]
    if len(set(paths)) < len(paths):
        raise InputError(f"{paths[0]}: two files would have this name; give another to one of them")
    if any(folder in _absolute(paths[0]).parents for folder in _staged):
        yield paths
        return
    with writing(paths[0]):
        for path in paths:
            if path.is_symlink() or (path.exists() and not path.is_file()):
                raise InputError(f"{path}: is no plain file; give the name of a file, or a new one")
        with locked(paths[0], PATIENCE):
            _finish(paths)
            new, commit = [_beside(p, "new") for p in paths], _beside(paths[0], "commit")
            try:
                for path in new:
                    path.unlink(missing_ok=True)
                yield new
                written = [p for p in new if p.exists()]
                for path in written if durable else ():
                    _sync(path)
                if len(written) > 1:
                    commit.touch()
                    if durable:
                        _sync(commit.parent)
                    _finish(paths)
                for path, final in zip(new, paths, strict=True):
                    if path in written and len(written) == 1:
                        path.replace(final)
                if durable:
                    _sync(commit.parent)
            finally:
                for path in new if not commit.exists() else ():
                    with suppress(OSError):
                        path.unlink(missing_ok=True)


def settle(paths: Sequence[Path | str]) -> None:
    """Finish what a killed writer of these files left, if all was written by then."""
    paths = [Path(p) for p in paths]
    if _beside(paths[0], "commit").exists():
        with writing(paths[0]), locked(paths[0], PATIENCE):
            _finish(paths)


def read_all(paths: Sequence[Path | str]) -> list[bytes | None]:
    """Contents of files that belong together, from before or after any `replacing_all`; None where there is none.

    Raises OSError where one cannot be read, InputError as `settle` or while they are written over and over.
    """
    paths = [Path(p) for p in paths]
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        settle(paths)
        before = _state(paths)
        found = [contents(path) if path.exists() else None for path in paths]
        if before == _state(paths) and not _beside(paths[0], "commit").exists():
            return found
    raise InputError(f"{paths[0]}: another greygate keeps writing it; wait for it")


def _state(paths: Sequence[Path]) -> list[tuple | None]:
    found = [p.stat() if p.exists() else None for p in paths]
    return [s and (s.st_ino, s.st_mtime_ns, s.st_size) for s in found]


@contextmanager
def replacing_folder(path: Path | str, kind: str, later: str = "(?!)") -> Iterator[Path]:
    """Yield a folder to fill; with its manifest it takes the place of `path` only if the block succeeds.

    kind: command that writes such folders. later: pattern of the files that other commands add, which go with it.
    Parents are made. Raises InputError, before the block runs, where something stands there that the command did not
    write (`replaceable`), or while another process writes it.
    """
    path = Path(path)
    replaceable(path, kind, later)
    new, old = _beside(path, "new"), _beside(path, "old")
    with making(path.parent), writing(path, "make this folder"), locked(path):
        settle_folder(path, kind, later, held=True)
        replaceable(path, kind, later)
        for left in (new, old):
            shutil.rmtree(left, ignore_errors=True)
        new.mkdir()
        _staged.add(_absolute(new))
        try:
            yield new
            write_manifest(new, kind)
            for folder, _, names in os.walk(new):
                for name in (*names, "."):
                    _sync(Path(folder, name))
            replaceable(path, kind, later)  # hours may lie between
            _put(new, path, kind, later)
        finally:
            _staged.discard(_absolute(new))
            if not _beside(path, "commit").exists():
                shutil.rmtree(new, ignore_errors=True)
                shutil.rmtree(old, ignore_errors=True)


def settle_folder(path: Path | str, kind: str, later: str = "(?!)", held: bool = False) -> None:
    """Finish the replacing of a folder that a kill broke off between its two renames. held: the lock is the caller's.

    kind, later: as in `replacing_folder`. Raises InputError for a folder that may not be replaced: anyone may have put
    a journal beside it.
    """
    path = Path(path)
    commit, new, old = (_beside(path, what) for what in ("commit", "new", "old"))
    if not commit.exists():
        return
    if not held:
        with writing(path), locked(path, PATIENCE):
            settle_folder(path, kind, later, held=True)
        return
    if new.exists():
        if path.exists():
            replaceable(path, kind, later)
            path.rename(old)
        new.rename(path)
        _sync(path.parent)
    commit.unlink(missing_ok=True)
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def making(folder: Path | str) -> Iterator[None]:
    """Make a folder and its parents; if the block fails, those go again that were made and are empty."""
    folder = Path(folder)
    missing = []
    try:
        with writing(folder, "make this folder"):
            missing = [p for p in (folder, *folder.parents) if not p.exists()]
            folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for made in missing:
            with suppress(OSError):
                made.rmdir()
        raise


@contextmanager
def writing(path: Path | str, do: str = "write here") -> Iterator[None]:
    """Turn an OSError of the block into an InputError on `path`, or on the other file that it names."""
    try:
        yield
    except OSError as error:
        other = str(error.filename or "")
        where = path if not other or ".greygate-" in other else other
        raise InputError(f"{where}: cannot {do} ({error.strerror or error}); choose another folder") from None


@contextmanager
def locked(path: Path | str, patience: float = 0.0) -> Iterator[None]:
    """Hold the right to write `path`. Raises InputError if another has it, and keeps it for `patience` seconds.

    Raises OSError where the lock cannot be made.
    """
    path = Path(path)
    lock, until = _beside(path, "lock"), time.monotonic() + patience
    while (handle := _taken(lock)) is None:
        if time.monotonic() >= until:
            raise InputError(f"{path}: another greygate is writing it; wait for it")
        time.sleep(0.01)
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink(missing_ok=True)
        os.close(handle)


def _taken(lock: Path) -> int | None:
    """Handle of the lock file, which then has its name still; None if another process holds it."""
    while True:
        # writable, as NFS locks nothing else; a pipe of that name is not waited for
        handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(handle), os.stat(lock)):
                return handle
        except FileNotFoundError:  # its holder removed it, ending
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


def manifest(folder: Path | str, kind: str) -> dict[str, str]:
    """SHA-256 by path of each file that `greygate <kind>` wrote into the folder, plain paths within it.

    Raises InputError where there is no such manifest, or it cannot be one.
    """
    path = Path(folder) / MANIFEST
    again = f"run greygate {kind} again, into a new folder"
    if not path.exists():
        raise InputError(f"{folder}: no {MANIFEST}, so not what this greygate {kind} writes; {again}")
    found = read_json(path, again)
    try:
        kinds = {"schema": whole(SCHEMA, SCHEMA), "kind": line, "files": named(_sha256, _plain)}
        found = table(found, f"{path}:", kinds, others=True)
    except InputError as error:
        raise InputError(f"{error}: no manifest of this greygate; {again}") from None
    if found["kind"] != kind:
        raise InputError(f"{folder}: written by greygate {found['kind']!r}, not by {kind}; choose another folder")
    return found["files"]


def changed(folder: Path | str, files: dict[str, str]) -> list[str]:
    """Those of `files` (as `manifest` gives them) that are other than they were written, or gone."""
    return [name for name, digest in files.items() if _digest(Path(folder) / name) != digest]


def replaceable(path: Path | str, kind: str, later: str = "(?!)") -> None:
    """Raise InputError unless nothing stands at `path`, or a folder of which greygate <kind> wrote every file.

    Neither may it be a link, hold the current folder, home or greygate. later: as in `replacing_folder`.
    """
    path, there, strange = Path(path), [], []
    with writing(path, "make this folder"):
        _check_place(path)
        if path.exists():
            if not path.is_dir():
                raise InputError(f"{path}: a file of that name is in the way; choose another folder")
            there = strange = _walk(path)
        if MANIFEST in there:
            files = manifest(path, kind)
            kept = {n: d for n, d in files.items() if n in there}
            strange = [n for n in there if n not in files and n != MANIFEST and not re.fullmatch(later, n)]
            strange = [n for n in strange if not OURS.fullmatch(n)] + changed(path, kept)
    if strange:
        names = ", ".join(strange[:NAMED]) + (f" and {len(strange) - NAMED} more" if len(strange) > NAMED else "")
        why = "other than" if MANIFEST in there else f"no {MANIFEST}, so not what"
        raise InputError(f"{path}: holds other files ({names}): {why} greygate {kind} wrote; choose a new folder")


def linked(folder: Path | str) -> list[str]:
    """Links within the folder, by path."""
    return [name for name in _walk(Path(folder)) if (Path(folder) / name).is_symlink()]


def _walk(folder: Path) -> list[str]:
    """Paths of all files and links within the folder, sorted."""
    found = []
    for at, folders, names in os.walk(folder, onerror=_fail):
        found += [Path(at, n) for n in names] + [Path(at, n) for n in folders if Path(at, n).is_symlink()]
    return sorted(p.relative_to(folder).as_posix() for p in found)


def _fail(error: OSError) -> None:
    raise error


def write_manifest(folder: Path, kind: str) -> None:
    """Note all files in the folder as written by greygate <kind>."""
    files = {name: _digest(folder / name) for name in _walk(folder) if name != MANIFEST}
    content = {"schema": SCHEMA, "kind": kind, "tool": f"greygate {__version__}", "files": files}
    (folder / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _digest(path: Path) -> str | None:
    """SHA-256 of a plain file, else None."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _sha256(value: object, where: str) -> str:
    """The digest of a file."""
    if not (isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value)):
        raise InputError(f"{where} {shown(value)} is no SHA-256")
    return value


def _plain(name: str, where: str) -> str:
    """A path of a manifest that leads to a place within its folder and nowhere else."""
    path = PurePosixPath(name)
    if not path.parts or path.is_absolute() or ".." in path.parts or str(path) != name:
        raise InputError(f"{where} {shown(name)} is no plain path within the folder")
    return name


def _check_place(path: Path) -> None:
    """Raise InputError where no folder may be put."""
    if path.is_symlink():
        raise InputError(f"{path}: is a link; name the folder itself")
    where = path.resolve()
    places = {"the current folder": ".", "your home": os.path.expanduser("~"), "greygate": __file__}
    for what, place in places.items():
        if Path(place).resolve().is_relative_to(where):
            raise InputError(f"{path}: is or holds {what}; give a folder of its own, such as {where / 'build'}")


def _put(new: Path, path: Path, kind: str, later: str) -> None:
    """Give the filled folder its name; what had it is then called `new`, or gone."""
    if not path.exists() or not any(path.iterdir()):
        new.rename(path)
    elif not _exchange(new, path):
        _beside(path, "commit").touch()
        _sync(path.parent)
        settle_folder(path, kind, later, held=True)
    _sync(path.parent)


def _exchange(one: Path, other: Path) -> bool:
    """Swap two names in one step; False where the system or the file system cannot."""
    swap = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if swap is None:
        return False
    if swap(AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in LACKING:
        return False
    raise OSError(code, os.strerror(code), str(other))


def _finish(paths: Sequence[Path]) -> None:
    """Where the journal says that all new files are whole, give them their names."""
    commit = _beside(paths[0], "commit")
    if not commit.exists():
        return
    for path in paths:
        if (new := _beside(path, "new")).exists():
            new.replace(path)
    _sync(commit.parent)
    commit.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Have a file or folder reach the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in LACKING:
            raise
    finally:
        os.close(handle)


def _beside(path: Path, what: str) -> Path:
    path = _absolute(path)
    return path.parent / f".{path.name}.greygate-{what}"


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))
