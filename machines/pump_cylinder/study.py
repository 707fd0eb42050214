"""The SRNN of the pump-controlled cylinder: trained on the nominal plant, adapted to its simulated rig (thesis ch. 6).

No prediction uses a pressure sensor; only `sensor_backup` reads the other chamber's pressure, as the thesis had to.
"""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from greygate.machines.procedure import Procedure
from greygate.machines.pump_cylinder.network import leakage_bounds, pump_srnn
from greygate.machines.pump_cylinder.plant import RECORDS, SENSORS, pump_cylinder, record
from greygate.models.accuracy import free_run_rms, rms
from greygate.models.families.library import library
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import Trained, train
from greygate.models.training.record import Record
from greygate.progress import Progress, silent, titled

TRAINING = ("rig_training",)
SCENARIOS = ("rig_training", "rig_chirp", "rig_random", "rig_open")
THESIS = {  # RMS in Pa, chambers A and B
    "chirp": (0.0547e6, 0.0911e6),  # simulated plant (6.3.3)
    "sensor_training": (0.092e6, 0.116e6),  # the other chamber measured (table 6.4)
    "sensor_validation": (0.112e6, 0.195e6),  # the same (6.4); without a sensor it diverged
}
_COMPARED = {  # source -> scenario -> figure of `THESIS`; there is none for its rig without a sensor
    "thesis, simulated plant": {"rig_chirp": "chirp"},
    "thesis, with a sensor": {
        "rig_training": "sensor_training",
        "rig_chirp": "sensor_validation",
        "rig_random": "sensor_validation",
    },
}
REFERENCES = {
    source: {name: dict(zip(("p_a", "p_b"), THESIS[figure], strict=True)) for name, figure in scenarios.items()}
    for source, scenarios in _COMPARED.items()
}
Q_MAX, P_MAX = 3e-4, 2e7  # m^3/s, Pa; the networks' normalisation
X_SCALE = 5e-6 * 2**14  # m; a step of the sensor is an exact binary fraction
EPOCHS = 40


@lru_cache
def recording(name: str, known: str = "") -> Record:
    """Speeds `n_1`, `n_2` [rev/s] and position `x` [m] as sensors give them; targets: measured pressures [Pa].

    known: chamber whose sensor's reading is an input, `p_a_measured` or `p_b_measured`, and no target.
    """
    c = record(name).channels
    inputs = {n: c[n] for n in ("n_1", "n_2", "x")} | ({f"p_{known}_measured": c[f"p_{known}"]} if known else {})
    return Record(inputs, {f"p_{chamber}": c[f"p_{chamber}"] for chamber in "ab" if chamber != known})


def records() -> dict[str, Record]:
    """The rig's training record and its three validation scenarios."""
    return {name: recording(name) for name in SCENARIOS}


def assemble(known: str = "") -> Network:
    """The SRNN with the parameters of table 6.1, at rest at 12 MPa. known: as for `pump_srnn`."""
    plant = pump_cylinder()
    k = {symbol: p.value for symbol, p in plant.parameters.items()} | {"q_max": Q_MAX, "p_max": P_MAX}
    k |= {f"p_{c}_rest": plant.constant(plant.states[f"p_{c}"].initial) for c in "ab"}
    rest = plant.initial()
    n_1, n_2 = (Port(n, "rev/s", SENSORS[n][0], initial=rest[n], resolution=SENSORS[n][2]) for n in ("n_1", "n_2"))
    return pump_srnn(k, library("divider"), (n_1, n_2), Port("x", "m", X_SCALE, resolution=SENSORS["x"][2]), known)


def fit(network: Network, name: str, known: str = "", progress: Progress = silent) -> Trained:
    """Free-run training on one record, the leakage kept as `assemble` bounds it."""
    bounds = leakage_bounds(assemble(known))
    return train(network, [recording(name, known)], epochs=EPOCHS, bounds=bounds, progress=titled(progress, name))


def train_srnn(progress: Progress = silent) -> tuple[Network, dict]:
    """Train on the nominal plant, adapt on the rig's training record. Returns the network and its figures.

    Figures: RMS in Pa, chambers A and B, by step and record; `constant`: of the training record's mean pressures.
    """
    snn = Procedure({name: recording(name) for name in RECORDS})
    snn.join(assemble)
    snn.step("nominal", partial(fit, snn.network, "training", progress=progress))
    snn.step("adapted", partial(fit, snn.network, "rig_training", progress=progress))
    steps = ("joined", "nominal", "adapted")
    figures: dict = {name: {r: tuple(e.values()) for r, e in snn[name].errors.items()} for name in steps}
    figures |= {"constant": constant(), "sensor_backup": sensor_backup(progress), "thesis": THESIS}
    figures["noisy_position"] = noisy_position(snn["nominal"].network)
    figures["seconds"] = {name: snn[name].seconds for name in ("nominal", "adapted")}
    return snn.network, figures


def constant() -> dict[str, tuple[float, ...]]:
    """RMS in Pa of the simplest model: the mean pressures of the rig's training record."""
    mean = {p: v.mean() for p, v in recording("rig_training").targets.items()}
    return {name: tuple(rms(v - mean[p]) for p, v in recording(name).targets.items()) for name in SCENARIOS}


def sensor_backup(progress: Progress = silent) -> dict[str, tuple[float, ...]]:
    """RMS in Pa of `RNN P_A` and `RNN P_B`, each with the other chamber's sensor (figs. 6.5, 6.6, table 6.4)."""
    found: dict[str, tuple[float, ...]] = dict.fromkeys(SCENARIOS, ())
    for known in "ba":
        network = fit(assemble(known), "training", known, progress).network
        network = fit(network, "rig_training", known, progress).network
        for name in SCENARIOS:
            found[name] += tuple(free_run_rms(network, recording(name, known)).values())
    return found


def noisy_position(nominal: Network) -> dict[str, tuple[float, ...]]:
    """RMS in Pa of the adaptation repeated with five times the noise of position, by record."""

    def noisier(name: str) -> Record:
        r, (_, noise, _) = recording(name), SENSORS["x"]
        more = np.sqrt(24.0) * noise * np.random.default_rng(RECORDS[name][1] + 500).standard_normal(len(r))
        return replace(r, inputs={**r.inputs, "x": r.inputs["x"] + more})

    bounds = leakage_bounds(assemble())
    network = train(nominal, [noisier("rig_training")], epochs=EPOCHS, bounds=bounds).network
    return {name: tuple(free_run_rms(network, noisier(name)).values()) for name in SCENARIOS}
