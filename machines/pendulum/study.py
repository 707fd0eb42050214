"""The pendulum: its simulated recordings, its structured network, and how that is trained.

    omega(k) = omega(k-1) + T/J (torque(k-1) - weight sin(theta(k-1)) - friction(omega(k-1)))
    theta(k) = theta(k-1) + T omega(k)

The known physics is built in: the two integrators, and gravity by the sine of the library. Training finds T/J and the
weight, which the data sheet gives roughly, and the unknown `friction`, a tanh network of the speed.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from greygate.models.accuracy import free_run_rms
from greygate.models.adaptation import frozen
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.plants.excitation import multisine
from greygate.plants.plant import Plant
from greygate.plants.simulator import simulate
from greygate.progress import Progress, silent

SAMPLE_TIME = 0.01  # s
SAMPLES = {"training": 4000, "validation": 2000}  # 40 s, 20 s
SEEDS = {"training": 1, "validation": 2}
LARGEST = 0.5  # N m, of the motor
BAND = (0.05, 3.0)  # Hz, of its torque: both sides of the resonance at 1.1 Hz
ENCODER = 2 * np.pi / 2**14  # rad per count
TORQUE = Port("torque", "N m", 1.0, resolution=2.0**-11)
ANGLE = Port("theta", "rad", np.pi, resolution=ENCODER)
FASTEST = 8.0  # rad/s, the scale of the speed
NEURONS, SEED, EPOCHS, DECAY = 4, 0, 150, 1e-8


def plant() -> Plant:
    return Plant.read(Path(__file__).with_name("pendulum.toml"))


@lru_cache
def records() -> dict[str, Record]:
    """Training and validation: `torque` [N m] and `theta` [rad] as converter and encoder give them."""
    found = {}
    for name, samples in SAMPLES.items():
        torque = multisine(samples, LARGEST, *BAND, SAMPLE_TIME, SEEDS[name])
        torque = TORQUE.resolution * np.round(torque / TORQUE.resolution)
        swung = simulate(plant(), {"torque": torque}, sample_time=SAMPLE_TIME, step=1e-3)
        found[name] = Record({"torque": torque}, {"theta": ENCODER * np.round(swung["theta"] / ENCODER)})
    return found


def pendulum(seed: int = SEED) -> Network:
    """The network with the data sheet's values; `friction` begins as `seed` draws it.

    Input `torque` [N m], output `theta` [rad].
    """
    k = {symbol: parameter.value for symbol, parameter in plant().parameters.items()}
    gain = SAMPLE_TIME / k["inertia"] / FASTEST  # of a torque in N m, on the normalised speed
    network = Network("pendulum", [TORQUE], [ANGLE], dt=SAMPLE_TIME)
    network.add("sine", frozen(library("sine")))
    network.add("friction", feedforward("friction", ["omega"], [NEURONS], seed))
    terms = {"before": 1.0, "torque": gain * TORQUE.scale, "weight": -gain * k["weight"], "friction": -gain * LARGEST}
    network.add("speed", Layer({n: [[w]] for n, w in terms.items()}, [0.0], frozen={"before", "friction", "bias"}))
    step = SAMPLE_TIME * FASTEST / ANGLE.scale
    network.add("angle", Layer({"before": [[1.0]], "speed": [[step]]}, [0.0], frozen={"before", "speed", "bias"}))
    network.connect("angle", "sine.x", delay=1, gain=ANGLE.scale)
    network.connect("speed", "friction.omega", delay=1)
    network.connect("speed", "speed.before", delay=1)
    network.connect("torque", "speed.torque", delay=1)
    network.connect("sine", "speed.weight")
    network.connect("friction", "speed.friction")
    network.connect("angle", "angle.before", delay=1)
    network.connect("speed", "angle.speed")
    network.connect("angle", "theta")
    return network.check()


def train_pendulum(progress: Progress = silent) -> tuple[Network, dict]:
    """Free-run training on the training record. Returns the network and its figures: RMS errors in rad, seconds."""
    network = pendulum()
    progress(f"{EPOCHS} epochs in free run")
    fit = train(network, [records()["training"]], epochs=EPOCHS, decay=DECAY)
    trained = network.with_parameters(fit.network.parameters())
    figures = {
        "untrained": {name: free_run_rms(network, record)["theta"] for name, record in records().items()},
        "trained": {name: free_run_rms(trained, record)["theta"] for name, record in records().items()},
        "neurons": NEURONS,
        "seconds": round(fit.seconds, 1),
        "outcome": fit.outcome.value,
    }
    return trained, figures
