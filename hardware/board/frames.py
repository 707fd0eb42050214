"""The frames between host and board, as bytes (docs/board.md, "Frames"). rtl/greygate_frame.v is the other end.

A request is SYNC, tag, sample and check sum; an answer is SYNC, tag, result and check sum.
"""

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

from greygate.compiler.verilog import lane_width
from greygate.emulator.fields import to_json
from greygate.emulator.program import Program, Terminal

SYNC = 0x55  # begins a frame
IDLE = 0xFF  # between frames: a byte of ones looks like an idle line wherever a receiver begins to listen
NUMBERS = 32  # samples are numbered modulo this
RESTART = 0x80  # in the tag of a request: the core begins from its initial states
LIMITED, OVERRUN, REFUSED = 0x80, 0x40, 0x20  # in the tag of an answer
AROUND = 4  # bytes of a frame beside the codes: SYNC, tag, check sum
POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, lowest bit first


def seed(program: Program) -> int:
    """Where the check sums of a program's frames begin: 16 bits of its SHA-256, so that no other program answers."""
    text = json.dumps(to_json(program), sort_keys=True)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:2], "little")


def width(ports: tuple[Terminal, ...]) -> int:
    """Bits of a sample or a result on AXI4-Stream."""
    return sum(lane_width(p.signal) * p.signal.size for p in ports)


@cache
def _table() -> tuple[int, ...]:
    rows = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (POLYNOMIAL if byte & 1 else 0)
        rows.append(byte)
    return tuple(rows)


def check_sum(data: bytes, start: int) -> bytes:
    """The two bytes after `data` in a frame."""
    table, crc = _table(), start
    for byte in data:
        crc = crc >> 8 ^ table[(crc ^ byte) & 0xFF]
    return crc.to_bytes(2, "little")


class Answer(NamedTuple):
    """next: number of the sample that the board waits for. result: that of the sample before it, as bytes."""

    next: int
    refused: bool
    overrun: bool
    limited: bool
    result: bytes


@dataclass(frozen=True)
class Frames:
    """The frames of one program. sample, result: their bytes. seed: of the check sums."""

    sample: int
    result: int
    seed: int

    @staticmethod
    def of(program: Program) -> "Frames":
        return Frames(width(program.inputs) // 8, width(program.outputs) // 8, seed(program))

    @property
    def request_size(self) -> int:
        return self.sample + AROUND

    @property
    def answer_size(self) -> int:
        return self.result + AROUND

    def request(self, sample: bytes, number: int, restart: bool = False) -> bytes:
        """The frame that brings a sample."""
        body = bytes([number % NUMBERS | (RESTART if restart else 0)]) + sample
        return bytes([SYNC]) + body + check_sum(body, self.seed)

    def answer(self, result: bytes, following: int, refused: bool = False, limited: bool = False) -> bytes:
        """The frame that brings a result; `following` is the number of the sample that the board waits for."""
        body = bytes([following % NUMBERS | REFUSED * refused | LIMITED * limited]) + result
        return bytes([SYNC]) + body + check_sum(body, self.seed)

    def parse(self, received: bytearray) -> Answer | None:
        """Remove the first answer from what was received, and return it; None if there is no whole one yet.

        Bytes that begin no answer with the right check sum are dropped.
        """
        while (at := received.find(SYNC)) >= 0 and len(received) - at >= self.answer_size:
            body = bytes(received[at + 1 : at + self.answer_size - 2])
            if check_sum(body, self.seed) == received[at + 1 + len(body) : at + self.answer_size]:
                del received[: at + self.answer_size]
                tag = body[0]
                refused, overrun, limited = (bool(tag & flag) for flag in (REFUSED, OVERRUN, LIMITED))
                return Answer(tag % NUMBERS, refused, overrun, limited, body[1:])
            del received[: at + 1]
        if at < 0:
            received.clear()
        return None
