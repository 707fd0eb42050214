"""Products of two signals in the serial architecture: a routine that adds one code for each bit of the other.

docs/integer-program.md, "PRODUCT". The routine finds one code in the word `slope`, times a power of two if the result
drops less bits than the other code has, and the other in `argument`. It leaves the result in the accumulator.
"""

from dataclasses import dataclass, field

from greygate.compiler.serial.tables import FACTOR
from greygate.compiler.serial.writer import NOTHING, TAKE, ZERO, Add, Constant, Range, Writer
from greygate.emulator.numbers import Fix, Rounding
from greygate.emulator.program import Product

BEFORE = 3  # bits that the accumulator is shifted before the lowest bit of the product is added


@dataclass
class Multiplied:
    """What a routine multiplies. bits: of the other code. shift: that the result drops, before `doubled` more.

    found: the range of the one code, doubled, over all that call it.
    """

    bits: int
    shift: int
    rounding: Rounding
    out: Fix
    found: Range = field(default=ZERO)

    @staticmethod
    def of(o: Product, one: Fix, other: Fix) -> "Multiplied":
        """The routine of an operation. A shift beyond every bit of the product is cut short."""
        shift = min(one.frac + other.frac - o.out.fix.frac, one.width + other.width + 2)
        return Multiplied(other.width, shift, o.rounding, o.out.fix)

    @property
    def name(self) -> str:
        return f"product of {self.bits} bits, {self.shift} dropped {self.rounding}, to {self.out}"

    @property
    def doubled(self) -> int:
        """Times that the one code is doubled: all but the sign of the other code are shifted out."""
        return max(0, self.bits - 1 - self.shift)

    def meets(self, found: Range) -> None:
        self.found = min(self.found[0], found[0]), max(self.found[1], found[1])

    def write(self, w: Writer, rest: int) -> None:
        w.memory[FACTOR], w.memory["argument"] = self.found, w.range
        half = 1 << (self.shift - 1) if self.shift > 0 and self.rounding is not Rounding.TRUNCATE else 0
        if half and self.rounding is Rounding.HALF_EVEN:
            self.multiply(w, rest, 0)
            self.keep_lowest(w)
            self.multiply(w, rest, half - 1, odd=True)
        else:
            self.multiply(w, rest, half)
        w.limit(self.out.lo, self.out.hi)

    def keep_lowest(self, w: Writer) -> None:
        """Write the lowest bit of the accumulator as the constant that a product begins with."""
        w.write("quotient")
        w.hold()
        w.add(NOTHING, Add.SHIFT, "its lowest bit")
        w.write("half")
        w.load("half")
        w.add("half")
        w.add("quotient", TAKE)
        w.set((0, 1))
        for _ in range(BEFORE + self.doubled):
            w.double(carry=False)
        w.write("odd")

    def multiply(self, w: Writer, rest: int, constant: int, odd: bool = False) -> None:
        """acc = (one * argument + constant) >> shift. odd: and the constant that stands in the word of that name."""
        other = w.memory["argument"]
        w.load("argument")
        for _ in range(rest - 1):
            w.add(NOTHING, Add.SHIFT, "bring the bits of the code to their end")
        w.load(Constant(constant << (BEFORE + self.doubled)))
        if odd:
            w.add("odd")
        first = w.range
        w.add(NOTHING, Add.SHIFT)
        lo, hi = self.found
        w.memory["zero"] = min(0, lo), max(0, hi)
        w.add(NOTHING, choose=True)
        for bit in range(self.bits - 1):
            w.add("zero", choose=True, note=f"bit {bit}")
        w.add("zero", Add.SHIFT | TAKE, "the sign takes it")
        w.add(NOTHING, TAKE)
        w.memory["zero"] = ZERO
        ends = [a * b for a in self.found for b in other]
        places = self.bits - 1
        more = [v >> BEFORE for v in first]
        w.set(((min(ends) + more[0]) >> places, (max(ends) + more[1]) >> places))
        for _ in range(self.shift - places):
            w.add(NOTHING, Add.SHIFT)
