"""A linear axis driven by a force: a double integrator whose friction depends on the direction.

    M dv/dt = F - friction(v, q),   dq/dt = v
    friction(v, q) = F_v v + F_+ max(v, 0) + F_c tanh(v / v_s) + F_0 + residual(v, q)

Steps are semi-implicit Euler (the new speed moves the position), stable while F_c dt < M v_s. With equal
directions it is the model of Janot, Gautier, Brunot, Data Set and Reference Models of EMPS (2019).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record

FORCE = Port("f_motor", "N", 128.0)
POSITION = Port("position", "m", 0.256)
SPEED = 0.25  # m/s, normal speed: position / (1024 dt), so that a step of the position is speed * 2^-10
STANDSTILL = 1e-3  # m/s, speed at which Coulomb friction is at tanh(1) of its value


def axis(
    mass: float = 95.0,
    viscous: float = 200.0,
    coulomb: float = 20.0,
    offset: float = 0.0,
    *,
    hidden: int = 0,
    seed: int = 0,
    period: float = 1e-3,
) -> Network:
    """Position [m] from force [N]. mass in kg, viscous in N s/m, coulomb and offset in N: where training starts.

    hidden: tanh neurons of the residual, which sees speed and position. period in s. Hardware starts at rest at the
    origin: see `starting`.
    """
    step = period * FORCE.scale / (mass * SPEED)
    network = Network("axis", [FORCE], [POSITION], dt=period)
    parts: dict[str, ArrayLike] = {
        "force": [[1.0]],
        "v": [[-viscous * SPEED / FORCE.scale]],
        "forward": [[0.0]],
        "sign": [[-coulomb / FORCE.scale]],
    }
    network.add("sign", Layer({"v": [[SPEED / STANDSTILL]]}, [0.0], "tansig", frozen={"v", "bias"}))
    network.add("forward", Layer({"v": [[1.0]]}, [0.0], "satlin", frozen={"v", "bias"}))
    network.connect("speed", "sign.v", delay=1)
    network.connect("speed", "forward.v", delay=1)
    if hidden:
        rng = np.random.default_rng(seed)
        w = {"v": 2 * rng.normal(size=(hidden, 1)), "q": 2 * rng.normal(size=(hidden, 1))}
        network.add("residual", Layer(w, rng.normal(size=hidden), "tansig"))
        network.connect("speed", "residual.v", delay=1)
        network.connect("place", "residual.q", delay=1)
        parts["residual"] = np.zeros((1, hidden))
    network.add("balance", Layer(parts, [-offset / FORCE.scale], frozen={"force"}))
    network.connect(FORCE.name, "balance.force", delay=1)
    network.connect("speed", "balance.v", delay=1)
    for part in set(parts) - {"force", "v"}:
        network.connect(part, f"balance.{part}")
    network.add("speed", Layer({"v": [[1.0]], "balance": [[1.0]]}, [0.0], frozen={"v", "bias"}))
    network.connect("speed", "speed.v", delay=1)
    network.connect("balance", "speed.balance", gain=step)
    network.add("place", Layer({"q": [[1.0]], "v": [[1.0]]}, [0.0], frozen={"q", "v", "bias"}))
    network.connect("place", "place.q", delay=1)
    network.connect("speed", "place.v", gain=period * SPEED / POSITION.scale)
    network.connect("place", POSITION.name)
    return network.check()


def moving(record: Record, start: int, stop: int, window: int, period: float = 1e-3) -> Record:
    """Samples start..stop, which do not count before `window`, with the state that they start from.

    A cubic through the first `window` positions gives position and speed.
    """
    position = POSITION.normalised(record.targets[POSITION.name])
    steps = 1 + np.arange(window)  # the state is that of the step before
    cubic = np.polyfit(steps, position[start : start + window], 3)
    before, place = np.polyval(cubic, (-1, 0))
    state = {"place": place, "speed": (place - before) * POSITION.scale / (period * SPEED)}
    drive = {FORCE.name: float(record.inputs[FORCE.name][max(start - 1, 0)])}
    return record.cut(start, stop, initial=drive | state, skip=window)


def starting(network: Network, record: Record) -> Network:
    """The flat network whose hardware starts with the position, speed and force of the record."""
    flat, state = network.flatten(), record.initial
    return replace(
        flat,
        inputs=[replace(p, initial=float(state.get(p.name, p.initial))) for p in flat.inputs],
        modules={
            n: replace(layer, initial=np.asarray(state.get(n, layer.initial))) for n, layer in flat.layers().items()
        },
    )
