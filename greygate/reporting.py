"""The report of folders that `greygate compile` wrote."""

from collections.abc import Sequence
from pathlib import Path

from greygate.compiler.quantize import Formats
from greygate.errors import InputError
from greygate.facts import FACTS
from greygate.machines.catalog import REPORTED
from greygate.pages.report import write
from greygate.pages.report.study import study
from greygate.pages.summary import WIDTHS, designs, results
from greygate.progress import Progress, silent
from greygate.project import Project, compile_project
from greygate.source import Source


def report(
    projects: Sequence[Project], out: Path | str, *, side_by_side: bool = False, progress: Progress = silent
) -> list[dict]:
    """Write what quantization cost as one HTML page, and as JSON beside it; return what the JSON holds.

    side_by_side: put two tables of all projects on top, and try only the widths that they show. A study a project, its
    keys as in `pages.report.study.study`: SI units, None for what is not finite.
    Raises InputError where a folder cannot be written, or a float network diverges.

    >>> (found,) = report([project], "report.html")
    >>> found["scenarios"]["train"]["outputs"]["y"]["hardware"]["parallel"]["equals_fixed"]
    True
    """
    studies = [_study(project, WIDTHS if side_by_side else None, progress) for project in projects]
    write(studies, out, Path(out).with_suffix(".json"), [results(studies), designs(studies)] if side_by_side else [])
    return studies


def plants(folder: Path, progress: Progress = silent) -> list[Project]:
    """The plants of the catalogue, each from folder/NAME, compiled there if it is not yet.

    Raises InputError where that folder holds something else.
    """
    found = []
    for name in REPORTED:
        if not (folder / name / FACTS).exists():
            progress(f"compiling {name}")
            compile_project(Source(name), folder / name)
        project = Project.open(folder / name)
        if project.source != Source(name):
            raise InputError(f"{folder / name}: holds {project.source.name}; give a folder in which {name} is {name}")
        found.append(project)
    return found


def _study(project: Project, widths: Sequence[int] | None, progress: Progress) -> dict:
    """What the report says of one project."""
    records = project.source.records()
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
        formats=Formats(finer=project.facts.get("finer", 0)),
        progress=progress,
        **{} if widths is None else {"widths": widths},
    )
