"""The hardware: building blocks in Verilog-2005, their verification against the emulator, their synthesis."""

from pathlib import Path

BLOCKS = Path(__file__).parent  # holds the building blocks, one module `greygate_*` a file


def block(name: str) -> Path:
    """The file of a building block, such as block("greygate_lookup")."""
    return BLOCKS / f"{name}.v"
