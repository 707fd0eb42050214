"""Prepares a recording before it trains or judges a model.

Each function takes a `Recording` and returns a new one whose `history` has one more line, which says what was done.
channels: names of the channels; all, if they are not given. If only one channel of a plant is filtered, the filter
becomes part of the identified model: filter inputs and outputs alike, or neither.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import gcd
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import ndtri

from greygate.errors import InputError
from greygate.plants.recording import Recording

WHITENING = 20  # order of the autoregression that whitens an input
CHANCE = 0.01  # probability that a delay is found where there is none


def filtered(
    recording: Recording,
    kind: Literal["low", "high", "band"],
    cutoff: float | tuple[float, float],
    *,
    phase: Literal["zero", "causal"],
    order: int = 2,
    channels: Sequence[str] | None = None,
) -> Recording:
    """Butterworth filter of `order`. cutoff: Hz, (low, high) for a band-pass.

    phase: "zero" runs it forwards and backwards, which adds no delay, looks ahead, and doubles order and attenuation
    (6 dB at the cut-off). "causal" runs it once, as hardware would, and adds a delay; it starts as if the first sample
    had stood there for ever. Raises InputError for a cut-off above Nyquist, or a recording shorter than a period of it.
    """
    from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt  # takes a second

    edges = np.atleast_1d(np.asarray(cutoff, float))
    if kind not in ("low", "high", "band") or len(edges) != (2 if kind == "band" else 1) or order < 1:
        raise InputError(f"filter {kind}, {cutoff} Hz, order {order}: low or high take one cut-off, band takes two")
    if phase not in ("zero", "causal"):
        raise InputError(f"filter phase {phase!r}: choose 'zero' (looks ahead) or 'causal' (delays)")
    _check_cutoff(recording, edges)
    sections = butter(order, edges.squeeze(), {"band": "bandpass"}.get(kind, kind), fs=1 / recording.dt, output="sos")
    if recording.samples <= (pad := 3 * (2 * len(sections) + 1)):
        raise InputError(f"{recording.source}: {recording.samples} samples are too few to filter; give over {pad}")

    def run(x: np.ndarray) -> np.ndarray:
        if phase == "zero":
            return sosfiltfilt(sections, x)
        return sosfilt(sections, x, zi=sosfilt_zi(sections) * x[0])[0]

    names = _names(recording, channels)
    at = " to ".join(f"{f:g}" for f in edges)
    done = f"{kind}-pass Butterworth of order {order} at {at} Hz, {phase} phase"
    return _changed(recording, {n: run(recording[n]) for n in names}, f"filtered {_listed(names)}: {done}")


def without_offset(recording: Recording, channels: Sequence[str] | None = None, rest: int | None = None) -> Recording:
    """Subtract from each channel its mean, or the mean of the first `rest` samples, while the plant stands still."""
    if rest is not None and not 1 <= rest <= recording.samples:
        raise InputError(f"{recording.source}: rest of {rest} samples; give 1 to {recording.samples}")
    names = _names(recording, channels)
    offsets = {n: float(np.mean(recording[n][:rest])) for n in names}
    taken = ", ".join(f"{v:.6g} from {n}" for n, v in offsets.items())
    over = "" if rest is None else f" (mean of the first {rest} samples)"
    return _changed(recording, {n: recording[n] - v for n, v in offsets.items()}, f"took offset {taken}{over}")


def without_drift(
    recording: Recording,
    channels: Sequence[str] | None = None,
    *,
    degree: int | None = None,
    cutoff: float | None = None,
) -> Recording:
    """Subtract from each channel its slow change; the mean stays.

    degree: fit and subtract a polynomial in time of this degree (1: a line). cutoff: subtract what is slower than this
    [Hz], by a zero-phase Butterworth filter. Raises InputError unless exactly one of them is given.
    """
    if (degree is None) == (cutoff is None) or (degree is not None and not 1 <= degree <= 10):
        raise InputError(f"drift: degree {degree}, cutoff {cutoff}; give a degree of 1 to 10, or a cutoff in Hz")
    names = _names(recording, channels)
    if degree is None:
        assert cutoff is not None
        slow = filtered(recording, "low", cutoff, phase="zero", channels=names).channels
        how = f"what is slower than {cutoff:g} Hz"
    else:
        if recording.samples <= degree + 1:
            raise InputError(f"{recording.source}: {recording.samples} samples are too few for degree {degree}")
        fit, t = np.polynomial.Polynomial.fit, recording.time
        slow = {n: fit(t, recording[n], degree)(t) for n in names}
        how = f"a polynomial of degree {degree}"
    flat = {n: recording[n] - slow[n] + np.mean(slow[n]) for n in names}
    return _changed(recording, flat, f"took drift off {_listed(names)}: {how}")


def without_outliers(
    recording: Recording, channels: Sequence[str], *, half_width: int = 5, threshold: float = 3.0, least: float = 0.0
) -> tuple[Recording, dict[str, int]]:
    """Hampel's identifier: a sample too far from the median of its neighbourhood is replaced by that median.

    Too far is more than `threshold` times 1.4826 MAD of the 2 half_width + 1 samples, and more than `least` (in the
    channel's unit; give the sensor's resolution, so that a flickering last bit is no outlier). If most samples of a
    neighbourhood have one value, MAD is 0 and says nothing: without `least` such samples stay, and the history counts
    them. A true pulse of half_width samples or less is replaced too, so name sensors, not commands that step.
    Returns how many samples were replaced, by channel (Hampel 1974).
    """
    width = 2 * half_width + 1
    if half_width < 1 or not threshold > 0 or least < 0 or recording.samples < width:
        raise InputError(
            f"{recording.source}: outliers of {recording.samples} samples with half_width {half_width}, threshold "
            f"{threshold}, least {least}; needs half_width >= 1, threshold > 0, least >= 0 and {width} samples"
        )
    mended, counts, unjudged = {}, {}, {}
    for name in _names(recording, channels):
        x = recording[name]
        windows = sliding_window_view(np.pad(x, half_width, mode="reflect"), width)
        median = np.median(windows, axis=1)
        mad = np.median(np.abs(windows - median[:, None]), axis=1)
        judged = (mad > 0) | (least > 0)
        far = judged & (np.abs(x - median) > np.maximum(threshold * 1.4826 * mad, least))
        mended[name], counts[name], unjudged[name] = np.where(far, median, x), int(far.sum()), int((~judged).sum())

    def said(samples: Mapping[str, int]) -> str:
        return ", ".join(f"{count} samples of {name}" for name, count in samples.items())

    line = f"replaced {said(counts)} by the median of {width}"
    if flat := {name: count for name, count in unjudged.items() if count}:
        line += f"; left {said(flat)} unjudged, whose neighbours are equal: give least"
    return _changed(recording, mended, line), counts


def estimated_delay(recording: Recording, source: str, target: str, longest: int, onset: bool = False) -> int:
    """Delay of `target` behind `source` in samples, 0 to `longest`, from their cross-correlation.

    Both pass the filter that whitens `source`, so that the correlation is the impulse response (Box and Jenkins 1976).
    The delay is the lag of its peak. With `onset` it is the first lag that chance explains in less than 1 % of
    recordings: the transport delay of a plant that answers slowly after it. Raises InputError for a constant channel,
    for a recording that is too short, or if no lag stands out.
    """
    from scipy.signal import lfilter  # takes a second

    u, y = (recording[n] - np.mean(recording[n]) for n in (source, target))
    for name, values in ((source, u), (target, y)):
        if not np.ptp(values) > 1e-12 * np.abs(recording[name]).max():
            raise InputError(f"{recording.source}: channel {name} is constant; a delay shows only if it moves")
    if longest < 0 or recording.samples < 4 * (longest + WHITENING):
        raise InputError(
            f"{recording.source}: {recording.samples} samples are too few for delays to {longest}; "
            f"give {4 * (max(longest, 0) + WHITENING)}"
        )
    past = sliding_window_view(u, WHITENING)[:-1, ::-1]
    whitening = np.r_[1.0, -np.linalg.lstsq(past, u[WHITENING:], rcond=1e-10)[0]]
    u, y = (lfilter(whitening, 1.0, v)[WHITENING:] for v in (u, y))
    n = len(u)
    response = np.array([u[: n - d] @ y[d:] for d in range(longest + 1)]) / np.sqrt((u @ u) * (y @ y))
    seen = np.flatnonzero(np.abs(response) > -ndtri(CHANCE / 2 / (longest + 1)) / np.sqrt(n))
    if not seen.size:
        raise InputError(f"{recording.source}: {target} does not answer {source} within {longest} samples; look longer")
    return int(seen[0] if onset else np.abs(response).argmax())


def without_delay(recording: Recording, delays: Mapping[str, int]) -> Recording:
    """Move each named channel ahead by its delay in samples (below 0: back), and cut all to the time they share."""
    names = _names(recording, delays)
    longest, shortest = (pick([0, *(delays[n] for n in names)]) for pick in (max, min))
    samples = recording.samples - longest + shortest
    if samples < 2:
        raise InputError(f"{recording.source}: {recording.samples} samples leave {samples} after delays {dict(delays)}")
    starts = {n: delays.get(n, 0) - shortest for n in recording.channels}
    moved = {n: recording[n][start : start + samples] for n, start in starts.items()}
    said = ", ".join(f"{d} samples from {n}" for n, d in delays.items())
    return _changed(recording, moved, f"took delay {said}; {samples} samples left")


def resampled(recording: Recording, up: int = 1, down: int = 1) -> Recording:
    """Change the sample rate by `up`/`down`, through a linear-phase low-pass at the lower Nyquist frequency (no delay).

    A command that steps will ring; use `recording[name][::down]` for it. Raises InputError if fewer than 2 samples
    stay.
    """
    from scipy.signal import resample_poly  # takes a second

    if up < 1 or down < 1:
        raise InputError(f"{recording.source}: resampling by {up}/{down}; give whole numbers above 0")
    if recording.samples * up // down < 2:
        raise InputError(f"{recording.source}: {recording.samples} samples are too few to keep {up} of {down}")
    up, down = up // gcd(up, down), down // gcd(up, down)
    channels = {n: resample_poly(v, up, down, padtype="line") for n, v in recording.channels.items()}
    dt = recording.dt * down / up
    return replace(
        _changed(recording, channels, f"resampled by {up}/{down}, from {recording.dt:g} s to {dt:g} s"), dt=dt
    )


def _changed(recording: Recording, values: Mapping[str, np.ndarray], line: str) -> Recording:
    return replace(recording, channels={**recording.channels, **values}, history=(*recording.history, line))


def _names(recording: Recording, channels: Sequence[str] | Mapping | None) -> list[str]:
    names = list(recording.channels if channels is None else channels)
    for name in names:
        recording[name]  # raises InputError for an unknown name
    return names


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)


def _check_cutoff(recording: Recording, edges: np.ndarray) -> None:
    nyquist = 0.5 / recording.dt
    if not (np.all(edges > 0) and np.all(edges < nyquist) and np.all(np.diff(edges) > 0)):
        raise InputError(
            f"{recording.source}: cut-off {edges.tolist()} Hz; give rising frequencies between 0 and Nyquist, "
            f"{nyquist:g} Hz"
        )
    if (length := recording.samples * recording.dt) * edges[0] < 1:
        raise InputError(f"{recording.source}: {length:g} s hold no period of {edges[0]:g} Hz; record longer")
