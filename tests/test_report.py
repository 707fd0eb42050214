"""The report: its figures are those of the programs it is about, and its page needs nothing but itself."""

import json
import re

import numpy as np
import pytest

from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.compiler.study import study
from greygate.emulator.interpreter import interpret
from greygate.emulator.program import Affine
from greygate.errors import InputError
from greygate.machines.catalog import entry
from greygate.machines.source import Source
from greygate.models.drawn import envelope
from greygate.models.network import Layer, Network, Port
from greygate.models.spectra import frequency_response
from greygate.models.training.record import Record
from greygate.pages.figures import Scale
from greygate.pages.report import page, write
from greygate.pages.units import display, number, shown

PERIOD = 2e-3
RATES = np.array([0.02, 0.05])


def network() -> Network:
    """Input u drives a position [m] and two pressures [Pa]: outputs of one and of two elements, states in a loop."""
    rng = np.random.default_rng(3)
    n = Network("small", [Port("u", "V", 2.0)], [Port("x", "m", 1e-3), Port("p", "Pa", 1e7, 2e5, size=2)])
    n.add(
        "hidden", Layer({"u": 0.7 * rng.normal(size=(6, 1)), "p": 0.3 * rng.normal(size=(6, 2))}, np.zeros(6), "tansig")
    )
    n.add("state", Layer({"h": 0.05 * rng.normal(size=(2, 6)), "p": np.diag(1 - RATES)}, np.zeros(2)))
    n.add("sum", Layer({"h": rng.normal(size=(1, 6)) / 3}, [0.0]))
    n.connect("u", "hidden.u")
    n.connect("state", "hidden.p", delay=1)
    n.connect("hidden", "state.h")
    n.connect("state", "state.p", delay=1)
    n.connect("hidden", "sum.h")
    n.connect("sum", "x")
    n.connect("state", "p")
    return n.check()


def record(seed: int, steps: int, skip: int = 0) -> Record:
    """The network's own answer with a little noise, as a plant that it knows almost exactly."""
    rng = np.random.default_rng(seed)
    u = {"u": np.repeat(rng.uniform(-1.5, 1.5, steps // 10), 10)}
    y = network().run(u)
    noise = {"x": 2e-6, "p": 3e4}
    return Record(u, {k: v + noise[k] * rng.normal(size=v.shape) for k, v in y.items()}, skip=skip)


@pytest.fixture(scope="module")
def records():
    return {"training": record(1, 800), "other <run>": record(2, 500, skip=50)}


@pytest.fixture(scope="module")
def compiled(records):
    return compile_network(network(), records, Formats(14), period=PERIOD)


@pytest.fixture(scope="module")
def found(compiled, records):
    return study(
        "Small & measured",
        compiled,
        records,
        ranged_on=["training"],
        period=PERIOD,
        references={"paper": {"training": {"x": 3e-6, "p[0]": (3e4, 4e4)}}},
        hardware={
            "parallel": {
                "clocks_per_step": 9,
                "scenarios": {
                    "training": {"steps": 800, "differing_bits": 0},
                    "other <run>": {"steps": 500, "differing_bits": 3},
                },
            }
        },
        resources={"parallel, ecp5": {"luts": 1234, "clock_mhz": None}},
        widths=(4, 10, 14, 20),
    )


def test_the_study_is_plain_json_with_finite_numbers(found):
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_its_errors_are_those_of_the_interpreter_and_of_the_float_network(found, compiled, records):
    for name, r in records.items():
        codes = interpret(compiled.program, compiled.program.encode(r.inputs)).outputs
        fixed, floating = compiled.program.decode(codes), network().run(r.inputs)
        outputs = found["scenarios"][name]["outputs"]
        assert set(outputs) == {"x", "p[0]", "p[1]"}
        for label, o in outputs.items():
            port, column = label[0], slice(None) if label == "x" else (slice(None), int(label[2]))
            reference, a, b = (np.asarray(v[port][column])[r.skip :] for v in (r.targets, floating, fixed))
            assert o["rmse"]["float"] == pytest.approx(np.sqrt(np.mean((a - reference) ** 2)), rel=1e-9)
            assert o["rmse"]["fixed"] == pytest.approx(np.sqrt(np.mean((b - reference) ** 2)), rel=1e-12)
            assert o["quantization"]["rms"] == pytest.approx(np.sqrt(np.mean((b - a) ** 2)), rel=1e-9)
            assert o["quantization"]["max"] == pytest.approx(np.abs(b - a).max(), rel=1e-9)
            assert o["ratio"] == o["rmse"]["fixed"] / o["rmse"]["float"]


def test_hardware_without_a_differing_bit_has_the_error_of_fixed_point_and_else_none(found):
    for o in found["scenarios"]["training"]["outputs"].values():
        assert o["hardware"]["parallel"]["rmse"] == o["rmse"]["fixed"]
    for o in found["scenarios"]["other <run>"]["outputs"].values():
        assert o["hardware"]["parallel"]["rmse"] is None


def test_the_curve_passes_through_the_compiled_program_and_falls_to_one(found):
    widths = found["widths"]
    assert widths["word"] == 14
    for name, s in found["scenarios"].items():
        for label, o in s["outputs"].items():
            curve = widths["ratio"][name][label]
            assert curve[2] == o["ratio"]
            assert curve[3] == pytest.approx(1, abs=0.01)


def test_every_signal_stands_beside_its_format_with_what_was_seen_and_what_is_proved(found, compiled):
    signals = {s["name"]: s for s in found["signals"]}
    assert list(signals) == list(compiled.program.signals)
    for name, s in signals.items():
        low, high = s["observed"]
        assert s["holds"][0] <= low <= high <= s["holds"][1] + 1e-3, name
        if s["sound"]:
            assert s["sound"][0] <= low <= high <= s["sound"][1]
        assert s["saturations"] == {}
    assert signals["hidden.n"]["kind"] == "operation"
    quantiles = signals["hidden"]["quantiles"]
    assert quantiles == sorted(quantiles)
    assert quantiles[-1] <= 1
    assert signals["state"]["note"] == compiled.program.notes["state"]
    assert found["tables"][0]["worst_error"] == compiled.program.tables[0].worst_error


def test_inputs_beyond_their_format_are_counted(compiled, records):
    loud = Record({"u": 3 * records["training"].inputs["u"]}, records["training"].targets)
    s = study("loud", compiled, {**records, "loud": loud}, ranged_on=["training"], period=PERIOD, widths=())
    u = next(x for x in s["signals"] if x["name"] == "u")
    assert u["saturations"]["loud"] == np.count_nonzero(np.abs(loud.inputs["u"] / 2) > 1)
    assert "None</span>, of any signal" not in page([s])


def test_the_weights_of_a_layer_stand_in_the_least_format_that_holds_them(compiled, found):
    sums = [o for o in compiled.program.operations if isinstance(o, Affine)]
    shown = {w["name"]: w for w in found["weights"]}
    assert sum(w["size"] for w in shown.values()) == sum(
        np.count_nonzero(o.weights) + np.count_nonzero(o.bias) for o in sums
    )
    for o in sums:
        columns = np.cumsum([0, *(compiled.program.signals[a].size for a in o.args)])
        for k, arg in enumerate(o.args):
            codes = o.weights[:, columns[k] : columns[k + 1]]
            exact = codes * 2.0 ** (compiled.program.signals[arg].fix.frac - o.frac)[:, None]
            w = shown[f"{o.out.name}: {arg}"]
            held = exact * 2.0 ** w["frac"]
            assert np.array_equal(held, np.floor(held))
            assert (held % 2).any(), "a bit less behind the point would not do"
            assert 2 ** (w["width"] - 2) <= np.abs(held).max() < 2 ** (w["width"] - 1)


def test_the_page_loads_nothing_and_shows_every_scenario_and_output(found):
    html = re.sub(
        r'<script type="text/plain" id="plotly">.*?</script>', "", page([found]), flags=re.S
    )  # without Plotly
    assert "://" not in html
    assert not re.search(r"<(link|img|iframe)|@import|url\(|src=", html)
    for text in ("Small &amp; measured", "training", "other &lt;run&gt;", "p[0]", "p[1]", "x [µm]", "paper", "1,234"):
        assert text in html, text
    assert "other <run>" not in html
    assert html.index('"reference": {') < html.index('"fixed": {'), "fixed point is drawn over the reference"
    assert "3 bits differ" in html
    assert "nan" not in re.sub(r"<(style|script).*?</\1>", "", html, flags=re.S).lower().replace("nano", "")
    assert html.count("<svg") == html.count("</svg>")


def test_page_and_json_are_written_together_and_replace_what_was_there(found, tmp_path):
    html, data = tmp_path / "report.html", tmp_path / "report.json"
    html.write_text("old")
    write([found, found], html, data)
    assert json.loads(data.read_text()) == [found, found]
    assert html.read_text() == page([found, found])
    with pytest.raises(InputError, match="cannot write here"):
        write([found], html, tmp_path / "missing" / "report.json")
    assert html.read_text() == page([found, found])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.html", "report.json"]


def test_a_scenario_that_is_not_there_is_named(compiled, records):
    with pytest.raises(InputError, match="no scenario v3"):
        study("s", compiled, records, ranged_on=["v3"], period=PERIOD)


def test_a_delayed_and_damped_copy_has_its_gain_and_phase():
    y = np.random.default_rng(0).normal(size=20_000)
    r = frequency_response(y, {"copy": 0.8 * np.roll(y, 3)}, 1e-3)
    f = r["frequency"]
    assert np.allclose(r["copy"]["magnitude"], 0.8, rtol=0.02)
    low = f < 100
    assert np.allclose(r["copy"]["phase"][low], -360 * f[low] * 3e-3, atol=2)
    assert len(f) <= 200


def test_a_constant_reference_has_no_response_but_a_page(compiled, records):
    still = records["training"]
    still = Record(still.inputs, {n: np.zeros_like(v) for n, v in still.targets.items()})
    s = study("still", compiled, {"still": still}, ranged_on=["still"], period=PERIOD, widths=(14,))
    assert set(s["scenarios"]["still"]["outputs"]["x"]["frf"]["fixed"]["magnitude"]) == {None}
    assert "still" in page([s])


def test_an_envelope_keeps_the_extremes_of_a_long_run():
    values = np.random.default_rng(1).normal(size=60_000)
    e = envelope(values, 100)
    assert len(e["step"]) <= 200
    assert e["step"] == sorted(e["step"])
    assert max(e["value"]) == pytest.approx(values.max(), rel=1e-5)
    assert min(e["value"]) == pytest.approx(values.min(), rel=1e-5)


@pytest.mark.parametrize(
    ("value", "unit", "reach", "text"),
    [
        (55_200, "Pa", 0, "0.552"),
        (3.2e-5, "m", 0, "32.0"),
        (2e-3, "m", 2e-3, "2.00"),
        (0.5, "1", 0, "0.500"),
        ((33_000, 50_000), "Pa", 0, "0.330 to 0.500"),
        (None, "Pa", 0, "–"),
    ],
)
def test_figures_are_shown_in_the_unit_that_a_person_reads(value, unit, reach, text):
    assert shown(value, unit, reach) == text


def test_units_without_a_habit_stay_as_they_are():
    assert display("rad/s") == (1.0, "rad/s")
    assert display("1") == (1.0, "")


@pytest.mark.parametrize(
    "scale", [Scale(0, 10, 300), Scale(-3e-7, 2e-7, 60), Scale(0.5, 500, 300, True), Scale(0.9, 1.3, 60, True)]
)
def test_ticks_are_round_inside_the_scale_and_at_least_two(scale):
    ticks = scale.ticks()
    assert len(ticks) >= 2
    assert all(scale.low <= t <= scale.high for t in ticks)


def test_numbers_have_three_digits():
    assert [number(v) for v in (0, 1234.5, 0.001234, 3.3e-5, -2.5e9)] == [
        "0",
        "1234",
        "0.00123",
        "3.30·10⁻⁵",
        "−2.50·10⁹",
    ]


@pytest.mark.parametrize("name", ["valve_cylinder", "asymmetric_cylinder"])
def test_what_was_published_of_a_machine_stands_beside_its_pressures(name):
    published = Source(name).references["thesis"]
    assert published
    assert published.keys() <= set(entry(name).scenarios)
    assert all(set(errors) == {"p_a", "p_b"} and min(errors.values()) > 0 for errors in published.values())
