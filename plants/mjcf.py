"""A MuJoCo model (MJCF, URDF) as a plant: MuJoCo itself steps it, called from the compiled loop.

States are the positions and velocities of its joints, hinges and slides, and the activations of its actuators; inputs
are the controls of its actuators, or the torques on its joints with the actuators switched off. Each joint is a balance
`motion_JOINT` of forces. Parameters have MuJoCo's own names: `damping_JOINT`, `mass_BODY`, `kp_ACTUATOR`.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from greygate.contents import contents, without_entities
from greygate.errors import InputError, brought_by, shown
from greygate.plants.outside import RUN, symbols
from greygate.plants.plant import Equation, Parameter, Plant, State

Setting = tuple[str, tuple[int, ...], float]
"""An array of MuJoCo's model, an index there, and what the parameter is multiplied with."""

POINT = 1e-9  # m^2: the inertia of a point mass, over its mass
TORQUE = "torque_"  # before the name of a joint: an input that acts on it
APPLIED = "applied"  # the term in which it does
ANGLE, WAY = ("rad", "N m", "kg m^2"), ("m", "N", "kg")  # units of a hinge and of a slide: position, force, inertia
GRAVITY = "gravity"  # an array of MuJoCo's options
BODY = ("body_mass", "body_ipos", "body_iquat", "body_inertia")
INERTIAL = ("body_mass", "body_inertia", "body_ipos", "dof_armature")  # after which MuJoCo's constants are set anew
AXES = ("x", "y", "z")
ELEMENTS = {"dry_friction": "frictionloss", "viscous_friction": "damping", "spring": "stiffness"}
"""Effects of `general.toml` -> what MuJoCo has for them at a joint."""
PROGRAMS = ("extension", "plugin")  # elements
NAMING = ("include", "mesh", "hfield", "texture", "skin", "flexcomp", "model", "asset")  # elements that name files
NAMES = ("file", "filename", *(f"file{side}" for side in ("right", "left", "up", "down", "front", "back")))
FOLDERS = ("meshdir", "texturedir", "assetdir")
MESHES = (".stl", ".obj", ".msh")
SOURCE = """
for_model = types.void(types.intp, types.intp)
mj_resetData = types.ExternalFunction("mj_resetData", for_model)
mj_forward = types.ExternalFunction("mj_forward", for_model)
mj_Euler = types.ExternalFunction("mj_Euler", for_model)
mj_implicit = types.ExternalFunction("mj_implicit", for_model)
mj_RungeKutta = types.ExternalFunction("mj_RungeKutta", types.void(types.intp, types.intp, types.int32))
FAR = 1e10  # MuJoCo's own largest number of a state: beyond it, it begins anew


@jit
def begin(at, x):
    model, data, qpos, qvel, act = at[:5]
    mj_resetData(model, data)
    restored(x, qpos, qvel, act)


@jit
def accelerate(at, x, u, force):
    model, data, qpos, qvel, act, ctrl, applied, qacc = at[:8]
    columns, n = at[11], len(qpos)
    for j in range(2 * n):
        if not abs(x[j]) < FAR:
            return False
    for j in range(len(ctrl)):
        ctrl[j] = u[columns[j]] if columns[j] >= 0 else 0.0
    for j in range(n):
        applied[j] = force[n + j]
    mj_forward(model, data)
    for j in range(n):
        if not abs(qacc[j]) < FAR:
            return False
    return True


@jit
def acceleration(at, i):
    return at[7][i]


@jit
def mobility(at, i):
    return at[10][i]


@jit
def lessened(at, x, slope):
    # A Runge-Kutta step takes a force as it is: less what it falls by over the step, by an implicit step tried before.
    # As a damping it would act on the whole velocity, and explicitly.
    model, data, qpos, qvel, act, _, applied = at[:7]
    damping, own, n = at[8], at[9], len(qpos)
    for j in range(n):
        damping[j] = own[j] + slope[j]
    mj_Euler(model, data)
    for j in range(n):
        applied[j] -= slope[j] * (qvel[j] - x[n + j])
        damping[j] = own[j]
    restored(x, qpos, qvel, act)
    mj_forward(model, data)


@jit
def restored(x, qpos, qvel, act):
    n = len(qpos)
    for j in range(n):
        qpos[j] = x[j]
        qvel[j] = x[n + j]
    for j in range(len(act)):
        act[j] = x[2 * n + j]


@jit
def steep(slope):
    for j in range(len(slope)):
        if slope[j] > 0.0:
            return True
    return False


@jit
def advance(at, x, slope):
    model, data, qpos, qvel, act = at[:5]
    damping, own, integrator, n = at[8], at[9], at[12], len(qpos)
    if integrator == 1:
        if steep(slope):
            lessened(at, x, slope)
        mj_RungeKutta(model, data, 4)
    else:
        for j in range(n):
            damping[j] = own[j] + slope[j]
        if integrator == 0:
            mj_Euler(model, data)
        else:
            mj_implicit(model, data)
    for j in range(n):
        damping[j] = own[j]
        x[j] = qpos[j]
        x[n + j] = qvel[j]
    for j in range(len(act)):
        x[2 * n + j] = act[j]
"""


@dataclass(eq=False)
class Pair:
    """A model and its data of MuJoCo, for one run at a time. at: what the loop takes of them, but for the inputs."""

    model: Any
    data: Any
    at: tuple[Any, ...]
    values: dict[str, float]


@dataclass(frozen=True)
class Load:
    """A point mass fixed to a body. symbols: of its mass and its place beside the body's own center of mass (x, y, z).

    own: the parameters of the body itself.
    """

    body: int
    symbols: tuple[str, str, str, str]
    own: tuple[str, ...]

    def place(self, model: Any, values: Mapping[str, float]) -> np.ndarray:
        """Where it is in the body's frame (3,), the model's body being without it."""
        return np.array(model.body_ipos[self.body]) + [values[s] for s in self.symbols[1:]]

    def put(self, model: Any, values: Mapping[str, float]) -> None:
        """Add it to a body that is without."""
        b, mass, at = self.body, values[self.symbols[0]], self.place(model, values)
        parts = (float(model.body_mass[b]), np.array(model.body_ipos[b])), (mass, at)
        whole = parts[0][0] + mass
        center = sum(m * r for m, r in parts) / whole
        flat = np.empty(9)
        _mujoco().mju_quat2Mat(flat, model.body_iquat[b])
        own = flat.reshape(3, 3)
        inertia = own * model.body_inertia[b] @ own.T
        for m, r in parts:
            inertia = inertia + m * ((r - center) @ (r - center) * np.eye(3) - np.outer(r - center, r - center))
        moments, axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.linalg.det(axes)
        _mujoco().mju_mat2Quat(model.body_iquat[b], axes.ravel())
        model.body_mass[b], model.body_ipos[b], model.body_inertia[b] = whole, center, moments


@dataclass(frozen=True, eq=False)
class Simulated:
    """MuJoCo as an `Outside`.

    path: of the model's file. settings: parameter -> where it stands. controls: the input of each control, or "".
    """

    path: Path
    model: Any
    stepped: tuple[str, ...]
    forced: int
    settings: Mapping[str, tuple[Setting, ...]]
    own: Collection[str]
    elements: Mapping[tuple[str, str], str]
    controls: tuple[str, ...]
    loads: tuple[Load, ...]
    coupled: Mapping[str, int]
    fixed: bool = False
    source: str = SOURCE + RUN
    shown: Collection[str] = ()
    loop: None = None
    steps: bool = True
    whole: bool = False
    timed: bool = False
    _idle: list[Pair] = field(default_factory=list)

    @property
    def first(self) -> int:
        return self.forced

    @property
    def early(self) -> float:
        return 0.0 if int(self.model.opt.integrator) == int(_mujoco().mjtIntegrator.mjINT_RK4) else 0.5

    @property
    def parameters(self) -> Collection[str]:
        return self.settings.keys()

    def near(self, recorded: Mapping[str, np.ndarray]) -> "Simulated":
        """Without contacts, which take most of a step's time, where no recorded position makes one."""
        joints = self.stepped[: self.forced]
        flag = int(_mujoco().mjtDisableBit.mjDSBL_CONTACT)
        if self.model.opt.disableflags & flag or not all(joint in recorded for joint in joints):
            return self
        data = _mujoco().MjData(self.model)
        for position in np.stack([recorded[joint] for joint in joints], axis=1):
            data.qpos[:] = position
            _mujoco().mj_fwdPosition(self.model, data)
            if data.ncon:
                return self
        free = self.model.__copy__()
        free.opt.disableflags |= flag
        return replace(self, model=free, _idle=[])

    @contextmanager
    def lent(self, inputs: Sequence[str], values: Mapping[str, float], step: float) -> Iterator[tuple[Any, ...]]:
        _alone()
        try:
            pair = self._idle.pop()
        except IndexError:
            pair = self._pair()
        try:
            self._set(pair, values)
            pair.model.opt.timestep = step
            columns = [inputs.index(name) if name in inputs else -1 for name in self.controls]
            own = pair.model.dof_damping.copy()
            yield (
                *pair.at,
                own,
                pair.model.dof_invweight0,
                np.array(columns, np.int64),
                int(self.model.opt.integrator),
            )
        finally:
            self._idle.append(pair)

    def _pair(self) -> Pair:
        model = self.model.__copy__()
        model.opt.disableflags |= _mujoco().mjtDisableBit.mjDSBL_AUTORESET  # what diverges shall say so
        d = _mujoco().MjData(model)
        arrays = (d.qpos, d.qvel, d.act, d.ctrl, d.qfrc_applied, d.qacc)
        has = {symbol: _held(model, settings) for symbol, settings in self.settings.items()}
        return Pair(model, d, (model._address, d._address, *arrays, model.dof_damping), has)

    def _set(self, pair: Pair, values: Mapping[str, float]) -> None:
        """Write what has changed since the model had it last."""
        changed = {s: values[s] for s in self.settings if values[s] != pair.values[s]}
        written = {setting[0] for s in changed for setting in self.settings[s]}
        self._write(pair.model, changed)
        for load in self.loads:
            if changed.keys() & {*load.symbols, *load.own} and (
                values[load.symbols[0]] or pair.values[load.symbols[0]]
            ):
                for name in BODY:
                    getattr(pair.model, name)[load.body] = getattr(self.model, name)[load.body]
                other = {s: values[s] for s in load.own if values[s] != _held(self.model, self.settings[s])}
                self._write(pair.model, other)
                if values[load.symbols[0]]:
                    load.put(pair.model, values)
                written.add(INERTIAL[0])
        if written & {*INERTIAL}:
            _mujoco().mj_setConst(pair.model, pair.data)
        pair.values.update(changed)

    def _write(self, model: Any, values: Mapping[str, float]) -> None:
        for symbol, value in values.items():
            for name, index, factor in self.settings[symbol]:
                _array(model, name)[index] = factor * value


def _array(model: Any, name: str) -> Any:
    return model.opt.gravity if name == GRAVITY else getattr(model, name)


def _held(model: Any, settings: Sequence[Setting]) -> float:
    """The value of a parameter that the model has; 0 for one that stands nowhere in it."""
    return next((float(_array(model, name)[index]) / factor for name, index, factor in settings), 0.0)


@cache
def _mujoco() -> Any:
    """The package, its library where the compiled loop finds its functions."""
    with brought_by("mujoco", "mujoco"):
        import mujoco
    from llvmlite import binding

    binding.load_library_permanently(str(next(Path(mujoco.__file__).parent.glob("*mujoco*.so*"), "")))
    return mujoco


def _alone() -> Any:
    """The package. Raises InputError where a callback of somebody else's would act in its simulations."""
    mujoco = _mujoco()
    if mujoco.get_mjcb_passive() or mujoco.get_mjcb_control():
        raise InputError("a callback of MuJoCo is set, which would act here too; take it away while greygate runs")
    return mujoco


def read(path: Path, recorded: Collection[str]) -> Plant:
    """The plant of a model. recorded: names of channels: the inputs are those of its controls or joint torques there.

    Raises InputError for a model that does not load, or that moves by more than hinges and slides.
    """
    return _Reading(path, load(path), recorded).plant()


def forces(plant: Plant) -> list[str]:
    """The inputs that a log may have in place of controls: forces on joints."""
    return [TORQUE + symbol for symbol, state in plant.states.items() if state.rate]


def load(path: Path) -> Any:
    """MuJoCo's model of a file. Raises InputError for one that it does not take, and as `files` does."""
    mujoco = _alone()
    content = bundle(path)
    told = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)  # else it writes MUJOCO_LOG.TXT where one stands
    try:
        if path.suffix == ".urdf":
            return mujoco.MjModel.from_xml_string(content.pop(path.name).decode(), content)
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{path}: MuJoCo does not load it ({shown(str(error))[1:-1]}); repair the model") from None
    finally:
        mujoco.set_mju_user_warning(told)


def file_of(plant: Plant) -> Path:
    """The file of a plant's model."""
    assert isinstance(plant.outside, Simulated)
    return plant.outside.path


def names_of(plant: Plant) -> list[str]:
    """The names that the joints of a plant have in its model, in its order."""
    assert isinstance(plant.outside, Simulated)
    return [plant.outside.model.joint(j).name for j in range(plant.outside.forced)]


def corrected(plant: Plant, values: Mapping[str, float]) -> str:
    """The MJCF of a model with other values of some of its plant's parameters; it names the same files.

    A body whose mass, place of mass or inertia changes has them written down, whatever its geometry says.
    """
    assert isinstance(plant.outside, Simulated)
    path = plant.outside.path
    model = load(path)
    spec = _mujoco().MjSpec.from_file(str(path))
    spec.compile()
    spec.option.timestep = plant.step
    for symbol, settings in plant.outside.settings.items():
        if values[symbol] != plant.parameters[symbol].value:
            for name, index, factor in settings:
                _write(spec, model, name, index, factor * values[symbol])
    for carried in plant.outside.loads:
        if mass := values[carried.symbols[0]]:
            body = next(b for b in spec.bodies if b.id == carried.body)
            at = [values[s] + values[p] for s, p in zip(carried.symbols[1:], carried.own[-3:], strict=True)]
            point = body.add_body(name=carried.symbols[0], pos=at)
            point.explicitinertial, point.mass, point.ipos, point.inertia = True, mass, [0.0] * 3, [POINT * mass] * 3
    try:
        return str(spec.to_xml())
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo does not take it as corrected ({shown(str(error))[1:-1]})") from None


def _write(spec: Any, model: Any, name: str, index: tuple[int, ...], value: float) -> None:
    """Write one number of a compiled model into its specification."""
    if name == GRAVITY:
        spec.option.gravity[index[0]] = value
        return
    kind, _, field_ = name.partition("_")
    elements = {"dof": spec.joints, "jnt": spec.joints, "body": spec.bodies, "actuator": spec.actuators}[kind]
    element = next(e for e in elements if e.id == index[0])
    whole = kind == "body" and np.isfinite(element.fullinertia).any()  # as of a URDF: not along its own axes
    if kind == "body" and (whole or not element.explicitinertial):
        element.explicitinertial = True
        b = index[0]
        element.mass, element.ipos, element.iquat = model.body_mass[b], model.body_ipos[b], model.body_iquat[b]
        element.inertia, element.fullinertia = model.body_inertia[b], np.full(6, np.nan)
    now = np.atleast_1d(np.array(getattr(element, field_), dtype=float))
    now[index[1] if len(index) > 1 else 0] = value
    setattr(element, field_, now if np.ndim(getattr(element, field_)) else float(now[0]))


def files(path: Path) -> list[str]:
    """The file of an MJCF and those that it names, by their places under its folder.

    Raises InputError where it cannot be read, names a file elsewhere, or a plugin, which is a program.
    """
    found, left = [path.name], [path]
    folders = [""]
    while left:
        root = _tree(left.pop())
        for element in root.iter():
            if element.tag in PROGRAMS:
                raise InputError(
                    f"{path}: <{element.tag}>: a plugin is a program, which a model may not run; remove it"
                )
            if element.tag == "compiler":
                folders += [element.get(key, "") for key in FOLDERS]
            for key in NAMES:
                if (name := element.get(key)) and element.tag in NAMING:
                    place = _inside(path, name, folders)
                    if element.tag == "include" and place in found:
                        raise InputError(f"{path}: {shown(name)} is included twice; include it once")
                    if element.tag == "include" and place:
                        left.append(path.parent / place)
                    found += [place] if place and place not in found else []
    return found


def bundle(path: Path) -> dict[str, bytes]:
    """What a rig takes along of a model: place in the rig's folder -> content.

    Of a URDF that is what moves and what collides, its meshes found in the packages around it; a mesh that MuJoCo does
    not read (only STL, OBJ, MSH), or that is not there, is left out with what collides by it.
    """
    root = _tree(path)
    if path.suffix != ".urdf":
        return {place: contents(path.parent / place) for place in files(path)}
    found: dict[str, bytes] = {}
    for link in root.iter("link"):
        for part in [part for part in link if part.tag in ("visual", "collision")]:
            mesh = part.find("geometry/mesh")
            file = None if mesh is None else _of_package(path, mesh.get("filename", ""))
            if part.tag == "visual" or (mesh is not None and (file is None or file.suffix.lower() not in MESHES)):
                link.remove(part)
            elif mesh is not None and file is not None:
                place = f"{file.parent.name}_{file.name}"
                mesh.set("filename", place)
                found[place] = contents(file)
    return {path.name: ElementTree.tostring(root), **found}


def _of_package(path: Path, name: str) -> Path | None:
    """The file that a URDF names, in a package that lies around it."""
    parts = name.removeprefix("package://").removeprefix("file://").strip("/").split("/")
    places = (folder.joinpath(*parts[first:]) for folder in path.resolve().parents for first in (0, 1, 2))
    return next((place for place in places if place.is_file()), None) if ".." not in parts else None


def _tree(path: Path) -> ElementTree.Element:
    try:
        text = contents(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give the model's file") from None
    without_entities(text, path)
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: is no XML ({error}); repair it") from None


def _inside(path: Path, name: str, folders: Sequence[str]) -> str:
    """Where a file that the model names lies under its folder; empty where there is none, as MuJoCo then says."""
    package = name.startswith("package://")  # of which MuJoCo takes the last part
    name = name.rpartition("/")[2] if package else name.replace("\\", "/")
    home, found = path.parent.resolve(), ""
    for folder in folders:
        place = (home / folder / name).resolve()
        if "://" in name or not place.is_relative_to(home):
            raise InputError(f"{path}: {shown(name)} is not under the model's folder; put it there")
        found = found or (place.relative_to(home).as_posix() if place.is_file() else "")
    return found


class _Reading:
    """A plant while it is read from a model."""

    def __init__(self, path: Path, model: Any, recorded: Collection[str]):
        self.path, self.model, self.mujoco = path, model, _mujoco()
        kinds = self.mujoco.mjtJoint
        for j, kind in enumerate(map(int, model.jnt_type)):
            if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
                what = "free" if kind == kinds.mjJNT_FREE else "ball"
                name = shown(model.joint(j).name or f"joint {j + 1}")
                raise InputError(f"{path}: {name} is a {what} joint; give a model with hinges and slides alone")
        if not model.njnt:
            raise InputError(f"{path}: has no joint; give a model that moves")
        self.joints = symbols([model.joint(j).name for j in range(model.njnt)], "joint")
        self.bodies = symbols([model.body(b).name for b in range(model.nbody)], "body")
        states = {s for joint in self.joints for s in (joint, f"v_{joint}")}
        self.actuators = symbols([model.actuator(a).name for a in range(self._count())], "actuator", states)
        self.units = [ANGLE if kind == kinds.mjJNT_HINGE else WAY for kind in map(int, model.jnt_type)]
        self.parameters: dict[str, Parameter] = {}
        self.settings: dict[str, tuple[Setting, ...]] = {}
        self.inputs: dict[str, str] = {}
        self.states: dict[str, State] = {}
        self.terms: list[dict[str, str]] = [{} for _ in self.joints]
        self.elements: dict[tuple[str, str], str] = {}
        self.loads: list[Load] = []
        torques = [TORQUE + j for j in self.joints]
        self.torques = [t for t in torques if t in recorded and not set(self.actuators) & set(recorded)]

    def _count(self) -> int:
        return int(getattr(self.model, "nactuator", self.model.nu))

    def plant(self) -> Plant:
        activations = self._states()
        self._joints()
        self._bodies()
        for a in range(self._count()) if not self.torques else ():
            self._actuator(a)
        own = {f"motion_{j}.{term}" for j, terms in zip(self.joints, self.terms, strict=True) for term in terms}
        for name in self.torques:
            j = self.joints.index(name.removeprefix(TORQUE))
            self.inputs[name] = self.units[j][1]
            self.parameters[f"gain_{name}"] = Parameter(1.0, "1")  # of the motor, or the sensor, that the log has it of
            self.terms[j][APPLIED] = f"gain_{name} * {name}"
        model = self.model.__copy__()
        if self.torques:
            model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_ACTUATION
        controls = ["" for _ in range(model.nu)]
        for a, name in enumerate(self.actuators if not self.torques else ()):
            controls[self._address(a)] = name
        self._gravity()
        trees = {f"v_{name}": int(tree) for name, tree in zip(self.joints, model.dof_treeid, strict=True)}
        outside = Simulated(
            self.path, model, tuple(self.states), len(self.joints), self.settings, own, self.elements, tuple(controls),
            tuple(self.loads), trees,
        )  # fmt: skip
        return Plant(
            self.path.stem, self.parameters, self.inputs, self.states, self._equations(activations),
            outputs=tuple(self.states), step=float(model.opt.timestep), outside=outside,
        )  # fmt: skip

    def _address(self, a: int) -> int:
        return int(self.model.actuator_ctrladr[a]) if hasattr(self.model, "actuator_ctrladr") else a

    def _states(self) -> list[str]:
        """Enter the states; those of actuators."""
        first = self.model.qpos0
        for j, (name, units) in enumerate(zip(self.joints, self.units, strict=True)):
            self.states[name] = State(units[0], initial=float(first[j]), rate=f"v_{name}")
        for name, units in zip(self.joints, self.units, strict=True):
            self.states[f"v_{name}"] = State(f"{units[0]}/s")
        found = []
        for a, name in enumerate(self.actuators):
            for i in range(int(self.model.actuator_actnum[a])):
                found.append(f"act_{name}" + (f"_{i + 1}" if i else ""))
                self.states[found[-1]] = State("1")
        return found

    def _equations(self, activations: Sequence[str]) -> dict[str, Equation]:
        found = {f"way_{j}": Equation(j, {"speed": f"v_{j}"}) for j in self.joints}
        for j, terms in zip(self.joints, self.terms, strict=True):
            found[f"motion_{j}"] = Equation(f"v_{j}", terms)
        return found | {f"activation_{a}": Equation(a, {}) for a in activations}

    def _enter(self, symbol: str, unit: str, *settings: Setting) -> str:
        """A parameter with the value that it has in the model; its symbol."""
        self.parameters[symbol] = Parameter(_held(self.model, settings), unit)
        self.settings[symbol] = settings
        return symbol

    def _joints(self) -> None:
        for j, (name, (way, force, inertia)) in enumerate(zip(self.joints, self.units, strict=True)):
            v, terms = f"v_{name}", self.terms[j]
            damping = self._enter(f"damping_{name}", _over(f"{force} s", way), ("dof_damping", (j,), 1.0))
            terms["damping"] = f"-{damping} * {v}"
            self._enter(f"armature_{name}", inertia, ("dof_armature", (j,), 1.0))
            loss = self._enter(f"frictionloss_{name}", force, ("dof_frictionloss", (j,), 1.0))
            terms["frictionloss"] = f"-{loss} * sign({v})"
            stiffness = self._enter(f"stiffness_{name}", _over(force, way), ("jnt_stiffness", (j,), 1.0))
            self.elements |= {(effect, f"motion_{name}"): f"{own}_{name}" for effect, own in ELEMENTS.items()}
            terms["stiffness"] = f"-{stiffness} * ({name} - {float(self.model.qpos_spring[j])!r})"

    def _bodies(self) -> None:
        """The inertial parameters of what moves."""
        for b, name in enumerate(self.bodies):
            if self.model.body_weldid[b] and self.model.body_mass[b] > 0 and self.model.body_inertia[b].min() > 0:
                self._enter(f"mass_{name}", "kg", ("body_mass", (b,), 1.0))
                moments = self.model.body_inertia[b]
                largest = sorted(range(len(AXES)), key=lambda i: -moments[i])  # of which the others stay a share
                shares = [("body_inertia", (b, i), float(moments[i] / moments.max())) for i in largest]
                self._enter(f"inertia_{name}", "kg m^2", *shares)
                places = [
                    self._enter(f"ipos_{axis}_{name}", "m", ("body_ipos", (b, i), 1.0)) for i, axis in enumerate(AXES)
                ]
                if self._last(b):
                    self._load(b, name, (f"mass_{name}", f"inertia_{name}", *places))

    def _last(self, b: int) -> bool:
        """Whether no other body moves on this one, which has a joint."""
        model = self.model
        on = [
            int(model.body_weldid[model.body_parentid[c]]) for c in range(1, model.nbody) if model.body_weldid[c] == c
        ]
        return bool(model.body_jntnum[b]) and b not in on

    def _load(self, b: int, name: str, own: Sequence[str]) -> None:
        """A load that the model has not, fixed to a body."""
        x, y, z = (f"payload_{axis}_{name}" for axis in AXES)
        symbols = (f"payload_{name}", x, y, z)
        for symbol, unit in zip(symbols, ("kg", "m", "m", "m"), strict=True):
            self._enter(symbol, unit)
        self.loads.append(Load(b, symbols, tuple(own)))
        self.elements["payload", f"motion_{self.joints[int(self.model.body_jntadr[b])]}"] = symbols[0]

    def _gravity(self) -> None:
        """Its components; of a tilted base those that are 0 are not."""
        gravity = self.model.opt.gravity
        for i, axis in enumerate(AXES):
            symbol = self._enter(f"gravity_{axis}", "m/s^2", (GRAVITY, (i,), 1.0))
            if gravity.any() and not gravity[i]:
                self.elements[symbol, f"motion_{self.joints[0]}"] = symbol

    def _actuator(self, a: int) -> None:
        """Its control as an input; its parameters and its force, where it is a simple one on a joint."""
        model, name, kinds = self.model, self.actuators[a], self.mujoco
        gain, bias, gear = model.actuator_gainprm[a], model.actuator_biasprm[a], float(model.actuator_gear[a][0])
        biased = int(model.actuator_biastype[a]) == kinds.mjtBias.mjBIAS_AFFINE
        joint = int(model.actuator_trntype[a]) in (kinds.mjtTrn.mjTRN_JOINT, kinds.mjtTrn.mjTRN_JOINTINPARENT)
        simple = joint and int(model.actuator_gaintype[a]) == kinds.mjtGain.mjGAIN_FIXED
        simple &= biased or int(model.actuator_biastype[a]) == kinds.mjtBias.mjBIAS_NONE
        if not simple:
            self.inputs[name] = "1"
            return
        j = int(model.actuator_trnid[a][0])
        q, v, (way, force, _) = self.joints[j], f"v_{self.joints[j]}", self.units[j]
        length, speed = f"({gear!r} * {q})", f"({gear!r} * {v})"
        at: Setting = ("actuator_gainprm", (a, 0), 1.0)
        stiff, quick = (float(bias[i]) if biased else 0.0 for i in (1, 2))
        parts = [repr(float(bias[0]))] if biased and bias[0] else []
        if stiff and stiff == -gain[0]:  # a position controller
            unit, k = way, self._enter(f"kp_{name}", _over(force, way), at, ("actuator_biasprm", (a, 1), -1.0))
            parts.append(f"-{k} * {length}")
        elif quick and quick == -gain[0]:  # a velocity controller
            unit = f"{way}/s"
            k = self._enter(f"kv_{name}", _over(f"{force} s", way), at, ("actuator_biasprm", (a, 2), -1.0))
            parts, quick = [*parts, f"-{k} * {speed}"], 0.0
        else:
            plain = gain[0] == gear == 1.0
            unit, k = force if plain else "1", self._enter(f"gain_{name}", "1" if plain else force, at)
            parts += [f"{stiff!r} * {length}"] if stiff else []
        if quick:
            kv = self._enter(f"kv_{name}", _over(f"{force} s", way), ("actuator_biasprm", (a, 2), -1.0))
            parts.append(f"-{kv} * {speed}")
        self.inputs[name] = unit
        given = f"act_{name}" if f"act_{name}" in self.states else name
        given = _limited(given, model.actuator_ctrlrange[a]) if model.actuator_ctrllimited[a] else given
        total = " + ".join([f"{k} * {given}", *parts])
        total = _limited(total, model.actuator_forcerange[a]) if model.actuator_forcelimited[a] else total
        self.terms[j][name] = f"{gear!r} * ({total})"


def _limited(text: str, span: Any) -> str:
    low, high = map(float, span)
    return f"min(max({text}, {low!r}), {high!r})"


def _over(unit: str, way: str) -> str:
    return f"{unit}/{way}"
