"""Long runs: the error of fixed point does not grow."""

import numpy as np

from greygate.emulator.engine import run
from greygate.emulator.program import Program
from greygate.hardware.proofs.proof import Proof, timed
from greygate.models.accuracy import float_error
from greygate.models.network import Network
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

STEPS = 1_000_000
TENTH = 10  # the last tenth of the run against the first, both of whole repetitions


def no_drift(
    program: Program, network: Network, record: Record, steps: int = STEPS, progress: Progress = silent
) -> Proof:
    """Run both over the record's inputs again and again; the mean error in the last tenth must be that of the first.

    They may differ by one LSB of the output. The states go on from one repetition to the next; there are at least ten,
    after one that is left out: it begins from the record's initial state, and the others with a jump of the inputs.
    """
    length = len(next(iter(record.inputs.values())))
    how = "emulator and float network on a scenario repeated"
    with timed() as seconds:
        times = max(TENTH, -(-steps // length))
        inputs = {p.name: np.concatenate([np.asarray(record.inputs[p.name])] * (times + 1)) for p in network.inputs}
        nothing = {p.name: np.zeros(((times + 1) * length, *[p.size] * (p.size > 1))) for p in network.outputs}
        progress("drift: float network")
        float_ = float_error(network, Record(inputs, nothing, record.initial))  # from zero: the prediction itself
        progress("drift: fixed point")
        fixed = program.decode(run(program, program.encode(inputs), states=False).outputs)
        moved, tenth = {}, times // TENTH * length
        for port in program.outputs:
            lsb = abs(port.signal.fix.lsb * port.scale)
            error = (np.asarray(fixed[port.name]) - np.asarray(float_[port.name]))[length:] / lsb
            first, last = (part.mean(axis=0) for part in (error[:tenth], error[-tenth:]))
            moved[port.name] = float(np.max(np.abs(last - first)))
    what = f"no drift over {times * length:,} steps in closed loop"
    worst = max(moved, key=lambda name: moved[name])
    holds = moved[worst] <= 1.0
    why = None if holds else f"{worst}: the mean error moved by {moved[worst]:.3g} LSB"
    rows = tuple({"output": name, "moved": value} for name, value in moved.items())
    return Proof(what, how, holds, seconds[0], why, {"mean error moved by, in LSB": moved[worst]}, rows)
