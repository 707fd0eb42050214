"""What the expert decided, on what, and why."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Decision:
    """step: of figure 3.3. about: the term, equation or signal. choice: what was done. reason: why.

    undone: whether the step was taken back, because it failed its test.
    """

    step: str
    about: str
    choice: str
    reason: str
    undone: bool = False

    def __str__(self) -> str:
        return f"{self.step:9} {self.about}: {'UNDONE: ' if self.undone else ''}{self.choice}, because {self.reason}"


class Log:
    """The decisions in their order."""

    def __init__(self) -> None:
        self.decisions: list[Decision] = []

    def __call__(self, step: str, about: str, choice: str, reason: str, undone: bool = False) -> None:
        found = Decision(step, about, choice, reason, undone)
        if found not in self.decisions:
            self.decisions.append(found)

    @property
    def facts(self) -> list[dict]:
        return [asdict(decision) for decision in self.decisions]

    @property
    def text(self) -> str:
        return "".join(f"{i:3} {decision}\n" for i, decision in enumerate(self.decisions, 1))
