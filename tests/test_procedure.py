"""The procedure's ledger, adaptation from one machine to another, and its picture, on a lag behind a curve."""

import re

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.machines.procedure import OWN, Procedure
from greygate.models.adaptation import adopt, weight_changes
from greygate.models.families.blocks import feedforward
from greygate.models.network import Layer, Network, Port
from greygate.models.saliency import obs
from greygate.models.training.levenberg import Outcome, train
from greygate.models.training.record import Record
from greygate.pages.changes import draw_changes
from greygate.pages.figures import weight_changes as draw

U = np.linspace(-1, 1, 61)
CURVE = Record({"u": U}, {"y": np.tanh(1.5 * U)})


def plant(seed: int) -> Record:
    u = np.repeat(np.random.default_rng(seed).uniform(-1, 1, 40), 5)
    y = [0.0]
    for v in u:
        y.append(0.9 * y[-1] + 0.1 * np.tanh(1.8 * v))
    return Record({"u": u}, {"y": 1e5 * np.array(y[1:])})


def lagged(curve: Network) -> Network:
    network = Network("lagged", [Port("u", "V")], [Port("y", "Pa", 1e5)])
    network.add("curve", curve)
    network.add("lag", Layer({"curve": [[0.12]], "y": [[0.88]]}, [0.0], frozen={"bias"}))
    network.connect("u", "curve")
    network.connect("curve", "lag.curve")
    network.connect("lag", "lag.y", delay=1)
    network.connect("lag", "y")
    return network


def curve(seed: int = 0) -> Network:
    return feedforward("curve", ["u"], [4], seed)


@pytest.fixture(scope="module")
def snn() -> Procedure:
    found = Procedure({"training": plant(1), "v1": plant(2)}, subsystems=("curve",))
    found.take("curve", train(curve(), [CURVE], epochs=30), CURVE)
    found.join(lagged)
    found.train(epochs=15, decay=1e-6)
    found.simplify()
    found.prune(allowed=1.1)
    return found


def test_every_step_stands_in_the_ledger_with_its_size_and_its_error(snn):
    names = ["curve", "joined", "trained", "simplified", "pruned by entropy"]
    assert [step.name for step in snn.steps] == names
    assert snn["curve"].errors.keys() == {OWN}
    assert all(step.errors.keys() == {"training", "v1"} for step in snn.steps[1:])
    assert (snn["curve"].neurons, snn["curve"].parameters) == (4, 13)
    assert (snn["joined"].neurons, snn["joined"].parameters) == (4, 15)
    assert snn["trained"].errors["v1"]["y"] < 0.1 * snn["joined"].errors["v1"]["y"]


def test_an_error_in_the_ledger_is_the_rms_of_a_free_run_in_the_output_s_unit(snn):
    record = plant(2)
    run = snn["trained"].network.run(record.inputs)["y"]
    assert snn["trained"].errors["v1"]["y"] == pytest.approx(np.sqrt(np.mean((run - record.targets["y"]) ** 2)))


def test_simplifying_keeps_the_error_and_pruning_what_was_allowed(snn):
    before, after = snn["trained"].errors["training"]["y"], snn["simplified"].errors["training"]["y"]
    assert after == pytest.approx(before, rel=1e-9)
    pruned = snn["pruned by entropy"]
    assert pruned.neurons < 4
    assert pruned.errors["training"]["y"] <= 1.1 * after


def test_weights_are_pruned_by_any_method_of_saliency(snn):
    again = Procedure({"training": plant(1)})
    again.join(snn["simplified"].network)
    again.prune(obs, allowed=1.5)
    before, after = again["joined"], again["pruned by obs"]
    assert after.parameters < before.parameters
    assert after.errors["training"]["y"] <= 1.5 * before.errors["training"]["y"]


def test_the_table_names_steps_and_scenarios_and_gives_pressure_in_bar(snn):
    lines = str(snn).splitlines()
    assert re.split(r"\s{2,}", lines[0]) == ["step", "neurons", "parameters", OWN, "training", "v1", "seconds"]
    assert f"{snn['joined'].errors['v1']['y'] / 1e5:.3g} bar" in lines[2]
    assert Outcome.EPOCHS.value in lines[3] or Outcome.CONVERGED.value in lines[3]
    assert len(lines) == 1 + len(snn.steps)


def test_a_step_that_went_wrong_is_undone_by_taking_an_earlier_network(snn):
    again = Procedure({"v1": plant(2)})
    again.join(snn["trained"].network)
    assert again["joined"].errors["v1"] == snn["trained"].errors["v1"]


def test_joining_waits_for_every_subsystem():
    snn = Procedure({"training": plant(1)}, subsystems=("curve", "lag"))
    snn.take("curve", curve())
    with pytest.raises(InputError, match="nothing was taken for lag"):
        snn.join(lagged)
    with pytest.raises(InputError, match="no joined network yet"):
        snn.train()
    with pytest.raises(InputError, match="no subsystem 'valve'; there are curve, lag"):
        snn.take("valve", curve())


def test_records_and_steps_that_do_not_exist_are_named():
    with pytest.raises(InputError, match="no records"):
        Procedure({})
    with pytest.raises(InputError, match="no record 'v9' to train on; there are training"):
        Procedure({"training": plant(1)}, training=("v9",))
    with pytest.raises(InputError, match="no step 'trained'; there are none"):
        Procedure({"training": plant(1)})["trained"]


def test_a_network_that_diverges_has_an_infinite_error_and_stops_nothing():
    snn = Procedure({"training": plant(1)})
    network = snn.join(lagged(curve()).with_parameters({"lag.y": np.array([[1e6]])}))
    assert snn.network is network
    assert snn["joined"].errors["training"]["y"] == np.inf


# ---- another machine


def test_adopting_takes_the_named_modules_and_leaves_the_rest():
    new, learnt = lagged(curve(1)), lagged(curve(2)).with_parameters({"lag.y": np.array([[0.5]])}).flatten()
    adopted, taught, own = adopt(new, learnt, ["curve"]).parameters(), learnt.parameters(), new.parameters()
    for name, value in adopted.items():
        source = taught if name.startswith("curve.") else own
        np.testing.assert_array_equal(value, source[name])


def test_adopting_what_is_not_there_or_does_not_fit_is_refused():
    with pytest.raises(InputError, match="no module valve to adopt; has curve, lag"):
        adopt(lagged(curve()), lagged(curve()), ["valve"])
    smaller = lagged(feedforward("curve", ["u"], [3], 0))
    with pytest.raises(InputError, match=r"cannot adopt curve.hidden1.u, \(4, 1\) here.*has it as \(3, 1\)"):
        adopt(lagged(curve()), smaller, ["curve"])


def test_changes_are_per_cent_of_what_each_weight_was():
    before = lagged(curve()).with_parameters({"lag.y": np.array([[-0.5]]), "curve.out.bias": np.zeros(1)})
    after = before.with_parameters({"lag.y": np.array([[-0.6]]), "curve.out.bias": np.ones(1)}).flatten()
    changes = weight_changes(before, after)
    np.testing.assert_allclose(changes["lag.y"], [[-20.0]])
    assert np.isnan(changes["curve.out.bias"])
    assert not changes["curve.hidden1.u"].any()
    assert "lag.bias" not in changes  # frozen


def test_changes_between_different_networks_are_refused():
    with pytest.raises(InputError, match=r"differ in curve\.hidden1\.bias"):
        weight_changes(lagged(curve()), lagged(feedforward("curve", ["u"], [3], 0)))


def test_the_picture_has_a_bar_a_weight_and_a_row_a_module():
    changes = {"curve.hidden1.u": np.array([[5.0], [-250.0]]), "curve.out.bias": np.array([np.nan]),
               "lag.y": np.array([[0.0]])}  # fmt: skip
    picture = draw(changes)
    bars = dict(re.findall(r"<title>([^:]+): ([^<]+)</title>", picture))
    assert bars == {"curve.hidden1.u[0, 0]": "+5.00 %", "curve.hidden1.u[1, 0]": "−250 %",
                    "curve.out.bias[0]": "was 0", "lag.y[0, 0]": "0 %"}  # fmt: skip
    assert re.findall(r'class="name"[^>]*end">([^<]+)<', picture) == ["curve", "lag"]
    assert "median 128 %" in picture
    assert "max 250 %" in picture


def test_the_page_is_written_whole_and_the_changes_come_back(tmp_path):
    before = lagged(curve(1))
    changes = draw_changes(before, lagged(curve(2)), tmp_path / "changes.html")
    assert changes.keys() == weight_changes(before, before).keys()
    page = (tmp_path / "changes.html").read_text()
    assert page.startswith("<!doctype html>")
    assert page.count("<title>") == 1 + sum(v.size for v in changes.values())
