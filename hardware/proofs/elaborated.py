"""The design as Yosys elaborates it: which module stands where, with which parameters. Read from the emitted files."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from greygate.files import scratch
from greygate.hardware.synthesis import reading
from greygate.hardware.tools import yosys
from greygate.progress import Progress, silent

ELABORATED = "elaborated.json"


@dataclass(frozen=True)
class Block:
    """A module with its parameters, as bits from the highest to the lowest, and the ports with their widths."""

    name: str
    parameters: Mapping[str, str]
    ports: Mapping[str, int]

    def number(self, parameter: str) -> int:
        """The value of a parameter, read as a signed number."""
        bits = self.parameters[parameter]
        return int(bits, 2) - (1 << len(bits) if bits[0] == "1" else 0)

    def field(self, parameter: str, width: int) -> list[int]:
        """The unsigned numbers of `width` bits that stand side by side in a parameter, the lowest first."""
        bits = self.parameters[parameter]
        whole = bits.zfill(-(-len(bits) // width) * width)
        return [int(whole[k - width : k], 2) for k in range(len(whole), 0, -width)]

    def instance(self, name: str) -> str:
        """An instance with these parameters; a port is connected to what has its name."""
        given = ", ".join(f".{k}({len(bits)}'sb{bits})" for k, bits in self.parameters.items())
        return f"{self.name} #({given}) {name} ({', '.join(f'.{p}({p})' for p in self.ports)});"

    def __str__(self) -> str:
        short = {k: v for k, v in self.parameters.items() if len(v) <= LONGEST}
        return f"{self.name}({', '.join(f'{k}={self.number(k)}' for k in short)})"


LONGEST = 64  # bits of a parameter that is shown


def elaborate(files: Sequence[Path], top: str | None, flat: str = "", progress: Progress = silent) -> dict:
    """Yosys's JSON of the design after `hierarchy` and `proc`: its modules by name.

    top: its module; None for all modules of the files. flat: further commands, such as "flatten; opt".
    """
    with scratch() as work:
        for path in files:
            shutil.copy(path, work)
        found = "hierarchy" if top is None else f"hierarchy -top {top}"
        yosys(f"{reading(list(files))}; {found}; proc; {flat}; write_json {ELABORATED}", work, progress=progress)
        return json.loads((work / ELABORATED).read_text())["modules"]


def blocks(modules: Mapping[str, dict]) -> list[Block]:
    """The building blocks of the design, each once for each set of parameters."""
    found: dict[tuple, Block] = {}
    for name, module in modules.items():
        own = module["attributes"].get("hdlname", name).strip()
        if own.startswith("greygate_"):
            parameters = module.get("parameter_default_values", {})
            ports = {p: len(port["bits"]) for p, port in module["ports"].items()}
            found[own, *sorted(parameters.items())] = Block(own, parameters, ports)
    return sorted(found.values(), key=lambda block: (block.name, str(block)))
