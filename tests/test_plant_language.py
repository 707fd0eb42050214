"""What a plant can say beside balances: curves, mass matrices, no input, no state, sympy, LaTeX."""

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.plants import Plant, curve, simulate
from greygate.plants.functions import FUNCTIONS
from greygate.plants.plant import Values

DOUBLE = {
    "outputs": ["a", "b", "p", "q"],
    "parameters": {"m": [1.0, "kg"], "l": [1.0, "m"], "g": [9.81, "m/s^2"]},
    "states": {
        "a": {"unit": "rad", "initial": 1.0, "rate": "p"},
        "p": {"unit": "rad/s"},
        "b": {"unit": "rad", "initial": 0.5, "rate": "q"},
        "q": {"unit": "rad/s"},
    },
    "equations": {
        "upper": {"a": {"speed": "p"}},
        "lower": {"b": {"speed": "q"}},
        "shoulder": {
            "p": {
                "storage": "2 * m * l**2",
                "couples": {"q": "m * l**2 * cos(a - b)"},
                "centrifugal": "-m * l**2 * sin(a - b) * q**2",
                "weight": "-2 * m * g * l * sin(a)",
            }
        },
        "elbow": {
            "q": {
                "storage": "m * l**2",
                "couples": {"p": "m * l**2 * cos(a - b)"},
                "centrifugal": "m * l**2 * sin(a - b) * p**2",
                "weight": "-m * g * l * sin(b)",
            }
        },
    },
}


def test_a_double_pendulum_by_its_mass_matrix_keeps_its_energy():
    plant = Plant.of("double", DOUBLE)
    run = simulate(plant, {}, sample_time=1e-3, samples=2000)
    a, b, p, q = (run[name] for name in "abpq")
    energy = p**2 + q**2 / 2 + p * q * np.cos(a - b) - 9.81 * (2 * np.cos(a) + np.cos(b))
    assert np.ptp(energy) < 1e-9 * np.abs(energy).max()
    assert np.ptp(a) > 1.0
    for place in ("shoulder", "elbow"):
        assert np.abs(plant.residual(place, run.channels, run.dt)[1:-1]).max() < 1e-3  # N m of 20: differences


def test_three_bodies_of_which_two_are_coupled():
    """A chain by accelerations relative to the body before, against the same in absolute coordinates."""
    masses, pull = [1.0, 2.0, 3.0], 4.0
    equations = {f"x{i}": {f"x{i}": {"speed": f"v{i}"}} for i in range(3)}
    spring = ["-10 * x0", "-20 * x1", "-30 * x2"]  # relative positions
    for i in range(3):
        own = sum(masses[i:])
        couples = {f"v{j}": repr(sum(masses[max(i, j) :])) for j in range(3) if j != i}
        equations[f"body{i}"] = {f"v{i}": {"storage": repr(own), "couples": couples, "spring": spring[i], "pull": "f"}}
    states = {f"x{i}": {"unit": "m", "rate": f"v{i}"} for i in range(3)} | {f"v{i}": {"unit": "m/s"} for i in range(3)}
    chain = Plant.of("chain", {"outputs": ["x0", "x1", "x2"], "inputs": {"f": "N"}, "states": states,
                               "equations": equations})  # fmt: skip
    absolute = {f"y{i}": {f"y{i}": {"speed": f"w{i}"}} for i in range(3)}
    extension = ["y0", "y1 - y0", "y2 - y1"]
    for i in range(3):
        terms = {"own": f"-{10 * (i + 1)} * ({extension[i]})"}
        if i < 2:
            terms["next"] = f"{10 * (i + 2)} * ({extension[i + 1]})"
        absolute[f"body{i}"] = {f"w{i}": {"storage": repr(masses[i]), **terms, "pull": "f" if i == 2 else "0.0 * f"}}
    states = {f"y{i}": {"unit": "m", "rate": f"w{i}"} for i in range(3)} | {f"w{i}": {"unit": "m/s"} for i in range(3)}
    plain = Plant.of("plain", {"outputs": ["y0", "y1", "y2"], "inputs": {"f": "N"}, "states": states,
                               "equations": absolute})  # fmt: skip
    force = np.full(2000, pull)
    relative, whole = simulate(chain, {"f": force}), simulate(plain, {"f": force})
    np.testing.assert_allclose(
        np.cumsum([relative[f"x{i}"] for i in range(3)], axis=0), [whole[f"y{i}"] for i in range(3)], atol=1e-9
    )


@pytest.mark.parametrize("coupled", ["first", "second"])
def test_a_rate_that_acts_on_another_equation_and_not_back_counts_there(coupled):
    """2 dx/dt + dz/dt / 2 = u and dz/dt = 3 u, the coupled one written before or after the other."""
    both = {"one": {"x": {"storage": "2", "couples": {"z": "0.5"}, "push": "u"}}, "other": {"z": {"push": "3 * u"}}}
    equations = dict(sorted(both.items(), reverse=coupled == "second"))
    states = {"x": {"unit": "m"}, "z": {"unit": "m"}}
    plant = Plant.of("one_sided", {"outputs": ["x", "z"], "inputs": {"u": "N"}, "states": states,
                                   "equations": equations})  # fmt: skip
    run = simulate(plant, {"u": np.ones(1001)})
    np.testing.assert_allclose([run["x"][-1], run["z"][-1]], [-0.25, 3.0], atol=1e-9)


@pytest.mark.parametrize(("couples", "message"), [({"z": "1"}, "'z' is no other state"), ({"q": "k"}, "unknown name")])
def test_a_wrong_couple_is_refused(couples, message):
    equations = DOUBLE["equations"] | {"shoulder": {"p": {"storage": "1", "couples": couples}}}
    with pytest.raises(InputError, match=message):
        Plant.of("double", DOUBLE | {"equations": equations})


def test_a_plant_without_input_needs_a_length():
    with pytest.raises(InputError, match="has no input; give samples"):
        simulate(Plant.of("double", DOUBLE), {})


# -- curves ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("points", [2, 3, 300])
def test_a_curve_goes_through_its_points_and_stays_beyond_them(points):
    rng = np.random.default_rng(0)
    x, y = np.sort(rng.uniform(-2.0, 1.0, points)), rng.standard_normal(points).cumsum()
    plant = Plant.of("s", {"inputs": {"q": "1"}, "definitions": {"k": {"y": {"unit": "1", **curve("q", x, y)}}}})
    q = np.r_[x, np.linspace(-3.0, 2.0, 501)]
    np.testing.assert_allclose(Values(plant, {"q": q})["y"], np.interp(q, x, y), atol=1e-9 * np.ptp(y))


def test_a_curve_is_read_from_a_file_beside_the_plant(tmp_path):
    (tmp_path / "fan.csv").write_text("q_m3_s,dp_Pa\n0,100\n1,80\n2,20\n")
    text = 'outputs = ["dp"]\ninputs = { q = "m^3/s" }\n[definitions.fan]\ndp = { unit = "Pa", '
    (tmp_path / "fan.toml").write_text(text + 'table = { file = "fan.csv", of = "q" }, loss = "-q" }\n')
    run = simulate(Plant.read(tmp_path / "fan.toml"), {"q": np.array([0.5, 2.5])}, sample_time=1.0, step=1.0)
    assert run["dp"] == pytest.approx([89.5, 17.5])
    for wrong, message in (("q,dp\n1,2\n1,3\n", "does not rise at point 2"), ("q,a,b\n1,2,3\n2,3,4\n", "give two")):
        (tmp_path / "fan.csv").write_text(wrong)
        with pytest.raises(InputError, match=message):
            Plant.read(tmp_path / "fan.toml")
    (tmp_path / "fan.toml").write_text(text + 'table = { file = "../fan.csv", of = "q" } }\n')
    with pytest.raises(InputError, match="file"):
        Plant.read(tmp_path / "fan.toml")


def test_a_smooth_switch_goes_from_0_to_1():
    step = FUNCTIONS["smooth_step"]
    assert step(np.array([-1.0, 0.0, 1.0]), 0.05) == pytest.approx([0.0, 0.5, 1.0])
    assert FUNCTIONS["atan2"](1.0, -1.0) == pytest.approx(3 * np.pi / 4)


# -- sympy -----------------------------------------------------------------------------------------------------------


def test_a_plant_of_sympy_expressions_is_that_of_its_texts():
    sympy = pytest.importorskip("sympy")
    from greygate.plants.symbolic import balances, texts

    a, b, p, q, m, l, g = sympy.symbols("a b p q m l g")
    mass = m * l**2 * sympy.Matrix([[2, sympy.cos(a - b)], [sympy.cos(a - b), 1]])
    bend = m * l**2 * sympy.sin(a - b)
    forces = [
        {"centrifugal": -bend * q**2, "weight": -2 * m * g * l * sympy.sin(a)},
        {"centrifugal": bend * p**2, "weight": -m * g * l * sympy.sin(b)},
    ]
    places = {"upper": {"a": {"speed": p}}, "lower": {"b": {"speed": q}}}
    declared = texts(DOUBLE | {"equations": places | balances(mass, forces, ["p", "q"])})
    one, other = (simulate(Plant.of("d", d), {}, samples=500) for d in (DOUBLE, declared))
    for name in "abpq":
        np.testing.assert_allclose(one[name], other[name], atol=1e-12)


def test_sympy_functions_and_cases_become_expressions_of_the_same_value():
    sympy = pytest.importorskip("sympy")
    from greygate.plants.symbolic import symbolic, written

    x, y = sympy.symbols("x y")
    for expression in (
        sympy.Max(x, y, 0) + sympy.Abs(x) ** sympy.Rational(1, 2) * sympy.pi,
        sympy.Piecewise((x**2, x > y), (y, x < -1), (2 * x, True)),
        sympy.exp(-x) * sympy.tanh(y / 3) - sympy.atan2(x, y) * sympy.sign(y),
    ):
        text = written(expression)
        plant = Plant.of("s", {"inputs": {"x": "1", "y": "1"}})
        for at in ((0.7, -0.2), (-1.5, 0.4), (0.1, 0.9)):
            value = Values(plant, {"x": at[0], "y": at[1]}).evaluate(text)
            assert float(value) == pytest.approx(float(expression.subs({x: at[0], y: at[1]})), rel=1e-12)
            if "when" not in text:
                assert float(symbolic(text).subs({x: at[0], y: at[1]})) == pytest.approx(float(value), rel=1e-5)
    with pytest.raises(InputError, match="no expression of a plant says this"):
        written(sympy.gamma(x))


def test_a_plant_is_printed_in_latex():
    pytest.importorskip("sympy")
    from greygate.plants.symbolic import latex

    lines = latex(Plant.of("double", DOUBLE)).splitlines()
    assert lines[0] == r"\begin{align}"
    assert lines[1] == r"\dot{a} &= p \\"
    assert lines[3].startswith(r"2 l^{2} m \, \dot{p} + l^{2} m \cos{\left(a - b \right)} \, \dot{q} &= -")
    assert r"- \underbrace{2 g l m \sin{\left(a \right)}}_{\text{weight}}" in lines[3]
