"""Sample times: when two of them are one, and what is said to who brings a recording of another one."""

import shlex
from pathlib import Path
from typing import Protocol

from greygate.errors import InputError

SAME = 1e-3  # relative: a printed time errs by up to as much of a step (plants/readers/columns.py)


class Sampled(Protocol):
    """What is read here of a `models.network.Network`, whose file stands above this one."""

    name: str

    def sample_time(self) -> float | None: ...


def same(one: float, other: float) -> bool:
    """Whether two sample times [s] are one, but for the rounding of printed times."""
    return abs(one - other) <= SAME * min(one, other)


def spoken(dt: float) -> str:
    """`10 ms` of 0.01."""
    factor, unit = next(((f, u) for f, u in ((1.0, "s"), (1e3, "ms")) if f * dt >= 1), (1e6, "us"))
    return f"{factor * dt:g} {unit}"


def resampling(path: Path | str, dt: float) -> str:
    """What to do with a file to have it sampled every dt seconds."""
    stem = Path(path).name.removesuffix(".gz").rpartition(".")[0] or Path(path).name
    out = shlex.quote(f"{stem}_{spoken(dt).replace(' ', '')}.csv")
    return f"resample it: greygate look {shlex.quote(str(path))} --resample {dt!r} --out {out}"


def check(network: Sampled, dt: float, what: str, do: str) -> None:
    """Raise InputError where `what` is sampled every dt seconds, and the network was made for another time."""
    made = network.sample_time()
    if made is not None and not same(dt, made):
        told = f"sample time {spoken(dt)}, the network {network.name} was made for {spoken(made)}"
        raise InputError(f"{what}: {told}; {do}")


def check_file(network: Sampled, dt: float, path: Path | str) -> None:
    """The same for a file, with the command that resamples it."""
    made = network.sample_time()
    if made is not None:
        check(network, dt, Path(path).name, resampling(path, made))
