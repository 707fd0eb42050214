"""The valve-controlled cylinder with a worn piston and oil at any temperature (thesis 8.2, no. 4).

The rig is that of chapter 5, where the oil is at 20 degC, with what its temperature changes: the viscosity, and with it
the leakage past the piston (5.4), the friction of the cylinder, the leakage of the pump and the damping of the line;
and the bulk modulus. The network is the SRNN with two terms more, both fed by the temperature:

    P_A(k) = P_A(k-1) + G2 divider( G1 q_a - v - l,  s (1 + gamma) - 1)      l = c (P_A(k-1) - P_B(k-1))
    P_B(k) = P_B(k-1) + G2 divider(-G1 q_b + v + l,  s (1 - gamma) - 1)

So the chambers are coupled: the outputs feed each other. s(T), the compressibility of the oil over the nominal one, and
c(T), the leakage, are tanh networks of the temperature.
"""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from greygate.machines.entry import BAR
from greygate.machines.valve_cylinder.line import Line
from greygate.machines.valve_cylinder.network import driven_spool, valve_srnn
from greygate.machines.valve_cylinder.plant import spool_discrete, valve_cylinder
from greygate.machines.valve_cylinder.scenarios import HOLD, LEVEL, measure
from greygate.machines.valve_cylinder.study import nominal, record, tuning
from greygate.models.accuracy import free_run_rms
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import library
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.plants.excitation import prms
from greygate.plants.plant import Plant
from greygate.plants.recording import Recording
from greygate.progress import Progress, silent, titled

ZERO = 273.15  # K
WALTHER = {20.0: 100e-6, 40.0: 40e-6}  # degC -> m^2/s; the thesis's oil has 100 mm^2/s at 20 degC
SOFTER = 0.004  # 1/K, loss of bulk modulus
BORE, CLEARANCE, LENGTH = 0.04, 25e-6, 0.03  # m, of the piston (5.4): worn
OIL = Port("t_oil", "K", 20.0, offset=ZERO + 40.0, resolution=0.5)
SAMPLES = 3_000
RUNS = {"training": (0, (20, 30, 40, 50, 60)), "oil": (10, (20, 25, 35, 45, 55, 60))}  # first seed, degC
NEURONS = 3
SIZE = 0.1  # of the leakage, over q_max at a pressure difference p_s


def viscosity(celsius: float) -> float:
    """Kinematic, m^2/s: Walther's equation (ASTM D341) through `WALTHER`."""
    known = {math.log(ZERO + t): math.log(math.log(1e6 * nu + 0.7)) for t, nu in WALTHER.items()}
    line = np.polyfit(list(known), list(known.values()), 1)
    return 1e-6 * (math.exp(math.exp(np.polyval(line, math.log(ZERO + celsius)))) - 0.7)


def warm_cylinder(celsius: float, clearance: float = CLEARANCE) -> Plant:
    """The plant of chapter 5 with oil of that temperature. clearance: m, of the piston."""
    cold = {symbol: p.value for symbol, p in valve_cylinder().parameters.items()}
    nu = viscosity(celsius)
    thinner = nu / viscosity(20.0)
    mu = nu * cold["density"]
    return valve_cylinder(
        bulk_modulus=cold["bulk_modulus"] * (1 - SOFTER * (celsius - 20.0)),
        c_internal=math.pi * BORE * clearance**3 / (12 * mu * LENGTH),
        c_pump=cold["c_pump"] / thinner,
        viscous=cold["viscous"] * thinner,
        line_damping=Line(viscosity=nu).damping,
    )


@lru_cache
def recording(celsius: float, seed: int) -> Recording:
    """The rig at that temperature under the PRMS of that seed."""
    v_c = prms(SAMPLES, -LEVEL, LEVEL, HOLD, seed)
    return measure(warm_cylinder(celsius), v_c, np.zeros(SAMPLES))


def run(celsius: float, seed: int) -> Record:
    """Inputs `v_c` [V], `x` [m], `t_oil` [K] by a thermometer of half a degree; targets `p_a`, `p_b` [Pa]."""
    found = record(recording(celsius, seed))
    read = OIL.offset + OIL.resolution * round((ZERO + celsius - OIL.offset) / OIL.resolution)
    return replace(found, inputs={**found.inputs, OIL.name: np.full(SAMPLES, read)})


@lru_cache
def records() -> dict[str, Record]:
    """`training_20` to `_60`, and `oil_20` to `oil_60` by degC: of other seeds, most of other temperatures."""
    return {
        f"{name}_{celsius}": run(celsius, first + n)
        for name, (first, temperatures) in RUNS.items()
        for n, celsius in enumerate(temperatures)
    }


TRAINING = tuple(f"training_{t}" for t in RUNS["training"][1])
SCENARIOS = tuple(f"oil_{t}" for t in RUNS["oil"][1])


def assemble(seed: int = 0, warm: bool = True) -> Network:
    """The network before its training, with the parameters of oil at 20 degC. warm: with the two terms of this file."""
    k = nominal(recording(RUNS["training"][1][0], RUNS["training"][0]))
    spool = driven_spool(*spool_discrete(valve_cylinder()), k["u_max"])
    oil = (OIL, small("soft", seed, 1.0), small("leak", seed, SIZE)) if warm else None
    return valve_srnn(k, library("flow"), library("divider"), spool, oil=oil)


def small(name: str, seed: int, level: float) -> Network:
    """A network of the temperature that begins near `level`."""
    network = feedforward(name, ["t"], [NEURONS], seed)
    out = network.parameters()["out.hidden1"]
    return network.with_parameters({"out.hidden1": 0.1 * level * out, "out.bias": np.array([level])})


def train_warm(progress: Progress = silent) -> tuple[Network, dict]:
    """Train on five temperatures, and two rivals without a thermometer; return the network and RMS in bar of each.

    cold: trained on five runs at 20 degC. blind: on the runs of the network itself.
    """
    same = [records()[name] for name in TRAINING]
    cold = [run(RUNS["training"][1][0], RUNS["training"][0] + n) for n in range(len(same))]
    tasks = {"warm": (True, same), "blind": (False, same), "cold": (False, cold)}
    networks, seconds = {}, {}
    for name, (warm, runs) in tasks.items():
        given = runs if warm else [without_thermometer(r) for r in runs]
        fitted = train(assemble(warm=warm), given, **tuning(), progress=titled(progress, name))
        networks[name], seconds[name] = fitted.network, fitted.seconds
    figures = {name: {n: errors(network, r) for n, r in records().items()} for name, network in networks.items()}
    return networks["warm"], figures | {"learnt": learnt(networks["warm"]), "seconds": seconds}


def learnt(network: Network) -> dict[str, list[list[float]]]:
    """By degC, of the network and of the rig: compressibility over that at 20 degC, and leakage in m^3/(Pa s)."""
    flat = network.flatten().parameters()
    plants = {t: warm_cylinder(t).parameters for t in RUNS["training"][1]}
    cold, supply = plants[20], float(network.outputs[0].scale)
    found = {}
    for t, plant in plants.items():
        told = []
        for name in ("soft", "leak"):
            module = small(name, 0, 1.0)
            module = module.with_parameters({n: flat[f"{name}.{n}"] for n in module.parameters()})
            at = OIL.normalised(np.full((1, 1), ZERO + t))
            told.append(float(module.run({"t": at})["y"][0, 0]))
        told[1] *= plant["q_max"].value / supply
        true = [cold["bulk_modulus"].value / plant["bulk_modulus"].value, plant["c_internal"].value]
        found[str(t)] = [told, true]
    return found


def without_thermometer(run: Record) -> Record:
    return replace(run, inputs={n: v for n, v in run.inputs.items() if n != OIL.name})


def errors(network: Network, run: Record) -> list[float]:
    """RMS in bar, chambers A and B."""
    read = {port.name for port in network.inputs}
    given = run if OIL.name in read else without_thermometer(run)
    return [value / BAR for value in free_run_rms(network, given).values()]
