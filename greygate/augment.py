"""A named effect as a module of the structured network: taught its law, joined, trained as one on the recording.

    diagnosis -> module (the law, as diagnosed) -> the network without it and with it -> Verilog

Both networks start from the diagnosed parameters and are trained alike, in free run on identify.csv. The law is that
of the table of effects; where the recording does not reach, the module rehearses it. holdout.csv is for the report.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from greygate.errors import InputError
from greygate.files import replaceable, replacing_folder
from greygate.machines.cable_drum.module import slip_sum
from greygate.machines.cable_drum.network import held
from greygate.machines.valve_cylinder.network import mean_spool, valve_srnn
from greygate.machines.valve_cylinder.plant import spool_discrete
from greygate.mismatch import effects as table
from greygate.mismatch.diagnosis import recovered
from greygate.mismatch.effects import Effect, join
from greygate.mismatch.rig import Rig, load
from greygate.mismatch.simulation import _form as form
from greygate.mismatch.simulation import check
from greygate.models.accuracy import free_run_rms
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record
from greygate.plants.plant import Values
from greygate.plants.recording import Recording
from greygate.progress import titled

FACTS = "augment.json"
RECORDINGS = ("identify", "holdout")
HIDDEN, SEED, EPOCHS, DECAY = 5, 0, 60, 1e-6
ROOM = 1.5  # times the recording's range, over which a module is taught its law
REHEARSAL = 0.1  # of a sample of the recording, that a sample of the law counts
DRUM_PERIOD = 0.02  # s, a sample of the drum's network: that of the thesis's sensor


@dataclass(frozen=True)
class Law:
    """What a module shall answer. reads: its signal, "v", "a", "between" or "outward" (structures `slip`, `cylinder`).

    at: (N,) values of that signal. answers: (N,), slip per travel or leakage in m^3/s.
    """

    reads: str
    at: np.ndarray
    answers: np.ndarray

    @property
    def reach(self) -> float:
        return float(np.abs(self.at).max())

    @property
    def size(self) -> float:
        return float(np.abs(self.answers).max())

    def record(self) -> Record:
        """Normalised, as the module's ports have it."""
        return Record({"s": self.at / self.reach}, {"y": self.answers / self.size})

    def module(self) -> Network:
        """A tanh network that has learnt the law."""
        taught = train(feedforward("missing", ["s"], [HIDDEN], SEED), [self.record()], epochs=200, decay=DECAY)
        return taught.network


class Drum:
    """The cable drum: slip [m], load less drum, from `x_drum`.

    needs: channels. starts: position that begins at 0. effects: name -> (place of its term, what its module reads).
    tied: parameters that training keeps equal.
    """

    needs, starts = ("x_drum", "x_load"), "x_drum"
    effects: ClassVar = {
        "speed_slip": ("slip", "v"),
        "direction_slip": ("slip", "v"),
        "acceleration_slip": ("slip", "a"),
    }
    tied = ()

    def __init__(self, rig: Rig, values: Mapping[str, float]):
        self.every = max(round(DRUM_PERIOD / rig.dt), 1)
        self.rig, self.values, self.period = rig, values, self.every * rig.dt

    def recording(self, recorded: Recording) -> Recording:
        """As the network samples it."""
        x, load = (recorded[name][:: self.every] for name in ("x_drum", "x_load"))
        return Recording(self.period, {"x_drum": x, "slip": load - x}, {"x_drum": "m", "slip": "m"}, recorded.source)

    def law(self, recorded: Recording, reads: str, term: Callable) -> Law:
        x = self.recording(recorded)["x_drum"]
        signal = np.diff(x) / self.period if reads == "v" else np.diff(x, 2) / self.period**2
        at = ROOM * np.abs(signal).max() * _grid()
        travel = at if reads == "v" else np.ones_like(at)
        return Law(reads, at, term(v=at, a=at, travel=travel) / travel)

    def network(self, recorded: Recording, law: Law | None) -> Network:
        r = self.recording(recorded)
        x, slip = (_port(name, r[name], "m", self.rig.channels.get(name)) for name in ("x_drum", "slip"))
        step = ROOM * float(np.abs(np.diff(r["x_drum"])).max())
        missing = None
        if law:
            missing = law.module(), law.reads, law.reach * self.period ** (2 if law.reads == "a" else 1), law.size
        return slip_sum(x, slip, step, self.values["creep"], missing)


class Valve:
    """The valve-controlled cylinder: chamber pressures [Pa] from `v_c` and `x`, what is known held."""

    needs, starts = ("v_c", "x", "p_a", "p_b"), "x"
    effects: ClassVar = {
        "internal_leakage": ("continuity_a", "between"),
        "external_leakage": ("continuity_a", "outward"),
    }
    tied = (("qa.gain.q", "qb.gain.q"), *((f"speed_a.d{n}", f"speed_b.d{n}") for n in range(4)))

    def __init__(self, rig: Rig, values: Mapping[str, float]):
        self.rig, self.values, self.period = rig, values, rig.dt

    def recording(self, recorded: Recording) -> Recording:
        units = {n: self.rig.channels[n].unit for n in self.needs}
        return Recording(self.period, {n: recorded[n] for n in self.needs}, units, recorded.source)

    def law(self, recorded: Recording, reads: str, term: Callable) -> Law:
        p_a, p_b = recorded["p_a"], recorded["p_b"]
        if reads == "between":
            at = ROOM * np.abs(p_a - p_b).max() * _grid()
        else:
            at = ROOM * max(p_a.max(), p_b.max()) * (1 + _grid()) / 2
        return Law(reads, at, -term(p_a=at, p_b=np.zeros_like(at)))

    def network(self, recorded: Recording, law: Law | None) -> Network:
        k = dict(self.values)
        k |= {"p_s": k["p_supply"], "p_a_rest": k["p_supply"] / 2, "p_b_rest": k["p_supply"] / 2}
        k |= {"area_a": k["area"], "area_b": k["area"], "q_max": k["k_valve"] * k["u_max"] * np.sqrt(k["p_supply"])}
        v_c, x = (_port(n, recorded[n], self.rig.channels[n].unit, self.rig.channels[n]) for n in ("v_c", "x"))
        plant = self.rig.plant.with_parameters(
            **{s: v for s, v in self.values.items() if s in self.rig.plant.parameters}
        )
        spool = mean_spool(*spool_discrete(plant, self.period), k["u_max"], v_c.scale)
        flow, divider = _scaled(library("flow")), _scaled(library("divider"))
        leakage = (law.module(), law.reads, law.reach, law.size / k["q_max"]) if law else None
        return valve_srnn(k, flow, divider, spool, v_c, x, self.period, leakage=leakage)


PLANTS = {"cable_drum": Drum, "valve_hydraulic": Valve}


def augment(folder: Path | str, diagnosis: Mapping, out: Path | str, say: Callable[[str], None] | None = None) -> dict:
    """Train the network of a rig's plant without and with the module of the diagnosed effect; write both to `out`.

    diagnosis: content of a diagnosis.json of this rig. Writes PLANT.toml and PLANT_EFFECT.toml with their numbers, the
    recordings as these networks read them, and augment.json, which is returned: RMS errors in free run by network
    and recording, neurons, seconds. Raises InputError for an effect that no module stands for.
    """
    say = say or (lambda text: None)
    replaceable(out, "augment")
    rig = load(folder)
    effect, found = _named(rig, diagnosis)
    kind = PLANTS[rig.plant.name]
    if missing := [name for name in kind.needs if name not in rig.channels]:
        raise InputError(f"{rig.folder / 'rig.toml'}: no channel {', '.join(missing)}; the network learns from it")
    recorded = {name: rig.recording(rig.folder / f"{name}.csv") for name in RECORDINGS}
    for r in recorded.values():
        if abs(first := r[kind.starts][0]) > 2 * rig.channels[kind.starts].sigma + 1e-9:
            raise InputError(f"{r.source}: {kind.starts} starts at {first:g} m, the network at 0; shift it there")
    values = {s: p.value for s, p in rig.plant.parameters.items()}
    values |= {s: float(p["value"]) for s, p in diagnosis["parameters"].items()} | found
    kind = kind(rig, values)
    place, reads = kind.effects[effect.id]
    plant, _ = join(rig.plant, [effect])
    (expression,) = (text for path, text in effect.terms.items() if path.startswith(f"{place}."))

    def term(**signals) -> np.ndarray:
        scope = Values(plant, signals)
        scope.update({s: v for s, v in values.items() if s in plant.parameters})
        return np.asarray(scope.evaluate(effect.lazily(expression)), float)

    say(f"teaching {effect.id}")
    law = kind.law(recorded["identify"], reads, term)
    records = {}
    for name, r in ((n, kind.recording(r)) for n, r in recorded.items()):
        inputs = {n: v for n, v in r.channels.items() if n in rig.inputs or n == "x"}
        records[name] = Record(inputs, {n: v for n, v in r.channels.items() if n not in inputs})
    networks, figures = {}, {}
    for name, module in ((rig.plant.name, None), (f"{rig.plant.name}_{effect.id}", law)):
        joined = replace(kind.network(recorded["identify"], module), name=name)
        own = [n for n in joined.modules if n.startswith(("missing", "leak"))]
        fit = train(
            joined,
            [records["identify"]],
            epochs=EPOCHS,
            decay=DECAY,
            rehearse={n: replace(law.record(), weight=REHEARSAL) for n in own},
            tied=(*kind.tied, *_alike(own)),
            progress=titled(say, name),
        )
        networks[name] = joined.with_parameters(fit.network.parameters())
        figures[name] = {
            "joined": {n: free_run_rms(joined, r) for n, r in records.items()},
            "trained": {n: free_run_rms(networks[name], r) for n, r in records.items()},
            "neurons": joined.neurons(),
            "seconds": round(fit.seconds, 2),
            "outcome": fit.outcome.value,
        }
    facts = {"plant": rig.plant.name, "effect": effect.id, "period_s": kind.period, "networks": figures}
    with replacing_folder(out, "augment") as new:
        for name, network in networks.items():
            network.save(new / name)
        for name, r in recorded.items():
            kind.recording(r).write_csv(new / f"{name}.csv")
        (new / FACTS).write_text(json.dumps(facts, indent=1) + "\n")
    return facts


def _named(rig: Rig, diagnosis: Mapping) -> tuple[Effect, dict[str, float]]:
    """The effect of which a module is made, and its parameters' values."""
    check(diagnosis)
    plant = rig.plant.name
    if diagnosis["plant"] != plant:
        raise InputError(f"diagnosis: is of {diagnosis['plant']}, the rig is {plant}; give the rig's own")
    if plant not in PLANTS:
        raise InputError(f"augment: no structured network of {plant}; there are {', '.join(PLANTS)}")
    names = [entry["id"] for entry in diagnosis["effects"]]
    known = PLANTS[plant].effects
    if len(names) != 1 or names[0] not in known:
        what = " and ".join(names) or "no effect"
        raise InputError(
            f"augment: the diagnosis names {what}; a module of {plant} stands for one of {', '.join(known)}"
        )
    entry = diagnosis["effects"][0]
    effect = form(table.read(), entry)
    if effect.states:  # a module has no memory of its own: the plain form of the same size
        effect = table.read()[effect.id]
    return effect, recovered(effect, entry["parameters"])


def _alike(modules: Sequence[str]) -> list[list[str]]:
    """Parameters of modules that stand for one law, to be tied."""
    names = feedforward("missing", ["s"], [HIDDEN], SEED).parameters()
    return [[f"{module}.{name}" for module in modules] for name in names] if len(modules) > 1 else []


def _grid() -> np.ndarray:
    """200 values from -1 to 1, of which none is 0."""
    return np.linspace(-1, 1, 200)


def _port(name: str, samples: np.ndarray, unit: str, channel) -> Port:
    """A port whose scale is a power of two times its sensor's resolution, with a quarter of room."""
    step = channel.resolution if channel and channel.resolution else 2.0**-40
    scale = step * 2.0 ** np.ceil(np.log2(1.25 * np.abs(samples).max() / step))
    return Port(name, unit, float(scale), resolution=channel.resolution if channel else 0.0)


def _scaled(network: Network) -> Network:
    """A library network held as it is, whose answer is multiplied by what training finds."""
    scaled = Network(network.name, network.inputs, network.outputs)
    scaled.add("known", held(network))
    scaled.add("gain", Layer({"q": [[1.0]]}, [0.0], frozen={"bias"}))
    for port in network.inputs:
        scaled.connect(port.name, f"known.{port.name}")
    scaled.connect("known", "gain.q")
    scaled.connect("gain", network.outputs[0].name)
    return scaled
