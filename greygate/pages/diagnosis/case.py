"""What the sections of the page share: the diagnosis, and what each of its fits leaves."""

from dataclasses import dataclass
from functools import cached_property

from greygate.mismatch.diagnosis import Diagnosis
from greygate.mismatch.fit import Fit
from greygate.mismatch.verdict import Verdict
from greygate.pages.diagnosis.residual import Residual, residuals


@dataclass(frozen=True)
class Case:
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
        """The diagnosis corrects more than parameters inside their tolerances."""
        return self.result.verdict != Verdict.CONSISTENT and (self.result.best.size > 0 or bool(self.found["effects"]))

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
