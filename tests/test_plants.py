"""The declaration of a plant and the simulation that comes from it."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from checking import POSIX
from scipy.integrate import solve_ivp

from greygate.errors import InputError
from greygate.plants import Definition, Equation, Parameter, Plant, State, simulate
from greygate.plants.simulator import Restarted, Stepper, _module, source

PARAMETERS = {"mass": Parameter(2.0, "kg", 0.1, "of the slide"), "stiffness": Parameter(50.0, "N/m")}


def oscillator(**changes) -> Plant:
    declaration = {
        "name": "slide",
        "parameters": PARAMETERS | {"damping": Parameter(3.0, "N s/m"), "x_max": Parameter(1.0, "m")},
        "inputs": {"force": "N"},
        "states": {"x": State("m", 0.1, "-x_max", "x_max", rate="v"), "v": State("m/s")},
        "equations": {
            "position": Equation("x", {"velocity": "v"}),
            "motion": Equation(
                "v", {"drive": "force", "spring": "-f_spring", "viscous": "-damping * v"}, storage="mass"
            ),
        },
        "outputs": ("x", "v", "f_spring"),
        "definitions": {"spring": Definition("f_spring", "N", {"linear": "stiffness * x"})},
    }
    return Plant(**(declaration | changes))


def motion(**terms) -> dict:
    return {"equations": {"position": Equation("x", {"velocity": "v"}), "motion": Equation("v", terms)}}


def exact_oscillation(t):
    """Position of the free oscillator."""
    decay, omega = 0.75, np.sqrt(25 - 0.75**2)
    return 0.1 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))


BAD = {
    "unknown name": (motion(drive="forse"), "equation motion, term drive: unknown name 'forse'"),
    "unknown function": (motion(drive="sinh(x)"), "equation motion, term drive: unknown function 'sinh'"),
    "method": (motion(drive="x.real"), "equation motion, term drive: 'x.real' is not arithmetic"),
    "call of a call": (motion(drive="sin(x)(v)"), "'sin(x)(v)' is no expression ('(' stands where it cannot)"),
    "function as a value": (motion(drive="sin"), "unknown name 'sin'"),
    "too few arguments": (motion(drive="orifice(x, v)"), "orifice takes 3 arguments"),
    "syntax": (motion(drive="force +"), "equation motion, term drive: 'force +' is no expression"),
    "comparison": (motion(drive="force > 0"), "'force > 0' is not arithmetic"),
    "text": (motion(drive="'force'"), "\"'force'\" is not arithmetic"),
    "storage": (
        {"equations": {"position": Equation("x", {}), "motion": Equation("v", {}, storage="mas")}},
        "equation motion, storage: unknown name 'mas'",
    ),
    "definition out of order": (
        {"definitions": {"a": Definition("f_a", "N", {"t": "f_b"}), "b": Definition("f_b", "N", {"t": "x"})}},
        "definition a, term t: unknown name 'f_b'; it is defined further down",
    ),
    "name twice": ({"inputs": {"x": "m"}}, "x: is declared twice"),
    "name of a function": ({"inputs": {"exp": "N"}}, "exp: is not a name for a quantity"),
    "keyword": ({"inputs": {"lambda": "N"}}, "lambda: is not a name for a quantity"),
    "equation missing": ({"equations": {"position": Equation("x", {"velocity": "v"})}}, "state v has 0 equations"),
    "equation of no state": (
        {"equations": {"a": Equation("x", {}), "b": Equation("v", {}), "c": Equation("y", {})}},
        "'y' is no state",
    ),
    "output unknown": ({"outputs": ("y",)}, "outputs: 'y' is no state, definition or input"),
    "initial uses a state": ({"states": {"x": State("m", "v"), "v": State("m/s")}}, "state x, initial: unknown name"),
    "rate unknown": ({"states": {"x": State("m", rate="w"), "v": State("m/s")}}, "rate 'w' is no state"),
    "step of nothing": ({"step": 0.0}, "step: 0.0 s; give 1e-09 s or more"),
    "step backwards": ({"step": -0.001}, "step: -0.001 s; give 1e-09 s or more"),
    "parameter NaN": ({"parameters": {"mass": Parameter(np.nan, "kg")}}, "parameter mass: nan"),
    "one name for two places": (
        {"definitions": {"motion": Definition("f_spring", "N", {"linear": "stiffness * x"})}},
        "equation motion: a definition has this name too",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_declaration_is_refused_in_one_line_that_names_the_place(case):
    changes, message = BAD[case]
    with pytest.raises(InputError) as caught:
        oscillator(**changes)
    assert message in str(caught.value)
    assert str(caught.value).startswith("plant slide: ")
    assert "\n" not in str(caught.value)


def test_a_term_left_out_and_put_back_gives_the_same_plant():
    plant = oscillator()
    bare = plant.without("motion.viscous")
    assert list(bare.equations["motion"].terms) == ["drive", "spring"]
    assert list(plant.equations["motion"].terms) == ["drive", "spring", "viscous"]
    assert bare.with_term("motion", "viscous", "-damping * v") == plant


def test_a_term_can_bring_its_parameters_and_enter_a_definition():
    plant = oscillator().with_term("spring", "cubic", "k_cubic * x**3", {"k_cubic": Parameter(7.0, "N/m^3")})
    values = plant.values(["f_spring"], {"x": np.array([2.0])})
    assert values["f_spring"].tolist() == [50.0 * 2 + 7.0 * 8]
    assert plant.unit("k_cubic") == "N/m^3"


def test_switching_what_is_not_there_names_what_is():
    with pytest.raises(InputError, match=r"motion\.friction: no such term; motion has drive, spring, viscous"):
        oscillator().without("motion.friction")
    with pytest.raises(InputError, match="notion: no such equation or definition"):
        oscillator().without("notion.viscous")
    with pytest.raises(InputError, match="'mas' is not among mass, stiffness"):
        oscillator().with_parameters(mas=1.0)


def test_the_residual_of_a_true_equation_vanishes_with_the_square_of_the_sampling_interval():
    worst = []
    for dt in (2e-3, 1e-3):
        force = np.sin(7.0 * np.arange(0.0, 2.0, dt))
        run = simulate(oscillator(), {"force": force}, sample_time=dt, step=dt / 10)
        # a held input acts from its sample on: around a sample, motion sees the mean of the last and the present
        seen = np.concatenate([force[:1], (force[1:] + force[:-1]) / 2])
        residual = oscillator().residual("motion", {**run.channels, "force": seen}, dt)
        assert residual.shape == force.shape
        worst.append(np.abs(residual[1:-1]).max())
    assert worst[0] < 1e-2
    assert 3.5 < worst[0] / worst[1] < 4.5


def test_the_residual_of_an_equation_shows_the_term_that_was_left_out():
    run = simulate(oscillator(), {"force": np.zeros(2001)})
    residual = oscillator().without("motion.viscous").residual("motion", run.channels, 1e-3)
    np.testing.assert_allclose(residual[1:-1], -3.0 * run["v"][1:-1], atol=1e-3)


def test_the_residual_of_a_definition_compares_the_measured_quantity():
    signals = {"x": np.array([0.1, 0.2]), "f_spring": np.array([6.0, 10.0])}
    np.testing.assert_allclose(oscillator().residual("spring", signals, 1.0), [1.0, 0.0], atol=1e-15)
    with pytest.raises(InputError, match="definition spring: f_spring was not measured"):
        oscillator().residual("spring", {"x": np.array([0.1])}, 1.0)


def test_a_residual_names_the_signal_that_it_lacks():
    with pytest.raises(InputError, match="plant slide: signal force is missing"):
        oscillator().residual("motion", {"x": np.zeros(3), "v": np.zeros(3)}, 1.0)


def test_the_simulation_follows_the_exact_solution_of_a_linear_plant():
    run = simulate(oscillator(), {"force": np.zeros(2001)})
    np.testing.assert_allclose(run["x"], exact_oscillation(run.time), atol=1e-13)
    np.testing.assert_array_equal(run["f_spring"], 50.0 * run["x"])
    assert run.units == {"force": "N", "x": "m", "v": "m/s", "f_spring": "N"}


def test_the_integrator_is_of_fifth_order():
    at_2s = [
        simulate(oscillator(), {"force": np.zeros(2 * n + 1)}, sample_time=1 / n, step=1 / n)["x"][-1] for n in (10, 20)
    ]
    coarse, fine = np.abs(np.array(at_2s) - exact_oscillation(2.0))
    assert 2**4.7 < coarse / fine < 2**5.6


def test_the_simulation_agrees_with_an_adaptive_solver_at_tight_tolerance():
    plant = oscillator().with_term("motion", "hardening", "-900 * x**3 - 2 * tanh(v / 0.2)")
    force = np.repeat([3.0, -2.0, 0.5, 1.0], 250)
    run = simulate(plant, {"force": force})
    state = np.array([0.1, 0.0])
    for k in range(0, 1000, 250):
        held = force[k]
        solved = solve_ivp(
            lambda t, s: [s[1], (held - 50 * s[0] - 3 * s[1] - 900 * s[0] ** 3 - 2 * np.tanh(s[1] / 0.2)) / 2],  # noqa: B023
            (0, 0.249 if k == 750 else 0.25),
            state,
            method="DOP853",
            rtol=1e-13,
            atol=1e-15,
        )
        state = solved.y[:, -1]
    np.testing.assert_allclose([run["x"][-1], run["v"][-1]], state, atol=1e-12)


def test_a_state_stops_at_its_bound_and_loses_its_outward_rate():
    run = simulate(oscillator(), {"force": np.repeat([200.0, -200.0], 1000)})
    assert run["x"].max() == 1.0
    assert run["x"].min() == -1.0
    resting = run["x"][:1001] == 1.0
    assert resting.sum() > 500
    assert (run["v"][:1001][resting] == 0.0).all()


def test_an_input_acts_from_its_own_sample_on():
    force = np.zeros(5)
    force[2] = 1.0
    v = simulate(oscillator().with_parameters(stiffness=0.0), {"force": force})["v"]
    assert v[:3].tolist() == [0.0, 0.0, 0.0]
    assert v[3] > 0


def test_the_same_run_gives_the_same_bits_and_leaves_its_inputs_alone():
    force = np.random.default_rng(1).standard_normal(500)
    before = force.copy()
    first, second = (simulate(oscillator(), {"force": force}) for _ in range(2))
    np.testing.assert_array_equal(first["x"], second["x"])
    np.testing.assert_array_equal(force, before)


def test_other_parameter_values_compile_nothing():
    plant = oscillator()
    assert source(plant) == source(plant.with_parameters(mass=3.0))
    assert source(plant) != source(plant.without("motion.viscous"))


def test_any_symbol_can_be_recorded_and_a_start_can_be_given():
    run = simulate(oscillator(), {"force": np.zeros(3)}, initial={"x": 0.25}, channels=["f_spring", "force"])
    assert list(run.channels) == ["force", "f_spring"]
    assert run["f_spring"][0] == 12.5


@pytest.mark.parametrize(
    ("inputs", "options", "message"),
    [
        ({}, {}, r"inputs are \[\]; give \['force'\]"),
        ({"force": np.zeros(0)}, {}, "one sequence of the same length"),
        ({"force": np.zeros((3, 2))}, {}, "one sequence of the same length"),
        ({"force": np.array([0.0, np.nan])}, {}, "input force is not finite at sample 1"),
        ({"force": np.zeros(3)}, {"step": 0.0}, "step 0.0 s does not divide the sample time"),
        ({"force": np.zeros(3)}, {"step": 3e-4}, "step 0.0003 s does not divide the sample time"),
        ({"force": np.zeros(3)}, {"initial": {"y": 1.0}}, "initial: 'y' is no state; it has x, v"),
        ({"force": np.zeros(3)}, {"channels": ["y"]}, "signal y is missing"),
    ],
)
def test_a_simulation_that_cannot_be_run_is_refused(inputs, options, message):
    with pytest.raises(InputError, match=message):
        simulate(oscillator(), inputs, **options)


def test_a_state_that_leaves_the_finite_numbers_is_named_with_its_time():
    plant = oscillator(states={"x": State("m", 0.1), "v": State("m/s")}).with_term("motion", "runaway", "1e4 * x**3")
    with pytest.raises(InputError, match=r"state x is not finite at 0\.\d+ s; check parameters"):
        simulate(plant, {"force": np.zeros(2000)})


def test_a_run_ends_at_the_sample_at_which_a_state_leaves_the_finite_numbers():
    plant = Plant("tank", {}, {"u": "1"}, {"x": State("1")}, {"level": Equation("x", {"in": "u * u"})}, ("x",))
    u = np.zeros(8)
    u[3] = 1e200  # from the third sample to the fourth
    with pytest.raises(InputError, match=r"state x is not finite at 0\.004 s"):
        simulate(plant, {"u": u})
    free = Restarted(plant, 1e-3, 1e-4)
    states = free.run(u[:, None], np.array([0]), np.zeros((1, 1)), np.array([True]), {})
    np.testing.assert_array_equal(states[:, 0], [0, 0, 0, 0, *[np.nan] * 4])
    under_way = Stepper(plant)
    for value in u[:3]:
        under_way.step({"u": value})
    with pytest.raises(InputError, match=r"state x is not finite at 0\.004 s"):
        under_way.step({"u": u[3]})


@pytest.mark.nightly
def test_terms_that_are_off_cost_nothing_and_count_when_they_come_on():
    """Nine terms, one more than a block holds; each alone adds what a plant has that always has it."""
    terms = {f"on_{i}": f"when(abs(on_{i}), on_{i} * x**{i})" for i in range(9)}
    parameters = {f"on_{i}": Parameter(0.0, "N") for i in range(9)}
    plant = oscillator()
    many = plant
    for i, (name, text) in enumerate(terms.items()):
        many = many.with_term("motion", name, text, {name: parameters[f"on_{i}"]})
    module, force = _module(source(many)), {"force": np.ones(20)}
    assert not module.asked(np.array([p.value for p in many.parameters.values()])).any()
    np.testing.assert_array_equal(simulate(many, force)["x"], simulate(plant, force)["x"])
    values = {symbol: p.value for symbol, p in many.parameters.items()}
    run = Restarted(many, 1e-3, 1e-4).run
    inputs, restarts, starts, reset = np.ones((20, 1)), np.array([0]), np.array([[0.1, 0.0]]), np.ones(2, bool)
    for i in range(9):
        found = run(inputs, restarts, starts, reset, {**values, f"on_{i}": 0.5})
        alone = plant.with_term("motion", "one", f"0.5 * x**{i}")
        np.testing.assert_array_equal(found[:, 0], simulate(alone, force)["x"])
        on = module.asked(np.array([*({**values, f"on_{i}": 0.5}).values()]))
        np.testing.assert_array_equal(on, [i < 8, i == 8])


def test_a_term_whose_condition_is_more_than_a_strength_is_asked_where_it_is_compiled():
    """Python would divide by zero, and numpy's third power is another than numba's."""
    names = dict.fromkeys(("p", "q", "r", "s"), Parameter(0.0, "N"))
    plant = oscillator().with_term("motion", "odd", "when(when(q, 1 / when(p, r)), s)", names)
    values = {symbol: p.value for symbol, p in plant.parameters.items()} | {"q": 1.0, "s": 2.0}
    alone = oscillator().with_term("motion", "odd", "2")
    inputs, restarts, starts, reset = np.ones((20, 1)), np.array([0]), np.array([[0.1, 0.0]]), np.ones(2, bool)
    found, wanted = (Restarted(p, 1e-3, 1e-4).run(inputs, restarts, starts, reset, values) for p in (plant, alone))
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("taken", [np.asfortranarray, lambda a: a.astype(np.int32), lambda a: a[:, ::-1]])
def test_inputs_in_any_layout_move_a_plant_alike(taken):
    """Their rows are read by address."""
    plant = oscillator()
    plant = replace(plant, inputs={**plant.inputs, "other": plant.inputs["force"]}).with_term(
        "motion", "more", "2 * other"
    )
    inputs = np.random.default_rng(1).integers(-9, 9, (50, 2))
    values = {symbol: p.value for symbol, p in plant.parameters.items()}
    wanted, found = (
        Restarted(plant, 1e-3, 1e-4).run(given, np.array([0]), np.zeros((1, 2)), np.ones(2, bool), values)
        for given in (np.ascontiguousarray(taken(inputs), dtype=float), taken(inputs))
    )
    np.testing.assert_array_equal(found, wanted)


def test_a_comment_or_a_line_break_in_an_expression_changes_nothing():
    plant = oscillator(**motion(drive="(force\n  - 50 * x)  # newtons"))
    run = simulate(plant, {"force": np.ones(10)})
    np.testing.assert_array_equal(
        run["x"], simulate(oscillator(**motion(drive="force - 50*x")), {"force": np.ones(10)})["x"]
    )


SCRIPT = """
import os, sys
sys.path.insert(0, os.environ["TESTS"])
import numpy as np
from test_plants import oscillator
from greygate.plants.simulator import _module, simulate, source
simulate(oscillator(), {"force": np.zeros(3)})
terms = _module(source(oscillator())).all_terms
print(terms.cache_hits, terms.__wrapped__.__code__.co_filename)
"""


def run_elsewhere(cache, **variables) -> list[str]:
    """HOME: without POSIX, a cache is the user's own where it lies in there."""
    own = {"XDG_CACHE_HOME": str(cache), "HOME": str(cache), "TESTS": os.path.dirname(__file__)}
    environment = os.environ | own | variables
    return subprocess.run(
        [sys.executable, "-c", SCRIPT], env=environment, check=True, capture_output=True, text=True
    ).stdout.split()


def test_a_second_process_compiles_nothing(tmp_path):
    assert run_elsewhere(tmp_path)[0] == "0"
    assert run_elsewhere(tmp_path)[0] == "1"


@POSIX
def test_a_cache_that_cannot_be_written_is_done_without(tmp_path):
    (tmp_path / "file").write_text("")
    other = tmp_path / f"greygate-{os.getuid()}"  # which everybody can write: what lies there is not run
    other.mkdir()
    other.chmod(0o777)
    hits, filename = run_elsewhere(tmp_path / "file", TMPDIR=str(tmp_path))
    assert (hits, filename.startswith("greygate_plant_")) == ("0", True)
    assert not list(other.iterdir())


def test_a_damaged_source_in_the_cache_is_written_anew(tmp_path, monkeypatch):
    for name in ("XDG_CACHE_HOME", "HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    text = source(oscillator(name="damaged").with_term("motion", "more", "0.125 * force"))
    path = _module(text).__file__
    _module.cache_clear()
    with open(path, "w") as file:
        file.write("raise RuntimeError")
    assert _module(text).all_terms.address


@pytest.mark.parametrize("side", [-1, 1])
def test_a_slide_driven_against_either_stop_rests_there_and_leaves_it_at_once(side):
    """What flows as fast as it moves stands still there too, within every step."""
    plain = oscillator()
    states = plain.states | {"q": State("m")}
    equations = plain.equations | {"flow": Equation("q", {"sweep": "v"})}
    plant = oscillator(states=states, equations=equations, outputs=("x", "v", "q"))
    run = simulate(plant, {"force": side * np.repeat([200.0, -200.0], [400, 20])})
    resting = run["x"] == side
    first = int(resting.argmax())
    assert 100 < first < 390
    assert resting[first:400].all()
    np.testing.assert_array_equal(run["v"][first:401], 0.0)
    np.testing.assert_array_equal(run["q"][first:401], run["q"][first])
    assert not resting[402:].any()


def test_at_a_restart_some_states_begin_anew_and_the_others_go_on():
    plant = oscillator()
    values = {symbol: p.value for symbol, p in plant.parameters.items()}
    force, starts = np.zeros((60, 1)), np.array([[0.1, 0.4], [-0.2, 9.0], [0.3, 9.0]])
    runner = Restarted(plant, 1e-2, 1e-3)
    out = runner.run(force, np.array([0, 20, 40]), starts, np.array([True, False]), values)
    assert out[0].tolist() == [0.1, 0.4]
    assert out[[20, 40], 0].tolist() == [-0.2, 0.3]
    free = runner.run(force[:21], np.array([0]), starts[:1], np.array([True, True]), values)
    assert np.array_equal(out[:20], free[:20])
    assert out[20, 1] == free[20, 1]  # the velocity goes on
