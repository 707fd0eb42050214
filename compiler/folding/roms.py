"""The text of synchronous ROMs, and of constants for their fields (Verilog-2005)."""

from collections.abc import Iterable

import numpy as np

from greygate.compiler.verilog import MEMORIES, module_text, number, remark

DEEP = 16  # lines from which a ROM is kept in block RAM
REMARKED = 4096  # lines of a ROM up to which each says what it does


def bits(largest: int) -> int:
    """Width of an unsigned number up to `largest`."""
    return max(1, int(largest).bit_length())


def vector(values: Iterable[int]) -> str:
    """Numbers of eight bits side by side, the first lowest."""
    return "{" + ", ".join(f"8'd{v}" for v in reversed(list(values))) + "}"


def flags(values: Iterable[bool]) -> str:
    """Bits side by side, the first lowest."""
    listed = list(values)
    return f"{len(listed)}'b" + "".join(str(int(v)) for v in reversed(listed))


def rom_rows(columns: list[tuple[np.ndarray, int, bool]], notes: dict[int, list[str]]) -> list[str]:
    """The lines of a ROM from the columns (values, width, signed) of their fields; a long ROM as plain numbers."""
    count = len(columns[0][0])
    if count <= REMARKED:
        texts = [[number(v, k) if signed else f"{k}'d{v}" for v in values.tolist()] for values, k, signed in columns]
        return [
            f"{{{', '.join(parts)}}};  {remark('; '.join(notes.get(t, ())) or '-')}"
            for t, parts in enumerate(zip(*texts, strict=True))
        ]
    total = [0] * count
    for values, k, _ in columns:
        mask = (1 << k) - 1
        total = [t << k | v & mask for t, v in zip(total, values.tolist(), strict=True)]
    width = sum(k for _, k, _ in columns)
    return [f"{width}'h{t:x};" for t in total]


def rom_text(comment: list[str], name: str, ports: str, width: int, rows: list[str], index: str, out: str) -> str:
    """A synchronous ROM with lines that a person can read."""
    listed = "\n".join(f"        rom[{n}] = {row}" for n, row in enumerate(rows))
    style = MEMORIES["block"] if len(rows) >= DEEP else ""
    return module_text(
        comment,
        f"module {name} (\n{ports}\n);\n\n"
        f"    {style}reg [{width - 1}:0] rom[0:{len(rows) - 1}];\n"
        f"    reg [{width - 1}:0] line;\n"
        f"    always @(posedge clk) line <= rom[{index}];\n{out}\n"
        f"    initial begin\n{listed}\n    end\n",
    )
