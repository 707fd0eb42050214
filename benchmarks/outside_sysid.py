"""The logs of `outside_concealed` given to mujoco.sysid: friction, damping, armature and masses free.

Needs what `mujoco[sysid]` brings (tabulate, matplotlib, mediapy). Windows begin where the rig's do: at recorded
positions, with velocities of a cubic over 21 samples. Its optimizer, bounds around the nominal model, no names; a
parameter counts as off where it is more than three of its standard deviations from what the concealing model has.
"""

import csv
import time
from pathlib import Path
from typing import Annotated

import numpy as np

from .made import place, stamp
from .outside_concealed import DT, MODELS, Machine, drawn, recorded
from .outside_models import packages
from .shared import scratch

TAKES = "an hour"
NEEDS = ("tabulate",)
FARTHEST = 3.0  # standard deviations
HELD = 0.25  # of a log is held out, as `init-rig` does
MASS = 0.5  # share of a mass, that it may be off


def specified(path: Path, machine: Machine):
    """The model as its specification: with encoders, and motors where it has none."""
    import mujoco

    from greygate.plants import mjcf

    if path.suffix == ".urdf":
        content = mjcf.bundle(path)
        spec = mujoco.MjSpec.from_string(content.pop(path.name).decode(), assets=content)
    else:
        spec = mujoco.MjSpec.from_file(str(path))
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for joint in spec.joints:
        spec.add_sensor(name=f"encoder_{joint.name}", type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                        objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint.name)  # fmt: skip
        if not machine.nominal.nu:
            motor = spec.add_actuator(name=f"motor_{joint.name}", target=joint.name)
            motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    spec.option.timestep = DT / max(round(DT / machine.nominal.opt.timestep), 1)
    return spec


def freed(spec, machine: Machine, torque: float):
    """Every joint's damping, friction and armature, and every mass that moves."""
    from mujoco import sysid

    def joint(name: str, what: str):
        def write(new, parameter) -> None:
            target, value = new.joint(name), parameter.value[0]
            setattr(target, what, [value, *getattr(target, what)[1:]] if what == "damping" else value)

        return write

    def body(name: str):
        return lambda new, parameter: setattr(new.body(name), "mass", parameter.value[0])

    found, model = sysid.ParameterDict(), machine.nominal
    for j in range(model.njnt):
        name = model.joint(j).name
        for what, own, most in (
            ("damping", model.dof_damping[j], torque), ("frictionloss", model.dof_frictionloss[j], torque),
            ("armature", model.dof_armature[j], machine.inertia[j]),
        ):  # fmt: skip
            found.add(sysid.Parameter(f"{what} {name}", own, 0.0, own + most, modifier=joint(name, what)))
    for b in range(1, model.nbody):
        if model.body_weldid[b] and model.body_mass[b] > 0 and spec.body(model.body(b).name).explicitinertial:
            name, own = model.body(b).name, model.body_mass[b]
            found.add(sysid.Parameter(f"mass {name}", own, (1 - MASS) * own, (1 + MASS) * own, modifier=body(name)))
    return found


def windows(samples: int, window: int | None) -> list[slice]:
    size = window or samples
    return [slice(k, min(k + size, samples)) for k in range(0, samples - size + 1, size)]


def simulated(model, commands: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Positions (samples, joints) from positions and velocities at the first."""
    import mujoco

    data, out = mujoco.MjData(model), []
    data.qpos[:], data.qvel[:] = np.split(begin, 2)
    for row in commands:
        out.append(data.qpos.copy())
        data.ctrl[:] = row
        for _ in range(round(DT / model.opt.timestep)):
            mujoco.mj_step(model, data)
    return np.array(out)


def solved(number: int) -> dict:
    import mujoco
    from mujoco import sysid
    from scipy.signal import savgol_filter

    from greygate.mismatch.rig import load

    case, machine = drawn(number)
    with scratch() as work:
        sigma, logs = recorded(case, machine, work)
        window = load(work / "rig").window
        table = {name: np.loadtxt(work / f"{name}.csv", delimiter=",", skiprows=1) for name in logs}
    spec = specified(packages() / MODELS[case.name][0], machine)
    model, inputs = spec.compile(), len(machine.inputs)
    torque = max(case.more["torque"], 1e-6)
    kept = table["log"][: round((1 - HELD) * len(table["log"]))]
    speed = savgol_filter(kept[:, 1 + inputs :], 21, 3, deriv=1, delta=DT, axis=0)
    steps = round(DT / model.opt.timestep)
    begins, controls, sensors = [], [], []
    for part in windows(len(kept), window):
        rows = kept[part]
        begins.append(sysid.create_initial_state(model, rows[0, 1 + inputs :], speed[part][0]))
        t = np.arange(len(rows)) * DT
        fine = np.arange(len(rows) * steps) * model.opt.timestep
        controls.append(sysid.TimeSeries(fine, np.repeat(rows[:, 1 : 1 + inputs], steps, axis=0)))
        sensors.append(sysid.TimeSeries.from_names(t[1:], rows[1:, 1 + inputs :] / sigma * sigma, model))
    names = [f"window{k}" for k in range(len(begins))]
    sequences = sysid.ModelSequences(case.name, spec, names, begins, controls, sensors)
    began, parameters = time.process_time(), freed(spec, machine, torque)
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    found, result = sysid.optimize(initial_params=parameters, residual_fn=residual, optimizer="mujoco", verbose=False)
    left = residual(result.x, found)[0]
    _, reach = sysid.calculate_intervals(left, np.asarray(result.jac))
    seconds = time.process_time() - began
    fitted = spec.copy()
    sysid.apply_param_modifiers_spec(found, fitted)
    fitted = fitted.compile()
    held, true = table["third"], logs["third"]
    errors = [
        (simulated(fitted, held[part, 1 : 1 + inputs], true[0][part][0]) - true[1][part]) / sigma
        for part in windows(len(held), window)
    ]
    wanted = _truth(case, machine, [*found.keys()])
    off = [name for name, at, by in zip(found.keys(), result.x, reach, strict=True)
           if abs(at - wanted[name]) > FARTHEST / 1.96 * by]  # fmt: skip
    mujoco.set_mju_user_warning(None)
    return {
        "case": number, "model": case.name, "kind": case.kind, "condition": case.condition, "freed": len(wanted),
        "off": len(off), "held_out": f"{np.sqrt(np.mean(np.concatenate(errors) ** 2)):.4g}", "cpu": f"{seconds:.1f}",
    }  # fmt: skip


def _truth(case, machine: Machine, names: list[str]) -> dict[str, float]:
    """What the concealing model has of each parameter."""
    model = machine.nominal.__copy__()
    for array, index, factor in case.more.get("parameters", ()):
        getattr(model, array)[index] *= factor
    if case.kind == "friction":
        model.dof_frictionloss[case.joint] += case.size
    if case.kind == "payload":
        model.body_mass[model.nbody - 1] += case.size
    out = {}
    for name in names:
        what, _, of = name.partition(" ")
        out[name] = float(
            model.body(of).mass[0] if what == "mass" else getattr(model, f"dof_{what}")[model.joint(of).dofadr[0]]
        )
    return out


def main(*only: int, cases: Annotated[int, "the first so many of outside_concealed"] = 60) -> None:
    path = place("outside_sysid.csv")
    rows = list(csv.DictReader(path.open(newline=""))) if path.exists() else []
    done = {int(row["case"]) for row in rows}
    for number in only or range(cases):
        if number in done:
            continue
        rows.append(solved(number))
        print(*rows[-1].values(), flush=True)
        with path.open("w", newline="") as out:
            writer = csv.DictWriter(out, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    stamp(path)
