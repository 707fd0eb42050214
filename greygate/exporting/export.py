"""`greygate export`: a build, a rig or a plant as files for another tool."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from greygate.errors import InputError, shown
from greygate.exporting import fmu, network, plant, values
from greygate.exporting.model import Model
from greygate.facts import FACTS
from greygate.files import replacing_folder
from greygate.mismatch import effects as effect_table
from greygate.mismatch import rig as rigs
from greygate.mismatch.model import BLUR, TIMING
from greygate.mismatch.simulation import asked, check, corrected
from greygate.plants.plant import Plant
from greygate.project import Project


def export_c(project: Project, out: Path | str) -> list[str]:
    """Write the step of a build in C99, with functions from values to codes and back; the names of the files.

    The folder replaces an earlier one of the kind and nothing else.
    """
    made = values.files(project.program)
    with replacing_folder(out, "export") as new:
        for name, text in made.items():
            (new / name).write_text(text, encoding="utf-8")
    return sorted(made)


def export_fmu(
    source: Path | str, out: Path | str, version: str = fmu.VERSIONS[0], diagnosis: Mapping | None = None
) -> dict[str, Any]:
    """Write an FMU for co-simulation of what `source` is: a build, a folder with rig.toml, or a plant's TOML file.

    diagnosis: content of a diagnosis.json of that rig, by which its plant is corrected. Returns what the FMU holds.
    Raises InputError for another source, and for a correction that is no part of the plant's equations.
    """
    return fmu.write(_model(Path(source), diagnosis), out, version)


def _model(source: Path, diagnosis: Mapping | None) -> Model:
    if (source / "rig.toml").is_file():
        return plant.model(_identified(source, diagnosis))
    if diagnosis is not None:
        raise InputError(f"{source}: a diagnosis corrects the plant of a rig; give the folder with its rig.toml")
    if source.suffix == ".toml":
        return plant.model(_named(Plant.read(source)))
    if (source / FACTS).is_file():
        project = Project.open(source)
        return network.model(project.program, str(project.facts["title"]))
    raise InputError(f"{source}: give a folder that `greygate compile` wrote, one with a rig.toml, or a plant's TOML")


def _identified(folder: Path, diagnosis: Mapping | None) -> Plant:
    """The plant of a rig with the values of its data sheet, or as a diagnosis corrects it."""
    rig = rigs.load(folder)
    if diagnosis is None:
        return _named(replace(rig.plant, outputs=_outputs(rig)))
    recording = rig.recording(rig.folder / rig.identify[0])
    keys = asked(check(diagnosis))
    named = {key: effect for key, effect in effect_table.named(rig, recording, keys).items() if key in keys}
    model, found = corrected(rig, recording, diagnosis, named)
    without = {TIMING: 0.0, BLUR: 0.0}  # of the comparison with a recording, which an FMU has not
    if beside := model.beside(found | {s: v for s, v in without.items() if s in found}):
        raise InputError(
            f"diagnosis: corrects what is recorded as {', '.join(beside)}, before or after the plant's equations; an "
            "FMU of the plant cannot hold that: correct the signals themselves"
        )
    kept = {s: replace(p, value=float(found[s])) for s, p in model.plant.parameters.items() if s not in without}
    return _named(replace(model.plant, parameters=kept, outputs=_outputs(rig)))


def _outputs(rig: rigs.Rig) -> tuple[str, ...]:
    return tuple(rig.predict)


def _named(given: Plant) -> Plant:
    """The plant under a name that C and file names take."""
    name = re.sub(r"\W", "_", given.name, flags=re.ASCII)
    if not re.match(r"[A-Za-z]", name):
        raise InputError(f"plant {shown(given.name)}: an FMU's name begins with a letter; rename the file")
    return replace(given, name=name)
