import json

import pytest

from benchmarks import systems
from greygate.machines import catalog
from greygate.machines.benchmark_systems import study as benchmark_systems
from greygate.machines.benchmark_systems.study import B2, THESIS, figures, identify, prune_weights
from greygate.models.storage import TRAINED


def test_the_stored_network_of_b2_has_its_figures_and_the_thesis_is_behind():
    network = catalog.entry("b2").network()
    kept, found = json.loads((TRAINED / "b2.json").read_text()), figures(B2, network, 0)
    assert found == pytest.approx({name: kept[name] for name in found}, rel=1e-6)
    assert found["parameters"] == 341
    assert found["mse"] <= THESIS["mse"]
    assert found["rmse"] <= THESIS["rmse"]


def test_b1_is_identified_better_than_in_the_thesis_and_the_test_signal_stays_in_bounds():
    _, found = identify(systems.SYSTEMS["b1_10"], 0)
    assert found["mse"] <= systems.THESIS_B1["b1_10"]["mse"]
    assert found["rmse"] < 1e-3


def test_b2_loses_a_quarter_of_its_weights_and_stays_better_than_the_thesis(monkeypatch):
    monkeypatch.setattr(benchmark_systems, "SHARES", (0.1,))  # the fastest way down; all of them take a minute
    smaller, rounds = prune_weights(B2, 0, catalog.entry("b2").network(), 1.0)
    found = figures(B2, smaller, 0)
    assert found["parameters"] <= THESIS["pruned_parameters"]
    assert found["rmse"] <= THESIS["rmse"]
    assert any(r.kept for r in rounds)


@pytest.mark.parametrize(("onto_others", "neurons"), [(False, 22), (True, 25)])
def test_b1_loses_neurons_by_entropy_and_errs_no_more_than_the_thesis(monkeypatch, onto_others, neurons):
    monkeypatch.setattr(systems, "AGAIN", (60, 100))  # with more it takes a minute and leaves 9
    system, seed = systems.SYSTEMS["b1_30"], 1
    network, _ = identify(system, seed)
    smaller, rounds = systems.prune_neurons(system, seed, network, onto_others)
    assert smaller.neurons() <= neurons
    assert figures(system, smaller, seed)["mse"] <= systems.THESIS_B1["b1_30"]["mse"]
    assert not rounds[-1].kept  # the loop goes on until a removal costs too much, and undoes that one


def test_b2_loses_neurons_by_entropy_only_while_held_out_records_run_well(monkeypatch):
    monkeypatch.setattr(systems, "TRIES", 1)  # with more it takes a minute and leaves fewer
    system, network = B2, catalog.entry("b2").network()
    smaller, rounds = systems.prune_guarded(system, 0, network, onto_others=True)
    found = figures(system, smaller, 0)
    assert found["neurons"] < network.neurons()
    assert found["held"] <= system.spare
    assert found["rmse"] <= THESIS["pruned_rmse"]
    assert [r.kept for r in rounds][-2:] == [True, False]
