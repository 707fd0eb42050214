"""One grammar of the command line: one word, one meaning; an old one is refused, with what it is called."""

import re
import typing
from pathlib import Path

import pytest
import typer
from test_invocations import callbacks

from greygate import cli
from greygate.cli.grammar import SHORT, leaves

ROOT = typer.main.get_command(cli.app)
COMMANDS = leaves(ROOT)
HINTS = {name: typing.get_type_hints(written) for name, written in callbacks(cli.app).items()}


def kind(hint):
    """The type of an option, whether it may be left out or given several times."""
    inner = [one for one in typing.get_args(hint) if one is not type(None)]
    return kind(inner[0]) if inner else hint


def options():
    for command, entry in COMMANDS.items():
        for option in entry.params:
            if option.param_type_name == "option":
                yield command, option, kind(HINTS[command][option.name])


def test_a_word_has_one_type_one_meaning_and_one_short_form():
    found = {}
    for command, option, of in options():
        word = next(w for w in option.opts if w.startswith("--"))
        assert [w for w in option.opts if w != word] == ([SHORT[word]] if word in SHORT else []), command
        if word not in ("--out", "--html"):
            found.setdefault(word, set()).add((of, option.help))
    assert not {word: told for word, told in found.items() if len(told) > 1}


def test_a_page_is_html_and_a_result_is_out():
    for command, option, of in options():
        page = "html" in f"{option.metavar} {option.help}".lower()
        assert page == ("--html" in option.opts), command
        if {"--html", "--out"} & {*option.opts}:
            assert of is Path, command


def test_a_recording_is_an_argument():
    role = {"--held", "--test"}  # recordings that judge
    for command, option, _ in options():
        reads = re.search(r"record(ing)?\b", " ".join(option.opts)) or option.metavar == "FILE.csv"
        assert not reads or {"--out", *role} & {*option.opts}, command


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("train a.toml --record b.csv", "an argument"),
        ("simulate rig --recording=a.csv", "an argument"),
        ("compile a --budget 1.05", "--max-error"),
        ("compile a --device up5k", "`greygate explore --target`"),
        ("build-snn a.toml b.csv --target y", "--output"),
        ("prove b --limit 3", "--seconds"),
        ("report b --out page.html", "--html"),
        ("board icebreaker b --port spi", "--interface"),
        ("conceal tank", "`greygate dev conceal`"),
    ],
)
def test_an_old_spelling_is_refused_in_a_line_with_what_it_is_called(old, new, greygate):
    code, printed, error = greygate(*old.split())
    assert (code, printed, error.count("\n")) == (2, "", 1)
    assert error.endswith(f" (it is called {new} now)\n")


@pytest.mark.parametrize("never", ["verify b --target up5k", "verify b --out c", "look a.csv --rows 3", "nothing"])
def test_what_was_never_a_word_of_a_command_has_no_other_name(never, greygate):
    code, _, error = greygate(*never.split())
    assert code == 2
    assert error.startswith("greygate: No such ")
    assert "called" not in error


def test_help_is_a_line_a_command_under_headings():
    for words in ([], ["dev"], ["export"], ["dev", "bench-concealed"]):
        command = ROOT
        for word in words:
            command = command.commands[word]
        told = command.get_help(command.make_context("greygate", [], resilient_parsing=True))
        rows = told.split("--help", 1)[1].splitlines()[1:]
        assert not [row for row in rows if row.endswith("...") or row.startswith("    ")]
