"""A Python function as a plant: it moves as the function says, effects act on it, and one call explains a recording."""

import math
import re
import tomllib

import numpy as np
import pytest

import greygate
from greygate.errors import InputError
from greygate.mismatch.general import general
from greygate.mismatch.given import rig_of
from greygate.mismatch.model import Model
from greygate.mismatch.places import unit_of_place
from greygate.mismatch.simulation import simulate as corrected
from greygate.pages.diagnosis import page
from greygate.plants.plant import Parameter, Plant
from greygate.plants.python import Simulator
from greygate.plants.simulator import Restarted, simulate

DT, STEP, SAMPLES, NOISE = 0.01, 1e-3, 800, 1e-5
CART = {
    "dt": STEP,
    "states": {"x": {"unit": "m", "rate": "v"}, "v": "m/s"},
    "inputs": {"force": "N"},
    "parameters": {"mass": [2.0, "kg"], "viscous": (4.0, "N s/m", 0.1)},
    "outputs": ["x"],
    "storage": {"v": "mass"},
    "name": "cart",
}
TEXT = """
outputs = ["x"]
inputs = { force = "N" }
parameters = { mass = [2.0, "kg"], viscous = [4.0, "N s/m"] }
states = { x = { unit = "m", rate = "v" }, v = { unit = "m/s" } }
[equations]
way_x = { x = { speed = "v" } }
motion_v = { v = { storage = "mass", drive = "force", friction = "-viscous * v" } }
"""


def rates(t, x, u, p):
    return x[1], (u[0] - p.viscous * x[1]) / p.mass


def unpacking(t, x, u, p):
    _, v = x
    (force,) = u
    return np.array([v, (force - p.viscous * v) / p.mass])


class Column:
    """Numbers as CasADi gives them: numpy can take them, in one column."""

    def __init__(self, *numbers):
        self.numbers = numbers

    def __array__(self, dtype=None, copy=None):
        return np.array(self.numbers, dtype).reshape(-1, 1)


def columned(t, x, u, p):
    return Column(*rates(t, x, u, p))


def euler(t, x, u, p, dt=STEP):
    return [x[0] + dt * x[1], x[1] + dt * (u[0] - p.viscous * x[1]) / p.mass]


def slow_euler(t, x, u, p):
    return euler(t, x, u, p, DT)


def cart(function=rates, compiled=False, stepping=None, **others):
    stepping = function in (euler, leapt, slow_euler) if stepping is None else stepping
    told = {**CART, **others, "compiled": compiled}
    return Simulator(step=function, **told) if stepping else Simulator(function, **told)


def force(seed=0):
    return 3.0 * np.repeat(np.random.default_rng(seed).uniform(-1, 1, SAMPLES // 20), 20)


def run(plant, **given):
    return simulate(plant, {"force": force(), **given}, sample_time=DT, step=plant.step)["x"]


@pytest.mark.parametrize(
    ("function", "compiled"),
    [(rates, False), (rates, True), (unpacking, False), (unpacking, True), (columned, False)],
)
def test_a_function_moves_as_the_same_equations_in_a_file_in_every_bit(function, compiled):
    """Also one that unpacks its arrays, which numba cannot."""
    wanted = simulate(Plant.of("cart", tomllib.loads(TEXT)), {"force": force()}, sample_time=DT, step=1e-3)["x"]
    assert np.ptp(wanted) > 0.1
    assert np.array_equal(run(cart(function, compiled)), wanted)


@pytest.mark.parametrize("compiled", [False, True])
def test_a_step_moves_as_the_function_says_in_every_bit(compiled):
    plant, x, wanted = cart(euler, compiled), [0.0, 0.0], []
    p = type("P", (), {symbol: q.value for symbol, q in plant.parameters.items()})
    for f in force():
        wanted.append(x[0])
        for _ in range(10):
            x = euler(0.0, x, [f], p)
    assert np.array_equal(run(plant), wanted)


@pytest.mark.parametrize(("function", "steps"), [(rates, [1, 2, 5]), (euler, [])])
def test_only_a_function_of_rates_is_run_in_longer_steps(function, steps):
    recording = greygate.Recording(DT, {"force": force(), "x": force()}, {"force": "N", "x": "m"})
    model = Model(rig_of(cart(function), recording), recording, {})
    assert model.steps == 10
    assert [longer.steps for longer in model.longer()] == steps


@pytest.mark.parametrize(("function", "within"), [(rates, 1e-12), (euler, 2e-3)])
def test_a_term_acts_in_the_balance_with_the_unit_that_storage_gives(function, within):
    term = "motion_v", "dry", "-k * tanh(v / 0.01)", {"k": Parameter(0.7, "N")}
    wanted = run(Plant.of("cart", tomllib.loads(TEXT)).with_term(*term))
    plain, rough = run(cart(function)), run(cart(function).with_term(*term))
    assert np.abs(plain - wanted).max() > 0.1 * np.ptp(wanted)
    assert np.abs(rough - wanted).max() < within * np.ptp(wanted)


def leapt(t, x, u, p):
    v = x[1] + STEP * (u[0] - p.viscous * x[1]) / p.mass
    return [x[0] + STEP * v, v]


@pytest.mark.parametrize("function", [euler, leapt])
@pytest.mark.parametrize(("term", "more"), [("0.5", lambda v: 0.5), ("-9.0 * v * abs(v)", lambda v: -9.0 * v * abs(v))])
def test_a_force_acts_within_a_step_as_if_it_stood_in_the_function(function, term, more):
    """Else the effect would come half a step late, and be taken for that."""

    def pushed(t, x, u, p):
        return function(t, x, u + more(x[1]), p)

    wanted = run(cart(pushed, stepping=True))
    assert np.allclose(run(cart(function).with_term("motion_v", "more", term)), wanted, rtol=1e-9, atol=1e-12)


def test_a_stiff_friction_does_not_shake_a_step():
    rough = cart(euler).with_term("motion_v", "dry", "-5.0 * tanh(v / 1e-6)")
    found = simulate(rough, {"force": force()}, sample_time=DT, step=1e-3, channels=["v"])["v"]
    assert np.abs(found).max() < 1e-5


def test_effects_act_in_the_unit_of_the_rate_or_of_the_balance_where_storage_says_it():
    assert unit_of_place(cart(storage={}), "motion_v") == {"m": 1, "s": -2}
    assert unit_of_place(cart(), "motion_v") == {"N": 1}
    turning = cart(states={"x": {"unit": "rad", "rate": "v"}, "v": "rad/s"}, parameters={
        "mass": [2.0, "kg m^2"], "viscous": [4.0, "N m s/rad"]})  # fmt: skip
    assert unit_of_place(turning, "motion_v") == {"N": 1, "m": 1}
    heated = Simulator(lambda t, x, u, p: [u[0] - x[0]], dt=0.1, states={"T": "K"}, inputs={"q": "K/s"}, compiled=False)
    assert list(heated.equations) == ["balance_T"]
    assert unit_of_place(heated, "balance_T") == {"K": 1, "s": -1}


# -- time ----------------------------------------------------------------------------------------------------------


def swept(t, x, u, p):
    return [math.cos(t) * u[0]]


def swept_step(t, x, u, p):
    return [x[0] + math.sin(t + 0.01) - math.sin(t)]


@pytest.mark.parametrize("told", [{"rates": swept}, {"step": swept_step}])
@pytest.mark.parametrize("parts", [1, 2])
def test_t_is_the_time_from_the_first_sample_wherever_a_run_restarts(told, parts):
    plant = Simulator(**told, dt=0.01, states={"y": "m"}, inputs={"a": "m/s"}, compiled=False)
    assert plant.inputs == {"a": "m/s", "t": "s"}
    n, dt = 60, 0.1
    clock, rows = np.arange(n) * dt, np.repeat(np.arange(n), parts)
    given = np.stack([np.ones(n), clock], axis=1)[rows]
    restarts = np.array([0, 20, 40])
    made = Restarted(plant, dt / parts, 0.01).run(
        given, restarts * parts, np.sin(clock[restarts])[:, None], np.array([True]), {}
    )
    assert np.abs(made[::parts, 0] - np.sin(clock)).max() < 1e-9


def test_a_time_that_is_not_given_is_that_of_the_samples():
    plant = Simulator(swept, dt=0.01, states={"y": "m"}, inputs={"a": "m/s"}, compiled=False)
    given = {"a": np.ones(50), "t": np.arange(50) * 0.1}
    found = [simulate(plant, u, sample_time=0.1)["y"] for u in ({"a": given["a"]}, given)]
    assert np.array_equal(*found)
    alone = Simulator(lambda t, x, u, p: [math.cos(t)], dt=0.01, states={"y": "m"}, compiled=False)
    assert np.allclose(simulate(alone, {}, sample_time=0.1, samples=50)["y"], np.sin(given["t"]), atol=1e-9)


def test_a_function_that_does_not_use_the_time_needs_no_time():
    assert cart().inputs == cart(euler).inputs == {"force": "N"}


@pytest.mark.parametrize(
    "function",
    [lambda *a: [a[0]], lambda t, x, u, p: [eval("t")], lambda t, x, u, p: [(lambda: t)()], lambda s, x, u, p: [s + 1]],
)
def test_whatever_may_read_the_time_has_it(function):
    assert "t" in Simulator(function, dt=0.1, states={"y": "m"}, compiled=False).inputs


# -- what cannot be compiled, and what is wrong ----------------------------------------------------------------------


class Kept:
    slope = 4.0


def untyped(t, x, u, p):
    return x[1], (u[0] - Kept.slope * x[1]) / p.mass


def test_what_numba_cannot_compile_runs_in_python_and_says_so():
    with pytest.warns(UserWarning, match=r"simulator cart: rates: runs in Python.*numba does not compile it: .*Kept"):
        plant = cart(untyped, compiled=None)
    assert np.array_equal(run(plant), run(cart()))
    with pytest.raises(InputError, match=r"^simulator cart: rates: numba does not compile it: [^\n]*Kept[^\n]*$"):
        cart(untyped, compiled=True)


def test_an_error_of_arithmetic_is_a_state_that_is_not_finite():
    def wall(t, x, u, p):
        return x[1], math.sqrt(0.05 - x[0]) * u[0]

    with pytest.raises(InputError, match="state x is not finite at"):
        run(cart(wall, True))
    with pytest.raises(InputError, match=r"raises ValueError \(math domain error\) where x is 0.05"):
        run(cart(wall, False))


def test_what_a_function_raises_in_a_simulation_is_said_in_one_line():
    def broken(t, x, u, p):
        return x[1], {}[u[0]] if x[0] > 0.05 and u[0] else u[0]

    problem = r"^simulator cart: rates: raises KeyError \(.*\) where x is .*, v is .*, force is -1.94607$"
    with pytest.raises(InputError, match=problem):
        run(cart(broken))
    assert np.isfinite(run(cart(broken), force=np.zeros(SAMPLES))).all()


CALLS = iter(range(10**6))
WRONG = {
    "raises": (lambda t, x, u, p: x.speed, {}, "rates: raises AttributeError .* where it begins, with inputs of 0"),
    "shape": (lambda t, x, u, p: [x[1]], {}, r"gives \(1,\) numbers; give one for each of 2 states"),
    "random": (lambda t, x, u, p: [x[1], next(CALLS)], {}, "gives two results for the same arguments"),
    "nothing": (lambda t, x, u, p: None, {}, "gives nothing; give one for each of 2 states"),
    "coarse": (lambda t, x, u, p: np.array([x[1], u[0]], np.float32), {}, "gives float32; let it compute in float64"),
    "complex": (lambda t, x, u, p: [x[1], np.sqrt(-1 + 0j)], {}, "gives complex128; let it compute in float64"),
    "unknown name": (lambda t, x, u, p: [x[1], p.friction], {}, "raises AttributeError .*has no attribute 'friction'"),
    "undefined": (lambda t, x, u, p: [x[1], length], {}, "raises NameError .*'length' is not defined"),  # noqa: F821
    "arguments": (lambda t, x, u: [x[1], u[0]], {}, "raises TypeError .*3 positional arguments but 4 were given"),
    "list": (rates, {"states": ["x", "v"]}, r"simulator cart: states \['x', 'v'\] is not a table"),
    "unit": (rates, {"inputs": {"force": 1}}, r"inputs.force 1 is not a line of text"),
    "one": (rates, {"outputs": "x"}, r"outputs 'x' is not a list"),
    "way": (lambda t, x, u, p: [2 * x[1], u[0]], {}, "the rate of x is .* where v is .*; leave its `rate` out"),
    "storage": (rates, {"storage": {"x": "mass"}}, r"storage\.x: is no state that effects act on; give v"),
    "unknown": (rates, {"storage": {"v": "weight"}}, "motion_v, storage: unknown name 'weight'"),
    "outputs": (rates, {"outputs": ["z"]}, "outputs: 'z' is no state"),
    "rate": (rates, {"states": {"x": {"unit": "m", "rate": "w"}, "v": "m/s"}}, "rate 'w' is no state"),
    "step": (rates, {"dt": 0.0}, "simulator cart: step"),
    "parameter": (rates, {"parameters": {"mass": 2.0}}, "is not a parameter"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_simulator_is_refused_in_one_line(name):
    function, others, problem = WRONG[name]
    with pytest.raises(InputError, match=problem) as error:
        cart(function, **others)
    assert "\n" not in str(error.value)


def test_rates_or_a_step_but_not_both_nor_neither():
    for given in ({}, {"rates": rates, "step": euler}):
        with pytest.raises(InputError, match="give rates or step"):
            Simulator(**given, **CART)


# -- a diagnosis -----------------------------------------------------------------------------------------------------


def recorded(seed=0, mass=2.0, dry=0.4, plant=None):
    """A cart with dry friction that its simulator has not: t, force, x."""
    real = plant or Plant.of("cart", tomllib.loads(TEXT)).with_parameters(mass=mass)
    real = real.with_term("motion_v", "dry", f"-{dry} * tanh(v / 0.01)")
    x = simulate(real, {"force": force(seed)}, sample_time=DT, step=real.step if plant else STEP)["x"]
    x = x + NOISE * np.random.default_rng(seed).standard_normal(SAMPLES)
    return {"t": np.arange(SAMPLES) * DT, "force": force(seed), "x": x}


def tiring():
    """A step that keeps what no state says: how often it was called."""
    calls = [0]

    def step(t, x, u, p):
        calls[0] += 1
        return slow_euler(t, x, u * (calls[0] < SAMPLES), p)

    return step


def few(rig, keys=("dry_friction", "spring", "constant_load")):
    return {k: e for k, e in general(rig, rig.to_explain()).items() if e.id in keys}


@pytest.mark.parametrize(
    ("function", "compiled", "dt"),
    [(rates, True, STEP), pytest.param(slow_euler, False, DT, marks=pytest.mark.nightly)],
)
def test_dry_friction_that_a_function_has_not_is_found_in_newtons(function, compiled, dt):
    plant = cart(function, compiled, dt=dt)
    recording, holdout = recorded(plant=plant), recorded(1, plant=plant)
    given = {"noise_rms": {"x": NOISE}, "holdout": holdout, "tolerance": {"mass": 0.05}}
    effects = few(rig_of(plant, recording, **given))
    found = greygate.diagnose(plant, recording, effects=effects, **given)
    said = found.as_dict()
    assert said["verdict"] == "missing_physics"
    (effect,) = said["effects"]
    assert effect["id"] == "dry_friction"
    ((_, strength),) = [item for item in effect["parameters"].items() if item[1]["unit"] == "N"]
    assert strength["value"] == pytest.approx(0.4, rel=0.1)
    errors = found.fits["holdout"]["x"]
    assert errors["corrected"] < 0.2 * errors["simulation"]
    held = found.rig.held_out()
    left = corrected(found.rig, held, said, effects)["x"] - held["x"]
    assert np.sqrt(np.mean(left**2)) == pytest.approx(errors["corrected"])
    assert re.search(r"effect +dry_friction: .*\n +f_v +0\.\d+ \[0\.\d+, 0\.\d+\] N\n", str(found))
    assert str(found) == repr(found)
    assert "dry" in page(found)


@pytest.mark.parametrize(
    ("told", "seeds"),
    [
        ({"noise_rms": {"x": NOISE}}, [0, 1]),
        ({}, [0]),
        pytest.param({"noise_rms": {"x": NOISE}}, [0], marks=pytest.mark.nightly),
        pytest.param({}, [0, 1], marks=pytest.mark.nightly),
    ],
)
def test_a_wrong_parameter_of_a_function_is_found(told, seeds):
    """With the noise told and untold, in one recording and in two."""
    recordings = [recorded(seed, mass=2.4, dry=0.0) for seed in seeds]
    given = recordings if len(seeds) > 1 else recordings[0]
    found = greygate.diagnose(cart(compiled=True), given, effects={}, tolerance={"mass": 0.02}, **told).as_dict()
    assert found["verdict"] == "parameter_error"
    assert found["parameters"]["mass"]["value"] == pytest.approx(2.4, rel=0.01)
    assert {*found["fit"]} == {"identify", *(f"recording{seed + 1}" for seed in seeds if len(seeds) > 1)}


def test_a_function_that_keeps_what_no_state_says_is_refused():
    plant = cart(tiring(), stepping=True, dt=DT)
    with pytest.raises(InputError, match=r"^plant cart: gives another run for the same inputs; .* is a state$"):
        greygate.diagnose(plant, recorded())


def test_a_step_is_asked_for_no_other_time_than_its_own():
    plant = cart(slow_euler, dt=DT)
    for wrong in ({"sample_time": 0.02, "step": 0.02}, {"sample_time": 0.015}):
        with pytest.raises(InputError, match="step"):
            simulate(plant, {"force": force()}, **wrong)
    slow = {k: v[::3] if k == "t" else v[: len(v[::3])] for k, v in recorded().items()}
    simulate(plant, {"force": slow["force"]}, sample_time=0.03)
    with pytest.raises(InputError, match=r"step: takes steps of 0.02 s, not of 0.015 s; let a sample take"):
        greygate.diagnose(cart(slow_euler, dt=0.02), slow)
    assert rig_of(plant, slow).dt == pytest.approx(0.03)
    assert Model(rig_of(plant, slow), rig_of(plant, slow).to_explain(), {}).longer_steps == []


def test_a_recording_comes_as_arrays_as_a_recording_or_as_a_file(tmp_path):
    arrays = recorded()
    as_file = tmp_path / "run.csv"
    columns = np.stack([*arrays.values()], axis=1)
    np.savetxt(as_file, columns, fmt="%.17g", delimiter=",", header="t,force,x", comments="")
    units = {"force": "N", "x": "m"}
    held = greygate.Recording(DT, {k: v for k, v in arrays.items() if k != "t"}, units)
    rigs = [rig_of(cart(), given) for given in (arrays, held, as_file, str(as_file))]
    for rig in rigs:
        assert rig.channels == rigs[0].channels
        assert rig.dt == DT
        assert all(np.array_equal(rig.to_explain()[name], arrays[name]) for name in units)
        assert rig.held_out() is None
        assert rig.plant.parameters["viscous"].tolerance == 0.1
    model = Model(rigs[0], rigs[0].to_explain(), {})
    assert {"mass", "viscous"} <= {*model.moving}


WRONG_RECORDINGS = {
    "none": (None, {}, "plant cart: give a recording of it"),
    "channel": ({**recorded(), "speed": np.zeros(SAMPLES)}, {}, "speed"),
    "input": ({k: v for k, v in recorded().items() if k != "force"}, {}, r"channels\.force: is missing"),
    "output": ({k: v for k, v in recorded().items() if k != "x"}, {}, "predict"),
    "nan": ({**recorded(), "x": np.full(SAMPLES, np.nan)}, {}, "column x: sample 0 has the value nan"),
    "short": ({k: v[:30] for k, v in recorded().items()}, {}, "recording: 30 samples, 0.3 s; record at least 40"),
    "unit": (greygate.Recording(DT, {"force": force(), "x": force()}, {"force": "N", "x": "V"}), {}, "x is in V"),
    "tolerance": (recorded(), {"tolerance": {"length": 0.1}}, r"tolerance\.length"),
    "noise": (recorded(), {"noise_rms": {"y": 0.1}}, r"noise_rms\.y: is no channel"),
    "predict": (recorded(), {"predict": ["force"]}, "predict: 'force' is no output channel"),
    "one of two": ([recorded(), {k: v[::2] for k, v in recorded().items()}], {}, "recording2: has other channels"),
    "no recording": ([], {}, "give a recording of it"),
    "holdout": (recorded(), {"holdout": {k: v[::2] for k, v in recorded().items()}}, "another sample time"),
    "window": (recorded(), {"window_s": DT}, "window_s: 0.01; give at least 10 samples"),
}


@pytest.mark.parametrize("name", WRONG_RECORDINGS)
def test_a_recording_that_is_not_of_the_plant_is_refused_in_one_line(name):
    recording, told, problem = WRONG_RECORDINGS[name]
    with pytest.raises(InputError, match=problem) as error:
        greygate.diagnose(cart(), recording, **told)
    assert "\n" not in str(error.value)


def test_a_rig_has_its_recordings_itself():
    rig = rig_of(cart(), recorded())
    with pytest.raises(InputError, match="a rig has its recordings"):
        greygate.diagnose(rig, recorded())


# -- what others made ------------------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_an_environment_of_gymnasium_with_drag_inside_is_explained():
    pytest.importorskip("gymnasium", reason="pip install gymnasium")
    from gymnasium.envs.classic_control.pendulum import PendulumEnv

    env, real = PendulumEnv(), PendulumEnv()
    env.max_torque = real.max_torque = 10.0
    samples, dt = 240, 0.05

    def step(t, x, u, p):
        env.state, env.m = x, p.m
        env.step(u)
        return env.state

    plant = Simulator(
        step=step, dt=dt, states={"th": {"unit": "rad", "rate": "w", "initial": math.pi}, "w": "rad/s"},
        inputs={"torque": "N m"}, parameters={"m": [1.0, "kg", 0.05], "l": [1.0, "m"]}, outputs=["th"],
        storage={"w": "m * l**2 / 3"}, name="pendulum", compiled=False,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    torque = np.repeat(rng.uniform(-1, 1, samples // 8), 8)
    real.state, th = np.array([math.pi, 0.0]), []
    for u in torque:
        th.append(real.state[0])
        real.step([u - 0.1 * real.state[1] * abs(real.state[1])])
    recording = {"t": np.arange(samples) * dt, "torque": torque, "th": th + 2e-3 * rng.standard_normal(samples)}
    given = {"noise_rms": {"th": 2e-3}}
    effects = few(rig_of(plant, recording, **given), ("square_damping", "spring", "dry_friction"))
    found = greygate.diagnose(plant, recording, effects=effects, **given).as_dict()
    (effect,) = found["effects"]
    assert (found["verdict"], effect["id"]) == ("missing_physics", "square_damping")
    assert effect["parameters"]["c2_w"]["unit"] == "N m s^2/rad^2"
    assert effect["parameters"]["c2_w"]["value"] == pytest.approx(0.1, rel=0.02)


@pytest.mark.nightly
def test_a_function_of_casadi_with_another_inflow_is_explained():
    ca = pytest.importorskip("casadi", reason="pip install casadi")
    h, q, a = ca.SX.sym("h"), ca.SX.sym("q"), ca.SX.sym("a")
    flow = ca.Function("flow", [h, q, a], [q - a * ca.sqrt(h)])
    plant = Simulator(
        lambda t, x, u, p: flow(x, u, p.a), dt=1.0, states={"h": {"unit": "m", "initial": 0.25}}, inputs={"q": "m/s"},
        parameters={"a": [0.02, "m^(1/2)/s", 0.02]}, name="tank", compiled=False,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    q = np.repeat(rng.uniform(0.006, 0.014, 20), 20)
    leaking = plant.with_term("balance_h", "leak", "-0.006 * h")
    level = simulate(leaking, {"q": q}, sample_time=1.0, step=1.0)["h"] + 1e-4 * rng.standard_normal(400)
    recording = {"t": np.arange(400.0), "q": q, "h": level}
    found = greygate.diagnose(plant, recording, noise_rms={"h": 1e-4}, effects=few(rig_of(plant, recording), ("leak",)))
    assert [e["id"] for e in found.as_dict()["effects"]] == ["leak"]
