"""The report of folders that `greygate compile` wrote."""

from collections.abc import Sequence
from pathlib import Path

from greygate.compiler.quantize import Formats
from greygate.pages.report import write
from greygate.pages.report.study import study
from greygate.pages.summary import WIDTHS, designs, results
from greygate.progress import Progress, silent
from greygate.project import Project


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
