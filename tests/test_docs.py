"""What the pages say is run."""

import os
import re
from pathlib import Path

import pytest

from greygate.errors import InputError
from greygate.machines.catalog import CATALOG, entry

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = {page.name: re.findall(r"```python\n(.*?)```", page.read_text(), re.S) for page in PAGES}


@pytest.mark.parametrize("page", [name for name, blocks in BLOCKS.items() if blocks])
def test_the_python_in_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recordings").symlink_to(ROOT / "recordings")
    namespace = {}
    for block in BLOCKS[page]:
        exec(compile(block, page, "exec"), namespace)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_between_pages_lead_somewhere(page):
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", page.read_text()):
        assert os.path.exists(page.parent / target), target


def test_the_readme_shows_the_figures_of_the_stored_network():
    from greygate.machines.valve_cylinder.study import records
    from greygate.models.accuracy import free_run_rms

    text = (ROOT / "README.md").read_text()
    network = entry("valve_cylinder").network()
    for scenario, label in (("training", "trained, training"), ("v1", "v1,"), ("v2", "v2,")):
        row = next(line for line in text.splitlines() if line.startswith(f"| {label}"))
        a, b = (v / 1e5 for v in free_run_rms(network, records()[scenario]).values())
        assert f"| {a:.3f} / {b:.3f} |" in row


@pytest.mark.parametrize("name", CATALOG)
def test_a_network_of_the_catalogue_is_kept_and_runs(name):
    chosen = entry(name)
    assert chosen.network().check().name
    try:
        records = chosen.records()
    except InputError as missing:  # not every recording may be copied into the repo
        pytest.skip(str(missing))
    assert {*chosen.training, *chosen.scenarios} <= set(records)
