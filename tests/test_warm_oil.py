"""The cylinder with a worn piston and warm oil: what the oil does, and what the network makes of a thermometer."""

import json

import numpy as np
import pytest

from greygate.machines.catalog import entry
from greygate.machines.valve_cylinder.warm import (
    OIL,
    SCENARIOS,
    TRAINING,
    ZERO,
    assemble,
    errors,
    learnt,
    records,
    viscosity,
    warm_cylinder,
    without_thermometer,
)
from greygate.models.storage import TRAINED

KEPT = json.loads((TRAINED / "valve_cylinder_warm.json").read_text())


def test_oil_thins_and_softens_as_it_warms_and_a_thinner_one_leaks_more():
    assert viscosity(20) == pytest.approx(100e-6)
    assert viscosity(40) == pytest.approx(40e-6)
    assert 15e-6 < viscosity(60) < 25e-6  # mineral oil of that grade
    cold, warm = (warm_cylinder(t).parameters for t in (20, 60))
    thinner = viscosity(60) / viscosity(20)
    assert warm["bulk_modulus"].value == pytest.approx(0.84 * cold["bulk_modulus"].value)
    assert warm["c_internal"].value * thinner == pytest.approx(cold["c_internal"].value)
    assert warm["viscous"].value == pytest.approx(thinner * cold["viscous"].value)


def test_without_leakage_and_softness_the_network_is_that_of_chapter_5():
    plain, warm = assemble(warm=False), assemble()
    still = {n: 0 * v for n, v in warm.parameters().items() if n.startswith(("soft.", "leak."))}
    warm = warm.with_parameters(still | {"soft.out.bias": np.ones(1)})
    run = records()["oil_20"].cut(0, 500)
    known = plain.run(without_thermometer(run).inputs)
    for name, pressure in warm.run(run.inputs).items():
        np.testing.assert_allclose(pressure, known[name], rtol=1e-9)


def test_a_leakage_moves_both_chambers_towards_each_other():
    tight, leaking = (assemble().with_parameters({"leak.out.bias": np.array([c])}) for c in (0.0, 0.5))
    run = records()["oil_20"].cut(0, 500)
    apart = [np.mean(np.abs(a["p_a"] - a["p_b"])) for a in (n.run(run.inputs) for n in (tight, leaking))]
    assert apart[1] < 0.9 * apart[0]


def test_the_kept_network_gives_the_kept_figures_and_a_thermometer_gains_at_every_temperature():
    network = entry("valve_cylinder_warm").network()
    for name in SCENARIOS:
        assert errors(network, records()[name]) == pytest.approx(KEPT["warm"][name], rel=1e-6)
        for rival in ("blind", "cold"):
            assert np.all(np.array(KEPT["warm"][name]) < KEPT[rival][name])


def test_the_network_finds_that_warmer_oil_is_softer_and_leaks_more():
    for told in zip(*(found[0] for found in learnt(entry("valve_cylinder_warm").network()).values()), strict=True):
        assert np.all(np.diff(told) > 0)


def test_runs_of_validation_are_others_than_those_of_training_and_the_thermometer_reads_half_degrees():
    found = records()
    assert {*TRAINING, *SCENARIOS} == set(found)
    seen = {name: found[name].inputs["v_c"][:200].tobytes() for name in found}
    assert len(set(seen.values())) == len(found)
    for name, run in found.items():
        assert set(run.inputs[OIL.name]) == {ZERO + float(name.split("_")[1])}
