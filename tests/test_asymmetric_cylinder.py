"""The second machine's SRNN: at or below the thesis on every scenario, standing still included."""

import json

import numpy as np
import pytest

from greygate.compiler.pipeline import compile_network
from greygate.machines.asymmetric_cylinder.study import (
    ADOPTED,
    CLOSED,
    SCENARIOS,
    THESIS,
    assemble,
    first_machine,
    fit,
    records,
)
from greygate.machines.catalog import entry
from greygate.machines.procedure import bar
from greygate.machines.source import Source
from greygate.models.accuracy import free_run_rms
from greygate.models.adaptation import adopt
from greygate.models.storage import TRAINED
from greygate.project import fixed_and_float


def adopted():
    return adopt(assemble(), first_machine(), ADOPTED)


def test_the_stored_network_is_at_or_below_the_thesis_on_every_scenario():
    network = entry("asymmetric_cylinder").network()
    found = bar({name: free_run_rms(network, records()[name]) for name in SCENARIOS})
    kept = json.loads((TRAINED / "asymmetric_cylinder.json").read_text())["trained"]
    for name in SCENARIOS:
        assert list(found[name]) == pytest.approx(kept[name], rel=1e-6)
        assert all(ours <= thesis for ours, thesis in zip(found[name], THESIS.get(name, (np.inf,) * 2), strict=True))


def test_a_closed_valve_lets_next_to_nothing_pass():
    def passes(network, name):
        return np.sqrt(np.mean(network.modules[name].run(dict(CLOSED.inputs))["y"] ** 2))

    network = entry("asymmetric_cylinder").network()
    for name in ("qa", "qb"):
        assert passes(network, name) < 0.1 * passes(adopted(), name)


def test_training_lowers_the_error_and_keeps_the_modules():
    start = adopted()
    found = fit(start, 1)
    assert found.history[-1] < found.history[0]
    assert found.network.modules.keys() == start.modules.keys()


@pytest.mark.parametrize("name", ["valve_cylinder", "asymmetric_cylinder"])
def test_sixteen_bits_cost_at_most_five_per_cent_on_every_scenario(name):
    source = Source(name, {})
    records = source.records()
    compiled = compile_network(source.network(), records, source.formats(), ranged_on=source.training)
    for record in records.values():
        for errors in fixed_and_float(compiled, record).values():
            assert errors["fixed"] <= 1.05 * errors["float"]
