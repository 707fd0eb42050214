"""rtl/greygate_serial.v in Python: performs the words of a program's code, and trips over what hardware leaves open."""

from greygate.compiler.serial.code import Code
from greygate.emulator.program import Program

STEPS_AT_MOST = 1 << 22  # words of one step


class Machine:
    """The code of a program under way. clocks: words performed since the step began."""

    def __init__(self, program: Program, code: Code):
        self.program, self.code = program, code
        self.memory: dict[int, int | None] = {n: v for n, (v, _) in code.memory.items()}
        self.acc, self.x, self.rest = 0, None, [0] * code.widths["rest"]
        self.place, self.back, self.inside = code.boot, 0, False
        self.word = code.words[0]
        self.pushed: list[int] = []
        self.clocks = 0

    def limited(self, value: int) -> int:
        half = 1 << (self.code.widths["acc"] - 1)
        return (value + half) % (2 * half) - half

    def step(self, sample: int) -> list[int]:
        """Perform words until a result is shown; the outputs' codes."""
        self.pushed, self.clocks = [], 0
        for _ in range(STEPS_AT_MOST):
            shown = self.clock(sample)
            self.clocks += 1
            if shown is not None:
                return shown
        raise AssertionError("no result")

    def clock(self, sample: int) -> list[int] | None:
        (operation, field, _), code, w = self.word, self.code, self.code.widths
        assert operation is not None, "a word that was never written"
        address = self.place
        shift, acc, x = bool(operation & 4), self.acc, self.x
        chosen = operation == 12 and (self.rest[0] if self.inside else sample >> code.bits[address] & 1)
        read = acc % (1 << w["read"]) if operation == 11 else field | chosen
        x_next = self.memory.get(read)
        if operation < 8 or operation == 12:
            assert x is not None, "adds a word that is not known"
            a = acc >> 1 if shift else acc
            a = ~a if operation & 2 else a
            self.acc = self.limited(a + x + (operation & 1))
        elif operation in (9, 11) or (operation == 10 and acc < 0):
            self.acc = 0
        elif operation == 8 and not field >> (w["field"] - 1):
            half = 1 << (w["data"] - 1)
            self.memory[field] = (acc + half) % (2 * half) - half
            x_next = None
        elif operation == 14 and field == 3:
            self.pushed.append(acc)
        self.rest = [*self.rest[1:], acc & 1] if shift else [int(acc < 0), *self.rest[1:]]
        self.place += 1
        if operation == 13:  # the word after it is performed before, and again after
            called = field % (1 << w["entry"]) << w["count"]
            self.place, self.back = (self.back, 0) if self.inside else (called, address)
            self.inside = not self.inside
        shown = None
        if operation == 15:
            shown = [*self.pushed, x, acc][-sum(p.signal.size for p in self.program.outputs) :]
            self.place = code.start
        self.x, self.word = x_next, code.words[address] if address < len(code.words) else (None, 0, "")
        return shown
