"""Steps from files to files: one that is done is not done again while all that it depends on is the same.

A step fills a folder of its own, completely or not at all (`greygate.files`). Its step.toml has the digest of what it
depended on: the version, what it was given, and what the steps before it wrote.
"""

import hashlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from time import monotonic

import tomli_w

from greygate.errors import InputError
from greygate.files import MANIFEST, OURS, changed, manifest, replacing_folder, settle_folder
from greygate.plain import json_text, plain
from greygate.progress import Progress, titled
from greygate.reading import line, number, read_toml, table, truth
from greygate.version import __version__

STEP = "step.toml"
NOTHING = "(?!)"  # a pattern of the files that others add to a folder: none


@dataclass(frozen=True)
class Told:
    """What a step says of its work: a short sentence with its figure, its main file, whether the answer is yes."""

    figure: str
    file: str
    yes: bool = True


@dataclass(frozen=True)
class Done:
    """A step that is done. folder: its own. again: whether it was done before, and all is as it was."""

    name: str
    folder: Path
    figure: str
    file: str
    yes: bool
    seconds: float
    key: str
    again: bool = False


class Steps:
    """Steps that are done one after the other in the folders of `folder`, each by the command `kind`.

    names: of all steps; others: of files beside them. Raises InputError for a folder that holds anything else.
    """

    def __init__(self, folder: Path, kind: str, names: Collection[str], others: Collection[str], progress: Progress):
        self.folder, self.kind, self.progress, self.done = folder, kind, progress, list[Done]()
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: is not a folder; give another one")
        there = {p.name for p in folder.iterdir()} if folder.is_dir() else set()
        strange = [n for n in there - {*names, *others} if not OURS.fullmatch(n)]
        if strange or (there & {*others} and not there & {*names}):
            what = min(strange or there)
            raise InputError(f"{folder}: holds {what}, which greygate {kind} did not write; give a new folder")

    def do(
        self,
        name: str,
        work: Callable[[Path, Progress], Told],
        given: Mapping[str, object],
        later: str = NOTHING,
    ) -> Done:
        """Do a step, or find it done. work: fills the folder. given: its settings, and what it reads of the user's.

        later: as of `replacing_folder`. Raises InputError as the work does, and where the folder holds other files.
        """
        folder = self.folder / name
        before = [_content(one.folder, self.kind) for one in self.done]
        key = hashlib.sha256(json_text(plain([__version__, name, given, before])).encode()).hexdigest()
        settle_folder(folder, self.kind, later)
        done = self._kept(name, key)
        if done is None:
            with replacing_folder(folder, self.kind, later) as new:
                began = monotonic()
                told = work(new, titled(self.progress, name))
                done = Done(name, folder, told.figure, told.file, told.yes, round(monotonic() - began, 1), key)
                facts = {k: v for k, v in asdict(done).items() if k in KEPT}
                (new / STEP).write_text(tomli_w.dumps(facts), encoding="utf-8", newline="\n")
        self.done.append(done)
        return done

    def _kept(self, name: str, key: str) -> Done | None:
        """The step as it was done, if that was so and nothing was touched since."""
        folder = self.folder / name
        if not (folder / MANIFEST).exists() or changed(folder, manifest(folder, self.kind)):
            return None
        found = table(read_toml(folder / STEP, f"remove {folder}"), f"{folder / STEP}:", KEPT)
        return Done(name, folder, **found, again=True) if found["key"] == key else None


KEPT = {"figure": line, "file": line, "yes": truth, "seconds": number, "key": line}


def _content(folder: Path, kind: str) -> dict[str, str]:
    """What a step wrote, but for what it says of itself."""
    return {name: digest for name, digest in manifest(folder, kind).items() if name != STEP}
