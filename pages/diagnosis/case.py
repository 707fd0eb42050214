"""Shared by the sections of the page: the diagnosis, and the residual of each of its fits."""

from dataclasses import dataclass
from functools import cached_property

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.fit import Fit
from greygate.mismatch.verdict import Verdict
from greygate.pages.diagnosis.residual import Residual, residuals


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosis as its page reads it."""

    result: Diagnosis

    @cached_property
    def found(self) -> dict:
        """Content of diagnosis.json."""
        return self.result.as_dict()

    @property
    def title(self) -> str:
        return self.result.rig.folder.resolve().name

    @cached_property
    def changed(self) -> bool:
        """Whether the diagnosis corrects more than parameters within their tolerances."""
        return self.result.verdict != Verdict.CONSISTENT and (self.result.best.size > 0 or bool(self.found["effects"]))

    @cached_property
    def fits(self) -> dict[str, Fit]:
        """The fits to draw: "calibrated", and "corrected" if it differs."""
        fits = {"calibrated": self.result.calibrated}
        return fits | ({"corrected": self.result.corrected} if self.changed else {})

    @cached_property
    def residuals(self) -> dict[str, Residual]:
        """The residual of each of `fits` on identify.csv."""
        return dict(zip(self.fits, residuals(self.result, list(self.fits.values())), strict=True))

    @cached_property
    def depends_on(self) -> list[str]:
        """The variables on which the mismatch depends, according to the diagnosis."""
        variables = self.residuals["calibrated"].variables
        return [v for place in self.found["where"] for v in place["depends_on"] if v in variables]
