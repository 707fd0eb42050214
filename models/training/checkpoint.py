"""Where a training stands, and the file that keeps it."""

from dataclasses import dataclass, field, fields
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from greygate.contents import contents
from greygate.errors import InputError
from greygate.files import replacing
from greygate.models.training.gauss_newton import Nielsen


@dataclass
class Checkpoint:
    """Where a training stands: theta, the best theta so far, the damping, and loss and held-out error by epoch."""

    theta: np.ndarray
    best: np.ndarray
    damping: Nielsen = field(default_factory=Nielsen)
    history: list[float] = field(default_factory=list)
    held: list[float] = field(default_factory=list)

    def save(self, path: Path, key: str) -> None:
        """Write it as NPZ. key: of the training it belongs to."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        values |= {"damping": self.damping.value, "growth": self.damping.growth}
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, key=key, **values)

    @staticmethod
    def load(path: Path, key: str) -> "Checkpoint":
        """Read what `save` wrote. Raises InputError for another key and for a file that is no checkpoint."""
        try:
            with np.load(BytesIO(contents(path))) as data:
                if str(data["key"]) != key:
                    raise InputError(
                        f"{path}: a checkpoint of other records, options or weights; remove it or give another path"
                    )
                damping, growth, history, held = (data[n].tolist() for n in ("damping", "growth", "history", "held"))
                return Checkpoint(data["theta"], data["best"], Nielsen(damping, growth), history, held)
        except InputError:
            raise
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise InputError(f"{path}: not a readable checkpoint ({error}); remove it") from None
