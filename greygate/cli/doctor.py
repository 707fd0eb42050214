"""The command that looks at the machine: doctor."""

from typing import TYPE_CHECKING

import typer

from greygate.cli.terminal import Json, give

if TYPE_CHECKING:
    from greygate.cli.printed import Doctor


def doctor(as_json: Json = False) -> None:
    """List the tools that greygate uses, and what is missing.

    Exit code 1 if a command of the plain installation would fail.
    """
    from greygate import __version__
    from greygate.doctor import tools
    from greygate.pages.summary import aligned

    found = tools()
    rows = [
        {
            "name": tool.name,
            "version": tool.version or ("MISSING" if tool.needed else "not installed"),
            "for": tool.needed_by,
            "remedy": "" if tool.version else tool.remedy,
        }
        for tool in found
    ]
    healthy = all(tool.version or not tool.needed for tool in found)
    verdict = "every command of the plain installation can run" if healthy else "some commands cannot run: see MISSING"
    result: Doctor = {"greygate": __version__, "healthy": healthy, "tools": found}
    lines = [f"greygate {__version__}", *aligned(rows, ("name", "version", "for", "remedy")), verdict]
    give("doctor", result, as_json, lines)
    if not healthy:
        raise typer.Exit(1)
