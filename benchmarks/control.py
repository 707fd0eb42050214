"""Position control in closed loop on the simulated machines.

    MACHINE        PI, predictive control and the network that imitates it (float, emulator, RTL) on three trajectories
                   that nothing was tuned or learnt on; undisturbed, with a disturbed load, with a supply that sags
    MACHINE_fixed  the network alone, in float, emulator and RTL, after its formats were changed
    drawn          a second of the cylinder's errors, for the picture of the page
    MACHINE_long   ten minutes of the network under a disturbed load, in RTL up to 200,000 steps, else in the emulator

A time is the median of a step on one core of this computer; hardware counts clocks.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from greygate.control.choices import JUDGED, Case, Method, Place
from greygate.control.loop import Run
from greygate.hardware.in_loop import Clocked, controller
from greygate.machines.catalog import CONTROLLED, task
from greygate.machines.control import Task

from .shared import say

TAKES = "hours"

SEEDS = tuple(range(JUDGED + 1, JUDGED + 4))
LONG, LONG_SEED = 600.0, JUDGED + 10  # s
AFFORDABLE = 200_000  # steps in hardware
SECOND = 2000, 3000  # samples
ROWS = (
    (Method.PI, Place.FLOAT),
    (Method.MPC, Place.FLOAT),
    (Method.NETWORK, Place.FLOAT),
    (Method.NETWORK, Place.EMULATOR),
    (Method.NETWORK, Place.RTL),
)


def pooled(runs: Sequence[Run], settle: int) -> dict:
    """Figures over the runs: RMS of all, the worst, sums and medians of the rest."""
    figures = [run.figures(settle) for run in runs]
    found = {
        "rms": float(np.sqrt(np.mean([f["rms"] ** 2 for f in figures]))),
        "worst": max(f["worst"] for f in figures),
        "effort": float(np.sqrt(np.mean([f["effort"] ** 2 for f in figures]))),
        "violations": sum(f["violations"] for f in figures),
        "microseconds": float(np.median([f["microseconds"] for f in figures])),
    }
    if "energy" in figures[0]:
        found["energy"] = float(np.mean([f["energy"] for f in figures]))
    return found


def bits(designs: Sequence[Clocked]) -> dict:
    return {
        d.program.name: {
            "steps": d.steps, "differing": d.differing, "compared": d.compared, "clocks": d.clocks / d.steps,
        }
        for d in designs
    }  # fmt: skip


def compared(name: str) -> dict:
    """Every controller in every case."""
    return {**_rows(name, ROWS), "pi": pi(task(name))}


def fixed(name: str) -> dict:
    """The imitating network alone."""
    return _rows(name, ROWS[2:])


def _rows(name: str, rows: Sequence[tuple[Method, Place]]) -> dict:
    asked, found, paths = task(name), {}, {}
    for method, place in rows:
        with controller(asked, method, place, say) as (made, designs):
            for case in Case:
                runs = [asked.run(made, case, seed) for seed in SEEDS]
                paths[place, case] = [run.signals[asked.tracked] for run in runs]
                row = pooled(runs, asked.settle)
                if method is Method.NETWORK and place is not Place.FLOAT:
                    both = zip(paths[place, case], paths[Place.FLOAT, case], strict=True)
                    row["apart"] = float(np.sqrt(np.mean(np.concatenate([a - b for a, b in both]) ** 2)))
                found.setdefault(f"{method}_{place}", {})[case] = row
                say(f"{name}, {method} in {place}, {case}: RMS {1e6 * row['rms']:.2f} µm")
            if designs:
                found["bits"] = bits(designs)
    return {"rows": found}


def pi(asked: Task) -> dict:
    tuned = asked.proportional()
    return {n: float(getattr(tuned, n)) for n in ("gain", "reset_rate", "forward", "lead")}


def long(name: str) -> dict:
    """Ten minutes, in hardware where that is affordable."""
    asked = task(name)
    samples = round(LONG / asked.period)
    place = Place.RTL if samples <= AFFORDABLE else Place.EMULATOR
    with controller(asked, Method.NETWORK, place, say) as (made, designs):
        run = asked.run(made, Case.LOAD, LONG_SEED, samples, say)
        minutes = np.array_split(run.error[asked.settle :], 10)
        rms = [float(np.sqrt(np.mean(part**2))) for part in minutes]
        return {"place": place, "samples": samples, "minutes": rms, **run.figures(asked.settle), "bits": bits(designs)}


def drawn() -> dict:
    """The cylinder's error, µm, of each controller, undisturbed and under its load, from the sample `start` on."""
    asked, (start, stop), found = task("valve_cylinder"), SECOND, {}
    for method, place in (ROWS[0], ROWS[1], ROWS[3]):
        with controller(asked, method, place, say) as (made, _):
            for case in (Case.NOMINAL, Case.LOAD):
                error = asked.run(made, case, JUDGED + 1, stop).error[start:]
                found.setdefault(case, {})[method] = [round(float(1e6 * e), 1) for e in error]
    return {"start": start, "period": asked.period, "errors": found}


PARTS = {"drawn": drawn}
for machine in CONTROLLED:
    PARTS[machine] = partial(compared, machine)
    PARTS[f"{machine}_fixed"] = partial(fixed, machine)
    PARTS[f"{machine}_long"] = partial(long, machine)
