"""The sample data of each tutorial, which `greygate demo` writes: nobody has to have the repository."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from greygate.errors import InputError
from greygate.files import making, replacing


@dataclass(frozen=True)
class Demo:
    """means: what it is. then: commands that begin with it. write: puts its files below a folder.

    names: the files that it writes, relative to the folder.
    """

    means: str
    names: tuple[str, ...]
    then: tuple[str, ...]
    write: Callable[[Path], None]


CUTS = {  # file -> (recording of the measured machine, first and last sample): learnt from, chosen by, judged by
    "train.csv": ("mts_15Hz0A", 10_000, 14_000), "other.csv": ("mts_15Hz0A", 20_000, 23_000),
    "test.csv": ("mts_15Hz1A", 10_000, 13_000),
}  # fmt: skip
AXIS = ("axis.toml", "rig.toml", "mine.toml", "identify.csv", "holdout.csv")
CART = ("cart.toml", "train.csv", "test.csv")
PENDULUM = ("pendulum.py", "run.csv")


def write(name: str, out: Path) -> list[Path]:
    """Write a sample below a folder, which is made; return the paths. Raises InputError where a file is there."""
    demo = DEMOS[name]
    paths = [out / n for n in demo.names]
    if there := [p for p in paths if p.exists() or p.is_symlink()]:
        raise InputError(f"{there[0]}: is there already; give another folder with --out")
    with making(out):
        demo.write(out)
    return paths


def _cuts(out: Path) -> None:
    from greygate.plants.recording import Recording, read_csv

    for file, (source, first, last) in CUTS.items():
        whole = read_csv(Path(str(_stored("servohydraulic-mts", f"{source}.csv"))))
        channels = {port: whole[port][first:last] for port in ("x_cmd", "x_meas")}
        Recording(whole.dt, channels, whole.units).write_csv(out / file)


def _copied(folder: str, names: tuple[str, ...], into: str = "") -> Callable[[Path], None]:
    def copy(out: Path) -> None:
        with making(out / into):
            for name in names:
                with replacing(out / into / name) as new:
                    new.write_bytes(_stored(folder, name).read_bytes())

    return copy


def _concealed(out: Path) -> None:
    from greygate.mismatch.concealed.conceal import conceal

    conceal("cable_drum", 3, out / "rig", kind="one", effect="speed_slip")


def _stored(*names: str):
    return files("greygate.recordings").joinpath(*names)


DEMOS = {
    "cart": Demo(
        "a simulated cart whose friction is concealed, with its equations: the whole way", CART,
        ("greygate make cart.toml train.csv test.csv --out cart",), _copied("cart", CART),
    ),
    "network": Demo(
        "a measured test machine, cut for training, choice and test: from a recording to a network", tuple(CUTS),
        ("greygate identify train.csv --input x_cmd --output x_meas --test other.csv --out found",), _cuts,
    ),
    "plant": Demo(
        "a slide with a hose that its equations leave out: a plant of your own", tuple(f"axis/{n}" for n in AXIS),
        ("greygate diagnose axis --effects axis/mine.toml --out diagnosis.json --html page.html",),
        _copied("axis", AXIS, "axis"),
    ),
    "recording": Demo(
        "a rig that conceals one effect: explain a recording", ("rig",),
        ("greygate diagnose rig --out diagnosis.json --html page.html",), _concealed,
    ),
    "simulator": Demo(
        "a pendulum as a function of Python, and a recording that it misses", PENDULUM,
        ("python pendulum.py",), _copied("pendulum", PENDULUM),
    ),
}  # fmt: skip
