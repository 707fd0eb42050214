"""The flow network in da4ml or alkaid, with a full table for each neuron. flow.py runs it in their interpreter.

    python flow_peers.py PACKAGE DATA.npz INDEX WIDTH...    prints {"width": [RMS, seconds], ...}
    python flow_peers.py PACKAGE DATA.npz INDEX WIDTH --design    writes flow/, prints {"rms", "latency", "files"}
    python flow_peers.py PACKAGE DATA.npz INDEX WIDTH --rates N...    prints {"N": {"wall", "cpu"}}: samples a second

DATA: x (N, 2), y (N,) of float, and w1, b1, w2, b2, w3, b3 of y = w3 tanh(w2 tanh(w1 x + b1) + b2) + b3. INDEX: bits of
the argument of a table; 0: as many as the word. WIDTH: bits of weights, inputs and results.
"""

import importlib
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

FLAT = 3  # whole bits of an argument: beyond 8, tanh is 1 to 20 bits
REPEATS = 5
CUTOFF = 5  # of the peers' measure of depth, between two registers
PACKAGES = {  # package -> (module, class of arrays), (module, function that traces)
    "da4ml": (("da4ml.trace", "FixedVariableArray"), ("da4ml.trace", "comb_trace")),
    "alkaid": (("alkaid.trace", "FVArray"), ("alkaid.trace", "trace")),
}


def rates(work: Callable[[], object], steps: int, repeats: int = REPEATS) -> dict[str, float]:
    """Steps per second of wall and of processor time, medians of several calls after a first one."""
    work()
    found = []
    for _ in range(repeats):
        clocks = time.perf_counter, time.process_time
        began = [clock() for clock in clocks]
        work()
        found.append([clock() - start for clock, start in zip(clocks, began, strict=True)])
    return dict(zip(("wall", "cpu"), (steps / np.median(found, axis=0)).tolist(), strict=True))


def rounded(weights: np.ndarray, width: int) -> np.ndarray:
    """Weights with `width` significant bits, the sign counted, of the largest of the matrix."""
    scale = 2.0 ** (width - 1 - int(np.frexp(np.abs(weights).max())[1]))
    return np.floor(weights * scale + 0.5) / scale


def given(array, trace, data, options: dict):
    """The logic with the weights and the formats of `fixes`."""

    def kif(n):
        return {"k": 1, "i": int(fixes[n][0] - fixes[n][1]) - 1, "f": int(fixes[n][1])}

    fixes, modes = data["fixes"], {"overflow_mode": "SAT", "round_mode": "RND"}
    ones, ends = np.ones(2, int), kif(0)
    x = h = array.from_kif(ones, ones * ends["i"], ones * ends["f"], **options)
    for n in (1, 2):
        z = (h @ data[f"w{n}"].T + data[f"b{n}"]).quantize(**kif(2 * n - 1), **modes)
        h = z.apply(np.tanh).quantize(**kif(2 * n), **modes)
    return trace(x, (h @ data["w3"].T + data["b3"]).quantize(**kif(5), **modes))


def network(array, trace, data, width: int, index: int, options: dict):
    """The logic: inputs, sums, tables with arguments of `index` bits, an output as wide as the inputs."""
    if "fixes" in data:
        return given(array, trace, data, options)
    x = array.from_kif(np.array([1, 1]), np.array([0, 0]), np.array([width - 1, width - 1]), **options)
    h = x
    for n in (1, 2):
        w, b = rounded(data[f"w{n}"], width), rounded(data[f"b{n}"], width)
        whole = min(int(np.frexp(float(data[f"reach{n}"]))[1]), FLAT)
        z = (h @ w.T + b).quantize(k=1, i=whole, f=index - 1 - whole, overflow_mode="SAT", round_mode="RND")
        h = z.apply(np.tanh).quantize(k=1, i=0, f=width - 1, overflow_mode="SAT", round_mode="RND")
    y = h @ rounded(data["w3"], width).T + rounded(data["b3"], width)
    return trace(x, y.quantize(k=1, i=0, f=width - 1, overflow_mode="SAT", round_mode="RND"))


def main(package: str, path: str, index: str, *widths: str) -> None:
    package, _, method = package.partition("-")
    options = {"solver_options": {"method0": method, "method1": method}} if method else {}
    array, trace = (getattr(importlib.import_module(module), name) for module, name in PACKAGES[package])
    data, found = dict(np.load(path)), {}
    option = next((n for n, word in enumerate(widths) if word.startswith("--")), len(widths))
    for width in map(int, widths[:option]):
        wide, fine = map(int, data["fixes"][0]) if "fixes" in data else (width, width - 1)
        start, lsb, end = time.monotonic(), 2.0**-fine, 2.0 ** (wide - 1 - fine)
        logic = network(array, trace, data, width, int(index) or width, options)
        x = np.clip(np.floor(data["x"] / lsb + 0.5) * lsb, -end, end - lsb)
        y = np.asarray(logic.predict(x)).reshape(-1)
        found[width] = [float(np.sqrt(np.mean((y - data["y"]) ** 2))), round(time.monotonic() - start, 2)]
        print(width, found[width], file=sys.stderr)
    if "--design" in widths:
        model = importlib.import_module(f"{package}.codegen.rtl.rtl_model").RTLModel
        design = model(logic, prj_name="flow", path="flow", latency_cutoff=CUTOFF, print_latency=False)
        design.write()
        clocks = design.latency if package == "alkaid" else len(design._pipe.solutions)
        files = sorted(str(f) for f in Path("flow/src").rglob("*.v") if "wrapper" not in f.name)
        found = {"rms": found[width][0], "latency": int(clocks), "files": files}
    if "--rates" in widths:
        sizes = [int(word) for word in widths[option + 1 :]]
        found = {n: rates(lambda n=n: logic.predict(np.resize(x, (n, x.shape[1]))), n) for n in sizes}
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
