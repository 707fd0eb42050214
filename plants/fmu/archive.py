"""The archive of an FMU: what it says of itself, and its files, unpacked safely. Nothing of it runs here."""

import hashlib
import io
import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from greygate.contents import contents, without_entities
from greygate.errors import InputError, brought_by, one_line, shown

LARGEST = 1 << 29  # bytes of an FMU
UNPACKED = 1 << 31  # bytes of its files
FILES = 20_000
DESCRIPTION = "modelDescription.xml"
QUOTED = 150  # characters of another program's message


@dataclass(frozen=True)
class Archive:
    """An FMU as it was read: all of its bytes, so that what was trusted is what runs."""

    path: Path
    content: bytes

    @classmethod
    def read(cls, path: Path) -> "Archive":
        """Raises InputError for a file that cannot be read."""
        try:
            return cls(path, contents(path, LARGEST))
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); give the FMU's file") from None

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the file."""
        return hashlib.sha256(self.content).hexdigest()

    @cached_property
    def about(self) -> Any:
        """The model description, as fmpy reads it. Raises InputError for what is no FMU of FMI 2 or 3."""
        with brought_by("fmi", "fmpy"):
            import fmpy
        text = self._text()
        without_entities(text, self.path)
        try:
            found = fmpy.read_model_description(io.BytesIO(self.content), validate=False)
        except Exception as error:  # of fmpy, lxml
            raise self.wrong(f"its {DESCRIPTION} cannot be read ({quoted(error)}); export it anew") from None
        if found.fmiMajorVersion not in (2, 3):
            raise self.wrong(f"is of FMI {found.fmiVersion}; export it for FMI 2.0 or 3.0")
        return found

    def _text(self) -> bytes:
        try:
            with zipfile.ZipFile(io.BytesIO(self.content)) as archive:
                return archive.read(DESCRIPTION)
        except (
            zipfile.BadZipFile,
            KeyError,
            ValueError,
            NotImplementedError,
            RuntimeError,
            OSError,
            EOFError,
        ) as error:
            raise self.wrong(f"is no FMU ({quoted(error)}); give a file that a simulator exported") from None
        except Exception as error:  # of zlib, lzma
            raise self.wrong(f"is damaged ({quoted(error)}); export it anew") from None

    def unpack(self, folder: Path) -> None:
        """Write its files into a folder. Raises InputError for one that would lie elsewhere, and for too much."""
        try:
            with zipfile.ZipFile(io.BytesIO(self.content)) as archive:
                members = archive.infolist()
                if len(members) > FILES or sum(m.file_size for m in members) > UNPACKED:
                    raise self.wrong(f"unpacks to more than {FILES} files or {UNPACKED >> 30} GiB; export less with it")
                for member in members:
                    name = PurePosixPath(member.filename.replace("\\", "/"))
                    if name.is_absolute() or ".." in name.parts or ":" in member.filename:
                        raise self.wrong(f"holds {shown(member.filename)}, a file outside of it; export it anew")
                    archive.extract(member, folder)
        except InputError:
            raise
        except OSError as error:
            if error.filename is not None:
                raise
            raise self.wrong(f"is damaged ({quoted(error)}); export it anew") from None
        except Exception as error:  # of zipfile, zlib, lzma
            raise self.wrong(f"is damaged ({quoted(error)}); export it anew") from None

    def library(self, folder: Path, identifier: str) -> Path:
        """The unpacked library for this computer. Raises InputError where there is none."""
        import fmpy

        own = {2: fmpy.platform, 3: fmpy.platform_tuple}[self.about.fmiMajorVersion]
        file = f"{identifier}{fmpy.sharedLibraryExtension}"
        for place in (own, fmpy.platform, fmpy.platform_tuple):
            if (found := folder / "binaries" / place / file).is_file():
                return found
        others = sorted(p.name for p in (folder / "binaries").glob("*") if any(p.iterdir()))
        raise self.wrong(f"has programs for {', '.join(others) or 'no computer'}, none for {own}; export it for that")

    def wrong(self, problem: str) -> InputError:
        return InputError(f"{self.path}: {problem}")


def quoted(error: object) -> str:
    """What another program says, as a message repeats it."""
    return one_line(" ".join(str(error).split()))[:QUOTED]
