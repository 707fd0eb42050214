"""A plant's equations for other tools: a Modelica model says the same, MuJoCo moves the same, LaTeX has every term."""

import json
import operator

import numpy as np
import pytest
from small_plants import motor
from test_export import CART

from greygate.export.export import export_latex, export_mjcf, export_modelica
from greygate.mismatch.simulation import read
from greygate.plants.plant import Plant, Values
from greygate.plants.simulator import simulate

MODELICA = pytest.importorskip("pymoca.parser", reason="pymoca is not installed")
MUJOCO = pytest.importorskip("mujoco", reason="mujoco is not installed")

SIGNS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "^": operator.pow}
TESTS = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
LOGIC = {"and": lambda a, b: a and b, "or": lambda a, b: a or b}


def value(node, known):
    """What a node of another program's tree of the Modelica text is worth."""
    kind = type(node).__name__
    if kind == "Primary":
        return node.value
    if kind == "ComponentRef":
        return known[node.name]
    if kind == "IfExpression":
        return value(node.expressions[0 if value(node.conditions[0], known) else 1], known)
    assert kind == "Expression", kind
    name = node.operator if isinstance(node.operator, str) else node.operator.name
    if name == "der":
        return known[f"der({node.operands[0].name})"]
    given = [value(operand, known) for operand in node.operands]
    if name == "noEvent":
        return given[0]
    if len(given) == 1 and name == "-":
        return -given[0]
    if name in ("abs", "sqrt", "sin", "cos", "tan", "tanh", "exp", "log", "sign"):
        return float(getattr(np, name)(given[0]))
    if name in ("min", "max", "atan2"):
        return float({"min": np.minimum, "max": np.maximum, "atan2": np.arctan2}[name](*given))
    return {**SIGNS, **TESTS, **LOGIC}[name](*given)


def loaded(text):
    model = MODELICA.parse(text).classes["cart"]
    return model, [e for e in model.equations if type(e).__name__ == "Equation"]


@pytest.fixture
def cart(tmp_path):
    (tmp_path / "cart.toml").write_text(CART)
    assert export_modelica(tmp_path / "cart.toml", tmp_path / "cart.mo") == "cart"
    return Plant.read(tmp_path / "cart.toml"), (tmp_path / "cart.mo").read_text()


def test_every_equation_of_a_modelica_model_is_that_of_the_plant(cart):
    plant, text = cart
    model, equations = loaded(text)
    assert [type(e).__name__ for e in model.equations] == ["Equation"] * 6 + ["WhenEquation"]
    rng = np.random.default_rng(2)
    for _ in range(20):
        known = Values(plant, {s: rng.uniform(-0.04, 0.04) for s in (*plant.inputs, *plant.states)})
        for symbol in plant.symbols:
            known[symbol] = float(known[symbol])
        for (place, of), equation in zip((plant.definitions | plant.equations).items(), equations, strict=False):
            expected = float(sum(map(known.evaluate, of.terms.values())))
            assert value(equation.right, known) == pytest.approx(expected, rel=1e-14, abs=1e-300), place
            if place in plant.equations:
                parts = {of.state: of.storage, **of.couples}
                for symbol, storage in parts.items():
                    only = {f"der({s})": float(s == symbol) for s in plant.states} | {"'rate of v'": symbol == "v"}
                    assert value(equation.left, known | only) == known.evaluate(storage)


@pytest.mark.parametrize(
    ("x", "push", "held"), [(0.05, 1.0, 0.0), (0.05, -1.0, -1.0), (-0.05, -1.0, 0.0), (0.0, 1.0, 1.0)]
)
def test_a_velocity_is_held_where_its_way_ends(cart, x, push, held):
    _, text = cart
    *_, hold = loaded(text)[1]
    assert value(hold.right, {"x": x, "stroke": 0.05, "'rate of v'": push}) == held


def test_words_units_and_texts_of_modelica(tmp_path):
    (tmp_path / "end.toml").write_text(
        """outputs = ["time"]
inputs = { when_ = "m^3/(Pa s)" }
parameters = { flow = [1.0, "m^(5/2)/kg^(1/2)", 0, 'a "quoted" word'], each = [2.0, "kg m^2"] }
states = { time = { unit = "J/kg/K" } }
equations = { a = { time = { storage = "flow", b = "when_ - each * time ** -2" } } }
"""
    )
    export_modelica(tmp_path / "end.toml", tmp_path / "end.mo")
    text = (tmp_path / "end.mo").read_text()
    assert "model 'end'" in text
    assert """parameter Real 'flow' = 1.0 "a \\"quoted\\" word, in m^(5/2)/kg^(1/2)";""" in text
    assert """parameter Real 'each'(unit = "kg.m2") = 2.0;""" in text
    assert """input Real when_(unit = "m3/(Pa.s)");""" in text
    assert """output Real 'time'(unit = "J/(kg.K)", start = 0.0, fixed = true);""" in text
    assert MODELICA.parse(text) is not None


# -- MuJoCo ----------------------------------------------------------------------------------------------------------

SLIDER = """outputs = ["x"]
step = 1e-4
inputs = { push = "N" }
[parameters]
mass = [2.0, "kg"]
oil = [3.0, "N s/m"]
dry = [1.5, "N"]
[states]
x = { unit = "m" }
v = { unit = "m/s" }
[definitions]
drag = { f = { unit = "N", oil = "oil * v", dry = "dry * tanh(v / 1e-4)" } }
[equations]
position = { x = { velocity = "v" } }
motion = { v = { storage = "mass", drive = "push", friction = "-f", air = "-0.5 * v" } }
"""
WORLD = """<mujoco>
  <include file="slider.xml"/>
  <option timestep="1e-3" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody><body>
    <joint class="guide" name="x" type="slide" axis="1 0 0"/><geom type="sphere" size="0.1" mass="2"/>
  </body></worldbody>
  <actuator><motor joint="x"/></actuator>
</mujoco>
"""


def test_mujoco_moves_as_the_plant(tmp_path):
    (tmp_path / "slider.toml").write_text(SLIDER)
    (found,) = export_mjcf(tmp_path / "slider.toml", tmp_path / "slider.xml", {"v": "guide"})
    assert (found.damping, found.frictionloss, found.armature) == (3.5, 1.5, 0.0)
    assert found.carried == {"damping": ["friction", "air"], "frictionloss": ["friction"]}
    assert found.left == ["drive"]
    (tmp_path / "world.xml").write_text(WORLD)
    model = MUJOCO.MjModel.from_xml_path(str(tmp_path / "world.xml"))
    data = MUJOCO.MjData(model)
    push = np.repeat([5.0, -8.0, 1.0, 12.0, 0.0], 200)
    run = []
    for force in push:
        run.append(data.qpos[0])
        data.ctrl[0] = force
        MUJOCO.mj_step(model, data)
    expected = simulate(Plant.read(tmp_path / "slider.toml"), {"push": push}, sample_time=1e-3)["x"]
    without = simulate(
        Plant.read(tmp_path / "slider.toml").without("motion.friction"), {"push": push}, sample_time=1e-3
    )["x"]
    error = np.abs(np.array(run) - expected).max() / np.ptp(expected)
    assert error < 0.02  # MuJoCo's dry friction is a soft constraint
    assert np.abs(without - expected).max() / np.ptp(expected) > 0.2


def test_a_diagnosis_gives_friction_and_inertia_to_a_joint(tmp_path, greygate):
    rig = motor(tmp_path / "motor", noise=0.5)
    assert greygate("diagnose", rig, "--out", rig / "diagnosis.json")[0] == 0
    arguments = ("export", "mjcf", rig, "--joint", "w=shaft", "--out", tmp_path / "m.xml", "--json")
    plain, corrected = (
        json.loads(greygate(*arguments, *more)[1])["joints"][0]
        for more in ((), ("--diagnosis", rig / "diagnosis.json"))
    )
    assert plain["frictionloss"] == 0
    named = {p: v["value"] for e in read(rig / "diagnosis.json")["effects"] for p, v in e["parameters"].items()}
    assert corrected["frictionloss"] == pytest.approx(named["f_w"], rel=1e-12)
    assert corrected["carried"]["frictionloss"] == ["dry_friction.dry_friction"]
    assert 'class="shaft"' in (tmp_path / "m.xml").read_text()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["mjcf", "lag.toml"], "no state is a velocity, in m/s or rad/s"),
        (["mjcf", "cart.toml", "--joint", "x=a"], "--joint x: is no velocity of plant cart; it has v, w, z"),
        (["modelica", "nothing"], "nothing: give a folder with rig.toml, a plant's TOML"),
    ],
)
def test_what_cannot_be_written_is_said(tmp_path, monkeypatch, greygate, arguments, told):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.toml").write_text(CART)
    (tmp_path / "lag.toml").write_text(
        'outputs = ["y"]\ninputs = { u = "V" }\nstates = { y = { unit = "V" } }\n'
        'equations = { lag = { y = { gain = "u - y" } } }\n'
    )
    code, _, error = greygate("export", *arguments, "--out", "out")
    assert (code, told in error) == (2, True), error
    assert not (tmp_path / "out").exists()


def test_latex_has_every_term_with_its_name(tmp_path):
    (tmp_path / "cart.toml").write_text(CART)
    assert export_latex(tmp_path / "cart.toml", tmp_path / "cart.tex") == "cart"
    text = (tmp_path / "cart.tex").read_text()
    assert text.startswith("\\begin{align}")
    assert all(rf"\text{{{term}}}" in text for term in ("motor", "spring", "pull", "drive", "friction"))
