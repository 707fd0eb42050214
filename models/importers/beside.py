"""A model in its own program beside the network made of it, over a recording."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from greygate.errors import one_line
from greygate.models.accuracy import float_error
from greygate.models.importers.onnx_file import QONNX, read
from greygate.models.importers.onnx_graph import opened
from greygate.models.importers.onnx_reference import CHECKED, Imported, Reference, answer, arranged, lengths
from greygate.models.training.record import Record
from greygate.plain import Count, Figure

ROUNDED = 1e-4  # of the largest answer: what float32 may lose to float64, fed back over a recording
STEPS = 10_000  # of a recording that are run at most
Columns = Mapping[str, np.ndarray]  # tensor of the model -> (steps, numbers)
Run = Callable[[Mapping[str, np.ndarray]], Mapping[str, np.ndarray]]


@dataclass(frozen=True)
class Beside:
    """largest: difference of an output, by the largest that it is in that program. steps: that both have run.

    beyond: steps in which that output differs by more than rounding. why: why they have not; empty where they have.
    """

    program: str
    steps: Count = 0
    output: str = ""
    largest: Figure = math.nan
    beyond: Count = 0
    why: str = ""

    def __str__(self) -> str:
        if self.why:
            return f"{self.program} and the network are not compared over the recording: {self.why}"
        steps, far = f"{self.steps} step{'s' * (self.steps > 1)}", ""
        if not self.largest <= ROUNDED:
            far = f"; that is more than rounding, in {self.beyond} of them: compare the two before you go on"
        return f"{self.program} and the network differ by at most {self.largest:.2g} of {self.output} in {steps}{far}"


def beside(made: Imported, path: Path, inputs: Columns, rounded: Run | None = None) -> Beside:
    """The largest difference over a recording: from onnxruntime, or from ONNX's reference where that does not run it.

    inputs: of the network, port -> (N,), in its unit; the first STEPS of them are run. A state goes on from step to
    step. rounded: of a model that rounds, what answers as it does, port -> (N,), in the network's place.
    """
    windows = any(t.window is not None for t in made.inputs)
    goes_on = not windows and not made.states and any(c.delay for c in made.network.flatten().connections)
    axes = [*range(min(len(t.axes) for t in made.inputs) - 1)] if goes_on or rounded else []
    found, why = [], ""
    for axis in (*axes, None):
        rows = {n: v[: 1 if goes_on and axis is None else STEPS] for n, v in inputs.items()}
        given = {t.name: np.column_stack([rows[p.name] for p in t.ports]) for t in made.inputs}
        try:
            program, run = _program(made, path, axis, rounded is not None)
            answers = _stepped(made, given, run) if axis is None else _along(made, given, run, axis)
        except Exception as error:  # of the other program, in many ways
            why = one_line(" ".join(str(error).split()))[:120]
            continue
        found.append(_difference(made, rows, answers, program, rounded))
        if found[-1].largest <= ROUNDED:
            return found[-1]
    return min(found, key=lambda b: b.largest) if found else Beside("onnxruntime", why=f"it does not run ({why})")


def _program(made: Imported, path: Path, axis: int | None, rounds: bool) -> tuple[str, Run]:
    """What runs the model, with that axis of its inputs as long as the recording."""
    foreign = any(n.domain in QONNX for n in read(path).graph.node)
    if foreign or find_spec("onnxruntime") is None:
        reference = Reference(made.opsets, CHECKED, double=True)
        return "ONNX's reference", lambda feeds: answer(made, feeds, reference, rounds)
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL  # it moves 16-bit codes
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    names = [*(t.name for t in made.outputs), *(after for _, _, after in made.states.values())]
    shown = {o.name for o in read(path).graph.output}
    model = _freed(path, made, axis) if rounds or axis is not None or not shown.issuperset(names) else str(path)
    try:
        session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception:  # it knows no opset below 7
        model = _freed(path, made, axis)
        session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    kinds = {i.name: np.float64 if "double" in i.type else np.float32 for i in session.get_inputs()}
    names = list(dict.fromkeys(names))

    def run(feeds: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        found = session.run(names, {n: v.astype(kinds[n]) for n, v in feeds.items()})
        return {n: np.asarray(v, float) for n, v in zip(names, found, strict=True)}

    return f"onnxruntime {version('onnxruntime')}", run


def _freed(path: Path, made: Imported, axis: int | None) -> bytes:
    """The model of what is shown, with that axis of its inputs of any length."""
    model, names = opened(path), {t.name for t in made.inputs}
    for tensor in model.graph.input:
        if tensor.name in names and axis is not None:
            tensor.type.tensor_type.shape.dim[axis].dim_param = "steps"
    for tensor in model.graph.output:
        tensor.type.tensor_type.ClearField("shape")
    del model.graph.value_info[:]
    return model.SerializeToString()


def _stepped(made: Imported, given: Columns, run: Run) -> dict[str, np.ndarray]:
    """Output -> (steps, numbers), step by step; where the model holds several samples, all of them are that step's."""
    shapes = {n: lengths(axes, {}) for n, (_, axes, _) in made.states.items()}
    states = {
        n: np.reshape(made.network.layers()[layer].initial, shapes[n]) for n, (layer, _, _) in made.states.items()
    }
    rows: dict[str, list[np.ndarray]] = {t.name: [] for t in made.outputs}
    past = {t.name: np.pad(given[t.name], ((t.length - 1, 0), (0, 0))) for t in made.inputs}
    for k in range(len(next(iter(given.values())))):
        found = run({t.name: t.samples(past[t.name][: k + t.length]) for t in made.inputs} | states)
        states = {n: np.reshape(found[after], shapes[n]) for n, (_, _, after) in made.states.items()}
        for t in made.outputs:
            size = sum(p.size for p in t.ports)
            rows[t.name].append(next(arranged(found[t.name], found[t.name].size // size, size))[-1].ravel())
    return {n: np.array(r) for n, r in rows.items()}


def _along(made: Imported, given: Columns, run: Run, axis: int) -> dict[str, np.ndarray]:
    """Output -> (steps, numbers) of the whole sequence along that axis; or (1, numbers), of its last step."""
    feeds = {}
    for t in made.inputs:
        rest = [n for k, n in enumerate(lengths(t.axes, {})) if k != axis]
        feeds[t.name] = np.moveaxis(given[t.name].reshape(-1, *rest), 0, axis)
    found, answers = run(feeds), {}
    for t in made.outputs:
        size = sum(p.size for p in t.ports)
        count = found[t.name].size // size
        answers[t.name] = next(arranged(found[t.name], count, size)).reshape(count, size)
    return answers


def _difference(made: Imported, inputs: Columns, answers: Columns, program: str, rounded: Run | None) -> Beside:
    steps = len(next(iter(inputs.values())))
    nothing = {p.name: np.zeros((steps, p.size) if p.size > 1 else steps) for t in made.outputs for p in t.ports}
    got = rounded(inputs) if rounded else float_error(made.network, Record(inputs, nothing))  # from 0: what it gives
    worst = Beside(program, steps, "", -1.0)
    for t in made.outputs:
        wanted, mine = answers[t.name], np.column_stack([got[p.name] for p in t.ports])[-len(answers[t.name]) :]
        scale = np.abs(wanted).max() or 1.0
        shares = np.abs(mine - wanted).max(1) / scale
        share, beyond = float(shares.max()), int((~(shares <= ROUNDED)).sum())
        if not share <= worst.largest:
            worst = replace(worst, output=t.name, largest=share, beyond=beyond)
    return worst
