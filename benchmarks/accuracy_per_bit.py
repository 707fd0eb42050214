"""Accuracy per bit of the flow network: RMS against float at words of 8 to 20 bits, beside da4ml and alkaid.

The peers have full tables: each neuron answers from a point for every code of its argument. They run in an interpreter
of their own, with the versions of benchmarks/peers.txt.
Usage: python benchmarks/accuracy_per_bit.py [--peers PYTHON]
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from flow import arrays, flow
from made import stamp

from greygate.compiler.explore.judge import agreed
from greygate.compiler.pipeline import fixed_error, quantize_centred
from greygate.compiler.quantize import Formats
from greygate.compiler.ranges import ranges
from greygate.models.accuracy import portable_rms

WIDTHS = range(8, 21)
PEERS = ("da4ml", "alkaid")
RESULTS = Path(__file__).parent / "results/accuracy_per_bit.json"


def ours() -> dict[int, list[float]]:
    """Width -> RMS and seconds; no bit finer than the word."""
    network, record = flow()
    flat, found = network.flatten(), {}
    seen = ranges(flat, [record])
    for width in WIDTHS:
        start = time.monotonic()
        program = quantize_centred(flat, seen, [record], Formats(width), 1e-3)
        found[width] = [agreed(portable_rms(fixed_error(program, record)["y"])), round(time.monotonic() - start, 2)]
    return found


def theirs(python: str, package: str) -> dict[int, list[float]]:
    """The same of a peer."""
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "data.npz", **arrays())
        script = Path(__file__).with_name("accuracy_peers.py").resolve()
        command = [python, str(script), package, "data.npz", *map(str, WIDTHS)]
        done = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
    return {int(width): row for width, row in json.loads(done.stdout).items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--peers", type=os.path.abspath, help="path of an interpreter that has da4ml and alkaid")
    peers = parser.parse_args().peers
    found = {"greygate": ours()} | ({package: theirs(peers, package) for package in PEERS} if peers else {})
    print(f"{'bits':>5}" + "".join(f"{name:>12}" for name in found))
    for width in WIDTHS:
        print(f"{width:5}" + "".join(f"{rows[width][0]:12.2e}" for rows in found.values()))
    kept = {
        name: {str(w): {"rms": agreed(r), "seconds": s} for w, (r, s) in rows.items()} for name, rows in found.items()
    }
    RESULTS.write_text(json.dumps(kept, indent=1) + "\n")
    stamp(RESULTS)


if __name__ == "__main__":
    main()
