"""Models that nobody here made: `init-rig --model` and `simulate`, against MuJoCo's own steps.

MJCF and URDF from PyPI packages in $GREYGATE_ROBOTS (`pip install --target FOLDER --no-deps gymnasium dm-control
example-robot-data robosuite`). Of each a log of 10 s is made by MuJoCo's `mj_step`; the rig that `init-rig` writes
is simulated freely. In the table: the largest difference of a joint's position, over the range of its motion.
"""

import csv
import os
import time
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.mismatch.explain import predict
from greygate.mismatch.rig import load
from greygate.mismatch.starting_model import init_rig
from greygate.plants import mjcf

from .made import place, stamp
from .shared import scratch

TAKES = "two minutes"
SECONDS, DT = 10.0, 0.01
TONES = (0.3, 0.7, 1.1)  # Hz, of the controls
MODELS = {
    "gym-inverted-pendulum": "gymnasium/envs/mujoco/assets/inverted_pendulum.xml",
    "gym-inverted-double-pendulum": "gymnasium/envs/mujoco/assets/inverted_double_pendulum.xml",
    "gym-reacher": "gymnasium/envs/mujoco/assets/reacher.xml",
    "gym-hopper": "gymnasium/envs/mujoco/assets/hopper.xml",
    "dm-cartpole": "dm_control/suite/cartpole.xml",
    "dm-acrobot": "dm_control/suite/acrobot.xml",
    "dm-reacher": "dm_control/suite/reacher.xml",
    "dm-point-mass": "dm_control/suite/point_mass.xml",
    "robosuite-panda": "robosuite/models/assets/robots/panda/robot.xml",
    "robosuite-iiwa": "robosuite/models/assets/robots/iiwa/robot.xml",
    "robosuite-ur5e": "robosuite/models/assets/robots/ur5e/robot.xml",
    "robosuite-gripper": "robosuite/models/assets/grippers/panda_gripper.xml",
    "urdf-ur5": "cmeel.prefix/share/example-robot-data/robots/ur_description/urdf/ur5_robot.urdf",
    "urdf-panda": "cmeel.prefix/share/example-robot-data/robots/panda_description/urdf/panda.urdf",
    "urdf-xarm7": "cmeel.prefix/share/example-robot-data/robots/xarm_description/urdf/xarm7.urdf",
    "urdf-so101": "cmeel.prefix/share/example-robot-data/robots/so_arm_description/urdf/so101.urdf",
    "urdf-two-dof": "cmeel.prefix/share/example-robot-data/robots/asr_twodof_description/urdf/TwoDofs.urdf",
}


def packages() -> Path:
    given = os.environ.get("GREYGATE_ROBOTS")
    if not given or not Path(given).is_dir():
        raise InputError("outside-models: set GREYGATE_ROBOTS to a folder of the packages that its text names")
    return Path(given)


def tones(count: int, samples: int, sizes: np.ndarray, seed: int = 1) -> np.ndarray:
    """Inputs (samples, count) of three tones each."""
    t, random = np.arange(samples) * DT, np.random.default_rng(seed)
    parts = [np.sin(2 * np.pi * f * t[:, None] + random.uniform(0, 2 * np.pi, count)) for f in TONES]
    return sum(parts) / len(TONES) * sizes


def log(model, path: Path) -> np.ndarray:
    """log.csv of the model's motion under tones; the joints' positions (samples, joints).

    Where it has no actuator, torques act on the joints: a tenth of what lifts them in a second.
    """
    import mujoco

    data, samples = mujoco.MjData(model), round(SECONDS / DT)
    plant = mjcf.read(path, [])
    if model.nu:
        names = list(plant.inputs)
        ranges = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange[:, 1], 1.0)
        inputs = tones(model.nu, samples, 0.3 * np.minimum(ranges, 10.0))
    else:
        names = mjcf.forces(plant)
        inputs = tones(model.nv, samples, 0.1 / model.dof_invweight0)
    out, substeps = [], max(round(DT / model.opt.timestep), 1)
    model.opt.timestep = DT / substeps
    for row in inputs:
        out.append(data.qpos.copy())
        (data.ctrl if model.nu else data.qfrc_applied)[:] = row
        for _ in range(substeps):
            mujoco.mj_step(model, data)
    joints = [s for s, state in plant.states.items() if state.rate]
    table = np.column_stack([np.arange(samples) * DT, inputs, np.array(out)])
    np.savetxt("log.csv", table, "%.17g", ",", header=",".join(["t", *names, *joints]), comments="")
    return np.array(out)


def row(name: str, path: Path) -> dict:
    model = mjcf.load(path)
    moved = log(model, path)
    began = time.process_time()
    init_rig(Path("rig"), "log.csv", path, {})
    rig = load("rig")
    predict(Path("rig"), Path("rig/identify.csv"), None, Path("sim.csv"), [], None)
    found = np.genfromtxt("sim.csv", delimiter=",", names=True)
    off = max(
        float(np.abs(found[s] - moved[: len(found), j]).max() / np.ptp(moved[:, j]))
        for j, s in enumerate(s for s, state in rig.plant.states.items() if state.rate)
        if np.ptp(moved[:, j]) > 0
    )
    freed = len(rig.uncertain())
    return {
        "model": name, "joints": model.njnt, "inputs": len(rig.inputs), "window": rig.window or "free",
        "integrator": int(model.opt.integrator), "released": freed, "difference": f"{off:.2g}",
        "cpu_seconds": f"{time.process_time() - began:.1f}",
    }  # fmt: skip


def main() -> None:
    folder, rows = packages(), []
    for name, path in MODELS.items():
        with scratch() as work:
            os.chdir(work)
            rows.append(row(name, folder / path))
            print(rows[-1], flush=True)
            os.chdir("/")
    table = place("outside_models.csv")
    with table.open("w", newline="") as out:
        writer = csv.DictWriter(out, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    stamp(table)
