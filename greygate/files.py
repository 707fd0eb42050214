"""Writes files and folders completely or not at all, and replaces only what greygate wrote.

A new NAME is written beside it as `.NAME.greygate-new`, synced to the disk, and renamed to NAME in one step. Meanwhile
the writer holds a lock on `.NAME.greygate-lock`; a kill releases the lock, even if the file stays. So a process that
holds the lock knows that other files of this form come from a writer that was killed, and removes them.

Where one rename is not enough (files that belong together; a folder on a file system that cannot exchange two names),
`.NAME.greygate-commit` is the journal: it is made when every new file is complete, and while it exists the new files
count. The next reader or writer finishes the renames and removes the journal.

A folder is greygate's only if its manifest.json says so. A file that the manifest does not list, or that was changed
since, is never removed. Every OSError is raised from here as an InputError.
"""

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Literal, TypedDict

from greygate.contents import contents
from greygate.errors import InputError, shown
from greygate.plain import Hash
from greygate.reading import line, named, read_json, table, whole
from greygate.system import exchange, release, sync, taken
from greygate.version import __version__

MANIFEST = "manifest.json"
SCHEMA = 1  # of the manifest
PATIENCE = 5.0  # s that a writer or reader of files waits for another one, which needs milliseconds
ROOM = 1 << 20  # bytes: where a disk has less left, what fails on it is said to fail for lack of room
NAMED = 3  # files that a refusal names
OURS = re.compile(r"(.*/)?\.[^/]+\.greygate-(new|old|lock|commit)")

_staged: set[Path] = set()  # folders being filled: files in them need no replacing of their own


class Manifest(TypedDict):
    """The files of the folder. A file that it does not list is never replaced."""

    schema: Literal[1]
    kind: str
    tool: str
    files: dict[str, Hash]


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Yield a path to write; it replaces `path` only if the block succeeds. Raises as `replacing_all`."""
    with replacing_all([path]) as (new,):
        yield new


@contextmanager
def replacing_all(paths: Sequence[Path | str], durable: bool = True) -> Iterator[list[Path]]:
    """Yield paths to write; the written ones replace `paths`, files of one folder, all of them or none.

    durable: sync them to the disk before the block ends, so that they survive a power failure.
    Raises InputError if the folder is missing or cannot be written, if `paths` holds a link, something that is not a
    file, or one path twice, or if another process keeps writing them.
    """
    files = [Path(path) for path in paths]
    if len(set(files)) < len(files):
        raise InputError(f"{files[0]}: two files would have this name; rename one of them")
    if any(folder in _absolute(files[0]).parents for folder in _staged):
        yield files
        return
    with writing(files[0]):
        for path in files:
            if path.is_symlink() or (path.exists() and not path.is_file()):
                raise InputError(f"{path}: is not a plain file; give the name of a file, or a new name")
        with locked(files[0], PATIENCE):
            _finish(files)
            new, commit = [_beside(p, "new") for p in files], _beside(files[0], "commit")
            try:
                for path in new:
                    path.unlink(missing_ok=True)
                yield new
                written = [p for p in new if p.exists()]
                for path in written if durable else ():
                    sync(path)
                if len(written) > 1:
                    commit.touch()
                    if durable:
                        sync(commit.parent)
                    _finish(files)
                for path, final in zip(new, files, strict=True):
                    if path in written and len(written) == 1:
                        path.replace(final)
                if durable:
                    sync(commit.parent)
            finally:
                for path in new if not commit.exists() else ():
                    with suppress(OSError):
                        path.unlink(missing_ok=True)


def settle(paths: Sequence[Path | str]) -> None:
    """Finish the renames that a killed writer of these files left, if it had written all of them."""
    files = [Path(path) for path in paths]
    if _beside(files[0], "commit").exists():
        with writing(files[0]), locked(files[0], PATIENCE):
            _finish(files)


def read_all(paths: Sequence[Path | str]) -> list[bytes | None]:
    """Contents of files that belong together, all from before or all from after a `replacing_all`.

    A file that does not exist gives None. Raises OSError if one cannot be read, InputError as `settle` or if another
    process keeps writing them.
    """
    files = [Path(path) for path in paths]
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until:
        settle(files)
        before = _state(files)
        found = [contents(path) if path.exists() else None for path in files]
        if before == _state(files) and not _beside(files[0], "commit").exists():
            return found
    raise InputError(f"{files[0]}: another greygate keeps writing it; wait until it has finished")


def _state(paths: Sequence[Path]) -> list[tuple | None]:
    found = [p.stat() if p.exists() else None for p in paths]
    return [s and (s.st_ino, s.st_mtime_ns, s.st_size) for s in found]


@contextmanager
def replacing_folder(path: Path | str, kind: str, later: str = "(?!)") -> Iterator[Path]:
    """Yield a folder to fill; with its manifest it replaces `path` only if the block succeeds.

    kind: command that writes such folders. later: pattern of the files that other commands add to the folder; they are
    replaced with it. Parent folders are made. Raises InputError, before the block runs, if `path` holds something that
    the command did not write (`replaceable`), or if another process is writing it.
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
                    sync(Path(folder, name))
            replaceable(path, kind, later)  # once more: the block may have taken hours
            _put(new, path, kind, later)
        finally:
            _staged.discard(_absolute(new))
            if not _beside(path, "commit").exists():
                shutil.rmtree(new, ignore_errors=True)
                shutil.rmtree(old, ignore_errors=True)


def settle_folder(path: Path | str, kind: str, later: str = "(?!)", held: bool = False) -> None:
    """Finish the replacement of a folder that a kill interrupted between its two renames.

    kind, later: as in `replacing_folder`. held: the caller holds the lock. Raises InputError for a folder that may not
    be replaced, because anyone may have put a journal beside it.
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
        sync(path.parent)
    commit.unlink(missing_ok=True)
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def making(folder: Path | str) -> Iterator[None]:
    """Make a folder and its parents; if the block fails, remove those that were made here and are empty."""
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
def scratch() -> Iterator[Path]:
    """Yield a folder for temporary files. If the block fails where the disk has no room, the InputError says so."""
    try:
        place = tempfile.mkdtemp(prefix="greygate-")
    except OSError as error:
        raise InputError(f"{_temporary('cannot be written')} ({error.strerror or error})") from None
    try:
        yield Path(place)
    except Exception as error:
        left = shutil.disk_usage(place).free
        if left < ROOM or getattr(error, "errno", 0) in (errno.ENOSPC, errno.EDQUOT):
            raise InputError(f"{_temporary(f'{Path(place).parent} has {left >> 10} kB left')} ({error})") from error
        raise
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _temporary(why: str) -> str:
    return f"the folder for temporary files: {why}; free some, or set TMPDIR to another"


@contextmanager
def writing(path: Path | str, do: str = "write here") -> Iterator[None]:
    """Turn an OSError of the block into an InputError about `path`, or about the other file that the error names."""
    try:
        yield
    except OSError as error:
        other = str(error.filename or "")
        where = path if not other or ".greygate-" in other else other
        raise InputError(f"{where}: cannot {do} ({error.strerror or error}); choose another folder") from None


@contextmanager
def locked(path: Path | str, patience: float = 0.0) -> Iterator[None]:
    """Hold the lock for writing `path`; wait up to `patience` seconds for it.

    Raises InputError if another process still holds it then, OSError if the lock cannot be made.
    """
    path = Path(path)
    lock, until = _beside(path, "lock"), time.monotonic() + patience
    while (handle := taken(lock)) is None:
        if time.monotonic() >= until:
            raise InputError(f"{path}: another greygate is writing it; wait until it has finished")
        time.sleep(0.01)
    try:
        yield
    finally:
        release(handle, lock)


def manifest(folder: Path | str, kind: str) -> dict[str, str]:
    """Path -> SHA-256 of each file that `greygate <kind>` wrote into the folder; the paths stay within the folder.

    Raises InputError if there is no manifest, or the file is not a valid manifest of that command.
    """
    path = Path(folder) / MANIFEST
    again = f"run greygate {kind} again, into a new folder"
    if not path.exists():
        raise InputError(f"{folder}: no {MANIFEST}, so greygate {kind} did not write this folder; {again}")
    found = read_json(path, again)
    try:
        kinds = {"schema": whole(SCHEMA, SCHEMA), "kind": line, "files": named(_sha256, _plain)}
        found = table(found, f"{path}:", kinds, others=True)
    except InputError as error:
        raise InputError(f"{error}: not a manifest of this greygate; {again}") from None
    if found["kind"] != kind:
        raise InputError(f"{folder}: written by greygate {found['kind']!r}, not by {kind}; choose another folder")
    return found["files"]


def changed(folder: Path | str, files: dict[str, str]) -> list[str]:
    """Names of those `files` (as `manifest` gives them) that were changed or removed since they were written."""
    return [name for name, digest in files.items() if _digest(Path(folder) / name) != digest]


def replaceable(path: Path | str, kind: str, later: str = "(?!)") -> None:
    """Raise InputError unless `path` does not exist, or is a folder in which greygate <kind> wrote every file.

    It also raises if `path` is a link, or holds the current folder, the home folder or greygate itself.
    later: as in `replacing_folder`.
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
    """List all files in the folder as written by greygate <kind>."""
    files = {name: _digest(folder / name) for name in _walk(folder) if name != MANIFEST}
    content = {"schema": SCHEMA, "kind": kind, "tool": f"greygate {__version__}", "files": files}
    (folder / MANIFEST).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="\n")


def _digest(path: Path) -> str | None:
    """SHA-256 of a plain file; None if there is no plain file."""
    try:
        if not stat.S_ISREG(path.lstat().st_mode):
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _sha256(value: object, where: str) -> str:
    """A kind (`greygate.reading`): the digest of a file."""
    if not (isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value)):
        raise InputError(f"{where} {shown(value)} is not a SHA-256")
    return value


def _plain(name: str, where: str) -> str:
    """A kind (`greygate.reading`): a path in a manifest, which stays within the manifest's folder."""
    path = PurePosixPath(name)
    if not path.parts or path.is_absolute() or ".." in path.parts or str(path) != name:
        raise InputError(f"{where} {shown(name)} is not a plain path within the folder")
    return name


def _check_place(path: Path) -> None:
    """Raise InputError if no folder may be written at `path`."""
    if path.is_symlink():
        raise InputError(f"{path}: is a link; name the folder itself")
    where = path.resolve()
    places = {"the current folder": ".", "your home": os.path.expanduser("~"), "greygate": __file__}
    for what, place in places.items():
        if Path(place).resolve().is_relative_to(where):
            raise InputError(f"{path}: is or holds {what}; give a folder of its own, such as {where / 'build'}")


def _put(new: Path, path: Path, kind: str, later: str) -> None:
    """Give the filled folder its name; the folder that had the name is then called `new`, or is removed."""
    if not path.exists() or not any(path.iterdir()):
        new.rename(path)
    elif not exchange(new, path):
        _beside(path, "commit").touch()
        sync(path.parent)
        settle_folder(path, kind, later, held=True)
    sync(path.parent)


def _finish(paths: Sequence[Path]) -> None:
    """Give the new files their names, if the journal says that all of them are complete."""
    commit = _beside(paths[0], "commit")
    if not commit.exists():
        return
    for path in paths:
        if (new := _beside(path, "new")).exists():
            new.replace(path)
    sync(commit.parent)
    commit.unlink(missing_ok=True)


def _beside(path: Path, what: str) -> Path:
    path = _absolute(path)
    return path.parent / f".{path.name}.greygate-{what}"


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))
