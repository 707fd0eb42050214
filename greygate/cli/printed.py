"""The types of what commands print as JSON, where no room makes it whole."""

from dataclasses import dataclass
from typing import Annotated, Any, NotRequired, TypedDict

from greygate.compiler.study import Explored
from greygate.doctor import Tool
from greygate.emulator.program import Clipped
from greygate.export.mjcf import Joint
from greygate.hardware.board.play import Played
from greygate.hardware.proofs.elaborated import Proof
from greygate.hardware.verify import Comparison
from greygate.mismatch.concealed.printed import Score, Sealed
from greygate.mismatch.printed import Rms
from greygate.models.importers.beside import Beside
from greygate.plain import Count, Figure, Hash, Json

Catalogue = Annotated[dict[str, str], "Name -> title of a network or a machine of the catalogue."]
CatalogueTraining = Annotated[
    dict[str, Any], Json(minProperties=1), "Figures of a network of the catalogue; each machine has its own."
]


class BenchMade(TypedDict):
    """A split of the blind benchmark."""

    out: str
    split: str
    cases: Count
    secret_sha256: str | None


class BenchRun(TypedDict):
    """The answers of a tool."""

    out: str
    cases: Count
    errors: Annotated[dict[str, str], "Case -> what failed."]


class Compared(TypedDict):
    figure: str
    where: str
    unit: str
    old: float | None
    new: float | None
    worse: bool
    says: str
    growth: float | None


class Comparing(TypedDict):
    """Two builds."""

    worse: Annotated[Count, "Figures that are worse than allowed."]
    differences: list[Compared]


class StepDone(TypedDict):
    step: str
    figure: str
    file: str
    yes: bool
    seconds: float
    again: Annotated[bool, "It was done before, and nothing that it depends on has changed."]


class Making(TypedDict):
    """What was made of a plant and its recordings."""

    out: str
    page: str
    passed: bool
    unmet: Annotated[str, "Why no design will do; empty where one does."]
    steps: list[StepDone]


PassLeft = TypedDict(
    "PassLeft", {"pass": str, "layers": Count, "parameters": Count, "multiplications": Count, "remarks": list[str]}
)


class OutputRmse(TypedDict):
    unit: str
    float: Figure
    fixed: Figure
    before: NotRequired[Figure]


class Compiling(TypedDict):
    """What was compiled."""

    folder: str
    top: Annotated[str, "The top module."]
    passes: list[PassLeft]
    signals: Annotated[dict[str, str], "Signal -> its format."]
    rmse: Annotated[
        dict[str, dict[str, OutputRmse]],
        "Scenario -> output -> RMSE of float, of fixed point, and of float before pruning.",
    ]
    explored: NotRequired[Explored]
    imported: NotRequired[Annotated[Beside, "A network of another tool beside its own program."]]


class Concealing(TypedDict):
    """A rig with something concealed."""

    out: str
    sha256: Hash


class Controlling(TypedDict):
    """A run of position control."""

    machine: str
    controller: str
    place: str
    case: str
    seed: Count
    rms: float
    worst: float
    effort: float
    violations: Count
    microseconds: float
    limits: Annotated[dict[str, Count], "Limit -> samples in which it was broken."]
    energy: NotRequired[float]
    differing_bits: NotRequired[Count]
    compared_bits: NotRequired[Count]
    clocks: NotRequired[dict[str, float]]


class Doctor(TypedDict):
    """The programs and packages that greygate uses."""

    greygate: Annotated[str, "The version of greygate."]
    healthy: bool
    tools: list[Tool]


class Serving(TypedDict):
    """Where `greygate app` shows a folder; printed when it begins."""

    folder: str
    address: str


class Sampling(TypedDict):
    """The samples that `greygate demo` writes."""

    samples: Annotated[dict[str, str], "Name -> what it is."]
    written: list[str]


class Emulating(TypedDict):
    """A run of the integer program."""

    steps: Count
    saturations: Annotated[dict[str, Count], "Signal -> how often it saturated."]
    clipped: Annotated[dict[str, Clipped], "Input -> values outside its format."]
    out: str


class ExportedC(TypedDict):
    """An export in C99."""

    out: str
    files: list[str]


class ExportedLatex(TypedDict):
    """A plant's equations in LaTeX."""

    plant: str
    out: str


class ExportedMjcf(TypedDict):
    """Joint classes of MuJoCo."""

    out: str
    joints: list[Joint]


class ExportedModelica(TypedDict):
    """A Modelica model."""

    model: str
    out: str


class ChannelRead(TypedDict):
    name: str
    unit: str
    given: Annotated[str, "The unit as it stands in the file."]
    samples: Count
    from_s: float
    to_s: float
    step_s: float | None
    jitter_s: float | None
    gaps: Count
    least: float
    greatest: float


class ModelFit(TypedDict):
    """How well a model fits an output in free run."""

    model: str
    output: str
    unit: str
    rms: Annotated[Figure, "null where it diverges."]
    fit: Annotated[Figure, "Per cent; null where it diverges."]


class Looking(TypedDict):
    """The channels of a recording, or the models on it."""

    recording: str
    channels: list[ChannelRead]
    models: NotRequired[list[ModelFit]]


@dataclass(frozen=True)
class Playing(Played):
    """A recording through a board."""

    saturations: dict[str, Count]
    clipped: dict[str, Count]


class Proving(TypedDict):
    """Proofs of a build."""

    holds: bool
    proofs: list[Proof]


class Revealed(TypedDict):
    answer: Sealed


class Revealing(Revealed, Score):
    right: bool


Reveal = Annotated[Revealing | Revealed, "The sealed answer, and the score of a diagnosis if there is one."]


class Simulating(TypedDict):
    """A simulation against a recording."""

    out: str
    rms: Annotated[dict[str, Rms], "Channel -> RMS of simulated minus recorded; null if the simulation diverges."]


class Verifying(TypedDict):
    """Verilog against emulator."""

    passed: bool
    verdicts: list[Comparison]
    waveforms: Annotated[dict[str, str], "Architecture -> VCD of the first step that differs."]
