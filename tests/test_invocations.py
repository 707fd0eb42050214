"""Wrong use of every command and option: one line on stderr, exit code 2, nothing on stdout, nothing written.

The sweep is drawn from the command line itself, so that a new option is tried without a line here; an option that takes
text needs its wrong texts in TEXTS.
"""

import json
import sys
import typing
from enum import Enum

import pytest
import typer
from networks import delay_line
from sweeping import every
from test_cli import recording

from benchmarks.concealed_bench.make import make
from benchmarks.concealed_bench.run import run
from greygate import cli
from greygate.cli import terminal
from greygate.cli.grammar import leaves
from greygate.machines.source import Source
from greygate.mismatch.concealed.conceal import conceal
from greygate.project import compile_project

LEAST = 400  # invocations
GOOD = {
    "app": ["folder"],
    "demo": ["cart", "--out", "new"],
    "look": ["a.csv", "--out", "new.csv"],
    "init": ["a.csv", "--output", "y", "--out", "new"],
    "init-rig": ["a.csv", "--output", "y", "--out", "new"],
    "train": ["line.toml", "a.csv", "--out", "new"],
    "compile": ["line.toml", "a.csv", "--out", "new"],
    "explore": ["line.toml", "a.csv", "--target", "up5k", "--out", "new"],
    "emulate": ["build", "a.csv", "--out", "new.csv"],
    "verify": ["build"],
    "prove": ["build"],
    "synthesize": ["build"],
    "report": ["build", "--html", "new.html"],
    "compare": ["build", "build"],
    "doctor": [],
    "dev schema": ["verify"],
    "board": ["icebreaker", "build", "--out", "new"],
    "play": ["build", "a.csv", "--port", "none"],
    "validate": ["line.toml", "a.csv", "--lags", "5", "--html", "new.html"],
    "diagnose": ["rig", "--out", "new.json"],
    "next": ["rig", "--diagnosis", "none.json", "--out", "new.csv"],
    "isolability": ["rig"],
    "simulate": ["rig", "rig/third.csv", "--out", "new.csv"],
    "augment": ["rig", "--diagnosis", "none.json", "--out", "new"],
    "dev conceal": ["cable_drum", "--seed", "1", "--out", "new"],
    "dev reveal": ["rig"],
    "build-snn": ["rig/rig.toml", "rig/identify.csv", "--out", "new"],
    "make": ["rig/rig.toml", "rig/identify.csv", "--output", "x_load", "--out", "new"],
    "identify": ["rig/identify.csv", "--input", "x_drum", "--output", "x_load", "--out", "new"],
    "export c": ["build", "--out", "new"],
    "export fmu": ["build", "--out", "new.fmu"],
    "export fusesoc": ["build", "--out", "new"],
    "export modelica": ["rig", "--out", "new.mo"],
    "export latex": ["rig", "--out", "new.tex"],
    "export mjcf": ["rig", "--out", "new.xml"],
    "ci-template": ["github", "line.toml", "--out", "new.yml", "--", "a.csv"],
    "control": ["belt_drive", "--controller", "pi", "--samples", "3"],
    "dev bench-concealed make": ["--out", "new", "--cases", "1", "--plant", "tank"],
    "dev bench-concealed run": ["bench", "--out", "new", "--tool", "nominal"],
    "dev bench-concealed score": ["bench", "answers"],
}
"""What each command takes, before it is spoilt."""

NO_TABLE = ["none.csv", "folder", "empty.csv", "binary.csv", "utf16.csv", "text.txt", "huge.csv", "\udcff.csv", ""]
NAMED = [*NO_TABLE, "=a.csv", "x=", "x=none.csv", "x=folder"]
NO_JSON = ["none.json", "folder", "empty.csv", "binary.csv", "a.csv", "null.json", "list.json", "other.json", ""]
NO_TOML = ["none.toml", "folder", "binary.csv", "text.txt", "a.csv"]
NO_NETWORK = ["nobody", "none.toml", "folder", "folder.toml", "a.csv", "rig/rig.toml", "binary.csv", ""]
NO_BUILD = ["none", "folder", "a.csv", "no_rig", "\udcff", ""]
NO_RIG = ["none", "folder", "a.csv", "build", "no_rig", "\udcff", ""]
NO_PLACE = ["a.csv/new", "a.csv/new/new"]
NO_NAME = ["", "x y", "a.csv/new", "2nd", "con"]
RANGES = ["", "u_d", "u_d=", "u_d=1", "u_d=1:", "u_d=:1", "u_d=2:1", "u_d=1:1", "u_d=nan:1", "u_d=0:inf", "u_d=a:b",
          "u_d=0:1:2", "=0:1", "nobody=0:1"]  # fmt: skip
TEXTS = {
    "record": NAMED, "held": NAMED, "recording": NO_TABLE, "diagnosis": NO_JSON, "effects": NO_TOML,
    "name": NO_NETWORK, "network": NO_NETWORK, "folder": NO_BUILD, "folders": NO_BUILD, "rig": NO_RIG, "rigs": NO_RIG,
    "out": NO_PLACE, "html": NO_PLACE, "scenario": ["v9", ""], "weights": ["guess", ""], "kind": ["none", ""],
    "effect": ["none", ""], "plant": ["none", ""], "scheduler": ["x", "tcp://127.0.0.1:1"], "ranges": RANGES,
    "max_error": ["", "%", "-1%", "nan", "1kg"], "max_latency": ["", "2", "x", "inf us"],
    "only": ["luck", ""], "architecture": ["none", ""],
    "port": ["none", "a.csv", ""], "source": NO_TABLE,
    "bench": NO_RIG, "answers": ["none", "folder", "a.csv", ""], "tool": ["none", "", "none --of them", "'"],
    "condition": ["none", ""], "secret": ["none", "folder", "binary.csv", "empty.csv", "short.txt"],
    "picture": NO_PLACE, "own": ["none", ""],
    "old": NO_BUILD, "new": NO_BUILD, "budget": NO_TOML,
    "test": NAMED, "sensor": ["nobody", ""], "target": ["nobody", ""], "machine": ["nobody", "a.csv", ""],
    "against": ["none.toml", "rig", "", "rig=none"],
    "fmu": ["none", "folder", "a.csv", "build", ""], "parameter": ["nobody", ""],
    "track": NO_TABLE, "control": NO_TABLE, "limits": RANGES, "rate": ["", "u", "u=", "u=0"],
    "noise": ["", "x", "x=-1", "x=nan"],
    "unit": ["", "u", "u=", "=V", "u=foo", "nobody=V"], "time": ["nobody", ""],
    "resample": ["", "x", "0", "-1", "nan", "inf", "1e9"],
    "block": ["none", "product", ""],
    "offset": ["nobody", "y", ""],
    "gain": ["nobody", "y", ""],
    "settle": ["x", "", "-1", "1.5", "nan", "9" * 20, "autos"],
    "model": ["none.xml", "folder", "a.csv", ""], "map": ["", "y", "y=", "=y", "y=u"],
    "init out": NO_NAME, "init-rig out": NO_NAME,
    "input": ["nobody", ""], "output": ["nobody", "x_drum", ""],
    "joint": ["", "v", "v=", "=hinge", "nobody=hinge", "v=a b"], "options": ["--nope", "--width=3", "--out=x"],
    "install": ["", "a\nb", "${{ x }}"], "app folder": ["none", "a.csv"], "ci-template accepted": ["", "../x", "/x"],
    "ci-template budget": ["", "../x", "/x", "folder", "a.csv"],
}  # fmt: skip
"""Wrong texts by the name of the option or argument, or by command and name."""

WHOLE = ["x", "", "1.5", "nan", "inf", "-1", "1e30", "9" * 20, "9" * 5000]
FLAG = ["1", "no"]
REAL = ["x", "", "nan", "-inf", "-1", "1,5", "0x10"]
OTHERS = [
    ["init", *GOOD["init"][:-1], "none/new"],
    ["nobody"], ["--nope"], ["--version=1"], ["train", "--version"], ["-x"], [""],
    ["train", "crane", "a.csv"], ["train", "crane", "--held", "a.csv"], ["train", "crane", "--epochs", "3"],
    ["train", "crane", "--no-narx"], ["train", "crane", "--out", "none"], ["train", "line.toml", "a.csv"],
    ["train", "list", "x"], ["train", *GOOD["train"], "--held", "a.csv"],
    ["train", *GOOD["train"], "--held", "x=a.csv"],
    ["train", *GOOD["train"], "a.csv"], ["train", *GOOD["train"], "slow.csv"],
    ["train", *GOOD["train"], "--settle", "60"], ["train", *GOOD["train"], "--settle", "1000000000"],
    ["train", *GOOD["train"], "--shooting", "31"], ["train", *GOOD["train"], "--shooting", "1000000000"],
    ["train", *GOOD["train"], "--tail", "1"], ["train", *GOOD["train"], "--tail", "2"],
    ["train", *GOOD["train"], "--tail", "0.999"], ["train", *GOOD["train"], "--decay", "inf"],
    ["train", *GOOD["train"], "--decay", "1e400"], ["train", *GOOD["train"], "--seconds", "0"],
    ["train", *GOOD["train"], "--epochs", "0"], ["train", *GOOD["train"], "--shooting", "0"],
    ["compile", *GOOD["compile"], "--width", "3"], ["compile", *GOOD["compile"], "--width", "33"],
    ["compile", *GOOD["compile"], "--finer", "29"], ["compile", *GOOD["compile"], "--finer", "17"],
    ["compile", *GOOD["compile"], "--max-error", "1x"], ["compile", *GOOD["compile"], "--max-error", "5%"],
    ["compile", *GOOD["compile"], "--prune", "0.99"], ["compile", *GOOD["compile"], "--prune", "inf"],
    ["compile", *GOOD["compile"], "--macs", "0"], ["compile", *GOOD["compile"], "--macs", "257"],
    ["compile", *GOOD["compile"], "--held", "slow.csv"], ["compile", *GOOD["compile"], "slow.csv"],
    ["compile", *GOOD["compile"], "--held", "a.csv", "--prune", "1.1"], ["compile", "line.toml", "--out", "new"],
    ["compile", *GOOD["compile"][:-1], "folder"], ["compile", *GOOD["compile"][:-1], "a.csv"],
    ["report"], ["report", "--all", "build", "build"], ["report", "build", "none"],
    ["validate", "line.toml", "a.csv"], ["validate", *GOOD["validate"], "--settle", "60"],
    ["validate", "line.toml"], ["validate", "crane", "training=a.csv"],
    ["diagnose", "rig", "rig"], ["diagnose", "rig", "no_rig", "--out", "none"], ["diagnose", "rig", "--jobs", "0"],
    ["diagnose", "rig", "--jobs", "1025"], ["diagnose", "rig", "--backend", "dask"],
    ["isolability", "rig", "--range", "u_d=0:1", "--range", "u_d=0:2"],
    ["synthesize", "build", "--target", "xc7a35t", "--clock-rate"], ["synthesize", "build", "--keep"],
    ["prove", "build", "--only", "luck"],
    ["synthesize", "build", "--seconds", "0"], ["simulate", *GOOD["simulate"][:-2]], ["augment", "rig", "--out", "new"],
    ["dev", "conceal", "cable_drum", "--out", "new"], ["dev", "conceal", "cable_drum", "--seed", "1"],
    ["dev", "conceal", *GOOD["dev conceal"], "--kind", "clean", "--effect", "speed_slip"],
    ["dev", "conceal", *GOOD["dev conceal"], "--seed", "2147483648"],
    ["dev", "conceal", *GOOD["dev conceal"][:-1], "folder"],
    ["verify", "build", "--seed", "2147483648"],
    ["build-snn", *GOOD["build-snn"], "--output", "x_drum"], ["build-snn", *GOOD["build-snn"], "--seconds", "0"],
    ["build-snn", "rig/rig.toml", "a.csv", "--out", "new"], ["build-snn", "line.toml", "a.csv", "--out", "new"],
    ["make", "rig/rig.toml", "--target", "ice40", "--out", "new"], ["make", *GOOD["make"], "--seconds", "0"],
    ["make", *GOOD["make"][:-1], "folder"], ["make", "line.toml", "a.csv", "--out", "new"],
    ["identify", *GOOD["identify"], "--settle", "1000000000"], ["identify", *GOOD["identify"], "--test", "a.csv"],
    ["identify", *GOOD["identify"], "--test", "rig/identify.csv"], ["identify", *GOOD["identify"][:-1], "folder"],
    ["identify", "rig/identify.csv", "--output", "x_load", "--out", "new"],
    ["control", "belt_drive", "--controller", "pi", "--place", "rtl"], ["control", "crane"],
    ["control", "rig", "--limits", "u_d=0:1"], ["control", "rig", "--track", "a.csv", "--limits", "u_d=0:1"],
    ["control", "line.toml", "--track", "a.csv"], ["look", "a.csv", "--settle", "10"],
    *(["look", "a.csv", "--against", m] for m in ("none.toml", "rig", "folder", "", "=", "rig=none", "build=a.csv")),
]  # fmt: skip


def wrong(command: str, name: str, hint) -> list[str]:
    """Values that an option or argument of that name and type cannot have."""
    if texts := TEXTS.get(f"{command} {name}"):
        return texts
    kinds = {hint, *typing.get_args(hint)}
    if any(isinstance(kind, type) and issubclass(kind, Enum) for kind in kinds):
        return ["none", "", "PARALLEL"]
    return FLAG if bool in kinds else WHOLE if int in kinds else REAL if float in kinds else TEXTS[name]


def commands() -> dict:
    """Command -> (its parts, the types of its parameters); one of a group is "GROUP COMMAND"."""
    entries, written = leaves(typer.main.get_command(cli.app)), callbacks(cli.app)
    return {name: (entry, typing.get_type_hints(written[name])) for name, entry in entries.items()}


def callbacks(group: typer.Typer, path: str = "") -> dict:
    found = {f"{path}{info.name or info.callback.__name__}": info.callback for info in group.registered_commands}
    for inner in group.registered_groups:
        found |= callbacks(inner.typer_instance, f"{path}{inner.name} ")
    return found


def sweep() -> list[list[str]]:
    """Every option of every command without a value, with a wrong one, misspelt; arguments missing, wrong, too many."""
    found = []
    for command, (entry, hints) in commands().items():
        words = command.split()
        good = [*words, *GOOD[command]]
        arguments = [p for p in entry.params if p.param_type_name == "argument"]
        for at, argument in enumerate(arguments, len(words)):
            values = wrong(command, argument.name, hints[argument.name])
            found += [[*good[:at], value, *good[at + 1 :]] for value in values]
            found += [[*words, *good[at + 1 :]]] if argument.required else []
        last = good.index("--") if "--" in good else len(good)
        for option in [p for p in entry.params if p not in arguments]:
            values, word = wrong(command, option.name, hints[option.name]), option.opts[-1]
            spoilt = [name + "x" for name in (*option.opts, *option.secondary_opts) if name.startswith("--")]
            spoilt += [f"{word}={value}" for value in values]
            found += [[*good[:last], text, *good[last:]] for text in spoilt]
            found += [] if option.is_flag else [[*good, word]]
        if all(argument.nargs == 1 for argument in arguments):
            found.append([*good, "toomuch"])
    return found


ALL = [*sweep(), *OTHERS]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A folder with whatever a command may be pointed at."""
    folder = tmp_path_factory.mktemp("world")
    delay_line().save(folder / "line")
    recording(folder / "a.csv")
    recording(folder / "slow.csv", dt=1e-2)
    (folder / "folder").mkdir()
    (folder / "folder" / "notes.txt").write_text("mine")
    (folder / "folder.toml").mkdir()
    (folder / "empty.csv").touch()
    (folder / "binary.csv").write_bytes(bytes(range(256)))
    (folder / "utf16.csv").write_bytes((folder / "a.csv").read_text().encode("utf-16")[:-1])
    (folder / "text.txt").write_text("Dear reader,\nthis is no table.\n")
    (folder / "huge.csv").write_text("t_s,u_V,y_m\n" + "1e308,1e308,1e308\n" * 60)
    for name, content in (("null", None), ("list", [1]), ("other", {"schema": "other"})):
        (folder / f"{name}.json").write_text(json.dumps(content))
    source = Source(str(folder / "line.toml"), {"a": str(folder / "a.csv")})
    compile_project(source, folder / "build", source.formats())
    conceal("cable_drum", 3, folder / "rig", kind="clean")
    for table in (folder / "rig").glob("*.csv"):
        table.write_text("".join(table.read_text().splitlines(keepends=True)[:3001]))
    make(folder / "bench", 1, plants=["tank"])
    run(folder / "bench", "nominal", folder / "answers", 60.0)
    (folder / "short.txt").write_text("secret")
    (folder / "no_rig").mkdir()
    (folder / "no_rig" / "rig.toml").write_text("plant = 5\n")
    return folder


def snapshot(folder) -> dict:
    return {path: path.lstat().st_mtime_ns for path in sorted(folder.rglob("*"))}


def of(command: str) -> list[list[str]]:
    """Its wrong invocations; of "", those of no command."""
    return [words for words in ALL if command == next((c for c in GOOD if words[: len(c.split())] == c.split()), "")]


@pytest.mark.parametrize("command", ["", *GOOD])
def test_wrong_use_is_one_line_with_exit_code_2_and_nothing_is_written(command, world, greygate, monkeypatch):
    monkeypatch.chdir(world)
    monkeypatch.setattr(terminal, "SILENCE", 600.0)  # s: a busy machine, on which it takes longer, prints progress
    before = snapshot(world)

    def check(arguments):
        code, printed, error = greygate(*arguments)
        assert (code, printed) == (2, ""), error
        assert error.startswith("greygate: "), error
        assert (error.count("\n"), error[-1]) == (1, "\n"), error
        assert "Traceback" not in error
        assert all(c.isprintable() for c in error[:-1])
        assert snapshot(world) == before

    every(of(command), check, lambda words: " ".join(ascii(word)[1:-1][:40] for word in words))


def test_every_command_is_swept_and_400_invocations_at_least():
    assert set(GOOD) == set(commands())
    assert len({tuple(a) for a in ALL}) >= LEAST
    assert sum(len(of(command)) for command in ["", *GOOD]) == len(ALL)
    print(f"{len(ALL)} invocations")


@pytest.mark.parametrize("command", commands())
def test_every_command_takes_json(command):
    entry, _ = commands()[command]
    assert "--json" in [word for option in entry.params for word in option.opts]


def test_a_command_line_of_nothing_is_answered_by_help(greygate):
    code, printed, error = greygate()
    assert code == 2
    assert "Hardware:" in printed + error


@pytest.mark.parametrize(
    ("raised", "code", "line"),
    [
        (KeyboardInterrupt(), 130, "greygate: interrupted\n"),
        (MemoryError(), 2, "greygate: out of memory; give fewer or shorter recordings\n"),
        (PermissionError(13, "Permission denied", "a.csv"), 2, "greygate: a.csv: Permission denied; check the path"),
        (OSError(28, "No space left on device"), 2, "greygate: a file: No space left on device; check"),
    ],
)
def test_whatever_ends_a_command_is_one_line(raised, code, line, world, greygate, monkeypatch):
    def fail(*arguments, **options):
        raise raised

    monkeypatch.chdir(world)
    monkeypatch.setattr("greygate.project.compile_project", fail)
    found, printed, error = greygate("compile", *GOOD["compile"])
    assert (found, printed) == (code, "")
    assert error.startswith(line)
    assert error.count("\n") == 1


def test_a_mistake_of_ours_is_not_hidden(world, greygate, monkeypatch):
    def fail(*arguments, **options):
        raise ZeroDivisionError

    monkeypatch.chdir(world)
    monkeypatch.setattr("greygate.project.compile_project", fail)
    monkeypatch.setattr(sys, "argv", ["greygate", "compile", *GOOD["compile"]])
    with pytest.raises(ZeroDivisionError):
        cli.run()
