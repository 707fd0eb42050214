"""What a design costs on an FPGA, told in milliseconds: a count of its parts, and what Yosys made of such parts.

The parts of each architecture are counted here, from the program alone. `cost.toml` says what a part of each kind
takes on each family. `python -m benchmarks calibrate` fits it to synthesized designs, and states its error on others.
"""

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from greygate.compiler.folding.schedule import fold
from greygate.compiler.limits import clamps_behind
from greygate.compiler.serial.code import compiled
from greygate.compiler.targets import FACTORS, Design, Memory, architecture
from greygate.compiler.targets.folded import DEEP
from greygate.compiler.targets.folded import memories as folded_memories
from greygate.emulator.numbers import signed_width
from greygate.emulator.program import Affine, Lookup, Product, Program
from greygate.emulator.tables import Lines, Table

COEFFICIENTS = Path(__file__).with_name("cost.toml")
LOOKUP, PRODUCT, EDGES = 3, 2, 2  # clocks of a lookup, of a product, and of a step beside its longest chain
SHARED = 0.5  # part of the digits of single weights that is left when equal patterns are summed once

# Shapes (words, bits) that one block of memory can have with one read port, and with two; and how many a family counts
# it as. Lattice ECP5: technical note FPGA-TN-02204; iCE40: FPGA-TN-02002; Xilinx 7 series: UG473.
BLOCKS: dict[str, tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...], float]] = {
    "ecp5": (((512, 36), (1024, 18), (2048, 9), (4096, 4)), ((1024, 18), (2048, 9), (4096, 4)), 1.0),
    "ice40": (((256, 16), (512, 8), (1024, 4), (2048, 2)), (), 1.0),
    "xilinx": (((512, 36), (1024, 18), (2048, 9), (4096, 4)), ((1024, 18), (2048, 9), (4096, 4)), 0.5),
}
WORTH = {"ecp5": 2048, "ice40": 1024, "xilinx": 7000}  # bits in each block from which Yosys 0.70 takes blocks
OPERATION = 4  # bits of a word of the serial architecture beside its field
BLOCKS_ALONE = {"ice40"}  # families without memory made of LUTs
MULTIPLIERS = {"ecp5": (18, 18), "ice40": (16, 16), "xilinx": (25, 18)}  # widths that one DSP multiplies
SMALL = {"ecp5": 0, "ice40": 11, "xilinx": 9}  # bits of a product up to which Yosys 0.70 takes LUTs


@dataclass(frozen=True)
class Cost:
    """luts, dsps, memories: as the family counts them. clocks: of a step. period: shortest clock, ns."""

    luts: int
    dsps: int
    memories: float
    clocks: int
    period: float

    @property
    def microseconds(self) -> float:
        """Of a step."""
        return round(self.clocks * self.period / 1e3, 4)


def blocks(family: str, words: int, bits: int, ports: int = 1) -> float:
    """Blocks of memory that hold `words` of `bits`, each block read through that many ports."""
    one, two, worth = BLOCKS[family]
    shapes = (one, two)[ports - 1]
    return worth * min(math.ceil(words / w) * math.ceil(bits / b) for w, b in shapes)


def filled(family: str, words: int, bits: int) -> float:
    """Blocks of memory that `words` of `bits` would take if a block could have any shape."""
    (deep, wide), *_ = BLOCKS[family][0]
    return BLOCKS[family][2] * words * bits / (deep * wide)


def tiles(family: str, a: int, b: int) -> int:
    """DSPs that a signed product of that many by that many bits takes."""
    wide, narrow = MULTIPLIERS[family]
    if a + b < SMALL[family]:
        return 0
    return min(math.ceil(x / wide) * math.ceil(y / narrow) for x, y in ((a, b), (b, a)))


@cache
def coefficients() -> dict:
    """The table of the package."""
    return tomllib.loads(COEFFICIENTS.read_text(encoding="utf-8"))


def digits(numbers: np.ndarray) -> np.ndarray:
    """Digits other than zero of each whole number, in canonical signed form."""
    size = np.abs(numbers).astype(np.uint64)
    return np.bitwise_count((np.uint64(3) * size) ^ size)


def odd_bits(numbers: np.ndarray) -> np.ndarray:
    """Bits of the odd part of each whole number, 0 for 0."""
    size = np.abs(numbers)
    odd = size // np.maximum(size & -size, 1)
    return np.where(size > 0, np.floor(np.log2(np.maximum(odd, 1))) + 1, 0)


@dataclass(frozen=True)
class Sums:
    """Of one affine operation: weights other than zero, bits of its adders, and bits of its results."""

    products: int
    adders: float
    results: int


def sums(program: Program, o: Affine) -> Sums:
    """Estimate the adders of an operation whose constants are adder graphs."""
    widths = np.array([program.signals[a].fix.width for a in o.args for _ in range(program.signals[a].size)])
    present = o.weights != 0
    inside = (np.maximum(digits(o.weights).astype(float) - 1, 0) * (widths + odd_bits(o.weights))).sum() * SHARED
    terms = present.sum(axis=1) + (o.bias != 0)
    low = np.where(present, np.abs(o.weights) & -np.abs(o.weights), np.int64(1) << 62).min(axis=1)
    reach = np.abs(o.weights).astype(float) @ np.exp2(widths - 1.0) + np.abs(o.bias)
    height = np.log2(np.maximum(reach, 1)) + 1 - np.log2(np.maximum(low, 1))
    between = (np.maximum(terms - 1, 0) * np.maximum(height, 0)).sum()
    return Sums(int(present.sum()), float(inside + between), o.out.size * o.out.fix.width)


def trivial(program: Program, o: Affine) -> bool:
    """Whether an operation only shifts and rounds one element into each of its own."""
    return bool((np.count_nonzero(o.weights, axis=1) <= 1).all() and not o.bias.any()
                and (digits(o.weights) <= 1).all())  # fmt: skip


@dataclass(frozen=True)
class Parts:
    """What a design is made of. luts: parts by kind, whose size `cost.toml` knows. dsps, memories: counted.

    filled: memories if blocks could be filled to the last bit.
    """

    luts: Mapping[str, float]
    dsps: int
    memories: float
    filled: float

    def sized(self, family: str, name: str) -> float:
        """The LUTs of all parts of that architecture."""
        table = coefficients()[family][name]["luts"]
        return sum(table.get(kind, 0.0) * number for kind, number in self.luts.items())


def _kept_width(value: int) -> int:
    """Bits of a number in a table, where only a negative one needs a sign."""
    return signed_width(value) if value < 0 else max(1, value.bit_length())


def _word(program: Program, o: Lookup) -> tuple[int, int, int, int]:
    """(words, bits of a word, and the widths of the two factors of a line) of the memory of a lookup."""
    t = program.table[o.table]
    if isinstance(t, Table) and not (t.interpolated and t.shift):
        return len(t.points), t.out.width, 0, 0
    found = t.segments
    base, slope = (max(map(_kept_width, part)) for part in (found.bases, found.slopes))
    place = max(shift - drop for shift, drop in zip(found.shifts, found.drops, strict=True))
    return len(found.bases), base + slope, slope, place + 1


def _octaves(program: Program, o: Lookup) -> float:
    """What chooses the part of a table in which its segments are equal: the argument's bits, for each such part."""
    t = program.table[o.table]
    parts = len(t.segments.shifts) if isinstance(t, Lines) else 1
    return float((parts - 1) * program.signals[o.arg].fix.width)


def _rom(program: Program, o: Lookup) -> str:
    """The kind of part that the words of a table are in LUTs: those of unequal segments have less in common."""
    return "segments" if isinstance(program.table[o.table], Lines) else "rom"


def _small(program: Program) -> float:
    """Bits that the clamps, thresholds, selects and products take in and give."""
    other = (o for o in program.operations if not isinstance(o, Affine | Lookup))
    return float(sum(o.out.size * (o.out.fix.width + sum(program.signals[a].fix.width for a in o.args)) for o in other))


def _ports(program: Program) -> float:
    """Bits of the samples that come and go."""
    return float(sum(p.signal.size * p.signal.fix.width for p in program.inputs + program.outputs))


def _factors(program: Program, o: Product) -> tuple[int, int]:
    """Widths of what is multiplied."""
    one, other = (program.signals[a].fix.width for a in o.args)
    return one, other


def served(program: Program, since: Mapping[str, int]) -> list[tuple[Lookup, int]]:
    """(one of its lookups, neurons) of the units that answer lookups: those of one table take turns if they can.

    since: clock at which each signal stands.
    """
    turns: dict[str, dict[int, int]] = {}
    for o in program.operations:
        if isinstance(o, Lookup):
            at = turns.setdefault(o.table, {})
            at[since[o.arg]] = at.get(since[o.arg], 0) + o.out.size
    one = {o.table: o for o in program.operations if isinstance(o, Lookup)}
    return [(one[table], max(sizes.values())) for table, sizes in turns.items()]


def parallel(program: Program, design: Design, family: str) -> Parts:
    """Every sum of adders of its own, every two units of a table a memory of their own where it has two ports."""
    luts = dict.fromkeys(("adders", "results", "lookups", "octaves", "products", "rom", "segments"), 0.0)
    luts |= {"small": _small(program), "ports": _ports(program), "core": 1.0}
    dsps, left, memories, full, both = 0, design.dsps, 0.0, 0.0, bool(BLOCKS[family][1])
    for o in program.operations:
        if isinstance(o, Affine):
            found = sums(program, o)
            luts["adders"] += found.adders
            luts["results"] += 0.0 if trivial(program, o) else found.results
    for o, units in served(program, standing(program, design)):
        words, bits, slope, rest = _word(program, o)
        luts["lookups"] += units * (program.signals[o.arg].fix.width + 2 * o.out.fix.width)
        luts["octaves"] += units * _octaves(program, o)
        if slope:
            in_dsps = min(units, left)
            left -= in_dsps
            dsps += in_dsps * tiles(family, slope, rest)
            luts["products"] += (units - in_dsps) * slope * rest
        if design.memory is Memory.BLOCK:
            one = blocks(family, words, bits)
            memories += min(units * one, math.ceil(units / 2) * blocks(family, words, bits, 2)) if both else units * one
            full += units / (2 if both else 1) * filled(family, words, bits)
        else:
            luts[_rom(program, o)] += units * words * bits
    for o in (o for o in program.operations if isinstance(o, Product)):
        in_dsps = min(o.out.size, left)
        left -= in_dsps
        dsps += in_dsps * tiles(family, *_factors(program, o))
        luts["products"] += (o.out.size - in_dsps) * math.prod(_factors(program, o))
    return Parts(luts, dsps, memories, full)


def factor(family: str) -> int:
    """Bits of the widest factor that one DSP of a family takes on either side."""
    return min(*MULTIPLIERS[family], FACTORS[-1])


def folded(program: Program, design: Design, family: str) -> Parts:
    """Some multipliers, a memory of codes, a schedule and biases in ROM; lookups in equal tables share one."""
    folding, m = fold(program, design.multipliers, design.factor), design.multipliers
    products, acc = folding.products, folding.acc_width
    schedule, biases, ram = folded_memories(program, design)
    luts = {"multipliers": float(m * acc), "stages": float(m * acc * len(products.stages))}
    luts |= {"drain": float(acc * len(folding.modes)), "code": float(ram[1]), "line": float(schedule[1])}
    luts |= {"small": _small(program), "ports": _ports(program), "core": 1.0}
    luts |= dict.fromkeys(("lookups", "octaves", "rom", "segments", "ram"), 0.0)
    dsps, taken = m * tiles(family, products.x_width, products.word_width), 0.0
    full = 0.0
    pairs = any(isinstance(o, Product) for o in folding.units.values())  # read at two places: two memories of codes
    for (words, bits), kind in ((schedule, "rom"), (biases, "rom"), *[(ram, "ram")] * (1 + pairs)):
        need = blocks(family, words, bits)
        worth = family in BLOCKS_ALONE or words * bits * BLOCKS[family][2] >= WORTH[family] * need
        if words >= DEEP if kind == "rom" else worth:
            taken, full = taken + need, full + filled(family, words, bits)
        else:
            luts[kind] += words * bits
    for o in {o.table: o for o in program.operations if isinstance(o, Lookup)}.values():
        words, bits, slope, rest = _word(program, o)
        luts["lookups"] += program.signals[o.arg].fix.width + 2 * o.out.fix.width
        luts["octaves"] += _octaves(program, o)
        dsps += tiles(family, slope, rest) if slope else 0
        if design.memory is Memory.BLOCK:
            taken, full = taken + blocks(family, words, bits), full + filled(family, words, bits)
        else:
            luts[_rom(program, o)] += words * bits
    dsps += sum(tiles(family, *_factors(program, o)) for o in folding.units.values() if isinstance(o, Product))
    return Parts(luts, dsps, taken, full)


def standing(program: Program, design: Design) -> dict[str, int]:
    """Signal -> clock at which it stands, an estimate: each sum is a tree with a register after every few adders."""
    since, with_sums = dict.fromkeys(program.signals, 0), clamps_behind(program)
    for o in program.operations:
        clocks = (
            LOOKUP
            if isinstance(o, Lookup)
            else PRODUCT
            if isinstance(o, Product)
            else 0
            if o.args[0] in with_sums
            else 1
        )
        if isinstance(o, Affine):
            terms = int(digits(o.weights).sum(axis=1).max()) + 1
            clocks = max(1, -(-(terms - 1).bit_length() // design.adders)) if design.adders else 1
        since[o.out.name] = clocks + max(since[a] for a in o.args)
    return since


def parallel_clocks(program: Program, design: Design) -> int:
    """An estimate of the clocks of a step."""
    return max(standing(program, design).values()) + EDGES


def serial(program: Program, design: Design, family: str) -> Parts:
    """One adder with an accumulator, a memory of code and one of numbers."""
    code = compiled(program)
    w, deep = code.widths, max(code.memory) + 1
    luts = {"acc": float(w["acc"]), "address": float(w["code"] + w["field"] + w["read"])}
    luts |= {"ports": _ports(program), "core": 1.0}
    kept = (len(code.words), w["field"] + OPERATION), (deep, w["data"])
    return Parts(luts, 0, *(sum(count(family, *shape) for shape in kept) for count in (blocks, filled)))


CLOCKS: dict[str, Callable[[Program, Design], int]] = {"parallel": parallel_clocks}  # where counting takes long
COUNTS: dict[str, Callable[[Program, Design, str], Parts]] = {"parallel": parallel, "folded": folded, "serial": serial}


def explored() -> tuple[str, ...]:
    """The architectures whose parts and clocks are known."""
    return tuple(name for name in COUNTS if architecture(name).clocks is not None)


def clocks_of(program: Program, name: str, design: Design, exact: bool = False) -> int:
    """Clocks from one sample to the next. exact: as the design is written, not as it is estimated quickly."""
    count = architecture(name).clocks if exact or name not in CLOCKS else CLOCKS[name]
    assert count is not None, f"{name} is not explored"
    return count(program, design)


def cost(program: Program, name: str, design: Design, family: str, clocks: int | None = None) -> Cost:
    """What the program costs as that architecture. clocks: of a step, if they are known."""
    if clocks is None:
        clocks = clocks_of(program, name, design)
    parts = COUNTS[name](program, design, family)
    period = coefficients()[family][name]["period"]
    return Cost(math.ceil(parts.sized(family, name)), parts.dsps, parts.memories, clocks, period)
