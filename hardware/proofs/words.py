"""Vectors of a module as expressions of z3, cut where their value is known otherwise."""

from collections.abc import Callable, Sequence
from typing import Any

import z3

from greygate.hardware.proofs.affine import Bit, Module, Vector


class Words:
    """Expressions of a module's vectors. cut: gives the expression of a vector whose driver is not to be followed."""

    def __init__(self, module: Module, cut: Callable[[Vector], Any]):
        self.module, self.cut = module, cut
        self._found: dict[Vector, Any] = {}
        self._undefined = 0

    def word(self, bits: Sequence[Bit]) -> Any:
        """The expression of bits, the lowest first; an undefined bit may have either value."""
        parts: list[Any] = []
        run: list[tuple[Vector, int]] = []
        for bit in [*bits, None]:
            at = self.module.origin(bit) if bit is not None else None
            if run and (not isinstance(at, tuple) or at != (run[0][0], run[0][1] + len(run))):
                vector, first = run[0]
                parts.append(z3.Extract(first + len(run) - 1, first, self.vector(vector)))
                run = []
            if isinstance(at, tuple):
                run.append(at)
            elif at is not None:
                parts.append(z3.BitVecVal(int(at), 1) if at in ("0", "1") else self._free(at))
        return parts[0] if len(parts) == 1 else z3.Concat(*reversed(parts))

    def _free(self, at: str) -> Any:
        """A bit of an input that is no element, which is one bit wherever it is read; a new one for "x"."""
        self._undefined += at == "x"
        return z3.BitVec(f"x{self._undefined}" if at == "x" else at, 1)

    def vector(self, vector: Vector) -> Any:
        """The expression of a vector. Raises NotImplementedError for a cell that has none."""
        if vector not in self._found:
            self._found[vector] = None
            found = self.cut(vector)
            self._found[vector] = self._cell(self.module.cells[vector[0]]) if found is None else found
        if self._found[vector] is None:
            raise NotImplementedError("in a loop")
        return self._found[vector]

    def _cell(self, cell: dict) -> Any:
        kind, ends = cell["type"], cell["connections"]
        parameters = {k: int(v, 2) for k, v in cell["parameters"].items() if set(v) <= {"0", "1"}}
        width = len(ends["Y"]) if "Y" in ends else 0
        signed = all(parameters.get(f"{p}_SIGNED", 1) for p in "AB")
        if kind == "$mux":
            for undefined, other in ("AB", "BA"):  # the answer does not matter where it would be undefined
                if all(self.module.origin(bit) == "x" for bit in ends[undefined]):
                    return self.word(ends[other])
            return z3.If(self._true(ends["S"]), self.word(ends["B"]), self.word(ends["A"]))
        if kind == "$pmux":
            found = self.word(ends["A"])
            for k, bit in enumerate(ends["S"]):
                found = z3.If(self._true([bit]), self.word(ends["B"][k * width : (k + 1) * width]), found)
            return found
        if kind in REDUCED:
            return _extended(_bit(REDUCED[kind](self.word(ends["A"]))), width, False)
        if kind in LOGIC:
            return _extended(_bit(LOGIC[kind](self._true(ends["A"]), self._true(ends.get("B", ["0"])))), width, False)
        if kind in SHIFTS:
            longest = max(len(ends["A"]), width, len(ends["B"])) + 1
            a = _extended(self.word(ends["A"]), longest, bool(parameters.get("A_SIGNED")))
            found = SHIFTS[kind](a, _extended(self.word(ends["B"]), longest, False), bool(parameters.get("A_SIGNED")))
            return z3.Extract(width - 1, 0, found)
        if kind in COMPARED:
            longest = max(len(ends["A"]), len(ends["B"]))
            a, b = (_extended(self.word(ends[p]), longest, signed) for p in "AB")
            return _extended(_bit(COMPARED[kind](a, b, signed)), width, False)
        if kind in COMPUTED:
            a, b = (_extended(self.word(ends[p]), width, signed) if p in ends else None for p in "AB")
            return COMPUTED[kind](a, b)
        raise NotImplementedError(kind)

    def _true(self, bits: Sequence[Bit]) -> Any:
        word = self.word(bits)
        return word != z3.BitVecVal(0, word.size())


def _bit(truth: Any) -> Any:
    return z3.If(truth, z3.BitVecVal(1, 1), z3.BitVecVal(0, 1))


def _extended(word: Any, width: int, signed: bool) -> Any:
    """The word as one of `width` bits: extended, or its low bits."""
    more = width - word.size()
    if more <= 0:
        return z3.Extract(width - 1, 0, word)
    return z3.SignExt(more, word) if signed else z3.ZeroExt(more, word)


def _ones(word: Any) -> Any:
    return word == z3.BitVecVal(-1, word.size())


def _odd(word: Any) -> Any:
    found = z3.Extract(0, 0, word)
    for k in range(1, word.size()):
        found = found ^ z3.Extract(k, k, word)
    return found == z3.BitVecVal(1, 1)


REDUCED: dict[str, Callable] = {
    "$reduce_and": _ones,
    "$reduce_or": lambda a: a != 0,
    "$reduce_bool": lambda a: a != 0,
    "$logic_not": lambda a: a == 0,
    "$reduce_xor": _odd,
    "$reduce_xnor": lambda a: z3.Not(_odd(a)),
}
LOGIC: dict[str, Callable] = {"$logic_and": z3.And, "$logic_or": z3.Or}
SHIFTS: dict[str, Callable] = {
    "$shl": lambda a, b, signed: a << b,
    "$sshl": lambda a, b, signed: a << b,
    "$shr": lambda a, b, signed: z3.LShR(a, b),
    "$sshr": lambda a, b, signed: a >> b if signed else z3.LShR(a, b),
}
COMPARED: dict[str, Callable] = {
    "$eq": lambda a, b, signed: a == b,
    "$eqx": lambda a, b, signed: a == b,
    "$ne": lambda a, b, signed: a != b,
    "$nex": lambda a, b, signed: a != b,
    "$lt": lambda a, b, signed: a < b if signed else z3.ULT(a, b),
    "$le": lambda a, b, signed: a <= b if signed else z3.ULE(a, b),
    "$gt": lambda a, b, signed: a > b if signed else z3.UGT(a, b),
    "$ge": lambda a, b, signed: a >= b if signed else z3.UGE(a, b),
}
COMPUTED: dict[str, Callable] = {
    "$add": lambda a, b: a + b,
    "$sub": lambda a, b: a - b,
    "$mul": lambda a, b: a * b,
    "$and": lambda a, b: a & b,
    "$or": lambda a, b: a | b,
    "$xor": lambda a, b: a ^ b,
    "$xnor": lambda a, b: ~(a ^ b),
    "$not": lambda a, b: ~a,
    "$neg": lambda a, b: -a,
    "$pos": lambda a, b: a,
}
