"""The verdicts of a diagnosis: what each is called in `diagnosis.json`, and what it says to a person."""

from enum import StrEnum

LEAST_SURE = 0.5  # of confidence in a name, below which something else is likelier


class Verdict(StrEnum):
    """A verdict; its value is the string in `diagnosis.json`, `words` is what a person reads.

    Each of them is an answer: `greygate diagnose` ends with exit code 0 whatever the verdict.
    """

    CONSISTENT = "consistent"
    PARAMETER_ERROR = "parameter_error"
    MISSING_PHYSICS = "missing_physics"
    PARTLY_EXPLAINED = "partly_explained"
    RECORDING_FAULT = "recording_fault"
    UNEXPLAINED = "unexplained"

    @property
    def words(self) -> str:
        """One sentence: the verdict's name and what it means."""
        return f"{self.replace('_', ' ')}: {_MEANS[self]}"


_MEANS = {
    Verdict.CONSISTENT: "the parameters alone explain the recording",
    Verdict.PARAMETER_ERROR: "one parameter lies outside its tolerance, and that explains the recording",
    Verdict.MISSING_PHYSICS: "the simulation leaves out what is named here",
    Verdict.PARTLY_EXPLAINED: "what is named here is missing, and something else too",
    Verdict.RECORDING_FAULT: "the recording is at fault, not the simulation",
    Verdict.UNEXPLAINED: "something is missing that no effect of the table has",
}
