"""Under- and overlapped valves by swapping the flow networks (thesis 5.4.3): a table of docs/valve_cylinder.md.

python benchmarks/valve_laps.py : the trained SRNN and the same with other valves' flow networks, each on rigs with
zero lap, an overlapped and an underlapped valve, v1's voltage. RMS error in bar, chambers A / B.
"""

from greygate.machines import catalog
from greygate.machines.valve_cylinder.plant import valve_cylinder
from greygate.machines.valve_cylinder.scenarios import measure, scenario
from greygate.machines.valve_cylinder.study import FLOW_SEED, swap_flow
from greygate.models.accuracy import free_run_rms
from greygate.models.families.blocks import fit_flow
from greygate.models.training.record import Record

LAP = 0.05  # of the stroke
VALVES = {"zero-lapped": 0.0, "overlapped": LAP, "underlapped": -LAP}


def rig(lap: float) -> Record:
    """v1's voltage on a valve with that lap of all four edges, as part of its stroke."""
    v_c = scenario("v1")["v_c"]
    plant = valve_cylinder()
    plant = plant.with_parameters(overlap=lap * plant.parameters["u_max"].value)
    c = measure(plant, v_c, 0 * v_c).channels
    return Record({n: c[n] for n in ("v_c", "x")}, {n: c[n] for n in ("p_a", "p_b")})


if __name__ == "__main__":
    trained = catalog.entry("valve_cylinder").network()
    networks = {"as trained": trained}
    for name, lap in VALVES.items():
        networks[name] = swap_flow(trained, fit_flow(FLOW_SEED, lap=lap).network)
    rigs = {name: rig(lap) for name, lap in VALVES.items()}
    print("| flow network | " + " | ".join(f"{name} rig" for name in rigs) + " |\n| --- |" + " --- |" * len(rigs))
    for label, network in networks.items():
        cells = [
            " / ".join(f"{v / 1e5:.2f}" for v in free_run_rms(network, record).values()) for record in rigs.values()
        ]
        print(f"| {label} | " + " | ".join(cells) + " |", flush=True)
