"""Units that do not agree are told with both of them."""

import pytest

from greygate.plants.dimensions import clashes
from greygate.plants.plant import Plant
from greygate.plants.units import of, powers

MASS = """outputs = ["x"]
inputs = {{ f = "{force}" }}
parameters = {{ m = [1.0, "kg"], k = [3.0, "{stiffness}"], d = [1.0, "{damping}"] }}
[states]
x = {{ unit = "mm", rate = "v" }}
v = {{ unit = "{speed}" }}
[equations]
position.x = {{ speed = "v" }}
motion.v = {{ storage = "m", drive = "f", spring = "-k * x", damping = "-d * v", bias = "0.5" }}
"""
RIGHT = {"force": "N", "stiffness": "N/mm", "damping": "Pa m s", "speed": "mm/s"}


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({}, []),
        ({"stiffness": "kg/s^2"}, []),  # a length in mm and one in m have one dimension
        ({"stiffness": "N"}, ["motion: left side is in kg mm/s^2, spring in N mm"]),
        ({"force": "Nm"}, []),  # nobody knows what that is
        ({"force": "N m"}, ["motion: left side is in kg mm/s^2, drive in N m"]),
        (
            {"speed": "mm"},
            ["position: left side is in mm/s, speed in mm", "motion: left side is in kg mm/s, drive in N"],
        ),
    ],
)
def test_terms_of_another_dimension_are_told(changed, told, tmp_path):
    (tmp_path / "mass.toml").write_text(MASS.format(**RIGHT | changed))
    assert clashes(Plant.read(tmp_path / "mass.toml")) == told


def test_an_angle_has_no_dimension(tmp_path):
    text = MASS.format(**RIGHT | {"speed": "mrad mm/s"})
    (tmp_path / "mass.toml").write_text(text)
    assert clashes(Plant.read(tmp_path / "mass.toml")) == []


def test_a_measured_curve_has_the_unit_of_its_definition(tmp_path):
    (tmp_path / "pull.csv").write_text("x_mm,f_N\n0,0\n1,3\n2,4\n")
    pull = '[definitions]\ncurve.pull = { unit = "N", table = { file = "pull.csv", of = "x" } }\n'
    text = MASS.format(**RIGHT).replace("[equations]", f"{pull}[equations]")
    (tmp_path / "mass.toml").write_text(text)
    assert clashes(Plant.read(tmp_path / "mass.toml")) == []


@pytest.mark.parametrize(
    ("expression", "unit"),
    [
        ("sqrt(area)", "m"),
        ("area**0.5 / t", "m/s"),
        ("area**(-1)", "1/m^2"),
        ("orifice(t, area, 1)", "m s"),
        ("sqrt(area) * t**2", "m s^2"),
        ("area**t", None),
        ("sqrt(unknown)", None),
        ("t + area", None),
        ("t + 0 * area", "s"),
        ("max(0, t)", "s"),
    ],
)
def test_an_expression_has_the_unit_of_what_it_computes(expression, unit):
    assert of(expression, {"area": "m^2", "t": "s"}) == (unit and powers(unit))
