"""The first machine's SRNN adapted to another machine (thesis 5.4.3), on its simulated rig.

The weights are those of the first machine; G1, G2 and the other normalisations follow from the data sheets of the
second one. From one record, the network learns how the rig differs (`machines/asymmetric_cylinder/plant.py`).
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from greygate.machines.asymmetric_cylinder.plant import CONVERTER, SENSORS, asymmetric_cylinder, record
from greygate.machines.procedure import Procedure, bar
from greygate.machines.valve_cylinder.network import measured_spool, valve_srnn
from greygate.models.adaptation import adopt
from greygate.models.families.blocks import feedforward
from greygate.models.network import Network, Port
from greygate.models.storage import TRAINED
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.progress import Progress, silent

SCENARIOS = ("training", "v3", "v4", "v5", "v6")
THESIS = {  # RMS in bar, chambers A and B (table 5.7, section 5.4.4)
    "adopted": (18.980, 22.064),
    "training": (1.232, 1.720),
    "v4": (1.76, 3.61),
    "v5": (1.66, 5.48),
    "v6": (2.646, 3.496),
}
THESIS_MINUTES, THESIS_EPOCHS = 835, 10
ADOPTED = ("qa", "qb", "pa.divider", "pb.divider")
STRETCH = 4.0
EPOCHS = 50
CLOSED = Record({"u": np.zeros(99), "p": np.linspace(0.01, 0.99, 99)}, {"y": np.zeros(99)}, weight=1e6)
"""A closed valve lets nothing pass, at any pressure: at rest a millionth of the nominal flow is 0.03 bar a second."""


@lru_cache
def records() -> dict[str, Record]:
    """Training and v3 to v6: spool `u` [V], `x` [m]; pressures [Pa]; all of them after sensors and filters."""
    found = {}
    for name in SCENARIOS:
        c = record(name).channels
        found[name] = Record({n: c[n] for n in ("u", "x")}, {n: c[n] for n in ("p_a", "p_b")})
    return found


def assemble(seed: int = 0) -> Network:
    """The SRNN with the second machine's nominal parameters, its flow and divider networks with weights from `seed`."""
    k = {symbol: p.value for symbol, p in asymmetric_cylinder().parameters.items()}
    training = record("training").channels
    k |= {"p_s": float(np.mean(training["p_s"]))} | {f"{p}_rest": float(training[p][0]) for p in ("p_a", "p_b")}
    spool, position = (
        Port(name, unit, SENSORS[name][0], resolution=SENSORS[name][0] * CONVERTER)
        for name, unit in (("u", "V"), ("x", "m"))
    )
    flow = feedforward("flow", ["u", "p"], [10, 10], seed)
    divider = feedforward("divider", ["omega", "gamma"], [20], seed)
    return valve_srnn(k, flow, divider, measured_spool(), spool, position, stretch=STRETCH)


def first_machine() -> Network:
    """The trained SRNN of the first machine."""
    return Network.load(TRAINED / "valve_cylinder")


def fit(network: Network, epochs: int, progress: Progress = silent) -> Trained:
    """Free-run training on the 50,001 samples, which also rehearses `CLOSED` in both flow networks; modules stay.

    Of the weights 0, 1e5, 1e6 and 1e7 for `CLOSED`, 1e6 and 1e5 gave the least error on the record `choice`.
    """
    closed = {"qa": CLOSED, "qb": CLOSED}
    found = train(network, [records()["training"]], epochs=epochs, decay=1e-6, rehearse=closed, progress=progress)
    return replace(found, network=network.with_parameters(found.network.parameters()))


def adapt(progress: Progress = silent) -> tuple[Network, dict]:
    """Adopt the weights and train for the thesis's 10 epochs, then on to `EPOCHS`; return the network and its figures.

    Figures: RMS in bar by step and scenario, seconds.
    """
    snn = Procedure(records())
    snn.join(adopt(assemble(), first_machine(), ADOPTED))
    first = f"{THESIS_EPOCHS} epochs"
    snn.step(first, lambda: fit(snn.network, THESIS_EPOCHS, progress))
    snn.step("trained", lambda: fit(snn.network, EPOCHS - THESIS_EPOCHS, progress))
    names = {"adopted": "joined", first: first, "trained": "trained"}
    return snn.network, {
        **{label: bar(snn[name].errors) for label, name in names.items()},
        "thesis": THESIS,
        "seconds": {label: snn[name].seconds for label, name in names.items() if name != "joined"},
        "thesis_minutes": THESIS_MINUTES,
    }
