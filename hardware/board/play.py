"""Plays samples through a board and compares its results with those of the emulator, bit for bit.

The host sends requests ahead, each followed by as many idle bytes as the board needs for its step and its answer, so
that the board never waits for the host. After a fault on the line it goes on from the sample that the board waits for;
where a result was lost that the board no longer has, from the beginning.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.hardware.board.frames import IDLE, NUMBERS, Answer, Frames
from greygate.hardware.verify import lanes, words
from greygate.plain import Count

AHEAD = NUMBERS // 2  # requests that may be under way: fewer than the numbers, so that none is taken for another
LINE = 2048  # bytes that may be under way: more would only wait in the computer
SPARE = 4  # idle bytes beyond those of an answer, at first: time for a step, and for two clocks that differ
MOST_SPARE = 1 << 10  # beyond it the host sends no request before the answer to the last
GROWTH = 4  # of the idle bytes when they were too few, which shows within ...
SOON = 64  # samples; a fault after more of them is taken for noise
PATIENCE = 0.25  # s without an answer after which the line is taken for silent; USB bridges hold bytes back for 16 ms
QUIET = 0.05  # s of silence, beyond the time of the bytes under way, after which nothing more comes
TRIES = 4  # of one sample
RESTARTS = 8
FEWER = 4  # by this the requests ahead are divided when the board was ahead of its answers


class Line(Protocol):
    """What is needed of a serial port: bytes to write, and those that have come within its time-out."""

    baudrate: int

    def write(self, data: bytes, /) -> int | None: ...

    def read(self, size: int = 1, /) -> bytes: ...


def opened(port: str, baud: int) -> Any:
    """The serial port. Raises InputError if pyserial is not installed or the port cannot be opened."""
    try:
        import serial
    except ImportError:
        raise InputError("pyserial is not installed; pip install greygate[board]") from None
    try:
        return serial.Serial(port, baud, timeout=0.01, write_timeout=PATIENCE * 10, exclusive=True)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise InputError(f"--port {port}: cannot be opened ({why}); name the board's serial port") from None


@dataclass
class Session:
    """One board, and what became of the line. results: bytes of each step that was answered, in order."""

    line: Line
    frames: Frames
    samples: Sequence[bytes]
    told: Callable[[int], None] = lambda done: None
    results: list[bytes] = field(default_factory=list)
    resent: int = 0
    restarts: int = 0
    overruns: int = 0
    limited: int = 0
    received: bytearray = field(default_factory=bytearray)
    heard: int = 0  # bytes
    spare: int = SPARE
    ahead: int = AHEAD

    @property
    def transit(self) -> float:
        """Seconds that the bytes under way take at most; ten bits each."""
        return 10 * LINE / self.line.baudrate

    def run(self) -> None:
        """Play every sample. Raises InputError if the board does not answer."""
        self.restore()
        while len(self.results) < len(self.samples):
            if not self.stream():
                self.restore()

    def stream(self) -> bool:
        """Send requests ahead until all are answered (true), or until an answer is missing or refused (false)."""
        first = sent = len(self.results)
        idle = bytes([IDLE]) * (self.frames.answer_size + self.spare if self.ahead > 1 else 0)
        ahead = max(1, min(self.ahead, LINE // (self.frames.request_size + len(idle))))
        until = time.monotonic() + PATIENCE + self.transit
        while len(self.results) < len(self.samples):
            while sent < len(self.samples) and sent - len(self.results) < ahead:
                self.line.write(self.frames.request(self.samples[sent], sent) + idle)
                sent += 1
            before = len(self.results)
            right = all(self.taken(answer, len(self.results)) for answer in self.answers())
            if len(self.results) > before:
                until = time.monotonic() + PATIENCE + self.transit
                self.told(len(self.results))
            if not right or time.monotonic() > until:
                if len(self.results) - first < SOON and ahead > 1:
                    self.spare *= GROWTH
                    self.ahead = self.ahead if self.spare <= MOST_SPARE else 1
                return False
        return True

    def restore(self) -> None:
        """Bring the next sample alone, as often as needed; begin again where a result is lost."""
        for _ in range(TRIES):
            self.settle()
            number = len(self.results)
            if number == len(self.samples):
                return
            self.resent += number > 0
            self.line.write(self.frames.request(self.samples[number], number, restart=number == 0))
            answer = self.wait()
            if answer is None:
                continue
            if self.taken(answer, number):
                self.told(len(self.results))
                return
            if number and answer.next == (number + 1) % NUMBERS:  # it has been stepped, and its answer was lost
                self.take(answer)
                return
            if number and answer.next != number % NUMBERS:
                self.again()
                return
        raise InputError(self.silence())

    def again(self) -> None:
        """Begin from the first sample, with fewer requests ahead: none is lost where there is but one."""
        self.restarts += 1
        if self.ahead == 1 and self.restarts > RESTARTS:
            raise InputError(f"the line loses answers again and again ({self.resent} samples were sent twice)")
        self.ahead = max(1, self.ahead // FEWER)
        self.results.clear()
        self.overruns = self.limited = 0
        self.restore()

    def taken(self, answer: Answer, number: int) -> bool:
        """Keep the result if the answer is that to the sample of this number."""
        if answer.refused or answer.next != (number + 1) % NUMBERS:
            return False
        self.take(answer)
        return True

    def take(self, answer: Answer) -> None:
        self.results.append(answer.result)
        self.overruns += answer.overrun
        self.limited += answer.limited

    def answers(self) -> list[Answer]:
        """Those that have come."""
        data = self.line.read(max(1, self.frames.answer_size))
        self.heard += len(data)
        self.received += data
        found = []
        while (answer := self.frames.parse(self.received)) is not None:
            found.append(answer)
        return found

    def wait(self) -> Answer | None:
        """The next answer; None after PATIENCE."""
        until = time.monotonic() + PATIENCE + self.transit
        while time.monotonic() < until:
            if found := self.answers():
                return found[0]
        return None

    def settle(self) -> None:
        """Fill up whatever the board believes to be a frame, and wait until it is silent.

        Answers that were only late are kept; before the first sample they belong to an earlier session.
        """
        self.line.write(bytes([IDLE]) * (self.frames.request_size + self.frames.answer_size))
        quiet = (QUIET if self.results else PATIENCE / 2) + self.transit
        until = time.monotonic() + quiet
        while time.monotonic() < until:
            before = self.heard
            found = self.answers()
            if self.heard > before:
                until = time.monotonic() + quiet
            if self.results:
                all(self.taken(answer, len(self.results)) for answer in found)
        self.received.clear()

    def silence(self) -> str:
        """Why there is no answer, as far as one can tell."""
        if self.results:
            return f"sample {len(self.results)}: no answer after {TRIES} tries; check the plug and play again"
        if self.heard:
            return "what answers is no board with this build: compare the build, its bitstream and --baud"
        return "nothing answers: load the bitstream of this build, check the plug, and --baud"


@dataclass(frozen=True)
class Played:
    """What came of it. mismatch: the first differing code, in words, or None."""

    samples: Count
    differing_samples: Count
    differing_bits: Count
    mismatch: str | None
    seconds: float
    resent: Count
    restarts: Count
    overruns: Count
    limited: Count


def play(
    program: Program,
    inputs: np.ndarray,
    expected: np.ndarray,
    line: Line,
    told: Callable[[int], None] = lambda done: None,
) -> Played:
    """Play input codes (N, columns) through a board; compare its results with the expected codes (N, columns).

    line: an open serial port. told: is called with the number of samples that have been answered.
    Raises InputError if the board does not answer.
    """
    frames = Frames.of(program)
    samples = [row.tobytes() for row in lanes([p.signal for p in program.inputs], inputs)]
    session = Session(line, frames, samples, told)
    begun = time.perf_counter()
    session.run()
    seconds = time.perf_counter() - begun
    got = np.frombuffer(b"".join(session.results), np.uint8).reshape(len(samples), -1)
    right = lanes([p.signal for p in program.outputs], expected)
    differing = np.bitwise_count(got ^ right).sum(axis=1)
    return Played(
        len(samples),
        int(np.count_nonzero(differing)),
        int(differing.sum()),
        _mismatch(program, got, right),
        seconds,
        session.resent,
        session.restarts,
        session.overruns,
        session.limited,
    )


def _mismatch(program: Program, got: np.ndarray, right: np.ndarray) -> str | None:
    rows, columns = np.nonzero(got != right)
    if not len(rows):
        return None
    step = int(rows[0])
    for name, size, start in words([replace(p.signal, name=p.name) for p in program.outputs]):
        if start <= columns[0] < start + size:
            codes = (
                int.from_bytes(side[step, start : start + size].tobytes(), "little", signed=True)
                for side in (got, right)
            )
            return "step {}: {} has the code {} instead of {}".format(step, name, *codes)
    raise AssertionError("a byte of no output")
