"""Where a training stands, and the file that keeps it."""

from dataclasses import dataclass, field, fields
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from greygate.contents import contents
from greygate.errors import InputError
from greygate.files import replacing


@dataclass
class Checkpoint:
    """Where a training stands: all that a checkpoint keeps."""

    theta: np.ndarray
    best: np.ndarray
    damping: float = 1e-3
    growth: float = 2.0
    history: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)

    def save(self, path: Path, key: str) -> None:
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, key=key, **{f.name: getattr(self, f.name) for f in fields(self)})

    @staticmethod
    def load(path: Path, key: str) -> "Checkpoint":
        try:
            with np.load(BytesIO(contents(path))) as data:
                if str(data["key"]) != key:
                    raise InputError(
                        f"{path}: a checkpoint of other records, options or weights; remove it or give another path"
                    )
                values = {f.name: data[f.name] for f in fields(Checkpoint)}
        except InputError:
            raise
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise InputError(f"{path}: not a readable checkpoint ({error}); remove it") from None
        return Checkpoint(**{n: v if v.ndim and n in ("theta", "best") else v.tolist() for n, v in values.items()})
