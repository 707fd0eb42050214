"""The cable-drum sensor's SNN: rest, home, and what is kept of it, in float and in fixed point."""

import json

import numpy as np
import pytest

from greygate.compiler.pipeline import compile_network
from greygate.emulator.engine import run
from greygate.machines import catalog
from greygate.machines.cable_drum.plant import SEEDS, cable_drum, validation
from greygate.machines.cable_drum.study import (
    ARCHITECTURES,
    HELD,
    SIZES,
    VALIDATED,
    at_rest,
    black_box,
    chosen,
    drift_at_rest,
    drum,
    fnn,
    micrometres,
    record_of,
    records,
    recurrent,
    residual,
    unswitched,
)
from greygate.models.accuracy import rmse
from greygate.models.storage import TRAINED
from greygate.models.training.levenberg import train
from greygate.models.training.objective import Objective

KEPT = json.loads((TRAINED / "cable_drum.json").read_text())


@pytest.fixture(scope="module")
def snn():
    return catalog.entry("cable_drum").network()


@pytest.fixture(scope="module")
def program(snn):
    entry = catalog.entry("cable_drum")
    return compile_network(snn, entry.records(), ranged_on=entry.training, period=entry.period)


def test_the_kept_network_gives_the_kept_figures(snn):
    for name in ("training", "validation", "home"):
        assert micrometres(snn, name) == pytest.approx(KEPT["um"][name], rel=1e-6)


def test_the_kept_network_is_the_one_that_is_chosen_of_the_kept_starts():
    assert KEPT["choice_um"].keys() == {str(size) for size in SIZES}
    scores = {(int(size), seed): um for size, all_um in KEPT["choice_um"].items() for seed, um in enumerate(all_um)}
    assert chosen(scores) == (KEPT["neurons"], KEPT["seed"])


def test_on_the_day_of_training_it_is_below_the_thesis_and_another_day_costs_most_where_no_beacon_helps(snn):
    courses = [validation(cable_drum(), seed) for seed in range(1000, 1005)]
    without, home = (np.median([1e6 * rmse(snn, record_of(c, beacon)) for c in courses]) for beacon in (False, True))
    assert without <= VALIDATED["validation"]
    assert home <= VALIDATED["home"]
    same_day = 1e6 * rmse(snn, record_of(validation(cable_drum(), SEEDS["validation"]), beacon=False))
    assert KEPT["um"]["validation"] - same_day > 5 * (KEPT["um"]["home"] - home) > 0


def test_nothing_drifts_in_a_minute_of_rest(snn):
    assert drift_at_rest(snn, records()["training"]) < 1e-4  # um; the tanh switch of the loop forgets so much
    assert drift_at_rest(snn, records()["home"]) < 1e-4
    assert unswitched(snn)["at_rest_um"] > 1.0


def test_in_hardware_nothing_moves_at_rest_and_detector_and_switches_are_logic(snn, program):
    remarks = [r for p in program.passes for r in p.remarks]
    assert sorted(r.split()[0] for r in remarks if "became logic" in r) == ["at_rest", "error", "moving"]
    stop = 700
    inputs = {n: np.append(v[:stop], np.full(HELD, v[stop])) for n, v in records()["home"].inputs.items()}
    moved = np.flatnonzero(np.diff(inputs["x_pe"]))[-1]
    codes = run(program.program, program.program.encode(inputs)).outputs[:, 0]
    assert np.ptp(codes[moved + 4 :]) == 0
    assert np.ptp(codes[:moved]) > 0


def test_at_home_the_answer_is_the_known_position_less_the_encoder(snn):
    r = records()["home"]
    answer = residual(snn, "home") + r.targets["e"]
    home = r.inputs["home"] == 1
    assert home.sum() > 200
    np.testing.assert_allclose(answer[home], -r.inputs["x_pe"][home], atol=1e-9)
    without = residual(snn, "validation") + r.targets["e"]
    assert np.abs(without[home] - answer[home]).max() > 10e-6


def test_only_slip_is_trained():
    network = drum((3,), 0)
    found = train(network, [records()["training"].cut(0, 600)], epochs=3)
    before, after = network.parameters(), found.network.parameters()
    changed = {n for n, v in before.items() if n in after and not np.array_equal(v, after[n])}
    assert changed
    assert {n.split(".")[0] for n in changed} == {"slip"}


def test_black_boxes_have_the_regressors_of_the_tables():
    assert len(ARCHITECTURES) == 9
    assert [c.target for c in fnn(2, 10).connections if c.target.startswith("hidden1.")] == [
        f"hidden1.{n}_z{d}" for n in ("x_pe", "v_pe") for d in (0, 1)
    ]
    assert Objective(recurrent(3, 30, turning=True), []).flat.modules["hidden1"].weights.keys() == {
        *(f"{n}_z{d}" for n in ("x_pe", "v_pe") for d in range(3)),
        "cos_z0",
        "sin_z0",
        "e_z1",
    }


def test_a_narx_is_good_one_step_ahead_and_an_fnn_cannot_know_the_past():
    r = black_box(records()["training"])
    narx = train(recurrent(1, 10), [r], teacher=True, epochs=15).network
    objective = Objective(narx, [r], teacher=True)
    ahead = 1e3 * np.sqrt(objective.squares(objective.theta) / objective.samples)
    assert ahead < 15
    assert 1e6 * rmse(train(fnn(1, 10), [r], epochs=15).network, r) > 10 * ahead


def test_a_rest_follows_the_longest_rest(snn):
    assert len(at_rest(snn, records()["training"])) >= HELD
