"""The verdicts of a diagnosis: what each is called in `diagnosis.json`, and what it says to a person."""

from enum import StrEnum


class Verdict(StrEnum):
    """A verdict; its value is the string in `diagnosis.json`, `words` is what a person reads.

    Each of them is an answer: `greygate diagnose` ends with exit code 0 whatever the verdict.
    """

    words: str

    CONSISTENT = "consistent", "consistent: the parameters, inside their tolerances, explain the recording"
    PARAMETER_ERROR = (
        "parameter_error",
        "parameter error: one parameter lies outside its tolerance, and that explains the recording",
    )
    MISSING_PHYSICS = "missing_physics", "missing physics: the simulation leaves out what is named here"
    UNEXPLAINED = "unexplained", "unexplained: something is missing that no effect of the table has"

    def __new__(cls, value: str, words: str) -> "Verdict":
        member = str.__new__(cls, value)
        member._value_, member.words = value, words
        return member
