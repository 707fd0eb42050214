"""Accuracy per bit of the flow network: RMS against float at words of 8 to 20 bits, beside da4ml and alkaid.

The peers have full tables: each neuron answers from a point for every code of its argument. They run in an interpreter
of their own, with the versions of benchmarks/peers.txt; where it is not there, they are left out.
"""

from greygate.compiler.explore.judge import agreed
from greygate.compiler.pipeline import fixed_error, quantize_centred
from greygate.compiler.quantize import Formats
from greygate.compiler.ranges import ranges
from greygate.models.accuracy import portable_rms

from . import shared
from .flow import PEERS, flow, of_peer
from .made import store
from .shared import scratch, stopwatch

TAKES = "five minutes"

WIDTHS = range(8, 21)


def ours() -> dict[int, list[float]]:
    """Width -> RMS and seconds; no bit finer than the word."""
    network, record = flow()
    flat, found = network.flatten(), {}
    seen = ranges(flat, [record])
    for width in WIDTHS:
        watch = stopwatch()
        program = quantize_centred(flat, seen, [record], Formats(width), 1e-3)
        found[width] = [agreed(portable_rms(fixed_error(program, record)["y"])), watch(2)]
    return found


def main(*, peers: shared.Peers = shared.PEERS) -> None:
    found = {"greygate": ours()}
    for package in PEERS if peers.exists() else ():
        with scratch() as folder:
            told = of_peer(peers, package, folder, 0, *WIDTHS)
        found[package] = {int(width): row for width, row in told.items()}
    print(f"{'bits':>5}" + "".join(f"{name:>12}" for name in found))
    for width in WIDTHS:
        print(f"{width:5}" + "".join(f"{rows[width][0]:12.2e}" for rows in found.values()))
    kept = {
        name: {str(w): {"rms": agreed(r), "seconds": s} for w, (r, s) in rows.items()} for name, rows in found.items()
    }
    store("accuracy_per_bit", kept)
