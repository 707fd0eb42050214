"""The timing-belt drive's machine: its five states, its experts' data, its logic, the stored network."""

from itertools import pairwise

import numpy as np
import pytest

from greygate.compiler.pipeline import compile_network, fixed_error
from greygate.errors import InputError
from greygate.machines.belt_drive import study
from greygate.machines.belt_drive.network import EXPERTS, PLAY, REACH, E, X, belt_machine
from greygate.machines.catalog import entry
from greygate.models.accuracy import float_error
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

SLOPE = 2.0  # of a path, error over `REACH`
TOY_PLAY = 0.2 * E.scale  # m


def line(inputs: str, weights: list[list[float]], bias: list[float]) -> Network:
    """An expert that is linear."""
    network = Network("line", [Port(i) for i in inputs.split()], [Port("y", size=len(bias))])
    network.add("out", Layer({i: np.array(weights)[:, [n]] for n, i in enumerate(inputs.split())}, bias))
    for i in inputs.split():
        network.connect(i, f"out.{i}")
    network.connect("out", "y")
    return network


def toy() -> dict[str, Network]:
    """Boundaries at -0.5 and 0.5, play of 0.2, paths of one slope: where a path began follows exactly."""
    found = {}
    for way, sign in (("forward", 1), ("backward", -1)):
        began = sign * 0.3  # the other boundary's 0.5, less the play
        found |= {
            f"e_{way}": line("x", [[0.0]], [-sign * 0.5]),
            f"b_{way}": line("x", [[0.0]], [-sign * 0.2]),
            f"d_{way}": line("start away", [[0.0, -SLOPE]], [0.0]),
            f"sp_{way}": line("x e", [[0.0, 1 / SLOPE], [0.0, 0.0]], [-began / SLOPE, began]),
        }
    return found


def drive(turns_mm, step=2e-4):
    """x [m] through the turns and what the toy machine says, normalised."""
    x = np.concatenate([np.arange(a, b, step * np.sign(b - a)) for a, b in pairwise(turns_mm)])
    return x, told(x)


def told(x):
    return belt_machine(toy(), TOY_PLAY).run({"x": x})["e"] / E.scale


def test_a_path_leads_from_one_boundary_across_the_play_to_the_other_and_stays_there():
    x, e = drive([0.0, 0.1, 0.05, 0.1])
    turn = int(np.argmax(x))
    assert e[:turn] == pytest.approx(-0.5)
    assert e[turn + 2] == pytest.approx(-0.3, abs=0.04)
    inside = (x < x[turn]) & (np.arange(len(x)) > turn + 1) & (np.arange(len(x)) < turn + 50)
    slope = np.polyfit(x[inside], e[inside], 1)[0] * REACH * X.scale
    assert slope == pytest.approx(-SLOPE, rel=0.01)
    bottom = turn + int(np.argmin(x[turn:]))
    assert e[bottom - 5] == pytest.approx(0.5)


def test_a_motion_that_turns_inside_the_band_starts_from_the_last_error_less_the_play():
    x, e = drive([0.0, 0.1, 0.092, 0.098])
    turn = int(np.argmax(x))
    bottom = turn + int(np.argmin(x[turn : turn + 50]))
    assert -0.3 < e[bottom] < 0.5
    assert e[bottom + 2] - e[bottom] == pytest.approx(-0.2, abs=0.03)


def test_after_a_turn_the_error_goes_as_the_motor_while_the_carriage_stands():
    x = np.concatenate([np.arange(0, 0.1, 1e-4), 0.1 - TOY_PLAY * np.linspace(0, 1, 11)])
    np.testing.assert_allclose(told(x)[-10:], -0.5 + (0.1 - x[-10:]) / E.scale, atol=0.01)


@pytest.mark.parametrize("turns_mm", [[0.0, 0.1], [0.0, 0.1, 0.05], [0.0, 0.1, 0.092]])
def test_a_turn_that_is_taken_back_in_the_play_leaves_no_trace(turns_mm):
    x, e = drive(turns_mm)
    last, way = x[-1], np.sign(x[-1] - x[-2])
    dither = last - way * TOY_PLAY * np.tile([0.3, 0.9, 0.5, 0.0], 5)
    on = last + way * 2e-4 * np.arange(1, 20)
    now = told(np.concatenate([x, dither, on]))
    np.testing.assert_allclose(now[len(x) :][:20], e[-1] + (last - dither) / E.scale, atol=1e-6)
    np.testing.assert_allclose(now[-19:], told(np.concatenate([x, on]))[-19:], atol=1e-6)


def test_at_rest_it_holds_its_state_however_long():
    x, e = drive([0.0, 0.1, 0.094])
    held = np.concatenate([x, np.full(800, x[-1])])
    still = told(held)
    assert -0.3 < e[-1] < 0.5
    assert still[len(x) :] == pytest.approx(e[-1], abs=1e-4)


def test_an_expert_that_is_missing_is_named():
    few = toy()
    del few["sp_forward"], few["b_backward"]
    with pytest.raises(InputError, match="no expert sp_forward, b_backward; give e_forward"):
        belt_machine(few)


def test_every_switch_xor_and_latch_of_the_stored_machine_becomes_logic_and_costs_no_accuracy():
    machine = entry("belt_drive").network()
    meant = [
        name for name, m in machine.modules.items() if getattr(m, "meaning", "") and name not in ("away", "in_play")
    ]
    s3 = study.records()["s3"].cut(0, 4000)
    compiled = compile_network(machine, {"s3": s3}, period=5e-3)
    said = compiled.passes[1].remarks
    assert [r.split()[0] for r in said if "became logic" in r] == sorted(meant)
    assert len(meant) == 16
    rms = [np.sqrt(np.mean(f(n, s3)["e"] ** 2)) for f, n in ((float_error, machine), (fixed_error, compiled.program))]
    assert rms[1] < 1.05 * rms[0]


def test_the_stored_machine_is_at_or_below_the_thesis_on_every_scenario():
    scores = study.scores(entry("belt_drive").network())
    for label in ("overall", "minor"):
        assert all(a <= b for a, b in zip(scores[label], study.THESIS["fnn"][label], strict=True)), label


def test_legs_are_cut_where_the_encoder_turns():
    x = 1e-5 * np.array([0, 0, 1, 2, 2, 1, 0, 0, 1.0])
    assert study.legs(x) == [(0, 5, "forward"), (5, 8, "backward"), (8, 9, "forward")]


def test_an_experts_data_are_those_of_its_own_part_of_the_band():
    boundary = study.boundary_data("forward")
    assert boundary.targets["y"].max() < 0 < study.boundary_data("backward").targets["y"].min()
    jumps = study.play_data("backward").targets["y"] * E.scale
    assert 120e-6 < jumps.min() < np.mean(jumps) == pytest.approx(PLAY, rel=0.05)  # the play, and the belt's stretch
    assert np.ptp(jumps) < 40e-6
    assert set(EXPERTS) == {f"{part}_{way}" for part in study.NEURONS for way in study.DIRECTIONS}


def test_an_expert_with_a_memory_forgets_how_it_began_and_is_asked_when_settled(monkeypatch):
    monkeypatch.setattr(study, "RECURRENT_EPOCHS", 4)
    x = np.sin(np.linspace(0, 9, 300))
    expert = study.rnn("e", ("x",), Record({"x": x}, {"y": np.tanh(2 * x)}), 0)
    past = expert.parameters()["hidden1.hidden1_past"]
    assert 0 < np.abs(past).sum(axis=1).max() <= study.FADING
    held = np.full(200, 0.3)
    there, here = (expert.run({"x": held}, initial={"hidden1": value})["y"] for value in (-1.0, 1.0))
    assert abs(there[0] - here[0]) > 1e-3
    assert there[-1] == here[-1]
    assert study.answer(expert, x=held[:1])[0] == pytest.approx(here[-1], abs=1e-4)
