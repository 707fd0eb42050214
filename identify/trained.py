"""What a training came to, for its page and its JSON: what moved, poles, how well each weight is known, residuals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypedDict

import numpy as np

from greygate.errors import InputError
from greygate.models.accuracy import float_error
from greygate.models.adaptation import weight_changes
from greygate.models.linearised import Linearised, linearised
from greygate.models.network import Network
from greygate.models.residuals import Correlation, asks_for, residual_tests
from greygate.models.training.levenberg import RUNAWAY
from greygate.models.training.loss import Loss
from greygate.models.training.objective import Objective
from greygate.models.training.record import Record
from greygate.plain import Count, Figure

LAGS = 25  # of the residual tests, in steps
MOVED = 12  # weights that are listed as those that moved most
SINGULAR = 1e-12  # least eigenvalue of J'J, its diagonal scaled to one: what is below it is not determined
POINTS, LOWEST, HIGHEST = 80, 1e-3, 0.5  # of a frequency response: how many, from where to where, times the sample rate


class Moved(TypedDict):
    weight: str
    before: float
    after: float


class Responses(TypedDict):
    frequency: list[float]
    pairs: dict[str, list[tuple[float, float]]]


class Weight(TypedDict):
    value: float
    deviation: Figure


class Tested(TypedDict):
    record: str
    output: str
    test: str
    passed: bool
    outside: Count
    lags: Count
    do: str


class EvidenceFigures(TypedDict):
    moved: list[Moved]
    poles: Annotated[list[tuple[float, float]], "Real and imaginary part, of one step, the slowest first."]
    response: Annotated[Responses, "Hz; output/input -> real and imaginary part, in the output's unit per the input's."]
    weights: Annotated[dict[str, Weight], "Normalised; null where the recordings do not determine it."]
    tests: list[Tested]


@dataclass(frozen=True)
class Evidence:
    """before, after: the network. about: its linearisation on the first record; None where that diverges.

    weights: name -> (value, standard deviation), normalised. tests: (record, output) -> residual tests of the free run.
    period: s.
    """

    before: Network
    after: Network
    about: Linearised | None
    weights: Mapping[str, tuple[float, float]]
    tests: Mapping[tuple[str, str], Sequence[Correlation]]
    period: float

    @property
    def frequency(self) -> np.ndarray:
        """Hz, (F,)."""
        return np.geomspace(LOWEST, HIGHEST, POINTS) / self.period

    def moved(self) -> list[tuple[str, float, float]]:
        """(weight, before, after), normalised: those that training moved most."""
        old, new = self.before.flatten().parameters(), self.after.flatten().parameters()
        found = [
            (f"{name}[{', '.join(map(str, at))}]", float(old[name][at]), float(new[name][at]))
            for name in weight_changes(self.before, self.after)
            for at in np.ndindex(old[name].shape)
        ]
        return sorted(found, key=lambda w: -abs(w[2] - w[1]))[:MOVED]

    def figures(self) -> EvidenceFigures:
        """As data: complex numbers as [real, imaginary]."""
        frequency = self.frequency
        pairs: dict[str, list[tuple[float, float]]] = {}
        if self.about is not None:
            response = self.about.response(frequency, self.period)
            for o, output in enumerate(self.after.outputs):
                for u, drive in enumerate(self.after.inputs):
                    pairs[f"{output.name}/{drive.name}"] = [(v.real, v.imag) for v in response[:, o, u]]
        return {
            "moved": [{"weight": n, "before": a, "after": b} for n, a, b in self.moved()],
            "poles": [] if self.about is None else [(p.real, p.imag) for p in self.about.poles()],
            "response": {"frequency": frequency.tolist(), "pairs": pairs},
            "weights": {n: {"value": v, "deviation": s} for n, (v, s) in self.weights.items()},
            "tests": [
                {"record": record, "output": output, "test": t.name, "passed": t.passed, "outside": t.outside,
                 "lags": len(t.lags), "do": "" if t.passed else asks_for(t, output)}
                for (record, output), found in self.tests.items()
                for t in found
            ],
        }  # fmt: skip


def evidence(
    before: Network, after: Network, learnt: Sequence[Record], judged: Mapping[str, Record], period: float, decay: float
) -> Evidence:
    """learnt: what was trained on, with its initial states. judged: by name, likewise, from `skip` on."""
    return Evidence(
        before,
        after,
        linearised(after, learnt[0]),
        deviations(after, learnt, decay),
        {(name, o): t for name, r in judged.items() for o, t in _tests(after, r).items()},
        period,
    )


def _tests(network: Network, record: Record) -> dict[str, Sequence[Correlation]]:
    """Of each output; none where the free run diverges or is too short to be tested."""
    if len(record) - record.skip < 4 * (LAGS + 2):
        return {}
    try:
        errors = float_error(network, record)
    except InputError:
        return {}
    inputs = {p.name: np.asarray(record.inputs[p.name], float)[record.skip :] for p in network.inputs}
    return {name: residual_tests(-e[record.skip :], inputs, LAGS) for name, e in errors.items()}


def deviations(network: Network, records: Sequence[Record], decay: float = 0.0) -> dict[str, tuple[float, float]]:
    """Every weight that moves, `layer.port[i, j]` -> (value, standard deviation), both normalised.

    For a residual that is white (Ljung 1999, 9.4): the covariance is s^2 (J'J + D)^-1 J'J (J'J + D)^-1, s^2 the sum of
    squares over samples less weights. decay: D. Initial states count as known. Empty where a free run
    diverges. Raises InputError as `Objective`.
    """
    objective = Objective(network, records)
    squares = objective.squares(objective.theta)
    if not squares <= RUNAWAY * 2 * objective.samples * objective.power:
        return {}
    squared, _ = objective.normal_equations(objective.theta)
    damped = squared + np.diag(Loss(objective, network, decay, {}).decay)
    size = np.sqrt(np.diag(damped))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(damped / np.outer(size, size))
    inverse = vectors / np.maximum(values, SINGULAR) @ vectors.T / np.outer(size, size)
    spread = squares / max(objective.samples - len(objective.free), 1) * (inverse @ squared @ inverse)
    theta, sizes = objective.theta[objective.free], np.sqrt(np.maximum(np.diag(spread), 0.0))
    silent = np.diag(squared) == 0.0  # what no output feels has no value that could be told
    names = _names(objective)
    return {
        names[place]: (float(v), float("inf") if mute else float(s))
        for place, v, s, mute in zip(objective.free.tolist(), theta, sizes, silent, strict=True)
    }


def _names(objective: Objective) -> dict[int, str]:
    """Column of theta -> the name of that weight."""
    shapes = {n: v.shape for n, v in objective.flat.parameters().items()}
    return {
        int(column): f"{name}[{', '.join(map(str, at))}]"
        for name, columns in objective.slices().items()
        for column, at in zip(columns, np.ndindex(shapes[name]), strict=True)
    }
