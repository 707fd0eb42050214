"""Grey-box networks from a mechanical plant to an FPGA.

    network and records -> train -> validate -> compile -> emulate, emit
    files -> Source -> build -> Project -> verify, synthesize, report
    plant and recording -> simulate, load_rig, diagnose

The names of `__all__` are what a program needs. Each is imported when it is first used, so that `import greygate` is
fast. Their docstrings hold examples that continue one another in the order of `__all__`, after

    import numpy as np
    from pathlib import Path
    from greygate import *
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from greygate.version import __version__ as __version__

if TYPE_CHECKING:
    from greygate.compiler.emit import emit
    from greygate.compiler.pipeline import compile_network as compile
    from greygate.compiler.quantize import Formats
    from greygate.emulation import emulate
    from greygate.emulator.program import Program
    from greygate.errors import InputError
    from greygate.mismatch.diagnosis import diagnose
    from greygate.mismatch.rig import load as load_rig
    from greygate.models.network import Connection, Layer, Network, Port
    from greygate.models.training.levenberg import train
    from greygate.models.training.record import Record
    from greygate.models.validation import validate
    from greygate.plants.plant import Plant
    from greygate.plants.recording import Recording, read_csv
    from greygate.plants.simulate import simulate
    from greygate.project import Project
    from greygate.project import compile_project as build
    from greygate.project import synthesize_project as synthesize
    from greygate.project import verify_project as verify
    from greygate.reporting import report
    from greygate.source import Source

__all__ = [  # noqa: RUF022 (in the order of the examples)
    "Port",
    "Layer",
    "Connection",
    "Network",
    "Record",
    "Recording",
    "read_csv",
    "train",
    "validate",
    "Formats",
    "compile",
    "Program",
    "emulate",
    "InputError",
    "emit",
    "Source",
    "build",
    "Project",
    "verify",
    "synthesize",
    "report",
    "Plant",
    "simulate",
    "load_rig",
    "diagnose",
]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'greygate' has no attribute {name!r}")
    module, own = _imported()[name]
    globals()[name] = found = getattr(import_module(module), own)
    return found


def _imported() -> dict[str, tuple[str, str]]:
    """Public name -> module and name there: what the imports above say to a type checker, read from this file."""
    tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {a.asname or a.name: (str(node.module), a.name) for node in imports for a in node.names}


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
