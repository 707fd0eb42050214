"""Effects concealed in models that nobody here made, which `init-rig --model` and `diagnose` are to name.

MJCF and URDF of 1 to 7 joints from the packages of `outside_models`. What is concealed is written here, in a loop of
MuJoCo's own steps ten times a sample: friction, play and compliance of a gear, delay of a command, a payload, a motor
constant, an encoder's zero, ripple of a motor; a third of the cases conceals nothing, or parameters within their
tolerances. Joints follow tones under a controller that knows the nominal model; the log has commands and encoders. A
line a case goes to results/outside_concealed.csv (an interrupted run goes on from there), the table to its .txt.
"""

import csv
import json
import re
import resource
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from .made import place, stamp
from .outside_models import packages
from .shared import GREYGATE, scratch, stopwatch

TAKES = "two hours"
DT, FINER, SECONDS = 0.005, 10, 10.0  # s of a sample, steps in it, s of a log
BEFORE, REST, RAMP = 1.0, 0.25, 1.0  # s: at rest before a log begins, in it, and until the tones are whole
QUICK, ROTOR = 12.0, 0.05  # rad/s of a controller; share of a joint's inertia that the motor of a gear has
SIGMA = 3e-4  # of an encoder's range: the RMS of its noise
SURE = 0.95  # a claim with this confidence is one that a reader takes for certain
STRONG = 2.0  # times the error of the nominal model without the effect, that it has with a strong one
ROBOTS = "cmeel.prefix/share/example-robot-data/robots"
MODELS = {
    "dm-pendulum": ("dm_control/suite/pendulum.xml", {"hinge": np.pi}),
    "dm-cartpole": ("dm_control/suite/cartpole.xml", {"hinge_1": np.pi}),
    "robosuite-panda": ("robosuite/models/assets/robots/panda/robot.xml", {}),
    "dm-acrobot": ("dm_control/suite/acrobot.xml", {"shoulder": np.pi}),
    "urdf-ur5": (f"{ROBOTS}/ur_description/urdf/ur5_robot.urdf", {}),
    "dm-reacher": ("dm_control/suite/reacher.xml", {}),
    "robosuite-iiwa": ("robosuite/models/assets/robots/iiwa/robot.xml", {}),
    "urdf-two-dof": (f"{ROBOTS}/asr_twodof_description/urdf/TwoDofs.urdf", {}),
    "robosuite-ur5e": ("robosuite/models/assets/robots/ur5e/robot.xml", {}),
    "robosuite-kinova3": ("robosuite/models/assets/robots/kinova3/robot.xml", {}),
}
"""Name -> file in the packages, and where a joint begins that does not begin in the middle of its range."""
KINDS = ("friction", "delay", "clean", "play", "payload", "parameter", "compliance", "motor_constant", "clean",
         "encoder_zero", "ripple", "parameter")  # fmt: skip
CONDITIONS = ("told", "white", "steps")
NAMES = {
    "friction": ("dry_friction", "frictionloss", "load_friction"), "delay": ("input_delay",),
    "payload": ("mass", "ipos", "payload"),
    "play": ("gear_play", "sensor_play"), "compliance": ("gear_compliance",), "ripple": ("ripple",),
    "motor_constant": ("gain", "input_gain"), "encoder_zero": ("sensor_offset",),
}  # fmt: skip
"""What is concealed -> beginnings of names that say so."""
FIELDS = ("case", "model", "joints", "kind", "condition", "at", "size", "strength", "verdict", "named", "wrong", "sure",
          "parameters", "right", "placed", "nominal", "truth", "removed", "seconds", "cpu")  # fmt: skip


@dataclass
class Case:
    """What is drawn. joint: the number of the one that has the effect."""

    number: int
    name: str
    kind: str
    condition: str
    random: np.random.Generator
    joint: int = 0
    size: float = 0.0
    phase: float = 0.0
    more: dict = field(default_factory=dict)


class Machine:
    """A model with what is concealed in it, and its controller."""

    def __init__(self, path: Path, begins: dict[str, float]):
        import mujoco

        from greygate.plants import mjcf

        mujoco.set_mju_user_warning(lambda text: None)  # else it writes MUJOCO_LOG.TXT where one stands
        self.mujoco, self.nominal, self.plant = mujoco, mjcf.load(path), mjcf.read(path, [])
        model = self.nominal
        self.joints = [s for s, state in self.plant.states.items() if state.rate]
        middle = np.where(model.jnt_limited, model.jnt_range.mean(axis=1), model.qpos0)
        self.begin = np.array([begins.get(s, middle[j]) for j, s in enumerate(self.joints)])
        data = mujoco.MjData(model)
        data.qpos[:] = self.begin
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        self.inertia = np.diag(mass).copy()
        self.driven = [int(model.actuator_trnid[a, 0]) for a in range(model.nu)] or [*range(model.nv)]
        self.gain = model.actuator_gear[:, 0] * model.actuator_gainprm[:, 0] if model.nu else np.ones(model.nv)
        self.inputs = [*self.plant.inputs] if model.nu else [f"torque_{j}" for j in self.joints]

    def reference(self, random: np.random.Generator, samples: int) -> np.ndarray:
        """Where each joint should be (samples, joints): three tones, from rest on, `BEFORE` the log."""
        samples += round(BEFORE / DT)
        t = np.arange(samples)[:, None] * DT
        reach = np.where(self.nominal.jnt_type == int(self.mujoco.mjtJoint.mjJNT_SLIDE), 0.15, 0.5)
        span = np.where(self.nominal.jnt_limited, np.ptp(self.nominal.jnt_range, axis=1), np.inf)
        reach = np.minimum(reach, span / 4) * random.uniform(0.7, 1.0, len(self.joints))
        tones = [np.sin(2 * np.pi * f * t + random.uniform(0, 2 * np.pi, len(self.joints)))
                 for f in random.uniform((0.1, 0.3, 0.7), (0.3, 0.7, 1.2))]  # fmt: skip
        begun = np.clip((t - BEFORE - REST) / RAMP, 0.0, 1.0)
        return self.begin + reach * sum(tones) / 2.0 * begun**2 * (3.0 - 2.0 * begun)

    def run(self, case: Case, wanted: np.ndarray, acts: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Commands (samples, inputs), encoders (samples, joints), and positions and velocities (samples, 2 joints).

        acts: whether what is concealed does.
        """
        mujoco, model = self.mujoco, self.nominal.__copy__()
        for name, index, value in case.more.get("parameters", ()):
            getattr(model, name)[index] *= value
        kind, j = case.kind if acts else "clean", case.joint
        if kind == "payload":
            _load(model, mujoco, case)
        if kind == "motor_constant" and model.nu:  # what is beyond the limit of its control is clipped before
            model.actuator_gainprm[self.driven.index(j), 0] *= 1.0 + case.size
        if kind == "friction" and case.phase > np.pi:
            model.dof_frictionloss[j] += case.size
        if kind in ("play", "compliance"):  # the motor's inertia is some of the joint's
            model.dof_armature[j] -= ROTOR * self.inertia[j]
        mujoco.mj_setConst(model, data := mujoco.MjData(model))
        model.opt.timestep = h = DT / FINER
        data.qpos[:] = self.begin
        scratch = mujoco.MjData(self.nominal)
        quick = np.full(len(self.joints), QUICK)
        quick[j] *= 0.5 if kind in ("play", "compliance") else 1.0  # else its motor shakes in the gear
        stiff, damp = self.inertia * quick**2, self.inertia * 2.0 * quick
        gear = Gear(case, self.inertia[j], self.begin[j], h) if kind in ("play", "compliance") else None
        bristle, commands, encoders, true = 0.0, [], [], []
        for row in wanted:
            shown, speed = data.qpos.copy(), data.qvel.copy()
            if gear:
                shown[j], speed[j] = gear.at, gear.speed
            if kind == "encoder_zero":
                shown[j] += case.size
            scratch.qpos[:] = row
            mujoco.mj_forward(self.nominal, scratch)
            torque = scratch.qfrc_bias - scratch.qfrc_passive + stiff * (row - shown) - damp * speed
            command = torque[self.driven] / self.gain
            if model.nu:
                limited = self.nominal.actuator_ctrllimited.astype(bool)
                command = np.where(limited, np.clip(command, *self.nominal.actuator_ctrlrange.T), command)
            commands.append(command)
            encoders.append(shown)
            true.append([*data.qpos, *data.qvel])
            for step in range(FINER):
                applied = command.copy()
                if kind == "delay":
                    late = len(commands) * FINER + step - round(case.size / h)
                    applied[self.driven.index(j)] = commands[max(late // FINER - 1, 0)][self.driven.index(j)]
                force = np.zeros(model.nv)
                if kind == "motor_constant" and not model.nu:
                    applied[self.driven.index(j)] *= 1.0 + case.size
                if kind == "ripple":
                    force[j] += case.size * np.sin(case.more["teeth"] * data.qpos[j] + case.phase)
                if kind == "friction" and case.phase <= np.pi:  # LuGre
                    v = data.qvel[j]
                    level = case.size * (1.0 + 0.3 * np.exp(-((v / 0.05) ** 2)))
                    bristle += h * (v - abs(v) * bristle * (case.size / 1e-3) / level)
                    force[j] -= case.size / 1e-3 * bristle
                if gear:
                    a = self.driven.index(j)
                    drive = applied[a] * self.gain[a]
                    force[j] += gear.step(drive, data.qpos[j], data.qvel[j])
                    applied[a] = 0.0
                if model.nu:
                    data.ctrl[:] = applied
                else:
                    force[self.driven] += applied
                data.qfrc_applied[:] = force
                mujoco.mj_step(model, data)
        first = round(BEFORE / DT)
        return np.array(commands)[first:], np.array(encoders)[first:], np.array(true)[first:]


class Gear:
    """Between a motor, which has the encoder, and its joint: a spring, with room on either side."""

    def __init__(self, case: Case, inertia: float, at: float, h: float):
        self.h, self.at, self.speed, self.rotor = h, at, 0.0, ROTOR * inertia
        self.room = case.size if case.kind == "play" else 0.0
        self.stiff = case.more["torque"] / (case.size if case.kind == "compliance" else 0.1 * case.size)
        self.damp = 0.6 * np.sqrt(self.stiff * self.rotor)

    def step(self, drive: float, q: float, v: float) -> float:
        """The torque on the joint, after a step of the motor."""
        bent = self.at - q
        out = np.sign(bent) * max(abs(bent) - self.room, 0.0)
        torque = self.stiff * out + (self.damp * (self.speed - v) if out else 0.0)
        self.speed += self.h * (drive - torque) / self.rotor
        self.at += self.h * self.speed
        return torque


def _load(model, mujoco, case: Case) -> None:
    """Fix a point mass to the last body."""
    b, mass, at = model.nbody - 1, case.size, case.more["at"]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[b])
    turn = turn.reshape(3, 3)
    whole = model.body_mass[b] + mass
    center = (model.body_mass[b] * model.body_ipos[b] + mass * at) / whole
    inertia = turn @ np.diag(model.body_inertia[b]) @ turn.T
    for m, r in ((model.body_mass[b], model.body_ipos[b] - center), (mass, at - center)):
        inertia += m * (r @ r * np.eye(3) - np.outer(r, r))
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.linalg.det(axes)
    mujoco.mju_mat2Quat(model.body_iquat[b], axes.ravel())
    model.body_mass[b], model.body_ipos[b], model.body_inertia[b] = whole, center, moments


def drawn(number: int) -> tuple[Case, Machine]:
    """A case by its number: kinds, models and conditions in turn."""
    random = np.random.default_rng([43, number])
    name = [*MODELS][(number + number // len(MODELS)) % len(MODELS)]
    case = Case(
        number, name, KINDS[number % len(KINDS)], CONDITIONS[(number + number // len(KINDS)) % len(CONDITIONS)], random
    )
    path, begins = MODELS[name]
    machine = Machine(packages() / path, begins)
    case.joint = int(random.choice(machine.driven))
    case.phase, share = random.uniform(0, 2 * np.pi), random.uniform(0.5, 1.0)
    clean, *_ = machine.run(Case(0, "", "clean", "", random), machine.reference(random, 1000), False)
    a, model = machine.driven.index(case.joint), machine.nominal
    torque = float(np.std(clean[:, a]) * abs(machine.gain[a]))
    case.more = {"torque": torque, "teeth": int(random.integers(20, 50))}
    last = model.nbody - 1
    case.more["at"] = model.body_ipos[last] + random.uniform(-0.05, 0.05, 3)
    case.size = share * {
        "friction": 0.3 * torque, "delay": 0.03, "play": 0.02, "compliance": 0.03, "motor_constant": 0.3,
        "encoder_zero": 0.1, "ripple": 0.3 * torque, "payload": 0.15 * float(model.body_subtreemass[1]),
    }.get(case.kind, 0.0)  # fmt: skip
    if case.kind in ("motor_constant", "encoder_zero") and case.phase > np.pi:
        case.size = -case.size
    if case.kind == "parameter":
        shares = (("body_mass", 0.05), ("dof_damping", 0.5), ("dof_armature", 0.3), ("dof_frictionloss", 0.5))
        case.more["parameters"] = [
            (name, i, 1.0 + random.uniform(-share, share))
            for name, share in shares
            for i in range(len(getattr(model, name)))
        ]
    return case, machine


def log(
    path: Path, machine: Machine, case: Case, commands: np.ndarray, encoders: np.ndarray, sigma: np.ndarray
) -> None:
    """A log with noise of that RMS (joints,), or in steps of its root of twelve times."""
    shown = encoders + sigma * case.random.standard_normal(encoders.shape)
    if case.condition == "steps":
        step = sigma * np.sqrt(12.0)
        shown = np.round(encoders / step) * step
    table = np.column_stack([np.arange(len(commands)) * DT, commands, shown])
    header = ",".join(["t", *machine.inputs, *machine.joints])
    np.savetxt(path, table, "%.10g", ",", header=header, comments="")


def off(rig, path: Path, sigma: np.ndarray, true: np.ndarray, encoders: np.ndarray, found: dict | None) -> float:
    """RMS of the error of the simulation, over joints and time, in units of the noise.

    true: positions and velocities (samples, 2 joints), from which each window of it begins.
    """
    from greygate.mismatch.simulation import corrected

    model, values = corrected(rig, rig.recording(path), found)
    shifts = None
    if rig.window:
        begun = model.states(values)[0][model.restarts]
        shifts = np.zeros((len(begun), len(model.locals)))
        for k, symbol in enumerate(model.locals):
            j = [*rig.plant.states].index(symbol)
            shifts[:, k] = true[model.restarts, j] - begun[:, j]
    errors = (model.predict(values, shifts) - encoders) / sigma
    return float(np.sqrt(np.mean(np.minimum(np.nan_to_num(errors, nan=1e6) ** 2, 1e12))))


def recorded(case: Case, machine: Machine, work: Path) -> tuple[np.ndarray, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Write log.csv, another one (third.csv), that without what is concealed (twin.csv), and the rig of the first.

    The noise of each encoder (joints,); of each log positions and velocities, and encoders without their noise.
    """
    samples, sigma, logs = round(SECONDS / DT), None, {}
    for name, acts, length in (("log", True, samples), ("third", True, samples // 2), ("twin", False, samples // 2)):
        random = np.random.default_rng([43, case.number, name == "log"])
        commands, encoders, true = machine.run(case, machine.reference(random, length), acts)
        sigma = SIGMA * np.ptp(encoders, axis=0) if sigma is None else sigma
        log(work / f"{name}.csv", machine, case, commands, encoders, sigma)
        logs[name] = true, encoders
    if not (work / "rig").exists():
        words = ("init-rig", work / "log.csv", "--model", packages() / MODELS[case.name][0], "--out", work / "rig")
        subprocess.run([GREYGATE, *words], check=True, capture_output=True)
    return sigma, logs


def solved(number: int, limit: float, kept: Path | None) -> dict:
    """Draw, diagnose and score one case."""
    from greygate.mismatch.rig import load

    with scratch() as work:
        work = kept / f"case{number}" if kept else work
        work.mkdir(parents=True, exist_ok=True)
        case, machine = drawn(number)
        sigma, logs = recorded(case, machine, work)
        rig = work / "rig"
        if case.condition == "told":
            _tell(rig / "rig.toml", dict(zip(machine.joints, sigma, strict=True)))
        watch, cpu, found = stopwatch(), stopwatch(_children), {"verdict": "no answer", "effects": [], "parameters": {}}
        try:
            done = subprocess.run(
                [GREYGATE, "diagnose", rig, "--out", work / "d.json"], capture_output=True, text=True, timeout=limit
            )
            seconds = watch(1)
            if (work / "d.json").exists():
                found = json.loads((work / "d.json").read_text())
            else:
                found["verdict"] = done.stderr.strip().splitlines()[-1]
        except subprocess.TimeoutExpired:
            seconds, found["verdict"] = limit, "out of time"
        spent = cpu(1)
        known = load(rig)
        nominal, truth = (off(known, work / f"{name}.csv", sigma, *logs[name], None) for name in ("third", "twin"))
        left = off(known, work / "third.csv", sigma, *logs["third"], found) if "schema" in found else nominal
    return _row(case, machine, found, nominal, truth, left, seconds, spent)


def _children() -> float:
    """Seconds of processor time of the processes that were started and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _tell(path: Path, sigma: dict[str, float]) -> None:
    """State the noise in rig.toml."""
    out = []
    for line in path.read_text().splitlines():
        if head := re.fullmatch(r"\[channels\.(\w+)\]", line):
            channel = head[1]
        out.append(f"noise_rms = {sigma[channel]:.3g}" if line.startswith("# noise_rms") else line)
    path.write_text("\n".join(out) + "\n")


def _row(case: Case, machine: Machine, found: dict, nominal: float, truth: float, left: float, *seconds: float) -> dict:
    at = machine.joints[case.joint]
    starts = NAMES.get(case.kind, ())
    last = machine.plant.parameters and [s for s in machine.plant.parameters if s.startswith("mass_")][-1].removeprefix(
        "mass_"
    )
    drive = machine.inputs[machine.driven.index(case.joint)]
    places = (last,) if case.kind == "payload" else (at, drive, f"v_{at}")

    def right(name: str) -> bool:
        return any(name == start or name.startswith(f"{start}_") for start in starts)

    def placed(name: str) -> bool:
        return right(name) and (name in starts or any(name.endswith(f"_{p}") for p in places))

    effects = [(e["id"], e.get("confidence") or 0.0) for e in found["effects"] if e["id"] != "unknown"]
    outside = [s for s, p in found["parameters"].items() if p.get("outside_tolerance")]
    wrong = [(name, c) for name, c in effects if not right(name)]
    return {
        "case": case.number, "model": case.name, "joints": len(machine.joints), "kind": case.kind,
        "condition": case.condition, "at": at if starts else "", "size": f"{case.size:.4g}",
        "strength": f"{nominal / truth:.3g}" if starts else "", "verdict": found["verdict"],
        "named": "+".join(f"{n} {c:.2g}" for n, c in effects), "wrong": "+".join(n for n, _ in wrong),
        "sure": sum(c >= SURE for _, c in wrong), "parameters": "+".join(outside),
        "right": any(right(n) for n, _ in effects) or any(map(right, outside)),
        "placed": any(placed(n) for n, _ in effects) or any(map(placed, outside)),
        "nominal": f"{nominal:.4g}", "truth": f"{truth:.4g}",
        "removed": f"{(nominal - left) / (nominal - truth):.3f}" if nominal > 1.1 * truth else "",
        "seconds": seconds[0], "cpu": seconds[1],
    }  # fmt: skip


def table(rows: list[dict]) -> list[str]:
    """The figures."""
    quiet = [r for r in rows if r["kind"] in ("clean", "parameter")]
    strong = [r for r in rows if r["strength"] and float(r["strength"]) >= STRONG]
    removed = [float(r["removed"]) for r in strong if r["removed"]]
    seconds, cpu = ([float(r[key]) for r in rows] for key in ("seconds", "cpu"))

    def share(part: list[dict], test) -> str:
        return f"{sum(map(bool, map(test, part)))} of {len(part)}"

    def true(key: str):
        return lambda row: str(row[key]) == "True"

    lines = [
        f"cases: {len(rows)}; without an answer: {share(rows, lambda r: r['verdict'] in ('out of time', 'no answer'))}",
        f"cases with a surely wrong name: {share(rows, lambda r: int(r['sure']))}",
        f"cases with a wrong name: {share(rows, lambda r: r['wrong'])}",
        f"claims on clean or wrong parameters only: {share(quiet, lambda r: r['named'])}",
        f"  parameters said outside their tolerance there: {share(quiet, lambda r: r['parameters'])}",
        f"right name of strong effects: {share(strong, true('right'))}",
        f"  at the right joint: {share(strong, true('placed'))}",
        f"median share of the error removed on unseen data: {np.median(removed) if removed else np.nan:.3f}",
        f"seconds: median {np.median(seconds):.0f}, worst {max(seconds):.0f}",
        f"of processors: median {np.median(cpu):.0f}, worst {max(cpu):.0f}",
    ]
    for kind in NAMES:
        part = [r for r in strong if r["kind"] == kind]
        lines.append(f"  {kind}: right name {share(part, true('right'))} strong")
    return lines


def main(
    *only: int,
    cases: int = 60,
    limit: Annotated[float, "seconds for a diagnosis"] = 400.0,
    kept: Annotated[Path | None, "folder in which the cases stay"] = None,
    only_table: Annotated[bool, "only print the table"] = False,
) -> None:
    path = place("outside_concealed.csv")
    rows = list(csv.DictReader(path.open(newline=""))) if path.exists() else []
    done = {int(row["case"]) for row in rows}
    for number in [] if only_table else only or range(cases):
        if number in done:
            continue
        rows.append(solved(number, limit, kept))
        print(*rows[-1].values(), flush=True)
        with path.open("w", newline="") as out:
            writer = csv.DictWriter(out, FIELDS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    path.with_suffix(".txt").write_text("\n".join(lines := table(rows)) + "\n")
    for ending in (".csv", ".txt"):
        stamp(path.with_suffix(ending))
    print("\n".join(lines))
