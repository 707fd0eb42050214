"""A build is a function of its inputs, on every processor; what training ends in is kept with a digest."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from networks import delay_line

from benchmarks.pruned import make
from greygate.compiler.pipeline import compile_network
from greygate.errors import InputError
from greygate.machines import kept as keeping
from greygate.machines.catalog import CATALOG, entry
from greygate.machines.kept import PRUNED, Kept, digest
from greygate.machines.source import Source
from greygate.models.arithmetic import exp, mean, product, tanh
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record
from greygate.plants.recording import Recording
from greygate.project import compile_project

ROOT = Path(__file__).parents[1]
EPS = np.finfo(float).eps


@pytest.mark.nightly  # beside `make test-old`
@pytest.mark.parametrize("network", ["b2 pruned", "emps"], ids=["pruned", "measured"])
def test_builds_are_the_same_bytes_under_other_kernels_of_blas_and_numpy(network):
    try:
        entry(network.partition(" ")[0]).records()
    except InputError as absent:  # its recording is published elsewhere
        pytest.skip(str(absent))
    settings = ("--setting", "Haswell", "old BLAS and numpy")
    command = [sys.executable, "-m", "benchmarks", "processors", network, *settings]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("files, equal") == 2


# ---- arithmetic


def test_exp_and_tanh_are_right_to_the_last_bit_but_one():
    x = np.random.default_rng(0).normal(size=20_000) * 20
    np.testing.assert_allclose(exp(x), np.exp(x), rtol=2 * EPS)
    np.testing.assert_allclose(tanh(x), np.tanh(x), rtol=0, atol=2 * EPS)
    np.testing.assert_allclose(exp(np.array([-708.0, -1e-300, 0.0, 1e-300, 709.0])), np.exp([-708, 0, 0, 0, 709.0]))


def test_exp_and_tanh_of_what_is_infinite_or_no_number():
    ends = np.array([-np.inf, -1e308, 1e308, np.inf, np.nan])
    np.testing.assert_array_equal(exp(ends), [0, 0, np.inf, np.inf, np.nan])
    np.testing.assert_array_equal(tanh(ends), [-1, -1, 1, 1, np.nan])


def test_products_and_means_are_sums_in_the_order_of_their_terms():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(50, 7)), rng.normal(size=(7, 3))
    terms = np.zeros((50, 3))
    for k in range(7):
        terms = terms + np.outer(a[:, k], b[k])
    np.testing.assert_array_equal(product(a, b), terms)
    np.testing.assert_array_equal(product(a, b[:, 0]), terms[:, 0])
    np.testing.assert_allclose(product(a, b), a @ b, rtol=0, atol=1e-14)
    assert product(np.zeros((2, 0)), np.zeros((0, 3))).shape == (2, 3)
    column = 0.0
    for value in a[:, 2]:
        column += value
    assert mean(a)[2] == column / 50
    assert mean(a[:, 2]) == column / 50


# ---- what pruning ended in


def small() -> tuple[Network, Network]:
    """A network of two neurons, and one of them alone."""
    both = Network("two", [Port("u", "V")], [Port("y", "m")])
    both.add("hidden", Layer({"u": [[0.5], [0.4]]}, [0.1, 0.0], "tansig"))
    both.add("out", Layer({"hidden": [[1.0, 1e-9]]}, [0.0]))
    for source, target in (("u", "hidden.u"), ("hidden", "out.hidden"), ("out", "y")):
        both.connect(source, target)
    one = both.with_parameters({"out.hidden": np.array([[1.1, 0.0]])})
    return both, one


@pytest.fixture
def kept(tmp_path, monkeypatch) -> Kept:
    monkeypatch.setattr(keeping, "PRUNED", tmp_path)
    both, one = small()
    u = {"u": np.linspace(-1, 1, 50)}
    recording = Record(u, {"y": both.run(u)["y"] + 0.1})

    def prune(network, allowed, **options):
        return one, []

    found = Kept("two", lambda: {"training": recording}, prune)
    make(found, both)
    return found


def anew(kept: Kept, **changes) -> Kept:
    """The same, whose pruning must not be asked again unless it fails by saying so."""

    def prune(network, allowed, **options):
        raise RuntimeError("pruned anew")

    return Kept(**({"name": kept.name, "records": kept.records, "prune": prune} | changes))


def test_a_pruned_network_that_is_kept_answers_for_what_it_was_made_of_and_for_nothing_else(kept):
    (both, one), recalled = small(), anew(kept)
    assert digest(recalled(both, 1.0, progress=print)[0]) == digest(one)
    for network, allowed, options in ((both, 1.02, {}), (both, 1.0, {"weights": prune_nothing}), (one, 1.0, {})):
        with pytest.raises(RuntimeError, match="pruned anew"):
            recalled(network, allowed, **options)


def prune_nothing():
    pass


def test_records_are_compared_by_what_the_network_makes_of_them(kept):
    both, (record,) = small()[0], kept.records().values()

    def shifted(by):
        return lambda: {"training": Record(record.inputs, {"y": record.targets["y"] * (1 + by)})}

    anew(kept, records=shifted(1e-12))(both, 1.0)  # as another processor simulates it
    with pytest.raises(RuntimeError, match="pruned anew"):
        anew(kept, records=shifted(1e-3))(both, 1.0)


def test_a_pruned_network_that_was_changed_is_refused(kept, tmp_path):
    both, one = small()
    one.with_parameters({"out.bias": np.array([np.nextafter(0.0, 1.0)])}).save(tmp_path / "two")
    with pytest.raises(InputError, match="its digest says that it was changed"):
        anew(kept)(both, 1.0)


@pytest.mark.parametrize("name", [n for n, e in CATALOG.items() if e.prune])
def test_the_catalogues_pruned_networks_are_those_of_its_networks(name):
    """A network that was trained again needs `python -m benchmarks pruned`."""
    found = entry(name)
    compiled = compile_network(
        found.network(),
        found.records(),
        ranged_on=found.training,
        prune=lambda network: anew(found.prune)(network, 1.0),
    )
    assert digest(compiled.network) == json.loads((PRUNED / f"{name}.json").read_text())["network"]


def test_from_the_network_in_a_pruned_build_the_same_hardware_comes_out(tmp_path):
    network = delay_line()
    u = np.random.default_rng(0).uniform(-1, 1, 300)
    Recording(1e-3, {"u": u, "y": network.run({"u": u})["y"]}, {"u": "V", "y": "m"}).write_csv(tmp_path / "a.csv")
    network.save(tmp_path / "line")
    builds = []
    for start, weights in (("line.toml", "obs"), ("once/network.toml", None)):
        source = Source(str(tmp_path / start), {"a": str(tmp_path / "a.csv")})
        folder = tmp_path / ("once" if weights else "again")
        compile_project(source, folder, source.formats(), weights=weights)
        files = [p for p in folder.rglob("*") if p.is_file() and p.name not in ("compile.json", "manifest.json")]
        builds.append({p.relative_to(folder): p.read_bytes() for p in files})
    assert builds[0] == builds[1]
