"""The page that argues the case of a diagnosis."""

import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from datetime import date
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.mismatch import rig, words
from greygate.mismatch.concealed.conceal import conceal
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.words import amount
from greygate.pages.diagnosis import advice
from greygate.pages.diagnosis import page as draw
from greygate.pages.diagnosis.residual import binned, dependence, residuals
from greygate.pages.diagnosis.sections import _inputs, _points, _within
from greygate.pages.zoomable import DRAWN, POINTS, unpacked

PLANT = """step = 1e-3
outputs = ["x"]
[inputs]
force = "N"
[parameters]
mass = [20.0, "kg"]
viscous = [400.0, "N s/m"]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations.position]
x = { velocity = "v" }
[equations.motion]
v = { storage = "mass", drive = "force", viscous = "-viscous * v" }
"""
RIG = """plant = "axis.toml"
sample_time_s = 0.005
window_s = 0.5
predict = ["x"]
parameters = { mass = 20.0, viscous = 400.0 }
tolerance = { viscous = 0.1 }
channels.force = { unit = "N", role = "input", resolution = 1e-3 }
channels.x = { unit = "m", role = "output", noise_rms = 2e-6 }
"""
SPRING = """[spring]
means = "a spring"
plants = ["axis"]
equations = ["motion"]
depends_on = ["x"]
parameters.k = { unit = "N/m", typical = 100.0, low = 0.0 }
terms."motion.spring" = "-k * x"
"""


@pytest.fixture(scope="module")
def drum(tmp_path_factory):
    """Diagnosis of a drum that conceals a slip that grows with speed, and its page."""
    folder = conceal("cable_drum", 3, tmp_path_factory.mktemp("drum") / "case", effect="speed_slip", kind="one")
    result = diagnose(rig.load(folder))
    return result, draw(result)


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    """Diagnosis of a rig that restarts, with a plant and a table of its own."""
    from greygate.mismatch import effects
    from greygate.plants.plant import Plant
    from greygate.plants.simulator import simulate

    folder = tmp_path_factory.mktemp("axis")
    for name, text in (("axis.toml", PLANT), ("rig.toml", RIG), ("mine.toml", SPRING)):
        (folder / name).write_text(text)
    rng = np.random.default_rng(2)
    real = Plant.read(folder / "axis.toml").with_term("motion", "spring", "-600 * x")
    for name, samples in (("identify", 1200), ("holdout", 800)):
        force = 60 * np.repeat(rng.standard_normal(samples // 40), 40)
        x = simulate(real, {"force": force}, sample_time=5e-3, step=1e-3)["x"] + 2e-6 * rng.standard_normal(samples)
        columns = np.column_stack([np.arange(samples) * 5e-3, force, x])
        np.savetxt(folder / f"{name}.csv", columns, delimiter=",", header="t,force,x", comments="", fmt="%.9g")
    return diagnose(rig.load(folder), effects=effects.read(folder / "mine.toml"))


def charts(page: str) -> list[str]:
    return re.findall(r'(<svg class="chart".*?</svg>)\s*</figure>', page, re.S)


def test_the_page_needs_nothing_else_and_every_picture_is_whole(drum):
    _, page = drum
    assert not re.search(r'(src|href)="(?!#)', re.sub(r"<script>.*?</script>", "", page, flags=re.S))
    assert "prefers-color-scheme: dark" in page
    pictures = charts(page)
    assert len(pictures) == 1 + 4 + 4 + 1  # largest misfit, x v a t, maps, ladder
    runs = re.findall(r'<script type="application/json">(.*?)</script>', page, re.S)
    first, traces = (json.loads(run)["traces"] for run in runs)  # to zoom
    assert [(name, trace["below"]) for name, trace in first.items()] == [
        ("recorded", False), ("data sheet", False), ("corrected", False), ("x_drum", True),
    ]  # fmt: skip
    assert list(traces) == ["calibrated", "corrected"]
    before, after = (unpacked(t["y"]) for t in traces.values())
    assert min(np.isfinite(before).mean(), np.isfinite(after).mean()) > 0.95
    assert np.nanstd(after) < 0.1 * np.nanstd(before)
    for picture in pictures:
        ElementTree.fromstring(picture)
        assert "nan" not in picture


def test_the_curves_of_a_diagnosis_share_the_points_of_its_page():
    """One channel is drawn with its inputs, and the errors of all."""
    rig = SimpleNamespace(inputs=["u"] * 5, predict=["y"] * 4)
    curves = 3 + 5 + 2 * 4
    assert curves * _points(SimpleNamespace(result=SimpleNamespace(rig=rig))) <= POINTS < curves * DRAWN


def test_the_page_says_what_the_diagnosis_says(drum):
    result, page = drum
    found = result.as_dict()
    assert found["verdict"] == "missing_physics"
    assert "<b>speed_slip</b>: slip per travel that grows with speed" in page
    value = found["effects"][0]["parameters"]["speed_slip"]
    assert amount(value["value"], value["ci95"], value["unit"]).value in page
    known = amount(value["value"], value["ci95"], value["unit"])
    assert f"<td>{known.low} to {known.high}</td>" in page
    framed = re.findall(r'<figure class="told"><figcaption><b>(\w+)</b>', page)
    assert framed == found["where"][0]["depends_on"]


def test_the_first_screen_says_how_sure_it_is_and_what_to_do_next(drum):
    result, page = drum
    first = page[: page.index('id="fit"')]
    sure = result.as_dict()["effects"][0]["confidence"]
    assert f"confidence {sure:.2g}: {advice.trust(sure)}" in first
    assert f"Simulate with speed_slip: greygate simulate {result.rig.folder} FILE.csv" in first
    foot = page[page.rindex('<p class="soft">') :]
    assert f"greygate diagnose {result.rig.folder}, {date.today()}" in foot


def test_figures_are_tables(drum):
    result, page = drum
    figures = page[page.index('id="figures"') :]
    assert "<pre" not in page
    for recording, channel, unit, *errors in words.fit_rows(result.as_dict()["fit"]):
        cells = [f"<td>{recording}</td>", f'<td class="text">{channel}</td>', *(f"<td>{e}</td>" for e in errors)]
        assert "".join([*cells, f'<td class="text">{unit}</td>']) in figures
    creep = result.as_dict()["parameters"]["creep"]
    value = amount(creep["value"], creep["ci95"], creep["unit"])
    known = words.given(result.rig.plant.parameters["creep"], creep["value"])
    row = figures[figures.index("<b>creep</b>") :].partition("</tr>")[0]
    assert all(f"<td>{cell}</td>" in row for cell in (value.value, f"{value.low} to {value.high}", known))


@pytest.mark.parametrize(
    ("verdict", "change", "said"),
    [
        ("consistent", {"effects": []}, ["Nothing needs a correction"]),
        (
            "parameter_error",
            {"effects": [], "parameters": {"creep": {"outside_tolerance": True}}},
            ["Measure creep anew"],
        ),
        ("recording_fault", {}, ["Mend what the recording has (speed_slip)"]),
        ("unexplained", {"effects": [], "where": [{"formula": "2 x"}]}, [" --accept."]),
        ("unexplained", {"effects": [], "where": []}, ["Look at the pictures"]),
        ("missing_physics", {"not_tried": ["drift"] * 3}, ["Simulate with", "3 hypotheses were not tried"]),
        ("missing_physics", {"units": ["a: N, b: m"]}, ["Simulate with", "Correct the units: a: N, b: m."]),
    ],
)
def test_what_to_do_next_goes_by_the_verdict(drum, verdict, change, said):
    found = {**drum[0].as_dict(), "verdict": verdict, **change}
    told = advice.steps(SimpleNamespace(found=found, result=drum[0]))
    assert len(told) == len(said)
    assert all(part in text for part, text in zip(said, told, strict=True))


def test_what_a_confidence_is_worth_is_what_sealed_cases_say():
    """`python -m benchmarks blind` writes them anew."""
    results = Path(__file__).parent.parent / "benchmarks/results/blind.json"
    bins = json.loads(results.read_text())["greygate"]["reliability"]
    ends = [*(part[0] for part in advice.RELIABLE[1:]), 1.0]
    for (low, claims, right), high in zip(advice.RELIABLE, ends, strict=True):
        inside = [b for b in bins if low <= b["from"] < high]
        assert (claims, right) == (sum(b["claims"] for b in inside), sum(b["right"] for b in inside))
    assert advice.trust(0.79).startswith("13 of 27 claims")
    assert advice.trust(0.99).startswith("111 of 111 claims")


def test_inputs_of_several_units_are_drawn_in_parts_of_their_largest(drum):
    result = drum[0]
    signals = {"a": np.array([0.0, 2.0]), "b": np.array([-300.0, 100.0])}
    channels = {"a": rig.Channel("V", "input"), "b": rig.Channel("N", "input")}
    several = SimpleNamespace(result=SimpleNamespace(rig=replace(result.rig, channels=channels)))
    traces, label = _inputs(several, SimpleNamespace(recording=signals))
    assert label.startswith("inputs, of their largest")
    assert [t.values.tolist() for t in traces.values()] == [[0.0, 1.0], [-1.0, pytest.approx(1 / 3)]]


def test_a_simulation_that_runs_away_flattens_nothing():
    target = np.array([1.0, 3.0, 2.0])
    np.testing.assert_array_equal(_within(np.array([5.0, -1.0, 2.0]), target), [5.0, -1.0, 2.0])
    np.testing.assert_array_equal(_within(np.array([5.1, -1.1, 2.0]), target), [np.nan, np.nan, 2.0])


def test_every_hypothesis_that_was_fitted_stands_on_the_ladder_the_one_taken_first(drum):
    result, page = drum
    ladder = charts(page)[-1]
    for hypothesis in result.rivals:
        assert f">{hypothesis}<" in ladder
    assert re.search(r'font-weight="600">speed_slip</text>', ladder)
    assert ladder.count("good-dot") == 1


def test_a_concealed_dependence_is_seen_before_and_gone_after(axis):
    """Of a rig that restarts, the drift of its position tells the force that is missing."""
    before, after = residuals(axis, [axis.calibrated, axis.corrected])
    assert [e["id"] for e in axis.as_dict()["effects"]] == ["spring"]
    assert list(before.errors) == ["x drifts"]
    assert before.units["x drifts"] == "m/s"
    x = before.variables["x"]
    assert dependence(x, before.errors["x drifts"]) > 0.9
    size = [np.median(np.abs(r.errors["x drifts"])) for r in (before, after)]
    assert size[1] < 0.05 * size[0]
    assert np.corrcoef(x, before.errors["x drifts"])[0, 1] < -0.9  # it pulls back
    assert "x drifts" in draw(axis)


def test_quartiles_are_those_of_what_lies_in_a_part():
    x, y = np.repeat([1.0, 2.0, 3.0], 100), np.tile(np.arange(100.0), 3)
    middle, quartiles = binned(x, y + 1000 * x)
    assert len(middle) == 3
    np.testing.assert_allclose(quartiles[0], 1000 + np.percentile(np.arange(100.0), (25, 50, 75)))


def test_a_variable_that_says_nothing_explains_nothing():
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, 5000))
    assert dependence(x, y) < 0.02
    assert dependence(x, x) > 0.9
    assert dependence(x, np.ones(5000)) == 0.0
