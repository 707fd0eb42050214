"""`greygate export`: c, fmu, fusesoc, modelica, mjcf, latex."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli.terminal import Json, following, give

if TYPE_CHECKING:
    from greygate.cli.printed import ExportedC, ExportedLatex, ExportedMjcf, ExportedModelica

app = typer.Typer(help="Write a build, a rig or a plant for another tool.", no_args_is_help=True)
Folder = Annotated[Path, typer.Argument(metavar="BUILD", help="A folder that `greygate compile` wrote.")]

PlantOf = Annotated[Path, typer.Argument(metavar="RIG|PLANT.toml", help="A folder with rig.toml, or a plant.")]
Corrected = Annotated[Path | None, typer.Option(help="diagnosis.json of the rig: the plant with its corrections.")]


class Fmi(StrEnum):
    """A version of the Functional Mock-up Interface."""

    THREE = "3.0"
    TWO = "2.0"


@app.command()
def c(
    folder: Folder,
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier export is replaced.")],
    as_json: Json = False,
) -> None:
    """Write the step of a build in C99, and the functions that turn physical values into codes and back."""
    from greygate.export.export import export_c
    from greygate.hardware.build import Project

    files = export_c(Project.open(folder), out)
    result: ExportedC = {"out": str(out), "files": files}
    give("export-c", result, as_json, [", ".join(files), f"written to {out}"])


@app.command()
def fmu(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="BUILD|RIG|PLANT.toml", help="What `greygate compile` wrote, a folder with rig.toml, or a plant."
        ),
    ],
    out: Annotated[Path, typer.Option(help="FMU to write.")],
    fmi: Annotated[Fmi, typer.Option(help="Version of FMI.")] = Fmi.THREE,
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write an FMU for co-simulation: a network bit for bit as compiled, or a plant, as it is or corrected."""
    from greygate.export.export import export_fmu
    from greygate.mismatch.simulation import read

    with following("compiling the FMU"):
        held = export_fmu(source, out, fmi.value, None if diagnosis is None else read(diagnosis))
    lines = [f"{what}: {', '.join(held[what]) or 'none'}" for what in ("inputs", "parameters", "outputs")]
    lines += [f"FMI {held['fmi']}, steps of {held['step_s']:g} s, {held['library']}", f"written to {out}"]
    give("export-fmu", held, as_json, lines)


@app.command()
def fusesoc(
    folder: Folder,
    out: Annotated[Path, typer.Option(help="Folder to write; an earlier export is replaced.")],
    architecture: Annotated[str | None, typer.Option(help="Of the build; folded if it has that.")] = None,
    as_json: Json = False,
) -> None:
    """Write a core for FuseSoC, Vivado and Quartus, with its benches in Verilog and cocotb."""
    from greygate.export.hdl import export_fusesoc
    from greygate.hardware.build import Project

    held = export_fusesoc(Project.open(folder), out, architecture)
    lines = [f"{held['core']}, {held['architecture']}: {len(held['files'])} files", f"written to {out}"]
    give("export-fusesoc", held, as_json, lines)


@app.command()
def modelica(
    source: PlantOf,
    out: Annotated[Path, typer.Option(help="FILE.mo to write.")],
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write a plant's equations as a Modelica model, as they are or corrected."""
    from greygate.export.export import export_modelica
    from greygate.mismatch.simulation import read

    name = export_modelica(source, out, None if diagnosis is None else read(diagnosis))
    result: ExportedModelica = {"model": name, "out": str(out)}
    give("export-modelica", result, as_json, [f"model {name}", f"written to {out}"])


@app.command()
def latex(
    source: PlantOf,
    out: Annotated[Path, typer.Option(help="FILE.tex to write.")],
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write a plant's equations in LaTeX, each term with its name under it, as they are or corrected."""
    from greygate.export.export import export_latex
    from greygate.mismatch.simulation import read

    name = export_latex(source, out, None if diagnosis is None else read(diagnosis))
    result: ExportedLatex = {"plant": name, "out": str(out)}
    give("export-latex", result, as_json, [f"plant {name}", f"written to {out}"])


@app.command()
def mjcf(
    source: PlantOf,
    out: Annotated[Path, typer.Option(help="FILE.xml to write, which a model includes.")],
    joint: Annotated[
        list[str], typer.Option(help="VELOCITY=NAME: the class of its joint; may be given several times.")
    ] = [],
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write damping, dry friction and added inertia of a plant as joint classes of MuJoCo, as it is or corrected."""
    from greygate.export.export import export_mjcf
    from greygate.mismatch.simulation import read

    names = {v: name or v for v, _, name in (text.partition("=") for text in joint)}
    found = export_mjcf(source, out, names, None if diagnosis is None else read(diagnosis))
    lines = []
    for one in found:
        sizes = [f"{what} {getattr(one, what):.6g} ({', '.join(terms)})" for what, terms in one.carried.items()]
        lines.append(f"{one.name}: {'; '.join(sizes) or 'nothing resists'}")
        lines += [f"  not here: {', '.join(one.left)}"] * bool(one.left)
    result: ExportedMjcf = {"out": str(out), "joints": found}
    give(
        "export-mjcf",
        result,
        as_json,
        [*lines, f"written to {out}"],
    )
