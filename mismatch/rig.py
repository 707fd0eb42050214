"""A rig: what the engineer knows of it (`rig.toml`), and its recordings.

The layout is that of `docs/diagnosis.md`: `rig.toml`, `identify.csv`, `holdout.csv`.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from greygate.errors import InputError, shown
from greygate.mismatch.libraries import declared
from greygate.mismatch.runs import Runs
from greygate.mismatch.scales import noise
from greygate.mismatch.uneven import resampled, varies
from greygate.names import check_file_name
from greygate.plants import kinds
from greygate.plants.expressions import check_name, is_symbol
from greygate.plants.plant import SHORTEST as SHORTEST_STEP
from greygate.plants.plant import Parameter, Plant
from greygate.plants.readers.read import CLOCKS, read_recording
from greygate.plants.recording import Recording, check_sizes, run_name
from greygate.plants.table import CsvTable, read_header, read_table
from greygate.progress import once
from greygate.reading import line, listed, named, number, one_of, read_toml, table, within

PLANTS = Path(__file__).parent.parent / "machines"  # NAME.toml in one of its folders is the plant NAME
SHORTEST = 40  # samples: a shorter recording leaves nothing to judge a fit by; it is held out in twenty blocks
READABLE = 2  # samples, from which a sample time follows
JITTER = 1e-3  # of a sample interval, by which one interval may differ from the next
COARSER = 1.5  # times the rig's sample interval: a log so coarse leaves every other sample to be guessed
TIME_ROUNDING = 1e-12  # of the last time, by which the difference of two written times may be off
FEWEST = 10  # samples: a shorter window is mostly its own beginning
LONGEST = 1e9  # s of a sample, a window, a settling: thirty years
MOST = 100_000  # steps of integration in a sample; with more the simulation seems to hang
IDENTIFY, HOLDOUT = "identify.csv", "holdout.csv"  # the recordings, where rig.toml lists no others
IN = "@"  # between a parameter and the recording that has a value of its own: mass@run2
UNKNOWN = "is no entry of [parameters]; give {} there"
STEP, LINEAR = "step", "linear"  # how an input goes from one sample to the next
UNIFORM_VARIANCE = 12  # an error spread evenly over a width has the variance width^2 / 12


@dataclass(frozen=True)
class Channel:
    """A recorded signal: its `role` is input or output.

    resolution: the quantum of its converter; noise: the RMS of its white noise; both in `unit`, 0 where not stated.
    hold: between two samples an input keeps its value (step), or goes straight to the next (linear).
    heard: whether nobody stated the noise, and the recording shows it.
    """

    unit: str
    role: str
    resolution: float = 0.0
    noise: float = 0.0
    hold: str = STEP
    heard: bool = False

    @property
    def sigma(self) -> float:
        """RMS of noise and rounding together."""
        return float(np.hypot(self.noise, self.resolution / np.sqrt(UNIFORM_VARIANCE)))


@dataclass(frozen=True)
class Own:
    """What differs in one recording: values of parameters there, and how uncertain they are.

    tolerance: relative. plus_minus: in the parameter's unit.
    """

    parameters: Mapping[str, float] = field(default_factory=dict)
    tolerance: Mapping[str, float] = field(default_factory=dict)
    plus_minus: Mapping[str, float] = field(default_factory=dict)

    @property
    def unsure(self) -> tuple[str, ...]:
        """The parameters that are fitted in that recording alone."""
        return (*self.tolerance, *self.plus_minus)


@dataclass(frozen=True)
class Rig:
    """What `rig.toml` says.

    plant: with the data sheet's values and tolerances. datasheet: symbol -> value as `rig.toml` gives it.
    predict: the channels that a simulation predicts. dt: the sample interval in s.
    window: samples between restarts of the simulation, None for one free run from the first sample to the last.
    anew: parameters that have another value in each recording. settle: how many first samples of holdout.csv serve
    only to fit its initial states and the parameters in `anew`; the error there does not count.
    identify, holdout: the files to be explained, and to be held against. own: name of a recording -> what differs
    there. given: those that are no files, by the names that stand in identify and holdout.
    """

    plant: Plant
    datasheet: Mapping[str, float]
    channels: Mapping[str, Channel]
    predict: tuple[str, ...]
    dt: float
    window: int | None
    folder: Path
    settle: int = 0
    anew: tuple[str, ...] = ()
    identify: tuple[str, ...] = (IDENTIFY,)
    holdout: tuple[str, ...] = (HOLDOUT,)
    own: Mapping[str, Own] = field(default_factory=dict)
    given: Mapping[str, Recording] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """What a message calls it."""
        return f"plant {self.plant.name}" if self.given else str(self.folder)

    @property
    def stated(self) -> bool:
        """Whether rig.toml states the noise of every predicted channel; if not, it is fitted along with the plant."""
        return all(self.channels[name].sigma > 0 for name in self.predict)

    @property
    def heard(self) -> bool:
        """Whether a noise that nobody stated was taken from the recording."""
        return any(channel.heard for channel in self.channels.values())

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(name for name, channel in self.channels.items() if channel.role == "input")

    # -- what differs from recording to recording ----------------------------------------------------------------------

    @property
    def several(self) -> bool:
        """Whether recordings to be explained may differ in more than their motion."""
        return len(self.identify) > 1 or any(run_name(file) in self.own for file in self.identify)

    def of(self, name: str) -> "Rig":
        """The rig as it is in the recording of that name: with its values of parameters, and their tolerances.

        A value that stands there is exact, unless a tolerance stands there too, or each recording has it `anew`.
        """
        own = self.own.get(name)
        if own is None:
            return self
        parameters, anew = dict(self.plant.parameters), self._beginning()
        for symbol in (*own.parameters, *own.unsure):
            p = parameters[symbol]
            value = own.parameters.get(symbol, p.value)
            if symbol in own.unsure or not (symbol in anew or value == p.value):
                p = replace(p, tolerance=own.tolerance.get(symbol, 0.0), plus_minus=own.plus_minus.get(symbol, 0.0))
            parameters[symbol] = replace(p, value=value)
        return replace(
            self,
            plant=replace(self.plant, parameters=parameters),
            datasheet={**self.datasheet, **own.parameters},
            anew=tuple(dict.fromkeys((*self.anew, *own.unsure))),
            own={},
        )

    def _beginning(self) -> set[str]:
        """Parameters that every recording has anew: those that `anew` lists, and in which states begin."""
        return {*self.anew, *(s.initial for s in self.plant.states.values() if isinstance(s.initial, str))}

    def fitted_in(self, name: str) -> dict[str, str]:
        """Parameter that is fitted to the recording of that name alone -> the name of its value there."""
        if not self.several:
            return {}
        own = self.own.get(name, Own())
        there = self.of(name).plant.parameters
        return {s: f"{s}{IN}{name}" for s in there if s in {*self._beginning(), *own.unsure} and there[s].reach}

    def uncertain(self) -> dict[str, Parameter]:
        """Every value that is fitted -> the data sheet's: of shared parameters, then of each recording's own."""
        names = [run_name(file) for file in self.identify]
        own = {name: self.fitted_in(name) for name in names}
        kept = [{*own[name], *self.own.get(name, Own()).parameters} for name in names]
        found = {
            s: p for s, p in self.plant.parameters.items() if p.reach and not all(s in symbols for symbols in kept)
        }
        for name in names:
            found |= {key: self.of(name).plant.parameters[s] for s, key in own[name].items()}
        return found

    # -- its recordings ------------------------------------------------------------------------------------------------

    def recording(self, path: Path | str) -> Recording:
        """Read a recording of this rig: its first column is `t` in s, each further column is a channel.

        Time steps that vary are made uniform (`uneven`). Raises InputError where a channel is missing or unknown, a
        value is NaN, time has a gap or another step than `dt`, or the recording is too short.
        """
        return self.timed(path)[0]

    def to_explain(self) -> Recording:
        """identify.csv, or the recordings that `identify` lists; `Runs` where they may differ.

        Raises InputError where one cannot be read, or is too short to be explained.
        """
        least = FEWEST if len(self.identify) > 1 else SHORTEST
        found = [self._recorded(file, least) for file in self.identify]
        if (samples := sum(r.samples for r in found)) < SHORTEST:
            raise InputError(f"{self.title}: {samples} samples in all recordings; record at least {SHORTEST}")
        return Runs.of(found) if self.several else found[0]

    def held_out(self) -> Recording | None:
        """holdout.csv, or the recordings that `holdout` lists; None where there is none.

        Raises InputError where one is no longer than the rig settles.
        """
        there = HOLDOUT in self.given or (self.folder / HOLDOUT).exists()
        if not self.holdout or (self.holdout == (HOLDOUT,) and not there):
            return None
        found = [self._recorded(file) for file in self.holdout]
        for recording in found:
            if recording.samples <= self.settle:
                problem = f"{recording.samples} samples, of which settle_s leaves none"
                raise InputError(f"{recording.source}: {problem}; record more, or settle for less")
        alike = not self.several and len(found) == 1 and found[0].name not in self.own
        return found[0] if alike else Runs.of(found)

    def _recorded(self, file: str, least: int = READABLE) -> Recording:
        if file not in self.given:
            return self.timed(self.folder / file, least)[0]
        self._long_enough(self.given[file].samples, least, self.given[file].source)
        return self.given[file]

    def _long_enough(self, samples: int, least: int, where: str) -> None:
        shortest = max(least, self.window or 0)
        if samples < shortest:
            wish = f"record at least {shortest} samples, {shortest * self.dt:g} s"
            raise InputError(f"{where}: {samples} samples, {samples * self.dt:g} s; {wish}")

    def timed(self, path: Path | str, least: int = READABLE) -> tuple[Recording, list[str]]:
        """The recording of `least` samples or more, and the column `t` as the file writes it.

        A file in another form than a rig's is read as a log: names with units, which are converted.
        """
        if Path(path).exists() and not _plain(Path(path)):
            logged = self._logged(path, least)
            return logged, [f"{t:.9g}" for t in logged.time]
        table = read_table(path)
        path, header = table.path, table.header
        if header[0] != "t":
            raise InputError(f"{path}: first column {header[0]!r}; it must be t, in s")
        if missing := [name for name in self.channels if name not in header]:
            raise InputError(f"{path}: no column {', '.join(missing)}; rig.toml names these channels")
        if unknown := [name for name in header[1:] if name not in self.channels]:
            raise InputError(f"{path}: column {', '.join(unknown)} is no channel of rig.toml; declare or drop it")
        self._long_enough(len(table.cells), least, str(path))
        channels = {name: table.values[:, header.index(name)] for name in self.channels}
        units = {name: channel.unit for name, channel in self.channels.items()}
        check_sizes(channels, str(path))
        clock, channels, said = self._uniform(table, channels, units)
        return Recording(self.dt, channels, units, source=str(path), history=said), clock

    def _logged(self, path: Path | str, least: int) -> Recording:
        """The channels of a log that the rig has, at its sample time; a column without a unit has the rig's."""
        found = read_recording(path, bare=True, told=once)
        if found.dt > COARSER * self.dt:
            wish = f"write sample_time_s = {found.dt:g}, or the unit of the time if it is not s"
            other = f"sampled every {found.dt:g} s, sample_time_s = {self.dt:g} in rig.toml"
            raise InputError(f"{path}: {other}; what lies between is not on record: {wish}")
        if abs(found.dt - self.dt) > JITTER * self.dt:
            found = read_recording(path, bare=True, resample=self.dt, told=once)
        if missing := [name for name in self.channels if name not in found.channels]:
            raise InputError(f"{path}: no column {', '.join(missing)}; rig.toml names these channels")
        units = {name: channel.unit for name, channel in self.channels.items()}
        for name, unit in units.items():
            if found.units[name] not in ("1", unit):
                raise InputError(f"{path}: {name} is in {found.units[name]}, rig.toml has it in {unit}")
        self._long_enough(found.samples, least, str(path))
        return replace(found, dt=self.dt, channels={name: found[name] for name in units}, units=units)

    def _uniform(
        self, table: CsvTable, channels: Mapping[str, np.ndarray], units: Mapping[str, str]
    ) -> tuple[list[str], dict[str, np.ndarray], tuple[str, ...]]:
        """(instants as text, channels there, what was done to them)."""
        clock = table.values[:, 0]
        steps, rounding = np.diff(clock), TIME_ROUNDING * float(np.abs(clock).max())
        off = np.abs(steps - self.dt) > JITTER * self.dt + rounding
        if off.any() and varies(steps, self.dt):
            rated = {how.split()[1] for how in self.plant.derived.values()}
            held: Collection[str] = [name for name in self.inputs if name not in rated]
            instants, channels, said = resampled(clock, channels, self.dt, held, units)
            if len(instants) >= FEWEST:
                return [f"{t:.9g}" for t in instants], channels, (said,)
        table.require_steps(steps, off, self.dt, "stands in rig.toml")
        return [row[0] for row in table.cells], dict(channels), ()


def _plain(path: Path) -> bool:
    """Whether a file is in a rig's own form, whatever is wrong with it: a CSV of `t` and names without units."""
    if not path.name.lower().removesuffix(".gz").endswith(".csv"):
        return False
    header, _ = read_header(path)
    return all(is_symbol(name) for name in header) and not CLOCKS - {"t"} & {*header[:1]}


CHANNEL = {"unit": line, "role": one_of(("input", "output"))}
SENSED = dict.fromkeys(("resolution", "noise_rms"), within(0.0, np.inf, "give 0 or more"))
SENSED["hold"] = one_of((STEP, LINEAR))
NEEDED = {
    "plant": line,
    "sample_time_s": within(1e-9, LONGEST, "give seconds"),
    "predict": listed(line),
    "parameters": named(number, check_name),
    "channels": named(lambda value, where: table(value, where, CHANNEL, SENSED, others=True), check_name),
}
UNSURE = {
    "tolerance": named(within(0.0, 1.0, "give a relative uncertainty, 0 to 1, or a plus_minus"), check_name),
    "plus_minus": named(within(0.0, np.inf, "give 0 or more, in the parameter's unit"), check_name),
}
OWN = {"parameters": named(number, check_name), **UNSURE}
OPTIONAL = {
    "window_s": within(0.0, LONGEST, "give seconds"),
    "settle_s": within(0.0, LONGEST, "give seconds"),
    "anew": listed(line),
    "step_s": within(SHORTEST_STEP, LONGEST, "give seconds"),
    kinds.TRUST: line,  # SHA-256 of the FMU that the rig means
    **UNSURE,
    "identify": listed(check_file_name),
    "holdout": listed(check_file_name),
    "recordings": named(lambda value, where: table(value, where, {}, OWN), line),
}


def load(folder: Path | str) -> Rig:
    """The rig of `folder`/rig.toml; its plant is one of `machines/*/NAME.toml`, or a TOML file named beside it.

    Raises InputError naming file and entry.

    >>> Path("rig").mkdir()
    >>> _ = Path("rig/axis.toml").write_text(text)  # of `Plant`
    >>> sheet = '''
    ... plant = "axis.toml"
    ... sample_time_s = 0.005
    ... predict = ["x"]
    ... parameters = { mass = 20.0, viscous = 400.0 }
    ... tolerance = { viscous = 0.1 }
    ... channels.force = { unit = "N", role = "input", resolution = 1e-3 }
    ... channels.x = { unit = "m", role = "output", noise_rms = 2e-6 }
    ... '''
    >>> _ = Path("rig/rig.toml").write_text(sheet)
    >>> rig = load_rig("rig")
    >>> rig.plant.parameters["viscous"].tolerance
    0.1
    """
    folder = Path(folder)
    path = folder / "rig.toml"
    found = table(read_toml(path, "give the folder of a rig"), f"{path}:", NEEDED, OPTIONAL, others=True)
    plant = _plant(path, found["plant"], found["channels"], found.get(kinds.TRUST))
    if "step_s" in found:
        plant = replace(plant, step=found["step_s"])
    return of(plant, found, folder, str(path))


def of(plant: Plant, found: Mapping, folder: Path, source: str, given: Mapping[str, Recording] | None = None) -> Rig:
    """The rig of a plant and of what rig.toml says besides. given: as `Rig.given`.

    Raises InputError naming `source` and the entry.
    """
    for check in (_wrong_times, _wrong_parameters, _wrong_channels, _wrong_predictions, _wrong_recordings):
        for where, problem in check(found, plant):
            raise InputError(f"{source}: {where}: {problem}")
    dt, window = found["sample_time_s"], found.get("window_s")
    tolerance, absolute = (found.get(key, {}) for key in UNSURE)
    own = {symbol: plant.parameters[symbol].value for symbol in (plant.outside.parameters if plant.outside else ())}
    datasheet = own | found["parameters"]
    switched = {on: 1.0 for on, by in plant.switches.items() if datasheet.get(by)}
    parameters = {}
    for symbol, p in plant.parameters.items():
        value = switched.get(symbol, datasheet.get(symbol, p.value))
        parameters[symbol] = Parameter(value, p.unit, tolerance.get(symbol, 0.0), p.meaning, absolute.get(symbol, 0.0))
    rig = Rig(
        replace(plant, parameters=parameters),
        datasheet,
        {name: _channel(entry) for name, entry in found["channels"].items()},
        tuple(found["predict"]),
        dt,
        None if window is None else round(window / dt),
        folder,
        round(found.get("settle_s", 0.0) / dt),
        tuple(found.get("anew", ())),
        tuple(found.get("identify", (IDENTIFY,))),
        tuple(found.get("holdout", (HOLDOUT,))),
        {name: Own(**entry) for name, entry in found.get("recordings", {}).items()},
        given or {},
    )
    return rig if rig.stated or rig.window is None else _heard(rig)


def _heard(rig: Rig) -> Rig:
    """The rig with the noise that identify.csv shows, for every predicted channel whose noise rig.toml does not state.

    A simulation in windows needs it: it says how well the state is known from which a window begins.
    """
    recording, channels = rig.to_explain(), dict(rig.channels)
    for name in rig.predict:
        if not channels[name].sigma:
            sizes = [(noise(run[name]), run.samples) for run in recording.runs]
            size = sizes[0][0] if len(sizes) == 1 else np.sqrt(sum(s**2 * n for s, n in sizes) / recording.samples)
            channels[name] = replace(channels[name], noise=float(size), heard=True)
    return replace(rig, channels=channels)


def _channel(entry: Mapping) -> Channel:
    resolution, noise_rms = (entry.get(key, 0.0) for key in ("resolution", "noise_rms"))
    return Channel(entry["unit"], entry["role"], resolution, noise_rms, entry.get("hold", STEP))


Mistakes = Iterator[tuple[str, str]]
"""Pairs of an entry of rig.toml and what is wrong with it; a check may rely on what the checks before it passed."""


def _wrong_times(found: Mapping, plant: Plant) -> Mistakes:
    dt, window = found["sample_time_s"], found.get("window_s")
    if plant.states and not dt <= MOST * plant.step:
        yield "sample_time_s", f"{dt:g} s, {plant.name} takes steps of {plant.step:g} s; take {MOST} a sample at most"
    if "step_s" in found and plant.outside and plant.outside.fixed:
        yield "step_s", f"{plant.name} takes no other steps than its own; remove it"
    if window is not None and window < FEWEST * dt:
        yield "window_s", f"{window:g}; give at least {FEWEST} samples, in s"


def _wrong_parameters(found: Mapping, plant: Plant) -> Mistakes:
    datasheet = found["parameters"]
    for symbol in datasheet:
        if symbol not in plant.parameters:
            yield f"parameters.{symbol}", f"{plant.name} has {', '.join(plant.parameters)}"
    if missing := [s for s in plant.required if s not in datasheet]:
        them = "it" if len(missing) == 1 else "them"
        yield "parameters", f"{', '.join(missing)} missing; {plant.name} needs {them}"
    known = plant.parameters if plant.outside else datasheet  # a model has the values itself
    yield from _wrong_uncertainties(found, known, "", "its value")
    for symbol in found.get("anew", ()):
        if symbol not in datasheet:
            yield "anew", f"{shown(symbol)} is no entry of [parameters]; give its value there"


def _wrong_uncertainties(found: Mapping, known: Mapping, where: str, what: str) -> Mistakes:
    for key in UNSURE:
        for symbol in found.get(key, {}):
            if symbol not in known:
                yield f"{where}{key}.{symbol}", UNKNOWN.format(what)
    for symbol in found.get("plus_minus", {}):
        if symbol in found.get("tolerance", {}):
            yield f"{where}plus_minus.{symbol}", "has a tolerance, too; give one of both"


def _wrong_channels(found: Mapping, plant: Plant) -> Mistakes:
    channels = found["channels"]
    for name, entry in channels.items():
        unit, role = entry["unit"], entry["role"]
        known = plant.inputs.get(name) if role == "input" else _unit(plant, name)
        if known is None:
            there = [n for n in plant.inputs if n not in plant.derived] if role == "input" else plant.outputs
            yield f"channels.{name}", f"{plant.name} has no {role} of that name; it has {', '.join(there)}"
        if "hold" in entry and role != "input":
            yield f"channels.{name}.hold", "is of an input; drop it here"
        if unit != known:
            yield f"channels.{name}", f"unit {shown(unit)}, {plant.name} has it in {known}; convert it"
    for name in plant.inputs:
        if name not in channels and name not in plant.derived and name != "t":
            yield f"channels.{name}", f"is missing; it is an input of {plant.name}"
    for name, how in plant.derived.items():
        if (source := how.partition(" ")[2]) not in channels:
            yield f"channels.{source}", f"is missing; {plant.name} derives {name} from it"


def _wrong_predictions(found: Mapping, plant: Plant) -> Mistakes:
    predict, channels = found["predict"], found["channels"]
    if not predict or len(set(predict)) < len(predict):
        yield "predict", f"{shown(predict)}; list the channels that a simulation predicts, each once"
    for name in predict:
        if name not in channels or channels[name]["role"] != "output":
            yield "predict", f"{shown(name)} is no output channel"


def _wrong_recordings(found: Mapping, plant: Plant) -> Mistakes:
    files = {run_name(IDENTIFY), run_name(HOLDOUT)}
    for key in ("identify", "holdout"):
        given = [run_name(file) for file in found.get(key, ())]
        if key in found and len(set(given)) < max(len(given), 1):
            yield key, f"{shown(given)}; list the files of the recordings, each name once"
        files |= set(given)
    for name, own in found.get("recordings", {}).items():
        if name not in files:
            yield f"recordings.{name}", f"is no recording; identify and holdout list {', '.join(sorted(files))}"
        for symbol in own.get("parameters", {}):
            if symbol not in found["parameters"]:
                yield f"recordings.{name}.parameters.{symbol}", UNKNOWN.format("its usual value")
        yield from _wrong_uncertainties(own, found["parameters"], f"recordings.{name}.", "its usual value")


def _unit(plant: Plant, name: str) -> str | None:
    try:
        return plant.unit(name)
    except KeyError:
        return None


def trusting(folder: Path | str) -> None:
    """Let the program that computes a rig's plant run, from now on, for this user, if it is the one that it means."""
    path = Path(folder) / "rig.toml"
    found = read_toml(path, "give the folder of a rig")
    plant = _plant_file(path, line(found.get("plant"), f"{path}: plant"))
    _check_trust(path, plant, found.get(kinds.TRUST))
    kinds.trust(plant)


def _plant(rig: Path, name: str, channels: Mapping[str, Mapping], trusted: str | None) -> Plant:
    path = _plant_file(rig, name)
    _check_trust(rig, path, trusted)
    plant = kinds.read(path, {name: entry["unit"] for name, entry in channels.items()})
    declared(plant)
    return plant


def _plant_file(rig: Path, name: str) -> Path:
    own = rig.parent / check_file_name(name, f"{rig}: plant")
    known = {path.stem: path for path in sorted(PLANTS.glob("*/*.toml"))}
    path = own if own.suffix in (".toml", *kinds.KINDS) else known.get(name, own)
    if not path.exists():
        given = ", ".join(known)
        raise InputError(f"{rig}: plant {shown(name)} is unknown; give {given}, or a plant file beside rig.toml")
    return path


def _check_trust(rig: Path, path: Path, trusted: str | None) -> None:
    """Raises InputError where the program that computes a plant is not the one that rig.toml means."""
    if (digest := kinds.digest(path)) not in (None, trusted):
        raise InputError(f"{rig}: {kinds.TRUST}: {path} is another program than it says; if you trust that too, write "
                         f'{kinds.TRUST} = "{digest}" there, and give --trust')  # fmt: skip
