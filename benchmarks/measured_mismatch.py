"""Diagnoses of the measured recordings of `recordings/rigs`.

identify.csv and holdout.csv are made from the published recordings (`recordings/NAME`, $GREYGATE_RECORDINGS or
../shared/recordings) in a temporary folder, then diagnosed. Every diagnosis is kept in results/measured_mismatch, the
table of all in results/measured_mismatch.csv.
"""

import csv
import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.ndimage import uniform_filter1d

from greygate.identify.study import ROOT, find
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.rig import load

from .made import place, stamp
from .shared import scratch

TAKES = "ten minutes"
RIGS = ROOT / "recordings" / "rigs"

Columns = dict[str, np.ndarray]


def read(folder: str, name: str) -> Columns:
    with (find(folder, "its SOURCE.md") / name).open(newline="") as file:
        header, *rows = list(csv.reader(file))
    table = np.array(rows, dtype=float)
    return {column: table[:, i] for i, column in enumerate(header)}


def thinned(columns: Columns, every: int, held: tuple[str, ...] = ()) -> Columns:
    """Every `every`-th sample; inputs in `held` are averaged over the time until the next."""
    n = len(next(iter(columns.values()))) // every * every
    return {
        name: c[:n].reshape(-1, every).mean(axis=1) if name in held else c[:n:every].copy()
        for name, c in columns.items()
    }


def emps() -> tuple[Columns, Columns]:
    runs = (read("emps", name) for name in ("emps_train.csv", "emps_test_pulses.csv"))
    return tuple(thinned({"force": r["force_N"], "x": r["q_meas_m"]}, 10, ("force",)) for r in runs)


def tanks() -> tuple[Columns, Columns]:
    r = read("cascaded-tanks", "cascaded_tanks.csv")
    return tuple({"u": r[f"u_{which}_V"], "y": r[f"y_{which}_V"]} for which in ("train", "test"))


def ced() -> tuple[Columns, Columns]:
    """The first binary run: its first half, and all of it, of which the second half counts."""
    r = read("ced", "ced_prbs.csv")
    whole = {"u": r["u1_V"], "z": r["z1_ticks_per_s"]}
    return {name: c[:250] for name, c in whole.items()}, whole


def ced_uniform() -> tuple[Columns, Columns]:
    """The high uniform run: its first 300 samples, and all of it, of which the rest counts."""
    r = read("ced", "ced_unif.csv")
    whole = {"u": r["u12_V"], "z": r["z12_ticks_per_s"]}
    return {name: c[:300] for name, c in whole.items()}, whole


def crane() -> tuple[Columns, Columns]:
    """The first half, and all, of which the second half counts."""
    r = read("hydraulic-actuator-crane", "actuator.csv")
    whole = {"u": r["u_valve"], "p": r["p_oil"]}
    return {name: c[:512] for name, c in whole.items()}, whole


def mts() -> tuple[Columns, Columns]:
    names = {"x_cmd": "x_cmd_m", "force": "force_N", "x": "x_meas_m"}
    runs = (read("servohydraulic-mts", f"mts_chirp_{load}.csv") for load in ("0A", "1A"))
    return tuple(thinned({n: r[c] for n, c in names.items()}, 10, ("x_cmd", "force")) for r in runs)


def kuka(axis: int) -> tuple[Columns, Columns]:
    """Trajectories A and B, one after the other, without a step of the motor between them; C.

    The torque is its mean over 0.1 s: what the current controller does faster, the gear's spring does not pass on.
    """
    runs = {}
    for name in "ABC":
        r = read("kuka-kr300-dual-encoder", f"traj_{name}.csv")
        torque = uniform_filter1d(r[f"tau{axis}_motor_Nm"], 25)
        runs[name] = {"motor": r[f"q{axis}_motor_enc_rad"], "torque": torque, "link": r[f"q{axis}_link_enc_rad"]}
    step = runs["B"]["motor"][0] - runs["A"]["motor"][-1]
    for name in ("motor", "link"):
        runs["B"][name] = runs["B"][name] - step
    return {n: np.concatenate((c, runs["B"][n])) for n, c in runs["A"].items()}, runs["C"]


def davinci() -> tuple[Columns, Columns]:
    names = {"drum": "be_angle_rad", "torque": "be_torque_Nm", "load": "fe_torque_Nm", "jaw": "fe_angle_rad"}
    runs = (read("davinci-cable-tool", f"L2_{name}.csv") for name in ("11", "12"))
    return tuple(thinned({n: r[c] for n, c in names.items()}, 10) for r in runs)


def dfki() -> dict[str, Columns]:
    """Four runs as they were recorded, at instants that vary."""
    names = {"t": "time", "tau1": "tau_meas1", "tau2": "tau_meas2", "q1": "pos_meas1", "q2": "pos_meas2"}
    runs = {n: read("dfki-double-pendulum", f"C0_sysid_{n}.csv") for n in ("00", "01", "03", "05")}
    return {f"run{n}": {name: r[column] for name, column in names.items()} for n, r in runs.items()}


def bam(high: int = 400) -> dict[str, Columns]:
    """Runs of one servo at four gains, as they were recorded, at instants that vary; a kind of motion is held out.

    high: the gain of half of those that are to be explained.
    """
    names = {"t": "t_s", "goal": "goal_rad", "supply": "u_V", "on": "torque_on", "q": "q_rad"}
    kinds = {"sine": "sin_sin", "square": "sin_time_square", "updown": "up_and_down"}
    folder, runs = find("bam-servo-pendulum", "its SOURCE.md"), {}
    for short, gain in (*((s, g) for s in ("sine", "square") for g in (100, high)), ("updown", 200), ("updown", 800)):
        (path,) = folder.glob(f"xl330_{kinds[short]}_m0.49_kp{gain}_*.csv")
        r = read("bam-servo-pendulum", path.name)
        runs[f"{short}_{gain}"] = {name: r[column] for name, column in names.items()}
    return runs


MAKERS: dict[str, Callable[[], tuple[Columns, Columns] | dict[str, Columns]]] = {
    "emps": emps,
    "ced": ced,
    "ced-uniform": ced_uniform,
    "tanks": tanks,
    "mts": mts,
    **{f"kuka-{axis}": partial(kuka, axis) for axis in (1, 2, 3)},
    "davinci": davinci,
    "crane": crane,
    "dfki": dfki,
    "dfki-mjcf": dfki,
    "bam": bam,
    "bam-mjcf": bam,
}


def make(name: str, folder: Path) -> Path:
    """The rig `name` in `folder`, with its recordings."""
    shutil.copytree(RIGS / name, folder, dirs_exist_ok=True)
    return record(folder, MAKERS[name]())


def record(folder: Path, made: tuple[Columns, Columns] | dict[str, Columns]) -> Path:
    """Write the recordings of a rig."""
    rig = load(folder)
    runs = made if isinstance(made, dict) else dict(zip(("identify", "holdout"), made, strict=True))
    for run, columns in runs.items():
        count = len(next(iter(columns.values())))
        columns = {"t": np.arange(count) * rig.dt, **columns}  # the recorded instants, where there are any
        with (folder / f"{run}.csv").open("w", newline="") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows([f"{v:.9g}" for v in row] for row in zip(*columns.values(), strict=True))
    return folder


def rows(name: str, said: dict) -> list[dict]:
    """Lines of the table, one for each predicted channel of a rig."""
    return [row(name, said, channel) for channel in said["fit"]["holdout"]]


def row(name: str, said: dict, channel: str) -> dict:
    held, own = (said["fit"][part][channel] for part in ("holdout", "identify"))
    kinds = ("simulation", "calibrated", "corrected")
    return {
        "rig": name,
        "verdict": said["verdict"],
        "effects": " + ".join(e.get("form", e["id"]) for e in said["effects"]),
        "channel": channel,
        "unit": held["unit"],
        **{f"identify_{kind}": f"{own[kind]:.5g}" for kind in kinds},
        **{f"holdout_{kind}": f"{held[kind]:.5g}" for kind in kinds},
        "seconds": f"{said['seconds']:.0f}",
    }


def main(*names: Annotated[str, MAKERS]) -> None:
    found, table = place("measured_mismatch"), place("measured_mismatch.csv")
    found.mkdir(exist_ok=True)
    for name in names or MAKERS:
        with scratch() as folder:
            said = diagnose(load(make(name, folder / name)))
        said.write(found / f"{name}.json")
        print(*rows(name, said.as_dict()), sep="\n", flush=True)
    kept = {name: found / f"{name}.json" for name in MAKERS}
    lines = [line for name, path in kept.items() if path.exists() for line in rows(name, json.loads(path.read_text()))]
    with table.open("w", newline="") as out:
        writer = csv.DictWriter(out, lines[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)
    for path in (found, table):
        stamp(path)
