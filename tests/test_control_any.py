"""Control of a machine of one's own: causal networks, several inputs, loads found, and the command on files."""

import json
from dataclasses import replace

import numpy as np
import pytest

from greygate.control import learning, tuning
from greygate.control.choices import Case, Method, Place
from greygate.control.modelled import Disturbed, OfNetwork, OfPlant, Rolled, derivatives
from greygate.control.observer import Kalman
from greygate.control.own import varied
from greygate.control.prediction import Prediction, hats, knots, online
from greygate.control.predictive import Aim, Predictive
from greygate.errors import InputError
from greygate.hardware import controlled
from greygate.hardware.controlled import table
from greygate.machines.asked import Wishes, asked
from greygate.models.network import Layer, Network, Port
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording

CART = """
step = 1e-3
outputs = ["x"]
inputs = { u = "V", f = "N" }
[parameters]
mass = [2.0, "kg", 0.05]
k_f = [5.0, "N/V", 0.1]
b = [20.0, "N s/m", 0.3]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations]
place.x = { speed = "v" }
cart.v = { storage = "mass", motor = "k_f * u", load = "f", guide = "-b * v" }
"""
MIXED = """
step = 1e-3
outputs = ["a", "b"]
inputs = { p = "V", q = "V" }
parameters = { T = [0.05, "s", 0.1] }
states = { a = { unit = "m" }, b = { unit = "m" } }
[equations]
one.a = { storage = "T", own = "-a", by = "p", other = "0.3 * q" }
two.b = { storage = "T", own = "-b", by = "-q", other = "0.2 * p" }
"""


def built() -> Network:
    """A network as build-snn writes it: the speed answers the present input, the place shows it a step later."""
    network = Network("cart", [Port("u", "V", 10.0, initial=3.0)], [Port("x", "m", 0.4)], dt=0.005)
    network.add("v", Layer({"u": [[0.02]], "past": [[0.03]], "own": [[0.95]]}, [0.0]), {"u": "u", "past": ("u", 1)})
    network.add("x_", Layer({"v": [[0.01]], "own": [[1.0]]}, [0.0]), {"v": ("v", 1), "own": ("x_", 1)})
    network.connect("v", "v.own", delay=1)
    network.connect("x_", "x")
    return network.check()


def files(folder, text=CART, names=("x",), units=("m",), size=0.05, samples=300):
    """A plant's file, and a reference that moves and rests."""
    (folder / "plant.toml").write_text(text)
    t = np.arange(samples) * 0.005
    waves = [size * (1 - np.cos(2 * np.pi * (1 + i) * t)) for i in range(len(names))]
    Recording(0.005, dict(zip(names, waves, strict=True)), dict(zip(names, units, strict=True))).write_csv(
        folder / "track.csv"
    )
    return folder / "plant.toml", folder / "track.csv"


@pytest.fixture
def quick(monkeypatch):
    for module in (tuning, learning, controlled):
        monkeypatch.setattr(module, "SAMPLES", 120)
    monkeypatch.setattr(tuning, "EVALUATIONS", 25)
    monkeypatch.setattr(tuning, "HORIZONS", (15, 15, 15))
    monkeypatch.setattr(learning, "ROUNDS", 1)
    monkeypatch.setattr(learning, "HELD_OUT", 1)


# -- causal networks ---------------------------------------------------------------------------------------------------


def test_a_layer_that_answers_the_present_input_is_evaluated_a_step_later():
    network, drive = built(), np.random.default_rng(0).uniform(-5, 5, 60)
    drive[:3] = 0.0
    beside = online(network, "u")
    late = beside.run({"u": np.append(0.0, drive[:-1])}, initial={"u": 0.0})
    np.testing.assert_allclose(late["x"], network.run({"u": drive}, initial={"u": 0.0})["x"], atol=1e-15)
    prediction = Prediction(network, "u", hats(knots(12, 4)))
    prediction.start({n: np.zeros((2, 1)) for n in ("v", "x_", "u")})
    plan = np.array([0.1, -0.2, 0.3, 0.0])
    told = prediction.run(plan)[:, 0] * 0.4
    planned = np.append(10.0 * hats(knots(12, 4)) @ plan, 0.0)
    np.testing.assert_allclose(told, network.run({"u": planned}, initial={"u": 0.0})["x"][1:], atol=1e-15)


def test_an_output_that_answers_the_present_input_is_refused_through_any_layer():
    network = built()
    network.outputs.append(Port("speed", "m/s"))
    network.connect("v", "speed")
    with pytest.raises(InputError, match="before step k alone; speed reads what acts only afterwards"):
        online(network, "u")


def test_a_weight_of_zero_makes_no_output_answer_at_once():
    network = built()
    network.outputs.append(Port("speed", "m/s"))
    network.connect("v", "speed")
    network.modules["v"].weights["u"][:] = 0.0
    assert online(network, "u").run({"u": np.ones(5)}, initial={"u": 1.0})["speed"][0] == pytest.approx(0.03 * 0.1)


# -- models, observer --------------------------------------------------------------------------------------------------


def cart(tmp_path) -> OfPlant:
    (tmp_path / "plant.toml").write_text(CART)
    return OfPlant(Plant.read(tmp_path / "plant.toml"), ["u"], ["x"], 0.005)


def test_plant_and_network_are_stepped_as_they_run(tmp_path):
    network = OfNetwork(built(), ["u"], ["x"], 0.005)
    inputs = np.random.default_rng(1).uniform(-5, 5, (2, 20, 1))
    for model in (cart(tmp_path), network):
        states = np.tile(model.start, (2, 1))
        _, whole = model.roll(states, inputs)
        half, first = model.roll(states, inputs[:, :8])
        _, second = model.roll(half, inputs[:, 8:])
        np.testing.assert_allclose(np.concatenate([first, second], axis=1), whole, rtol=1e-12, atol=1e-15)
        assert np.ptp(whole) > 0


def test_the_observer_finds_a_load_that_nobody_measures(tmp_path):
    model = cart(tmp_path)
    seen = Disturbed(model, [0], [])
    observer = Kalman(seen, {0: 1e-6}, np.array([1e-8, 1e-6, 0.1]), np.array([0.1, 0.5, 5.0]))
    state = model.start
    for _ in range(200):
        state = model.roll(state[None], np.array([[[1.0 + 2.0]]]))[0][0]  # 2 V more than is told
        observer.corrected(np.array([1.0]), state[:1])
    np.testing.assert_allclose(observer.state, [*state, 2.0], rtol=1e-3)


def test_derivatives_of_a_step_are_those_of_the_matrix_exponential(tmp_path):
    from scipy.linalg import expm

    model = cart(tmp_path)
    _, _, a, c = derivatives(model, np.array([0.1, 0.2]), np.zeros(1), np.ones(2))
    exact = expm(np.array([[0.0, 1.0], [0.0, -10.0]]) * 0.005)
    np.testing.assert_allclose(a, exact, atol=1e-8)
    np.testing.assert_allclose(c, exact[:1], atol=1e-8)


def test_fewer_steps_of_integration_are_taken_only_where_they_agree(tmp_path):
    machine = asked(*files(tmp_path), Wishes({"u": (-10.0, 10.0)}))
    assert machine.model.restarted.substeps < cart(tmp_path).restarted.substeps
    states, inputs = np.array([[0.02, 0.4]]), np.full((1, 20, 1), 3.0)
    both = [m.roll(states, inputs)[1] for m in (machine.model, machine.truth(None))]
    np.testing.assert_allclose(*both, rtol=1e-3)


# -- closed loops ------------------------------------------------------------------------------------------------------


def test_two_outputs_track_by_two_inputs_under_a_load_and_within_limits(tmp_path, quick):
    where, track = files(tmp_path, MIXED, ("a", "b"), ("m", "m"), 0.3)
    wishes = Wishes({"p": (-1.0, 1.5), "q": (-1.5, 1.0), "a": (-1.0, 0.5)}, {"p": 40.0, "q": 40.0})
    machine = asked(where, track, wishes)
    rows = table(machine, Method.MPC, Place.FLOAT).found["rows"]
    pi, mpc = (rows[name]["load"] for name in ("PI", "predictive"))
    assert mpc["errors"]["b"]["rms"] < 0.3 * pi["errors"]["b"]["rms"]
    assert mpc["limits"]["input"] == mpc["limits"]["rate"] == 0
    reached = machine.reference[:, 0].max() - mpc["errors"]["a"]["worst"]
    assert reached == pytest.approx(0.5, abs=0.02)  # a is held at its limit, below its reference


def test_a_network_drives_as_the_predictive_controller_and_fixed_point_as_the_network(tmp_path, quick):
    machine = asked(*files(tmp_path), Wishes({"u": (-10.0, 10.0)}, {"u": 400.0}, {"x": 1e-5}))
    done = table(machine, Method.NETWORK, Place.EMULATOR)
    errors = [done.found["rows"][name]["nominal"]["errors"]["x"]["rms"] for name in done.found["rows"]]
    assert [*done.found["rows"]] == ["PI", "predictive", "network, float", "network, fixed"]
    assert errors[1] < 0.5 * errors[0]
    assert max(errors[2:]) < errors[0]
    assert done.found["network"]["matches"] == (max(done.found["network"]["apart"].values()) <= learning.FACTOR)
    assert all(not run["limits"]["rate"] for run in done.found["rows"]["network, fixed"].values())


def test_what_is_not_finite_is_not_solved_and_says_nothing_on_stdout(tmp_path, capfd):
    machine = asked(*files(tmp_path), Wishes({"u": (-10.0, 10.0)}))
    prediction = Rolled(machine.model, machine.drives, machine.signals, hats(knots(10, 3)))
    controller = Predictive(prediction, Aim("x", 1e-3, 1e-2), machine.limits)
    assert np.isfinite(controller(np.zeros(2), np.zeros(10)))
    assert controller.solved
    controller(np.full(2, np.inf), np.zeros(10))
    assert not controller.solved
    assert capfd.readouterr().out == ""


def test_another_reference_is_no_faster_than_the_one_given():
    reference = np.cumsum(np.sin(np.arange(400) / 40))[:, None]
    speed = np.abs(np.diff(reference, axis=0)).max()
    for seed in range(20):
        other = varied(reference, 300, seed)
        assert other[0] == reference[0]
        assert np.abs(np.diff(other, axis=0)).max() < 2.5 * speed
    assert not np.array_equal(varied(reference, 300, 0), varied(reference, 300, 1))


def test_a_day_draws_parameters_within_their_tolerances(tmp_path):
    machine = asked(*files(tmp_path), Wishes({"u": (-10.0, 10.0)}))
    drawn = [machine.truth(seed).values for seed in range(30)]
    told = machine.truth(None).values
    assert told == {"mass": 2.0, "k_f": 5.0, "b": 20.0}
    assert all(abs(d["mass"] / 2.0 - 1) < 0.0501 and abs(d["b"] / 20.0 - 1) < 0.301 for d in drawn)
    assert np.std([d["b"] for d in drawn]) > 1.0


def test_a_column_of_another_input_disturbs_the_machine_and_no_controller_sees_it(tmp_path):
    where, track = files(tmp_path, names=("x", "f"), units=("m", "N"))
    machine = asked(where, track, Wishes({"u": (-10.0, 10.0)}))
    assert machine.tracked == ["x"]

    class Idle:
        ahead = 0

        def reset(self):
            pass

        def __call__(self, measured, before, reference):
            return before

    moved = [
        np.ptp(replace(machine, acting=a).run(Idle(), Case.NOMINAL, None).signals["x"]) for a in ({}, machine.acting)
    ]
    assert moved[0] == 0 < moved[1]


# -- the command -------------------------------------------------------------------------------------------------------


def test_the_command_prints_the_table_and_keeps_the_signals(tmp_path, greygate, quick):
    where, track = files(tmp_path)
    out = tmp_path / "out"
    words = ["--track", track, "--limits", "u=-10:10", "--controller", "pi", "--out", out, "--json"]
    code, printed, error = greygate("control", where, *words)
    assert code == 0, error
    found = json.loads(printed)
    assert found["units"] == {"x": "m"}
    assert {*found["rows"]["PI"]} == {"nominal", "load", "supply"}
    assert (out / "load.csv").read_text().startswith("t_s,x_m,u_V,reference_x_m")


LIMITED = ("--limits", "u=-10:10")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "no input has limits; give --limits NAME=LOW:HIGH"),
        (("--limits", "u=1:-1"), "--limits u=1:-1: is empty"),
        (("--limits", "u=0:nan"), "write NAME=LOW:HIGH"),
        (("--limits", "u=0:"), "--limits u: an input needs both limits"),
        ((*LIMITED, "--limits", "z=0:1"), "--limits z: "),
        ((*LIMITED, "--rate", "x=1"), "--rate x: is no input with limits"),
        ((*LIMITED, "--rate", "u=0"), "write NAME=VALUE, a number above 0"),
        ((*LIMITED, "--noise", "w=1"), "--noise w: "),
        ((*LIMITED, "--seed", "3"), "are for a machine of the catalogue"),
        ((*LIMITED, "--place", "rtl"), "only the imitating network is compiled"),
    ],
)  # fmt: skip
def test_the_command_refuses_wishes_that_do_not_fit(words, said, tmp_path, greygate):
    where, track = files(tmp_path)
    code, printed, error = greygate("control", where, "--track", track, *words, "--out", tmp_path / "out")
    assert (code, printed, (tmp_path / "out").exists()) == (2, "", False)
    assert said in error


@pytest.mark.parametrize(
    ("header", "rows", "said"),
    [
        ("t_s,z_m", "0,0\n0.005,0.1\n0.01,0\n", "column z is no signal of"),
        ("t_s,u_V", "0,0\n0.005,0.1\n0.01,0\n", "column u is controlled, and cannot be given"),
        ("t_s,v_m_s", "0,0\n0.005,0.1\n0.01,0\n", "no column is an output of"),
        ("t_s,x_V", "0,0\n0.005,0.1\n0.01,0\n", "x"),
        ("t_s,x_m", "0,0\n0.005,nan\n0.01,0\n", "nan"),
        ("t_s,x_m", "0,0.1\n0.005,0.1\n0.01,0.1\n", "x does not move"),
    ],
)  # fmt: skip
def test_the_command_refuses_a_reference_that_does_not_fit(header, rows, said, tmp_path, greygate):
    where, track = files(tmp_path)
    track.write_text(f"{header}\n{rows}")
    code, printed, error = greygate("control", where, "--track", track, *LIMITED)
    assert (code, printed) == (2, "")
    assert said in error


def test_a_network_that_does_not_fit_the_machine_is_refused(tmp_path):
    where, track = files(tmp_path)
    (tmp_path / "net").mkdir()
    wrong = {
        "x is in V, in the machine in m": {"outputs": [Port("x", "V", 0.4)]},
        "sample time 5 ms, the network cart was made for 1 ms": {"dt": 0.001},
    }
    for said, change in wrong.items():
        replace(built(), **change).save(tmp_path / "net" / "cart")
        with pytest.raises(InputError, match=said):
            asked(where, track, Wishes({"u": (-10.0, 10.0)}, network=tmp_path / "net" / "cart.toml"))
