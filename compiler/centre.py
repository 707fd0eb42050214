"""Bias correction: move each rounded sum so that its average over a record equals that of the float network.

Rounded weights and tables shift the mean of a sum slightly. Inside a loop that drives an integrator, the shift would
add up to an offset of the output. Nagel et al. 2019 correct the biases of feed-forward networks in this way. Here every
step starts from the states of the float network, so that the error of one step is measured without the drift of the
loop.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greygate.compiler.ranges import sums
from greygate.emulator.engine import run
from greygate.emulator.program import Affine, Program
from greygate.models.arithmetic import mean, product
from greygate.models.network import Network
from greygate.models.training.objective import Objective, traces
from greygate.models.training.record import Record

SAMPLES = 2000  # steps of all records together, evenly spread
FLIPPED = 100.0  # times the median distance from the median error: beyond it a comparison has flipped


def centre_biases(program: Program, network: Network, records: Sequence[Record]) -> Program:
    """Correct the biases of every AFFINE operation that rounds weights, in program order, on records."""
    objective = Objective(network, list(records))
    past: dict[str, list[np.ndarray]] = {}  # signal -> by delay, its values at the chosen steps of all records
    chosen, rest, layers = [], objective.flat.rest(), objective.flat.layers()
    for record, trace in zip(records, traces(objective), strict=True):
        count = max(1, min(SAMPLES // len(records), len(trace)))
        steps = np.unique(np.linspace(0, len(trace) - 1, count).astype(int))
        chosen.append(program.encode(record.inputs)[steps])
        for name, columns in objective.elements().items():
            series = np.concatenate([np.tile(rest[name], (objective.depth, 1)), trace[:, columns]])
            delayed = [series[steps + objective.depth - d] for d in range(objective.depth + 1)]
            before = past.get(name, [d[:0] for d in delayed])
            past[name] = [np.concatenate(pair) for pair in zip(before, delayed, strict=True)]
    codes = np.concatenate(chosen)[:, None, :]
    initial = []
    for state in program.states:
        source, _, delay = state.signal.name.rpartition(".z")
        value = np.floor(past[source][int(delay)] * 2.0**state.signal.fix.frac + 0.5)
        initial.append(np.clip(value, state.signal.fix.lo, state.signal.fix.hi))
    start = np.concatenate(initial, axis=1).astype(np.int64) if initial else np.zeros((len(codes), 0), np.int64)
    feeds = objective.flat.feeds()
    summed = {}  # signal -> layer and its rows; sums of which only the sign counts are not corrected
    for name, layer in layers.items():
        if layer.is_linear:
            summed[name] = name, slice(None)
        elif layer.function.lowered != "threshold":
            summed |= {p: (name, r) for p, r in sums(name, layer).items() if not p.endswith(".condition")}
    for at, operation in enumerate(program.operations):
        name, rows = summed.get(operation.out.name, ("", None))
        if not isinstance(operation, Affine) or not name or _rounds_nothing(operation):
            continue
        layer = layers[name]
        exact = layer.bias[rows] + sum(
            product(past[source][delay], w[rows].T)
            for p, w in layer.weights.items()
            for source, delay in [feeds[f"{name}.{p}"]]
        )
        traced = run(program, codes, start, trace=True).trace
        assert traced is not None, "it was asked for"
        fixed = traced[operation.out.name][:, 0] * operation.out.fix.lsb
        apart = exact - fixed
        if layer.function.periodic:
            apart -= 2.0 * np.floor(0.5 * apart + 0.5)
        error = usual(apart, operation.out.fix.lsb)
        bias = operation.bias + np.floor(np.ldexp(error, operation.frac) + 0.5).astype(np.int64)
        changed = replace(operation, bias=bias)
        program = replace(program, operations=(*program.operations[:at], changed, *program.operations[at + 1 :]))
    return program.check()


def usual(apart: np.ndarray, lsb: float) -> np.ndarray:
    """The mean error of each element (samples, elements) -> (elements,), without samples that are off by a jump.

    What one comparison makes of a few samples is no shift of all.
    """
    away = np.abs(apart - np.median(apart, axis=0))
    kept = away <= FLIPPED * np.maximum(np.median(away, axis=0), 0.5 * lsb)
    if kept.all():
        return mean(apart)
    return np.array([float(mean(column[at][:, None])[0]) for column, at in zip(apart.T, kept.T, strict=True)])


def _rounds_nothing(operation: Affine) -> bool:
    """Whether it is a sum or difference of unscaled earlier signals, which is exact and needs no correction."""
    powers = np.abs(operation.weights[operation.weights != 0])
    return bool((powers & (powers - 1) == 0).all()) and not operation.bias.any()
