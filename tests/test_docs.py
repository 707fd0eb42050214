"""What the pages say is run."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import notebooks
import pytest
from checking import valid_files

from greygate.errors import InputError
from greygate.machines.catalog import CATALOG, entry

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = {
    page.name: re.findall(r'```(python|sh|\w+ title="([\w/.]+)")\n(.*?)```', page.read_text(), re.S) for page in PAGES
}
"""Of each page, in order: Python and shell that is run, and files that it tells the reader to write."""
RUN = re.compile(r"```\w.*?```\n", re.S)
PRINTED = {p.name: re.findall(r"```\n((?:.+\n)+?)```\n", RUN.sub("", p.read_text())) for p in PAGES}
"""Of each page: what its commands print."""
NOTEBOOKS = [f"{name}.md" for name in notebooks.TUTORIALS]
APART = [*NOTEBOOKS, "README.md"]  # pages that run by tests of their own


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a reader works: the recordings are there, and `greygate` is that of this environment."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    return tmp_path


def need(page: str) -> None:
    """Skip a page that imports a package that is not installed."""
    code = "\n".join(text for kind, _, text in BLOCKS[page] if kind == "python")
    for module in re.findall(r"^(?:import|from) (\w+)", code, re.M):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{page} needs {module}, which is not installed")


def run(command: str) -> None:
    """A shell block."""
    done = subprocess.run(["bash", "-euc", command], capture_output=True, text=True)
    assert done.returncode == 0, f"{command}{done.stdout}{done.stderr}"


SETUP = ("greygate --help", "greygate app")  # of the installation


@pytest.mark.nightly
def test_every_line_of_the_readme_runs_as_it_is_pasted_in_order(folder):
    (folder / "recordings").unlink()  # whoever installed greygate has no more than it writes
    namespace = {}
    for kind, text in re.findall(r"```(python)?\n(.*?)```", (ROOT / "README.md").read_text(), re.S):
        if kind:
            exec(compile(text, "README.md", "exec"), namespace)
        for command in [line for line in text.splitlines() if line.startswith("greygate ")] if not kind else ():
            if not command.startswith(SETUP):
                run(command)
    assert (folder / "found").is_dir()
    assert (folder / "build_ice").is_dir()


@pytest.mark.nightly
@pytest.mark.parametrize("page", [name for name, blocks in BLOCKS.items() if blocks and name not in APART])
def test_the_python_and_the_commands_in_a_page_run(page, folder):
    namespace = {}
    for kind, name, text in BLOCKS[page]:
        if kind == "python":
            exec(compile(text, page, "exec"), namespace)
        elif kind == "sh":
            run(text)
        else:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)
    valid_files(folder)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore")  # of Jupyter's own
@pytest.mark.parametrize("page", NOTEBOOKS)
def test_the_notebook_of_a_tutorial_runs(page, folder):
    nbclient = pytest.importorskip("nbclient")
    need(page)
    notebook = notebooks.notebook(page.removesuffix(".md"))
    blocks = [text.rstrip() for _, _, text in BLOCKS[page]]
    code = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    assert all(any(cell.endswith(block) for cell in code) for block in blocks)
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
    shown = [path for cell in code for path in re.findall(r'IFrame\("([^"]+)"', cell)]
    assert all((folder / path).stat().st_size for path in shown)
    valid_files(folder)
    cells = [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]
    outputs = ["".join(o["text"] for o in found if o.get("name") == "stdout") for found in cells]
    printed = "\n".join([*outputs, *(path.read_text() for path in folder.glob("*.csv"))]).splitlines()
    lines = [line for text in PRINTED[page] for line in text.splitlines()]
    assert lines
    assert [line for line in lines if not any(same(line, other) for other in printed)] == []


def same(shown: str, printed: str) -> bool:
    """Whether a page shows that line; figures that training found may differ with the processor, by 5 %."""
    number = r"-?\d+\.?\d*(?:e[-+]?\d+)?"
    if re.sub(number, "#", shown).split() != re.sub(number, "#", printed).split():
        return False
    pairs = zip(re.findall(number, shown), re.findall(number, printed), strict=True)
    within = 0.0 if "clocks" in shown else 0.05
    return all(float(a) == pytest.approx(float(b), rel=within, abs=0.0) for a, b in pairs)


def test_a_notebook_says_what_its_page_says():
    for page in NOTEBOOKS:
        notebook = notebooks.notebook(page.removesuffix(".md"))
        told = "".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
        for heading in re.findall(r"^#+ .*$", (ROOT / "docs" / page).read_text(), re.M):
            assert heading in told
        assert "](" not in re.sub(r"\]\(http", "", told)


def test_the_notebooks_in_the_repository_are_made_of_the_pages():
    made = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert made == {name: notebooks.text(name) for name in notebooks.TUTORIALS}, "python docs/notebooks.py notebooks"


def test_figures_of_the_pages_are_those_of_the_stored_results():
    done = subprocess.run([sys.executable, ROOT / "docs" / "pages.py", "--check"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_readme_counts_the_clicks_of_the_film():
    found = json.loads((ROOT / "benchmarks" / "results" / "film.json").read_text())["app"]
    text = f"{found['effect_clicks']} clicks to a named effect, {found['verilog_clicks']} to verified Verilog, in three"
    assert text in " ".join((ROOT / "README.md").read_text().split())
    assert (found["verilog_s"] < 180, found["console"]) == (True, [])


def test_the_readme_says_what_its_installation_takes_and_its_commands_have_run_in_it():
    found = json.loads((ROOT / "benchmarks" / "results" / "wheel.json").read_text())["readme"]
    text, (least, most) = " ".join((ROOT / "README.md").read_text().split()), found["installed"]
    assert f"'.[{most['extras']}]'" in text
    told = [f"{row['megabytes'] / 1000:.1f} GB" for row in (most, least)]
    assert re.search(rf"it takes two minutes and {told[0]}; without .* {told[1]}:", text)
    assert most["seconds"] < 120
    assert {row["code"] for row in found["rows"]} == {0}


def test_a_picture_is_below_a_megabyte_and_the_film_of_the_app_lasts_thirty_seconds():
    pictures = ROOT / "docs" / "pictures"
    assert [path.name for path in pictures.iterdir() if path.stat().st_size > 1e6] == []
    image = pytest.importorskip("PIL.Image", reason="needs the extra `browser`")
    shown = []
    with image.open(pictures / "app.webp") as film:
        for k in range(film.n_frames):
            film.seek(k)
            film.load()
            shown.append(film.info["duration"])
    assert sum(shown) == pytest.approx(30_000, rel=0.01)
    assert len(shown) > 20


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_between_pages_lead_somewhere(page):
    for target, anchor in re.findall(r"\]\((?!http)([^)#]*)(?:#([^)]+))?\)", page.read_text()):
        to = page.parent / target if target else page
        assert os.path.exists(to), target
        assert not anchor or anchor in anchors(to), f"{target}#{anchor}"


def anchors(page: Path) -> set[str]:
    """Those of its headings: small letters, no punctuation, `-` for spaces."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    return {re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-") for title in titles}


def test_every_page_stands_in_the_sites_navigation_once():
    listed = re.findall(r"(\w[\w-]*\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M)
    assert sorted(listed) == sorted(["index.md", *(page.name for page in PAGES[1:])])


@pytest.mark.parametrize("name", re.findall(r"^::: (\S+)$", (ROOT / "docs" / "modules.md").read_text(), re.M))
def test_a_module_of_the_reference_is_there(name):
    assert importlib.import_module(name).__doc__


def test_the_readme_shows_the_figures_of_the_stored_network():
    from greygate.machines.valve_cylinder.study import records
    from greygate.models.accuracy import free_run_rms

    text = (ROOT / "README.md").read_text()
    network = entry("valve_cylinder").network()
    for scenario, label in (("training", "trained, training"), ("v1", "v1,"), ("v2", "v2,")):
        row = next(line for line in text.splitlines() if line.startswith(f"| {label}"))
        a, b = (v / 1e5 for v in free_run_rms(network, records()[scenario]).values())
        assert f"| {a:.3f} / {b:.3f} |" in row


def test_the_readme_shows_the_figures_that_training_left():
    kept = json.loads((ROOT / "models" / "trained" / "valve_cylinder.json").read_text())
    flow, joined = (
        next(line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith(f"| {label}"))
        for label in ("flow network", "as assembled")
    )
    assert [cell.strip() for cell in flow.split("|")][2:4] == [
        f"{1e4 * v:.2f}e-4" for v in (kept["thesis"]["flow_rms"], kept["flow_rms"])
    ]
    assert [cell.strip() for cell in joined.split("|")][2:4] == [
        "{:.3f} / {:.3f}".format(*v) for v in (kept["thesis"]["assembled"], kept["assembled"]["training"])
    ]


def test_the_readme_shows_the_scores_of_fresh_concealed_cases():
    scores = (ROOT / "benchmarks" / "results" / "concealed_fresh.txt").read_text()
    right, single = re.search(r"right effect first, all single effects: (\d+) of (\d+)", scores).groups()
    false, clean = re.search(r"false claims on clean or miscalibrated rigs: (\d+) of (\d+)", scores).groups()
    text = (ROOT / "README.md").read_text()
    assert f"right effect in {right} of {single} with one effect; false claims in {false} of {clean} with none" in text


def test_the_picture_of_the_readme_has_the_errors_of_the_kept_diagnosis():
    import numpy as np
    import pictures

    diagnosis, runs = pictures.tanks()
    measured = runs.pop("reference")
    found = [np.sqrt(np.mean((run - measured) ** 2)) for run in runs.values()]
    fit = diagnosis["fit"]["identify"]["y"]
    np.testing.assert_allclose(found, [fit["calibrated"], fit["corrected"]], rtol=1e-6)


@pytest.mark.parametrize("name", CATALOG)
def test_a_network_of_the_catalogue_is_kept_and_runs(name):
    chosen = entry(name)
    assert chosen.network().check().name
    try:
        records = chosen.records()
    except InputError as missing:  # not every recording may be copied into the repo
        pytest.skip(str(missing))
    assert {*chosen.training, *chosen.scenarios} <= set(records)
