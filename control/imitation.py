"""A small network that imitates a controller, trained on the states that the network itself visits.

DAgger (Ross, Gordon, Bagnell 2011): the controller drives first; then the network drives, and the controller says at
every sample what it would have done; the network is trained on all of that, and drives again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from greygate.control.loop import Controller
from greygate.control.predictive import Limits
from greygate.control.stepping import Stepped
from greygate.errors import InputError
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

Feature = Mapping[tuple[str, int], float]
"""(input port, delay) -> weight, in the units of the ports: what the network sees, a sum."""
AHEAD, LAST = "ahead", "last"
APART = 0.25  # of the most that two inputs at a sample can differ by, from which on they are apart


def differences(port: str, delays: Sequence[int], gain: float = 1.0) -> list[Feature]:
    """The changes of a port between neighbours of `delays`."""
    return [{(port, a): gain, (port, b): -gain} for a, b in pairwise(delays)]


def imitator(
    name: str,
    inputs: Sequence[Port],
    drive: Port | Sequence[Port],
    limits: Limits,
    features: Sequence[Feature],
    hidden: int,
    seed: int,
) -> Network:
    """The network before training. Inputs: `ahead`, the reference so many samples ahead that delays reach the present
    one; the measured ports; `last`, the last input. Output: `drive`. Of several drives each has its own last input,
    `last_NAME`, and its own wanted value.

        wanted = W seen + V tanh(U seen + b) + c       seen: the features, fixed sums of delayed inputs
        drive  = limit(last + limit_rate(wanted - last))

    The two limiters are library networks, so no training can break the limits. Raises InputError for a feature of a
    port that is not an input.
    """
    ports = {p.name: p for p in inputs}
    for feature in features:
        for port, _ in feature:
            if port not in ports:
                raise InputError(f"network {name}: a feature reads {port}; its inputs are {', '.join(ports)}")
    drives = [drive] if isinstance(drive, Port) else list(drive)
    network = Network(name, list(inputs), drives)
    taps = sorted({tap for feature in features for tap in feature})
    weights = {
        f"{port}_z{delay}": np.array([[f.get((port, delay), 0.0) * ports[port].scale] for f in features])
        for port, delay in taps
    }
    fixed = Layer(weights, np.zeros(len(features)), frozen={*weights, "bias"})
    network.add("seen", fixed, dict(zip(weights, taps, strict=True)))
    rng, count = np.random.default_rng(seed), len(features)
    spread = rng.normal(size=(hidden, count)) / np.sqrt(count)
    network.add("hidden", Layer({"seen": spread}, rng.normal(size=hidden), "tansig"), {"seen": "seen"})
    for i, own in enumerate(drives):
        start = {"seen": np.zeros((1, count)), "hidden": 0.01 * rng.normal(size=(1, hidden))}
        bounds = [float(np.atleast_1d(v)[i if np.ndim(v) else 0]) for v in (limits.low, limits.high, limits.rate)]
        _driven(network, own, bounds, start, "" if isinstance(drive, Port) else f"_{own.name}")
    return network.check()


def _driven(network: Network, drive: Port, bounds: Sequence[float], start: Mapping[str, np.ndarray], own: str) -> None:
    """Join what is wanted of a drive to it, through the limiters. own: the ending of the names that are its own."""

    def added(name: str, module: Layer | Network, **feeds: str) -> None:
        network.add(f"{name}{own}", module, feeds)

    added("wanted", Layer(start, [0.0]), seen="seen", hidden="hidden")
    one = {"wanted": [[1.0]], "last": [[-1.0]]}
    added("change", Layer(one, [0.0], frozen={*one, "bias"}), wanted=f"wanted{own}", last=f"{LAST}{own}")
    low, high = sorted(drive.normalised(v) for v in bounds[:2])
    rate = min(bounds[2] / abs(drive.scale), high - low)
    added("rate", library("limiter", lo=-rate, hi=rate), x=f"change{own}")
    both = {"rate": [[1.0]], "last": [[1.0]]}
    added("sum", Layer(both, [0.0], frozen={*both, "bias"}), rate=f"rate{own}", last=f"{LAST}{own}")
    added("range", library("limiter", lo=low, hi=high), x=f"sum{own}")
    network.connect(f"range{own}", drive.name)


@dataclass
class Imitated:
    """The network as a controller, beside the network that replaces sensors. Each in float, emulator or hardware.

    ahead: samples by which port `ahead` leads. driven: the input of `sensor` that brings the last input of the plant.
    """

    network: Stepped
    sensor: Stepped | None
    ahead: int
    driven: str
    drive: str

    def reset(self) -> None:
        self.network.reset()
        if self.sensor:
            self.sensor.reset()

    def awaited(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> list[dict[str, float]]:
        """What it reads before its first sample."""
        return []

    def inputs(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> dict[str, float]:
        """What the network reads at a sample."""
        seen = dict(measured)
        if self.sensor:
            seen |= self.sensor.step({**measured, self.driven: before} if self.driven else measured)
        return {**seen, LAST: before, AHEAD: float(reference[self.ahead])}

    def __call__(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> Any:
        return self.network.step(self.inputs(measured, before, reference))[self.drive]


class ImitatedAll(Imitated):
    """A network that gives all of several inputs: each has its own `last_NAME`, each output that tracks `ahead_NAME`.

    Before its first sample it is told the reference up to where it sees ahead, so that it remembers it.
    """

    def __init__(self, network: Stepped, ahead: int, drives: Sequence[str], tracked: Sequence[str]):
        super().__init__(network, None, ahead, "", "")
        self.drives, self.tracked = drives, tracked

    def reset(self) -> None:
        super().reset()
        self.begun = False

    def awaited(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> list[dict[str, float]]:
        if self.begun:
            return []
        self.begun = True
        return [self._row(measured, before, now) for now in reference[: self.ahead]]

    def inputs(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> dict[str, float]:
        return self._row(measured, before, reference[self.ahead])

    def _row(self, measured: Mapping[str, float], before: np.ndarray, ahead: np.ndarray) -> dict[str, float]:
        last = {f"{LAST}_{n}": float(v) for n, v in zip(self.drives, before, strict=True)}
        return {**measured, **last, **{f"{AHEAD}_{n}": float(v) for n, v in zip(self.tracked, ahead, strict=True)}}

    def __call__(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> Any:
        for row in self.awaited(measured, before, reference):
            self.network.step(row)
        answer = self.network.step(self.inputs(measured, before, reference))
        return np.array([answer[n] for n in self.drives])


@dataclass
class Watched:
    """A controller that drives while an expert says what it would do, and what the network would have read.

    The expert's answers are as its actuator would make them. Where the driver has been apart from them for all the time
    that the expert looks ahead, the expert drives until they have agreed for as long (Zhang and Cho 2017): what a young
    network that runs away would see is of no use to anyone.
    """

    driver: Controller | None
    expert: Controller
    reads: Imitated
    limits: Limits

    def __post_init__(self) -> None:
        self.ahead = max(self.expert.ahead, self.reads.ahead)

    def reset(self) -> None:
        self.expert.reset()
        self.reads.reset()
        if self.driver:
            self.driver.reset()
        self.rows: list[dict[str, Any]] = []
        self.led, self.since = False, 0  # by the expert; samples since which that is to change

    def __call__(self, measured: Mapping[str, float], before: Any, reference: np.ndarray) -> Any:
        answer = self.limits.kept(self.expert(measured, before, reference[: self.expert.ahead + 1]), before)
        self.rows += [row | {"answer": before} for row in self.reads.awaited(measured, before, reference)]
        self.rows.append(self.reads.inputs(measured, before, reference) | {"answer": answer})
        if self.driver is None:
            return answer
        driven = self.limits.kept(self.driver(measured, before, reference), before)
        most = np.minimum(2 * self.limits.rate, self.limits.high - self.limits.low)
        apart = bool(np.any(np.abs(driven - answer) > APART * most))
        self.since = self.since + 1 if apart != self.led else 0
        if self.since > self.expert.ahead:
            self.led, self.since = apart, 0
        return answer if self.led else driven

    def record(self, network: Network, skip: int) -> Record:
        """What was read beside the expert's answers."""
        columns = {n: np.array([row[n] for row in self.rows]) for n in self.rows[0]}
        inputs = {p.name: columns[p.name] for p in network.inputs}
        answers = columns["answer"].reshape(len(self.rows), -1).T
        return Record(inputs, {p.name: a for p, a in zip(network.outputs, answers, strict=True)}, skip=skip)


def standardised(network: Network, records: Sequence[Record]) -> Network:
    """The network whose features have mean 0 and deviation 1 over the records; what never moves keeps its size."""
    seen = np.concatenate([network.run(r.inputs, trace=True)["seen"][r.skip :] for r in records])
    layer = network.modules["seen"]
    assert isinstance(layer, Layer)
    size = np.maximum(seen.std(axis=0), 1e-9 * np.abs(seen).max())
    values = {f"seen.{port}": w / size[:, None] for port, w in layer.weights.items()}
    return network.with_parameters(values | {"seen.bias": (layer.bias - seen.mean(axis=0)) / size})


def dagger(
    network: Network,
    visit: Callable[[Network | None], list[Record]],
    rounds: int,
    epochs: int,
    decay: float,
    progress: Progress = silent,
) -> Network:
    """Train by DAgger. visit: drives by a network (by the expert for None) and returns what was seen and answered.

    rounds: for which the network itself drives; it is trained before each, and once more after the last.
    """
    records = visit(None)
    network = standardised(network, records)
    for i in range(rounds + 1):
        trained = train(network, records, epochs=epochs, decay=decay)
        network = network.with_parameters(
            {n: v for n, v in trained.network.parameters().items() if n in network.parameters()}
        )
        progress(f"round {i}: {sum(map(len, records))} samples, loss {trained.history[-1]:.3g}")
        if i < rounds:
            records = records + visit(network)
    return network
