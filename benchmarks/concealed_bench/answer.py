"""The answer of a tool to one case: a JSON file that any tool can fill, and the prediction of the unseen recording.

    {"schema": "concealed-answer/1",
     "verdict": "consistent" | "parameter_error" | "missing_physics" | "partly_explained" | "unexplained" |
                "recording_fault" | null,
     "claims": [{"name": ..., "confidence": 0 to 1 or null, "parameters": {NAME: {"value": ..., "ci95": [low, high]}}}],
     "where": [{"equation": ..., "depends_on": [...]}],
     "parameters": {NAME: {"value": ..., "ci95": [low, high], "outside_tolerance": true}},
     "corrects": false where it predicts by the simulation as it calibrated it, with nothing added}

Everything but `schema` may be absent: a method that gives no names claims nothing and is scored by its prediction.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

from greygate.errors import InputError
from greygate.reading import line as text
from greygate.reading import listed, maybe, named, number, one_of, read_json, table, truth, within

SCHEMA = "concealed-answer/1"
VERDICTS = (
    "consistent", "parameter_error", "missing_physics", "partly_explained", "unexplained", "recording_fault",
)  # fmt: skip
FILE, PREDICTED, RUN = "answer.json", "predicted.csv", "run.json"
ESTIMATE = {"value": number}
FITTED = named(
    lambda v, w: table(v, w, ESTIMATE, {"ci95": listed(number), "outside_tolerance": truth}, others=True), text
)
CLAIM = {"name": text}
MORE = {"confidence": maybe(within(0.0, 1.0, "give 0 to 1")), "parameters": FITTED}
PLACE = {"equation": text}
ENTRIES = {
    "verdict": maybe(one_of(VERDICTS)),
    "claims": listed(lambda v, w: table(v, w, CLAIM, MORE, others=True)),
    "where": listed(lambda v, w: table(v, w, PLACE, {"depends_on": listed(text)}, others=True)),
    "parameters": FITTED,
    "corrects": truth,
}


@dataclass(frozen=True)
class Answer:
    """What a tool says of one case."""

    verdict: str | None = None
    claims: tuple[dict, ...] = ()
    where: tuple[dict, ...] = ()
    parameters: dict[str, dict] = field(default_factory=dict)
    corrects: bool = True

    @property
    def names(self) -> list[str]:
        return [claim["name"] for claim in self.claims]

    def intervals(self) -> dict[str, tuple[float, float]]:
        """Every estimate that has an interval: name -> (low, high)."""
        estimates = dict(self.parameters)
        for claim in self.claims:
            estimates |= claim.get("parameters", {})
        return {name: tuple(e["ci95"]) for name, e in estimates.items() if len(e.get("ci95", ())) == 2}

    def write(self, folder: Path) -> None:
        """Write answer.json to an existing folder."""
        content = {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "claims": list(self.claims),
            "where": list(self.where),
            "parameters": self.parameters,
            "corrects": self.corrects,
        }
        (folder / FILE).write_text(json.dumps(content, indent=1) + "\n")


def read(folder: Path) -> Answer:
    """The answer in `folder`. Raises InputError where it is not as above."""
    path = folder / FILE
    found = read_json(path, "write one as docs/benchmark.md says")
    table(found, f"{path}:", {"schema": one_of((SCHEMA,))}, ENTRIES)
    for place, values in _intervals(found):
        if len(values) != 2 or not values[0] <= values[1]:
            raise InputError(f"{path}: {place}: ci95 {values}; give [low, high]")
    answer = Answer(
        found.get("verdict"),
        tuple(found.get("claims", ())),
        tuple(found.get("where", ())),
        found.get("parameters", {}),
        found.get("corrects", True),
    )
    released = [name for name, estimate in answer.parameters.items() if estimate.get("outside_tolerance")]
    if not answer.corrects and (named := [*answer.names, *released]):
        raise InputError(f"{path}: corrects: false, but {named[0]} is claimed; leave one of both out")
    return answer


def _intervals(found: dict):
    for owner in (found, *found.get("claims", ())):
        for name, estimate in owner.get("parameters", {}).items():
            if "ci95" in estimate:
                yield name, estimate["ci95"]
