"""What holds for every command: headings in `greygate --help`, short options, and what an old word is called."""

import re
from typing import Any

from typer.core import TyperGroup

SHORT = {"--out": "-o", "--jobs": "-j", "--diagnosis": "-d", "--html": "-H", "--json": "-J"}  # the most used ones
OLD = {  # what older scripts say -> what it is called
    **{name: f"`greygate dev {name}`" for name in ("bench-concealed", "conceal", "reveal", "schema")},
    **{"--record": "an argument", "--recording": "an argument", "--device": "`greygate explore --target`"},
    **{"--limit": "--seconds", "--budget": "--max-error", "--target": "--output", "--out": "--html"},
    "--port": "--interface",
}


class Commands(TyperGroup):
    """The commands of greygate."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        for command in leaves(self).values():
            for option in command.params:
                option.opts = [*(SHORT[word] for word in option.opts if word in SHORT), *option.opts]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        headings: dict[str, list[tuple[str, str]]] = {}
        widest = max(map(len, self.commands))
        for name, command in self.commands.items():
            rows = headings.setdefault(command.rich_help_panel, [])  # type: ignore[attr-defined]
            rows.append((name.ljust(widest), command.get_short_help_str(formatter.width - 6 - widest)))
        for heading, rows in headings.items():
            with formatter.section(heading):
                formatter.write_dl(rows)


def leaves(group: Any, path: str = "") -> dict[str, Any]:
    """Command -> what it is; one of a group is "GROUP COMMAND"."""
    found: dict[str, Any] = {}
    for name, command in group.commands.items():
        full = f"{path} {name}".strip()
        found |= leaves(command, full) if hasattr(command, "commands") else {full: command}
    return found


def renamed(error: Any) -> str:
    """What a word that click refused is called now; "" where it was never a word of that command."""
    if error.ctx is None or not (
        refused := re.search(r"No such (?:option: |command ')([\w-]+)", error.format_message())
    ):
        return ""
    new, options = OLD.get(refused[1], ""), {word for option in error.ctx.command.params for word in option.opts}
    return f" (it is called {new} now)" if new and (new[:2] != "--" or new in options) else ""
