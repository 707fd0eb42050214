"""The FMU that computes a rig's plant, within that of the corrected plant: its files, and what C has to know of it."""

import io
import string
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from greygate.errors import InputError
from greygate.plants import fmu
from greygate.plants.fmu.archive import DESCRIPTION, Archive
from greygate.plants.plant import Plant

KEPT = ("binaries/", "resources/")  # of its archive; sources and pages are not run
FOLDER = "inner"


@dataclass(frozen=True)
class Wrapped:
    """files: place under resources -> content. state: lines of the model's structure. source: C ahead of the model."""

    files: Mapping[str, bytes]
    state: Sequence[str]
    source: str


def wrapped(plant: Plant) -> Wrapped:
    """The FMU of a plant. Raises InputError for a plant that no FMU computes, and for one with events or own steps."""
    outside = plant.outside
    if not isinstance(outside, fmu.Simulated):
        raise InputError(f"plant {plant.name}: its model computes it, which an FMU cannot hold; `greygate export mjcf` "
                         "writes the model")  # fmt: skip
    if outside.whole:
        raise InputError(f"plant {plant.name}: its FMU has events, or steps itself; such a one is not wrapped. Set the "
                         "parameters that the diagnosis found in the FMU itself")  # fmt: skip
    archive = Archive.read(outside.path)
    about = outside.running.about
    with zipfile.ZipFile(io.BytesIO(archive.content)) as held:
        files = {f"{FOLDER}/{name}": held.read(name) for name in held.namelist() if name.startswith(KEPT)
                 and not name.endswith("/")}  # fmt: skip
        files[f"{FOLDER}/{DESCRIPTION}"] = held.read(DESCRIPTION)
    library = str(about["library"]).removeprefix(f"{about['folder']}/")
    groups = {
        "state": (about["states"], about["scales"]["states"]),
        "input": (about["inputs"], about["scales"]["inputs"]),
        "parameter": (about["parameters"], outside.settings),
        "output": (outside.references, outside.scales),
    }
    most = max(1, *(len(references) for references, _ in groups.values()))
    lines = [f"#define INNER_FMI {about['version']}", f"#define INNER_STATES {len(about['states'])}",
             f"#define INNER_NUMBERS {most}", '#include "inner.h"', ""]  # fmt: skip
    for name, (references, scales) in groups.items():
        pairs = ", ".join(f"{{{factor!r}, {level!r}}}" for factor, level in scales) or "{1.0, 0.0}"
        listed = ", ".join(f"{r}u" for r in references) or "0u"
        lines += [f"static const double {name}_scale[][2] = {{{pairs}}};"]
        lines += [f"static const unsigned {name}_reference[] = {{{listed}}};"] if name != "state" else []
    counts = ", ".join(str(len(references)) for references, _ in groups.values())
    lines += [
        "static const inner_about INNER = {",
        f"    {_text(about['token'])}, {_text(library)}, {counts},",
        "    input_reference, parameter_reference, output_reference,",
        "    state_scale, input_scale, parameter_scale, output_scale,",
        "};",
    ]
    return Wrapped(files, ("double time;", "void *inner;"), "\n".join(lines))


def _text(text: str) -> str:
    """A text in C: whatever it holds is a character of it."""
    plain = {*"{}-_./", *string.ascii_letters, *string.digits}
    return '"' + "".join(chr(b) if chr(b) in plain else f"\\{b:03o}" for b in text.encode()) + '"'
