"""`greygate compare`: a build that became worse is refused, with the line that says why."""

import json
import shutil

import pytest
from networks import delay_line
from test_cli import recording

from greygate.errors import InputError
from greygate.hardware.build import Project
from greygate.hardware.comparing import compare, read_budget
from greygate.machines.source import Source
from greygate.project import compile_project


@pytest.fixture(scope="module")
def builds(tmp_path_factory):
    """The same network at 16 and at 8 bits, and at 16 bits with another recording."""
    root = tmp_path_factory.mktemp("builds")
    delay_line().save(root / "line")
    found = {}
    for name, steps, width in (("good", 200, 16), ("coarse", 200, 8), ("other", 150, 16)):
        source = Source(str(root / "line.toml"), {"a": str(recording(root / f"{steps}.csv", steps=steps))})
        compile_project(source, root / name, formats=source.formats(width))
        found[name] = root / name
    return found


@pytest.fixture
def good(builds, tmp_path):
    shutil.copytree(builds["good"], tmp_path / "good")
    return tmp_path / "good"


def told(build, **counts):
    """The build as if it had been synthesized with these figures."""
    (build / "resources.json").write_text(json.dumps({"folded, ecp5": counts}))
    return Project.open(build)


def budget(tmp_path, text):
    path = tmp_path / "budget.toml"
    path.write_text(text)
    return path


def test_a_build_is_no_worse_than_itself(greygate, builds):
    code, out, _ = greygate("compare", builds["good"], builds["good"])
    assert code == 0
    assert "no figure worse than allowed" in out
    assert all(d.growth in (0.0, None) and not d.worse for d in compare(*[Project.open(builds["good"])] * 2))


def test_a_coarser_build_is_worse_and_the_line_says_by_how_much(greygate, builds, tmp_path):
    code, out, _ = greygate("compare", builds["good"], builds["coarse"], "--html", tmp_path / "c.html")
    assert code == 1
    (line,) = [line for line in out.splitlines() if line.startswith("error")]
    assert "a.y" in line
    assert "WORSE: nothing is allowed" in line
    page = (tmp_path / "c.html").read_text()
    assert 'class="worse"' in page
    assert "nothing is allowed" in page


def test_the_other_way_round_it_is_better(greygate, builds):
    code, out, _ = greygate("compare", builds["coarse"], builds["good"], "--json")
    assert code == 0
    (error,) = [d for d in json.loads(out)["differences"] if d["figure"] == "error"]
    assert error["says"] == "better"
    assert error["growth"] == pytest.approx(error["new"] / error["old"] - 1, rel=1e-12)
    assert error["growth"] < 0


def test_a_budget_allows_what_it_names_and_no_more(builds, tmp_path):
    old, new = (Project.open(builds[name]) for name in ("good", "coarse"))
    (growth,) = [d.growth for d in compare(old, new) if d.figure == "error"]
    for factor, worse in ((1.01, False), (0.99, True)):
        allowed = read_budget(budget(tmp_path, f"[growth]\nerror = {growth * factor}\n"))
        assert any(d.worse for d in compare(old, new, allowed)) == worse


def test_a_limit_holds_whatever_the_old_build_had(builds, tmp_path):
    project = Project.open(builds["coarse"])
    (error,) = [d.new for d in compare(project, project) if d.figure == "error"]
    for factor, worse in ((1.01, False), (0.99, True)):
        allowed = read_budget(budget(tmp_path, f'[limit.error]\n"a.y" = {error * factor}\n'))
        (judged,) = [d for d in compare(project, project, allowed) if d.figure == "error"]
        assert judged.worse == worse
        assert not worse or judged.says.startswith("the budget's most is")


@pytest.mark.parametrize(
    ("figure", "old", "new", "text", "worse"),
    [
        ("luts", 100, 110, "", True),
        ("luts", 100, 110, "[growth]\nluts = 0.1\n", False),
        ("luts", 100, 111, "[growth]\nluts = 0.1\n", True),
        ("luts", 100, 90, "", False),
        ("luts", 0, 1, "[growth]\nluts = 5\n", True),
        ("luts", 100, 100, "[limit]\nluts = 99\n", True),
        ("clock_mhz", 100.0, 90.0, "", True),
        ("clock_mhz", 100.0, 110.0, "", False),
        ("clock_mhz", 100.0, 80.0, "[growth]\nclock_mhz = 0.25\n", False),
        ("clock_mhz", 100.0, 120.0, "[limit]\nclock_mhz = 121\n", True),
        ("us_per_step", None, 3.0, "", False),
    ],
)
def test_resources_are_judged_each_in_its_own_direction(good, builds, tmp_path, figure, old, new, text, worse):
    one = told(good, **({} if old is None else {figure: old}))
    shutil.copytree(builds["good"], tmp_path / "new")
    other = told(tmp_path / "new", **{figure: new})
    found = compare(one, other, read_budget(budget(tmp_path, text)))
    (judged,) = [d for d in found if d.figure == figure]
    assert judged.worse == worse
    assert [d.figure for d in found if d.worse] == ([figure] if worse else [])


@pytest.mark.parametrize(("bits", "worse"), [(0, False), (None, True)])
def test_a_differing_bit_is_worse_whatever_the_budget(good, builds, bits, worse):
    scenario = {"steps": 200, "differing_bits": bits, "mismatch": None if bits == 0 else "step 3: y"}
    verdict = {"clocks_per_step": 9.0, "seed": 1, "scenarios": {"a": scenario}}
    (good / "verify.json").write_text(json.dumps({"folded": verdict}))
    found = compare(Project.open(builds["good"]), Project.open(good))
    assert [d.where for d in found if d.worse] == (["folded"] if worse else [])


def test_a_budget_may_ask_for_verified_bits(builds, tmp_path):
    project = Project.open(builds["good"])
    found = compare(project, project, read_budget(budget(tmp_path, "verified = true\n")))
    assert {d.says for d in found if d.worse} == {"not verified; run greygate verify"}


def test_what_is_no_verilog_needs_no_verification(builds, tmp_path):
    compile_project(Project.open(builds["good"]).source, tmp_path / "c", architectures=("c99",))
    project = Project.open(tmp_path / "c")
    assert not any(d.worse for d in compare(project, project, read_budget(budget(tmp_path, "verified = true\n"))))


def test_builds_of_other_recordings_are_not_compared(greygate, builds):
    code, out, err = greygate("compare", builds["good"], builds["other"])
    assert (code, out) == (2, "")
    assert "scenario a: the two builds have other recordings of y; compile both with the same one" in err


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[growth]\nspeed = 1\n", "growth 'speed' does not exist; choose error, parameters"),
        ("[growth]\nluts = -1\n", "growth.luts -1 is too small; give 0 or more"),
        ("[limit]\nluts = 'few'\n", "limit.luts 'few' is not a finite number"),
        ("limit = 3\n", "limit 3 is not a table; give FIGURE = NUMBER"),
        ("[limit.error]\ny = nan\n", "limit.error.y nan is not a finite number"),
        ("verified = 1\n", "verified 1 is neither true nor false"),
        ("grown = 1\n", "'grown': there is no such entry"),
    ],
)
def test_a_budget_that_is_wrong_says_where(tmp_path, text, says):
    with pytest.raises(InputError) as refused:
        read_budget(budget(tmp_path, text))
    assert says in str(refused.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[limit]\nluts = 9\n", "limit.luts: .* has no such figure; run greygate synthesize or verify first"),
        ('[limit.error]\n"b.y" = 9\n', r"limit.error: .* has no b\.y; it has a\.y"),
    ],
)
def test_a_limit_of_something_that_the_build_lacks_is_refused(builds, tmp_path, text, says):
    project = Project.open(builds["good"])
    with pytest.raises(InputError, match=says):
        compare(project, project, read_budget(budget(tmp_path, text)))
