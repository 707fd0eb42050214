"""What lies in a folder: recordings, networks, rigs, builds, diagnoses and pages, each with its state."""

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from itertools import islice
from pathlib import Path

from greygate.contents import contents
from greygate.errors import one_line

DEEP, LOOKED = 2, 10_000  # folders below the folder, and things, that are looked at
MOST = 200  # things of a kind that are shown
READ = 1 << 20  # bytes of a file that is opened for its state; a larger one tells none
RECORDINGS = (".csv", ".gz", ".mat", ".h5", ".hdf5", ".parquet", ".mf4", ".mdf", ".dat", ".tdms", ".mcap")
TAKEN = (*RECORDINGS, ".toml", ".safetensors", ".json", ".onnx", ".xml")  # what may be dropped
NEXT = {  # kind -> the commands that begin with it
    "recording": ("look", "identify", "init"), "network": ("train", "validate", "compile"),
    "rig": ("diagnose", "isolability", "next", "simulate"), "diagnosis": (), "page": (),
    "build": ("emulate", "verify", "prove", "synthesize", "report", "board"),
}  # fmt: skip


@dataclass(frozen=True)
class Thing:
    """path: within the folder. state: in a few words. changed: when, in ns. page: that of its name, if there is one."""

    kind: str
    path: str
    state: str
    changed: int
    page: str = ""

    @property
    def next(self) -> tuple[str, ...]:
        return NEXT[self.kind]

    def has(self, page: "Thing") -> bool:
        """Whether that is a page of this thing: it lies in it, or its name begins as this one's."""
        path = Path(self.path) if self.kind in ("rig", "build") else Path(self.path).with_suffix("")
        stem = path.parent if path.name == path.parent.name else path  # found/found.toml of the folder found
        return page.kind == "page" and page.path.startswith((f"{stem.as_posix()}.", f"{stem.as_posix()}/"))


def things(folder: Path) -> list[Thing]:
    """What lies in the folder, by kind and path, the first MOST of each kind. Links are not followed."""
    found = sorted(islice(_found(folder, folder, DEEP), LOOKED), key=lambda thing: thing.path)
    return [thing for kind in NEXT for thing in islice((t for t in found if t.kind == kind), MOST)]


def mark(found: list[Thing]) -> str:
    """Another one where one of them is new, gone or changed."""
    return sha256(repr(found).encode(errors="surrogateescape")).hexdigest()


def _found(root: Path, folder: Path, deep: int) -> Iterator[Thing]:
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith(".") or entry.is_symlink():
            continue
        found = None
        with suppress(OSError):  # it is gone
            found = _thing(root, entry)
        if found:
            yield found
        if entry.is_dir() and deep and not (found and found.kind == "build"):
            yield from _found(root, Path(entry.path), deep - 1)


def _thing(root: Path, entry: os.DirEntry) -> Thing | None:
    path = Path(entry.path)
    kind, state = _folder(path) if entry.is_dir() else _file(path) if entry.is_file() else ("", "")
    if not kind:
        return None
    page = path.with_suffix(".html") if entry.is_file() else path / "index.html"
    within, named = (p.relative_to(root).as_posix() for p in (path, page))
    return Thing(kind, within, one_line(state), entry.stat().st_mtime_ns, named if page.is_file() else "")


def _folder(path: Path) -> tuple[str, str]:
    if (path / "rig.toml").is_file():
        return "rig", f"{len(list(path.glob('*.csv')))} recordings"
    if (path / "compile.json").is_file():
        return "build", verified(path) or "not verified"
    return "", ""


def verified(build: Path) -> str:
    """What `greygate verify` found of a build; empty where it has not run."""
    designs = object_in(build / "verify.json").values()
    runs = [run for design in designs for run in inner(design, "scenarios").values()]
    if not runs:
        return ""
    return "verified" if all(inner(run).get("mismatch", "") is None for run in runs) else "differs"


def _file(path: Path) -> tuple[str, str]:
    suffix = path.suffix.lower()
    if suffix in RECORDINGS:
        return "recording", f"{path.stat().st_size / 1000:,.0f} kB"
    if suffix == ".toml" and path.with_suffix(".safetensors").is_file():
        return "network", "trained" if path.with_suffix(".json").is_file() else "not trained"
    if suffix == ".html":
        return "page", ""
    if suffix == ".json" and str((told := object_in(path)).get("schema", "")).startswith("diagnosis/"):
        return "diagnosis", str(told.get("verdict", "")).replace("_", " ")
    return "", ""


def object_in(path: Path) -> dict:
    """The object in a file; empty where there is none."""
    try:
        found = json.loads(contents(path, READ))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def inner(found: object, *names: str) -> dict:
    """The object below these names; empty where there is none."""
    for name in names:
        found = found.get(name) if isinstance(found, dict) else None
    return found if isinstance(found, dict) else {}
