"""What a recording is like, before anything is fitted to it: numbers for each channel, and what to do about them."""

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np
from scipy.signal import welch
from scipy.stats import f

from greygate.errors import InputError
from greygate.plain import Count
from greygate.plants.preparation import estimated_delay
from greygate.plants.recording import Recording

POWER = 0.95  # share of the power below a signal's bandwidth
FAST, SLOW = 40.0, 4.0  # samples in a period of the bandwidth: more are wasteful, fewer miss what happens between them
ENDS = 0.02  # share of samples at an end of a signal's range from which a sensor may be at its limit
COARSE = 0.02  # of a signal's deviation: a sensor's step above it is seen in the errors
DRIFT = 1.0  # deviations that a signal's mean may move between the first and the last quarter
LONGEST = 50  # samples of delay that are looked for
UNSEEN = "does not visibly answer"
STRIDE = 10.0  # samples in a period of the bandwidth that taps should have
SPIKE = 5.0  # times what 99 % of samples move, from which one that goes and comes back is no motion
TAPS, AHEAD = 8, 4  # samples before and after, by which an input's later values are asked for what they tell
SPARE = 10  # samples for each of them
TOLD, CHANCE = 0.03, 1e-6  # share of what is left that they tell, and its probability by chance
TINY = np.finfo(float).tiny


class Channel(TypedDict):
    unit: str
    range: tuple[float, float]
    deviation: float
    step: float
    levels: Count
    at_ends: float
    drift: float
    bandwidth: float


class Seen(TypedDict):
    samples: Count
    dt: float
    channels: dict[str, Channel]
    delays: dict[str, int | None]
    stride: Count
    remarks: list[str]


def look(recording: Recording, inputs: Sequence[str], output: str) -> Seen:
    """Figures by channel, delays by input, and remarks that say what to do.

    Each channel: unit, range, deviation, step (smallest difference, in its unit), share of samples at its ends, drift
    between the first and last quarter in deviations, and bandwidth in Hz, below which 95 % of its power lies.
    """
    channels = {name: _channel(recording[name], recording.units[name], recording.dt) for name in (*inputs, output)}
    delays = {name: _delay(recording, name, output) for name in inputs}
    remarks = [line for name, seen in channels.items() for line in _remarks(name, seen, name == output, recording.dt)]
    for name, delay in delays.items():
        if delay is None and _longest(recording) > 0:
            remarks.append(f"{output} {UNSEEN} {name}: it may be slow, or {name} without effect")
        if _answers(recording[name], recording[output]):
            remarks.append(
                f"later values of {name} tell of {output}: a controller drives it, or their clocks are apart; "
                f"a disturbance of {output} then acts through {name}, unless its reference moves it more"
            )
    if (spikes := _spikes(recording[output])).size:
        times = ", ".join(f"{k * recording.dt:g} s" for k in spikes[:3]) + ", ..." * (len(spikes) > 3)
        remarks.append(
            f"{output} jumps and comes back in {len(spikes)} sample{'s' * (len(spikes) > 1)} ({times}): "
            "look whether its sensor failed"
        )
    return {
        "samples": recording.samples,
        "dt": recording.dt,
        "channels": channels,
        "delays": delays,
        "stride": stride(channels[output]["bandwidth"], recording.dt),
        "remarks": remarks,
    }


def stride(bandwidth: float, dt: float) -> int:
    """Distance of taps in samples, so that a period of the output's bandwidth has ten of them."""
    return max(int(1 / (STRIDE * bandwidth * dt)), 1)


def _channel(x: np.ndarray, unit: str, dt: float) -> Channel:
    deviation = float(np.std(x))
    steps = np.diff(np.unique(x))
    quarter = max(len(x) // 4, 1)
    ends = float(np.sum((x == x.min()) | (x == x.max())) - 2) / len(x)  # two samples stand there always
    return {
        "unit": unit,
        "range": (float(x.min()), float(x.max())),
        "deviation": deviation,
        "step": float(steps.min()) if len(steps) else 0.0,
        "levels": len(steps) + 1,
        "at_ends": ends,
        "drift": float((x[-quarter:].mean() - x[:quarter].mean()) / deviation) if deviation else 0.0,
        "bandwidth": bandwidth(x, dt),
    }


def bandwidth(x: np.ndarray, dt: float) -> float:
    """Hz below which 95 % of the power about the mean lies (Welch 1967)."""
    frequency, power = welch(x - x.mean(), 1 / dt, nperseg=min(len(x), 4096), detrend="constant")
    below = np.cumsum(power)
    return float(frequency[max(int(np.searchsorted(below, POWER * below[-1])), 1)])


def _delay(recording: Recording, source: str, target: str) -> int | None:
    """Samples, None where no answer is seen."""
    try:
        return estimated_delay(recording, source, target, _longest(recording), onset=True)
    except InputError:
        return None


def _answers(u: np.ndarray, y: np.ndarray) -> bool:
    """Whether later values of an input tell of an output what its past and the input's do not (F test)."""
    at = np.arange(TAPS, len(y) - AHEAD)
    if len(at) < SPARE * (2 * TAPS + AHEAD) or not np.ptp(u) * np.ptp(y):
        return False
    past = [y[at - k] for k in range(1, TAPS + 1)] + [u[at - k] for k in range(TAPS + 1)]
    later = [u[at + k] for k in range(1, AHEAD + 1)]
    without, with_them = (_unexplained(y[at], np.column_stack(of)) for of in (past, past + later))
    if without <= 0 or 1 - with_them / without < TOLD:
        return False
    free = len(at) - len(past) - AHEAD - 1
    return float(f.sf((without - with_them) / AHEAD / max(with_them / free, TINY), AHEAD, free)) < CHANCE


def _unexplained(y: np.ndarray, by: np.ndarray) -> float:
    """Squared error that least squares leave."""
    by = np.column_stack([(by - by.mean(0)) / np.maximum(by.std(0), TINY), np.ones(len(y))])
    return float(np.sum((y - by @ np.linalg.lstsq(by, y, rcond=1e-10)[0]) ** 2))


def _spikes(y: np.ndarray) -> np.ndarray:
    """Samples that stand far from both of their neighbours, on one side."""
    moved = np.diff(y)
    away = np.where(moved[:-1] * moved[1:] < 0, np.minimum(abs(moved[:-1]), abs(moved[1:])), 0.0)
    usual = float(np.quantile(np.abs(moved), 0.99)) if len(moved) else 0.0
    return 1 + np.flatnonzero(away > SPIKE * usual) if usual else np.zeros(0, int)


def _longest(recording: Recording) -> int:
    """Samples to which a delay is looked for; a short recording shows none."""
    return max(min(LONGEST, recording.samples // 8 - 20), 0)


def _remarks(name: str, seen: Mapping, output: bool, dt: float) -> list[str]:
    found = []
    period = 1 / (seen["bandwidth"] * dt)
    if output and period > FAST:
        found.append(
            f"{name} is sampled {period:.0f} times in a period of its bandwidth: taps are set apart; "
            "a slower recording would do"
        )
    if output and period < SLOW:
        found.append(f"{name} has power up to {seen['bandwidth']:.3g} Hz: sample faster, or filter before sampling")
    if output and seen["at_ends"] > ENDS:
        found.append(
            f"{name} stands at an end of its range in {100 * seen['at_ends']:.0f} % of samples: "
            "look whether its sensor is at a limit"
        )
    if output and seen["levels"] > 2 and seen["step"] > COARSE * seen["deviation"] and seen["levels"] < 200:
        found.append(
            f"{name} moves in steps of {seen['step']:.3g} {seen['unit']}: a model comes to a third of it at best"
        )
    if output and abs(seen["drift"]) > DRIFT:
        found.append(
            f"{name} ends {seen['drift']:+.1f} deviations from where it began: "
            "if inputs do not explain it, take the drift off"
        )
    if not output and seen["levels"] == 2:
        found.append(f"{name} has two levels only: how its size acts cannot be learnt; play more levels")
    return found
