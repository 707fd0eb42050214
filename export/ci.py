"""A workflow for GitHub or GitLab that compiles a network, simulates it and compares it with the build one accepts."""

import shlex
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import TypedDict

from greygate.compiler.verilog import render
from greygate.errors import InputError
from greygate.files import making, replacing
from greygate.hardware.comparing import read_budget
from greygate.names import check_text
from greygate.version import __version__

PLACES = {"github": ".github/workflows/greygate.yml", "gitlab": ".gitlab-ci.yml"}
BUILD = "build/greygate"
MARK = "# Written by greygate ci-template"  # the first line of a file that may be replaced
BUDGET = """\
# What a new build may have beside the accepted one: docs/compare.md.
verified = true     # every bit simulated, none differs

[growth]            # by which share a figure may be worse
error = 0.02
luts = 0.02
"""


class Workflow(TypedDict):
    """A workflow."""

    written: list[str]
    next: list[str]


def write_workflow(
    service: str,
    compiling: Sequence[str],
    files: Sequence[str],
    *,
    accepted: str = "accepted",
    budget: str = "budget.toml",
    install: str = f"greygate[synthesis]=={__version__}",
    out: Path | str | None = None,
) -> Workflow:
    """Write the workflow, and the budget if there is none, below the current folder; what was written and what is next.

    service: a key of `PLACES`. compiling: the command that compiles or explores, without --out. files:
    those of them that are files. accepted: folder of the build to compare with. install: what pip installs. out: file
    to write, its usual place if not given. Raises InputError, before anything is written, for a path outside the
    current folder, a budget that is none, and a workflow that somebody else wrote.
    """
    for path in (*files, accepted, budget):
        _check_inside(path)
    for word in (*compiling, install):
        check_text(word, "ci-template, word")
        if "${{" in word:
            raise InputError(f"{word}: GitHub replaces what follows ${{{{; rename the file")
    place = Path(PLACES[service] if out is None else out)
    if place.exists() and not place.read_text(encoding="utf-8", errors="replace").startswith(MARK):
        raise InputError(f"{place}: exists and is not of greygate; give --out FILE, and include that file in it")
    known = Path(budget).exists()
    if known:
        read_budget(budget)
    judge = [
        _greygate("report", BUILD, "--html", "build/report.html"),
        _greygate("compare", accepted, BUILD, "--budget", budget, "--html", "build/compare.html"),
    ]
    context = {"mark": MARK, "install": shlex.quote(install), "build": _making(compiling, BUILD), "judge": judge}
    with making(place.parent), replacing(place) as new:
        new.write_text(render(f"{service}.yml", context, "greygate.export"), encoding="utf-8", newline="\n")
        if not known:
            with replacing(budget) as limits:
                limits.write_text(BUDGET, encoding="utf-8", newline="\n")
    written = [str(place), *([] if known else [budget])]
    first = [] if Path(accepted).exists() else _making(compiling, accepted)
    return {"written": written, "next": [*first, shlex.join(["git", "add", "--force", *written, accepted])]}


def _greygate(*words: str) -> str:
    return shlex.join(("greygate", *words))


def _making(compiling: Sequence[str], folder: str) -> list[str]:
    """The commands that make a build, and the figures that `compare` judges."""
    made = _greygate(*compiling, "--out", folder)
    return [made, _greygate("verify", folder), _greygate("synthesize", folder)]


def _check_inside(path: str) -> None:
    """The path must mean the same file, or folder, in every clone, and not all of the repository."""
    inside = PurePosixPath(path)
    if inside.is_absolute() or ".." in inside.parts or not inside.name:
        raise InputError(f"{path or repr(path)}: a clone has no such path; give one below the folder where you are now")
