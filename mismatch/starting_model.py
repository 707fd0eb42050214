"""A rig folder to start from a model of somebody else's and a log, as `greygate init-rig --model` writes it."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from greygate.errors import InputError, shown
from greygate.files import replacing_folder
from greygate.mismatch.model import TIMING, Model
from greygate.mismatch.rig import FEWEST, HOLDOUT, IDENTIFY, SHORTEST, Channel, Rig, load
from greygate.mismatch.runs import bent
from greygate.mismatch.scales import memory, noise
from greygate.mismatch.starting import KEPT, RigStart, listed, write
from greygate.names import check_name
from greygate.plants import kinds
from greygate.plants.kinds import of_file
from greygate.plants.plant import Plant
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import Recording
from greygate.progress import once

TOLERANCES = {  # beginning of a parameter's name -> how uncertain it is in the field, where nobody measured it
    "damping": 0.5,  # made up in most models
    "frictionloss": 0.5,
    "armature": 0.3,  # a rotor's inertia times the square of the gear ratio, seldom in a data sheet
    "stiffness": 0.2,
    "gain": 0.1,  # a motor constant
    "kp": 0.1,
    "kv": 0.2,
    "mass": 0.05,  # of CAD, without cables and screws
    "inertia": 0.2,
    "ipos": 0.1,
}
TOLD = 2.0  # times as well as by its tolerance, that a log must tell a parameter, or it is not released
OWN = 0.02  # of what a parameter changes, that no other must change: differences over steps are no better
STEP = 0.1  # of a tolerance, by which a parameter is moved to see what it changes
SHARED = 0.1  # of another parameter's tolerance, above which moving that does the same is said
MEMORIES = 2  # of the fastest position, that a window lasts: long enough to see friction, too short to diverge
HALVED = 3  # times, that a step is halved at most
BEGUN = 0.5  # of that memory, from which a free run over what is held out takes where it begins
SHORT = 50  # samples of a window, at least: a fifth of them smooths its first velocity
STEPS = 10  # of integration in a sample, at least: effects may be quicker than the model
LOST = 0.5  # of a channel's spread, by which a free run may be off
WINDOWS = 10  # at least, where the recording is long enough


@dataclass(frozen=True)
class _Log:
    """Columns of a log by the symbols of a plant."""

    recording: Recording
    columns: Mapping[str, str]  # symbol -> column
    plant: Plant

    @property
    def inputs(self) -> list[str]:
        return [name for name in self.plant.inputs if name in self.columns]

    @property
    def outputs(self) -> list[str]:
        """Positions, and the velocities of those whose position is not there; outputs that a simulator shows."""
        found = [s for s, state in self.plant.states.items() if s in self.columns and state.rate]
        seen = {self.plant.states[s].rate for s in found}
        return found + [s for s in self.plant.states if s in self.columns and s not in (*found, *seen)]


def init_rig(path: Path, record: str, model: Path, mapped: Mapping[str, str], trust: bool = False) -> RigStart:
    """Write the folder of a rig whose plant a model computes; what was written, and the next command.

    mapped: symbol of the plant -> column of the log, where their names differ. trust: whether the model may run, if it
    is a program. Raises InputError for a model that does
    not load, a log without its inputs or without a position, and a folder that is there; nothing is written then.
    """
    check_name(path.name, "--out")
    if path.exists():
        raise InputError(f"{path}: is there already; choose another --out, or remove it")
    recording = read_recording(record, bare=True, told=once)
    if trust:
        kinds.trust(model)
    log = _matched(recording, model, mapped)
    split = int(KEPT * recording.samples)
    outside = log.plant.outside
    anew = outside is None or not (outside.timed or outside.whole)  # whether what is held out may begin a run
    held = anew and recording.samples - split >= 2 * FEWEST and split >= SHORTEST
    names = [*log.inputs, *log.outputs]
    units = {name: log.plant.unit(name) for name in names}
    kept = Recording(recording.dt, {n: recording[log.columns[n]] for n in names}, units, source=record)
    with replacing_folder(path, "init-rig") as new:
        for file, content in of_file(model).bundle(model).items():
            (new / file).parent.mkdir(parents=True, exist_ok=True)
            (new / file).write_bytes(content)
        write(kept, names, slice(0, split if held else None), new / IDENTIFY)
        if held:
            write(kept, names, slice(split, None), new / HOLDOUT)
        sheet = _Sheet(log, kept, new / model.name, held, _step(log.plant, kept.dt))
        sheet.write(new)
        rig = load(new)
        recording = rig.to_explain()
        rig = replace(rig, channels=_heard(rig, recording), window=_window(log, rig, recording))
        if outside and outside.steps and not outside.fixed:
            rig = replace(rig, plant=replace(rig.plant, step=_finer(rig, recording)))
            sheet = replace(sheet, step=rig.plant.step if rig.plant.step < log.plant.step else None)
        replace(sheet, window=rig.window, untold=_untold(Model(rig, recording, {}))).write(new)
    written = ["rig.toml", model.name, IDENTIFY, *([HOLDOUT] if held else [])]
    return {"written": [str(path / n) for n in written], "next": f"greygate diagnose {path}"}


def _matched(recording: Recording, model: Path, mapped: Mapping[str, str]) -> _Log:
    """The log's columns by the plant's symbols. Raises InputError where inputs or all positions are missing."""
    channels = {**recording.channels, **dict.fromkeys(_numbered(recording), None)}
    for symbol, column in mapped.items():
        if column not in channels:
            raise InputError(f"--map {symbol}={column}: {recording.source} has no column {column}; it has "
                             f"{', '.join(channels)}")  # fmt: skip
    columns = {name: name for name in channels if name not in mapped.values()} | dict(mapped)
    columns = {symbol: _numbered(recording).get(column, column) for symbol, column in columns.items()}
    plant = of_file(model).read(model, {symbol: recording.units[column] for symbol, column in columns.items()})
    known = [*plant.inputs, *plant.states]
    for symbol in mapped:
        if symbol not in known:
            raise InputError(f"--map {symbol}: {plant.name} has no such name; it has {', '.join(known)}")
    log = _Log(recording, {name: column for name, column in columns.items() if name in known}, plant)
    if missing := [name for name in plant.inputs if name not in log.columns]:
        forces = ", ".join(of_file(model).forces(plant))
        other = f", or columns {forces} in place of controls" if forces else ""
        raise InputError(
            f"{recording.source}: no column for {', '.join(missing)}; give --map {missing[0]}=COLUMN{other}"
        )
    if not log.outputs:
        states = ", ".join(s for s in plant.states if s not in plant.inputs)
        raise InputError(f"{recording.source}: no column is a state of {plant.name}; give --map for one of {states}")
    for name, column in log.columns.items():
        if (unit := recording.units[column]) not in ("1", plant.unit(name)):
            raise InputError(f"{recording.source}: {column} is in {shown(unit)}, {plant.name} has {name} in "
                             f"{plant.unit(name)}; convert it, or map another column")  # fmt: skip
    return log


def _numbered(recording: Recording) -> dict[str, str]:
    """joint_1 -> joint: a header in which the reader takes the number for the unit of a plain number."""
    return {f"{name}_1": name for name, unit in recording.units.items() if unit == "1" and name in recording.channels}


def _window(log: _Log, rig: Rig, recording: Recording) -> int | None:
    """Samples between restarts, where a free run loses the recording and all positions are recorded; else None."""
    moving = [s for s in log.plant.states if s not in log.plant.shown]
    positions = [s for s in moving if log.plant.states[s].rate] or moving
    if log.plant.whole or any(s not in log.columns for s in positions):
        return None
    model = Model(rig, recording, {})
    off = np.sqrt(np.mean((model.predict(model.values) - model.target) ** 2, axis=0))
    if (off < LOST * np.std(model.target, axis=0)).all():
        return None
    wanted = max(round(MEMORIES * _shortest([recording[s] for s in positions])), SHORT)
    return max(min(wanted, recording.samples // WINDOWS), FEWEST)


def _finer(rig: Rig, recording: Recording) -> float:
    """The plant's step, or the first of its halves, fourths, eighths that errs by less than the noise.

    A step errs by what half of it changes, but for what a diagnosis allows for: inputs that act early by half a step,
    and where a window begins. A log that the plant follows more closely than that was made in such steps.
    """
    first = rig.dt / max(round(rig.dt / rig.plant.step), 1)
    before = own = np.empty(0)
    sigma = np.array([rig.channels[n].sigma for n in rig.predict])
    for halved in range(HALVED + 1):
        model = Model(replace(rig, plant=replace(rig.plant, step=first / 2**halved)), recording, {})
        now = model.predict(model.values | dict.fromkeys({TIMING} & model.values.keys(), model.early_by))
        off = bent(now - before, rig.window) if halved else np.inf
        if np.all(off <= sigma):
            return first / 2 ** (halved - 1) if halved > 1 else rig.plant.step
        if halved == 1 and np.all(bent(model.target - own, rig.window) < off):
            return rig.plant.step
        own = own if halved else model.predict(model.values)
        before = now
    return first / 2**HALVED


def _shortest(signals: Sequence[np.ndarray]) -> float:
    """Samples after which the fastest of the signals has forgotten where it was; 0 where none moves."""
    found = min(map(memory, signals))
    return found if np.isfinite(found) else 0.0


def _heard(rig: Rig, recording: Recording) -> dict[str, Channel]:
    """The rig's channels with the noise that the recording shows."""
    return {n: replace(c, noise=float(noise(recording[n]))) for n, c in rig.channels.items()}


def _untold(model: Model) -> dict[str, str]:
    """Parameters with a tolerance that this recording cannot tell -> in words, what does the same there.

    One after the other is taken by what it changes that those before it do not, the largest first.
    """
    plant, rig = model.plant, model.rig
    sheet = {s: p for s, p in plant.parameters.items() if p.tolerance}
    sigma = np.array([rig.channels[n].sigma for n in rig.predict])
    columns = {}
    for symbol, p in sheet.items():  # by central differences: a curve of the model would tell any two apart
        ends = (p.value * (1 + sign * STEP * p.tolerance) for sign in (1, -1))
        high, low = (model.predict({**model.values, symbol: value}) for value in ends)
        columns[symbol] = (np.nan_to_num(high - low) / sigma / STEP / 2).ravel()
    left, taken = dict(columns), []
    size = {s: float(np.linalg.norm(c)) for s, c in columns.items()}
    while left:
        best = max(left, key=lambda s: float(np.linalg.norm(left[s])))
        rest = float(np.linalg.norm(left[best]))
        if rest <= max(TOLD, OWN * size[best]):
            break
        axis = left.pop(best) / rest
        taken.append(best)
        left = {s: c - axis * (axis @ c) for s, c in left.items()}
    return {s: _same(columns[s], {t: columns[t] for t in taken}) for s in left}


def _same(column: np.ndarray, taken: Mapping[str, np.ndarray]) -> str:
    """What of the released parameters does what this one does, in words."""
    if np.linalg.norm(column) <= TOLD or not taken:
        return "nothing moves with it"
    shares = np.linalg.lstsq(np.stack([*taken.values()], axis=1), column)[0]
    found = [symbol for symbol, share in zip(taken, shares, strict=True) if abs(share) > SHARED]
    return f"no motion of this log tells it from {', '.join(found) or 'the noise'}"


def _step(plant: Plant, dt: float) -> float | None:
    """s of an integration step, for equations that effects are added to; None where the model has its own."""
    if plant.outside is None or plant.outside.steps:
        return None
    return dt / max(math.ceil(dt / plant.step), STEPS)


@dataclass(frozen=True)
class _Sheet:
    """What rig.toml says. step: s, where it says that. window: samples. untold: parameter -> why it is not fitted."""

    log: _Log
    kept: Recording
    model: Path
    held: bool
    step: float | None
    window: int | None = None
    untold: Mapping[str, str] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        (folder / "rig.toml").write_text(
            "\n".join([*self._head(), *self._channels()]) + "\n", encoding="utf-8", newline="\n"
        )

    def _head(self) -> list[str]:
        dt, window = self.kept.dt, self.window
        begun = max(FEWEST, round(BEGUN * _shortest([self.kept[name] for name in self.log.outputs])))
        held = self.kept.samples - round(KEPT * self.kept.samples)
        settle = min(begun, held // WINDOWS) if not window and self.held else 0
        digest = kinds.digest(self.model)
        program = [f'{kinds.TRUST} = "{digest}"  # SHA-256 of {self.model.name}'] if digest else []
        return [
            "# What is known of the machine; docs/diagnosis.md describes every entry.",
            f'plant = "{self.model.name}"',
            *program,
            f"sample_time_s = {dt!r}",
            *([f"step_s = {self.step!r}  # of the integrator"] if self.step else []),
            *([f"window_s = {window * dt:.6g}  # after which a simulation begins anew as recorded"] if window else []),
            *([f"settle_s = {settle * dt:.6g}  # of {HOLDOUT}: they only give its initial state"] if settle else []),
            f"predict = {listed(self.log.outputs)}  # what a simulation predicts",
            "",
            "[parameters]  # in place of the model's own",
            "",
            "[tolerance]  # relative, of the model's values; a parameter that is not here is known",
            *_tolerances(self.log.plant, self.untold),
        ]

    def _channels(self) -> Iterator[str]:
        for name in self.kept.channels:
            role = "input" if name in self.log.inputs else "output"
            yield from ("", f"[channels.{name}]", f'unit = "{self.kept.units[name]}"', f'role = "{role}"')
            if role == "output":
                size = float(noise(self.kept[name]))
                yield f"# noise_rms = {size:.2g}  # state it if you know it of the sensor; the recording shows that"


def _tolerances(plant: Plant, untold: Mapping[str, str]) -> Sequence[str]:
    known = {s: p.tolerance or TOLERANCES.get(s.partition("_")[0]) for s, p in plant.parameters.items()}
    given = {s: (plant.parameters[s].value, share) for s, share in known.items() if share and plant.parameters[s].value}
    lines = {s: f"{s} = {share:.3g}  # of {v:.6g} {plant.unit(s)}" for s, (v, share) in given.items()}
    return [f"# {line}: {untold[s]}" if s in untold else line for s, line in lines.items()]
