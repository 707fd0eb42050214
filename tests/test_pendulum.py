"""The pendulum: a machine in one folder, from its plant to a network that knows gravity and learns friction."""

import json

import numpy as np
import pytest

from greygate.machines.catalog import entry
from greygate.machines.pendulum.study import pendulum, records
from greygate.models.accuracy import free_run_rms
from greygate.models.storage import TRAINED
from greygate.models.training.levenberg import train

KEPT = json.loads((TRAINED / "pendulum.json").read_text())


def test_the_kept_network_gives_the_kept_figures_and_swings_as_a_record_that_it_never_saw():
    network = entry("pendulum").network()
    found = {name: free_run_rms(network, record)["theta"] for name, record in records().items()}
    assert found == pytest.approx(KEPT["trained"], rel=1e-6)
    assert found["validation"] < 0.03 * np.std(records()["validation"].targets["theta"])


def test_few_epochs_in_free_run_find_most_of_the_friction():
    fit = train(pendulum(), [records()["training"]], epochs=10)
    trained = pendulum().with_parameters(fit.network.parameters())
    assert free_run_rms(trained, records()["validation"])["theta"] < 0.1 * KEPT["untrained"]["validation"]
