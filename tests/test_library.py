"""Library networks: each does what it says, and says how well."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import library as training
from greygate.errors import InputError
from greygate.models.families import blocks
from greygate.models.families import library as families
from greygate.models.families.library import LIBRARY, entry, library, recalled
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train

ARGUMENTS = [
    ("limiter", {"lo": -1e9, "hi": 0.1}),
    ("limiter", {"lo": -5.0, "hi": 3.0}),
    ("limiter", {"lo": -math.inf}),
    ("absolute", {"reach": 50.0}),
    ("switch_1", {"reach": 300.0}),
    ("switch_2", {"gain": 1e5, "reach": 300.0}),
]


@pytest.mark.parametrize("name", LIBRARY)
def test_the_stated_worst_error_is_the_one_measured_on_a_dense_grid(name):
    found = entry(name)
    measured = training.worst(found)
    assert measured <= found.worst_error <= 1.01 * measured + 1e-15  # three digits are stated, rounded up


def test_the_library_is_trained_into_its_files_and_says_their_errors(tmp_path, monkeypatch, capsys):
    def briefly(network, records, **options):
        return train(network, records, epochs=1)

    for module in (training, blocks):
        monkeypatch.setattr(module, "train", briefly)
    monkeypatch.setattr(training, "NEURONS", {"square": 3})
    monkeypatch.setattr(training, "markdown", lambda: "")
    monkeypatch.setattr(families, "TRAINED", tmp_path)
    monkeypatch.setattr(families, "ERRORS", tmp_path / "errors.json")
    training.main()
    told = capsys.readouterr().out.splitlines()
    assert [text.split(":")[0] for text in told if text] == ["flow", "divider", "square"]
    for name in ("flow", "divider", "square"):
        assert entry(name).worst_error >= training.worst(entry(name)) > 0


@pytest.mark.parametrize(("name", "args"), [*((name, {}) for name in LIBRARY), *ARGUMENTS])
def test_no_error_is_larger_than_stated_wherever_it_is_looked_for(name, args):
    found, rng = entry(name, **args), np.random.default_rng(1)
    at = {}
    for port, (low, high) in found.ranges.items():
        low, high = max(low, -10), min(high, 10)
        x = rng.uniform(low, high, 200_000)
        edges = [low, high, *(v for gap in found.gaps.get(port, ()) for v in gap)]
        inside = np.any([(a < x) & (x < b) for a, b in found.gaps.get(port, ())], axis=0)
        at[port] = np.where(inside | (rng.random(len(x)) < 0.3), rng.choice(edges, len(x)), x)
    assert training.errors(found, at).max() <= found.worst_error


@pytest.mark.parametrize("lap", [-0.3, -0.05, 0.05, 0.2])
def test_a_lapped_valve_keeps_its_bound(lap):
    found = entry("flow", lap=lap)
    assert 1e-4 < training.worst(found, 301) <= found.worst_error
    u, p = np.meshgrid([-0.5, -0.02, 0.0, 0.02, 0.5], [0.2, 0.7])  # A.4, A.6 as they stand
    by_hand = np.maximum(u + lap, 0) * np.sqrt(1 - p) - np.maximum(lap - u, 0) * np.sqrt(p)
    np.testing.assert_allclose(found.function(u=u, p=p), by_hand, atol=1e-15)


def answer(network: Network, **inputs):
    return network.run({p: np.array(v, float)[:, None] for p, v in inputs.items()})["y"][:, 0]


@pytest.mark.parametrize(("gain", "least"), [(1e5, 3e-4), (1e6, 3e-5), (1e8, 3e-7)])
def test_switch_2_answers_within_the_step_and_zero_is_not_negative(gain, least):
    u1, u2, s = [0.5, -0.7, 0.5, 0.5], [-0.2, 0.9, 0.1, 0.1], [0.0, -least, 1.0, least]
    np.testing.assert_allclose(
        answer(library("switch_2", gain=gain), u1=u1, u2=u2, s=s), [0.5, 0.9, 0.5, 0.5], atol=4e-5
    )


def test_the_sign_of_zero_is_a_third_sign_to_the_exclusive_or():
    u1, u2 = [0.3, 0.3, -1e-3, 0, 0, 0, 0.2], [0.8, -0.1, -0.5, 0, 0.4, -0.4, 0]
    np.testing.assert_array_equal(answer(library("xor"), u1=u1, u2=u2), [-1, 1, -1, -1, 1, 1, 1])


@pytest.mark.parametrize(
    ("name", "args", "x", "y"),
    [
        ("limiter", {}, [-2, 0.25, 2], [0, 0.25, 1]),
        ("limiter", {"lo": -1}, [-2, -0.5, 2], [-1, -0.5, 1]),
        ("limiter", {"lo": 2, "hi": 6}, [0, 3, 7], [2, 3, 6]),
        ("limiter", {"lo": 0.1, "hi": math.inf}, [-1e9, 0.1, 1e9], [0.1, 0.1, 1e9]),
        ("limiter", {"lo": -math.inf, "hi": 0.3}, [-1e9, 0.3, 1e9], [-1e9, 0.3, 0.3]),
        ("absolute", {"reach": 4}, [-4, -0.5, 0, 3], [4, 0.5, 0, 3]),
        ("zero_region", {"threshold": 0.25}, [-0.26, -0.25, 0, 0.25, 0.26], [-1, 1, 1, 1, -1]),
        ("sign", {}, [-1e-4, 0, 1e-9], [-1, 1, 1]),
    ],
)
def test_what_has_arguments_does_what_they_say(name, args, x, y):
    np.testing.assert_allclose(answer(library(name, **args), x=x), y, atol=1e-12)


def test_a_library_network_carries_the_name_it_can_be_recalled_by(tmp_path):
    network = library("switch_2", gain=1e5)
    network.save(tmp_path / "n")
    again = Network.load(tmp_path / "n")
    assert again.meaning == "switch_2(gain=100000.0)"
    name, found = recalled(again.meaning)
    assert name == "switch_2"
    assert found.network.meaning == again.meaning
    assert recalled("xor")[1].network.meaning == "xor"


def test_constructed_weights_are_frozen_and_trained_ones_may_move():
    for name in LIBRARY:
        frozen = [layer.frozen == {*layer.weights, "bias"} for layer in library(name).layers().values()]
        assert all(frozen) == (entry(name).worst_error < 1e-12 or name.startswith("switch")), name


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: library("adder"), "no library network is called 'adder'; there are switch_1"),
        (lambda: library("sine", gain=2.0), "sine: does not take gain"),
        (lambda: library("switch_2", gain=0.0), "gain = 0.0 must be a positive number"),
        (lambda: library("limiter", lo=2.0), "lo = 2.0, hi = 1.0; give lo < hi"),
        (lambda: library("limiter", lo=-math.inf, hi=math.inf), "one of them may be infinite"),
        (lambda: library("flow", lap=1.5), "lap = 1.5 is not within"),
        (lambda: library("xor", gain=10.0), "gain = 10.0 is below 100"),
        (lambda: recalled("switch_2(gain"), "names no library network"),
        (lambda: recalled("switch 2"), "write NAME or NAME(option=number)"),
        (lambda: recalled("adder"), "no library network is called 'adder'"),
    ],
)
def test_what_is_not_in_the_library_is_named(make, message):
    with pytest.raises(InputError, match=re.escape(message)):
        make()


def test_the_page_shows_the_table_that_the_code_makes():
    assert training.markdown() in (Path(__file__).parents[1] / "docs" / "library.md").read_text()


def test_a_library_network_is_a_module_like_any_other():
    network = Network("rectifier", [Port("v", "V", scale=2.0)], [Port("y", "V", scale=2.0)])
    network.add("positive", library("limiter"))
    network.connect("v", "positive.x")
    network.connect("positive", "y")
    np.testing.assert_allclose(network.run({"v": np.array([-1.0, 0.5, 3.0])})["y"], [0, 0.5, 2])
