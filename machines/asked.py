"""A machine to be controlled, from files: a plant, a rig or a network, and the reference that it is to track."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from greygate.control.modelled import Model, OfNetwork, OfPlant
from greygate.control.own import Machine
from greygate.control.predictive import Limits
from greygate.errors import InputError
from greygate.mismatch.noise import roughness
from greygate.mismatch.rig import load
from greygate.models.network import Network, Port
from greygate.plants import kinds
from greygate.plants.excitation import prms
from greygate.plants.plant import Plant
from greygate.plants.readers.read import read_channels, read_recording
from greygate.plants.recording import Recording
from greygate.reading import read_toml

PROBED, HELD = 200, (5, 20)  # samples of a run, and of an input held in it, that choose the steps of integration
DEVIATIONS = 2  # a tolerance is two standard deviations


@dataclass(frozen=True)
class Wishes:
    """limits: signal -> (low, high). rates: input -> its largest change in a second. noise: output -> standard
    deviation. noisy: a recording whose roughness says the noise of the others. network: that predicts, "" for the
    plant itself."""

    limits: Mapping[str, tuple[float, float]]
    rates: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    noisy: Path | None = None
    network: Path | None = None


def is_machine(name: str) -> bool:
    """Whether it names a file or a folder, not an entry of the catalogue."""
    return Path(name).suffix in {".toml", ".safetensors", *kinds.KINDS} or Path(name).is_dir()


def asked(where: Path, track: Path, wishes: Wishes) -> Machine:
    """The machine of a file or a rig's folder. Raises InputError as `of`, and for what cannot be read."""
    return of(where, *_read(where, columns_of(track)), track, wishes)


def columns_of(track: Path) -> dict[str, str]:
    """Column of a reference -> its unit. Raises InputError for what cannot be read."""
    return {c.name: c.unit for c in read_channels(track, unitless="1")}


def of(where: Path, what: Plant | Network, noise: Mapping[str, float], track: Path, wishes: Wishes) -> Machine:
    """What stands in the file `where`, as a machine. noise: of its sensors, as a rig tells it.

    Raises InputError naming what does not fit: names, units, empty limits, a reference that does not move.
    """
    columns, units = columns_of(track), _units(what)
    if missing := sorted(columns.keys() - units.keys()):
        raise InputError(f"{track}: column {missing[0]} is no signal of {where}; it has {', '.join(units)}")
    reference = read_recording(track, {n: units[n] for n in columns})
    inputs, outputs = _inputs(what), _outputs(what)
    drives = [n for n in inputs if n in wishes.limits]
    tracked = [n for n in columns if n in outputs]
    _check(where, track, wishes, units, drives, columns, tracked)
    if stray := [n for n in columns if n not in inputs and n not in outputs]:
        raise InputError(f"{track}: column {stray[0]} is no output of {where}, and cannot be tracked; leave it out")
    _check_derived(where, what, {*drives, *columns})
    predicts = what if wishes.network is None else _network(wishes.network, drives, units)
    measured = [n for n in outputs if n in _outputs(predicts)] if wishes.network else list(outputs)
    names = [*dict.fromkeys([*tracked, *measured]), *(n for n in wishes.limits if n not in (*inputs, *outputs))]
    names += [n for n in wishes.limits if n in outputs and n not in names]
    limits = _limits(wishes, drives, reference.dt)
    acting = {n: reference[n] for n in columns if n in inputs}
    seen = rough(read_recording(wishes.noisy), measured) if wishes.noisy else {}
    noisy = {**noise, **seen, **wishes.noise}
    sensors = {n: noisy.get(n, 0.0) for n in names if n in measured}

    def truth(seed: int | None) -> Model:
        return _model(what if seed is None else _drawn(what, seed), drives, names, reference.dt)

    model = _model(predicts, drives, names, reference.dt)
    if isinstance(model, OfPlant):
        model = model.faster(*_probed(model, limits))
    ports = [_drive(n, units[n], *wishes.limits[n]) for n in drives]
    signals = [Port(n, units[n]) for n in names]
    wanted = np.stack([reference[n] for n in tracked], axis=1)
    if still := [n for n in tracked if np.ptp(reference[n]) == 0]:
        raise InputError(
            f"{track}: {still[0]} does not move; begin where the machine rests, so that errors have a size"
        )
    return Machine(where.stem or where.resolve().name, reference.dt, truth, model, ports, signals, sensors, tracked,
                   limits, wanted, acting)  # fmt: skip


def _read(where: Path, columns: Mapping[str, str]) -> tuple[Plant | Network, dict[str, float]]:
    """What is controlled, and the noise that its rig tells."""
    if where.is_dir() or where.name == "rig.toml":
        rig = load(where if where.is_dir() else where.parent)
        noise = {n: c.sigma for n, c in rig.channels.items()}
        return rig.plant, noise
    if where.suffix == ".safetensors" or (where.suffix == ".toml" and "modules" in read_toml(where, "give a plant")):
        return Network.load(where.with_suffix(".toml")), {}
    return kinds.read(where, columns), {}


def _inputs(what: Plant | Network) -> list[str]:
    return [*what.inputs] if isinstance(what, Plant) else [p.name for p in what.inputs]


def _outputs(what: Plant | Network) -> list[str]:
    return [*what.outputs] if isinstance(what, Plant) else [p.name for p in what.outputs]


def _units(what: Plant | Network) -> dict[str, str]:
    if isinstance(what, Network):
        return {p.name: p.unit for p in (*what.inputs, *what.outputs)}
    names = (*what.inputs, *what.states, *(d.symbol for d in what.definitions.values()))
    return {n: what.unit(n) for n in names}


def _check(
    where: Path, track: Path, wishes: Wishes, units: Mapping[str, str], drives: Sequence[str],
    columns: Mapping[str, str], tracked: Sequence[str],
) -> None:  # fmt: skip
    for option, names in (("limits", wishes.limits), ("rate", wishes.rates), ("noise", wishes.noise)):
        if unknown := [n for n in names if n not in units]:
            raise InputError(f"--{option} {unknown[0]}: {where} has no such signal; it has {', '.join(units)}")
    if not drives:
        raise InputError(f"{where}: no input has limits; give --limits NAME=LOW:HIGH of each that is controlled")
    if wild := [n for n in drives if not np.isfinite(wishes.limits[n]).all()]:
        raise InputError(f"--limits {wild[0]}: an input needs both limits, as finite numbers")
    if stray := [n for n in wishes.rates if n not in drives]:
        raise InputError(f"--rate {stray[0]}: is no input with limits; those are {', '.join(drives)}")
    if both := [n for n in drives if n in columns]:
        raise InputError(f"{track}: column {both[0]} is controlled, and cannot be given; leave one out")
    if not tracked:
        raise InputError(f"{track}: no column is an output of {where}; name one to track")


def _check_derived(where: Path, what: Plant | Network, moved: Collection[str]) -> None:
    """Raise InputError where an input that is derived from another would stand still while that one moves."""
    for name, how in what.derived.items() if isinstance(what, Plant) else ():
        source = how.split()[-1]
        if name not in moved and (source in moved or source not in what.inputs):
            raise InputError(f"{where}: {name} is the {how}, which nothing computes under control; write {source} as a "
                             "state whose rate is an input")  # fmt: skip


def _limits(wishes: Wishes, drives: Sequence[str], period: float) -> Limits:
    for name, (low, high) in wishes.limits.items():
        if not low < high:
            raise InputError(f"--limits {name}={low:g}:{high:g}: is empty; give a lower limit below the upper one")
    low, high = np.array([wishes.limits[n] for n in drives]).T
    rate = np.array([wishes.rates.get(n, np.inf) * period for n in drives])
    return Limits(low, high, rate, np.zeros(len(drives)), {n: v for n, v in wishes.limits.items() if n not in drives})


def _drive(name: str, unit: str, low: float, high: float) -> Port:
    return Port(name, unit, (high - low) / 2, (low + high) / 2, initial=float(np.clip(0.0, low, high)))


def _network(path: Path, drives: Sequence[str], units: Mapping[str, str]) -> Network:
    network = Network.load(path.with_suffix(".toml"))
    for port in (*network.inputs, *network.outputs):
        if port.name not in units:
            raise InputError(f"{path}: {port.name} is no signal of the machine; it has {', '.join(units)}")
        if port.unit != units[port.name]:
            raise InputError(f"{path}: {port.name} is in {port.unit}, in the machine in {units[port.name]}")
    if unread := [n for n in drives if n not in {p.name for p in network.inputs}]:
        raise InputError(f"{path}: does not read {unread[0]}, which is controlled")
    return network


def _model(what: Plant | Network, drives: Sequence[str], names: Sequence[str], period: float) -> OfPlant | OfNetwork:
    if isinstance(what, Plant):
        return OfPlant(what, drives, names, period)
    return OfNetwork(what, drives, names, period)


def _drawn(what: Plant | Network, seed: int) -> Plant | Network:
    """The plant of a day: its parameters drawn within what is told of them."""
    if isinstance(what, Network):
        return what
    rng = np.random.default_rng(seed)
    off = np.clip(rng.normal(size=len(what.parameters)), -DEVIATIONS, DEVIATIONS) / DEVIATIONS
    return what.with_parameters(
        **{n: p.value + p.reach * e for (n, p), e in zip(what.parameters.items(), off, strict=True)}
    )


def rough(found: Recording, names: Sequence[str]) -> dict[str, float]:
    """Standard deviation of the noise of the channels of a recording, by how rough they are."""
    tiny = {n: float(np.ptp(found[n])) * 1e-9 or 1.0 for n in names if n in found.channels}
    return {n: size * roughness(found[n], size) for n, size in tiny.items()}


def _probed(model: OfPlant, limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """States and inputs of a run whose inputs jump within their limits, up to where it is finite."""
    ends = enumerate(zip(limits.low, limits.high, strict=True))
    inputs = np.stack([prms(PROBED, float(low), float(high), HELD, i) for i, (low, high) in ends], axis=1)
    states = [model.start]
    for given in inputs[:-1]:
        after = model.roll(states[-1][None], given[None, None])[0][0]
        if not np.isfinite(after).all():
            break
        states.append(after)
    return np.array(states), inputs[: len(states)]
