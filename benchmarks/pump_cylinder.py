"""The rivals of the pump-controlled cylinder's network, from nothing.

    python benchmarks/pump_cylinder.py [flows black_boxes starts]

    flows        table 6.3: the linear flow networks by least mean squares
    black_boxes  table 6.2 to the thesis's epochs, output error from the best, a linear model: half an hour on one core
    starts       the structured network from random weights, with and without bounds on its leakage

What is found is kept in results/pump_cylinder.json, from which `make pages` writes the tables of the page.
"""

import sys
from collections.abc import Callable

from made import keep

from greygate.machines.pump_cylinder import study


def flows() -> dict:
    return study.flow_models()


def black_boxes() -> dict:
    return study.black_boxes(lambda text: print(text, file=sys.stderr, flush=True))


def starts() -> dict:
    """RMS in Pa on the rig's chirp, chambers A and B, of three starts."""
    return {name: study.random_starts(bounded) for name, bounded in (("free", False), ("bounded", True))}


PARTS: dict[str, Callable[[], dict]] = {p.__name__: p for p in (flows, black_boxes, starts)}

if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        keep("pump_cylinder", part, PARTS[part]())
