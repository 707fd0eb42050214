"""The design as Yosys elaborates it: which module stands where, with which parameters. Read from the emitted files."""

import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from greygate.files import scratch
from greygate.hardware.synthesis import reading
from greygate.hardware.tools import yosys
from greygate.progress import Progress, silent


@dataclass(frozen=True)
class Proof:
    """what: the claim. how: the method. holds: True; False with a counterexample; None where nothing was shown.

    seconds: that it took. counterexample: what contradicts the claim, or why nothing was shown. figures: of the claim,
    by name, such as {"steps": 5000, "differing bits": 0}. rows: a table of it, such as a row for each signal.
    """

    what: str
    how: str
    holds: Annotated[bool | None, "null: nothing was shown."]
    seconds: float = 0.0
    counterexample: str | None = None
    figures: Mapping[str, float | str | bool | None] = field(default_factory=dict)
    rows: tuple[dict, ...] = ()

    def line(self) -> str:
        """The proof in one line for a person."""
        verdict = {True: "holds", False: "DOES NOT HOLD", None: "not shown"}[self.holds]
        told = "".join(f"; {name} {_short(value)}" for name, value in self.figures.items())
        why = f": {self.counterexample}" if self.counterexample else ""
        return f"{self.what}: {verdict}, by {self.how} ({self.seconds:.1f} s){told}{why}"


def _short(value: float | str | None) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


@contextmanager
def timed() -> Iterator[list[float]]:
    """A list that holds the seconds since the beginning when the block ends."""
    start, found = time.perf_counter(), [0.0]
    try:
        yield found
    finally:
        found[0] = round(time.perf_counter() - start, 2)


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

    def given(self) -> str:
        """The parameters of an instance."""
        return ", ".join(f".{k}({len(bits)}'sb{bits})" for k, bits in self.parameters.items())

    def instance(self, name: str) -> str:
        """An instance with these parameters; a port is connected to what has its name."""
        return f"{self.name} #({self.given()}) {name} ({', '.join(f'.{p}({p})' for p in self.ports)});"

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
