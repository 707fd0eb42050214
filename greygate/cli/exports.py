"""`greygate export`: c, fmu, fusesoc, modelica, mjcf, latex."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from greygate.cli import words
from greygate.cli.terminal import Json, following, give

if TYPE_CHECKING:
    from greygate.cli.printed import ExportedC, ExportedLatex, ExportedMjcf, ExportedModelica

app = typer.Typer(help="Write a build, a rig or a plant for another tool.", no_args_is_help=True)
Corrected = Annotated[Path | None, words.DIAGNOSIS]


class Fmi(StrEnum):
    """A version of the Functional Mock-up Interface."""

    THREE = "3.0"
    TWO = "2.0"


@app.command()
def c(
    folder: words.Build,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; an earlier export is replaced.")],
    as_json: Json = False,
) -> None:
    """Write a build in C99, with conversions of its values."""
    from greygate.export.export import export_c
    from greygate.hardware.build import Project

    files = export_c(Project.open(folder), out)
    result: ExportedC = {"out": str(out), "files": files}
    give("export-c", result, as_json, [", ".join(files), f"written to {out}"])


@app.command()
def fmu(
    source: Annotated[
        Path, typer.Argument(metavar="BUILD|PLANT", help="A build, PLANT.toml, rig.toml, or a folder with one.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.fmu", help="FMU to write.")],
    fmi: Annotated[Fmi, typer.Option(help="Version of FMI.")] = Fmi.THREE,
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write an FMU for co-simulation of a build or a plant."""
    from greygate.export.export import export_fmu
    from greygate.mismatch.simulation import read

    with following("compiling the FMU"):
        held = export_fmu(source, out, fmi.value, None if diagnosis is None else read(diagnosis))
    lines = [f"{what}: {', '.join(held[what]) or 'none'}" for what in ("inputs", "parameters", "outputs")]
    lines += [f"FMI {held['fmi']}, steps of {held['step_s']:g} s, {held['library']}", f"written to {out}"]
    give("export-fmu", held, as_json, lines)


@app.command()
def fusesoc(
    folder: words.Build,
    out: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder to write; an earlier export is replaced.")],
    architecture: Annotated[words.Architecture | None, words.ARCHITECTURE] = None,
    as_json: Json = False,
) -> None:
    """Write a core for FuseSoC, Vivado, Quartus, with benches.

    The core is the folded one if the build has that. The benches are in Verilog and cocotb.
    """
    from greygate.export.hdl import export_fusesoc
    from greygate.hardware.build import Project

    held = export_fusesoc(Project.open(folder), out, architecture and architecture.value)
    lines = [f"{held['core']}, {held['architecture']}: {len(held['files'])} files", f"written to {out}"]
    give("export-fusesoc", held, as_json, lines)


@app.command()
def modelica(
    source: words.Plant,
    out: Annotated[Path, typer.Option(metavar="FILE.mo", help="Model to write.")],
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write a plant as a Modelica model, corrected or not."""
    from greygate.export.export import export_modelica
    from greygate.mismatch.simulation import read

    name = export_modelica(source, out, None if diagnosis is None else read(diagnosis))
    result: ExportedModelica = {"model": name, "out": str(out)}
    give("export-modelica", result, as_json, [f"model {name}", f"written to {out}"])


@app.command()
def latex(
    source: words.Plant,
    out: Annotated[Path, typer.Option(metavar="FILE.tex", help="LaTeX to write.")],
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write a plant's equations in LaTeX, each term named."""
    from greygate.export.export import export_latex
    from greygate.mismatch.simulation import read

    name = export_latex(source, out, None if diagnosis is None else read(diagnosis))
    result: ExportedLatex = {"plant": name, "out": str(out)}
    give("export-latex", result, as_json, [f"plant {name}", f"written to {out}"])


@app.command()
def mjcf(
    source: words.Plant,
    out: Annotated[Path, typer.Option(metavar="FILE.xml", help="MJCF to write, which a model includes.")],
    joint: Annotated[
        list[str], typer.Option(metavar="VELOCITY=NAME", help="The class of the joint of a velocity.")
    ] = [],
    diagnosis: Corrected = None,
    as_json: Json = False,
) -> None:
    """Write joint classes of MuJoCo from a plant, corrected or not.

    They have damping, dry friction and added inertia.
    """
    from greygate.export.export import export_mjcf
    from greygate.mismatch.simulation import read

    names = {v: name or v for v, _, name in (text.partition("=") for text in joint)}
    found = export_mjcf(source, out, names, None if diagnosis is None else read(diagnosis))
    lines = []
    for one in found:
        sizes = [f"{what} {getattr(one, what):.6g} ({', '.join(terms)})" for what, terms in one.carried.items()]
        lines.append(f"{one.name}: {'; '.join(sizes) or 'nothing to write'}")
        lines += [f"  not here: {', '.join(one.left)}"] * bool(one.left)
    result: ExportedMjcf = {"out": str(out), "joints": found}
    give("export-mjcf", result, as_json, [*lines, f"written to {out}"])
