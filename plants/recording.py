"""A recording: named channels with units, sampled uniformly, and its CSV form."""

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.files import replacing
from greygate.plants.table import LARGEST, CsvTable, read_table

UNITS = {
    "s": "s", "m": "m", "m_s": "m/s", "m_s2": "m/s^2", "m3_s": "m^3/s", "rad": "rad", "rad_s": "rad/s",
    "rev_s": "rev/s", "N": "N", "Nm": "N m", "Pa": "Pa", "bar": "bar", "V": "V", "A": "A", "K": "K",
    "counts": "count", "raw": "count", "ticks_per_s": "tick/s", "W": "W", "J": "J", "kg": "kg", "Hz": "Hz",
    "m2": "m^2", "m3": "m^3", "rad_s2": "rad/s^2", "kg_s": "kg/s", "1": "1",
}  # fmt: skip
"""Unit suffix of a CSV column name -> unit."""

NEWTONS = ("N", "kN", "mN")  # before a length or a time they may be a factor of the unit, or end a name
MOST_PARTS = 4  # of a suffix, between its `_`
_SUFFIX = {unit: suffix for suffix, unit in reversed(UNITS.items())}
_UNIFORM = 1e-3  # of a sample interval: largest error of a printed time
SMALLEST = 1 / LARGEST  # size of a channel, and of its differences, but 0: so powers of both stay within float64
EPOCH = 1 << 31  # s; a larger time counts ms, us or ns from a common epoch, not from the start of a recording
FEWEST = 2  # samples, from which a sample time follows


@dataclass(frozen=True)
class Recording:
    """Channels `name -> float64 (samples,)` with `units` `name -> unit`, one sample every `dt` seconds.

    history: what was done to it, one line for each step (`plants/preparation.py`); a CSV does not keep it.
    Raises InputError when channels differ in length, are empty, hold NaN or inf, or lack a unit.

    >>> recording = Recording(1e-3, record.inputs | record.targets, {"u": "V", "y": "m"})
    >>> recording
    <Recording recording: u [V], y [m]; 500 samples, one every 0.001 s>
    >>> recording.write_csv("lag.csv")
    """

    dt: float
    channels: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    source: str = field(default="recording", compare=False)
    history: tuple[str, ...] = field(default=(), compare=False)

    def __post_init__(self):
        arrays = {name: np.asarray(values, dtype=np.float64) for name, values in self.channels.items()}
        object.__setattr__(self, "channels", arrays)
        if not (np.isfinite(self.dt) and self.dt > 0):
            raise InputError(f"{self.source}: sample time {self.dt} s; give a positive number of seconds")
        if not arrays or len({values.shape for values in arrays.values()}) > 1 or self.samples == 0:
            shapes = {name: values.shape for name, values in arrays.items()}
            raise InputError(f"{self.source}: channel shapes {shapes}; give each the same number of samples, above 0")
        for name, values in arrays.items():
            if name not in self.units:
                raise InputError(f"{self.source}: channel {name} has no unit; name it in units")
            bad = np.flatnonzero(~np.isfinite(values))
            if bad.size:
                raise InputError(
                    f"{self.source}: channel {name}, sample {bad[0]} is {values[bad[0]]}; repair or cut the recording"
                )

    def __repr__(self) -> str:
        channels = ", ".join(f"{name} [{self.units[name]}]" for name in self.channels)
        return f"<Recording {self.source}: {channels}; {self.samples} samples, one every {self.dt:g} s>"

    def __getitem__(self, name: str) -> np.ndarray:
        """The channel `name`, float64 (samples,). Raises InputError, naming the channels, if there is none."""
        if name not in self.channels:
            raise InputError(f"{self.source}: no channel {name}; it has {', '.join(self.channels)}")
        return self.channels[name]

    @property
    def samples(self) -> int:
        return len(next(iter(self.channels.values())))

    @property
    def header(self) -> list[str]:
        """`name_unit` of each channel. Raises InputError for a unit without suffix in `UNITS`."""
        for name in self.channels:
            if (unit := self.units[name]) not in _SUFFIX:
                raise InputError(f"{self.source}: channel {name}: unit {unit} has no suffix; use one of {_known()}")
        return [f"{name}_{_SUFFIX[self.units[name]]}" for name in self.channels]

    @property
    def runs(self) -> tuple["Recording", ...]:
        """The recordings that it is made of, one after the other; here it is one."""
        return (self,)

    @property
    def name(self) -> str:
        """The name of its file, without folder and ending."""
        return run_name(self.source)

    @property
    def time(self) -> np.ndarray:
        """Seconds from the first sample, (samples,)."""
        return np.arange(self.samples) * self.dt

    def write_csv(self, path: Path | str) -> None:
        """Write `t_s` and a column `name_unit` for each channel; `read_csv` reads the same bits.

        Raises InputError for a unit without suffix in `UNITS`, or a folder that cannot be written.
        """
        header = ["t_s", *self.header]
        columns = [[f"{t:.12g}" for t in self.time], *(values.tolist() for values in self.channels.values())]
        with replacing(path) as temporary, temporary.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(zip(*columns, strict=True))


def run_name(path: Path | str) -> str:
    """The name of a recording's file, without folder and ending: run1 of data/run1.csv.gz."""
    return Path(path).name.removesuffix(".gz").removesuffix(".csv")


def read_csv(
    path: Path | str,
    required: Mapping[str, str] | None = None,
    *,
    units: Mapping[str, str] | None = None,
    dt: float | None = None,
    bare: bool = False,
) -> Recording:
    """Read a CSV whose header is `t_s` and `name_unit` columns, such as `v_c_V,x_m,p_a_Pa`.

    required: channel -> unit of those that must be there.
    units: unit of each column whose header has none (`{"be_cmd": "1"}`); it takes precedence over a suffix.
    dt: sample time in s of a file whose first column is an index `k` instead of a time.
    bare: a column without a known unit is a plain number, and a file with dt need not have an index.

    Raises InputError, naming the row as an editor numbers it (the header is 1) and the column.

    >>> read_csv("lag.csv").samples
    500
    """
    table, units = read_table(path), units or {}
    path, header = table.path, table.header
    clock = "k" if dt is not None else "t_s"
    timed = header[0] in (clock, clock.removesuffix("_s"))
    if bare and dt is not None and header[0] in ("t_s", "t"):
        raise InputError(f"{path}: has a time column; leave out the sample time")
    if not timed and not (bare and dt is not None):
        wish = "give dt for an index column k" if header[0] == "k" else f"name the first column {clock}"
        wish += " (--sample-time)" if bare and header[0] == "k" else ", or give --sample-time" if bare else ""
        raise InputError(f"{path}: the first column is {header[0]!r}; {wish}")
    if len(table.cells) < FEWEST:
        raise InputError(f"{path}: the recording holds {len(table.cells)} samples; give at least {FEWEST}")
    columns = header[timed:]
    names, kinds = zip(*(_split(path, column, units, bare) for column in columns), strict=True)
    if (repeated := twice(names)) is not None:
        raise InputError(f"{path}: channel {repeated} appears twice; rename one of its columns")
    for name, unit in (required or {}).items():
        if name not in names:
            raise InputError(f"{path}: column {name}_{_SUFFIX.get(unit, unit)} is missing; it has {', '.join(header)}")
        if (found := kinds[names.index(name)]) != unit:
            raise InputError(f"{path}: column {name} is in {found}; convert it to {unit}")
    if header[0] == "t" and table.values[0, 0] > EPOCH:
        raise InputError(
            f"{path}: time t begins at {table.values[0, 0]:g} and has no unit; write t [ms], t [us], t [ns] or t_s"
        )
    step = _step(table) if timed else 1.0
    if dt is not None and step != 1:
        raise InputError(f"{path}: column k counts in steps of {step:g}; number the samples one by one")
    channels = {name: np.ascontiguousarray(table.values[:, timed + i]) for i, name in enumerate(names)}
    check_sizes(channels, str(path))
    return Recording(step if dt is None else dt, channels, dict(zip(names, kinds, strict=True)), source=str(path))


def check_sizes(channels: Mapping[str, np.ndarray], source: str) -> None:
    """Raise InputError for a channel whose values, or differences, are too large or too small for powers of them."""
    for name, values in channels.items():
        low, high = float(values.min()), float(values.max())
        peak, spread = max(abs(low), abs(high)), high - low
        if peak > LARGEST or any(0 < size < SMALLEST for size in (peak, spread)):
            raise InputError(
                f"{source}: channel {name} goes from {low:.6g} to {high:.6g}, beyond any quantity: sizes "
                f"and differences are read from {SMALLEST:g} to {LARGEST:g}; repair it, or write it in another unit"
            )


def twice(names: Iterable[str]) -> str | None:
    """The first name that appears a second time, None if there is none; in time that grows as the names do."""
    known: set[str] = set()
    for name in names:
        if name in known:
            return name
        known.add(name)
    return None


def _known() -> str:
    return ", ".join(UNITS)


def _split(path: Path, column: str, units: Mapping[str, str], bare: bool = False) -> tuple[str, str]:
    """`v_true_m_s` -> (`v_true`, `m/s`): the longest suffix in UNITS is the unit."""
    if column in units:
        return column, units[column]
    parts = column.split("_")
    for start in range(max(1, len(parts) - MOST_PARTS), len(parts)):
        if (suffix := "_".join(parts[start:])) in UNITS and (name := "_".join(parts[:start])):
            unambiguous(column, name, UNITS[suffix], str(path))
            return name, UNITS[suffix]
    if bare:
        return column, "1"
    problem = f"unit {parts[-1]!r} is unknown" if all(parts) and len(parts) > 1 else "has no name or no unit"
    raise InputError(f"{path}: column {column}: {problem}; end its name in one of _{', _'.join(UNITS)}")


def unambiguous(column: str, name: str, unit: str, where: str) -> None:
    """Refuse `torque_N_m`, which is no `torque_N` in m. Raises InputError."""
    before, _, last = name.rpartition("_")
    if before and last in NEWTONS and unit in ("m", "mm", "cm", "s"):
        written = f"{before} [{last} {unit}], {before} [{last}/{unit}] or {name} [{unit}]"
        raise InputError(f"{where}: column {column}: is it {name} in {unit}, or in {last} {unit}? write {written}")


def _step(table: CsvTable) -> float:
    """The uniform step of the first column."""
    clock = table.values[:, 0]
    steps, step = np.diff(clock), (clock[-1] - clock[0]) / (len(clock) - 1)
    drift = np.abs(clock - clock[0] - step * np.arange(len(clock))) > _UNIFORM * step
    table.require_steps(steps, np.full(len(steps), drift.any()), float(np.median(steps)))
    return float(f"{step:.9g}")
