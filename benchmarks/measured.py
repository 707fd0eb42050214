"""The measured benchmarks beyond their training: what the held-out blocks foretell, and what hardware costs.

foretold: the chosen structure and seed are trained again on every fold, and the errors over the held-out blocks are
drawn anew in stretches; 95 % of the RMS errors. No test enters. outside: share of a test's samples whose input or
output is beyond anything in training. fixed: RMS error on each test in float and in words of 12, 14 and 16 bits, every
run from the network's rest, as hardware has it; cost: 16 bits against float. verified: both architectures at 16 bits in
Verilator.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from greygate.compiler.pipeline import fixed_error
from greygate.compiler.quantize import Formats, quantize
from greygate.compiler.ranges import ranges
from greygate.identify.study import Study, stored
from greygate.identify.tried import interval, segmented
from greygate.machines.measured.study import STUDIES
from greygate.models.accuracy import float_error, rms
from greygate.models.simplify import simplify

from .hardware import verified

TAKES = "not timed"

WIDTHS = (12, 14, 16)


def foretold(study: Study) -> list[float]:
    training, _ = study.runs()
    figures = stored(study)[1]
    candidate, errors = study.candidates[figures["candidate"]], []
    for fold in study.folds(training):
        network = candidate.build(figures["seed"])
        if candidate.grown:
            line = study.linear.fit(study.linear.build(0), fold.pieces).network
            network = network.with_parameters(line.parameters())
        network = candidate.fit(network, fold.pieces).network
        for block in fold.blocks:
            judged = study.start(network, block)
            errors.append(float_error(network, judged)[network.outputs[0].name][judged.skip :])
    return interval(segmented(errors))


def outside(study: Study) -> dict[str, float]:
    """Test -> share of its samples with an input or output beyond the training runs' ranges."""
    training, tests = study.runs()

    def signals(record) -> dict[str, np.ndarray]:
        return {**record.inputs, **record.targets}

    low = {n: min(signals(r)[n].min() for r in training.values()) for n in signals(next(iter(training.values())))}
    high = {n: max(signals(r)[n].max() for r in training.values()) for n in low}
    return {
        test: float(np.mean(np.any([(v < low[n]) | (v > high[n]) for n, v in signals(r).items() if n in low], axis=0)))
        for test, r in tests.items()
    }


def fixed(study: Study) -> dict:
    """Test -> "float", a width or "cost" -> RMS error in the unit of the output."""
    training, tests = study.runs()
    network, found = simplify(stored(study)[0]), {name: {} for name in tests}
    seen = ranges(network, list(training.values()))
    for width in WIDTHS:
        program = quantize(network, seen, Formats(width), study.period)
        for name, record in tests.items():
            resting = replace(record, initial={})
            (free,), (words,) = float_error(network, resting).values(), fixed_error(program, record).values()
            free, words = free[record.skip :], words[record.skip :]
            found[name] |= {"float": rms(free), str(width): rms(words), "cost": rms(words - free)}
    return found


def judged(name: str) -> dict:
    study = STUDIES[name]
    found = {"foretold": foretold(study), "outside": outside(study), "fixed": fixed(study)}
    return found | {"verified": verified(name)}


PARTS = {name: partial(judged, name) for name in STUDIES}
