"""A compiled network as a folder, which `greygate compile` writes and `verify`, `emulate` and `report` read.

program.json           the integer program (docs/integer-program.md)
network.toml, .safetensors   the generic float network it was quantized from
compile.json           the source, the passes, the architectures
manifest.json          SHA-256 of each file above and below; a file that it does not list is never replaced
rtl/parallel, rtl/folded     the Verilog of each architecture, and <program>.f, its list of files
bench/                 a bench in plain Verilog for any of them, and the scenario that it plays
verify.json            results of the last verification; results-*.xml beside it are JUnit
resources.json         resources that synthesis found, by architecture and target
simulation/            results and logs of the last verification, by architecture
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from greygate.compiler.emit import emitted
from greygate.compiler.pipeline import Compiled, Pass
from greygate.compiler.ranges import ranges
from greygate.compiler.study import size
from greygate.compiler.targets import NAMES, Architecture, Design, target
from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import changed, linked, manifest, settle, settle_folder, writing
from greygate.hardware.facts import FACTS, read_facts, read_hardware, read_resources
from greygate.hardware.verify import Case, Scenario
from greygate.machines.catalog import CATALOG
from greygate.machines.source import Source, read_record, read_records
from greygate.models.network import Network
from greygate.models.storage import TRAINED
from greygate.models.training.record import Record
from greygate.plants.readers.read import is_recording
from greygate.reading import read_json

LATER = (  # the files that verify and synthesize add to a build; nothing else writes there
    rf"verify\.json|resources\.json|results-({'|'.join(NAMES)})\.xml|"
    rf"simulation/({'|'.join(NAMES)})/(results\.xml|(sim|verilator|make)\.log|dump\.vcd|"
    r"build/(bench(\.v)?|job\.(json|npz)|verdicts\.json|(verilator|make)\.log|(Vtop|verilat)\w*(\.\w+)+))"
)


@dataclass(frozen=True)
class Project:
    """A folder that `build` wrote, read back.

    folder: its path. source: what it was compiled from. program, network: the compiler's results, in integers and in
    float. facts: the content of compile.json.

    >>> project = Project.open("lag")
    >>> project.program.name, project.design.multipliers
    ('lag', 4)
    """

    folder: Path
    source: Source
    program: Program
    network: Network
    facts: dict

    @staticmethod
    def open(folder: Path | str) -> "Project":
        """Read a build. Raises InputError if `compile` did not write the folder, or a file outside rtl/ was changed."""
        folder = Path(folder)
        with writing(folder, "read this folder"):
            return Project._open(folder)

    @staticmethod
    def _open(folder: Path) -> "Project":
        settle_folder(folder, "compile", LATER)
        facts = read_facts(folder)
        files = manifest(folder, "compile")
        data = {name: digest for name, digest in files.items() if not name.startswith("rtl/")}
        if missing := {FACTS, "program.json", "network.toml", "network.safetensors"} - set(data):
            raise InputError(f"{folder}: its manifest does not list {min(missing)}; run greygate compile again")
        if other := [*changed(folder, data), *linked(folder)]:
            raise InputError(f"{folder / other[0]}: not as greygate compile wrote it; run greygate compile again")
        files = facts["recordings"]
        source = Source(facts["source"], files, learnt=facts.get("learnt", 1) if files else None)
        program = Program.load(folder / "program.json")
        network = replace(Network.load(folder / "network"), dt=program.period)
        return Project(folder, source, program, network, facts)

    def records(self) -> dict[str, Record]:
        """The scenarios by name; recordings are read again. Raises InputError as `Source.records`."""
        if not self.source.recordings:
            return self.source.records()
        return read_records(self.network, self.source.recordings, answering=True)

    def compiled(self, records: Mapping[str, Record]) -> Compiled:
        """The result of the compiler, with ranges computed again from the training records."""
        found = ranges(self.network, [records[n] for n in self.source.training])
        passes = tuple(Pass(**p) for p in self.facts["passes"])
        return Compiled(self.network, found, self.program, passes)

    def scenarios(self, names: tuple[str, ...] = ()) -> dict[str, Scenario]:
        """Inputs and the outputs and states that hardware must give, by the emulator.

        Raises InputError for a scenario that does not exist.
        """
        records = self.records()
        found = {}
        for name in names or self.source.scenarios:
            if name not in records:
                raise InputError(f"no scenario {name!r}; there are {', '.join(records)}")
            codes = self.program.encode(records[name].inputs)
            answer = run(self.program, codes)
            found[name] = Scenario(codes, answer.outputs, answer.states)
        return found

    def inputs(self, recording: str) -> tuple[Mapping[str, np.ndarray], float]:
        """The inputs of a file, or else of a scenario of that name, and the sample time in s.

        Raises InputError for a file that cannot be read, and for a name that is neither.
        """
        if Path(recording).exists() or is_recording(recording):
            record, dt = read_record(self.network, recording, targets=False)
            return record.inputs, dt
        if recording not in (records := self.records()):
            raise InputError(f"{recording}: no such file, and no scenario of this build; it has {', '.join(records)}")
        return records[recording].inputs, self.program.period

    def case(self, architecture: str, names: tuple[str, ...] = ()) -> Case:
        """One emitted design with the answers that it must give."""
        where = self.folder / "rtl" / architecture
        return Case(self.program, self.scenarios(names), architecture, self.design, emitted=where)

    @property
    def design(self) -> Design:
        """How the Verilog was built."""
        return Design(**self.facts["design"])

    @property
    def designs(self) -> list[str]:
        """The architectures in Verilog. Raises InputError if there is none."""
        found = [a for a in self.facts["architectures"] if isinstance(target(a), Architecture)]
        if not found:
            raise InputError(f"{self.folder}: holds no Verilog; run greygate compile --architecture both")
        return found

    def edited(self) -> list[Path]:
        """Files in rtl/ that differ from the Verilog of the program: code of the user, or of a stranger."""
        found = []
        for architecture in self.facts["architectures"]:
            where = self.folder / "rtl" / architecture
            for name, text in emitted(self.program, architecture, self.design).items():
                path = where / name
                if not path.is_file() or path.read_bytes() != text.encode():
                    found.append(path)
        return found

    @property
    def hardware(self) -> dict | None:
        """The results of `verify` by architecture, or None."""
        settle(result_files(self.folder))
        return read_hardware(self.folder)

    @property
    def resources(self) -> dict | None:
        """The results of `synthesize` by "architecture, target", or None.

        If the build has none, those that the package keeps for this network, if its program has the same size.
        """
        if (found := read_resources(self.folder)) is not None:
            return found
        kept = kept_file(self.source.name)
        if self.source.name not in CATALOG or not kept.exists():
            return None
        found = read_json(kept, "install greygate again")
        return found["resources"] if found["size"] == size(self.program) else None


def kept_file(name: str) -> Path:
    """The file in the package that keeps a network's resources."""
    return TRAINED / f"{name}.resources.json"


def result_files(folder: Path) -> list[Path]:
    """The files that `verify` writes together."""
    return [folder / "verify.json", *(folder / f"results-{architecture}.xml" for architecture in NAMES)]
