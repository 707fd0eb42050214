"""Studies side by side: published, float, fixed point and hardware in one row, and what is not there named."""

import json

import numpy as np
import pytest
import test_report
from test_report import PERIOD, record
from typer.testing import CliRunner

from greygate import reporting
from greygate.cli import app
from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.study import size, study
from greygate.errors import InputError
from greygate.files import write_manifest
from greygate.hardware import build
from greygate.machines import catalog
from greygate.models.network import Network
from greygate.pages.report import page
from greygate.pages.summary import aligned, designs, results

NAME = "tiny"


def network() -> Network:
    """That of `test_report` by a name that Verilog can hold."""
    found = test_report.network()
    found.name = NAME
    return found


@pytest.fixture(scope="module")
def records():
    return {"training": record(1, 800), "other": record(2, 500)}


@pytest.fixture(scope="module")
def told(records):
    """Two studies of one network: of 12 bits and nothing else known, of 14 with all there is."""
    parts = {w: compile_network(network(), records, Formats(w), period=PERIOD) for w in (12, 14)}
    common = {"ranged_on": ["training"], "period": PERIOD, "widths": (12, 14)}
    hardware = {
        "parallel": {"clocks_per_step": 9, "scenarios": {"training": {"steps": 800, "differing_bits": 0}}},
        "folded": {"clocks_per_step": 70, "scenarios": {"training": {"steps": 800, "differing_bits": None}}},
    }
    references = {
        "thesis": {"training": {"x": 3e-6}},
        "thesis, another plant": {"training": {"x": 4e-6, "p[0]": 2e4}},
    }
    resources = {"parallel, ecp5": {"luts": 1234, "dsps": 5}, "folded, ecp5": {"stopped_after_s": 300.0}}
    full = study("full", parts[14], records, **common, hardware=hardware, references=references, resources=resources)
    return [study("bare", parts[12], records, **common, called="narrow"), full]


def test_a_row_has_the_figures_of_the_study_and_says_what_is_missing(told):
    bare, full = ({(r["scenario"], r["output"]): r for r in rows} for rows in (results(told[:1]), results(told[1:])))
    x = full["training", "x"]
    figures = told[1]["scenarios"]["training"]["outputs"]["x"]
    assert x["published"] == "3.00; 4.00 (another plant)"
    assert float(x["float"]) == pytest.approx(1e6 * figures["rmse"]["float"], rel=5e-3)
    assert float(x["fixed"]) == pytest.approx(1e6 * figures["rmse"]["fixed"], rel=5e-3)
    assert x["fixed / float"] == f"{figures['ratio']:.3f}"
    assert x["12 bits"] == bare["training", "x"]["fixed / float"]
    assert x["differing bits"] == "parallel 0, folded differ"
    assert full["training", "p[0]"]["published"] == "0.200 (another plant)"
    assert full["other", "x"]["differing bits"] == bare["other", "x"]["differing bits"] == "not verified"
    assert bare["other", "x"]["published"] == "–"


def test_rows_of_programs_of_different_words_have_the_same_columns(told):
    rows = results(told)
    assert {tuple(r) for r in rows} == {tuple(rows[0])}
    assert [r["word"] for r in rows] == ["12"] * 6 + ["14"] * 6


def test_bits_beyond_the_word_are_told(records):
    formats = Formats(12, finer=2)
    made = compile_network(network(), {"training": records["training"]}, formats, period=PERIOD)
    common = {"ranged_on": ["training"], "period": PERIOD, "widths": (12,)}
    rows = results([study("finer", made, records, **common, formats=formats)])
    assert {r["word"] for r in rows} == {"12 + 2"}
    assert {r["word"] for r in results([study("plain", made, records, **common)])} == {"–"}


def test_a_design_that_was_stopped_or_never_synthesized_is_named(told):
    rows = {(r["plant"], r["word"], r["design"]): r for r in designs(told)}
    assert rows["narrow", "12", "–"]["target"] == "not synthesized"
    parallel, folded = rows["tiny", "14", "parallel"], rows["tiny", "14", "folded"]
    assert (parallel["clocks a step"], parallel["luts"], parallel["dsps"]) == ("9", "1,234", "5")
    assert "flip flops" not in parallel
    assert (folded["clocks a step"], folded["luts"]) == ("70", "–")
    assert folded["target"] == "ecp5, stopped after 300 s"


def test_the_page_shows_both_tables_and_a_mismatch(told):
    html = page(told, [results(told), designs(told)])
    for text in ("Side by side", "parallel 0, folded differ", "stopped after 300 s", "3.00; 4.00 (another plant)"):
        assert text in html, text
    assert "Side by side" not in page(told)


def test_columns_are_as_wide_as_their_widest_cell():
    rows = [{"plant": "a", "n": "1"}, {"plant": "long", "n": "200"}]
    assert aligned(rows) == ["plant    n", "a        1", "long   200"]


# ---- the command, on a catalogue of one small plant


@pytest.fixture
def plants(monkeypatch, records, tmp_path):
    """A catalogue of one plant, its network kept in tmp_path/kept; the command runs in tmp_path."""
    entry = catalog.Entry(NAME, "Small", None, lambda: records, ("training",), ("training",), PERIOD)
    monkeypatch.setattr(catalog.Entry, "network", lambda self: network())
    monkeypatch.setitem(catalog.CATALOG, NAME, entry)
    monkeypatch.setattr(reporting, "REPORTED", (NAME,))
    monkeypatch.setattr(build, "TRAINED", tmp_path / "kept")
    (tmp_path / "kept").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ran(*arguments) -> str:
    done = CliRunner().invoke(app, [*map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_what_is_missing_is_compiled_and_what_was_left_is_read(plants):
    first = ran("report", "--all")
    assert "not verified" in first
    assert "not synthesized" in first
    program = plants / "hardware" / NAME / "program.json"
    left = program.stat().st_mtime_ns
    found = {
        "size": size(build.Project.open(program.parent).program),
        "resources": {"folded, ecp5": {"luts": 77}},
    }
    kept = plants / "kept" / f"{NAME}.resources.json"
    kept.write_text(json.dumps(found))
    assert " 77\n" in ran("report", "--all")
    assert program.stat().st_mtime_ns == left
    kept.write_text(json.dumps(found | {"size": found["size"] | {"operations": 1}}))
    assert " 77\n" not in ran("report", "--all")
    data = json.loads((plants / "report.json").read_text())
    assert [s["title"] for s in data] == ["Small"]
    assert data[0]["widths"]["width"] == [12, 16, 18]
    assert np.isfinite(data[0]["scenarios"]["other"]["outputs"]["x"]["ratio"])


def test_a_folder_that_holds_another_network_is_named(plants):
    ran("report", "--all", "mine")
    facts = plants / "mine" / NAME / "compile.json"
    facts.write_text(facts.read_text().replace('"source": "tiny"', '"source": "b2"'))
    write_manifest(facts.parent, "compile")
    with pytest.raises(InputError, match="is a build of b2"):
        CliRunner().invoke(app, ["report", "--all", "mine"], catch_exceptions=False)


def test_wrong_use_of_the_command_says_what_to_do():
    for arguments, message in (["report"], "or --all"), (["report", "--all", "a", "b"], "takes one folder"):
        with pytest.raises(InputError, match=message):
            CliRunner().invoke(app, arguments, catch_exceptions=False)
