"""Files and folders are written whole or not at all, by one at a time, over nothing that greygate did not write."""

import errno
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from networks import delay_line

from greygate import files, system
from greygate.errors import InputError
from greygate.files import locked, manifest, read_all, replacing, replacing_all, replacing_folder, write_manifest

GREYGATE = str(Path(sys.executable).with_name("greygate"))


def put(folder: Path, text: str = "new", kind: str = "compile", later: str = "(?!)") -> None:
    with replacing_folder(folder, kind, later) as new:
        (new / "deep").mkdir()
        (new / "deep" / "a.txt").write_text(text)


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_folder_lists_what_was_written_into_it_and_is_replaced_by_the_next(tmp_path):
    put(tmp_path / "b", "old")
    assert set(manifest(tmp_path / "b", "compile")) == {"deep/a.txt"}
    put(tmp_path / "b")
    assert set(tree(tmp_path)) == {"b/deep/a.txt", "b/manifest.json"}
    assert (tmp_path / "b" / "deep" / "a.txt").read_text() == "new"


@pytest.mark.parametrize("where", ["thesis.docx", "deep/thesis.docx", "deep/more/thesis.docx", ".thesis"])
def test_a_file_that_the_manifest_does_not_list_is_named_and_never_touched(tmp_path, where):
    put(tmp_path / "b", "old")
    (tmp_path / "b" / where).parent.mkdir(exist_ok=True)
    (tmp_path / "b" / where).write_text("years")
    before = tree(tmp_path)
    with pytest.raises(InputError, match=f"holds other files .{where}"):
        put(tmp_path / "b")
    assert tree(tmp_path) == before


def test_a_file_that_comes_while_the_folder_is_made_is_never_touched(tmp_path):
    put(tmp_path / "b", "old")
    with pytest.raises(InputError, match="thesis"), replacing_folder(tmp_path / "b", "compile"):
        (tmp_path / "b" / "thesis.docx").write_text("years")
    assert set(tree(tmp_path)) == {"b/deep/a.txt", "b/manifest.json", "b/thesis.docx"}


def test_what_a_person_changed_or_linked_is_not_replaced(tmp_path):
    put(tmp_path / "b", "old")
    (tmp_path / "b" / "deep" / "a.txt").write_text("mended by hand")
    with pytest.raises(InputError, match=r"deep/a\.txt"):
        put(tmp_path / "b")
    put(tmp_path / "c", "old")
    (tmp_path / "c" / "link").symlink_to(tmp_path)
    with pytest.raises(InputError, match="link"):
        put(tmp_path / "c")


def test_what_other_commands_add_goes_with_the_folder(tmp_path):
    put(tmp_path / "b")
    (tmp_path / "b" / "verify.json").write_text("{}")
    put(tmp_path / "b", later=r"verify\.json")
    assert set(tree(tmp_path)) == {"b/deep/a.txt", "b/manifest.json"}


def test_a_folder_of_another_command_or_of_an_earlier_version_is_refused(tmp_path):
    put(tmp_path / "b", kind="conceal")
    with pytest.raises(InputError, match="written by greygate 'conceal', not by compile"):
        put(tmp_path / "b")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "compile.json").write_text("{}")
    with pytest.raises(InputError, match=r"compile.json.: no manifest.json, so not what greygate compile wrote"):
        put(tmp_path / "old")


@pytest.mark.parametrize("name", ["../out.txt", "/etc/passwd", "a/../../b", "", ".", "a//b", "./a"])
def test_a_manifest_names_nothing_outside_its_folder(tmp_path, name):
    put(tmp_path / "b")
    path = tmp_path / "b" / "manifest.json"
    found = json.loads(path.read_text())
    path.write_text(json.dumps(found | {"files": found["files"] | {name: "0" * 64}}))
    with pytest.raises(InputError, match="not a manifest of this greygate"):
        put(tmp_path / "b")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "{}",
        "null",
        '{"schema": 1, "kind": 5, "files": {"a": 3}}',
        "[" * 100_000,
        '{"files": []}',
        "\xff",
    ],
)
def test_a_broken_manifest_is_one_line(tmp_path, text):
    put(tmp_path / "b")
    (tmp_path / "b" / "manifest.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match="manifest") as refused:
        put(tmp_path / "b")
    assert "\n" not in str(refused.value)


def test_places_that_are_no_folder_of_ones_own_are_refused(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "file").write_text("mine")
    repository = Path(files.__file__).resolve().parents[1]
    before = tree(tmp_path)
    for place, why in (
        (".", "the current folder"),
        ("..", "the current folder"),
        ("../here", "the current folder"),
        ("/", "is or holds"),
        (Path.home(), "is or holds"),
        (repository, "is or holds"),
        (tmp_path / "link", "is a link"),
        (tmp_path / "file", "in the way"),
        (tmp_path / "file" / "b", "cannot make this folder"),
        (tmp_path / ("x" * 300), "File name too long"),
    ):
        with pytest.raises(InputError, match=why):
            put(Path(place))
    assert tree(tmp_path) == before


def test_a_file_is_not_written_over_a_link_a_device_or_a_folder(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "real")
    for path in (tmp_path / "link", tmp_path, Path("/dev/null"), Path(".")):
        with pytest.raises(InputError, match="is not a plain file"), replacing(path) as new:
            new.write_text("x")
    assert [p.name for p in tmp_path.iterdir()] == ["link"]
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize("ending", [KeyboardInterrupt, SystemExit, InputError("x"), OSError(28, "No space left")])
def test_whatever_ends_a_writer_leaves_the_old_and_no_strays(tmp_path, ending):
    put(tmp_path / "b", "old")
    (tmp_path / "f").write_text("old")
    before = tree(tmp_path)

    def write(writer) -> None:
        with writer as new:
            (new / "half" if new.is_dir() else new).write_text("x")
            raise ending

    for writer in (
        replacing_folder(tmp_path / "b", "compile"),
        replacing_folder(tmp_path / "n" / "m" / "b", "compile"),
        replacing(tmp_path / "f"),
    ):
        with pytest.raises((KeyboardInterrupt, SystemExit, InputError)):
            write(writer)
    assert tree(tmp_path) == before
    assert not (tmp_path / "n").exists()


def test_of_two_writers_the_second_is_told_to_wait(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "PATIENCE", 0.0)
    with (
        locked(tmp_path / "b"),
        pytest.raises(InputError, match="b: another greygate is writing it; wait until it has finished"),
    ):
        put(tmp_path / "b")
    with locked(tmp_path / "f"), pytest.raises(InputError, match="another greygate"), replacing(tmp_path / "f") as new:
        new.write_text("x")
    assert not any(tmp_path.iterdir())


def test_many_writers_of_one_folder_leave_one_whole_result_and_no_strays(tmp_path):
    ended, start = [], threading.Barrier(8)

    def write(text: str) -> None:
        start.wait()
        try:
            put(tmp_path / "b", text)
            ended.append(text)
        except InputError as error:
            ended.append(str(error))

    threads = [threading.Thread(target=write, args=(str(k),)) for k in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    done = [e for e in ended if len(e) == 1]
    assert done
    assert all("another greygate is writing" in e for e in ended if len(e) > 1)
    assert (tmp_path / "b" / "deep" / "a.txt").read_text() in done
    assert set(tree(tmp_path)) == {"b/deep/a.txt", "b/manifest.json"}


def test_the_lock_of_a_killed_writer_holds_nobody_up(tmp_path):
    code = (
        "import sys, time; from greygate.files import replacing_folder\n"
        "with replacing_folder(sys.argv[1], 'compile') as new:\n"
        "    (new / 'half').write_text('x'); print('in', flush=True); time.sleep(60)"
    )
    writer = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "b")], stdout=subprocess.PIPE)
    assert writer.stdout.readline() == b"in\n"
    with pytest.raises(InputError, match="another greygate is writing"):
        put(tmp_path / "b")
    writer.kill()
    writer.wait()
    writer.stdout.close()
    assert {p.name for p in tmp_path.iterdir()} == {".b.greygate-lock", ".b.greygate-new"}
    put(tmp_path / "b")
    assert set(tree(tmp_path)) == {"b/deep/a.txt", "b/manifest.json"}


def test_a_reader_never_sees_half_of_two_files_that_belong_together(tmp_path):
    pair, stop = [tmp_path / "a", tmp_path / "b"], threading.Event()

    def write() -> None:
        count = 0
        while not stop.is_set():
            with replacing_all(pair, durable=False) as new:
                for path in new:
                    path.write_text(str(count))
            count += 1

    with replacing_all(pair) as new:
        for path in new:
            path.write_text("0")
    writer = threading.Thread(target=write)
    writer.start()
    try:
        until, seen = time.monotonic() + 1, set()
        while time.monotonic() < until or (len(seen) < 2 and time.monotonic() < until + 30):  # a busy machine is slow
            first, second = read_all(pair)
            assert first == second
            seen.add(first)
    finally:
        stop.set()
        writer.join()
    assert len(seen) > 1


def test_a_disk_that_is_full_is_one_line_and_the_old_build_stays(tmp_path):
    """RLIMIT_FSIZE, as `ulimit -f` sets it."""
    resource = pytest.importorskip("resource")
    delay_line().save(tmp_path / "line")
    rows = "".join(f"{k * 1e-3:.3f},{k % 5},{k % 3}\n" for k in range(50))
    (tmp_path / "a.csv").write_text("t_s,u_V,y_m\n" + rows)
    command = [GREYGATE, "compile", "line.toml", "a.csv", "--out", "b"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    before = tree(tmp_path)
    full = subprocess.run(
        [*command, "--macs", "2"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048)),
    )
    assert (full.returncode, full.stdout) == (2, "")
    assert full.stderr == "greygate: b: cannot make this folder (File too large); choose another folder\n"
    assert tree(tmp_path) == before


def test_without_the_exchange_of_names_a_folder_is_replaced_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "exchange", lambda one, other: False)
    put(tmp_path / "b", "old")
    put(tmp_path / "b")
    assert (tmp_path / "b" / "deep" / "a.txt").read_text() == "new"
    assert set(tree(tmp_path)) == {"b/deep/a.txt", "b/manifest.json"}


def test_a_file_system_that_cannot_exchange_says_so(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    with pytest.raises(OSError, match="No such file"):
        files.exchange(tmp_path / "a", tmp_path / "none")
    monkeypatch.setattr(system.ctypes, "CDLL", lambda *a, **o: object())
    assert files.exchange(tmp_path / "a", tmp_path / "none") is False


def test_a_manifest_made_anew_lists_what_is_there(tmp_path):
    put(tmp_path / "b")
    (tmp_path / "b" / "more").write_text("x")
    write_manifest(tmp_path / "b", "compile")
    assert set(manifest(tmp_path / "b", "compile")) == {"deep/a.txt", "more"}
    assert os.listdir(tmp_path) == ["b"]


def test_one_name_for_two_files_is_refused_before_either_is_written(tmp_path):
    with (
        pytest.raises(InputError, match="two files would have this name"),
        replacing_all([tmp_path / "a", tmp_path / "a"]),
    ):
        pytest.fail("the block ran")
    assert list(tmp_path.iterdir()) == []


def test_where_no_room_is_left_for_temporary_files_their_folder_is_named(monkeypatch):
    with pytest.raises(InputError, match=r"temporary files: .* TMPDIR .*No space left"), files.scratch():
        raise OSError(errno.ENOSPC, "No space left on device", "x")
    left = os.statvfs("/")
    monkeypatch.setattr(os, "statvfs", lambda place: os.statvfs_result([*left[:4], 0, *left[5:]]))
    full = r"temporary files: .* has 0 kB left; .* TMPDIR .* \(x.csv: is short\)"
    with pytest.raises(InputError, match=full), files.scratch():
        raise InputError("x.csv: is short")


def test_a_failure_that_is_not_for_lack_of_room_stays_as_it_is():
    with pytest.raises(InputError, match=r"^x\.csv: is short$"), files.scratch() as place:
        raise InputError("x.csv: is short")
    assert not place.exists()
