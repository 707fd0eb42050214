"""Benches in plain Verilog, which read what goes in and what must come out from a file of hexadecimal words.

One plays a scenario through a core; `greygate compile` writes it, too. The other sends frames through a port.
"""

from typing import Any

import numpy as np

from greygate.compiler.verilog import lane_width, render
from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.hardware.board.frames import Frames, width
from greygate.hardware.verify import lanes

STEPS = 1000  # of the scenario, in the bench of a core
FRAMES = 20  # of the scenario, in the bench of a port
PATIENCE = 100_000  # clocks that a step may take; a folded core of 10,000 weights and one multiplier takes 10,000


def core_bench(program: Program, codes: np.ndarray, listing: str) -> tuple[str, str]:
    """The bench of a core, and the file `listing` that it reads.

    codes: inputs (N, columns). The emulator gives the results.
    """
    found = steps(program, codes, STEPS)
    context = {
        "name": program.name,
        "in_w": width(program.inputs),
        "out_w": width(program.outputs),
        "steps": len(found),
        "patience": PATIENCE,
        "hex": listing,
    }
    return render("bench.v", context, __package__), "".join(
        (sample + result)[::-1].hex() + "\n" for sample, result in found
    )


def port_bench(program: Program, codes: np.ndarray, port: str, clocks_per_bit: int, listing: str) -> tuple[str, str]:
    """The bench of a port, and the file `listing` that it reads. codes: inputs (N, columns)."""
    frames, exchanged = Frames.of(program), exchange(program, codes)
    context = {
        "name": program.name,
        "port": port,
        "clocks_per_bit": clocks_per_bit,
        "frames": len(exchanged),
        "steps": min(FRAMES, len(codes)),
        "patience": PATIENCE,
        "frames_hex": listing,
        "request_size": frames.request_size,
        "answer_size": frames.answer_size,
    }
    text = render("port_bench.v", context, __package__)
    return text, "".join((request + answer)[::-1].hex() + "\n" for request, answer in exchanged)


def steps(program: Program, codes: np.ndarray, count: int) -> list[tuple[bytes, bytes]]:
    """(sample, result) of the first steps, as bytes of AXI4-Stream."""
    outputs = run(program, codes[:count], states=False).outputs
    sides = ((program.inputs, codes[:count]), (program.outputs, outputs))
    samples, results = (lanes([p.signal for p in ports], side) for ports, side in sides)
    return [(s.tobytes(), r.tobytes()) for s, r in zip(samples, results, strict=True)]


def exchange(program: Program, codes: np.ndarray) -> list[tuple[bytes, bytes]]:
    """(request, answer) on the line. A damaged request comes before the second, and the second comes twice."""
    frames = Frames.of(program)
    found: list[tuple[bytes, bytes]] = []
    last, flagged = b"", False
    for n, (sample, result) in enumerate(steps(program, codes, FRAMES)):
        request = frames.request(sample, n, restart=n == 0)
        if n == 1:
            damaged = request[:-1] + bytes([request[-1] ^ 1])
            found.append((damaged, frames.answer(last, n, refused=True, limited=flagged)))
        last, flagged = result, limited(program, result)
        found.append((request, frames.answer(result, n + 1, limited=flagged)))
        if n == 1:
            found.append((request, frames.answer(result, n + 1, refused=True, limited=flagged)))
    return found


def limited(program: Program, result: bytes) -> bool:
    """Whether a code of the result stands at an end of its format."""
    word = int.from_bytes(result, "little")
    return any((word >> c["low"]) & c["mask"] in (c["hi"], c["lo"]) for c in output_codes(program))


def output_codes(program: Program) -> list[dict[str, Any]]:
    """Where each code of an output stands in the result, and the bits at both ends of its format."""
    found, start = [], 0
    for port in program.outputs:
        fix = port.signal.fix
        for _ in range(port.signal.size):
            ends = {"hi": fix.hi, "lo": fix.hi + 1, "mask": (1 << fix.width) - 1}
            found.append({"low": start, "high": start + fix.width - 1, "width": fix.width} | ends)
            start += lane_width(port.signal)
    return found
