"""The cable-drum sensor beside the thesis (chapter 7).

trips       slip of the round trips of figure 7.3
noe         table 7.3, five starts of each network
drawn       what networks 9 and 10 of table 7.3 leave in training, for the picture
starts      every size and seed that `greygate train cable_drum` chooses among, on every record
less_slip   the same on a rig whose guide wheels pull a fourth as hard
days        the kept network on the course of validation, with what differs on that day changed one by one
spread      the kept network on 20 days and courses drawn at random
"""

from collections.abc import Mapping

import numpy as np

from greygate.machines import catalog
from greygate.machines.cable_drum import plant as rig
from greygate.machines.cable_drum.study import (
    ARCHITECTURES,
    black_box,
    chosen,
    micrometres,
    record_of,
    records,
    recurrent,
    starts,
    with_angle,
)
from greygate.models.accuracy import float_error, rmse
from greygate.models.drawn import envelope
from greygate.models.network import Network
from greygate.models.training.levenberg import train
from greygate.plants.recording import Recording

from .shared import say
from .valve_cylinder import DRAWN, ranked

TAKES = "not timed"

JUDGED = ("training", "choice", "validation", "home")
LESS = 0.12  # N, of the guide wheels
STARTS = 5  # of a black box
BINS = 400  # of a curve


def trips() -> dict:
    """By speed in mm/s: mean slip of a trip and its deviation, there and back, and the sum after all; in um."""
    found = {}
    for speed in rig.SPEEDS:
        e = 1e6 * rig.record(f"trips_{round(1e3 * speed)}")["e_true"]
        turns = np.linspace(0, len(e) - round(1 / rig.SAMPLE_TIME), 2 * rig.ROUND_TRIPS + 1).astype(int)
        there, back = np.diff(e[turns])[::2], np.diff(e[turns])[1::2]
        found[f"{1e3 * speed:g}"] = {
            "mean": [float(np.mean(there)), float(np.mean(back))],
            "deviation": [float(np.std(there)), float(np.std(back))],
            "sum": float(e[-1]),
        }
    return {"um": found}


def noe() -> dict:
    """Training error in um of networks 1 to 9: 100 epochs one step ahead, then 10 in free run; every start."""
    training = black_box(records()["training"])
    found = []
    for taps, neurons in ARCHITECTURES:
        rows = []
        for seed in range(STARTS):
            ahead = train(recurrent(taps, neurons, seed), [training], epochs=100, teacher=True).network
            rows.append(1e6 * rmse(train(ahead, [training], epochs=10).network, training))
        found.append(rows)
        say(f"NOE {taps} taps, {neurons}: {rows}")
    return {"um": found}


def drawn() -> dict:
    """Figures 7.8 and 7.10: what networks 9 (10 epochs) and 10 (100 more, with the angle) leave in training, um."""
    training = black_box(records()["training"])
    ahead = train(recurrent(*ARCHITECTURES[-1]), [training], epochs=100, teacher=True).network
    ninth = train(ahead, [training], epochs=10).network
    tenth = train(with_angle(ninth), [training], epochs=100).network
    left = {name: 1e6 * float_error(network, training)["e"] for name, network in (("9", ninth), ("10", tenth))}
    bins = {name: envelope(error, BINS) for name, error in left.items()}
    return {
        "um": {
            n: {"step": [int(k) for k in b["step"]], "left": [round(v, 1) for v in b["value"]]} for n, b in bins.items()
        }
    }


def every_start(**values: float) -> dict:
    """RMS in um of each size and seed by record, and which one the record `choice` takes."""
    networks, scores = starts(say, **values)
    rows = [
        {"neurons": n, "seed": s} | {name: micrometres(net, name, **values) for name in JUDGED}
        for (n, s), net in networks.items()
    ]
    size, seed = chosen(scores)
    return {"rows": rows, "neurons": size, "seed": seed, "slip_mm": 1e3 * slipped(**values)}


def slipped(**values: float) -> float:
    """Error at the end of the training run, m."""
    return float(rig.record("training", **values)["e"][-1])


def less_slip() -> dict:
    return every_start(f_bias=LESS)


def both(network: Network, recording: Recording) -> list[float]:
    """RMS in um, without the beacon and with it."""
    return [1e6 * rmse(network, record_of(recording, beacon)) for beacon in (False, True)]


def days() -> dict:
    """RMS in um of the course of validation: on training's day, with one thing changed, and with all."""
    network, seed = catalog.entry("cable_drum").network(), rig.SEEDS["validation"]
    half = {name: (1 + factor) / 2 for name, factor in rig.ANOTHER_DAY.items()}
    changes: dict[str, Mapping[str, float]] = {"none": {}, "half": half, "all": rig.ANOTHER_DAY}
    changes |= {name: {name: factor} for name, factor in rig.ANOTHER_DAY.items()}
    found = {n: both(network, rig.validation(rig.another_day(rig.cable_drum(), c), seed)) for n, c in changes.items()}
    found["no_drift"] = both(network, rig.validation(rig.cable_drum(), seed, warmth=0.0))
    return {"um": found, "factors": rig.ANOTHER_DAY}


def spread() -> dict:
    """RMS in um of 20 courses on training's day, and on days that differ by as much as validation's, either way."""
    network, seeds = catalog.entry("cable_drum").network(), range(1000, 1000 + DRAWN)
    deviation = {name: abs(factor - 1) for name, factor in rig.ANOTHER_DAY.items()}

    def drawn(seed: int) -> dict[str, float]:
        rng = np.random.default_rng(seed)
        return {name: 1 + d * rng.standard_normal() for name, d in deviation.items()}

    plant = rig.cable_drum()
    same = [both(network, rig.validation(plant, seed)) for seed in seeds]
    other = [both(network, rig.validation(rig.another_day(plant, drawn(seed)), seed)) for seed in seeds]
    picked = [micrometres(network, name) for name in ("validation", "home")]
    return {"picked": picked, "same_day": ranked(same, picked) | {"each": same},
            "another_day": ranked(other, picked) | {"each": other}}  # fmt: skip


PARTS = {"starts": every_start} | {p.__name__: p for p in (trips, noe, drawn, less_slip, days, spread)}
