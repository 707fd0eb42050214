"""What the sections of the page share: the diagnosis, its words, and what each of its fits leaves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.fit import Fit
from greygate.pages.diagnosis.residual import Residual, residuals


class Amount(Protocol):
    """A value in the unit that a person reads, with the ends of its 95 % interval ("" where there is none)."""

    value: str
    low: str
    high: str
    unit: str


@dataclass(frozen=True)
class Words:
    """A diagnosis as the terminal tells it; `greygate.diagnose` finds the words.

    sentence: of the verdict. effects: (entry of the diagnosis, its meaning, [(parameter, amount, fitted term that
    stands for the effect, or "")]). parameters: name -> its value beside the data sheet. fit: a table, line by line.
    alike: explanations that are not told apart. where: (place, what acts there).
    """

    sentence: str
    effects: Sequence[tuple[Mapping, str, Sequence[tuple[str, Amount, str]]]]
    parameters: Mapping[str, str]
    fit: Sequence[str]
    alike: Sequence[str]
    where: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Case:
    """A diagnosis and its words."""

    result: Diagnosis
    words: Words

    @cached_property
    def found(self) -> dict:
        """Content of diagnosis.json."""
        return self.result.as_dict()

    @property
    def title(self) -> str:
        return self.result.rig.folder.resolve().name

    @cached_property
    def changed(self) -> bool:
        """The diagnosis corrects more than parameters inside their tolerances."""
        return self.result.verdict != "consistent" and (self.result.best.size > 0 or bool(self.found["effects"]))

    @cached_property
    def fits(self) -> dict[str, Fit]:
        """The fits that are drawn: "calibrated", and "corrected" where that is another."""
        fits = {"calibrated": self.result.calibrated}
        return fits | ({"corrected": self.result.corrected} if self.changed else {})

    @cached_property
    def residuals(self) -> dict[str, Residual]:
        """What each of `fits` leaves of identify.csv."""
        return dict(zip(self.fits, residuals(self.result, list(self.fits.values())), strict=True))

    @cached_property
    def depends_on(self) -> list[str]:
        """Variables that the diagnosis names as what the mismatch depends on."""
        variables = self.residuals["calibrated"].variables
        return [v for place in self.found["where"] for v in place["depends_on"] if v in variables]
