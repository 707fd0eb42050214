"""The pages of the plants say what the stored networks do, and show it."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pages
import pictures
import pytest

from benchmarks import concealed
from benchmarks.made import RESULTS
from greygate.errors import InputError
from greygate.machines.belt_drive import study as belt_drive
from greygate.machines.cable_drum import study as cable_drum
from greygate.machines.catalog import entry
from greygate.models.accuracy import free_run_rms
from greygate.models.storage import TRAINED

DOCS = Path(__file__).parents[1] / "docs"


def cells(page: str, label: str) -> list[str]:
    """What follows the first cell, which is this or begins so before a comma, in the first such row of the page."""
    lines = (DOCS / page).read_text().replace("**", "").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return next(row[1:] for row in rows if row[0] == label or row[0].startswith(f"{label},"))


def test_the_belt_drives_page_has_the_figures_of_its_machine():
    scores = belt_drive.scores(entry("belt_drive").network())
    for label, thesis in belt_drive.THESIS["fnn"].items():
        said = [f"{a} / {b:.1f}" for a, b in zip(thesis, scores[label], strict=True)]
        assert cells("belt_drive.md", f"FNN {label}") == said, label
    for label in ("max", "min"):
        assert [c.split(" / ")[1] for c in cells("belt_drive.md", f"FNN {label}")] == [
            f"{v:.0f}" for v in scores[label]
        ]


@pytest.mark.parametrize(("row", "kind"), [("RBF", "radial machine"), ("RNN", "recurrent machine")])
def test_the_belt_drives_page_has_the_figures_that_training_left_of_other_experts(row, kind):
    stored = json.loads((TRAINED / "belt_drive.json").read_text())[kind]
    said = [cell.split(" / ") for cell in cells("belt_drive.md", f"{row} overall")]
    thesis = belt_drive.THESIS[row.lower()]["overall"]
    assert said == [[str(a), f"{b:.1f}"] for a, b in zip(thesis, stored["overall"], strict=True)]


@pytest.mark.parametrize("scenario", ["rig_chirp", "rig_random", "rig_open"])
def test_the_pump_cylinders_page_has_the_figures_of_its_network(scenario):
    chosen = entry("pump_cylinder")
    a, b = (1e-6 * v for v in free_run_rms(chosen.network(), chosen.records()[scenario]).values())
    assert cells("pump_cylinder.md", f"rig, no pressure sensor, `{scenario}`")[1] == f"{a:.3f} / {b:.3f}"


def test_the_cable_drums_page_has_the_figures_of_its_network():
    network = entry("cable_drum").network()
    for label, scenario in (
        ("training", "training"),
        ("random motion, 250 s, another day", "validation"),
        ("the same with the beacon at home", "home"),
    ):
        thesis, ours, largest, _ = cells("cable_drum.md", label)
        error = 1e6 * cable_drum.residual(network, scenario)
        assert ours == f"{np.sqrt(np.mean(error**2)):.1f} um"
        if scenario != "training":
            assert thesis == f"{cable_drum.VALIDATED[scenario]:.0f} um"
            assert largest.startswith(f"{np.abs(error).max():.0f} um")


def test_the_asymmetric_cylinders_page_has_the_figures_of_its_training():
    stored = json.loads((TRAINED / "asymmetric_cylinder.json").read_text())
    for label, step in (
        ("ours, weights adopted", "adopted"),
        ("ours, after 10 epochs", "10 epochs"),
        ("ours, after 50 epochs", "trained"),
    ):
        said = [f"{a:.2f} / {b:.2f}" for a, b in stored[step].values()]
        assert cells("asymmetric_cylinder.md", label)[:5] == said, label


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("belt_drive", "timing-belt drive"),
        ("pump_cylinder", "pump-controlled cylinder"),
        ("cable_drum", "cable-drum sensor"),
    ],
)
def test_the_page_of_devices_has_the_resources_that_are_kept(name, label):
    kept = json.loads((TRAINED / f"{name}.resources.json").read_text())["resources"]["folded, ecp5"]
    assert cells("devices.md", label)[0] == "{luts:,} / {dsps} / {block_rams:g}".format(**kept)


@pytest.mark.parametrize("name", pictures.PICTURES)
def test_a_page_shows_the_picture_that_the_command_draws(name):
    """To a pixel: another machine's arithmetic may round otherwise."""
    stored = (DOCS / "pictures" / f"{name}.svg").read_text()
    assert any(f"pictures/{name}.svg)" in page.read_text() for page in (DOCS.parent / "README.md", *DOCS.glob("*.md")))
    drawn = pictures.PICTURES[name]()
    ElementTree.fromstring(drawn)  # well-formed
    number = re.compile(r"-?\d+\.?\d*")
    assert number.sub("", drawn) == number.sub("", stored)
    then, now = (np.array([float(v) for v in number.findall(text)]) for text in (stored, drawn))
    np.testing.assert_allclose(now, then, atol=1.0)


def test_a_folder_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        pictures.draw(tmp_path / "none")


def test_the_page_of_concealed_effects_has_the_table_that_the_kept_cases_make():
    table = "\n".join(concealed.table(concealed.read(RESULTS / "concealed.csv")))
    assert table in (DOCS / "concealed.md").read_text()


def test_a_cell_of_a_table_is_what_stands_at_its_path_in_the_format_and_unit_of_its_column():
    found = {"v1": {"p": [1e5, 2e5]}, "word": "so", "s": {"a": 1.0, "b": 2.0}}
    assert pages.cell(("title", found), "v1.p", "%.1f/%.1f", 1e-5) == "1.0/2.0"
    assert pages.cell(("title", found), "v1.p.1", "figures") == "200000"
    assert pages.cell(("title", found, "p"), ("v1", "{1:g}"), at="{column}.{key}") == "200000"
    assert pages.cell(("title", found, "", "%g and %g"), "s", "%.3f") == "1 and 2"
    assert pages.cell(("title", (found["s"], found["s"])), "b", "%g/%g") == "2/2"
    assert pages.cell(("title", found), "word", "%.1f") == "so"
    with pytest.raises(KeyError):
        pages.cell(("title", found), "v2.p")
