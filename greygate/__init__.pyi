# What a type checker sees of __init__.py, which imports each of these when it is first used.

from greygate.compiler.emit import emit as emit
from greygate.compiler.quantize import Formats as Formats
from greygate.emulation import emulate as emulate
from greygate.emulator.program import Program as Program
from greygate.errors import InputError as InputError
from greygate.mismatch.diagnosis import diagnose as diagnose
from greygate.models.network import Connection as Connection
from greygate.models.network import Layer as Layer
from greygate.models.network import Network as Network
from greygate.models.network import Port as Port
from greygate.models.training.levenberg import train as train
from greygate.models.training.record import Record as Record
from greygate.models.validation import validate as validate
from greygate.plants.plant import Plant as Plant
from greygate.plants.recording import Recording as Recording
from greygate.plants.recording import read_csv as read_csv
from greygate.plants.simulate import simulate as simulate
from greygate.project import Project as Project
from greygate.reporting import report as report
from greygate.source import Source as Source
from greygate.version import __version__ as __version__
