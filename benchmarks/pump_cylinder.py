"""The rivals of the pump-controlled cylinder's network, from nothing.

flows        table 6.3: the linear flow networks by least mean squares
black_boxes  table 6.2 to the thesis's epochs, output error from the best, a linear model: half an hour on one core
starts       the structured network from random weights, with and without bounds on its leakage
"""

from greygate.machines.pump_cylinder import study

from .shared import say

TAKES = "half an hour"


def black_boxes() -> dict:
    return study.black_boxes(say)


def starts() -> dict:
    """RMS in Pa on the rig's chirp, chambers A and B, of three starts."""
    return {name: study.random_starts(bounded) for name, bounded in (("free", False), ("bounded", True))}


PARTS = {"flows": study.flow_models, "black_boxes": black_boxes, "starts": starts}
