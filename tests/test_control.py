"""Control: exact derivatives, limits that hold, an observer that finds the load, and a loop closed through hardware."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from greygate.compiler.pipeline import compile_network
from greygate.compiler.quantize import Formats
from greygate.control.choices import JUDGED, Case, Method, Place
from greygate.control.imitation import AHEAD, LAST, Imitated, Watched, dagger, differences, imitator
from greygate.control.loop import run
from greygate.control.observer import Observer
from greygate.control.pi import Proportional, tuned
from greygate.control.prediction import Prediction, hats, knots, online
from greygate.control.predictive import Aim, Limits, Predictive
from greygate.control.stepping import Emulated, Floating
from greygate.errors import InputError
from greygate.hardware.in_loop import clocked
from greygate.hardware.verify import Case as Built
from greygate.machines.belt_drive import axis as belt
from greygate.machines.catalog import task
from greygate.machines.valve_cylinder import axis as cylinder
from greygate.models.families.regression import noe
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record
from greygate.plants.simulator import Stepper, simulate

U, Y = Port("u", "V", 2.0), Port("y", "m", 0.5)
LIMITS = Limits(-1.0, 1.0, rate=0.2)


def lag() -> Network:
    """y(k) = 0.9 y(k-1) + 0.1 u(k-1), in m and V."""
    network = Network("lag_of_one", [U], [Y])
    weights = {"y": [[0.9]], "u": [[0.1 * U.scale / Y.scale]]}
    network.add("memory", Layer(weights, [0.0]))
    network.connect("memory", "memory.y", delay=1)
    network.connect("u", "memory.u", delay=1)
    network.connect("memory", "y")
    return network


class Lag:
    """The same as a machine under way, with a load that pulls."""

    def __init__(self, load: float = 0.0):
        self.y, self.load = 0.0, load

    def measured(self):
        return {"y": self.y}

    def truth(self):
        return {"truth": self.y}

    def actuate(self, value):
        self.y = 0.9 * self.y + 0.1 * value + self.load
        return value


class Known:
    """Predictive control of `Lag`, whose state is measured."""

    def __init__(self, limits=LIMITS, steps=20):
        self.predictive = Predictive(Prediction(lag(), "u", hats(knots(steps, 6))), Aim("y", 1e-3, 1e-4), limits)
        self.ahead = steps

    def reset(self):
        self.predictive.reset()

    def __call__(self, measured, before, reference):
        self.predictive.applied(before)
        return self.predictive({"memory": np.array([[Y.normalised(measured["y"])]])}, reference[1:])


# -- prediction --------------------------------------------------------------------------------------------------------


def models():
    black_box = noe("box", {U: (1, 2, 3)}, Y, (1, 2), hidden=(4,), seed=3)
    return {
        "lag": (lag(), "u"),
        "black box": (black_box, "u"),
        "cylinder": (cylinder.axis_model(cylinder.stored()), "v_c"),
        "belt": (belt.axis_model(belt.stored()), "v"),
    }


@pytest.mark.parametrize("name", ["lag", "black box", "cylinder", "belt"])
def test_derivatives_by_the_plan_are_those_of_finite_differences(name):
    model, drive = models()[name]
    prediction = Prediction(model, drive, hats(knots(15, 5)))
    rng = np.random.default_rng(1)
    plan, size = rng.uniform(0.05, 0.2, 5), 1e-6
    prediction.run(plan)
    found = prediction.derivatives()
    for knot in range(5):
        up, down = (prediction.run(plan + sign * size * np.eye(5)[knot]) for sign in (1, -1))
        np.testing.assert_allclose(found[:, :, knot], (up - down) / (2 * size), atol=1e-6 * np.abs(found).max() + 1e-9)
    assert np.abs(found).max() > 0


def test_a_prediction_is_the_run_of_the_network_from_its_state():
    model, drive = models()["cylinder"]
    u = 0.3 * np.sin(np.arange(60) / 5)
    whole = model.run({drive: u})
    prediction = Prediction(model, drive, np.eye(20))
    beside = Floating(online(model, drive))
    for value in [0.0, *u[:29]]:
        beside.step({drive: value})
    state = beside.state() | {drive: u[29 - 1 :: -1][:, None] / model.inputs[0].scale}
    prediction.start(state)
    told = prediction.run(u[29:49] / model.inputs[0].scale)
    for column, port in enumerate(model.outputs):
        np.testing.assert_allclose(told[:, column], port.normalised(whole[port.name][30:50]), atol=1e-9)


def test_a_prediction_that_diverges_is_told_up_to_there():
    network = lag()
    network.modules["memory"].weights["y"] = np.array([[1e100]])
    prediction = Prediction(network, "u", hats(knots(20, 6)))
    found = prediction.run(np.ones(6))
    ends = int(np.isnan(found[:, 0]).argmax())
    assert 0 < ends < 20
    assert np.isfinite(found[:ends]).all()
    assert np.isnan(found[ends:]).all()


def test_a_state_that_lacks_a_layer_is_refused():
    prediction = Prediction(*models()["belt"], hats(knots(5, 3)))
    with pytest.raises(InputError, match=r"the state lacks machine\.direction"):
        prediction.start({"place": np.zeros((1, 1))})


def test_a_model_that_answers_at_once_or_reads_more_than_the_drive_is_refused():
    direct = lag()
    direct.connect("u", "memory.u")
    with pytest.raises(InputError, match="before step k alone"):
        Prediction(direct, "u", hats(knots(5, 3)))
    with pytest.raises(InputError, match="plans one, v, and has no other"):
        Prediction(lag(), "v", hats(knots(5, 3)))
    with pytest.raises(InputError, match="no input w"):
        online(lag(), "w")
    with pytest.raises(InputError, match="give 2 to 4 knots"):
        knots(4, 5)


@pytest.mark.parametrize(("steps", "count"), [(2, 2), (10, 10), (30, 8), (100, 5)])
def test_knots_begin_now_and_end_with_the_horizon(steps, count):
    at = knots(steps, count)
    assert (at[0], at[-1]) == (0, steps - 1)
    assert (np.diff(at) > 0).all()
    np.testing.assert_allclose(hats(at).sum(axis=1), 1.0)


# -- predictive control ------------------------------------------------------------------------------------------------


def test_predictive_control_tracks_within_the_limits_of_input_and_rate():
    reference = np.where(np.arange(200) < 60, 0.0, np.where(np.arange(200) < 130, 0.6, -0.6))
    done = run(Lag(), Known(), reference, "truth", LIMITS, 1e-3)
    assert not any(done.violations.values())
    assert np.abs(np.diff(done.input)).max() == pytest.approx(0.2)  # the jump takes all that there is
    assert np.abs(done.input).max() == pytest.approx(1.0)
    assert np.abs(done.error[100:108]).max() < 1e-3
    assert np.abs(done.error[-5:]).max() < 1e-3


def test_the_next_program_begins_with_what_is_left_of_the_plan():
    predictive = Predictive(Prediction(lag(), "u", np.eye(12)), Aim("y", 1e-3, 1e-4), LIMITS)
    planned = []
    solve = predictive._solve
    predictive._solve = lambda *given: (solve(*given), planned.append(predictive.plan))
    reference = 0.3 * np.sin(np.arange(12) / 3)
    for _ in range(2):
        predictive({"memory": np.zeros((1, 1))}, reference)
        np.testing.assert_allclose(predictive.plan, [*planned[-1][1:], planned[-1][-1]], atol=1e-12)
    assert np.ptp(planned[0]) > 0.1


def test_limits_of_an_output_hold_where_they_can_and_yield_where_they_cannot():
    reference = np.full(150, 0.5)
    bounded = replace(LIMITS, outputs={"y": (-0.3, 0.3)})
    free = run(Lag(), Known(), reference, "truth", LIMITS, 1e-3)
    held = run(Lag(), Known(bounded), reference, "truth", LIMITS, 1e-3)
    assert free.signals["truth"][-1] == pytest.approx(0.5, abs=1e-3)
    assert held.signals["truth"].max() == pytest.approx(0.3, abs=5e-3)
    rig, controller = Lag(), Known(bounded)
    rig.y = 2.0  # outside, and no input leads back at once
    done = run(rig, controller, reference, "truth", LIMITS, 1e-3)
    assert controller.predictive.solved
    assert not done.violations["rate"]
    assert done.signals["truth"][-1] == pytest.approx(0.3, abs=1e-3)


def test_osqp_names_itself_where_it_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(InputError, match=r"osqp is not installed; pip install 'greygate\[control\]'"):
        Known()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: Limits(1.0, -1.0), "limits of input: 1.0 to -1.0"),
        (lambda: Limits(-1.0, 1.0, rate=0.0), "rate 0.0"),
        (lambda: Limits(-1.0, 1.0, outputs={"y": (1.0, 1.0)}), "limits of y"),
        (lambda: Known(Limits(-1.0, 1.0, outputs={"z": (0.0, 1.0)})), "z is no output of network lag_of_one"),
        (lambda: run(Lag(), Known(), np.array([0.0, np.nan]), "truth", LIMITS, 1e-3), "finite numbers"),
        (lambda: run(Lag(), Known(), np.zeros(0), "truth", LIMITS, 1e-3), "finite numbers"),
        (lambda: imitator("i", [Port(LAST)], U, LIMITS, [{("z", 0): 1.0}], 2, 0), "a feature reads z"),
        (lambda: Observer(lag(), "u", {"z": 1.0}, {}), "z is no output that the model remembers"),
        (lambda: Observer(lag(), "u", {"y": 1.0}, {"z": 1.0}), "z is no layer that it remembers"),
        (lambda: task("crane"), "there are valve_cylinder, belt_drive"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(wrong, said):
    with pytest.raises(InputError, match=said):
        wrong()


# -- observer, PI ------------------------------------------------------------------------------------------------------


def test_the_gain_of_the_observer_is_the_stationary_one_of_the_deviations_that_it_was_told():
    process, noise = 0.02, 0.05
    variance = 1.0
    for _ in range(1000):  # prediction and correction of one state by hand
        gain = variance / (variance + noise**2)
        variance = 0.9**2 * (1 - gain) * variance + process**2
    observer = Observer(lag(), "u", {"y": noise * Y.scale}, {"memory": process})
    assert observer._gain.item() == pytest.approx(gain, rel=1e-9)


def test_the_observer_corrects_the_older_samples_that_its_model_remembers_too():
    process, noise = 0.02, 0.05
    carried, seen = np.array([[1.2, -0.3], [1.0, 0.0]]), np.array([[1.0, 0.0]])
    spread = np.eye(2)
    for _ in range(1000):  # prediction and correction of both samples by hand
        gain = spread @ seen.T / (seen @ spread @ seen.T + noise**2)
        spread = carried @ (spread - gain @ seen @ spread) @ carried.T + np.diag([process**2, 0.0])
    network = lag()
    network.modules["memory"].weights["y"] = np.array([[1.2]])
    network.modules["memory"].weights["older"] = np.array([[-0.3]])
    network.connect("memory", "memory.older", delay=2)
    observer = Observer(network, "u", {"y": noise * Y.scale}, {"memory": process})
    assert observer._gain == pytest.approx(gain, rel=1e-6)


def test_the_observer_finds_a_load_from_position_and_soft_sensor():
    force = 1500.0
    chosen = task("valve_cylinder")
    controller, rig = chosen.predictive(), chosen.rig(Case.NOMINAL, JUDGED, 300)
    rig._force[100:] = force
    done = run(rig, controller, np.zeros(300), "position", chosen.limits, chosen.period)
    found = controller.observer.value("load") * cylinder.LOAD
    assert found == pytest.approx(force, abs=200.0)  # dry friction, 130 N, and half a bar in each chamber
    assert np.abs(done.error[-20:]).max() < cylinder.RESOLUTION


def test_a_pi_controller_is_tuned_to_a_lower_error_and_stays_within_its_limits():
    reference = 0.3 * np.sin(np.arange(300) / 30)
    first = Proportional("y", LIMITS, 1e-3, gain=1.0, reset_rate=1.0, forward=1e-3)

    def track(controller):
        return run(Lag(), controller, reference, "truth", LIMITS, 1e-3).figures()["rms"]

    best = tuned(first, track, lead=False, evaluations=60)
    assert track(best) < 0.2 * track(first)
    done = run(Lag(load=-0.2), best, reference, "truth", LIMITS, 1e-3)  # more than the input can carry
    assert not any(done.violations.values())
    assert abs(best._integral) < 2.0  # it stands while the input is limited


def test_a_plant_under_way_is_the_plant_simulated():
    plant = cylinder.valve_cylinder()
    inputs = {"v_c": 0.5 * np.sin(np.arange(50) / 5), "f_ext": np.linspace(0, 500, 50)}
    whole = simulate(plant, inputs, sample_time=1e-3)
    stepper = Stepper(plant, 1e-3)
    for k in range(50):
        assert stepper["x"] == whole["x"][k]
        assert stepper["p_a"] == whole["p_a"][k]
        stepper.step({n: v[k] for n, v in inputs.items()})


# -- imitation ---------------------------------------------------------------------------------------------------------

SEEN = ({(AHEAD, 6): 1.0, ("y", 0): -1.0}, *differences(AHEAD, (6, 4, 2, 0)), {(LAST, 0): 1.0}, {("y", 0): 1.0})


def student() -> Network:
    return imitator("imitator", [replace(Y, name=AHEAD), Y, replace(U, name=LAST)], U, LIMITS, SEEN, 3, 0)


def reads(network: Network) -> Imitated:
    return Imitated(Floating(network), None, 6, "", "u")


@pytest.fixture(scope="module")
def learnt() -> Network:
    reference, untrained = 0.3 * np.sin(np.arange(300) / 20), student()

    def visit(network):
        watched = Watched(reads(network) if network else None, Known(), reads(untrained), LIMITS)
        run(Lag(), watched, reference, "truth", LIMITS, 1e-3)
        return [watched.record(untrained, 6)]

    return dagger(untrained, visit, rounds=1, epochs=30, decay=1e-6)


def test_a_network_that_runs_away_is_brought_back_by_the_controller_that_it_imitates():
    class Away:
        ahead = 0

        def reset(self):
            pass

        def __call__(self, measured, before, reference):
            return LIMITS.high

    still = np.zeros(200)
    alone = run(Lag(), Away(), still, "truth", LIMITS, 1e-3)
    watched = Watched(Away(), Known(), reads(student()), LIMITS)
    led = run(Lag(), watched, still, "truth", LIMITS, 1e-3)
    early = slice(0, Known().ahead)
    np.testing.assert_array_equal(led.input[early], alone.input[early])  # it is left alone at first
    assert led.input[early.stop + 2] < alone.input[early.stop + 2]
    assert np.abs(led.error[-50:]).max() < 0.05 < 0.99 < np.abs(alone.error[-50:]).min()
    assert len(watched.rows) == 200  # and what it saw is kept all the while


def test_an_imitating_network_tracks_like_the_controller_that_it_imitates(learnt):
    reference = 0.25 * np.sin(np.arange(300) / 15 + 0.5)
    rms = [run(Lag(), c, reference, "truth", LIMITS, 1e-3).figures(50)["rms"] for c in (Known(), reads(learnt))]
    assert rms[1] < 2 * rms[0] + 1e-3


def test_an_imitating_network_cannot_break_the_limits_whatever_it_learnt():
    wild = student()
    wild = wild.with_parameters({"wanted.seen": np.full((1, len(SEEN)), 50.0)})
    noise = np.random.default_rng(0).uniform(-1, 1, 200)
    done = run(Lag(), reads(wild), noise, "truth", LIMITS, 1e-3)
    assert not any(done.violations.values())
    assert np.abs(np.diff(done.input)).max() == pytest.approx(0.2)


@pytest.mark.parametrize("name", ["belt_drive", "valve_cylinder"])
def test_a_kept_network_tracks_closer_than_the_tuned_pi_where_neither_learnt(name):
    chosen = task(name)
    samples = chosen.settle + 700
    network, pi = chosen.floating(chosen.network()), chosen.proportional()
    rms = [chosen.run(c, Case.LOAD, JUDGED + 5, samples).figures(chosen.settle)["rms"] for c in (network, pi)]
    assert rms[0] < 0.8 * rms[1]


# -- hardware in the loop ----------------------------------------------------------------------------------------------


def test_a_loop_closed_by_verilog_is_that_of_the_emulator_in_every_bit(learnt, tmp_path):
    reference = 0.25 * np.sin(np.arange(120) / 15)
    noted = {n: [] for n in (AHEAD, "y", LAST)}

    class Noting:
        ahead = 6

        def reset(self):
            self.inner = reads(learnt)

        def __call__(self, *seen):
            for n, v in self.inner.inputs(*seen).items():
                noted[n].append(v)
            return self.inner(*seen)

    run(Lag(), Noting(), reference, "truth", LIMITS, 1e-3)
    inputs = {n: np.array(v) for n, v in noted.items()}
    program = compile_network(learnt, {"loop": Record(inputs, learnt.run(inputs))}, Formats(14)).program
    emulated = run(Lag(), Imitated(Emulated(program), None, 6, "", "u"), reference, "truth", LIMITS, 1e-3)
    with clocked([Built(program, {})], tmp_path) as (design,):
        controller = Imitated(design, None, 6, "", "u")
        for _ in range(2):  # a reset in between
            done = run(Lag(), controller, reference, "truth", LIMITS, 1e-3)
            np.testing.assert_array_equal(done.input, emulated.input)
        assert (design.differing, design.first, design.steps) == (0, None, 240)
        assert design.compared == 240 * 8 * _bytes(program)
        assert design.clocks / design.steps < 40
        other = replace(program, states=tuple(replace(s, initial=tuple(v + 1 for v in s.initial))
                                              for s in program.states))  # fmt: skip
        design._emulated = Emulated(other)
        design.reset()
        design.step({AHEAD: 0.1, "y": 0.0, LAST: 0.0})
        assert design.differing > 0  # a difference is counted
        assert design.first == 240


def _bytes(program) -> int:
    outputs = [replace(p.signal, name=p.name) for p in program.outputs]
    return sum(-(-s.fix.width // 8) * s.size for s in [*outputs, *(s.signal for s in program.states)])


# -- the command -------------------------------------------------------------------------------------------------------


def test_the_command_tracks_and_keeps_the_signals(tmp_path, greygate):
    csv = tmp_path / "run.csv"
    words = ["belt_drive", "--controller", "network", "--samples", "300", "--out", csv, "--json"]
    code, out, error = greygate("control", *words)
    assert code == 0, error
    found = json.loads(out)
    assert found["limits"] == {"input": 0, "rate": 0}
    assert 0 < found["rms"] < found["worst"]
    assert csv.read_text().startswith("t_s,")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("crane",), "no machine 'crane' has position control; there are valve_cylinder, belt_drive"),
        (("belt_drive", "--controller", "pi", "--place", "rtl"), "only the imitating network is compiled"),
    ],
)
def test_the_command_says_what_is_wrong(arguments, said, greygate):
    code, _, error = greygate("control", *arguments)
    assert code == 2
    assert said in error


def test_methods_and_places_are_those_of_the_command():
    assert [*Method] == ["pi", "mpc", "network"]
    assert [*Place] == ["float", "emulator", "rtl"]
