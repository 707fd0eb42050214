"""One grammar of the command line: one word, one meaning; an old spelling works and says what it is called."""

import re
import typing
from pathlib import Path

import pytest
import typer
from test_invocations import callbacks

from greygate import cli
from greygate.cli.grammar import EXPLORING, OLD_COMMANDS, OLD_OPTIONS, RESULTS, SHORT, leaves, spelt

ROOT = typer.main.get_command(cli.app)
COMMANDS = leaves(ROOT)
HINTS = {name: typing.get_type_hints(written) for name, written in callbacks(cli.app).items()}
OLD = [(name, old) for name, table in OLD_OPTIONS.items() for old in table if old != EXPLORING[1]]


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


@pytest.mark.parametrize(("command", "old"), OLD)
def test_an_old_option_is_understood_and_told_and_not_shown(command, old, capsys):
    new = OLD_OPTIONS[command][old]
    found = spelt(ROOT, [*command.split(), "one", old, "2", f"{old}=3"])
    wanted = f"{new} {{}} {new} {{}}" if new and "{}" not in new else f"{new or '{}'} {new or '{}'}"
    assert wanted.format(2, 3) in " ".join(found)
    said = capsys.readouterr().err
    assert said == f"greygate: an old spelling; it is called: greygate {' '.join(found)}\n"
    assert old not in [word for option in COMMANDS[command].params for word in option.opts]


@pytest.mark.parametrize("old", OLD_COMMANDS)
def test_an_old_command_is_understood_and_told_and_not_shown(old, greygate):
    code, printed, error = greygate(old, "--help")
    assert (code, f" dev {old} " in printed) == (0, True)
    assert error == f"greygate: an old spelling; it is called: greygate dev {old} --help\n"
    assert old not in ROOT.commands


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("train a.toml --record=b.csv --out c", "train a.toml b.csv --out c"),
        ("train --record b.csv a.toml", "train a.toml b.csv"),
        ("compile a --budget 1.05 -o b", "compile a --max-error=1.05x -o b"),
        ("compile a --device up5k --record b.csv --max-luts 5", "explore a b.csv --target up5k --max-luts 5"),
        ("init mine --record a.csv --python --output y", "init a.csv --python --output y --out mine"),
        ("bench-concealed make b --cases 3", "dev bench-concealed make --cases 3 --out b"),
        ("conceal tank --seed 1 --out a", "dev conceal tank --seed 1 --out a"),
        ("simulate rig --as --recording --recording a.csv", "simulate rig a.csv --as --recording"),
        ("play b a.csv --port x", "play b a.csv --port x"),
        ("train a.toml --record", "train a.toml --record"),
        ("init a.csv b.csv --output y --out c", "init a.csv b.csv --output y --out c"),
        ("ci-template github a -- --record b.csv", "ci-template github a -- --record b.csv"),
        ("", ""),
        ("nobody --record a", "nobody --record a"),
    ],
)
def test_old_words_become_new_ones(old, new, capsys):
    assert spelt(ROOT, old.split()) == new.split()
    assert bool(capsys.readouterr().err) == (old != new)


def test_an_old_spelling_does_what_the_new_one_does(build, tmp_path, greygate):
    new = greygate("report", build, "-H", tmp_path / "page.html", "-J")
    old = greygate("report", build, "--out", tmp_path / "page.html", "-J")
    assert (old[:2], new[2]) == (new[:2], "")
    assert old[2].startswith("greygate: an old spelling; it is called: greygate report ")
    assert old[2].count("\n") == 1


def test_help_is_a_line_a_command_under_headings():
    for words in ([], ["dev"], ["export"], ["dev", "bench-concealed"]):
        command = ROOT
        for word in words:
            command = command.commands[word]
        told = command.get_help(command.make_context("greygate", [], resilient_parsing=True))
        rows = told.split("--help", 1)[1].splitlines()[1:]
        assert not [row for row in rows if row.endswith("...") or row.startswith("    ")]
    assert {*RESULTS} <= {*COMMANDS}


def test_two_recordings_are_no_old_spelling(greygate):
    code, _, error = greygate("init", "a.csv", "b.csv", "--output", "y")
    assert code == 2
    assert "old spelling" not in error


@pytest.mark.parametrize(
    ("words", "twice"),
    [
        ("identify a.csv --output y --output z --out o", "--output"),
        ("identify a.csv --output y -o o --out=p", "--out"),
        ("dev conceal drum --out a --out b", "--out"),
        ("identify a.csv --input u --input v --output y --out o", ""),
        ("identify a.csv --output y --out o -- --output", ""),
    ],
)
def test_a_value_that_would_be_dropped_is_refused(words, twice, greygate):
    code, _, error = greygate(*words.split())
    assert code == 2
    assert ("is given twice" in error) == bool(twice)
    assert twice in error
