"""How far fixed point may be from float, and how far a program is: measured in closed loop over whole scenarios."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from greygate.compiler.pipeline import fixed_error
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.models.accuracy import float_error, portable_rms
from greygate.models.network import Network
from greygate.models.training.record import Record

SHOWN = 6  # significant digits of an error: every processor agrees on them, and decisions are made with them alone


class Scale(StrEnum):
    """What an error is told in."""

    RANGE = "%"  # RMS of fixed - float, in per cent of the range that float covers in the scenario
    UNIT = "unit"  # RMS of fixed - float, in a unit of the output
    GROWTH = "x"  # RMS error of fixed point against the targets, over that of float


BEYOND = 4.0
USELESS = {Scale.RANGE: 5.0, Scale.UNIT: math.inf, Scale.GROWTH: 2.0}


@dataclass(frozen=True)
class Bound:
    """The largest error that is allowed. limit: inf if none is. unit: of `Scale.UNIT`; factors: output -> what turns
    the output's own unit into that one; outputs that it does not list are not judged."""

    limit: float = math.inf
    scale: Scale = Scale.RANGE
    unit: str = ""
    factors: Mapping[str, float] | None = None

    @property
    def interest(self) -> float:
        """The error beyond which nobody looks at a design: far above the limit, or useless whatever is asked for."""
        return BEYOND * self.limit if math.isfinite(self.limit) else USELESS[self.scale]

    def text(self, value: float) -> str:
        """An error in words, such as 0.31 % or 0.2 bar."""
        if self.scale is Scale.GROWTH:
            return f"{value:.5g} times the error of float"
        return f"{value:.3g} {'%' if self.scale is Scale.RANGE else self.unit}".rstrip()


def agreed(value: float) -> float:
    """The value to as many digits as decide."""
    return float(f"{value:.{SHOWN - 1}e}") if math.isfinite(value) else math.inf


@dataclass(frozen=True)
class Judge:
    """Measures programs of one network on scenarios {name: Record}."""

    network: Network
    records: Mapping[str, Record]
    bound: Bound = Bound()

    @cached_property
    def floats(self) -> dict[str, dict[str, np.ndarray]]:
        """Error of float by scenario and output, in the output's unit."""
        return {name: float_error(self.network, record) for name, record in self.records.items()}

    @cached_property
    def allowed(self) -> dict[str, dict[str, float]]:
        """By scenario and output: the RMS that counts as an error of 1. Raises InputError where float has none."""
        found: dict[str, dict[str, float]] = {}
        for name, errors in self.floats.items():
            found[name] = {}
            for output, error in errors.items():
                if (factor := 1.0 if self.bound.factors is None else self.bound.factors.get(output)) is None:
                    continue
                found[name][output] = self._one(name, output, error) / factor
        if not any(found.values()):
            raise InputError(f"--max-error: no output has a unit that {self.bound.unit or 1} can be converted to")
        return found

    def _one(self, name: str, output: str, error: np.ndarray) -> float:
        record = self.records[name]
        targets = np.asarray(record.targets[output], float)
        if self.bound.scale is Scale.UNIT:
            return 1.0
        if self.bound.scale is Scale.RANGE:
            return (float(np.ptp(error + targets)) or 1.0) / 100
        if (size := portable_rms(error, record.skip)) <= 1e-9 * (float(np.std(targets)) or 1.0):
            raise InputError(f"output {output}: float repeats {name} exactly, so growth means nothing; give per cent")
        return size

    def error(self, program: Program) -> float:
        """The worst error of all scenarios and outputs, to `SHOWN` digits, in the scale of the bound."""
        worst = 0.0
        for name, record in self.records.items():
            found = fixed_error(program, record)
            for output, one in self.allowed[name].items():
                less = 0.0 if self.bound.scale is Scale.GROWTH else self.floats[name][output]
                worst = max(worst, portable_rms(found[output] - less, record.skip) / one)
        return agreed(worst)
