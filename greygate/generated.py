"""Modules of generated source that numba compiles; they are kept on disk, so that each is compiled once on a computer.

This package writes the source: for a plant from names and trees that `plants.expressions` has checked, for an integer
program from its numbers. No text from a file stands in the source.
"""

import hashlib
import importlib.abc
import importlib.util
import os
import sys
import types
from pathlib import Path

from greygate import caches
from greygate.errors import InputError
from greygate.files import replacing


def load(kind: str, text: str) -> types.ModuleType:
    """Load the module of source `text` from the folder `<kind>s` of `greygate.caches`.

    Its name is its hash. For functions decorated with `njit(cache=True)`, numba keeps its compiled code beside the
    module and finds it there in later processes. If the folder cannot be written, the module stays in memory.
    """
    name = f"greygate_{kind}_{hashlib.sha256(text.encode()).hexdigest()[:24]}"
    folder = (caches.folder() or Path(os.devnull)) / f"{kind}s"
    path = folder / f"{name}.py"
    try:
        folder.mkdir(exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            with replacing(path) as temporary:
                temporary.write_text(text, encoding="utf-8", newline="\n")
        writable = os.access(folder, os.W_OK)
    except (OSError, InputError):
        writable = False
    if writable:
        spec = importlib.util.spec_from_file_location(name, path)
    else:
        spec = importlib.util.spec_from_loader(name, _InMemory(text.replace("cache=True", "cache=False")))
    assert spec is not None  # neither a Python file nor a loader is without one
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # numba finds a cached function's globals by this name
    spec.loader.exec_module(module)
    return module


class _InMemory(importlib.abc.InspectLoader):
    """Loads the module of one source text."""

    def __init__(self, text: str):
        self.text = text

    def get_source(self, fullname: str) -> str:
        return self.text

    def get_code(self, fullname: str) -> types.CodeType:
        return self.source_to_code(self.text, fullname)
