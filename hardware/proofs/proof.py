"""What came of a proof."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Annotated


@dataclass(frozen=True)
class Proof:
    """what: the claim. how: the method. holds: True; False with a counterexample; None where nothing was shown.

    seconds: that it took. counterexample: what contradicts the claim, or why nothing was shown. figures: of the claim,
    by name, such as {"steps": 5000, "differing bits": 0}. rows: a table of it, such as a row for each signal.
    """

    what: str
    how: str
    holds: Annotated[bool | None, "null: nothing was shown."]
    seconds: float = 0.0
    counterexample: str | None = None
    figures: Mapping[str, float | str | bool | None] = field(default_factory=dict)
    rows: tuple[dict, ...] = ()

    def line(self) -> str:
        """The proof in one line for a person."""
        verdict = {True: "holds", False: "DOES NOT HOLD", None: "not shown"}[self.holds]
        told = "".join(f"; {name} {_short(value)}" for name, value in self.figures.items())
        why = f": {self.counterexample}" if self.counterexample else ""
        return f"{self.what}: {verdict}, by {self.how} ({self.seconds:.1f} s){told}{why}"


def _short(value: float | str | None) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


@contextmanager
def timed() -> Iterator[list[float]]:
    """A list that holds the seconds since the beginning when the block ends."""
    start, found = time.perf_counter(), [0.0]
    try:
        yield found
    finally:
        found[0] = round(time.perf_counter() - start, 2)
