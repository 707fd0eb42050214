"""What a term that the plant has not would do, without compiling it: a signal along the recording acts in a place.

A place is a balance or a definition. In each stands one further input, `forced_PLACE`, which is 0. A function of
recorded signals, computed along the recording, is given to one of them; what it changes in the errors is the slope by
its coefficient, as long as the run stays near the recorded signals. So hundreds of functions cost one compilation.

Where states are recorded the run begins anew in short windows, even if the rig says one free run: a run that is far
from the recording says nothing of what was missing on the way.
"""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from greygate.errors import InputError
from greygate.mismatch.entries import SENSOR, TIME
from greygate.mismatch.fit import Fit, Likelihood, tame
from greygate.mismatch.model import TINY, Model, lagged
from greygate.mismatch.places import places
from greygate.mismatch.rig import FEWEST, Rig
from greygate.mismatch.runs import Runs, along, with_channels
from greygate.mismatch.scales import noise
from greygate.mismatch.search import Hypothesis, Search
from greygate.plants.expressions import names
from greygate.plants.plant import Equation, Plant, Values
from greygate.plants.recording import Recording

FORCED = "forced_"
NOTHING = Hypothesis()
LAGS = {"lag_2": 2, "lag_5": 5, "lag_15": 15}  # samples, of a sensor that answers late
FLAT = 1e-12  # of a signal's size, below which its spread is rounding
LONGEST = 40_000  # samples of all channels together that are looked at: a function takes as many numbers
WINDOWS = 40  # of a recording, at least, where the run begins anew in windows
SMALL = 0.01  # of the largest term of a place: a term of this size changes the errors in proportion
EXPECTED = 0.9  # of the cost that pure noise would have: what is above it is misfit


Place = tuple[str, ...]
"""One balance or definition; or two balances, in the second of which a term stands with the opposite sign."""
SIGNS = (1, -1)


@dataclass(frozen=True)
class Acting:
    """A term along the recording, signal (samples,), in a place."""

    place: Place
    signal: np.ndarray


def sums(rig: Rig) -> list[str]:
    """Where a term may be missing: any balance but that of a position, any law that gives a predicted channel."""
    plant = rig.plant
    moving = {name: e.state for name, e in plant.equations.items() if e.state not in plant.shown}
    balances = [name for name, state in moving.items() if not plant.states[state].rate]
    return balances + [name for name, d in plant.definitions.items() if d.symbol in rig.predict]


def first(recording: Recording, samples: int) -> Recording:
    """The first of so many samples; of several recordings the same share of each."""
    share = min(samples / recording.samples, 1.0)
    if share == 1.0:
        return recording
    runs = [
        replace(run, channels={name: c[: int(share * run.samples)] for name, c in run.channels.items()})
        for run in recording.runs
    ]
    return Runs.of(runs) if isinstance(recording, Runs) else runs[0]


def between(rig: Rig) -> dict[Place, list[str]]:
    """The balances of two bodies -> by how much they move apart, and how fast."""
    found: dict[Place, list[str]] = {}
    for pair in places(rig)["bodies"]:
        apart = [f"({pair[f'{s}_1']} - {pair[f'{s}_2']})" for s in ("x", "v") if f"{s}_2" in pair]
        found[pair["motion_1"], pair["motion_2"]] = apart
    return found


def sensors(base: Fit) -> dict[tuple[str, str], np.ndarray]:
    """(place, function) -> what a sensor at fault would add to the errors of a fit, (samples, channels)."""
    likelihood = base.likelihood
    rig = likelihood.model.rig
    values = {**likelihood.model.values, **base.values}
    predicted = likelihood.model.predict(values, base.shifts * likelihood.local_scale)
    out, cut = {}, likelihood.model.pieces
    for i, channel in enumerate(rig.predict):
        signal = predicted[:, i]
        rate = along(lambda part: np.gradient(part, rig.dt), cut, signal)
        shapes = {
            "one": np.ones_like(signal),
            "value": signal - signal.mean(),
            "rate": rate,
            "t": likelihood.model.recording.time,
        }
        shapes |= {
            name: along(lambda part, s=lag * rig.dt: lagged(part, s, rig.dt), cut, signal) - signal
            for name, lag in LAGS.items()
        }
        for name, shape in shapes.items():
            column = np.zeros_like(base.errors)
            size = max(float(np.std(shape)), FLAT * float(np.abs(shape).max()) + TINY)
            column[:, i] = -shape / size
            out[SENSOR + channel, name] = likelihood.white(column)
    return out


class Forced:
    """The calibrated fit of a search's plant, and what functions of its signals change there.

    rig: the search's, with restarts where states are recorded. told: whether its file says so. base: that fit.
    signals: what moves along the recording, as recorded or as a rate of that, else as simulated, and how far bodies are
    apart (samples,). places: where a term may be missing -> the signals on which it may depend there. size: RMS of the
    largest term of each place. given: effects that the plant has, fitted from `values` on. acting: a term that acts in
    `run`, the fit at which all is linearised; `base` has the errors of that run without the term. free: the run begins
    anew only where the rig's file says so.
    """

    def __init__(
        self,
        search: Search,
        given: Hypothesis = NOTHING,
        values: Mapping[str, float] | None = None,
        acting: Acting | None = None,
        free: bool = False,
    ):
        everywhere, most = sums(search.rig), LONGEST // len(search.rig.predict)
        recording = first(search.final.model.recording, most)
        plant = search.rig.plant
        anew = not search.rig.window and not plant.whole
        anew &= any(s in search.rig.channels for s in plant.states if s not in plant.shown)
        self.rig = _restarted(search.rig, recording, free) if anew else search.rig
        self.told = bool(search.rig.window)
        self.anew, self.free = anew and not free, anew and free
        rig = replace(self.rig, plant=_opened(self.rig.plant, everywhere))
        zeros = {FORCED + place: np.zeros(recording.samples) for place in everywhere}
        units = {**recording.units, **dict.fromkeys(zeros, "")}
        recording = with_channels(recording, {**recording.channels, **zeros}, units)
        self.search = Search(rig, recording, {key: search.effects[key] for key in given.effects})
        if search.rig.stated and not anew:
            self.search.under(search.noise)
        self.search.between = search.between
        self._driven = dict(zeros)
        final, start = self._final(acting), values if acting else None
        base = self.search.fit(final, given, values or {}) if given.size else self.search.base(final, start)
        self.run: Fit = base
        moving, scope = _signals(base, {**(values or {}), **base.values})
        self._values = Values(rig.plant, scope)
        self._values.update({s: v for s, v in base.values.items() if s in rig.plant.parameters})
        apart = between(self.rig)
        self.signals = moving | {text: self.of(text) for texts in apart.values() for text in texts}
        self.places: dict[Place, list[str]] = {(place,): [*moving] for place in everywhere} | apart
        self.size = {place: self._largest(place[0]) for place in self.places}
        self._columns: dict[tuple[Place, str], np.ndarray] = {}
        self.base = _less(base, self._moved(acting.place, acting.signal)) if acting else base

    def _final(self, acting: Acting | None) -> Likelihood:
        """The likelihood in which a term acts."""
        likelihood = self.search.final
        if acting is None:
            return likelihood
        likelihood = copy.copy(likelihood)
        for name, sign in zip(acting.place, SIGNS, strict=False):
            self._driven[FORCED + name] = sign * self._held(acting.signal, likelihood.model)
            likelihood.model = likelihood.model.driven(FORCED + name, self._driven[FORCED + name])
        return likelihood

    @property
    def model(self) -> Model:
        return self.run.likelihood.model

    @property
    def lost(self) -> bool:
        """Whether a run that is not begun anew leaves the recording."""
        return self.search.lost(self.run)

    @property
    def expected(self) -> float:
        """The cost that the noise alone would have; 0 where nobody told it."""
        told = self.search.rig.stated
        return self.base.likelihood.count * EXPECTED / float(np.mean(self.base.temper**2)) if told else 0.0

    def is_place(self, signal: str) -> bool:
        """Whether a signal says where something is: the integral of a state, or how far two bodies are apart."""
        plant = self.rig.plant
        return any(s in plant.states and plant.states[s].rate for s in names([signal]))

    def of(self, text: str) -> np.ndarray:
        """An expression along the recording (samples,)."""
        with np.errstate(all="ignore"):
            return np.nan_to_num(np.broadcast_to(self._values.evaluate(text), len(self.model.target)).astype(float))

    def unit(self, place: Place, text: str) -> float:
        """What the coefficient of an expression is where it is as large as the largest term of its place."""
        return self.size[place] / (float(np.sqrt(np.mean(self.of(text) ** 2))) or 1.0)

    def column(self, place: Place, text: str) -> np.ndarray:
        """What an expression in a place, times its `unit`, changes in the errors (windows, rows)."""
        key = place, text
        if key not in self._columns:
            self._columns[key] = self.changed(place, self.of(text) * self.unit(place, text))
        return self._columns[key]

    def changed(self, place: Place, signal: np.ndarray) -> np.ndarray:
        """What a signal (samples,) in a place changes in the errors (windows, rows), in proportion to a small one.

        Less what the beginnings of the windows make up for.
        """
        rows = self.run.likelihood.rows(self._moved(place, signal), self.run.temper)
        return self.run.likelihood.eliminate(rows[:, :, None], None, self.run.basis)[0][:, :, 0]

    def _moved(self, place: Place, signal: np.ndarray) -> np.ndarray:
        """By how much a signal (samples,) in a place moves the errors (samples, channels)."""
        run, likelihood = self.run, copy.copy(self.run.likelihood)
        for name, sign in zip(place, SIGNS, strict=False):
            acting = self._driven[FORCED + name] + sign * SMALL * self._held(signal, self.model)
            likelihood.model = likelihood.model.driven(FORCED + name, acting)
        return tame(likelihood.errors(run.values, run.shifts) - run.errors) / SMALL

    @staticmethod
    def _held(signal: np.ndarray, model: Model) -> np.ndarray:
        """A signal (samples,) in the middle between its samples."""
        return along(lambda s: np.append((s[1:] + s[:-1]) / 2, s[-1]), model.pieces, signal)

    def strange(self, place: Place, depends_on: Iterable[str]) -> int:
        """How strange signals are to a place: 0 for what is stored or moves there, 1 for what acts there, 2 for others.

        The sum over all of them.
        """
        plant = self.search.rig.plant
        found = [plant.equations.get(name) or plant.definitions[name] for name in place]
        states = {getattr(each, "state", "") for each in found}
        own = states | {symbol for symbol, state in plant.states.items() if state.rate in states}
        acts = _used(plant, [text for each in found for text in each.terms.values()])
        return sum(0 if symbol in own else 1 if symbol in acts else 2 for symbol in depends_on)

    def _largest(self, place: str) -> float:
        plant = self.search.rig.plant
        table = plant.equations.get(place) or plant.definitions[place]
        signals = [self.of(text) for text in table.terms.values()]
        if not signals and plant.outside and isinstance(table, Equation):
            signals = [np.gradient(self.of(table.state), self.search.rig.dt)]
        return max((float(np.sqrt(np.mean(np.square(s)))) for s in signals), default=0.0) or 1.0


def _signals(base: Fit, values: Mapping[str, float]) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """(inputs and states that move, with t; all of them): as recorded, a rate of that, or as simulated (samples,)."""
    likelihood, model = base.likelihood, base.likelihood.model
    plant = model.rig.plant
    states, inputs = model.states({**model.values, **values}, base.shifts * likelihood.local_scale)
    simulated = dict(zip(model.plant.states, states.T, strict=True))
    rates = {state.rate: symbol for symbol, state in plant.states.items() if state.rate}
    found = {TIME: model.recording.time, **inputs}
    for symbol, run in simulated.items():
        place = rates.get(symbol)
        if symbol in model.recording.channels:
            found[symbol] = model.recording[symbol]
        elif place is not None and place in model.recording.channels:
            found[symbol] = _rate(model, place, model.smooth_rate(place), simulated[place], run)
        else:
            found[symbol] = run
    own = {TIME, *(s for s in plant.symbols if not s.startswith(FORCED))}
    moving = {s: x for s, x in found.items() if s in own and np.isfinite(x).all() and np.ptp(x) > 0}
    return moving, found


def _rate(model: Model, place: str, smooth: np.ndarray, simulated: np.ndarray, run: np.ndarray) -> np.ndarray:
    """The rate of a recorded channel, smoothed or as `run`: the one whose integral follows the recording (samples,).

    simulated: the channel itself in that run. The integral begins anew with every window.
    """
    recorded, cut = model.recording[place], model.restarts[1:]
    summed = np.cumsum(smooth) * model.rig.dt
    off = [_scatter(path - recorded, cut) for path in (summed, simulated)]
    return run if off[1] < off[0] else smooth


def _scatter(errors: np.ndarray, cut: np.ndarray) -> float:
    """Squares of errors, less the mean of each window; infinite where they are no numbers."""
    parts = np.split(errors, cut)
    return float(np.nan_to_num(sum(np.sum((part - part.mean()) ** 2) for part in parts), nan=np.inf))


def _used(plant: Plant, texts: Iterable[str]) -> set[str]:
    """The symbols in expressions, and in the definitions of those."""
    found: set[str] = set()
    new = names(texts)
    while new - found:
        found |= new
        new = names(t for d in plant.definitions.values() if d.symbol in new for t in d.terms.values())
    return found


def _less(fit: Fit, moved: np.ndarray) -> Fit:
    """A fit without what moved its errors (samples, channels); it is linearised with that, where it was made."""
    less = replace(fit, errors=fit.errors - moved)
    vars(less).update(basis=fit.basis, slopes=fit.slopes)
    return less


def _restarted(rig: Rig, recording: Recording, free: bool) -> Rig:
    """The rig with restarts, unless it runs `free`, and the noise that its channels show where none is told."""
    channels = {n: c if c.sigma else replace(c, noise=noise(recording[n])) for n, c in rig.channels.items()}
    return replace(rig, channels=channels, window=None if free else max(recording.samples // WINDOWS, FEWEST))


def _opened(plant: Plant, where: Iterable[str]) -> Plant:
    """The plant with a further input in each place."""
    inputs, equations, definitions = dict(plant.inputs), dict(plant.equations), dict(plant.definitions)
    for place in where:
        name = FORCED + place
        if name in plant.symbols:
            raise InputError(f"plant {plant.name}: {name}: is the simulation's own name; rename it")
        inputs[name] = ""
        table: dict = equations if place in equations else definitions
        table[place] = replace(table[place], terms={**table[place].terms, name: name})
    return replace(plant, inputs=inputs, equations=equations, definitions=definitions)
