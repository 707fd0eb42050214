"""Bias correction: move each rounded sum so that, on average over a record, it is what it is in float.

Rounded weights and tables shift the mean of a sum a little; inside a loop that drives an integrator the shift would add
up to an offset of the output. (Nagel et al. 2019 do this for feed-forward networks; here every step starts from the
float network's own states, so that the error of one step is seen and not where the loop has drifted to.)
"""

from dataclasses import replace

import numpy as np

from greygate.emulator.engine import run
from greygate.emulator.program import Affine, Program
from greygate.models.network import Network
from greygate.models.training import Problem, Record

SAMPLES = 2000  # steps of the record, evenly spread


def centre_biases(program: Program, network: Network, record: Record) -> Program:
    """Correct the biases of every AFFINE operation that rounds weights, in program order, on one record."""
    problem = Problem(network, [record])
    signals = dict(
        zip(problem.elements(), np.split(problem.simulate(problem.theta)[0], _ends(problem), axis=1), strict=True)
    )
    steps = np.unique(np.linspace(0, len(next(iter(signals.values()))) - 1, SAMPLES).astype(int))
    past = {n: _padded(problem, n, v) for n, v in signals.items()}
    initial = []
    for state in program.states:
        source, _, delay = state.signal.name.rpartition(".z")
        rows = past[source][steps + problem.depth - int(delay)]
        codes = np.floor(rows * 2.0**state.signal.fix.frac + 0.5)
        initial.append(np.clip(codes, state.signal.fix.lo, state.signal.fix.hi))
    start = np.concatenate(initial, axis=1).astype(np.int64) if initial else np.zeros((len(steps), 0), np.int64)
    codes = program.encode(record.inputs)[steps][:, None, :]
    feeds = problem.flat.feeds()
    for at, operation in enumerate(program.operations):
        name = operation.out.name.removesuffix(".n")
        if not isinstance(operation, Affine) or name not in problem.flat.modules or _rounds_nothing(operation):
            continue
        layer = problem.flat.modules[name]
        exact = layer.bias + sum(
            past[feeds[f"{name}.{p}"][0]][steps + problem.depth - feeds[f"{name}.{p}"][1]] @ w.T
            for p, w in layer.weights.items()
        )
        fixed = run(program, codes, start, trace=True).trace[operation.out.name][:, 0] * operation.out.fix.lsb
        error = (exact - fixed).mean(axis=0)
        bias = operation.bias + np.floor(error * 2.0**operation.frac + 0.5).astype(np.int64)
        changed = replace(operation, bias=bias)
        program = replace(program, operations=(*program.operations[:at], changed, *program.operations[at + 1 :]))
    return program.check()


def _ends(problem: Problem) -> np.ndarray:
    return np.cumsum([len(c) for c in problem.elements().values()])[:-1]


def _padded(problem: Problem, name: str, signal: np.ndarray) -> np.ndarray:
    """A signal with what it was before the first step in front."""
    port = next((p for p in problem.flat.inputs if p.name == name), None)
    first = (
        problem.flat.modules[name].initial
        if port is None
        else np.full(port.size, (port.initial - port.offset) / port.scale)
    )
    return np.concatenate([np.tile(first, (problem.depth, 1)), signal])


def _rounds_nothing(operation: Affine) -> bool:
    """A sum or difference of earlier signals as they are: exact, so there is nothing to correct."""
    powers = np.abs(operation.weights[operation.weights != 0])
    return bool((powers & (powers - 1) == 0).all()) and not operation.bias.any()
