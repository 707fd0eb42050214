"""The valve cylinder of the thesis, its supply, its excitation and its scenarios."""

import re
from ctypes import POINTER
from pathlib import Path

import numpy as np
import pytest
from numpy.ctypeslib import as_ctypes_type
from scipy.integrate import solve_ivp

from greygate.errors import InputError
from greygate.machines.valve_cylinder.line import Line
from greygate.machines.valve_cylinder.plant import CYLINDER, SUPPLY, spool_discrete, valve_cylinder
from greygate.machines.valve_cylinder.scenarios import RESOLUTION, converted, scenario
from greygate.plants import Plant, band_limited_noise, chirp, multisine, prms, read_csv, simulate
from greygate.plants.simulator import _module, source

STATES = ("i", "u", "u_dot", "x", "v", "z", "p_a", "p_b")
DOCS = Path(__file__).parents[1] / "docs" / "plants.md"


def modal(line, gains, s):
    """The sum over the modes of a fitted function at complex `s`."""
    omega = line.frequencies(len(gains))
    return (
        (gains[:, 0] * s[:, None] * omega + gains[:, 1] * omega**2)
        / (s[:, None] ** 2 + line.damping * s[:, None] + omega**2)
    ).sum(1)


def rig_equations(state, v_c, f_ext):
    """The valve rig of RIGS.md with the values of thesis table 5.1, written out by hand; supply constant."""
    i, u, u_dot, x, v, z, p_a, p_b = state
    p_s, p_t, area, beta, k_valve = 2e7, 0.0, 645e-6, 1.4e9, 3.2e-5

    def orifice(u, p_1, p_2):
        return u * np.sign(p_1 - p_2) * np.sqrt(abs(p_1 - p_2)) if u > 0 else 0.0

    q_a = k_valve * (orifice(u, p_s, p_a) - orifice(-u, p_a, p_t))
    q_b = k_valve * (orifice(-u, p_s, p_b) - orifice(u, p_b, p_t))
    g = (100.0 + (130.0 - 100.0) * np.exp(-((v / 0.1) ** 2))) / 12e5
    z_dot = v - abs(v) * z / g
    friction = 12e5 * z + 300.0 * z_dot + 60.0 * v
    return [
        (v_c - 100.0 * i) / 0.59,
        u_dot,
        1256.0**2 * 0.0401 * i - 2 * 0.7 * 1256.0 * u_dot - 1256.0**2 * u,
        v,
        ((p_a - p_b) * area - 2000.0 * v - 10.0 * x - friction - f_ext) / 9.0,
        z_dot,
        beta / (5e-5 + area * x) * (q_a - area * v),
        beta / (5e-5 - area * x) * (q_b + area * v),
    ]


def test_the_generated_equations_are_those_of_the_rig():
    plant = valve_cylinder("constant")
    module = _module(source(plant))
    parameters = np.array([p.value for p in plant.parameters.values()])
    on = module.asked(parameters).view(np.uint8)
    assert tuple(plant.states) == STATES
    rng = np.random.default_rng(0)
    scale = np.array([0.01, 6e-4, 0.1, 0.04, 0.1, 1e-4, 1e7, 1e7])
    for _ in range(200):
        state = rng.uniform(-1, 1, 8) * scale + [0, 0, 0, 0, 0, 0, 1.1e7, 1.1e7]
        inputs, found = rng.uniform(-1, 1, 2) * [1.5, 3000], np.empty(8)
        arrays = state, inputs, parameters, on, found
        module.all_terms.ctypes(*(a.ctypes.data_as(POINTER(as_ctypes_type(a.dtype))) for a in arrays))
        np.testing.assert_allclose(found, rig_equations(state, *inputs), rtol=1e-11)


def test_fixed_steps_agree_with_an_adaptive_solver_at_tight_tolerance():
    v_c, f_ext = np.repeat([1.2, -0.8, 0.3, 1.0], 60), np.repeat([0.0, 800.0], 120)
    state, exact = np.array([0, 0, 0, 0, 0, 0, 1e7, 1e7]), []
    for k in range(len(v_c)):
        exact.append(state)
        held = (v_c[k], f_ext[k])
        state = solve_ivp(
            lambda t, s, held=held: rig_equations(s, *held), (0, 1e-3), state, method="DOP853", rtol=1e-10, atol=1e-12
        ).y[:, -1]
    for step, bound in ((1e-4, dict.fromkeys(STATES, 5e-6) | {"z": 5e-5}), (1e-5, dict.fromkeys(STATES, 1e-6))):
        run = simulate(valve_cylinder("constant"), {"v_c": v_c, "f_ext": f_ext}, step=step, channels=STATES)
        for name, column in zip(STATES, np.transpose(exact), strict=True):
            assert np.abs(run[name] - column).max() < bound[name] * np.abs(column).max(), (name, step)


def test_with_the_full_supply_a_step_of_a_tenth_moves_no_pressure_by_a_hundredth_of_a_bar():
    inputs = {"v_c": prms(2000, -0.9, 0.9, (10, 100), seed=5), "f_ext": np.zeros(2000)}
    coarse, fine = (simulate(valve_cylinder(), inputs, step=step) for step in (1e-4, 1e-5))
    for name in ("p_a", "p_b", "p_s"):
        assert np.abs(coarse[name] - fine[name]).max() < 1e3


def test_the_declared_values_are_those_of_the_thesis():
    assert CYLINDER["k_valve"].value == pytest.approx(0.625 * 1.08e-3 * np.sqrt(2 / 890), rel=1e-3)
    assert SUPPLY["displacement"].value * 2 * np.pi == pytest.approx(16e-6)
    assert all(p.unit and p.meaning for p in (CYLINDER | SUPPLY).values())


def test_the_full_supply_starts_in_its_steady_state_and_stays_there():
    plant = valve_cylinder()
    rest = {"v_c": np.zeros(1001), "f_ext": np.zeros(1001)}
    run = simulate(plant, rest, channels=tuple(plant.states))
    start = plant.initial()
    assert 2.0e7 < start["p_pump"] < 2.03e7
    assert start["p_a"] == start["p_b"] == start["p_pump"] / 2
    for name in plant.states:
        np.testing.assert_allclose(run[name], start[name], rtol=1e-9, atol=1e-12)


def test_the_supply_settles_to_the_same_steady_state_from_elsewhere():
    plant = valve_cylinder()
    rest = {"v_c": np.zeros(15001), "f_ext": np.zeros(15001)}
    run = simulate(plant, rest, initial={"p_pump": 1.8e7, "omega": 120.0}, channels=["p_s", "p_pump", "omega"])
    for name in ("p_pump", "omega"):
        assert run[name][-1] == pytest.approx(plant.initial()[name], rel=2e-5)
    assert run["p_s"][-1] == pytest.approx(run["p_pump"][-1], rel=1e-7)


def test_the_steady_supply_spends_what_the_motor_takes_in():
    plant = valve_cylinder()
    k = {name: p.value for name, p in plant.parameters.items()}
    s = plant.initial()
    taken = k["voltage"] * s["i_motor"]
    copper = k["r_motor"] * s["i_motor"] ** 2
    shaft = k["k_fric"] * s["omega"] ** 2
    oil = k["displacement"] * s["omega"] * s["p_pump"]
    assert taken == pytest.approx(copper + shaft + oil / k["eta_mech"], rel=1e-12)
    flows = plant.values(["q_relief", "q_line", "q_gas", "q_control"], s)
    assert flows["q_relief"] == pytest.approx(k["displacement"] * s["omega"] - k["c_pump"] * s["p_pump"], rel=1e-12)
    for name in ("q_line", "q_gas", "q_control"):
        assert abs(flows[name]) < 1e-12


def test_flow_into_the_valve_lowers_its_pressure_by_the_resistance_of_the_line():
    steady = {"v_c": np.full(400, 0.9), "f_ext": np.zeros(400)}
    run = simulate(valve_cylinder(), steady, channels=["p_s", "p_pump", "q_s", "q_line"])
    drop = (run["p_pump"] - run["p_s"])[300:]
    np.testing.assert_allclose(drop, Line().resistance * run["q_s"][300:], rtol=0.02)
    np.testing.assert_allclose(run["q_line"][300:], run["q_s"][300:], rtol=0.02)


def test_the_fitted_line_is_within_half_a_percent_of_the_four_pole_line_up_to_1_khz():
    line, s = Line(), 2j * np.pi * np.linspace(1, 1000, 1500)
    fitted = line.fit()
    for name, exact in line.four_pole(s).items():
        assert np.abs(modal(line, fitted[name], s) - exact).max() < 5e-3 * np.abs(exact).max()


def test_the_fitted_line_is_exact_at_rest_stable_and_strictly_proper():
    line = Line()
    assert line.resistance == pytest.approx(128 * 890 * 1e-4 / (np.pi * 5e-3**4))
    for name, gains in line.fit().items():
        dc = {"transmission": 1.0, "impedance": line.resistance, "admittance": 0.0}[name]
        scale = np.abs(gains).sum()
        assert abs(modal(line, gains, np.array([1e-9j]))[0] - dc) < 1e-12 * scale
        assert abs(modal(line, gains, np.array([1e12j]))[0]) < 1e-6 * scale
    for omega in line.frequencies(3):
        assert (np.roots([1, line.damping, omega**2]).real < 0).all()


@pytest.mark.parametrize(("supply", "values", "message"), [
    ("none", {}, "supply 'none'; give 'full' or 'constant'"),
    ("full", {"masss": 1.0}, "'masss' is not among mass"),
    ("constant", {"voltage": 1.0}, "'voltage' is not among mass"),
    ("full", {"voltage": 40.0}, "no steady state with an open relief valve"),
])  # fmt: skip
def test_a_valve_cylinder_that_cannot_be_is_refused(supply, values, message):
    with pytest.raises(InputError, match=message):
        valve_cylinder(supply, **values)


def test_the_lap_of_the_valve_decides_what_flows_near_the_centre():
    signals = {"u": np.array([-1e-5, 0.0, 1e-5]), "p_a": np.full(3, 1e7), "p_b": np.full(3, 1e7)}
    for overlap, flowing in ((0.0, [1, 0, 1]), (2e-5, [0, 0, 0]), (-2e-5, [1, 1, 1])):
        plant = valve_cylinder("constant", overlap=overlap)
        assert (plant.values(["q_s"], signals)["q_s"] > 0).tolist() == [bool(f) for f in flowing]


def test_leakage_is_absent_by_default_and_flows_downhill_when_given():
    signals = {"u": 0.0, "v": 0.0, "x": 0.0, "p_a": np.full(3, 1.2e7), "p_b": np.full(3, 0.8e7)}
    plant = valve_cylinder("constant")
    assert (plant.residual("continuity_a", signals, 1e-3) == 0).all()
    leaking = plant.with_parameters(c_internal=1e-12, c_external=1e-13)
    np.testing.assert_allclose(leaking.residual("continuity_a", signals, 1e-3), 1e-12 * 0.4e7 + 1e-13 * 1.2e7)
    np.testing.assert_allclose(leaking.residual("continuity_b", signals, 1e-3), -1e-12 * 0.4e7 + 1e-13 * 0.8e7)


def test_coil_spool_and_stroke_saturate():
    run = simulate(
        valve_cylinder("constant"),
        {"v_c": np.full(1500, 10.0), "f_ext": np.zeros(1500)},
        channels=["i", "u", "x", "v", "p_a"],
    )
    assert (run["i"].max(), run["u"].max(), run["x"].max()) == (0.015, 0.6e-3, 0.05)
    assert run["v"][-1] == 0.0
    assert run["p_a"][-1] == pytest.approx(2e7, rel=1e-3)


def test_the_discrete_spool_is_the_simulated_spool_and_its_mean():
    plant = valve_cylinder("constant")
    a, b, c, d = spool_discrete(plant)
    v_c = prms(400, -1.0, 1.0, (5, 40), seed=3)
    fine = simulate(
        plant, {"v_c": np.repeat(v_c, 100), "f_ext": np.zeros(40_000)}, sample_time=1e-5, step=1e-5, channels=STATES[:3]
    )
    states = np.stack([fine[name] for name in STATES[:3]], axis=1)
    s = np.zeros(3)
    for k in range(1, 400):
        mean = c @ s + d * v_c[k - 1]
        inside = fine["u"][100 * (k - 1) : 100 * k + 1]
        simpson = (inside[0] + inside[-1] + 4 * inside[1:-1:2].sum() + 2 * inside[2:-1:2].sum()) / 300
        s = a @ s + b * v_c[k - 1]
        np.testing.assert_allclose(s, states[100 * k], rtol=1e-9, atol=1e-13)
        assert abs(mean - simpson) < 1e-13
    assert b.shape == c.shape == (3,)
    assert np.linalg.solve(np.eye(3) - a, b)[1] == pytest.approx(0.0401 / 100, rel=1e-12)


# -- excitation --------------------------------------------------------------------------------------------------------


def test_prms_holds_its_levels_within_bounds():
    signal = prms(20_000, -0.5, 1.0, (10, 30), seed=1, levels=4)
    edges = np.flatnonzero(np.diff(signal)) + 1
    assert set(np.unique(signal)) == set(np.linspace(-0.5, 1.0, 4))
    assert np.diff(edges).min() >= 10
    free = prms(20_000, -0.5, 1.0, (10, 30), seed=1)
    holds = np.diff(np.flatnonzero(np.diff(free)) + 1)
    assert (holds.min(), holds.max()) == (10, 30)
    assert -0.5 <= free.min() < -0.45
    assert 0.95 < free.max() <= 1.0


def test_a_chirp_runs_from_its_first_to_its_last_frequency():
    signal = chirp(5000, 3000.0, 0.1, 5.0, 1e-3)
    assert signal[0] == 0.0
    assert 2999 < signal.max() <= 3000
    crossings = np.flatnonzero(np.diff(np.sign(signal[1:]))) * 1e-3
    assert 1 / (2 * np.diff(crossings)[-1]) == pytest.approx(5.0, rel=0.05)
    assert len(crossings) == int(2 * (0.1 + 5.0) / 2 * 5)


@pytest.mark.parametrize("make", [band_limited_noise, multisine])
def test_noise_and_multisine_keep_to_their_band_and_amplitude(make):
    signal = make(4000, 2.0, 5.0, 50.0, 1e-3, seed=4)
    power = np.abs(np.fft.rfft(signal)) ** 2
    frequency = np.fft.rfftfreq(4000, 1e-3)
    outside = (frequency < 5.0) | (frequency > 50.0)
    assert power[outside].sum() < 1e-20 * power.sum()
    if make is multisine:
        assert np.abs(signal).max() == 2.0
        np.testing.assert_allclose(power[~outside], power[~outside].mean(), rtol=1e-9)
    else:
        assert np.sqrt(np.mean(signal**2)) == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("make", [
    lambda seed: prms(100, -1.0, 1.0, (1, 9), seed),
    lambda seed: band_limited_noise(100, 1.0, 10.0, 100.0, 1e-3, seed),
    lambda seed: multisine(100, 1.0, 10.0, 100.0, 1e-3, seed),
])  # fmt: skip
def test_a_seed_gives_the_same_bits_and_another_seed_another_signal(make):
    np.testing.assert_array_equal(make(1), make(1))
    assert (make(1) != make(2)).any()


@pytest.mark.parametrize("make", [
    lambda: prms(0, -1.0, 1.0, (1, 2), 0),
    lambda: prms(10, 1.0, -1.0, (1, 2), 0),
    lambda: prms(10, -1.0, 1.0, (3, 2), 0),
    lambda: prms(10, -1.0, 1.0, (1, 2), 0, levels=1),
    lambda: chirp(10, 1.0, 0.0, 600.0, 1e-3),
    lambda: multisine(10, 1.0, 10.0, 20.0, 1e-3, 0),
    lambda: band_limited_noise(10, 1.0, 20.0, 10.0, 1e-3, 0),
])  # fmt: skip
def test_an_impossible_excitation_is_refused(make):
    with pytest.raises(InputError, match=r"needs|take a longer record"):
        make()


# -- scenarios ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scenarios():
    return {name: scenario(name) for name in ("training", "v1", "v2")}


def test_scenarios_have_the_lengths_and_channels_of_the_thesis(scenarios):
    assert {name: r.samples for name, r in scenarios.items()} == {"training": 10_001, "v1": 5_000, "v2": 5_000}
    for recording in scenarios.values():
        assert list(recording.channels) == ["v_c", "x", "p_a", "p_b", "p_s", "u", "x_true", "v_true", "f_ext"]
        assert recording.dt == 1e-3


def test_scenarios_are_deterministic_to_the_bit(scenarios):
    again = scenario("v2")
    for name, values in scenarios["v2"].channels.items():
        np.testing.assert_array_equal(again[name], values)


def test_the_piston_stays_off_its_stops_and_the_pressures_within_the_supply(scenarios):
    for recording in scenarios.values():
        assert np.abs(recording["x_true"]).max() < 0.0499
        for name in ("p_a", "p_b"):
            assert recording[name].min() > 0
            assert (recording[name] < recording["p_s"]).all()
        assert np.abs(recording["u"]).max() < 0.6e-3
        assert 1.9e7 < recording["p_s"].min() < recording["p_s"].max() < 2.1e7


def test_training_comes_near_the_stroke_limit_at_7_8_s_and_works_on_the_positive_side(scenarios):
    x = scenarios["training"]["x_true"]
    assert x.max() > 0.049
    assert 7.7 < x.argmax() * 1e-3 < 7.9
    assert x.min() > -1e-4


def test_v2_swings_the_pressures_over_70_to_130_bar(scenarios):
    recording = scenarios["v2"]
    for name in ("p_a", "p_b"):
        assert 69e5 < recording[name].min() < 76e5
        assert 124e5 < recording[name].max() < 131e5
    np.testing.assert_array_equal(recording["f_ext"], chirp(5000, 3000.0, 0.1, 5.0, 1e-3))


def test_sensors_quantize_position_and_voltage(scenarios):
    for recording in scenarios.values():
        steps = recording["x"] / RESOLUTION
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
        assert np.abs(recording["x"] - recording["x_true"]).max() <= RESOLUTION / 2 * (1 + 1e-9)
        codes = recording["v_c"] * 2048 / 1.5
        np.testing.assert_array_equal(codes, np.round(codes))
    assert converted(np.array([-2.0, 0.0, 2.0])).tolist() == [-1.5, 0.0, 1.5 * 2047 / 2048]


def test_an_unknown_scenario_is_refused():
    with pytest.raises(InputError, match="'v3' is unknown; give one of training, v1, v2"):
        scenario("v3")


def test_a_scenario_reads_back_from_csv_bit_for_bit(tmp_path, scenarios):
    scenarios["v1"].write_csv(tmp_path / "v1.csv")
    again = read_csv(tmp_path / "v1.csv", required={"v_c": "V", "x": "m", "p_a": "Pa", "p_b": "Pa"})
    for name, values in scenarios["v1"].channels.items():
        np.testing.assert_array_equal(again[name], values)
    assert again.units == scenarios["v1"].units


def test_the_example_of_the_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(python|toml title=\"([\w.]+)\")\n(.*?)```", DOCS.read_text(), flags=re.DOTALL)
    assert blocks
    space = {}
    for _, name, block in blocks:
        if name:
            Path(name).write_text(block)
        else:
            exec(block, space)
    assert isinstance(space["plant"], Plant)
    assert read_csv("run.csv").units == {"q_in": "m^3/s", "h": "m", "q_out": "m^3/s"}
    assert space["residual"].mean() == pytest.approx(2e-5 * space["recording"]["h"].mean(), rel=0.02)
