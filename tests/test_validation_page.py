"""The validation page and its command."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import greygate
from test_validation import linear, record
from typer.testing import CliRunner

from greygate import cli
from greygate.errors import InputError
from greygate.machines.source import Source
from greygate.models.network import Network
from greygate.models.validation import validate
from greygate.pages.validation import page, sections
from greygate.pages.validation.judged import judge, rows, table
from greygate.pages.validation.sections import histogram, run_data
from greygate.pages.zoomable import DRAWN, POINTS, unpacked
from greygate.plants.recording import Recording


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """arx.toml, which is right of train.csv and <test>.csv; wild.toml, which is not."""
    monkeypatch.chdir(tmp_path)
    linear(gain=0.95).save("arx")
    linear(feedback=(1.9,)).save("wild")
    for seed, name in enumerate(("train", "<test>")):
        r = record(600, seed=seed, equation_noise=0.2)
        Recording(1e-2, r.inputs | r.targets, {"u": "V", "y": "m"}).write_csv(f"{name}.csv")
    return tmp_path


def source(name="arx.toml") -> Source:
    return Source(name, {"train": "train.csv", "<test>": "<test>.csv"})


def test_the_table_has_a_row_per_record_and_output_with_the_figures_of_the_validation(folder):
    judged = judge(source())
    assert judged.period == 1e-2
    assert judged.training == ("train",)
    assert [r["record"] for r in rows(judged)] == ["train*", "<test>"]
    for row, v in zip(rows(judged), judged.validations, strict=True):
        assert row["fit %"] == f"{v.fit:.1f}"
        assert row["1 step"] == f"{v.ahead[1][1]:.1f}"
        assert row["one step"] == f"{sum(t.passed for t in v.tests['one step ahead'])}/5"
        assert row["unit"] == "mm"
        assert float(row["RMS"]) == pytest.approx(1e3 * v.rms, rel=5e-3)
        assert row["long run"] == "stable"
    assert any(line.startswith("<test>") for line in table(judged))


def test_the_page_needs_nothing_else_and_shows_every_record(folder):
    html = page(judge(source()))
    own = re.sub(r'<script type="text/plain" id="plotly">.*?</script>', "", html, flags=re.S)
    assert len(own) < len(html) < 1_000_000  # Plotly is inside
    assert "://" not in own
    assert not re.search(r"<(link|img|iframe)|@import|url\(|src=", own)
    assert "<test>" not in own
    assert own.count("&lt;test&gt;") > 3
    assert own.count("<svg") == own.count("</svg>")
    assert own.count('class="plot"') == 2
    assert "nan" not in re.sub(r"<(style|script).*?</\1>", "", own, flags=re.S).lower()


def test_a_residual_test_says_how_many_lags_chance_allows_and_why_it_failed(folder):
    judged = judge(source())
    found = re.findall(r"(passed|failed)</span><span>(\d+) of \d+ lags outside, chance allows (\d+)(;?)", page(judged))
    assert len(found) == sum(len(tests) for v in judged.validations for tests in v.tests.values())
    assert {word for word, *_ in found} == {"passed", "failed"}
    for word, outside, allowed, too_far in found:
        assert (word == "failed") == (int(outside) > int(allowed) or too_far == ";")


def test_a_zoomed_run_holds_every_sample_and_a_long_one_its_extremes():
    (v,) = validate(linear(), {"run": record(1000, equation_noise=0.1)}, period=0.5)
    traces = run_data(v, 0.5, DRAWN)["traces"]
    drawn = unpacked(traces["measured"]["y"])
    np.testing.assert_allclose(drawn, 1e3 * v.measured, atol=0.51 * traces["measured"]["y"]["step"])
    assert traces["measured"]["dx"] == 0.5
    (v,) = validate(linear(), {"run": record(3 * DRAWN, equation_noise=0.1)}, period=0.5, horizons=(1,))
    y, x = (unpacked(run_data(v, 0.5, DRAWN)["traces"]["error"][axis]) for axis in "yx")
    e = 1e3 * (v.measured - v.predicted)
    assert len(x) == len(y) <= DRAWN
    assert np.all(np.diff(x) > 0)
    assert (y.min(), y.max()) == pytest.approx((e.min(), e.max()), rel=1e-5)


def test_the_curves_of_a_page_share_its_points(monkeypatch):
    drawn = []
    monkeypatch.setattr(sections, "pictures", lambda v, period, points: drawn.append(points))
    validations = [SimpleNamespace(record=f"run{k}", output="y") for k in range(7)]
    sections.records(SimpleNamespace(validations=validations, period=1.0))
    assert 3 * sum(drawn) <= POINTS < 3 * 7 * DRAWN, "measured, predicted and error of each"


def test_a_network_of_the_catalogue_is_judged_on_what_it_learnt_from_too(folder):
    channels = {"u_valve": np.sin(np.arange(300.0)), "p_oil": np.cos(np.arange(300.0))}
    Recording(1.0, channels, {"u_valve": "1", "p_oil": "1"}).write_csv("mine.csv")
    judged = judge(Source("crane", {"mine": "mine.csv"}))
    assert [v.record for v in judged.validations] == ["train", "mine"]
    assert judged.training == ("train",)
    with pytest.raises(InputError, match="name yours otherwise"):
        judge(Source("crane", {"train": "mine.csv"}))


def test_the_command_prints_a_table_writes_a_page_and_exits_with_0(folder):
    code, out, error = greygate("validate", "arx.toml", "train.csv", "new=<test>.csv")
    assert (code, error) == (
        0,
        "network arx does not say its sample time; taken as that of train.csv (10 ms)\n",
    )
    assert out.splitlines()[-1] == "written to validation.html"
    assert [line.split()[0] for line in out.splitlines()[2:4]] == ["train*", "new"]
    assert (folder / "validation.html").read_text().startswith("<!doctype html>")


def test_an_unbounded_free_run_is_exit_code_1_with_page_and_json(folder):
    done = CliRunner().invoke(cli.app, ["validate", "wild.toml", "train.csv", "--json", "--html", "w.html"])
    assert done.exit_code == 1
    found = json.loads(done.stdout)
    assert found["bounded"] is False
    assert found["outputs"][0]["rms"] is None
    assert "unbounded" in (folder / "w.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["arx.toml"], "no recordings"),
        (["nobody"], "no network is called 'nobody'"),
        (["arx.toml", "missing.csv"], "missing.csv: cannot be read"),
        (["arx.toml", "train.csv", "--lags", "200"], "600 samples are too few for 200 lags"),
        (["arx.toml", "train.csv", "--html", "no/page.html"], "cannot write here"),
    ],
)
def test_wrong_use_is_named_and_nothing_is_written(folder, arguments, message):
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match=message):
        CliRunner().invoke(cli.app, ["validate", *arguments], catch_exceptions=False)
    assert sorted(folder.rglob("*")) == before


def test_a_saved_network_is_validated_as_the_one_in_memory(folder):
    judged = judge(source())
    r = record(600, seed=0, equation_noise=0.2)
    (v,) = validate(Network.load("arx"), {"train": r}, period=1e-2)
    assert v.rms == judged.validations[0].rms


@pytest.mark.parametrize("error", [[1e29] * 5, [1e29, 1e29 * (1 + 1e-15)], [0.0] * 5, [-3.0] * 5, [1e-300, 2e-300]])
def test_the_errors_of_a_record_that_rests_are_drawn(error):
    assert "<svg" in histogram(np.array(error), "m")
