"""Three figures of each stored network on test runs: float and fixed against the recording, fixed against float.

Every run starts from the network's rest, as hardware does, and is judged where the study judges it.

python benchmarks/measured.py [WIDTH ...]
"""

import sys

import numpy as np

from greygate.compiler.quantize import Formats, quantize
from greygate.compiler.ranges import ranges
from greygate.compiler.simplify import simplify
from greygate.emulator.interpreter import interpret
from greygate.errors import InputError
from greygate.machines.identification import stored
from greygate.machines.measured.study import STUDIES


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def main(widths):
    for study in STUDIES.values():
        try:
            training, tests = study.runs()
        except InputError as missing:
            print(f"{study.name}: {missing}")
            continue
        network = simplify(stored(study)[0])
        seen = ranges(network, list(training.values()))
        for width in widths:
            program = quantize(network, seen, Formats(width), study.period)
            source, sink = program.inputs[0], program.outputs[0]
            fix, step = source.signal.fix, 2.0**-sink.signal.fix.frac * sink.scale
            for name, record in tests.items():
                value = (record.inputs[source.name] - source.offset) / source.scale
                codes = np.clip(np.floor(value * 2.0**fix.frac + 0.5), fix.lo, fix.hi).astype(np.int64)
                run = interpret(program, codes[:, None])
                judged = slice(record.skip, None)
                fixed = (run.outputs[:, 0] * step + sink.offset)[judged]
                free = network.run(record.inputs)[sink.name][judged]
                target = record.targets[sink.name][judged]
                figures = f"float {rms(free - target):.4g}, fixed {rms(fixed - target):.4g}"
                cost = f"fixed against float {rms(fixed - free):.3g} {sink.unit}"
                print(f"{study.name} {name}, {width} bits: {figures}, {cost}", flush=True)


main([int(a) for a in sys.argv[1:]] or [12, 14, 16])
