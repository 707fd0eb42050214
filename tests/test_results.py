"""Every stored result says which command found it, on which commit and day, and which code it measures; the runner."""

import ast
import re
import subprocess
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Annotated

import pytest

from benchmarks import made, stale
from benchmarks.__main__ import called, kept_parts, known, missing

ROOT = Path(__file__).parents[1]
INDEX = made.index()


def test_every_stored_file_is_in_the_index():
    lost = [f for f in made.files() if not any(f.is_relative_to(ROOT / name) for name in INDEX)]
    assert not lost, "python -m benchmarks made --help says how"


@pytest.mark.parametrize("name", INDEX)
def test_a_result_says_when_it_was_made_and_of_which_code(name):
    entry = INDEX[name]
    assert entry["measures"]
    assert all((ROOT / path).exists() for path in entry["measures"])
    assert any(not path.startswith("benchmarks") for path in entry["measures"])
    for how in made.stamps(name, entry):
        assert date.fromisoformat(how["date"])
        assert how["command"]
        assert re.fullmatch(r"[0-9a-f]{7,40}\+?", how.get("commit") or how["stored"])


@pytest.mark.parametrize("name", [n for n, entry in INDEX.items() if "sha256" in entry])
def test_a_result_is_what_was_stamped(name):
    assert made.digest(ROOT / name) == INDEX[name]["sha256"], "stamp it: python -m benchmarks made"


def whole_history() -> bool:
    return made.git("rev-parse", "--is-shallow-repository") == "false"


@pytest.mark.skipif(not whole_history(), reason="the history is not here")
def test_the_commit_of_a_stamp_is_in_the_history():
    assert all(stale.known((e.get("commit") or e["stored"]).rstrip("+")) for e in INDEX.values() if "date" in e)
    assert all(stale.commit(how) for name, entry in INDEX.items() for how in made.stamps(name, entry))


def test_a_result_older_than_its_code_is_named_and_a_new_one_not(tmp_path, monkeypatch):
    def commit(text: str) -> str:
        (tmp_path / "code.py").write_text(text)
        made.git("add", "code.py")
        made.git("-c", "user.name=a", "-c", "user.email=a", "commit", "-qm", text)
        return made.git("rev-parse", "HEAD")

    monkeypatch.setattr(made, "ROOT", tmp_path)
    subprocess.run(["git", "init", "-qb", "main", tmp_path], check=True)
    first, last = commit("old"), commit("new")
    how = {"date": "2026-01-01", "measures": ["code.py"]}
    monkeypatch.setattr(made, "index", lambda: {"old": {"commit": first, **how}, "new": {"commit": last, **how}})
    stale.known.cache_clear()
    (line,) = stale.stale()
    assert line.startswith("old: 1 commits to code.py since, ")


def test_what_is_stored_again_is_stamped_again(tmp_path, monkeypatch):
    result = tmp_path / "results" / "mine.csv"
    result.parent.mkdir()
    monkeypatch.setattr(made, "ROOT", tmp_path)
    monkeypatch.setattr(made, "STORED", (result.parent,))
    monkeypatch.setattr(made, "INDEX", result.parent / "made.json")
    made.INDEX.write_text("{}")
    for text in ("1", "2"):
        result.write_text(text)
        made.stamp(result, command="python mine.py", measures=["code.py"] if text == "1" else [])
        entry = made.index()["results/mine.csv"]
        assert entry["sha256"] == made.digest(result)
        assert (entry["command"], entry["measures"]) == ("python mine.py", ["code.py"])
    made.stamp(tmp_path / "elsewhere.csv", command="python mine.py")
    assert list(made.index()) == ["results/mine.csv"]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder that takes the results of a benchmark of the name `mine`."""
    monkeypatch.setattr(made, "RUN", {"results": tmp_path, "name": "mine"})
    return tmp_path


def test_every_benchmark_is_listed_with_what_it_finds_and_how_long_it_takes():
    listed = known()
    for path in (ROOT / "benchmarks").glob("*.py"):
        names = {t.id for n in ast.parse(path.read_text()).body if isinstance(n, ast.Assign) for t in n.targets
                 if isinstance(t, ast.Name)}  # fmt: skip
        assert (path.stem in listed) == ("TAKES" in names)
        assert "PARTS" not in names or path.stem in listed
    assert all(told["about"] and told["TAKES"] and told["THREADS"] in ("one", "all") for told in listed.values())


def test_a_command_line_is_the_signature_of_main(place, capsys):
    def main(
        *names: Annotated[str, ("a", "b")],
        limit: Annotated[float, "s"] = 3.0,
        of: Sequence[int] = (1,),
        new: bool = False,
    ) -> tuple:
        return names, limit, of, new

    folder = ["--results", str(place)]
    assert called("mine", main, "", folder) == ((), 3.0, (1,), False)
    words = ["b", "a", "--limit", "2", "--of", "4", "5", "--new"]
    assert called("mine", main, "", [*words, *folder]) == (("b", "a"), 2.0, [4, 5], True)
    for wrong in (["c"], ["--limit", "x"], ["--other"]):
        with pytest.raises(SystemExit):
            called("mine", main, "", [*wrong, *folder])
    assert "'c' is none of a, b" in capsys.readouterr().err


def test_each_part_is_kept_with_the_command_that_finds_it_and_the_machine(place):
    parts = {"one": lambda: {"x": 1}, "two words": lambda: {"x": 2}}
    called("mine", kept_parts("mine", parts), "", ["two words", "--results", str(place)])
    called("mine", kept_parts("mine", parts), "", ["--results", str(place)])
    found = made.stored("mine")
    assert {name: part["x"] for name, part in found.items()} == {"two words": 2, "one": 1}
    assert found["one"]["made"]["command"] == "python -m benchmarks mine one"
    assert found["two words"]["made"]["command"] == "python -m benchmarks mine 'two words'"
    assert re.fullmatch(r".+, \d+ cores", found["one"]["made"]["machine"])
    assert not any("mine" in name for name in made.index()), "results elsewhere are not stored"


def test_what_a_benchmark_needs_is_named():
    assert missing(["python3", "json", "no-such-tool"]) == ["no-such-tool"]
