"""Where a network and its records come from: the catalogue, or the user's files."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from greygate.compiler.pipeline import compile_declared
from greygate.compiler.quantize import Formats
from greygate.emulator.emulation import emulate
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.machines.catalog import CATALOG, entry
from greygate.models import sampling
from greygate.models.importers.beside import Beside
from greygate.models.importers.files import compared, foreign, load, load_quantized
from greygate.models.importers.qonnx import Quantized
from greygate.models.network import Network, Port
from greygate.models.training.record import Record
from greygate.plants.readers.read import read_channels, read_recording
from greygate.progress import once

PORTS = (
    'write inputs = ["a [V]", "b [m]"] in {} beside the model to name them as the recording does; an input that an '
    'output becomes is a state: state = {{ h = "h_next" }}'
)


def read_record(network: Network, path: Path | str, targets: bool = True) -> tuple[Record, float]:
    """Read a recording for a network: a column for each port, in its unit or one that is converted to it, and the time.

    targets: read the network's outputs too. Returns the record and its sample time in s. Raises InputError for a
    missing column or unit, NaN, non-uniform time, an empty file, and a sample time that is not the network's.
    """
    for port in network.inputs + network.outputs:
        if port.size > 1:
            raise InputError(f"port {port.name} has {port.size} elements, but a CSV column holds one; use scalar ports")
    wanted = network.inputs + (network.outputs if targets else [])
    recording = read_recording(path, {p.name: p.unit for p in wanted}, told=once)
    sampling.check_file(network, recording.dt, path)

    def channels(ports: list[Port]) -> dict[str, np.ndarray]:
        return {p.name: recording[p.name] for p in ports}

    return Record(channels(network.inputs), channels(network.outputs) if targets else {}), recording.dt


def _answered(network: Network, path: Path | str) -> tuple[Record, float]:
    try:
        names = {c.name for c in read_channels(path, {p.name: p.unit for p in network.inputs + network.outputs})}
    except InputError:  # of a column that may be none of the network's: the reader knows first what it lacks
        return read_record(network, path)
    if names & {p.name for p in network.outputs}:
        return read_record(network, path)
    record, dt = read_record(network, path, targets=False)
    once(f"{path}: has no output of {network.name}; what the network answers stands for it")
    return replace(record, targets=network.run(record.inputs)), dt


def _outputs(program: Program, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return emulate(program, inputs).outputs


def read_records(network: Network, paths: Mapping[str, Path | str], answering: bool = False) -> dict[str, Record]:
    """Read recordings by scenario, as `read_record`. Raises InputError if their sample times differ.

    answering: where a recording has none of the outputs, they are what the network answers, with a line.
    """
    read = _answered if answering else read_record
    found = {scenario: read(network, path) for scenario, path in paths.items()}
    times = {path: dt for path, (_, dt) in zip(paths.values(), found.values(), strict=True)}
    for path, dt in times.items():
        first, expected = next(iter(times.items()))
        if not sampling.same(dt, expected):
            raise InputError(
                f"{path}: sampled every {dt:g} s, {first} every {expected:g} s; {sampling.resampling(path, expected)}"
            )
    return {scenario: record for scenario, (record, _) in found.items()}


@dataclass(frozen=True)
class Source:
    """Where a network and its records come from: a name of the catalogue, or a network file with recordings.

    recordings: scenario -> CSV; empty for the records of the catalogue.
    settle: the number of first samples of each recording that only give its initial state.
    learnt: how many of them, the first, a network learns from, and set the ranges of the formats; all by default.
    Its methods raise InputError for a name, a file or a recording that cannot be used.

    >>> lag.save("lag")
    >>> source = Source("lag.toml", {"train": "lag.csv"})
    >>> source.training, source.period
    (('train',), 0.001)
    """

    name: str
    recordings: Mapping[str, str] = field(default_factory=dict)
    settle: int = 0
    learnt: int | None = None

    def network(self) -> Network:
        path = Path(self.name)
        if foreign(self.name):
            return load(path)
        written = self.name.endswith((".toml", ".safetensors")) or (path.name and path.with_suffix(".toml").exists())
        if self.name not in CATALOG and written:
            return Network.load(self.name)
        return entry(self.name).network()

    def quantized(self) -> Quantized | None:
        """The network and the formats of its signals, of a file that declares them (QONNX); else None."""
        return load_quantized(self.name) if foreign(self.name) else None

    def records(self, answering: bool = False) -> dict[str, Record]:
        """By scenario. answering: the network stands for outputs that no recording has."""
        if not self.recordings:
            if self.name not in CATALOG:
                self.network()  # that there is none of that name is the first mistake
                raise InputError(f"{self.name}: no recordings; give FILE.csv after it")
            return dict(entry(self.name).records())
        network = self.network()
        try:
            records = read_records(network, self.recordings, answering=answering)
        except InputError as error:
            if not (answering and self.name.endswith(".onnx") and "is missing" in str(error)):
                raise
            ports = Path(self.name).with_suffix(".ports.toml").name
            raise InputError(f"{error}; {PORTS.format(ports)}") from None
        if self.imported:
            once(f"{self.name}: {self.imported}")
        return {scenario: replace(record, skip=self.settle) for scenario, record in records.items()}

    @cached_property
    def imported(self) -> Beside | None:
        """The worst of the recordings for a network of another tool beside its own program; None for any other."""
        if not (self.recordings and foreign(self.name)):
            return None
        records, quantized = read_records(self.network(), self.recordings, answering=True), self.quantized()
        given, rounded = [r.inputs for r in records.values()], None
        if quantized:
            try:
                program = compile_declared(quantized, records, self.training, self.period).program
            except InputError as error:  # the float network can be used nevertheless
                return Beside("the program", why=f"there is no program ({error})")
            given = [{p.name: p.held(inputs[p.name]) for p in program.inputs} for inputs in given]
            rounded = partial(_outputs, program)
        found = [b for inputs in given if (b := compared(self.name, inputs, rounded))]
        return max(found, key=lambda b: (bool(b.why), b.largest), default=None)

    def apart(self, held: Mapping[str, str]) -> tuple[dict[str, Record], dict[str, Record]]:
        """The records to train on, and those of other recordings, scenario -> file, that are held out."""
        if both := set(self.recordings) & set(held):
            raise InputError(f"{min(both)} is both a record to train on and a held-out record; rename one of them")
        files = {**self.recordings, **held}
        paths = {name: Path(path).resolve() for name, path in files.items()}
        if len(set(paths.values())) < len(paths):
            raise InputError("one file is given twice, under two names; hold out another file")
        found = replace(self, recordings=files).records()
        return {n: found[n] for n in self.recordings}, {n: found[n] for n in held}

    @property
    def title(self) -> str:
        return entry(self.name).title if self.name in CATALOG else Path(self.name).stem

    @cached_property
    def period(self) -> float:
        """Sample time of the network, or else of its first recording [s]."""
        if (known := self.network().sample_time()) is not None:
            return known
        if not self.recordings:
            return 1e-3
        return read_record(self.network(), next(iter(self.recordings.values())), targets=False)[1]

    @property
    def supposed(self) -> str:
        """What is supposed of the sample time where the network does not say it; else empty."""
        network = self.network()
        if network.sample_time() is not None or not self.recordings:
            return ""
        path = next(iter(self.recordings.values()))
        taken = f"that of {path} ({sampling.spoken(self.period)})"
        return f"network {network.name} does not say its sample time; taken as {taken}"

    @property
    def training(self) -> tuple[str, ...]:
        """Scenarios that set ranges and formats: the catalogue's training runs, or the first `learnt` recordings."""
        return entry(self.name).training if not self.recordings else tuple(self.recordings)[: self.learnt]

    @property
    def scenarios(self) -> tuple[str, ...]:
        """The scenarios on which hardware is verified."""
        if self.name in CATALOG and not self.recordings:
            return entry(self.name).scenarios
        return tuple(self.recordings)

    def formats(self, width: int = 16, finer: int | None = None) -> Formats:
        """Formats of that word width; finer: as in `Formats`, the catalogue's choice for the network if not given."""
        own = entry(self.name).finer if self.name in CATALOG else 0
        return Formats(width, own if finer is None else finer)

    @property
    def references(self) -> Mapping[str, Mapping]:
        return entry(self.name).references if self.name in CATALOG else {}
