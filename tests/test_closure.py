"""What a plant's file says of terms that may be missing: libraries of functions, joined, for the places it names."""

import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.mismatch.closure import bases
from greygate.mismatch.libraries import declared
from greygate.plants.plant import Plant

ROOT = Path(__file__).parents[1]
SLIDE = """
outputs = ["x"]
[inputs]
u = "N"
t = "s"
[parameters]
mass = [2.0, "kg"]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations.position]
x = { velocity = "v" }
[equations.motion]
v = { storage = "mass", drive = "u" }
"""
CLOSURE = """
[closure.signals]
x = "x - seen_low_x"
reach = "seen_high_x - seen_low_x"
duration = "20.0"
[closure.libraries.own]
fall = "exp(-t / duration)"
push = "u * x"
[closure.places]
motion = { libraries = ["waves", "own"], term = "2.0 * f", typical = 3.0, reported = "position" }
"""


def plant(tmp_path: Path, text: str = SLIDE + CLOSURE) -> Plant:
    (tmp_path / "slide.toml").write_text(text)
    return Plant.read(tmp_path / "slide.toml")


def test_libraries_are_joined_in_the_order_in_which_a_place_names_them(tmp_path):
    basis = declared(plant(tmp_path))["motion"]
    waves = [f"{wave}{k}" for k in range(1, 13) for wave in ("sin", "cos")]
    assert list(basis) == [*waves, "fall", "push"]
    inside = "(x - seen_low_x) / (seen_high_x - seen_low_x)"
    assert basis["sin2"].expression == f"2.0 * (sin(2 * 3.141592653589793 * {inside}))"
    assert basis["push"].expression == "2.0 * (u * (x - seen_low_x))"


def test_a_function_depends_on_the_signals_in_it_and_on_no_limit_of_them(tmp_path):
    basis = declared(plant(tmp_path))["motion"]
    assert (basis["cos1"].depends_on, basis["fall"].depends_on) == (("x",), ("t",))
    assert basis["push"].depends_on == ("u", "x")


def test_a_function_of_a_signal_that_does_not_move_is_left_out(tmp_path):
    search = SimpleNamespace(rig=SimpleNamespace(plant=plant(tmp_path)))
    assert list(bases(search, {"u": np.arange(3.0), "t": np.arange(3.0)})["motion"]) == ["fall"]


def test_a_library_with_k_has_each_function_once_for_every_k_named_by_its_whole_part(tmp_path):
    text = CLOSURE.replace('fall = "exp', 'k = [0.5, 2.5]\nfall = "k * exp')
    basis = declared(plant(tmp_path, SLIDE + text))["motion"]
    assert list(basis)[24:] == ["fall0", "push0", "fall1", "push1", "fall2", "push2"]
    assert basis["fall1"].expression == "2.0 * (1.5 * exp(-t / 20.0))"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('["waves", "own"]', '["wave"]', "there is no library 'wave'; there are travel, waves"),
        ('duration = "20.0"\n', "", "unknown name 'duration'; say in closure.signals what it stands for"),
        ("motion = {", "movement = {", "no such equation or definition; it has position, motion"),
        ('"u * x"', '"__import__(1)"', "closure.libraries.own.push"),
        ("[closure.libraries.own]", "[closure.libraries.own]\nk = [3, 1]", "is not a range; write [first, last]"),
        ("typical = 3.0", "typical = 0.0", "give a size above 0"),
        ('push = "u', "".join(f'p{i} = "u"\n' for i in range(500)) + 'push = "u', "526 functions; 499 are the most"),
        ("typical", "typicl", "write typical if that is meant"),
    ],
)
def test_what_cannot_serve_is_told_in_one_line(tmp_path, old, new, message):
    with pytest.raises(InputError, match=re.escape(message)) as told:
        declared(plant(tmp_path, (SLIDE + CLOSURE).replace(old, new)))
    assert "\n" not in str(told.value)


def test_the_example_of_the_docs_is_a_closure(tmp_path):
    text = re.search(r"```toml\n(.*?)```", (ROOT / "docs" / "plants.md").read_text(), re.DOTALL)[1]
    belt = (ROOT / "machines" / "belt_drive" / "belt_drive.toml").read_text()
    assert tomllib.loads(text)
    basis = declared(plant(tmp_path, belt[: belt.index("[closure.signals]")] + text))["transmission"]
    assert list(basis)[-3:] == ["tooth_sin1", "tooth_sin2", "tooth_sin3"]
    assert basis["tooth_sin1"].depends_on == ("x",)


@pytest.mark.parametrize("path", sorted((ROOT / "machines").glob("*/*.toml")), ids=lambda path: path.stem)
def test_every_plant_that_comes_along_declares_closures_that_hold(path):
    declared(Plant.read(path))
