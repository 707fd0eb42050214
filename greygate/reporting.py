"""Makes the report of builds: the folders that `greygate compile` wrote."""

from collections.abc import Sequence
from pathlib import Path

from greygate.compiler.quantize import Formats
from greygate.compiler.study import study
from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.hardware.facts import FACTS
from greygate.machines.catalog import REPORTED
from greygate.machines.source import Source
from greygate.pages.report import write
from greygate.pages.summary import WIDTHS, designs, results
from greygate.progress import Progress, silent
from greygate.project import compile_project


def report(
    projects: Sequence[Project], out: Path | str, *, side_by_side: bool = False, progress: Progress = silent
) -> list[dict]:
    """Write what quantization cost as one HTML page, and as JSON beside it; return the content of the JSON.

    side_by_side: put two tables of all projects on top, and try only the widths that they show. The result has one
    study for each project, with the keys of `pages.report.study.study`: SI units, None for a figure that is not finite.
    Raises InputError if a folder cannot be written, or a float network diverges.

    >>> (found,) = report([project], "report.html")
    >>> found["scenarios"]["train"]["outputs"]["y"]["hardware"]["parallel"]["equals_fixed"]
    True
    """
    studies = [study_of(project, WIDTHS if side_by_side else None, progress) for project in projects]
    write(studies, out, Path(out).with_suffix(".json"), [results(studies), designs(studies)] if side_by_side else [])
    return studies


def plants(folder: Path, progress: Progress = silent) -> list[Project]:
    """The plants of the catalogue, each from folder/NAME; those that are missing are compiled there.

    Raises InputError if such a folder holds another build.
    """
    found = []
    for name in REPORTED:
        if not (folder / name / FACTS).exists():
            progress(f"compiling {name}")
            compile_project(Source(name), folder / name)
        project = Project.open(folder / name)
        if project.source != Source(name):
            raise InputError(
                f"{folder / name}: is a build of {project.source.name}, not of {name}; give another folder"
            )
        found.append(project)
    return found


def study_of(project: Project, widths: Sequence[int] | None = None, progress: Progress = silent) -> dict:
    """The study of one project. widths: of words that are tried beside its own, by default as `study` does."""
    records = project.records()
    return study(
        project.facts["title"],
        project.compiled(records),
        records,
        ranged_on=project.source.training,
        period=project.program.period,
        called=Path(project.source.name).stem,
        references=project.source.references,
        hardware=project.hardware,
        resources=project.resources,
        explored=project.facts.get("explored"),
        formats=Formats(finer=project.facts.get("finer", 0)),
        progress=progress,
        **{} if widths is None else {"widths": widths},
    )
