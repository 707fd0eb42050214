"""What a folder that came by mail does to the machine of whoever opens it: nothing."""

import gzip
import os
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import pytest
from checking import POSIX

from greygate import project
from greygate.contents import contents
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.files import manifest, replacing_folder
from greygate.hardware import verify
from greygate.hardware.build import Project
from greygate.mismatch import effects, rig, simulation
from greygate.mismatch.concealed.conceal import sealed
from greygate.models.network import Network
from greygate.models.training.levenberg import Checkpoint
from greygate.plants import table
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import read_csv
from greygate.plants.table import read_table
from greygate.project import verify_project


@pytest.mark.parametrize("name", ["x.d", "Makefile", "GNUmakefile", "sitecustomize.py", "deep/bench"])
def test_a_file_that_make_may_run_is_refused_before_a_verification(build, name, monkeypatch):
    strange = build / "simulation" / "parallel" / "build" / name
    strange.parent.mkdir(parents=True)
    strange.write_text("X := $(shell id)\n")
    monkeypatch.setattr(project, "verify_many", lambda *a: pytest.fail("simulated"))
    with pytest.raises(InputError, match="greygate verify did not write"):
        verify_project(Project.open(build))
    assert strange.exists()


@pytest.mark.parametrize("name", ["bench", "Vtop.mk", "Vtop__ALL.o", "verilated.o", "verilated.d"])
def test_what_an_earlier_verification_built_is_never_run_again(build, name, monkeypatch):
    strange = build / "simulation" / "parallel" / "build" / name
    strange.parent.mkdir(parents=True)
    strange.write_text("X := $(shell id)\n")

    def simulated(*arguments):
        raise InputError(f"there is {strange.exists()}")

    monkeypatch.setattr(project, "verify_many", simulated)
    with pytest.raises(InputError, match="there is False"):
        verify_project(Project.open(build))


def test_workers_import_nothing_from_the_folder_in_which_greygate_is_started(tmp_path):
    (tmp_path / "joblib.py").write_text("open('ran', 'w')")
    greygate = Path(sys.executable).with_name("greygate")
    command = [greygate, "diagnose", "one", "two", "--jobs", "2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "two: not diagnosed" in done.stdout
    assert not (tmp_path / "ran").exists()


READERS = {  # of what a stranger sends, with the name that it reads
    "recording": ("a.csv", lambda folder: read_csv(folder / "a.csv")),
    "rig": ("rig.toml", rig.load),
    "effects": ("effects.toml", lambda folder: effects.read(folder / "effects.toml")),
    "diagnosis": ("diagnosis.json", lambda folder: simulation.read(folder / "diagnosis.json")),
    "network": ("n.toml", lambda folder: Network.load(folder / "n.toml")),
    "weights": ("n.safetensors", lambda folder: Network.load(folder / "n.toml")),
    "program": ("program.json", lambda folder: Program.load(folder / "program.json")),
    "build": ("compile.json", Project.open),
    "manifest": ("manifest.json", lambda folder: manifest(folder, "compile")),
    "seal": ("sealed.json.sha256", sealed),
    "checkpoint": ("n.checkpoint", lambda folder: Checkpoint.load(folder / "n.checkpoint", "key")),
}


@pytest.mark.parametrize("kind", [pytest.param("pipe", marks=POSIX), "endless", "sparse"])
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_plain_file_of_a_bounded_size_is_refused_at_once(reader, kind, tmp_path):
    name, read = READERS[reader]
    if reader == "weights":
        (tmp_path / "n.toml").touch()
    if kind == "pipe":
        os.mkfifo(tmp_path / name)
    elif kind == "endless":
        (tmp_path / name).symlink_to("/dev/zero")
    else:
        (tmp_path / name).touch()
        os.truncate(tmp_path / name, 1 << 36)
    with pytest.raises(InputError):
        read(tmp_path)


def test_a_file_of_the_largest_size_is_read_and_one_byte_more_is_not(tmp_path):
    (tmp_path / "a").write_bytes(b"1234")
    assert contents(tmp_path / "a", 4) == b"1234"
    with pytest.raises(OSError, match="larger than 3 bytes"):
        contents(tmp_path / "a", 3)


def test_a_journal_that_a_stranger_put_beside_a_folder_replaces_nothing(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.docx").write_text("years of work")
    (tmp_path / ".mine.greygate-commit").touch()
    (tmp_path / ".mine.greygate-new").mkdir()
    with pytest.raises(InputError, match=r"thesis\.docx"):
        Project.open(tmp_path / "mine")
    assert (tmp_path / "mine" / "thesis.docx").read_text() == "years of work"


@POSIX
def test_a_lock_that_is_a_pipe_holds_nobody_up(tmp_path):
    os.mkfifo(tmp_path / ".b.greygate-lock")
    with replacing_folder(tmp_path / "b", "compile") as new:
        (new / "a").touch()
    assert sorted(os.listdir(tmp_path)) == ["b"]


def test_no_name_of_a_folder_reaches_the_makefile_of_a_verification(build, monkeypatch):
    named = build.rename(build.with_name("a;id>ran;$(id>ran)"))
    commands = []

    def run_logged(command, log, environment, where):
        commands.append(command)
        if len(commands) == 2:
            raise InputError("make was called")
        (where / "Vtop.h").touch()

    monkeypatch.setattr(verify, "run_logged", run_logged)
    with pytest.raises(InputError, match="make was called"):
        verify.verify_many([Project.open(named).case("parallel")], named / "simulation" / "parallel", 1)
    assert [Path(command[0]).name for command in commands] == ["verilator", "make"]
    assert not [part for command in commands for part in command if "ran" in part.split("/site-packages/")[0]]


def test_a_path_that_is_no_text_is_printed_all_the_same(compiled, tmp_path):
    out = os.fsencode(tmp_path) + b"/bad\xff.csv"
    code = "import sys; sys.argv[0] = 'greygate'\nfrom greygate.cli import run\nrun()"
    command = [
        sys.executable,
        "-P",
        "-c",
        code,
        "emulate",
        str(compiled),
        str(compiled.with_name("a.csv")),
        "--out",
        out,
    ]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONUTF8": "1"})
    assert done.returncode == 0, done.stderr
    assert "bad\\udcff.csv" in done.stdout


def test_a_header_of_100000_columns_takes_no_square_of_their_number(tmp_path):
    names = [f"c{i}" for i in range(100_000)]
    (tmp_path / "a.csv").write_text(f"{','.join(names)}\n{','.join(['0'] * len(names))}\n")
    start = time.process_time()
    assert read_table(tmp_path / "a.csv").header == names
    assert time.process_time() - start < 5  # s; comparing all pairs takes a minute


@pytest.mark.parametrize("header", ["c{}_m", "c{} [mm]"])
def test_a_recording_of_50000_channels_takes_no_square_of_their_number(header, tmp_path):
    names = ["t_s", *map(header.format, range(50_000))]
    rows = "".join(f"{k},{','.join('1' * 50_000)}\n" for k in range(2))
    (tmp_path / "a.csv").write_text(f"{','.join(names)}\n{rows}")
    start = time.process_time()
    assert len(read_recording(tmp_path / "a.csv").channels) == 50_000
    assert time.process_time() - start < 10  # s; comparing all pairs takes minutes


@pytest.mark.parametrize("name", ["a" + "_a" * 60_000, " " * 120_000 + "x", "a [" * 40_000, "a(" * 60_000])
def test_a_name_of_100000_characters_is_refused_at_once(name, tmp_path):
    (tmp_path / "a.csv").write_text(f't [s],"{name}"\n0,1\n1,2\n')
    start = time.process_time()
    with pytest.raises(InputError, match=r"characters; rename it|has no unit"):
        read_recording(tmp_path / "a.csv")
    assert time.process_time() - start < 5  # s


def test_a_small_archive_of_a_huge_recording_is_refused_without_unpacking_it(tmp_path, monkeypatch):
    monkeypatch.setattr(table, "MOST_UNPACKED", 10_000_000)
    (tmp_path / "bomb.csv").write_bytes(gzip.compress(b"t_s,x_m\n" + b"\0" * 30_000_000, 1))
    tracemalloc.start()
    with pytest.raises(InputError, match=r"bomb\.csv: unpacks to more than 10000000 bytes; unpack it"):
        read_table(tmp_path / "bomb.csv")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20_000_000
