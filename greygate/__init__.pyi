# What a type checker sees of __init__.py, which imports each of these when it is first used.

from greygate.compiler.emit import emit
from greygate.compiler.pipeline import compile_network as compile
from greygate.compiler.quantize import Formats
from greygate.emulator.emulation import emulate
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.hardware.comparing import compare
from greygate.machines.source import Source
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.rig import load as load_rig
from greygate.models.importers.matlab import from_matlab
from greygate.models.importers.onnx_graph import from_onnx
from greygate.models.importers.pytorch import from_torch, to_torch
from greygate.models.network import Connection, Layer, Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.models.validation import validate
from greygate.plants.frames import to_pandas
from greygate.plants.plant import Plant
from greygate.plants.python import Simulator
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import Recording, read_csv
from greygate.plants.simulator import simulate
from greygate.project import compile_project as build
from greygate.project import synthesize_project as synthesize
from greygate.project import verify_project as verify
from greygate.reporting import report
from greygate.version import __version__ as __version__

__all__ = [
    "Connection",
    "Formats",
    "InputError",
    "Layer",
    "Network",
    "Plant",
    "Port",
    "Program",
    "Project",
    "Record",
    "Recording",
    "Simulator",
    "Source",
    "build",
    "compare",
    "compile",
    "diagnose",
    "emit",
    "emulate",
    "from_matlab",
    "from_onnx",
    "from_torch",
    "load_rig",
    "read_csv",
    "read_recording",
    "report",
    "simulate",
    "synthesize",
    "to_pandas",
    "to_torch",
    "train",
    "validate",
    "verify",
]
