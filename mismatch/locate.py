"""Where a mismatch acts: in which regime of the plant, when, and in which frequency band.

What is located is the term that a correction adds to a balance equation, along the recording; where nothing is
corrected, it is what the fit leaves. The energy of this signal is compared with the values of a variable. A regime is
the range of that variable in which the share of energy exceeds the share of time by most (the Kolmogorov distance of
the two distributions). A regime is reported where this excess is large, and where chance rarely concentrates the same
energy as much. Chance is simulated: stretches of the signal, as long as its energy is correlated, are permuted.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.signal import savgol_filter

from greygate.mismatch.effects import SENSOR
from greygate.mismatch.fit import Fit
from greygate.mismatch.model import SMOOTH, TINY, Model, reach
from greygate.mismatch.scales import PARABOLA
from greygate.plants.plant import Values

CELLS = 1000  # of a recording, in each of which energy and variables are averaged
STRETCHES = 12  # that are permuted, at least
DRAWS = 199  # permutations: with the order as it is 200, so that one in a hundred can be told
CHANCE = 0.01  # of so much concentration where there is none, below which a regime is reported
CLEAR = 0.35  # by which a regime's share of energy must exceed its share of time
ONE_WAY = 0.95  # of the energy: when so much acts in one direction, that direction is the regime
EDGE = 0.02  # of the time, nearer than which to an end of its range a variable is at that end
EVEN = 0.2  # of its width, within which a range lies symmetrically about zero
POWER = (0.1, 0.9)  # shares of the power below the two ends of the frequency band
STEADY = 0.9  # of the energy: a signal whose mean holds so much is constant
SLOWEST = 2  # periods in the recording: a lower frequency is not resolved
PERCENT = 100
FIGURE = ".2g"  # two significant digits
DISPLAYED = {
    "Pa": ((np.inf, 1e-5, "bar"),),
    "m": ((1e-3, 1e6, "µm"), (np.inf, 1e3, "mm")),
    "m/s": ((1e-3, 1e6, "µm/s"), (0.1, 1e3, "mm/s")),
    "s": ((1.0, 1e3, "ms"),),
}
"""SI unit -> (sizes below this one, factor, unit that a person reads); larger sizes are read in the SI unit."""


@dataclass(frozen=True)
class Location:
    """Where a mismatch acts, in words: "|x| above 31 mm", "from 12 s on", "80 % of its power between 0.2 and 3 Hz"."""

    regime: str
    time: str
    band: str


@np.errstate(over="ignore", invalid="ignore")  # a window may diverge
def located(fit: Fit, place: Mapping, acting: Sequence[Iterable[str]]) -> dict:
    """`place`, an entry of a diagnosis's `where`, with the regime in which the correction acts, its `time` and `band`.

    acting: the symbols of the parameters of each effect of the correction; an effect counts by how much it changes the
    prediction. Where there are none, what the fit leaves is located.
    """
    equation, model = place["equation"], fit.likelihood.model
    parts = [_unit(added(fit, equation, symbols)) * _weight(fit, symbols) for symbols in map(tuple, acting)]
    signal = np.hstack(parts) if parts else _unit(left(fit, equation))
    samples = np.arange(len(model.target)) if parts else np.arange(len(model.target))[fit.likelihood.kept]
    kept = np.isfinite(fit.likelihood.sigma[samples]).all(axis=1)
    signal, samples = signal[kept], samples[kept]
    if not np.any(signal):
        return dict(place)
    variables, units = signals(model)
    on = place["depends_on"] or variables
    variables = {name: s[samples] for name, s in variables.items() if name in on}
    found = locate(signal, model.recording.time[samples], variables, units)
    regime = "; ".join(text for text in (place["regime"], found.regime) if text)
    time, when = _within(signal, samples, model) if len(model.pieces) > 1 else (found.time, found.band)
    return {**place, "regime": regime, "time": time, "band": when}


def _within(signal: np.ndarray, samples: np.ndarray, model: Model) -> tuple[str, str]:
    """(in which of several recordings a signal (samples, columns) acts most, if not in all alike; its band there)."""
    energy = np.sum(signal**2, axis=1)
    most, words, there = -np.inf, "", slice(None)
    for piece, run in zip(model.pieces, model.recording.runs, strict=True):
        inside = (samples >= piece.start) & (samples < piece.stop)
        acts, lasts = float(energy[inside].sum() / energy.sum()), float(inside.mean())
        if acts - lasts > most:
            most, there = acts - lasts, inside
            words = f"in {run.name} ({PERCENT * acts:.0f} % of it, in {PERCENT * lasts:.0f} % of the time)"
    return words if most > CLEAR else "in all recordings", band(signal[there], model.rig.dt)


def _unit(columns: np.ndarray) -> np.ndarray:
    """The columns that are not 0, scaled to one size; the sum of their squares is 1 in the mean."""
    columns = columns[:, np.any(columns, axis=0)]
    return columns / np.sqrt(np.mean(columns**2, axis=0) * max(columns.shape[1], 1))


def _weight(fit: Fit, symbols: Iterable[str]) -> float:
    """By how much parameters change the prediction against their values on the data sheet, RMS in units of noise."""
    at_rest = {symbol: fit.likelihood.model.values[symbol] for symbol in symbols}
    change = fit.likelihood.errors({**fit.values, **at_rest}, fit.shifts) - fit.errors
    return float(np.sqrt(np.mean(np.where(np.isfinite(change), change, 0.0) ** 2)))


# -- what is located -------------------------------------------------------------------------------------------------


def added(fit: Fit, equation: str, symbols: Iterable[str]) -> np.ndarray:
    """What parameters add to a balance against their values on the data sheet, (samples, columns).

    The columns are in the unit of the equation's terms, on the simulated states. Where the parameters do not enter the
    equation itself, there is one column for each balance, definition of a predicted channel and sensor that they do
    enter; where they enter none, one for each channel: by how much its prediction changes.
    """
    likelihood = fit.likelihood
    model, shifts = likelihood.model, fit.shifts * likelihood.local_scale
    on = {**model.values, **fit.values}
    off = {**on, **{symbol: model.values[symbol] for symbol in symbols}}
    states, acting = model.states(on, shifts)
    _, resting = model.states(off, shifts)
    scopes = []
    for values, given in ((on, acting), (off, resting)):
        scope = Values(model.plant, {**given, **dict(zip(model.plant.states, states.T, strict=True))})
        scope.update(model.spread(values))
        scopes.append(scope)

    def differ(*places: str) -> np.ndarray:
        found = [np.broadcast_to(_difference(model, place, *scopes), len(states)) for place in places]
        columns = np.stack(found, axis=1)
        return np.where(np.isfinite(columns), columns, 0.0)

    outputs = [name for name, d in model.plant.definitions.items() if d.symbol in model.rig.predict]
    places = (*model.plant.equations, *outputs, *(SENSOR + channel for channel in model.readings))
    for columns in (differ(equation), differ(*places)):
        if np.any(columns):
            return columns[:, np.any(columns, axis=0)]
    return np.nan_to_num(model.predict(on, shifts) - model.predict(off, shifts), posinf=0.0, neginf=0.0)


def _difference(model: Model, place: str, on: Values, off: Values) -> np.ndarray | float:
    """By how much an equation, a definition or a sensor differs between two scopes on the same states, 0 for others."""
    plant = model.plant
    if equation := plant.equations.get(place):
        rates = [_sum(scope, equation.terms) / scope.evaluate(equation.storage) for scope in (on, off)]
        return (rates[0] - rates[1]) * off.evaluate(equation.storage)
    if definition := plant.definitions.get(place):
        return on[definition.symbol] - off[definition.symbol]
    reading = model.readings.get(place.removeprefix(SENSOR), {})
    return _sum(on, reading) - _sum(off, reading)


def _sum(scope: Values, terms: Mapping[str, str]):
    return sum((scope.evaluate(text) for text in terms.values()), start=0.0)


def left(fit: Fit, equation: str = "") -> np.ndarray:
    """Errors that neither parameters nor starts of windows explain (samples, channels); a sensor has one channel."""
    channels = fit.likelihood.model.rig.predict
    rows = fit.projected[:, : fit.likelihood.block * len(channels)].reshape(-1, len(channels))
    sensor = equation.removeprefix(SENSOR)
    return rows[:, [channels.index(sensor)]] if sensor in channels else rows


def signals(model: Model) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """(name -> signal, name -> unit): position, velocity and acceleration, the other channels, time."""
    if len(model.each) > 1:
        each = [signals(one) for one in model.each]
        return {name: np.concatenate([found[name] for found, _ in each]) for name in each[0][0]}, each[0][1]
    rig, recording, plant = model.rig, model.recording, model.plant
    found, units = {}, {}
    moved = next((x for x, s in plant.states.items() if s.rate and x in rig.channels), None)
    moved = moved or next((n for n in (*rig.inputs, *rig.channels) if rig.channels[n].unit == "m"), None)
    if moved is not None:
        x = recording[moved]
        found["x"], units["x"] = x, rig.channels[moved].unit
        for order, (name, per) in enumerate((("v", "/s"), ("a", "/s^2")), start=1):
            found[name] = savgol_filter(x, 2 * reach(x, SMOOTH) + 1, order + 1, deriv=order, delta=rig.dt)
            units[name] = units["x"] + per
    for name, channel in rig.channels.items():
        if name != moved and (channel.role == "input" or channel.unit != "m"):
            signal = recording[name]  # an output is smoothed, for its noise is in the residual, too
            smooth = channel.role == "output"
            found[name] = savgol_filter(signal, 2 * reach(signal, SMOOTH) + 1, PARABOLA) if smooth else signal
            units[name] = channel.unit
    found["t"], units["t"] = recording.time, "s"
    return found, units


# -- where it is -----------------------------------------------------------------------------------------------------


def locate(
    signal: np.ndarray, time: np.ndarray, variables: Mapping[str, np.ndarray], units: Mapping[str, str]
) -> Location:
    """The regime among `variables`, the time and the frequency band in which `signal` acts.

    signal: (samples, columns); its energy is the sum of their squares. time: (samples,) in s. variables: name ->
    (samples,) in SI; v among them gives the direction, and the difference of any two in one unit is a variable, too.
    units: name -> unit of each variable.
    """
    energy = Energy.of(np.sum(signal**2, axis=1))
    seen = {name: energy.beside(s) for name, s in variables.items() if name != "t"}
    units = dict(units)
    for one, other in combinations(list(seen), 2):
        if units[one] == units[other]:
            name = f"{one} − {other}"
            seen[name], units[name] = seen[one] - seen[other], units[one]
    way = _way(energy, seen["v"]) if "v" in seen else ""
    return Location(
        way or _regime(energy, seen, units) or "everywhere",
        _when(energy, energy.beside(time)) or "all the time",
        band(signal, float(time[1] - time[0])),
    )


@dataclass(frozen=True)
class Energy:
    """Shares of a signal's energy in cells of equal length, (stretches, cells of a stretch).

    A stretch is as long as the amplitude is correlated: until its autocorrelation falls below zero.
    """

    stretches: np.ndarray

    @classmethod
    def of(cls, energy: np.ndarray) -> "Energy":
        cells = _cells(energy)
        away = np.sqrt(cells) - np.sqrt(cells).mean()
        memory = np.fft.irfft(np.abs(np.fft.rfft(away, 2 * len(away))) ** 2)[: len(away)]
        forgotten = np.append(np.flatnonzero(memory <= 0), len(away))[0]
        length = int(np.clip(forgotten, 1, max(len(away) // STRETCHES, 1)))
        kept = cells[: len(cells) // length * length]
        return cls(kept.reshape(-1, length) / kept.sum())

    @property
    def cells(self) -> np.ndarray:
        return self.stretches.ravel()

    @cached_property
    def shuffled(self) -> np.ndarray:
        """The cells with their stretches permuted, (DRAWS, cells)."""
        orders = np.argsort(np.random.default_rng(0).random((DRAWS, len(self.stretches))), axis=1)
        return self.stretches[orders].reshape(DRAWS, -1)

    def beside(self, signal: np.ndarray) -> np.ndarray:
        """Means of a signal over the cells."""
        return _cells(signal)[: self.stretches.size]


def _cells(signal: np.ndarray) -> np.ndarray:
    """Means over CELLS pieces of equal length; the samples themselves where there are fewer."""
    size = max(len(signal) // CELLS, 1)
    return signal[: len(signal) // size * size].reshape(-1, size).mean(axis=1)


def _excess(cells: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Share of energy less share of time below each value of a variable, (..., cells + 1). order: that sorts it."""
    summed = np.cumsum(cells[..., order] - 1.0 / len(order), axis=-1)
    return np.concatenate([np.zeros((*summed.shape[:-1], 1)), summed], axis=-1)


def _distance(excess: np.ndarray) -> np.ndarray:
    """By how much the share of energy exceeds that of time in the densest region of a variable."""
    inside = excess - np.minimum.accumulate(excess, axis=-1)
    outside = np.maximum.accumulate(excess, axis=-1) - excess
    return np.maximum(inside.max(axis=-1), outside.max(axis=-1))


def _correlation(rows: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Correlation of each row (..., cells) with `shape` (cells,)."""
    away, shape = rows - rows.mean(axis=-1, keepdims=True), shape - np.mean(shape)
    return away @ shape / np.maximum(np.linalg.norm(away, axis=-1) * np.linalg.norm(shape), TINY)


def _rare(found: float, drawn: np.ndarray) -> bool:
    """Whether chance is seldom as large: where the same energy stands in another order."""
    return bool((1 + np.sum(drawn >= found)) / (1 + len(drawn)) <= CHANCE)


def _way(energy: Energy, v: np.ndarray) -> str:
    """The direction in which nearly all energy acts, if there is one."""
    for word, there in (("forward", v > 0), ("backward", v < 0)):
        share = energy.cells[there].sum()
        if share >= ONE_WAY and _rare(share, energy.shuffled[:, there].sum(axis=1)):
            return word
    return ""


def _regime(energy: Energy, seen: Mapping[str, np.ndarray], units: Mapping[str, str]) -> str:
    """The region in which the energy is densest, of the variable that tells most."""
    orders = {name: np.argsort(s, kind="stable") for name, s in seen.items()}
    distances = {name: float(_distance(_excess(energy.cells, order))) for name, order in orders.items()}
    name = max(distances, key=lambda name: distances[name], default="")
    if not name or distances[name] < CLEAR:
        return ""
    drawn = np.max([_distance(_excess(energy.shuffled, order)) for order in orders.values()], axis=0)
    if not _rare(distances[name], drawn):
        return ""
    part = Region.densest(energy, seen[name])
    if part.whole:
        return ""
    shares = PERCENT * energy.cells[part.inside].sum(), PERCENT * part.inside.mean()
    words = part.words(name, *display_unit(units[name], float(np.abs(seen[name]).max())))
    return f"{words} ({shares[0]:.0f} % of it, in {shares[1]:.0f} % of the time)"


def _when(energy: Energy, clock: np.ndarray) -> str:
    """The time in which the energy is densest, or that it grows."""
    order = np.arange(len(clock))
    distance = float(_distance(_excess(energy.cells, order)))
    if distance < CLEAR:
        return ""
    part = Region.densest(energy, clock)
    if part.whole:
        return ""
    ramp, jump = (float(_correlation(np.sqrt(energy.cells), shape)) for shape in (clock, part.inside))
    if part.open and abs(ramp) >= jump:
        steady = _rare(abs(ramp), np.abs(_correlation(np.sqrt(energy.shuffled), clock)))
        return ("grows with time" if ramp > 0 else "fades with time") if steady else ""
    if not _rare(distance, _distance(_excess(energy.shuffled, order))):
        return ""
    low, high = (None if b is None else _figure(b) for b in (part.low, part.high))
    if part.open:
        return f"from {low} s on" if high is None else f"until {high} s"
    return f"until {low} s and from {high} s on" if part.beyond else f"between {low} and {high} s"


@dataclass(frozen=True)
class Region:
    """Values of a variable between low and high, or beyond both. An end is None where the region is open.

    inside: whether each cell is in the region (cells,).
    """

    low: float | None
    high: float | None
    beyond: bool
    inside: np.ndarray

    @property
    def whole(self) -> bool:
        """Whether the region has no end: then it tells nothing."""
        return self.low is None and self.high is None

    @property
    def open(self) -> bool:
        """Whether the region reaches to one end of all values."""
        return self.low is None or self.high is None

    @classmethod
    def densest(cls, energy: Energy, variable: np.ndarray) -> "Region":
        """The region in which the share of energy exceeds the share of time by most.

        A burst near one end is between two values as well as beyond them, and then told as what has an end.
        """
        order = np.argsort(variable, kind="stable")
        excess = _excess(energy.cells, order)
        rise, fall = excess - np.minimum.accumulate(excess), np.maximum.accumulate(excess) - excess
        beyond = bool(fall.max() > rise.max())
        found = cls._between(variable, order, excess, rise, fall, beyond)
        return cls._between(variable, order, excess, rise, fall, not beyond) if found.whole else found

    @classmethod
    def _between(cls, variable, order, excess, rise, fall, beyond: bool) -> "Region":
        """The region between two values, or beyond them, by the curves of `densest`."""
        count = len(variable)
        last = int(np.argmax(fall if beyond else rise))
        first = int((np.argmax if beyond else np.argmin)(excess[: last + 1]))
        first = 0 if first < EDGE * count else first
        last = count if count - last < EDGE * count else last
        low = None if first == 0 else float(variable[order[first]])
        high = None if last == count else float(variable[order[last - 1]])
        within = np.zeros(count, bool)
        within[order[first:last]] = True
        if not beyond:
            return cls(low, high, False, within)
        if low is None or high is None:  # beyond one end
            return cls(high, low, False, ~within)
        return cls(low, high, True, ~within)

    def words(self, name: str, factor: float, unit: str) -> str:
        """The region as a person says it: "|x| above 31 mm"; a symmetric one is told by its half width.

        A whole one is not told.
        """
        low, high = (None if b is None else b * factor for b in (self.low, self.high))
        unit = f" {unit}" if unit else ""
        if high is None:
            return "" if low is None else f"{name} above {_figure(low)}{unit}"
        if low is None:
            return f"{name} below {_figure(high)}{unit}"
        if abs(low + high) < EVEN * (high - low):
            return f"|{name}| {'above' if self.beyond else 'below'} {_figure((high - low) / 2)}{unit}"
        ends = _figure(low), _figure(high)
        return (
            f"{name} below {ends[0]} or above {ends[1]}" if self.beyond else f"{name} {ends[0]} to {ends[1]}"
        ) + unit


def band(columns: np.ndarray, dt: float) -> str:
    """The frequencies between which most power of `columns` (samples, columns), sampled every `dt` s, lies."""
    away = columns - columns.mean(axis=0)
    if np.sum(away**2) < (1 - STEADY) * np.sum(columns**2):
        return "constant"
    power = np.sum(np.abs(np.fft.rfft(away * np.hanning(len(away))[:, None], axis=0)) ** 2, axis=1)
    low, high = np.searchsorted(np.cumsum(power) / power.sum(), POWER)
    resolved = 1.0 / (len(columns) * dt)
    if low <= SLOWEST:
        return f"{PERCENT * POWER[1]:.0f} % of its power below {_figure(max(high, SLOWEST) * resolved)} Hz"
    low, high = _figure(low * resolved), _figure(high * resolved)
    where = f"between {low} and {high} Hz" if low != high else f"at {low} Hz"
    return f"{PERCENT * (POWER[1] - POWER[0]):.0f} % of its power {where}"


def display_unit(unit: str, reach: float) -> tuple[float, str]:
    """(factor, label) from SI to what a person reads for sizes up to `reach`: bar, µm or mm, ms."""
    for below, factor, label in DISPLAYED.get(unit, ()):
        if reach < below or below == np.inf:
            return factor, label
    return 1.0, "" if unit == "1" else unit


def _figure(value: float) -> str:
    """`value` to two significant digits."""
    return f"{float(f'{value:{FIGURE}}'):g}".replace("-", "−")
