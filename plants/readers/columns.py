"""From columns to a recording: names and units, the time, uniform or resampled."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from greygate.errors import InputError, shown
from greygate.plants.layout import CLOCKS
from greygate.plants.recording import EPOCH, FEWEST, Recording, check_sizes, twice
from greygate.plants.units.reading import converted, same, split, suffixed

Told = Callable[[str], None]
WHOLE = 1 << 53  # beyond it a float does not tell one integer from the next
DAYS = (2e4, 8e4)  # of a spreadsheet, which counts them from 1900: from 1954 to 2119
SOONEST = 1.2e-5  # of them, a second: as seconds it would be the 80 kHz of a clock that runs for hours
UNKNOWN = "?"  # the unit of a column that is merely looked at
CLOCK_OF = re.compile(r"(t|time|timestamp)_(ms|us|ns|min)", re.I)
UNIFORM = 1e-3  # of a step: the largest error of a printed time
GAP = 1.5  # of a median step: a longer one is a gap
FINER = 1.5  # of a median step: a wanted step that is longer needs a filter first
CUT = 0.4  # of the new sample rate: where that filter cuts
ORDER = 4


@dataclass(frozen=True)
class Column:
    """values (N,) under a header as written. unit: as written, where the file keeps it apart. time: own times, s."""

    header: str
    values: np.ndarray
    unit: str | None = None
    time: np.ndarray | None = None


@dataclass(frozen=True)
class Channel:
    """A column with its name, its unit and its times (N,) in s. given: the unit in the file, if it was another."""

    name: str
    unit: str
    time: np.ndarray
    values: np.ndarray
    given: str | None = None

    @property
    def step(self) -> float:
        """The median step in s."""
        return float(np.median(np.diff(self.time)))

    @property
    def jitter(self) -> float:
        """Largest distance of a sample from the uniform grid through the first and the last, in s."""
        n = len(self.time)
        return float(np.abs(self.time - np.linspace(self.time[0], self.time[-1], n)).max())

    @property
    def gaps(self) -> int:
        """Steps that are longer than `GAP` median steps."""
        return int(np.count_nonzero(np.diff(self.time) > GAP * self.step))


def channels(
    columns: Sequence[Column],
    source: str,
    units: Mapping[str, str] | None = None,
    required: Mapping[str, str] | None = None,
    dt: float | None = None,
    clock: str | None = None,
    unitless: str | None = None,
) -> list[Channel]:
    """Channels in SI or the house's units; in the required ones, where they are required.

    units: name -> unit as written, before what the header says. dt: sample time in s of columns without a time.
    clock: name of the time. unitless: the unit of a column that has none.
    Raises InputError for a header or a unit that cannot be read in one way.
    """
    units, required = dict(units or {}), required or {}
    named = [(column, *_named(column, source, required, units)) for column in columns]
    clocks = [k for k, (c, name, _) in enumerate(named) if c.time is None and _is_clock(name, c.header, clock)]
    if clock is not None and not clocks:
        raise InputError(f"{source}: no column {clock}; it has {', '.join(name for _, name, _ in named)}")
    if len(clocks) > 1:
        names = " and ".join(named[k][0].header for k in clocks)
        raise InputError(f"{source}: {names} may both be the time; rename or drop one of them")
    time = None
    if clocks and dt is not None:
        raise InputError(f"{source}: has a time, {named[clocks[0]][0].header}; leave out the sample time")
    if clocks:
        column, name, unit = named.pop(clocks[0])
        written = units.pop(name, "") or column.unit or unit
        if not written and len(column.values) and abs(column.values[0]) > EPOCH:
            raise InputError(
                f"{source}: time {name} begins at {column.values[0]:g} and has no unit; tell it: --unit {name}=ms, or "
                "us, ns or s"
            )
        if not written and _counts_days(np.asarray(column.values, float)):
            raise InputError(
                f"{source}: time {name} begins at {column.values[0]:g} and seems to count days; tell its unit: "
                f"--unit {name}=d, or s"
            )
        written = written or "s"
        time, _ = converted(_since(column.values), written, f"{source}: time {name}", "s")
    bare = [name for column, name, unit in named if not (units.get(name) or column.unit or unit or unitless)]
    if bare:
        numbers = " ".join(f"--unit {name}=1" for name in bare)
        raise InputError(
            f"{source}: {_listed(bare)} no unit; write {bare[0]} [unit] in its header, or have a file written that has "
            f"it: greygate look {source} --out NEW.csv --unit {bare[0]}=UNIT; of plain numbers: {numbers}"
        )
    found = []
    for column, name, unit in named:
        where, told = f"{source}: column {name}", units.pop(name, "") or column.unit or unit or unitless or ""
        raw = np.asarray(column.values)
        if raw.dtype.kind in "iu" and raw.size and max(-int(raw.min()), int(raw.max())) > WHOLE:
            raise InputError(f"{where}: integers beyond 2^53, which no float tells apart; subtract where they begin")
        values, kind = raw.astype(float), told
        if told != UNKNOWN:
            values, kind = converted(values, told, where, required.get(name))
        own = column.time if column.time is not None else time
        if own is None and dt is not None:
            own = dt * np.arange(len(values))
        if own is None:
            raise InputError(f"{source}: has no time; name a column t, or give the sample time")
        own = np.asarray(own, float)
        if own.shape != values.shape or values.ndim != 1:
            raise InputError(f"{where}: {values.shape} values at {own.shape} times; give one value for each time")
        found.append(Channel(name, kind, *_sorted(own, values, where), told if kind != told else None))
    if units:
        raise InputError(f"{source}: no column {next(iter(units))}, which a unit is given for")
    if (repeated := twice(c.name for c in found)) is not None:
        raise InputError(f"{source}: two columns are called {repeated}; rename one of them")
    if not found:
        raise InputError(f"{source}: holds no channel beside the time")
    return found


def _named(
    column: Column, source: str, required: Mapping[str, str], units: Mapping[str, str]
) -> tuple[str, str | None]:
    """(name, unit or None) that a header gives. Raises InputError if the file tells another unit apart from it.

    required: channel -> unit; a header that is the name of one without a unit has none, `x_1` as little as `x_2`.
    units: channel -> unit that is told; a header that is the name of one has none either, `phi_m` no metres.
    """
    if column.header in units:
        return column.header, None
    if timed := CLOCK_OF.fullmatch(column.header):
        return timed[1], timed[2]
    if required.get(column.header) == "1" and column.unit in (None, "", "1"):
        return column.header, "1"
    name, unit = split(column.header, source)
    if not column.unit or unit is None or same(column.unit, unit):
        return name, unit
    if suffixed(column.header)[1] is None:
        raise InputError(
            f"{source}: column {shown(column.header)} names two units, {unit} and {shown(column.unit)}; write one of "
            "them"
        )
    return split(f"{column.header} [{column.unit}]", source)


def _since(values: np.ndarray) -> np.ndarray:
    """Times as floats; those since an epoch count from the first, since a float has no room for both in seconds."""
    values = np.asarray(values)
    if len(values) and abs(values[0]) > EPOCH:
        values = values - values[0]
        values = values.astype(np.int64) if values.dtype.kind == "u" else values
    return values.astype(float)


def _counts_days(values: np.ndarray) -> bool:
    return len(values) > 1 and DAYS[0] < values[0] < DAYS[1] and 0.0 < float(np.median(np.diff(values))) < SOONEST


def _listed(names: Sequence[str]) -> str:
    return f"columns {', '.join(names)}: have" if len(names) > 1 else f"column {names[0]}: has"


def _is_clock(name: str, header: str, clock: str | None) -> bool:
    if clock is not None:
        return name == clock
    return name == "t" or name.lower() in CLOCKS or header.strip().lower() in CLOCKS


def _sorted(time: np.ndarray, values: np.ndarray, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Both, checked: finite, and forward in time."""
    if len(time) < FEWEST:
        raise InputError(f"{where}: {len(time)} samples; give at least {FEWEST}")
    for what, array in (("time", time), ("value", values)):
        bad = np.flatnonzero(~np.isfinite(array))
        if bad.size:
            raise InputError(f"{where}: sample {bad[0]} has the {what} {array[bad[0]]}; repair or cut the recording")
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        file, (first, then) = where.partition(": column ")[0], time[back[0] : back[0] + 2]
        raise InputError(
            f"{file}: the time does not increase after sample {back[0]} ({first:.9g} s, then {then:.9g} s); "
            "sort it, keep each time once"
        )
    return time, values


def recording(
    found: Sequence[Channel], source: str, resample: float | bool = False, told: Told | None = None
) -> Recording:
    """A recording with one uniform time.

    resample: True for the median step of the fastest channel, or a step in s. told: gets a line for each conversion and
    for what resampling did. Raises InputError for times that are not uniform, or differ, where it is not asked for.
    """
    say = told or (lambda line: None)
    history = [f"{c.name}: {c.given} to {c.unit}" for c in found if c.given is not None]
    first = found[0]
    same = all(len(c.time) == len(first.time) and bool((c.time == first.time).all()) for c in found)
    if resample is False:
        if not same:
            other = next(c for c in found if len(c.time) != len(first.time) or (c.time != first.time).any())
            raise InputError(
                f"{source}: {first.name} and {other.name} have different times ({len(first.time)} and "
                f"{len(other.time)} samples); resample them: greygate look FILE --resample auto --out FILE.csv"
            )
        step = (first.time[-1] - first.time[0]) / (len(first.time) - 1)
        if first.jitter > UNIFORM * step:
            raise InputError(
                f"{source}: the time is not uniform: {first.gaps} gaps, jitter up to {first.jitter:.3g} s at steps of "
                f"{first.step:.6g} s; resample it: greygate look FILE --resample auto --out FILE.csv"
            )
        values = {c.name: c.values for c in found}
        dt = float(f"{step:.9g}")
    else:
        dt, values, lines = _resampled(found, source, None if resample is True else float(resample))
        history += lines
    check_sizes(values, source)
    for line in history:
        say(f"{source}: {line}")
    units = {c.name: c.unit for c in found}
    return replace(Recording(dt, values, units, source=source), history=tuple(history))


def _resampled(
    found: Sequence[Channel], source: str, wanted: float | None
) -> tuple[float, dict[str, np.ndarray], list[str]]:
    """(step in s, values on the common grid, what was done)."""
    from scipy.signal import butter, sosfiltfilt

    dt = min(c.step for c in found) if wanted is None else wanted
    begin, end = max(c.time[0] for c in found), min(c.time[-1] for c in found)
    count = int(np.floor((end - begin) / dt * (1 + 1e-12))) + 1 if end > begin and dt > 0 else 0
    if count < FEWEST:
        raise InputError(f"{source}: {count} samples of {dt:g} s are common to all channels; give a smaller step")
    if count > 10**8:
        raise InputError(f"{source}: {count} samples of {dt:g} s; give a larger step")
    grid, values, lines = begin + dt * np.arange(count), {}, []
    for c in found:
        fine, time = c.values, c.time
        if dt > FINER * c.step:
            own = np.linspace(time[0], time[-1], len(time))
            shape = butter(ORDER, 2 * CUT * c.step / dt, output="sos")
            fine, time = sosfiltfilt(shape, np.interp(own, time, fine)), own
        values[c.name] = np.interp(grid, time, fine)
    for times in {len(c.time): c for c in found}.values():
        low = ", low-pass before" if dt > FINER * times.step else ""
        lines.append(
            f"resampled to {dt:.6g} s by straight lines{low}: {times.gaps} gaps, jitter up to {times.jitter:.3g} s, "
            f"median step {times.step:.6g} s"
        )
    return float(f"{dt:.9g}"), values, lines
