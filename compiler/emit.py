"""Write an integer program as a folder of files, as one of the targets (targets/) has it."""

import re
from pathlib import Path

from greygate import rtl
from greygate.compiler.targets import Architecture, Design, target
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import making, replacing_all
from greygate.names import check_file_name


def emit(program: Program, folder: Path | str, architecture: str = "parallel", design: Design = Design()) -> list[Path]:
    """Write the program into `folder` and return the files, the top `<program>.v` of Verilog first.

    architecture: the name of a target, such as "parallel" or "folded". design: how it is built. Verilog stands on its
    own: the building blocks used are copied into the folder, and `<program>.f` lists the sources. Either all files are
    written or none. Raises InputError for names that Verilog cannot hold, a program without input or output, an illegal
    option, or a folder that cannot be written.

    >>> [path.name for path in emit(program, "rtl")][0]
    'lag.v'
    """
    files = emitted(program, architecture, design)
    folder = Path(folder)
    with making(folder), replacing_all([folder / name for name in files], durable=False) as new:
        for path, text in zip(new, files.values(), strict=True):
            path.write_bytes(text.encode())  # UTF-8, whatever the system's own encoding
    return [folder / name for name in files]


def emitted(program: Program, architecture: str = "parallel", design: Design = Design()) -> dict[str, str]:
    """The files that `emit` writes, by name. Raises InputError as it does."""
    program.check()
    chosen = target(architecture)
    texts = chosen.files(program, design)
    if isinstance(chosen, Architecture):
        blocks = set(re.findall(r"^ *(greygate_\w+) #\(", "".join(texts.values()), re.M))
        if {"greygate_clamp", "greygate_select", "greygate_multiply"} & blocks:
            blocks.add("greygate_requantize")
        if "greygate_stream" in blocks:
            blocks.add("greygate_skid")
        if any(name in text for text in texts.values() for name in ("greygate_lookup", "greygate_multiply")):
            blocks.add("greygate_product")
        texts |= {f"{b}.v": rtl.block(b).read_text() for b in sorted(blocks)}
        texts |= {f"{program.name}.f": "\n".join(texts) + "\n"}
    for name in texts:
        check_file_name(name, f"program {program.name}: file")
    return texts


def sources(folder: Path | str, top: str) -> list[Path]:
    """The Verilog files that `top`.f lists, in the folder that `emit` wrote.

    Raises InputError where it cannot be read, or lists anything but plain names in that folder.
    """
    listing = Path(folder) / f"{top}.f"
    try:
        names = listing.read_text().split()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{listing}: not readable ({error}); emit the design first") from None
    for name in names:
        if not re.fullmatch(r"\w+\.(v|vlt)", name, re.ASCII):
            raise InputError(f"{listing}: {name!r} is no plain name of a file beside it; emit the design again")
    return [listing.parent.resolve() / name for name in names if name.endswith(".v")]
