"""Every stored result says which command found it, on which commit and day, and which code it measures."""

import re
import subprocess
from datetime import date
from pathlib import Path

import made
import pytest
import stale

ROOT = Path(__file__).parents[1]
INDEX = made.index()


def test_every_stored_file_is_in_the_index():
    lost = [f for f in made.files() if not any(f.is_relative_to(ROOT / name) for name in INDEX)]
    assert not lost, "store it by benchmarks/made.py, which says how"


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
    assert made.digest(ROOT / name) == INDEX[name]["sha256"], "stamp it: python benchmarks/made.py"


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
