"""The lines of the folded architecture's schedule while they are laid out: fields that act in clocks."""

from collections import defaultdict
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

# Clocks from the read of a code to ...
WORD = 1  # ... the code at the output of the memory, and its weight beside it
SELECT = 2  # ... the stages of its product, in the line
SUM = 4  # ... the sum that takes its product
CODE = 6  # ... the code of a row that ends with it, and `levels` more where several multipliers take turns
ARGUMENT = 2  # ... the argument of a unit that reads the memory
UNIT = 1  # clocks of a unit that is no lookup
CONTROL = 1  # a field of the control acts so many clocks after its line
NEAR = 4  # sums among which one clock can pick
DRAINED, COPIED, SAMPLED, UNITS = range(4)  # numbers of the sources of a write; each unit has one from UNITS up
FIELDS = ("first", "row", "last", "mode", "part", "source", "write", "show", "stored", "done")


def levels_of(multipliers: int) -> int:
    """Clocks in which one of so many sums is picked."""
    levels = 0
    while multipliers > 1:
        multipliers, levels = -(-multipliers // NEAR), levels + 1
    return levels


@dataclass
class Lines:
    """Lines of the ROM while they are laid out.

    controls: field -> {line: value}. bursts: (line, elements read, words and selects of each multiplier).
    """

    controls: dict[str, dict[int, int]] = field(default_factory=lambda: {n: {} for n in FIELDS})
    reads: dict[int, int] = field(default_factory=dict)
    bursts: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)
    notes: dict[int, list[str]] = field(default_factory=lambda: defaultdict(list))

    def control(self, clock: int, **values: int) -> None:
        """Let fields act in a clock. Every field has one value in a line."""
        for name, value in values.items():
            if value:
                assert clock - CONTROL not in self.controls[name], f"two values of {name} in one clock"
                self.controls[name][clock - CONTROL] = value

    @cached_property
    def length(self) -> int:
        """Lines up to the last that does anything."""
        ends = [max(found) for found in (*self.controls.values(), self.reads) if found]
        return 1 + max(ends, default=0)

    def arrays(self, multipliers: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """reads (lines,), words and selects (lines, multipliers), controls (lines, fields), with CLOSING idle lines."""
        count = self.length + CLOSING
        reads, controls = np.zeros(count, np.int64), np.zeros((count, len(FIELDS)), np.int64)
        words, selects = np.zeros((2, count, multipliers), np.int64)
        reads[list(self.reads)] = list(self.reads.values())
        for i, name in enumerate(FIELDS):
            controls[list(self.controls[name]), i] = list(self.controls[name].values())
        for start, elements, w, s in self.bursts:
            n = len(elements)
            reads[start : start + n] = elements
            for m in range(len(w)):
                words[start + WORD + m : start + WORD + m + n, m] = w[m]
                selects[start + SELECT + m : start + SELECT + m + n, m] = s[m]
        return reads, words, selects, controls


CLOSING = 2  # lines that are read while `done` returns the counter
