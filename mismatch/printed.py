"""The types of diagnosis.json and of what is said of a recording. docs/diagnosis.md describes each entry."""

from typing import Annotated, Any, Literal, NotRequired, TypedDict

from greygate.mismatch.verdict import Verdict
from greygate.plain import Count, Figure, Json


class Band(TypedDict):
    of: str
    at: list[Figure]
    value: list[Figure]
    low: list[Figure]
    high: list[Figure]


class Place(TypedDict):
    equation: str
    depends_on: list[str]
    regime: str
    formula: NotRequired[Annotated[str, "The term that is missing, with its coefficients, where no effect is claimed."]]
    curve: NotRequired[Annotated[Band, "The same over one signal, with 95 % intervals, and no formula behind it."]]
    time: NotRequired[str]
    band: NotRequired[str]


class Fitted(TypedDict):
    value: Figure
    ci95: tuple[Figure, Figure]
    unit: str
    outside_tolerance: NotRequired[Literal[True]]
    place: NotRequired[str]
    term: NotRequired[str]
    against: NotRequired[Annotated[str, "The balance in which the term stands with the opposite sign."]]


class Gained(TypedDict):
    e_value: Figure
    held_out_gain: Figure


class Shown(TypedDict):
    alone: Figure
    without: Figure


class Named(TypedDict):
    id: str
    equations: list[str]
    confidence: float
    parameters: dict[str, Fitted]
    not_told_apart_from: list[str]
    form: NotRequired[str]
    only_with: NotRequired[list[str]]
    share: NotRequired[Figure]
    evidence: NotRequired[Gained]
    shown_by: NotRequired[list[str]]
    recordings: NotRequired[dict[str, Shown]]


class Fits(TypedDict):
    simulation: Figure
    calibrated: Figure
    corrected: Figure
    unit: str


class Own(TypedDict):
    alone: NotRequired[Any]
    parameters: NotRequired[dict[str, Fitted]]
    resampled: NotRequired[str]


class Bound(TypedDict):
    value: Figure
    unit: str


class RuledOut(TypedDict):
    id: str
    parameters: NotRequired[dict[str, Bound]]
    why: NotRequired[str]


class Noisy(TypedDict):
    told: Figure
    found: Figure
    unit: str
    memory: Count
    as_told: bool


class Diagnosed(TypedDict):
    schema: Literal["diagnosis/2"]
    plant: str
    verdict: Verdict
    where: list[Place]
    effects: list[Named]
    parameters: dict[str, Fitted]
    fit: Annotated[
        dict[str, dict[str, Fits]], "Recording -> channel -> RMS with the data sheet, calibrated, corrected."
    ]
    remaining: str
    seconds: float
    recordings: NotRequired[Annotated[dict[str, Own], "By recording, where there are several."]]
    begins: NotRequired[
        Annotated[dict[str, dict[str, Figure]], "By recording and state: how far off its reading a free run begins."]
    ]
    simulation: NotRequired[Annotated[dict[str, Figure], "What the simulation itself leaves open: input_timing, s."]]
    explained: NotRequired[Figure]
    refused: NotRequired[list[str]]
    units: NotRequired[list[str]]
    not_tried: NotRequired[Annotated[list[str], "Hypotheses for which there was no time."]]
    searched: NotRequired[Annotated[Figure, "The share of the recording in which effects were searched, if not all."]]
    not_larger_than: NotRequired[list[RuledOut]]
    noise: NotRequired[dict[str, Noisy]]
    reads: NotRequired[Annotated[list[str], "What a network reads that it was made for, as build-snn and make do."]]


class Rms(TypedDict):
    rms: float | None
    unit: str
    finite: bool


class Failed(TypedDict):
    error: str


Diagnoses = Annotated[
    Diagnosed | Annotated[dict[str, Diagnosed | Failed], Json(minProperties=1)],
    "What a simulation leaves out. docs/diagnosis.md describes each entry. Of several rigs the output is NAME -> "
    'diagnosis, or {"error": line}.',
]
