"""Write an integer program as a folder of Verilog, in either architecture."""

import re
from contextlib import ExitStack
from pathlib import Path

from greygate import rtl
from greygate.compiler.folded import folded
from greygate.compiler.parallel import parallel
from greygate.emulator.program import Program
from greygate.errors import InputError, replacing
from greygate.names import check_file_name


def emit(program: Program, folder: Path | str, architecture: str = "parallel", macs: int = 4) -> list[Path]:
    """Write the program as Verilog into `folder` and return the files, the top `<program>.v` first.

    The folder stands on its own: the building blocks used are copied into it, and `<program>.f` lists the sources.
    architecture: "parallel", or "folded" with `macs` multipliers. Either all files are written or none.
    Raises InputError for names that Verilog cannot hold, a program without input or output, an illegal option, or
    a folder that cannot be written.
    """
    program.check()
    if architecture not in ("parallel", "folded"):
        raise InputError(f"architecture {architecture!r} does not exist; choose parallel or folded")
    if architecture == "folded" and not 1 <= macs <= 256:
        raise InputError(f"{macs} multipliers are not in 1..256")
    texts = parallel(program) if architecture == "parallel" else folded(program, macs)
    blocks = sorted(set(re.findall(r"^ *(greygate_\w+) #\(", "".join(texts.values()), re.M)))
    if {"greygate_clamp", "greygate_select"} & set(blocks):
        blocks = sorted({*blocks, "greygate_requantize"})
    texts |= {f"{b}.v": rtl.block(b).read_text() for b in blocks}
    texts[f"{program.name}.f"] = "\n".join(texts) + "\n"
    folder = Path(folder)
    for name in texts:
        check_file_name(name, f"program {program.name}: file")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot make this folder ({error.strerror}); choose another") from None
    with ExitStack() as stack:
        for name, text in texts.items():
            stack.enter_context(replacing(folder / name)).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]
