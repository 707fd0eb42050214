"""What holds for every command: headings in `greygate --help`, short options, and old spellings.

An old spelling is understood, and one line on stderr says what it is called.
"""

import shlex
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from greygate.cli.terminal import say

SHORT = {"--out": "-o", "--jobs": "-j", "--diagnosis": "-d", "--html": "-H", "--json": "-J"}  # the most used ones
ARGUMENT = ""  # a word that is no option
RECORD, LIMIT = {"--record": ARGUMENT}, {"--limit": "--seconds"}
OLD_COMMANDS = {name: ("dev", name) for name in ("bench-concealed", "conceal", "reveal", "schema")}
EXPLORING = ("compile", "--device", "explore")  # that command with this option is the other command
OLD_OPTIONS = {  # command -> old option -> what it is called; {} is its value
    "init": RECORD,
    "init-rig": RECORD,
    "train": RECORD,
    "validate": {**RECORD, "--out": "--html"},
    "compile": {**RECORD, "--budget": "--max-error={}x"},
    "explore": {**RECORD, "--device": "--target"},
    "build-snn": {"--target": "--output"},
    "simulate": {"--recording": ARGUMENT},
    "prove": LIMIT,
    "synthesize": LIMIT,
    "report": {"--out": "--html"},
    "compare": {"--out": "--html"},
    "board": {"--port": "--interface"},
    "dev bench-concealed run": LIMIT,
    "dev bench-concealed score": {"--rows": "--out"},
}
RESULTS = ("init", "init-rig", "dev bench-concealed make")  # whose first argument, a name, was what is --out


class Commands(TyperGroup):
    """The commands of greygate."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        for command in leaves(self).values():
            for option in command.params:
                option.opts = [*(SHORT[word] for word in option.opts if word in SHORT), *option.opts]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not ctx.resilient_parsing:
            args = spelt(self, args)
            once_each(self, args)
        return super().parse_args(ctx, args)

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


def spelt(root: Any, given: list[str]) -> list[str]:
    """The arguments of `greygate` as they are called; if they were others, a line on stderr says so."""
    args = [*OLD_COMMANDS.get(given[0], given[:1]), *given[1:]] if given else []
    known = leaves(root)
    name = next((n for n in known if n.split() == args[: len(n.split())]), None)
    if name is not None:
        args = _of(name, args[len(name.split()) :], known)
    if args != given:
        say(f"greygate: an old spelling; it is called: greygate {shlex.join(args)}")
    return args


def once_each(root: Any, args: list[str]) -> None:
    """Raise BadParameter where an option of one value is given twice: the parser would take the last."""
    known = leaves(root)
    name = next((n for n in known if n.split() == args[: len(n.split())]), None)
    if name is None:
        return
    given = [word for word, _, _ in _words(args[: args.index("--") if "--" in args else len(args)], known[name])]
    for option in known[name].params:
        one = option.param_type_name == "option" and not (option.multiple or getattr(option, "is_flag", False))
        if one and sum(word in option.opts for word in given) > 1:
            raise typer.BadParameter(f"{option.opts[-1]} is given twice; it has one value")


def _of(name: str, args: list[str], known: dict[str, Any]) -> list[str]:
    """A command and its arguments, as they are called."""
    ends = args.index("--") if "--" in args else len(args)
    found = [*_words(args[:ends], known[name])]
    command, option, other = EXPLORING
    called = other if name == command and any(word == option for word, _, _ in found) else name
    renamed, slots = OLD_OPTIONS.get(called, {}), [p for p in known[called].params if p.param_type_name == "argument"]
    moved = [value for word, value, _ in found if word and renamed.get(word) == ARGUMENT]
    arguments = [value for word, value, _ in found if not word] + moved
    options = [w for word, value, written in found if word for w in _option(renamed, word, value, written)]
    named = {"--out", "-o"} & {word for word, _, _ in found}
    if name in RESULTS and not named and len(arguments) > len(slots) and not (slots and Path(arguments[0]).suffix):
        options += ["--out", arguments.pop(0)]
    elif not any(word in renamed for word, _, _ in found):
        return [*name.split(), *args]
    return [*called.split(), *arguments, *options, *args[ends:]]


def _option(renamed: dict[str, str], word: str, value: str, written: list[str]) -> list[str]:
    """An option as it is called; nothing of one that is an argument."""
    new = renamed.get(word)
    if new is None:
        return written
    return [new.format(value)] if "{}" in new else [new, value] if new else []


def _words(args: list[str], command: Any) -> Iterator[tuple[str, str, list[str]]]:
    """Option, value and both as they are written; an argument is a value alone."""
    flags = {word for p in command.params for word in (*p.opts, *p.secondary_opts) if getattr(p, "is_flag", False)}
    left = iter(args)
    for word in left:
        name, equals, value = word.partition("=")
        if len(word) < 2 or word[0] != "-":
            yield ARGUMENT, word, [word]
        elif equals or word in flags | {"--help"} or (word[1] != "-" and len(word) > 2):
            yield name, value, [word]
        else:
            after = [*islice(left, 1)]
            yield word if after else word + "=", "".join(after), [word, *after]
