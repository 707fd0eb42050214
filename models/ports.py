"""Ports whose normalisation comes from a training recording and is kept with the network."""

from collections.abc import Mapping, Sequence

import numpy as np

from greygate.errors import InputError
from greygate.models.network import Port
from greygate.names import check_path, check_unit


def ports(channels: Mapping[str, np.ndarray], units: Mapping[str, str], names: Sequence[str]) -> list[Port]:
    """One scalar port a channel: inside, its range is [-1, 1], and before the first step stands the first sample.

    channels: name -> (samples,), of the training recording. Raises InputError for a channel that is missing, constant
    or not finite, and for a name or unit that a port cannot have (`greygate.names`).
    """
    found = []
    for name in names:
        check_path(name, "port")
        unit = check_unit(units.get(name, "1"), f"port {name}: unit")
        if name not in channels:
            raise InputError(f"port {name}: no such channel; there are {', '.join(channels)}")
        x = np.asarray(channels[name], float)
        if x.size == 0 or not np.isfinite(x).all():
            raise InputError(f"port {name}: its channel is empty or holds NaN or inf; mend the recording")
        low, high = float(x.min()), float(x.max())
        if not high - low > 1e-12 * max(abs(low), abs(high)):
            raise InputError(f"port {name}: its channel is constant at {low:g}; nothing can be learnt from it")
        found.append(Port(name, unit, (high - low) / 2, (high + low) / 2, initial=float(x[0])))
    return found
