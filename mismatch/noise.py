"""The noise of the sensors, as a rig states it and as a recording shows it."""

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from greygate.mismatch.model import Model

LONGEST = 200  # samples of one recorded code that are counted as one reading
SMOOTHED, CUBIC = 9, 3  # samples and order of the smoothing that shows how rough a signal is
MOVING = 5  # samples of one recorded code, below which a signal is said to move
SELDOM = 0.05  # share of moving samples below which they do not show how rough a signal is
EVEN = 12  # the variance of errors spread evenly over one step is a twelfth of its square


def deviation(model: Model) -> np.ndarray:
    """Standard deviation of the noise of each predicted channel (samples, channels), in its unit.

    In free-run simulation the rounding of the inputs adds to that of an output of the same unit. How much of another
    unit's rounding arrives at the output, only the plant knows: it is left out.
    """
    rig, found = model.rig, []
    for i, name in enumerate(rig.predict):
        channel, target = rig.channels[name], model.target[:, i]
        variance = np.full(len(target), channel.noise**2)
        if channel.resolution:
            variance += channel.resolution**2 / EVEN * runs(target)
        for given in rig.inputs if model.window is None else ():
            if rig.channels[given].unit == channel.unit:
                variance += rig.channels[given].resolution ** 2 / EVEN * runs(model.recording[given])
        found.append(np.sqrt(variance) * (1.0 if channel.noise else roughness(target, channel.sigma)))
    return np.stack(found, axis=1)


def runs(signal: np.ndarray) -> np.ndarray:
    """For each sample the length of the run of equal values it stands in, at most LONGEST."""
    change = np.flatnonzero(np.diff(signal) != 0) + 1
    edges = np.concatenate(([0], change, [len(signal)]))
    lengths = np.diff(edges)
    return np.minimum(np.repeat(lengths, lengths), LONGEST).astype(float)


def roughness(signal: np.ndarray, sigma: float) -> float:
    """How much rougher a channel is than its rounding alone makes it, at least 1; for a sensor of unknown noise.

    A cubic is fitted over nine samples at a time; what it leaves of the signal where that moves is the noise.
    """
    left = signal - savgol_filter(signal, SMOOTHED, CUBIC)
    moving = runs(signal) < MOVING
    if moving.mean() < SELDOM:
        return 1.0
    share = 1.0 - float(savgol_coeffs(SMOOTHED, CUBIC)[SMOOTHED // 2])  # a sample's weight in its own smoothed value
    return max(1.0, float(np.sqrt(np.mean(left[moving] ** 2) / share) / sigma))
