"""A recording whose time steps vary, resampled to the sample time of its rig.

An output, and an input from which a rate is derived, is interpolated straight between the two readings beside an
instant. Any other input is held from its reading to the next, as a command is, and averaged over each new sample.
Nothing else is done: no smoothing, no filter. What it costs is told: how far a cubic through the readings would be
from the straight line, in the channel that this concerns most.
"""

from collections.abc import Collection, Mapping

import numpy as np
from scipy.interpolate import PchipInterpolator

SLIPS, SELDOM = 5, 1e-3  # steps, and of all steps, that are not as usual: fewer are slips of one clock, to be mended
GAP = 5.0  # usual steps: across a longer one nothing is interpolated
FINER, COARSER = 0.5, 20.0  # usual steps, between which the new one lies: no finer than was recorded
JITTER = 1e-3  # of a usual step, by which one may differ and be as usual
MILLI = 1e3
ROUNDING = 1e-12  # of a count of steps, by which the last instant may miss its step


def varies(steps: np.ndarray, dt: float) -> bool:
    """Whether the time steps (samples - 1,), in s, vary, without a gap, about a step from which `dt` may be made."""
    if not np.all(steps > 0):
        return False
    usual = float(np.median(steps))
    other = np.abs(steps - usual) > JITTER * usual
    even = FINER * usual <= dt <= COARSER * usual
    many = np.sum(other) >= SLIPS and np.mean(other) > SELDOM
    return bool(many and np.max(steps) <= GAP * usual and even)


def resampled(
    clock: np.ndarray, channels: Mapping[str, np.ndarray], dt: float, held: Collection[str], units: Mapping[str, str]
) -> tuple[np.ndarray, dict[str, np.ndarray], str]:
    """(instants, channels there, one line on what was done and what it costs).

    clock: the instants of the readings (samples,), in s, rising. held: the channels that are held and averaged.
    """
    count = int((clock[-1] - clock[0]) / dt * (1 + ROUNDING)) + 1
    held_to = clock[0] + np.arange(count + 1) * dt
    instants = held_to[:-1]
    out, costs = {}, {}
    for name, signal in channels.items():
        if name in held:
            out[name] = _averaged(clock, signal, held_to)
            continue
        out[name] = np.interp(instants, clock, signal)
        cost = float(np.sqrt(np.mean((PchipInterpolator(clock, signal)(instants) - out[name]) ** 2)))
        costs[name] = cost, cost / (float(np.ptp(signal)) or 1.0)
    steps = MILLI * np.diff(clock)
    said = f"time steps of {steps.min():.3g} to {steps.max():.3g} ms, resampled to {MILLI * dt:.3g} ms"
    if costs:
        worst = max(costs, key=lambda name: costs[name][1])
        said += f"; between two readings {worst} is uncertain by {costs[worst][0]:.2g} {units[worst]} RMS"
    return instants, out, said


def _averaged(clock: np.ndarray, signal: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Means between edges of a signal that is held from each reading to the next, the last one for ever."""
    last = max(float(edges[-1]), float(clock[-1])) + 1.0
    area = np.concatenate(([0.0], np.cumsum(signal * np.diff(clock, append=last))))
    means = np.diff(np.interp(edges, np.append(clock, last), area)) / np.diff(edges)
    return np.clip(means, np.min(signal), np.max(signal))  # against rounding: what rests goes on resting
