"""The types of the JSON of concealed cases, and of the blind benchmark on them."""

from typing import Annotated, Any, Literal, NotRequired, TypedDict

from greygate.plain import OTHERS, Count, Hash, Json

Verdict = Literal[
    "consistent", "parameter_error", "missing_physics", "partly_explained", "recording_fault", "unexplained"
]


class Third(TypedDict):
    simulation: float
    calibrated: float
    true: float
    unit: str


class Sealed(TypedDict):
    """What is concealed."""

    plant: str
    verdict: Verdict
    effects: list[str]
    equation: list[str]
    depends_on: list[str]
    effects_true: dict[str, float]
    parameters_true: dict[str, float]
    kind: str
    concealed: list[str]
    parameter: str | None
    form: str
    seed: Count
    strength: dict[str, float]
    removable: float
    third: dict[str, Third]
    counted_from: Count
    condition: NotRequired[str]
    faulty: NotRequired[Any]


class Score(TypedDict):
    plant: str
    kind: str
    concealed: list[str]
    form: str
    strength: dict[str, float]
    removable: float
    verdict: str
    named: list[str]
    right_verdict: bool
    right_first: bool | None
    all_named: bool | None
    false_effects: list[str]
    in_set: bool | None
    right_equation: bool | None
    right_place: bool | None
    depends_on: float | None
    right_parameter: bool | None
    inside: dict[str, bool]
    seconds: float
    removed: float | None


class Commitment(TypedDict):
    """SHA-256 of every sealed file of a split."""

    schema: Literal["concealed-bench/1"]
    split: str
    secret_sha256: str | None
    cases: dict[str, dict[str, Hash]]


Vocabulary = Annotated[
    dict[str, dict[str, str]],
    Json(required=["any"]),
    "Plant -> name -> meaning; `any` has what every recording may have.",
]


class Estimate(TypedDict):
    value: float
    ci95: NotRequired[list[float]]
    outside_tolerance: NotRequired[bool]


class Claim(TypedDict):
    name: str
    confidence: NotRequired[Annotated[float, Json(minimum=0, maximum=1)] | None]
    parameters: NotRequired[dict[str, Annotated[Estimate, OTHERS]]]


class Where(TypedDict):
    equation: str
    depends_on: NotRequired[list[str]]


class AnswerFile(TypedDict):
    """What a tool says of a case; any tool can fill it. Everything but `schema` may be absent."""

    schema: Literal["concealed-answer/1"]
    verdict: NotRequired[Verdict | None]
    claims: NotRequired[list[Annotated[Claim, OTHERS]]]
    where: NotRequired[list[Annotated[Where, OTHERS]]]
    parameters: NotRequired[dict[str, Annotated[Estimate, OTHERS]]]
    corrects: NotRequired[bool]


class Ran(TypedDict):
    """How a tool ran on a case."""

    seconds: float
    code: int
    error: str


class Share(TypedDict):
    of: Count
    count: Count


Figures = TypedDict(
    "Figures",
    {
        "cases": Count,
        "errors": Share,
        "wrong names": Share,
        "surely wrong names": Share,
        "cases with a surely wrong name": Share,
        "clean rigs with a claim": Share,
        "right first, strong single effects": Share,
        "right first, single effects": Share,
        "all named, two effects": Share,
        "effect and parameter": Share,
        "parameter found": Share,
        "fault of the recording named": Share,
        "foreign, not explained": Share,
        "foreign, and right equation": Share,
        "inside 95 % intervals": Share,
        "corrections worse than calibrated": Share,
        "of these, with nothing added": Share,
        "worse than the concealed machine, too": Share,
        "median removed": float | None,
        "median seconds": float | None,
        "worst seconds": float | None,
    },
)
Claims = TypedDict("Claims", {"from": float, "to": float, "claims": Count, "right": Count})


class Scored(TypedDict):
    all: Figures
    reliability: list[Claims]


Scores = Annotated[
    dict[str, Annotated[Scored, Json(additionalProperties=Figures)]],
    Json(minProperties=1),
    "Tool -> its figures of all cases, under each condition, of each plant; and how far its confidence can be "
    "believed.",
]
