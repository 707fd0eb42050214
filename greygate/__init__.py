"""Grey-box networks from a mechanical plant to an FPGA.

    network and records -> train -> validate -> compile -> emulate, emit
    files -> Source -> build -> Project -> verify, synthesize, report, compare
    plant or Simulator, and recording -> simulate, load_rig, diagnose

The names of `__all__` are what a program needs. Each is imported when it is first used, so that `import greygate` is
fast. Their docstrings hold examples that continue one another in the order of `__all__`, after

    import numpy as np
    from pathlib import Path
    from greygate import *
"""

import sys
from importlib import import_module

from greygate.caches import keep_compiled
from greygate.version import __version__ as __version__

_PUBLIC = {  # name -> module: name there, in the order of the examples
    "Port": "greygate.models.network:Port",
    "Layer": "greygate.models.network:Layer",
    "Connection": "greygate.models.network:Connection",
    "Network": "greygate.models.network:Network",
    "Record": "greygate.models.training.record:Record",
    "Recording": "greygate.plants.recording:Recording",
    "read_csv": "greygate.plants.recording:read_csv",
    "read_recording": "greygate.plants.readers.read:read_recording",
    "from_torch": "greygate.models.importers.pytorch:from_torch",
    "to_torch": "greygate.models.importers.pytorch:to_torch",
    "from_onnx": "greygate.models.importers.onnx_graph:from_onnx",
    "from_matlab": "greygate.models.importers.matlab:from_matlab",
    "train": "greygate.models.training.levenberg:train",
    "validate": "greygate.models.validation:validate",
    "Formats": "greygate.compiler.quantize:Formats",
    "compile": "greygate.compiler.pipeline:compile_network",
    "Program": "greygate.emulator.program:Program",
    "emulate": "greygate.emulator.emulation:emulate",
    "InputError": "greygate.errors:InputError",
    "emit": "greygate.compiler.emit:emit",
    "Source": "greygate.machines.source:Source",
    "build": "greygate.project:compile_project",
    "Project": "greygate.hardware.build:Project",
    "verify": "greygate.project:verify_project",
    "synthesize": "greygate.project:synthesize_project",
    "report": "greygate.reporting:report",
    "compare": "greygate.hardware.comparing:compare",
    "to_pandas": "greygate.plants.frames:to_pandas",
    "Plant": "greygate.plants.plant:Plant",
    "simulate": "greygate.plants.simulator:simulate",
    "Simulator": "greygate.plants.python:Simulator",
    "load_rig": "greygate.mismatch.rig:load",
    "diagnose": "greygate.mismatch.diagnose:diagnose",
}
_SHOWN = {  # in a notebook: what shows itself -> what draws it
    "greygate.models.network:Network": "network",
    "greygate.mismatch.diagnosis:Diagnosis": "diagnosis",
    "greygate.hardware.build:Project": "project",
}
__all__ = [*_PUBLIC]
keep_compiled()


_TOLD = ("train", "diagnose")  # in a notebook they say where they are, on one line
_SHELL = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()


def _show_in_notebooks() -> None:
    """Where a notebook imports greygate, say what draws its results; nothing is imported for it here."""
    formatter = _SHELL and _SHELL.display_formatter.formatters["text/html"]
    for name, drawn in _SHOWN.items() if formatter else ():

        def html(value: object, drawn: str = drawn) -> str:
            return getattr(import_module("greygate.pages.notebook"), drawn)(value)

        formatter.for_type_by_name(*name.split(":"), html)


_show_in_notebooks()


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'greygate' has no attribute {name!r}")
    module, _, own = _PUBLIC[name].partition(":")
    found = getattr(import_module(module), own)
    if _SHELL and name in _TOLD:
        found = import_module("greygate.progress").told(found)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
