"""`greygate export`: a build, a rig or a plant as files for another tool."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypedDict

from greygate.errors import InputError, shown
from greygate.export import fmu, network, plant, values
from greygate.export.mjcf import Joint, joints, mjcf
from greygate.export.model import Model
from greygate.export.modelica import modelica
from greygate.export.mujoco_model import Corrected, corrected_model
from greygate.files import replacing, replacing_folder
from greygate.hardware.build import Project
from greygate.hardware.facts import FACTS
from greygate.mismatch import effects as effect_table
from greygate.mismatch import rig as rigs
from greygate.mismatch.joining import acting, begun
from greygate.mismatch.model import NUISANCES
from greygate.mismatch.simulation import asked, check, corrected
from greygate.plants import mjcf as mjcf_model
from greygate.plants.plant import Equation, Plant
from greygate.plants.symbolic import latex


class ExportedFmu(TypedDict):
    """An FMU."""

    out: str
    fmi: Literal["2.0", "3.0"]
    model: str
    step_s: float
    library: str
    inputs: list[str]
    parameters: list[str]
    outputs: list[str]


def export_c(project: Project, out: Path | str) -> list[str]:
    """Write the step of a build in C99, with functions from values to codes and back; the names of the files.

    The folder replaces an earlier one of the kind and nothing else.
    """
    made = values.files(project.program)
    with replacing_folder(out, "export") as new:
        for name, text in made.items():
            (new / name).write_text(text, encoding="utf-8", newline="\n")
    return sorted(made)


def export_fmu(
    source: Path | str, out: Path | str, version: str = fmu.VERSIONS[0], diagnosis: Mapping | None = None
) -> dict[str, Any]:
    """Write an FMU for co-simulation of what `source` is: a build, a folder with rig.toml, or a plant's TOML file.

    diagnosis: content of a diagnosis.json of that rig, by which its plant is corrected. Returns what the FMU holds.
    Raises InputError for another source, and for a correction that is no part of the plant's equations.
    """
    return fmu.write(_model(Path(source), diagnosis), out, version)


def export_modelica(source: Path | str, out: Path | str, diagnosis: Mapping | None = None) -> str:
    """Write the equations of a rig's plant, as a diagnosis corrects it, or of a plant's TOML file; the model's name."""
    chosen = _written(_plant(Path(source), diagnosis))
    with replacing(out) as new:
        new.write_text(modelica(chosen, _told(source, diagnosis)), encoding="utf-8", newline="\n")
    return chosen.name


def export_latex(source: Path | str, out: Path | str, diagnosis: Mapping | None = None) -> str:
    """Write the same equations in LaTeX, for an `align` environment; the plant's name. Needs sympy."""
    chosen = _written(_plant(Path(source), diagnosis))
    text = latex(chosen)
    with replacing(out) as new:
        new.write_text(text + "\n", encoding="utf-8", newline="\n")
    return chosen.name


def export_mjcf(
    source: Path | str, out: Path | str, names: Mapping[str, str], diagnosis: Mapping | None = None
) -> list[Joint]:
    """Write what resists the motion of such a plant as joint classes of MuJoCo; see `mjcf.joints`. Needs sympy.

    Of a rig whose plant is a model of MuJoCo it is the whole model, and beside it a Python file, NAME.py, with what
    MJCF has no element for.
    """
    chosen = _plant(Path(source), diagnosis)
    if isinstance(chosen.outside, mjcf_model.Simulated):
        return _outside(Path(source), Path(out), chosen, names, _told(source, diagnosis))
    found = joints(_written(chosen), names, None if diagnosis is None else _plant(Path(source), None))
    with replacing(out) as new:
        new.write_text(mjcf(found, _told(source, diagnosis)), encoding="utf-8", newline="\n")
    return found


def _outside(source: Path, out: Path, chosen: Plant, names: Mapping[str, str], meaning: str) -> list[Joint]:
    """Write the corrected model of a rig; its joints, with what has changed and what the Python file adds."""
    if names:
        raise InputError("--joint: the joints of a model have their names; leave it out")
    rig = rigs.load(source)
    if out.exists() and out.resolve() == mjcf_model.file_of(rig.plant).resolve():
        raise InputError(f"{out}: is the rig's own model; choose another --out")
    made = corrected_model(rig, chosen, out, meaning)
    with replacing(out) as new:
        new.write_text(made.xml, encoding="utf-8", newline="\n")
    if made.python:
        with replacing(out.with_suffix(".py")) as new:
            new.write_text(made.python, encoding="utf-8", newline="\n")
    return [_joint(chosen, made, place, e) for place, e in chosen.equations.items() if place.startswith("motion_")]


def _joint(plant: Plant, made: Corrected, place: str, equation: Equation) -> Joint:
    """A joint of a corrected model: its properties, carried where a diagnosis changed them."""
    name = place.removeprefix("motion_")
    kinds = ("damping", "frictionloss", "armature")
    sizes = {kind: plant.parameters[f"{kind}_{name}"].value for kind in kinds}
    carried = {kind: [f"{kind}_{name}"] for kind in kinds if f"{kind}_{name}" in made.changed}
    left = [path.partition(".")[2] for path in made.added if path.partition(".")[0] == place]
    gain = f"gain_{mjcf_model.TORQUE}{name}"
    left += [f"{gain} {made.changed[gain][1]:.6g}, of what the log has"] if gain in made.changed else []
    return Joint(equation.state, name, **sizes, carried=carried, left=left)


def _written(plant: Plant) -> Plant:
    """The plant, if its equations are written down. Raises InputError where a model from outside computes them."""
    if plant.outside is not None:
        kind = "mjcf" if isinstance(plant.outside, mjcf_model.Simulated) else "fmu"
        raise InputError(f"plant {plant.name}: a model computes it, which has no equations here; `greygate export "
                         f"{kind}` writes that model corrected")  # fmt: skip
    return plant


def _told(source: Path | str, diagnosis: Mapping | None) -> str:
    """What the file is, in a line."""
    return f"Plant of {Path(source).name}{', as a diagnosis corrects it' if diagnosis else ''}; written by greygate"


def _plant(source: Path, diagnosis: Mapping | None) -> Plant:
    if (source / "rig.toml").is_file():
        return _identified(source, diagnosis)
    if diagnosis is not None:
        raise InputError(f"{source}: a diagnosis corrects the plant of a rig; give the folder with its rig.toml")
    if source.suffix == ".toml":
        return _named(Plant.read(source))
    raise InputError(
        f"{source}: give a folder with rig.toml, a plant's TOML, or for an FMU what `greygate compile` wrote"
    )


def _model(source: Path, diagnosis: Mapping | None) -> Model:
    if (source / FACTS).is_file() and diagnosis is None:
        project = Project.open(source)
        return network.model(project.program, str(project.facts["title"]))
    return plant.model(_plant(source, diagnosis))


def _identified(folder: Path, diagnosis: Mapping | None) -> Plant:
    """The plant of a rig with the values of its data sheet, or as a diagnosis corrects it."""
    rig = rigs.load(folder)
    if diagnosis is None:
        return _named(replace(rig.plant, outputs=tuple(rig.predict)))
    recording = rig.recording(rig.folder / rig.identify[0])
    keys = asked(check(diagnosis))
    named = {key: effect for key, effect in effect_table.named(rig, recording, keys).items() if key in keys}
    model, found = corrected(rig, recording, diagnosis, named)
    without = dict.fromkeys(NUISANCES, 0.0)  # of the comparison with a recording, which an FMU has not
    values = found | {s: v for s, v in without.items() if s in found}
    laws = model.laws(values)
    plant, left = acting(model.plant, laws)
    if beside := model.beside(values, {*laws} - {*left}):
        raise InputError(
            f"diagnosis: corrects what is recorded as {', '.join(beside)}, before or after the plant's equations, "
            "which hold no delay, lag, sensor or logger: correct the signals themselves"
        )
    kept = {s: replace(p, value=float(found[s])) for s, p in plant.parameters.items() if s not in without}
    whole = replace(plant, parameters=kept, outputs=tuple(rig.predict))
    return _named(begun(whole, model.effects.values()))


def _named(given: Plant) -> Plant:
    """The plant under a name that C and file names take."""
    name = re.sub(r"\W", "_", given.name, flags=re.ASCII)
    if not re.match(r"[A-Za-z]", name):
        raise InputError(f"plant {shown(given.name)}: the name of a model begins with a letter; rename the file")
    return replace(given, name=name)
