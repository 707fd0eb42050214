"""Experiments until the right effect stands alone: those of `greygate next`, random ones, and multisines.

Twenty simulated rigs conceal an effect, and their first recording, short and of one kind of motion, leaves several
explanations. Then the loop runs by itself: an experiment is played on the rig, with fresh noise, and the new recording
alone is diagnosed, until one name stands alone or MOST experiments are done. Random and multisine experiments have the
duration of the first that `next` proposes, and the same limits: travel, rates, inputs, and outputs as the data sheet's
plant predicts them.
"""

import json
import shutil
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean, median
from typing import Annotated

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from greygate.mismatch import rig as rigs
from greygate.mismatch.concealed.conceal import EVERY_RIG, conceal
from greygate.mismatch.concealed.domains.integrate import FINE, Ways, acting, integrate
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.experiments.experiment import AMPLITUDES, Bounds, FreeRun, leg
from greygate.mismatch.proposing import propose
from greygate.mismatch.simulation import read
from greygate.plants.excitation import multisine

from .made import store, stored
from .shared import say, scratch, stopwatch

TAKES = "three minutes"
MOST = 4  # experiments on a rig
LONGEST = 3.0  # times the first recording, that an experiment may take
HOLDS = (4, 0.2)  # samples, and share of the experiment, between which a random level is held
BAND, FASTEST = 40, 0.1  # cycles in a multisine's length at its upper end; of the sampling rate, at most
MIDDLE = 0.5  # of the travel, about which a position swings
RAMP = 0.1  # of a multisine that a position takes to swing in
NAMES = {"friction_between": "dry_friction", "cubic_spring_between": "hardening_spring"}  # of ours -> of `conceal`
WAYS = ("next", "random", "multisine")
Inputs = dict[str, np.ndarray]


# -- rigs ------------------------------------------------------------------------------------------------------------


def sine(low: float, high: float, frequency: float) -> Callable[[int, float], np.ndarray]:
    """A sine that begins half way."""
    return lambda n, dt: (low + high) / 2 + (high - low) / 2 * np.sin(2 * np.pi * frequency * np.arange(n) * dt)


def swing(travel: float, frequency: float) -> Callable[[int, float], np.ndarray]:
    """A cosine of a position that begins at rest."""
    return lambda n, dt: travel / 2 * (1 - np.cos(2 * np.pi * frequency * np.arange(n) * dt))


def strokes(travel: float, speed: float, hardness: float) -> Callable[[int, float], np.ndarray]:
    """A position that goes to and fro at constant speed."""

    def path(n: int, dt: float) -> np.ndarray:
        out = leg(0.0, 1.0, speed / travel, hardness / travel, dt) * travel
        there = np.concatenate([out, travel - out])
        return np.concatenate([np.zeros(1), np.tile(there, n // len(there) + 1)])[:n]

    return path


@dataclass(frozen=True)
class Case:
    """A rig that conceals `effect`, and its first recording: `samples` of `motion`, one sample in `every` ms if given.

    told: whether rig.toml says the noise.
    """

    plant: str
    effect: str
    seed: int
    samples: int
    motion: Callable[[int, float], np.ndarray]
    every: int = 0
    told: bool = True

    @property
    def name(self) -> str:
        return f"{self.plant}: {self.effect}, seed {self.seed}{'' if self.told else ', noise not told'}"


STROKES = strokes(0.1, 0.05, 0.2)
CASES = (
    Case("cable_drum", "direction_slip", 1, 1500, STROKES, every=4),
    Case("cable_drum", "drift", 1, 1500, STROKES, every=4),
    Case("cable_drum", "acceleration_slip", 1, 1500, STROKES, every=4),
    Case("belt_drive", "drift", 2, 1250, swing(0.05, 0.125), every=4),
    Case("belt_drive", "scale_error", 2, 1250, swing(0.05, 0.125), every=4),
    Case("belt_drive", "rate_dependent_band", 2, 1250, swing(0.05, 0.125), every=4),
    Case("belt_drive", "rate_dependent_band", 4, 1250, swing(0.05, 0.125), every=4),
    Case("belt_drive", "inertial_stretch", 1, 1250, swing(0.05, 0.125), every=4),
    Case("motor", "square_damping", 1, 600, sine(-2, 2, 0.8)),
    Case("motor", "input_delay", 1, 600, sine(-2, 2, 0.8)),
    Case("motor", "input_delay", 3, 600, sine(-2, 2, 0.8)),
    Case("pendulum", "square_damping", 1, 600, sine(-0.3, 0.3, 0.3)),
    Case("thermal", "input_delay", 3, 300, sine(40, 160, 3e-4)),
    Case("thermal", "sensor_lag", 3, 300, sine(40, 160, 3e-4)),
    Case("thermal", "leak", 3, 300, sine(40, 160, 3e-4)),
    Case("electrical", "input_lag", 2, 600, sine(-1, 1, 300)),
    Case("quarter_car", "sensor_lag", 2, 600, sine(-0.01, 0.01, 0.8)),
    Case("slider", "input_lag", 1, 1200, sine(-2, 2, 0.3)),
    Case("slider", "input_delay", 2, 1200, sine(-2, 2, 0.3)),
    Case("thermal", "input_delay", 3, 300, sine(40, 160, 3e-4), told=False),
)


@dataclass
class Machine:
    """A rig in `folder`, and what it truly does: `run` gives the outputs of an input (samples,)."""

    folder: Path
    rig: rigs.Rig
    run: Callable[[np.ndarray], Mapping[str, np.ndarray]]
    noise: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def record(self, inputs: Mapping[str, np.ndarray], *seed: int) -> None:
        """Play the inputs with noise of its own, and write identify.csv."""
        ((name, signal),) = inputs.items()
        rng, shown = np.random.default_rng(seed), {name: np.asarray(signal, float)}
        for channel, clean in self.run(shown[name]).items():
            shown[channel] = clean + self.noise[channel][0] * rng.standard_normal(len(clean))
        for channel, signal in shown.items():
            step = self.noise[channel][1]
            shown[channel] = step * np.round(signal / step) if step else signal
        rows = np.column_stack([np.arange(len(shown[name])) * self.rig.dt, *shown.values()])
        header = ",".join(["t", *shown])
        np.savetxt(self.folder / "identify.csv", rows, "%.9g", delimiter=",", header=header, comments="")


def machine(case: Case, folder: Path) -> Machine:
    """Write the rig of a case to `folder`, without a recording."""
    made = _slider(case, folder) if case.plant == "slider" else _concealed(case, folder)
    channels = rigs.load(folder).channels
    noise = {name: (channel.noise, channel.resolution) for name, channel in channels.items()}
    if not case.told:
        text = (folder / "rig.toml").read_text().split("\n[channels.")
        bare = [part if "input" in part else _without(part, ("resolution", "noise_rms")) for part in text[1:]]
        (folder / "rig.toml").write_text("\n[channels.".join([text[0], *bare]))
    return Machine(folder, rigs.load(folder), made, noise)


def _without(text: str, entries: tuple[str, ...]) -> str:
    return "\n".join(line for line in text.split("\n") if not line.startswith(entries))


def _concealed(case: Case, folder: Path) -> Callable:
    conceal(case.plant, case.seed, folder, effect=case.effect, kind="one")
    answer = json.loads((folder / "sealed.json").read_text())
    for path in folder.iterdir():
        if path.suffix not in (".toml",):
            path.unlink()
    if case.every:
        text = (folder / "rig.toml").read_text()
        (folder / "rig.toml").write_text(text.replace("= 0.001\n", f"= {case.every * 1e-3!r}\n", 1))
    true, every = EVERY_RIG[case.plant], case.every or 1
    sheet = rigs.load(folder).datasheet
    parameters = {**sheet, **answer["parameters_true"]}
    (source,) = (channel.name for channel in true.channels if channel.role == "input")

    def run(signal: np.ndarray) -> Mapping[str, np.ndarray]:
        if every > 1:  # a position between its samples
            at = np.arange((len(signal) - 1) * every + 1) / every
            signal = CubicSpline(np.arange(len(signal)), signal)(at)
        found = true.predict({source: signal}, parameters, answer["effects_true"], float(answer["form"] == "variant"))
        return {name: s[::every] for name, s in found.items()}

    return run


SLIDER = """step = 1e-3
outputs = ["x"]
[inputs]
u = "V"
[parameters]
mass = [20.0, "kg"]
viscous = [300.0, "N s/m"]
motor = [40.0, "N/A"]
inductance = [0.01, "H"]
[states]
i = { unit = "A" }
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
[equations.coil]
i = { storage = "inductance", drive = "u", resistance = "-i" }
[equations.position]
x = { velocity = "v" }
[equations.motion]
v = { storage = "mass", motor = "motor * i", viscous = "-viscous * v" }
"""
SLIDER_RIG = """plant = "slider.toml"
sample_time_s = 0.005
predict = ["x"]
parameters = { mass = 20.0, viscous = 300.0, motor = 40.0, inductance = 0.01 }
tolerance = { viscous = 0.05, mass = 0.02 }
[channels.u]
unit = "V"
role = "input"
[channels.x]
unit = "m"
role = "output"
noise_rms = 2e-4
"""
SHARP = 1e-3  # m/s: below this speed dry friction is less than it is
HIDDEN = {"input_delay": 0.02, "input_lag": 0.02, "dry_friction": 5.0, "square_damping": 300.0}


@njit(cache=True)
def _sliding(s, u, t, p, e, d):
    mass, viscous, motor, inductance = p
    dry, square = e
    d[0] = (u[0] - s[0]) / inductance
    d[1] = s[2]
    d[2] = (motor * s[0] - viscous * s[2] - dry * np.tanh(s[2] / SHARP) - square * s[2] * abs(s[2])) / mass


def _slider(case: Case, folder: Path) -> Callable:
    """A linear motor; its seed draws the parameters inside their tolerances and the size of the effect."""
    folder.mkdir()
    (folder / "slider.toml").write_text(SLIDER)
    (folder / "rig.toml").write_text(SLIDER_RIG)
    rng = np.random.default_rng(case.seed)
    p = (20.0 * (1 + 0.01 * rng.standard_normal()), 300.0 * (1 + 0.025 * rng.standard_normal()), 40.0, 0.01)
    size = {case.effect: HIDDEN[case.effect] * float(np.exp(rng.uniform(-0.7, 0.7)))}
    dt = rigs.load(folder).dt

    def run(signal: np.ndarray) -> Mapping[str, np.ndarray]:
        ways = Ways(delay=size.get("input_delay", 0.0), lag=size.get("input_lag", 0.0))
        e = (size.get("dry_friction", 0.0), size.get("square_damping", 0.0))
        states = integrate(_sliding, acting(signal, dt, ways)[:, None], np.zeros(3), dt / FINE, p, e)
        return {"x": states[:-1:FINE, 1]}

    return run


# -- experiments -----------------------------------------------------------------------------------------------------


def random(bounds: Bounds, samples: int, dt: float, rng: np.random.Generator) -> Callable[[float], Inputs]:
    """Random levels, held for random times; positions move to them with random shares of their rates."""
    if bounds.positions:
        path = [np.array([_begin(bounds)])]
        while sum(map(len, path)) < samples:
            to, speed, hard = rng.uniform(0, 1), *rng.uniform(0.25, 1.0, 2)
            path.append(leg(path[-1][-1], to, speed * bounds.speed, hard * bounds.acceleration, dt))
            if rng.uniform() < 0.5:
                path.append(np.full(int(rng.uniform(0, HOLDS[1]) * samples), path[-1][-1]))
        way = np.concatenate(path)[:samples]
        return lambda size: _placed(bounds, way)
    wave: list[float] = []
    while len(wave) < samples:
        hold = np.exp(rng.uniform(np.log(HOLDS[0]), np.log(HOLDS[1] * samples)))
        wave += [rng.uniform(-1, 1)] * int(hold)
    return lambda size: _commanded(bounds, size * np.array(wave[:samples]))


def sines(bounds: Bounds, samples: int, dt: float, rng: np.random.Generator) -> Callable[[float], Inputs]:
    """A multisine of random phases; that of a position swings in, as large as travel and rates allow."""
    seconds = samples * dt
    fastest = min(BAND / seconds, FASTEST / dt)
    if not bounds.positions:
        wave = multisine(samples, 1.0, 1 / seconds, fastest, dt, int(rng.integers(2**31)))
        return lambda size: _commanded(bounds, size * wave)
    begin = _begin(bounds)
    lead = leg(begin, MIDDLE, bounds.speed, bounds.acceleration, dt) if begin != MIDDLE else np.zeros(0)
    wave = multisine(samples, 1.0, 1 / seconds, fastest, dt, int(rng.integers(2**31)))
    t = np.minimum(np.arange(samples) / (RAMP * samples), 1.0)
    wave = (wave - wave[0]) * (t - np.sin(2 * np.pi * t) / (2 * np.pi))
    speed = np.gradient(wave, dt)
    used = (np.max(np.abs(wave)) / MIDDLE, np.max(np.abs(speed)) / bounds.speed)
    wave /= max(*used, np.max(np.abs(np.gradient(speed, dt))) / bounds.acceleration)
    return lambda size: _placed(bounds, np.concatenate([lead, MIDDLE + wave])[:samples])


def _begin(bounds: Bounds) -> float:
    name = bounds.positions[0]
    return (bounds.rest[name] - bounds.low[name]) / (bounds.high[name] - bounds.low[name])


def _placed(bounds: Bounds, way: np.ndarray) -> Inputs:
    spans = {n: (bounds.low[n], bounds.high[n] - bounds.low[n]) for n in bounds.positions}
    moved = {n: low + span * np.clip(way, 0.0, 1.0) for n, (low, span) in spans.items()}
    return {n: moved.get(n, np.full(len(way), rest)) for n, rest in bounds.rest.items()}


def _commanded(bounds: Bounds, wave: np.ndarray) -> Inputs:
    signals = {n: rest + bounds.swing.get(n, 0.0) * wave for n, rest in bounds.rest.items()}
    return {n: np.clip(s, bounds.low[n], bounds.high[n]) for n, s in signals.items()}


# -- the loop --------------------------------------------------------------------------------------------------------


def said(folder: Path) -> dict:
    """Diagnose the recording in `folder`; the file stays there."""
    result = diagnose(rigs.load(folder))
    result.write(folder / "diagnosis.json")
    return read(folder / "diagnosis.json")


def explanations(found: dict) -> list[list[str]]:
    """Of every effect that a diagnosis names: its name and what it is not told apart from."""
    return [[NAMES.get(n, n) for n in (e["id"], *e["not_told_apart_from"])] for e in found["effects"]]


def alone(found: dict) -> str:
    """The name that stands alone; empty where none does."""
    names = explanations(found)
    return names[0][0] if len(names) == 1 and len(names[0]) == 1 and names[0][0] != "unknown" else ""


def right(name: str, effect: str) -> bool:
    """Whether a name says what is concealed; general effects bear the place after their name."""
    return name == effect or name.startswith(f"{effect}_")


def loop(machine: Machine, effect: str, first: dict, choose: Callable[[int, dict], Inputs | None]) -> dict:
    """Play what `choose` (of round and diagnosis) gives until one name stands alone."""
    found, rounds = first, []
    while not alone(found) and len(rounds) < MOST:
        watch = stopwatch()
        inputs = choose(len(rounds), found)
        if inputs is None:
            break
        machine.record(inputs, zlib.crc32(effect.encode()), len(rounds) + 1, len(next(iter(inputs.values()))))
        found = said(machine.folder)
        rounds.append({"verdict": found["verdict"], "explanations": explanations(found)})
        rounds[-1] |= {"seconds": watch(1)}
    name = alone(found)
    resolved = right(name, effect)
    return {"resolved": resolved, "experiments": len(rounds), "wrong": bool(name) and not resolved, "rounds": rounds}


def run(case: Case, work: Path) -> dict:
    """The loop of one case, three ways."""
    home = machine(case, work / "first")
    ((source, span),) = [(n, home.rig.channels[n].unit) for n in home.rig.inputs]
    home.record({source: case.motion(case.samples, home.rig.dt)}, case.seed)
    first = said(home.folder)
    out = {"case": case.name, "first": explanations(first), "seconds": case.samples * home.rig.dt, "unit": span}
    if alone(first) or not any(right(name, case.effect) for names in out["first"] for name in names):
        return out | {"ambiguous": False}
    longest = LONGEST * out["seconds"]
    played: list[dict] = []

    def proposed(folder: Path) -> Callable[[int, dict], Inputs | None]:
        def choose(round_: int, found: dict) -> Inputs | None:
            figures, _, tells = propose(folder, folder / "diagnosis.json", folder / "next.csv", longest=longest)
            if not tells:
                return None
            played.append({k: figures["experiment"][k] for k in ("shape", "seconds", "reach")})
            played[-1]["pairs"] = [[p["one"], p["other"], p["here"], round(p["then"], 2)] for p in figures["pairs"]]
            table = np.genfromtxt(folder / "next.csv", delimiter=",", names=True)
            return {name: table[name] for name in home.rig.inputs}

        return choose

    def drawn(make: Callable, seed: int) -> Callable[[int, dict], Inputs | None]:
        usual = {"seconds": out["seconds"], "reach": 1.0}
        seconds, reach = ((played or [usual])[0][key] for key in ("seconds", "reach"))
        recording = home.rig.recording(home.folder / "identify.csv")
        free = FreeRun(home.rig, {}, {})
        bounds = free.at_rest(Bounds.of(home.rig, recording, reach), recording, seconds / 4)

        def choose(round_: int, found: dict) -> Inputs | None:
            rng = np.random.default_rng([case.seed, round_, seed])
            inputs = make(bounds, round(seconds / home.rig.dt), home.rig.dt, rng)
            stood = (i for a in AMPLITUDES if free.record(i := inputs(a), bounds) is not None)
            return next(stood, inputs(AMPLITUDES[-1]))

        return choose

    for k, way in enumerate(WAYS):
        folder = Path(shutil.copytree(home.folder, work / way))
        there = Machine(folder, rigs.load(folder), home.run, home.noise)
        made = proposed(folder) if way == "next" else drawn(random if way == "random" else sines, k)
        out[way] = loop(there, case.effect, first, made)
    return out | {"ambiguous": True, "played": played}


def summary(found: list[dict]) -> dict:
    """Experiments until resolved, in the cases that each way resolves; MOST + 1 stands for unresolved in the median."""
    out = {}
    ambiguous = [case for case in found if case["ambiguous"]]
    for way in WAYS:
        counts = [c[way]["experiments"] for c in ambiguous if c[way]["resolved"]]
        all_ = [c[way]["experiments"] if c[way]["resolved"] else MOST + 1 for c in ambiguous]
        out[way] = {
            "resolved": len(counts),
            "unresolved": len(ambiguous) - len(counts),
            "wrong": sum(c[way]["wrong"] for c in ambiguous),
            "by_one": sum(count == 1 for count in counts),
            "median": median(all_) if all_ else None,
            "mean": round(mean(all_), 2) if all_ else None,
            "mean_where_resolved": round(mean(counts), 2) if counts else None,
        }
    return {"cases": len(ambiguous), "most": MOST, "unresolved_counts_as": MOST + 1, **out}


def main(*, only: Annotated[str, "part of a case's name"] = "") -> None:
    kept = {c["case"]: c for c in stored("next_experiments").get("cases", [])}  # a file that is deleted begins anew
    for case in CASES:
        if only not in case.name or case.name in kept:
            continue
        watch = stopwatch()
        with scratch() as folder:
            found = run(case, folder)
        kept[case.name] = found | {"wall": watch(1)}
        say(json.dumps(kept[case.name]))
        cases = [kept[c.name] for c in CASES if c.name in kept]
        store("next_experiments", {"summary": summary(cases), "cases": cases})
    print(json.dumps(summary([kept[c.name] for c in CASES if c.name in kept]), indent=1))
