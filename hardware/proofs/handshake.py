"""What AXI4-Stream wants of a core, by SAT: a result that waits stays and does not change, none comes after a reset,
none without its sample; and no output follows an input within a clock.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from shutil import copy

from greygate.compiler.emit import sources
from greygate.compiler.verilog import render
from greygate.files import scratch
from greygate.hardware.proofs.elaborated import Proof, timed
from greygate.hardware.proofs.paths import paths
from greygate.hardware.synthesis import reading
from greygate.hardware.tools import yosys
from greygate.progress import Progress, silent

CLOCKS = 30  # after a reset in which a whole core is tried
LONGEST = 8  # clocks over which an induction may need to look back
SECONDS = 120  # the solver gives up after
PREPARED = "hierarchy -top handshake; proc; flatten; opt -full; memory; opt -full"
CONTROL = ("stays", "silent", "paired")
WANTED = "a result that waits stays, none comes after a reset or without its sample"


def handshake(
    folder: Path, top: str, widths: Mapping[str, int], seconds: int = SECONDS, progress: Progress = silent
) -> Iterator[Proof]:
    """Proofs of the streams of a design. folder: as emit left it. widths: width_in and width_out of its streams."""
    files = sources(folder, top)
    yield _paths(files, top, progress)
    named = {"top": top, **widths}
    block = [path for path in files if path.stem in ("greygate_stream", "greygate_skid")]
    for skid in (path for path in block if path.stem == "greygate_skid"):
        check = render("skid_check.v", named, "greygate.hardware")
        yield _proof("greygate_skid: a beat is kept until it is taken", [skid], check, ["kept"], seconds)
    if len(block) == 2:
        what = f"greygate_stream: {WANTED} or changed, whatever core answers each start once"
        yield _proof(what, block, render("stream_check.v", named, "greygate.hardware"), CONTROL, seconds)
    control = render("handshake.v", named | {"data": False}, "greygate.hardware")
    yield _proof(f"{WANTED}, for {CLOCKS} clocks after a reset", files, control, CONTROL, seconds, CLOCKS)
    if len(block) < 2:
        data = render("handshake.v", named | {"data": True}, "greygate.hardware")
        yield _proof("a result that waits does not change", files, data, ("stays", "still"), seconds)


def _paths(files: Sequence[Path], top: str, progress: Progress) -> Proof:
    with timed() as spent:
        found = paths(files, top, progress)
    why = ", ".join(f"{a} to {b}" for a, b in found) or None
    what, how = "no output follows an input within a clock, but s_axis_tready a reset", "paths of the elaborated design"
    return Proof(what, how, not found, spent[0], why, {"paths": len(found)})


def _proof(what: str, files: Sequence[Path], check: str, of: Sequence[str], seconds: int, clocks: int = 0) -> Proof:
    """That outputs of the module `handshake` are 1 at every clock after a reset. clocks: only in so many, if not 0."""
    mode = f"-tempinduct-baseonly -maxsteps {clocks}" if clocks else f"-tempinduct -maxsteps {LONGEST}"
    sat = f"sat -set-at 1 rst 1 {mode} {' '.join(f'-prove {name} 1' for name in of)} -timeout {seconds}"
    with timed() as spent, scratch() as work:
        for path in files:
            copy(path, work)
        (work / "handshake.v").write_text(check, encoding="utf-8", newline="\n")
        log = yosys(f"{reading([*files, Path('handshake.v')])}; {PREPARED}; {sat}", work)
    how = f"SAT over {clocks} clocks" if clocks else "SAT and induction"
    if "SUCCESS!" in log:
        return Proof(what, how, True, spent[0])
    if "model found for base case: FAIL!" in log:
        return Proof(what, how, False, spent[0], "the solver found a run in which it fails")
    return Proof(what, how, None, spent[0], f"induction over {LONGEST} clocks or {seconds} s does not show it")
