"""The guided ways: steps that are commands, with the values that they begin with, and what has been made so far."""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import count
from pathlib import Path
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from greygate.app.things import Thing, inner, object_in, things, verified
from greygate.contents import contents
from greygate.errors import InputError
from greygate.files import replacing, scratch
from greygate.hardware.build import Project
from greygate.mismatch import effects
from greygate.mismatch.accepted import TABLE
from greygate.mismatch.rig import load
from greygate.models.network import Network
from greygate.pages import notebook
from greygate.pages.figures import Curve, chart
from greygate.pages.units import display, labelled
from greygate.plants.dimensions import clashes
from greygate.plants.readers.columns import UNKNOWN, Channel
from greygate.plants.readers.read import read_channels
from greygate.reading import read_toml

DRAWN = 64 << 20  # bytes of the largest recording whose channels are drawn in a guide
EDITED = 1 << 20  # bytes of the largest text that is edited
BINS = 400  # of a drawing: each shows the least and the largest of its samples
RIG = "rig.toml"
SAMPLES = {  # sample of `greygate demo`, written into a folder of its name -> where the page goes on
    "recording": "guide/explain?of=recording/rig", "plant": "guide/explain?of=plant/axis",
    "network": "guide/network?of=network/train.csv",
    "cart": "command/make?of=cart/cart.toml&record=cart/train.csv&test=cart/test.csv&out=cart/made",
}  # fmt: skip
SAID = {"verified": "verified: every bit is equal", "differs": "the Verilog differs from the emulator"}


@dataclass(frozen=True)
class Ask:
    """A field of a command that a step asks for. choices: to be ticked, or to choose one of; without them a text."""

    name: str
    label: str
    value: str = ""
    choices: tuple[str, ...] = ()
    several: bool = False


@dataclass(frozen=True)
class Step:
    """A command. fixed: field -> value. roles: (channel, drawing) whose role is asked for.

    then: where the page goes when it is done. {out} in it, and in a value, is the field `out`.
    """

    title: str
    told: str
    command: str
    button: str
    then: str
    fixed: Mapping[str, str]
    asks: tuple[Ask, ...] = ()
    roles: tuple[tuple[str, Markup], ...] = ()


@dataclass(frozen=True)
class Text:
    """A file that is edited. mark: of what it held when it was read."""

    path: str
    text: str
    mark: str


@dataclass(frozen=True)
class Way:
    """What a guide's page shows. choose: what it can begin with. page: of the last step. onward: (place, words).

    shown: a drawing of what has been made.
    """

    steps: list[Step] = field(default_factory=list)
    choose: list[Thing] = field(default_factory=list)
    texts: list[Text] = field(default_factory=list)
    verdict: str = ""
    page: str = ""
    onward: tuple[str, str] = ("", "")
    shown: Markup = field(default_factory=Markup)


def explain(folder: Path, of: str, made: str) -> Way:
    """From a recording, or a rig, to what its simulation leaves out."""
    if not (folder / of / RIG).is_file():
        told = "Click what drives the machine and what the simulation predicts; you write the equations next."
        asks = (Ask("out", "Folder of the rig", _fresh(folder, f"{Path(of).with_suffix('').as_posix()}_rig")),)
        step = Step("Roles", told, "init-rig", "Make a rig", _at("explain") + "{out}", {"recording": of}, asks,
                    drawings(folder / of))  # fmt: skip
        return Way([step])
    texts = [read(folder, path.relative_to(folder).as_posix()) for path in sorted((folder / of).glob("*.toml"))]
    own = tuple(_tables(folder, texts))
    out, page = f"{of}.diagnosis.json", f"{of}.diagnosis.html"
    ticked = (Ask("effects", "Effects of your own to try", "\n".join(own), own, several=True),) if own else ()
    fixed, back = {"rigs": of, "out": out, "html": page}, _at("explain", of)
    told = "It fits the data sheet, looks for what is missing, and judges it on the held-out recording."
    steps = [Step("Diagnose", told, "diagnose", "Diagnose", back, fixed, ticked)]
    found = object_in(folder / out)
    if any("formula" in inner(where) for where in _list(found, "where")):
        told = f"What has no name becomes an effect of {of}/{TABLE}; then diagnose again."
        steps.append(Step("Accept", told, "diagnose", "Accept the formula", back, fixed | {"accept": "yes"}, ticked))
    return Way(steps, [], texts, _verdict(found), _page(folder, page) if found else "")


def network(folder: Path, of: str, made: str) -> Way:
    """From a recording to a network that predicts it."""
    recordings = tuple(
        t.path for t in _of(folder, "recording") if t.path != of and Path(t.path).parent == Path(of).parent
    )
    out = _fresh(folder, (Path(of).parent / "found").as_posix())
    tests = (Ask("test", "Judge it by", choices=recordings, several=True),) if recordings else ()
    asks = (*tests, Ask("seconds", "Seconds to look for it", "60"), Ask("out", "Folder of the network", out))
    told = "Click what drives the machine, and what the network is to predict from that alone."
    step = Step("Roles", told, "identify", "Find a network", _at("network", of) + "&made={out}",
                {"record": of, "html": "{out}.html"}, asks, drawings(folder / of))  # fmt: skip
    name = f"{made}/{Path(made).name}.toml"
    if not made or not (folder / name).is_file():
        return Way([step])
    said = inner(object_in(folder / made / f"{Path(made).name}.json"), "chosen").get("model", "")
    return Way(
        [step], verdict=str(said), page=_page(folder, f"{made}.html"), onward=(_at("fpga", name), "Network to FPGA")
    )


def fpga(folder: Path, of: str, made: str) -> Way:
    """From a network to Verilog that is verified."""
    here = _at("fpga", of) + "&made="
    if not (made and (folder / made / "compile.json").is_file()):
        recordings = _learnt(folder, of)
        asks = (
            Ask("record", "Recording that sets the ranges", choices=recordings),
            Ask("held", "Others to verify it on", choices=recordings[1:], several=True),
            Ask("width", "Bits of a word", "16"),
            Ask("out", "Folder of the build", _fresh(folder, f"{Path(of).with_suffix('').as_posix()}_build")),
        )
        told = "Signals and weights become integers of fixed width, in readable Verilog."
        return Way([Step("Compile", told, "compile", "Compile", here + "{out}", {"network": of}, asks)])
    page, said = f"{made}.html", verified(folder / made)
    told = "The Verilog is simulated; every bit of every output and state is compared with the emulator."
    steps = [Step("Verify", told, "verify", "Verify", here + quote(made), {"folder": made})]
    if said:
        steps.append(Step("Report", "What fixed point costs, as a page.", "report", "Make the page", here + made,
                          {"folders": made, "html": page}))  # fmt: skip
    shown = sections(folder, made, "build") if said else Markup()
    return Way(steps, verdict=SAID.get(said, ""), page=_page(folder, page), shown=shown)


def compare(folder: Path, of: str, made: str) -> Way:
    """Several models over one recording."""
    known = _of(folder, "network", "build", "rig")
    models = [t.path for t in known] + [
        f"{t.path}={p}" for t in known if (p := _page(folder, f"{t.path}.diagnosis.json"))
    ]
    asks = (
        Ask("against", "Models", choices=tuple(models), several=True),
        Ask("settle", "First samples that only settle", str(max([0, *(_settled(folder / t.path) for t in known)]))),
    )
    page = f"{Path(of).with_suffix('').as_posix()}.models.html"
    told = "Each runs freely over the recording: one plot, and how well each fits."
    step = Step("Models", told, "look", "Compare", _at("compare", of), {"recording": of, "html": page}, asks)
    return Way([step], page=_page(folder, page))


def _settled(path: Path) -> int:
    """The samples that `identify` let a network settle in."""
    found = object_in(path.with_suffix(".json")).get("settle", 0)
    return found if isinstance(found, int) else 0


WAYS: dict[str, tuple[str, Callable[[Path, str, str], Way], tuple[str, ...]]] = {
    "explain": ("Explain a recording", explain, ("rig", "recording")),
    "network": ("Network from a recording", network, ("recording",)),
    "fpga": ("Network to FPGA", fpga, ("network",)),
    "compare": ("Compare models", compare, ("recording",)),
}
"""Name -> title, what shows it, the kinds of things that it begins with."""


def guide(name: str, folder: Path, of: str, made: str) -> Way:
    """A way that begins with `of`, or what it can begin with. Raises InputError for what cannot be read."""
    _, way, kinds = WAYS[name]
    return way(folder, of, made) if of else Way(choose=_of(folder, *kinds))


def sections(folder: Path, path: str, kind: str) -> Markup:
    """What a thing shows of itself. Raises InputError for one that cannot be read."""
    if kind == "recording":
        return Markup("").join(drawn for _, drawn in drawings(folder / path))
    if kind == "build":
        return Markup(notebook.project(Project.open(folder / path)))
    return Markup(notebook.network(Network.load(str(folder / path)))) if kind == "network" else Markup()


def drawings(path: Path) -> tuple[tuple[str, Markup], ...]:
    """(name, drawing) of each channel of a recording. Raises InputError as `read_channels`."""
    if not path.is_file():
        raise InputError(f"{path.name}: is no file; choose another")
    if path.stat().st_size > DRAWN:
        raise InputError(f"{path.name}: above {DRAWN >> 20} MB nothing is drawn here; use the command's own form")
    return tuple((c.name, _drawn(c)) for c in read_channels(path, unitless=UNKNOWN))


def _drawn(c: Channel) -> Markup:
    factor, unit = display(c.unit, float(np.abs(c.values).max()))
    edges = np.unique(np.linspace(0, len(c.values), BINS + 1).astype(int)[:-1])
    lows, highs = (f.reduceat(c.values, edges) * factor for f in (np.minimum, np.maximum))
    y = np.column_stack([lows, highs]).ravel()
    line = Curve(np.repeat(c.time[edges], 2), y, "model")
    return chart([line], x="time [s]", y=labelled(c.name, unit), width=390, height=130)


def read(folder: Path, name: str) -> Text:
    """A text of a rig. Raises InputError for one that cannot be edited here."""
    path = _editable(folder, name)
    try:
        data = contents(path, EDITED)
        return Text(name, data.decode(), sha256(data).hexdigest())
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be edited here ({error})") from None


def save(folder: Path, name: str, text: str, mark: str) -> str:
    """Write a text in place of the one with the mark; the new mark. Raises InputError where that has changed."""
    if read(folder, name).mark != mark:
        raise InputError(f"{name}: was changed meanwhile; reload the page")
    with replacing(folder / name) as new:
        new.write_text(text, encoding="utf-8", newline="\n")
    return read(folder, name).mark


def check(folder: Path, name: str, text: str) -> str:
    """What is remarked of a rig with this text. InputError says what is wrong with it, units too."""
    path = _editable(folder, name)
    with scratch() as copy:
        for file in path.parent.iterdir():
            if file.is_file() and not file.is_symlink() and file.name != path.name:
                _link(file, copy / file.name)
        (copy / path.name).write_text(text, encoding="utf-8", newline="\n")
        try:
            if _is_table(path):
                return f"{len(effects.read(copy / path.name))} effects"
            plant = load(copy).plant
        except InputError as error:
            raise InputError(str(error).replace(f"{copy}{os.sep}", "").replace(str(copy), path.parent.name)) from None
    if wrong := clashes(plant):
        raise InputError("; ".join(wrong))
    return "the equations can be simulated, and their units agree"


def _editable(folder: Path, name: str) -> Path:
    path = folder / name
    if path.suffix != ".toml" or path.is_symlink() or not path.is_file() or not (path.parent / RIG).is_file():
        raise InputError(f"{name}: is no text of a rig")
    return path


def _link(file: Path, to: Path) -> None:
    try:
        to.symlink_to(file)
    except OSError:  # Windows without the right to
        shutil.copyfile(file, to)


def _is_table(path: Path) -> bool:
    """Whether a TOML file beside a rig is to hold effects: neither rig.toml nor the plant that it names."""
    try:
        plant = read_toml(path.parent / RIG, "give the folder of a rig").get("plant")
    except InputError:
        return False
    return path.name not in (RIG, plant)


def _tables(folder: Path, texts: list[Text]) -> Iterator[str]:
    """The tables of effects that a diagnosis does not try by itself."""
    for text in texts:
        path = folder / text.path
        if _is_table(path) and path.name != TABLE:
            with suppress(InputError):
                effects.read(path)
                yield text.path


def _at(way: str, of: str = "") -> str:
    return f"guide/{way}?of={quote(of)}"


def _of(folder: Path, *kinds: str) -> list[Thing]:
    return [thing for kind in kinds for thing in things(folder) if thing.kind == kind]


def _fresh(folder: Path, name: str) -> str:
    """The name, or the next one that nothing has."""
    return next(n for k in count(1) if not (folder / (n := name if k == 1 else f"{name}_{k}")).exists())


def _page(folder: Path, name: str) -> str:
    return name if (folder / name).is_file() else ""


def _verdict(found: Mapping) -> str:
    names = [str(inner(effect).get("id")) for effect in _list(found, "effects")]
    said = str(found.get("verdict", "")).replace("_", " ")
    return f"{said}: {', '.join(names)}" if names else said


def _list(found: Mapping, name: str) -> list:
    return value if isinstance(value := found.get(name), list) else []


def _learnt(folder: Path, of: str) -> tuple[str, ...]:
    """The recordings beside a network, and in the folder above; those it learnt from first."""
    path = Path(of)
    names = inner(object_in((folder / of).with_suffix(".json")), "recordings")
    first = [(path.parent / f"{name}.csv").as_posix() for name in names]
    every = [t.path for t in _of(folder, "recording") if Path(t.path).parent in (path.parent, path.parent.parent)]
    return tuple(dict.fromkeys([*(p for p in first if p in every), *every]))
