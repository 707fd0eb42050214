"""Flow networks of the valve-controlled cylinder: parts of valve_cylinder.py.

architectures   the four networks of table 5.3 on the 9801 points of its grid, with its epochs
laps            networks of under- and overlapped valves in the place of the trained ones (5.4.3), each on rigs with
                such valves and v1's voltage
"""

from greygate.machines import catalog
from greygate.machines.valve_cylinder.plant import CYLINDER, valve_cylinder
from greygate.machines.valve_cylinder.scenarios import measure, scenario
from greygate.machines.valve_cylinder.study import FLOW_SEED, assemble, record
from greygate.models.accuracy import free_run_rms
from greygate.models.adaptation import adopt
from greygate.models.families.blocks import feedforward, fit_flow, flow_record
from greygate.models.network import Network
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

from .shared import say, stopwatch

BAR = 1e5
ARCHITECTURES = {"10": (10,), "30": (30,), "5 + 5": (5, 5), "10 + 10": (10, 10)}
EPOCHS = {"10": 1000, "30": 1000, "5 + 5": 1000, "10 + 10": 2500}
THESIS = {"10": 4.37e-7, "30": 5.22e-8, "5 + 5": 2.31e-7, "10 + 10": 8.52e-9}  # m^3/s, RMS in training
LAP = 0.05  # of the stroke
VALVES = {"zero-lapped": 0.0, "overlapped": LAP, "underlapped": -LAP}


def architectures() -> dict:
    """RMS in m^3/s of each network of table 5.3 in training, its seconds and epochs; one seed."""
    rated, grid, found = CYLINDER["q_max"].value, flow_record(), {}
    for name, hidden in ARCHITECTURES.items():
        watch = stopwatch()
        fit = train(feedforward("flow", ["u", "p"], hidden, FLOW_SEED), [grid], epochs=EPOCHS[name], decay=1e-7)
        found[name] = {
            "rms": rated * free_run_rms(fit.network, grid)["y"],
            "thesis": THESIS[name],
            "seconds": watch(),
            "epochs": len(fit.history) - 1,
        }
        say(name, found[name])
    return {"networks": found}


def swap_flow(network: Network, flow: Network) -> Network:
    """The SRNN with another valve's flow network in the place of both of its own (thesis 5.4.3)."""
    divider = feedforward("divider", ["omega", "gamma"], [20], 0)
    return adopt(assemble(flow, divider), network, ("pa.divider", "pb.divider", "speed_a", "speed_b"))


def rig(lap: float) -> Record:
    """v1's voltage on a valve with that lap of all four edges, as part of its stroke."""
    v_c = scenario("v1")["v_c"]
    plant = valve_cylinder()
    plant = plant.with_parameters(overlap=lap * plant.parameters["u_max"].value)
    return record(measure(plant, v_c, 0 * v_c))


def laps() -> dict:
    """RMS in bar, chambers A and B, of every network on every rig."""
    trained = catalog.entry("valve_cylinder").network()
    networks = {"as trained": trained}
    networks |= {name: swap_flow(trained, fit_flow(FLOW_SEED, lap=lap).network) for name, lap in VALVES.items()}
    rigs = {name: rig(lap) for name, lap in VALVES.items()}
    return {
        "networks": {
            label: {name: [v / BAR for v in free_run_rms(network, r).values()] for name, r in rigs.items()}
            for label, network in networks.items()
        }
    }
