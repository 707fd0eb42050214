"""The network of the timing-belt drive: eight experts, switches, XOR and latches (thesis 4.5, figure 4.10).

From the encoder's position alone it tracks five states: direction, change of direction, latched position, latched
error, boundary reached. A motion that turned at position p with error q (including the play of the gears) follows

    path(k) = q + d(p, engaged(k) - p)    until it crosses    boundary(k) = e(engaged(k))

The carriage stands while the motor winds the belt back and crosses the play, which a play operator follows
(Krasnosel'skii and Pokrovskii 1989). The machine reads the position at which the motor drives the carriage, `engaged`:
where it drove it last, until all the play is crossed. Only then the direction changes. What the motor has gone in the
play is added to the error, so a turn that is taken back sooner leaves no trace.

p and q are latched when the direction changes: on a boundary they are the last position and error; inside the band they
are the point of the boundary from which a path would lead here (`sp`). There is one of each expert per direction.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from greygate.errors import InputError
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port

COUNT = 1e-5  # m, of the encoder
X_SCALE = COUNT * 2**14  # m; a count is an exact binary fraction
X = Port("x", "m", X_SCALE, offset=0.15, resolution=COUNT)
E = Port("e", "m", 1e-6 * 2**8)
REACH = 0.040 / X_SCALE  # of a path from where it began
MOVED = 2.0**9  # gain from position to motion
HALF_COUNT = MOVED * 2.0**-15
PLAY = 20 * COUNT  # m of the motor, over which the carriage stands after a turn
FAR = 100.0  # reach of a switch: its tanh form then keeps a latched value unchanged over thousands of steps
DIRECTIONS = ("forward", "backward")
EXPERTS = tuple(f"{part}_{way}" for part in ("e", "d", "sp", "b") for way in DIRECTIONS)


def belt_machine(experts: Mapping[str, Network], play: float = PLAY) -> Network:
    """Position error `e` [m] from encoder position `x` [m].

    experts, by the names of `EXPERTS`, normalised as `X` and `E`:
    `e`: `x` -> error on the boundary; `d`: `start`, `away` (over `REACH`) -> error since the start of the path;
    `sp`: `x`, `e` -> `y` (2,): start less x (over `REACH`), error there; `b`: `x` -> jump of the error at a reversal.
    play: m of the motor, over which the carriage stands after a turn; whole counts, as half a count is no motion.
    It starts on the lower boundary at x = 0, moving forward. Raises InputError for an expert that is missing.
    """
    if missing := [name for name in EXPERTS if name not in experts]:
        raise InputError(f"belt drive: no expert {', '.join(missing)}; give {', '.join(EXPERTS)}")
    home = -X.offset / X.scale
    rest = float(experts["e_forward"].run({"x": np.full((1, 1), home)})["y"][0, 0])
    machine = Network("belt_drive", [X], [replace(E, initial=rest * E.scale)])

    def logic(name: str, kind: str, initial: float = 0.0, **sources: tuple) -> None:
        """A library network; sources: port -> (source, delay, gain)."""
        arguments = {"reach": FAR} if kind == "switch_2" else {}
        module = library(kind, **arguments)
        module.modules["out"] = replace(module.layers()["out"], initial=np.asarray(initial))
        machine.add(name, module)
        connect(name, sources)

    def total(
        name: str, weights: Mapping[str, float], bias: float = 0.0, initial: float = 0.0, **sources: tuple
    ) -> None:
        ports = {port: [[weight]] for port, weight in weights.items()}
        machine.add(name, Layer(ports, [bias], initial=initial, frozen={*ports, "bias"}))
        connect(name, sources)

    def connect(name: str, sources: Mapping[str, tuple]) -> None:
        for port, (source, *rest) in sources.items():
            machine.connect(source, f"{name}.{port}", *rest)

    def either(name: str, part: str, gain: np.ndarray | None = None, **sources: tuple) -> None:
        """The answer of the expert of the present direction."""
        for way in DIRECTIONS:
            if f"{part}_{way}" not in machine.modules:
                machine.add(f"{part}_{way}", experts[f"{part}_{way}"])
                connect(f"{part}_{way}", sources)
        u1, u2 = ((f"{part}_{way}", 0, gain) for way in DIRECTIONS)
        logic(name, "switch_2", s=("direction",), u1=u1, u2=u2)

    whole = play / X.scale
    machine.add(
        "in_play", library("limiter", lo=0.0, hi=whole)
    )  # 0: on the flank that drives forward; whole: the other
    for source, delay, gain in (("in_play", 1, 1.0), ("x", 0, -1.0), ("x", 1, 1.0)):
        machine.connect(source, "in_play.x", delay, gain)
    moved = {"now": MOVED, "before": -MOVED, "in_play": MOVED, "was_in_play": -MOVED}
    total("moved", moved, now=("x",), before=("x", 1), in_play=("in_play",), was_in_play=("in_play", 1))
    logic("direction", "sign", 1.0, x=("moved",))
    machine.connect("direction", "direction.x", delay=1, gain=HALF_COUNT)  # at rest it stays what it was
    logic("changed", "xor", u1=("direction",), u2=("direction", 1))

    behind = {"in_play": 1.0, "direction": 0.5 * whole}  # how far the motor has gone in the play
    total("behind", behind, -0.5 * whole, in_play=("in_play",), direction=("direction",))
    total("engaged", {"x": 1.0, "behind": 1.0}, initial=home, x=("x",), behind=("behind",))

    either("play", "b", x=("engaged", 1))
    total("turn", {"error": 1.0, "play": 1.0}, error=("error", 1), play=("play",))
    either("start_away", "sp", np.array([[1.0, 0.0]]), x=("engaged", 1), e=("turn",))
    either("start_error", "sp", np.array([[0.0, 1.0]]))
    total("start", {"x": 1.0, "away": REACH}, x=("engaged", 1), away=("start_away",))
    for name, latch, here, inside, initial in (
        ("begun_at", "position", ("engaged", 1), ("start",), home),
        ("begun_with", "error_there", ("turn",), ("start_error",), rest),
    ):
        logic(name, "switch_2", u1=here, u2=inside, s=("reached", 1))
        logic(latch, "switch_2", initial, u1=(name,), u2=(latch, 1), s=("changed",))

    total("gone", {"x": 1 / REACH, "start": -1 / REACH}, x=("engaged",), start=("position",))
    machine.add("away", library("limiter", lo=-1.0, hi=1.0))
    machine.connect("gone", "away.x")
    either("slipped", "d", start=("position",), away=("away",))
    total("path", {"start": 1.0, "slipped": 1.0}, start=("error_there",), slipped=("slipped",))
    either("boundary", "e", x=("engaged",))

    total("beyond", {"boundary": 1.0, "path": -1.0}, boundary=("boundary",), path=("path",))
    logic("across", "switch_2", u1=("beyond",), u2=("beyond", 0, -1.0), s=("direction",))
    logic("beyond_it", "sign", x=("across",))
    total("keeps", {"reached": 1.0, "changed": -1.0}, -1.0, reached=("reached", 1), changed=("changed",))
    logic("held", "sign", x=("keeps",))
    total("one_of", {"beyond": 1.0, "held": 1.0}, 1.0, beyond=("beyond_it",), held=("held",))
    logic("reached", "sign", 1.0, x=("one_of",))
    logic("error", "switch_2", rest, u1=("boundary",), u2=("path",), s=("reached",))
    shown = {"error": 1.0, "behind": X.scale / E.scale}
    total("shown", shown, initial=rest, error=("error",), behind=("behind",))
    machine.connect("shown", "e")
    return machine.check()
