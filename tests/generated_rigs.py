"""Random valid rigs: any plant, any time scale, any noise. The same seed makes the same folder.

`make(seed, folder)` writes `plant.toml`, `rig.toml`, `identify.csv`, mostly `holdout.csv` and `effects.toml`, and
returns what was drawn. The recordings are small (a few hundred samples), so that a diagnosis takes seconds. They come
from an integrator of their own (Runge-Kutta 4 in plain Python), not from the product's.

Equations and effects are drawn by the remainder of the seed, all else (sizes, time scale, noise, what is told and what
is concealed) by the seed: compiling equations takes longer than a diagnosis of so few samples.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

KINDS = ("network", "chain", "static", "decay", "imposed", "defined")
TOLD = ("noise", "resolution", "both", "none", "some")
STRUCTURES = 42  # sets of equations with their effects
SHORT = 40  # samples of the shortest recordings
FUNCTIONS = {"sqrt": np.sqrt, "tanh": np.tanh, "sin": np.sin, "exp": np.exp, "abs": abs, "max": max, "min": min}
UNITS = ("K", "V", "m", "Pa", "kg", "1", "rad")


@dataclass
class Rig:
    """A rig while it is drawn: its structure by `form`, its numbers by `rng`.

    truth: terms that the plant's file does not have. off: values that the data sheet does not have.

    parameters: symbol -> (value, unit, tolerance). equations: name -> (state, storage, terms). definitions: name ->
    (symbol, unit, terms). signals: input -> (samples,). size: channel -> its expected size.
    """

    kind: str
    dt: float
    samples: int
    rng: np.random.Generator
    form: np.random.Generator
    parameters: dict = field(default_factory=dict)
    states: dict = field(default_factory=dict)
    inputs: dict = field(default_factory=dict)
    derived: dict = field(default_factory=dict)
    equations: dict = field(default_factory=dict)
    definitions: dict = field(default_factory=dict)
    predict: list = field(default_factory=list)
    size: dict = field(default_factory=dict)
    truth: dict = field(default_factory=dict)
    off: dict = field(default_factory=dict)
    traits: list = field(default_factory=list)

    def parameter(self, symbol: str, value: float, unit: str = "1", share: float = 0.5) -> str:
        """Declare a parameter, with a tolerance in `share` of the cases."""
        known = self.rng.random() > share
        self.parameters[symbol] = (value, unit, 0.0 if known else float(self.rng.choice([0.02, 0.1, 0.3])))
        return symbol

    def chance(self, share: float, trait: str) -> bool:
        """Whether a trait that `share` of the rigs have is drawn; then it is noted."""
        return self._noted(self.rng, share, trait)

    def formed(self, share: float, trait: str) -> bool:
        """The same for a trait of the structure."""
        return self._noted(self.form, share, trait)

    def _noted(self, rng: np.random.Generator, share: float, trait: str) -> bool:
        if drawn := bool(rng.random() < share):
            self.traits.append(trait)
        return drawn


def make(seed: int, folder: Path) -> dict:
    """Write the rig of `seed` to `folder` (made if it is missing) and return its traits."""
    rng, form = np.random.default_rng(seed), np.random.default_rng(seed % STRUCTURES)
    kind = KINDS[seed % len(KINDS)]
    dt = float(f"{10 ** rng.uniform(-6, np.log10(60)):.3g}")
    rig = Rig(kind, dt, SHORT if rng.random() < 0.1 else int(rng.integers(120, 420)), rng, form)
    PLANTS[kind](rig)
    _decorate(rig)
    _conceal(rig)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "plant.toml").write_text(_plant(rig))
    effects = _effects(rig)
    if effects:
        (folder / "effects.toml").write_text(effects)
    signals = {name: _signal(rig, name) for name in rig.inputs if name not in rig.derived and name != "t"}
    recorded = _recorded(rig, signals)
    if not all(np.isfinite(v).all() for v in recorded.values()):  # what is concealed has made it unstable
        rig.truth.clear()
        rig.traits.append("unstable, so nothing concealed")
        recorded = _recorded(rig, signals)
    rig.size = {name: max(float(np.abs(v).max()), 1e-12) for name, v in recorded.items()}
    sheet, noise = _sheet(rig, recorded)
    (folder / "rig.toml").write_text(sheet)
    _write(folder / "identify.csv", rig, recorded, noise)
    if rig.chance(0.8, "holdout"):
        grow = 30.0 if rig.chance(0.15, "wild holdout") else 1.0
        again = {name: grow * _signal(rig, name) for name in signals}
        held = _recorded(rig, again)
        held = {name: np.clip(np.nan_to_num(v), -1e12, 1e12) for name, v in held.items()}
        _write(folder / "holdout.csv", rig, held, noise)
    return {"seed": seed, "kind": kind, "dt": dt, "samples": rig.samples, "traits": rig.traits}


# -- plants ------------------------------------------------------------------------------------------------------------


def _network(rig: Rig) -> None:
    """Storages that leak and exchange, driven by inputs: tanks, heat, voltages."""
    rng, form, unit = rig.rng, rig.form, str(rig.rng.choice(UNITS))
    count = int(form.integers(1, 5))
    for j in range(int(form.integers(1, 3))):
        rig.inputs[f"u{j}"] = str(rng.choice(UNITS))
    slow, size = rig.dt * rng.uniform(6, 40), 10 ** rng.uniform(-4, 4)
    for i in range(count):
        x, c = f"x{i}", 10 ** rng.uniform(-2, 2)
        rig.states[x] = {"unit": unit}
        rig.parameter(f"c{i}", c, "1", 0.1)
        rig.parameter(f"g{i}", c / (slow * rng.uniform(0.5, 2)), "1", 0.7)
        terms = {"leak": f"-g{i} * {x}"}
        if i < len(rig.inputs):
            rig.parameter(f"b{i}", size * c / slow, "1", 0.3)
            terms["drive"] = f"b{i} * u{i}"
        if i:
            rig.parameter(f"k{i}", c / slow, "1", 0.3)
            terms["exchange"] = f"k{i} * (x{i - 1} - {x})"
        rig.equations[f"balance{i}"] = (x, f"c{i}", terms)
    rig.predict = [f"x{i}" for i in sorted(form.choice(count, int(form.integers(1, count + 1)), replace=False))]


def _chain(rig: Rig) -> None:
    """One or two masses on springs, pulled by a force."""
    rig.inputs["force"] = "N"
    _masses(rig, 10 ** rig.rng.uniform(-3, 1), {"drive": "force"})


def _masses(rig: Rig, size: float, first: dict, anchor: str = "0.0", speed: str = "0.0") -> None:
    """Masses in a row; the spring and the damper of the first end at `anchor`, which moves with `speed`."""
    rng, form, slow = rig.rng, rig.form, rig.dt * rig.rng.uniform(3, 10)
    unit, mass = str(rng.choice(["m", "rad"])), 10 ** rng.uniform(-2, 2)
    for i in range(int(form.integers(1, 3))):
        x, v, m = f"x{i}", f"v{i}", mass * rng.uniform(0.7, 1.5)
        rig.states |= {x: {"unit": unit, "rate": v}, v: {"unit": f"{unit}/s"}}
        rig.parameter(f"m{i}", m, "kg", 0.1)
        rig.parameter(f"k{i}", m / slow**2, "N/m", 0.6)
        rig.parameter(f"d{i}", 0.4 * m / slow, "N s/m", 0.6)
        before, its = (f"x{i - 1}", f"v{i - 1}") if i else (anchor, speed)
        pull = f"k{i} * ({before} - {x}) + d{i} * ({its} - {v})"
        rig.equations |= {f"position{i}": (x, "1", {"velocity": v}), f"motion{i}": (v, f"m{i}", {"spring": pull})}
        if i:
            rig.equations["motion0"][2]["back"] = f"-({pull})"
        elif "drive" in first:
            rig.parameter("gain", size * m / slow**2, "1", 0.3)
            rig.equations["motion0"][2]["drive"] = f"gain * {first['drive']}"
    rig.predict = ["x0"] if form.random() < 0.6 else [x for x in rig.states if x.startswith("x")]
    if form.random() < 0.2:
        rig.predict = ["v0"]


def _static(rig: Rig) -> None:
    """Outputs that are functions of the inputs of the same instant."""
    rng, form = rig.rng, rig.form
    for j in range(int(form.integers(1, 3))):
        rig.inputs[f"u{j}"] = str(rng.choice(UNITS))
    if rig.formed(0.3, "time"):
        rig.inputs["t"] = "s"
    for i in range(int(form.integers(1, 3))):
        y, size = f"y{i}", 10 ** rng.uniform(-6, 6)
        rig.parameter(f"a{i}", size, "1", 0.9)
        rig.parameter(f"b{i}", 0.3 * size, "1", 0.5)
        terms = {"line": f"a{i} * u0", "bend": f"b{i} * {form.choice(['u0 * u0', 'tanh(u0)', 'abs(u0)'])}"}
        if "u1" in rig.inputs:
            rig.parameter(f"e{i}", size, "1", 0.5)
            terms["other"] = f"e{i} * u1"
        if "t" in rig.inputs:
            rig.parameter(f"drift{i}", 0.2 * size / (rig.dt * rig.samples), "1/s", 0.5)
            terms["drift"] = f"drift{i} * t"
        rig.definitions[f"law{i}"] = (y, str(rng.choice(UNITS)), terms)
        rig.predict.append(y)


def _decay(rig: Rig) -> None:
    """A plant without inputs: it starts somewhere and comes to rest."""
    if rig.form.random() < 0.5:
        _network(rig)
        rig.inputs.clear()
        for _, _, terms in rig.equations.values():
            terms.pop("drive", None)
        rig.parameters = {s: p for s, p in rig.parameters.items() if not s.startswith("b")}
    else:
        _masses(rig, 1.0, {})
    for x in list(rig.states):
        if not x.startswith("v"):
            size = rig.rng.choice([1.0, -1.0]) * 10 ** rig.rng.uniform(-3, 3)
            free = rig.form.random() < 0.4
            if free:
                rig.parameter(f"{x}_start", float(size), rig.states[x]["unit"], 0.7)
            rig.states[x]["initial"] = f"{x}_start" if free else float(size)


def _imposed(rig: Rig) -> None:
    """Masses whose first spring and damper hang on a recorded motion, or a follower that answers to its rate."""
    how = str(rig.form.choice(["rate", "smooth_rate"]))
    rig.traits.append(f"derived {how}")
    rig.inputs |= {"base": "m", "base_rate": "m/s"}
    rig.derived["base_rate"] = f"{how} base"
    _masses(rig, 1.0, {}, "base", "base_rate")
    if rig.formed(0.3, "derived smooth_acceleration"):
        rig.inputs["base_acc"] = "m/s^2"
        rig.derived["base_acc"] = "smooth_acceleration base"
        rig.parameter("inertial", 0.1 * rig.parameters["m0"][0], "kg", 0.9)
        rig.equations["motion0"][2]["inertial"] = "-inertial * base_acc"


def _defined(rig: Rig) -> None:
    """A network of which not a state but what is made of it is recorded."""
    _network(rig)
    x = str(rig.form.choice(list(rig.states)))
    scale = 10 ** rig.rng.uniform(-3, 3)
    rig.parameter("sense", scale, "1", 0.6)
    law = str(rig.form.choice([f"sense * {x}", f"sense * {x} * abs({x})", f"sense * {x} + sense * u0"]))
    rig.definitions["output"] = ("z", str(rig.rng.choice(UNITS)), {"law": law})
    rig.predict = ["z", x] if rig.form.random() < 0.4 else ["z"]
    if rig.formed(0.3, "derived integral"):
        rig.inputs["w"], rig.derived["w"] = "1", "integral u0"
        rig.parameter("wind", scale / (rig.dt * rig.samples), "1", 0.9)
        rig.definitions["output"][2]["wound"] = "wind * w"


PLANTS = dict(zip(KINDS, (_network, _chain, _static, _decay, _imposed, _defined), strict=True))


def _decorate(rig: Rig) -> None:
    """Limits, a parameter that is 0, a storage that never moves; at least one parameter is uncertain."""
    first = next(iter(rig.parameters))
    if rig.formed(0.25, "zero parameter with a tolerance"):
        rig.parameters["nought"] = (0.0, "1", 0.1)
        place = next(iter(rig.equations.values()))[2] if rig.equations else next(iter(rig.definitions.values()))[2]
        place["nought"] = "nought * " + (next(iter(rig.states)) if rig.states else "u0")
    if rig.equations and rig.formed(0.15, "constant output"):
        rig.states["still"] = {"unit": "Pa", "initial": 5.0}
        rig.equations["tightness"] = ("still", "1", {"leak": "-tight * still"})
        rig.parameters["tight"] = (0.0, "1/s", 0.0)
        rig.predict.append("still")
    if rig.kind == "network" and rig.chance(0.2, "limits"):
        rig.states["x0"] |= {"low": -1e9, "high": 1e9}
    if not any(p[2] and p[0] for p in rig.parameters.values()):
        value, unit, _ = rig.parameters[first]
        rig.parameters[first] = (value, unit, 0.1)


def _conceal(rig: Rig) -> None:
    """What the real machine has and the plant's file has not."""
    rng = rig.rng
    for symbol, (value, _, tolerance) in rig.parameters.items():
        rig.off[symbol] = value * (1 + 0.5 * tolerance * float(np.clip(rng.standard_normal(), -2, 2)))
    what = str(rng.choice(["nothing", "parameter", "cubic", "load", "late"]))
    rig.traits.append(f"concealed {what}")
    if what == "parameter":
        symbol = str(rng.choice([s for s, p in rig.parameters.items() if p[2] and p[0]]))
        rig.off[symbol] *= 2.0
    if what in ("cubic", "load") and rig.equations:
        name = str(rng.choice([n for n, e in rig.equations.items() if not n.startswith(("position", "tight"))]))
        state, storage, _ = rig.equations[name]
        pace = rig.off.get(storage, 1.0) / (20 * rig.dt)
        rig.truth[name] = f"-{pace!r} * {state} * tanh(abs({state}))" if what == "cubic" else f"{0.1 * pace!r}"
    if what == "late":
        rig.truth["late"] = "2"


# -- recordings --------------------------------------------------------------------------------------------------------


def _signal(rig: Rig, name: str) -> np.ndarray:
    """An input: steps, a smooth motion, or, seldom, a constant."""
    rng, n = rig.rng, rig.samples
    if rig.chance(0.06, f"constant {name}"):
        return np.full(n, float(rng.choice([0.0, 1.0])))
    if rng.random() < 0.5 and name != "base":
        hold = int(rng.integers(3, 15))
        return np.repeat(rng.standard_normal(n // hold + 1), hold)[:n]
    t, out = np.arange(n) / n, np.zeros(n)
    for _ in range(4):
        out += rng.standard_normal() * np.sin(2 * np.pi * (rng.uniform(1, n / 12) * t + rng.random()))
    return out - (out[0] if name == "base" else 0.0)


def _recorded(rig: Rig, signals: dict) -> dict[str, np.ndarray]:
    """Channel -> (samples,): the machine as it is, by Runge-Kutta 4 with two steps a sample, without noise."""
    late = int(rig.truth.get("late", "0"))
    given = {n: np.concatenate((np.full(late, s[0]), s[: len(s) - late])) for n, s in signals.items()}
    for name, how in rig.derived.items():
        kind, source = how.split()
        given[name] = _derive(kind, given[source], rig.dt)
    if "t" in rig.inputs:
        given["t"] = np.arange(rig.samples) * rig.dt
    sums = {n: compile(" + ".join(terms.values()), n, "eval") for n, (_, _, terms) in rig.definitions.items()}
    rates = {}
    for n, (_, storage, terms) in rig.equations.items():
        texts = [*terms.values(), *([rig.truth[n]] if n in rig.truth else [])]
        rates[n] = compile(f"({' + '.join(f'({t})' for t in texts)}) / ({storage})", n, "eval")
    values = {s: rig.off.get(s, p[0]) for s, p in rig.parameters.items()}

    def slopes(x, now):
        scope = {**FUNCTIONS, **values, **now, **dict(zip(rig.states, x, strict=True))}
        return np.array([eval(rates[n], {"__builtins__": {}}, scope) for n in _ordered(rig)], float)

    x = np.array([values.get(s.get("initial", 0.0), s.get("initial", 0.0)) for s in rig.states.values()], float)
    out = {name: np.empty(rig.samples) for name in rig.predict}
    h = rig.dt / 2
    with np.errstate(all="ignore"):
        for k in range(rig.samples):
            now = {name: s[k] for name, s in given.items()}
            scope = {**FUNCTIONS, **values, **now, **dict(zip(rig.states, x, strict=True))}
            for n, (symbol, _, _) in rig.definitions.items():
                scope[symbol] = eval(sums[n], {"__builtins__": {}}, scope)
            for name in rig.predict:
                out[name][k] = scope[name]
            for _ in range(2 if len(x) else 0):
                a = slopes(x, now)
                b = slopes(x + h / 2 * a, now)
                c = slopes(x + h / 2 * b, now)
                x = x + h / 6 * (a + 2 * b + 2 * c + slopes(x + h * c, now))
    return {**signals, **out}


def _ordered(rig: Rig) -> list[str]:
    """The equations in the order of the states."""
    by_state = {state: name for name, (state, _, _) in rig.equations.items()}
    return [by_state[s] for s in rig.states]


def _derive(kind: str, signal: np.ndarray, dt: float) -> np.ndarray:
    if kind == "integral":
        return np.concatenate(([0.0], np.cumsum(signal[:-1]) * dt))
    rate = np.append(np.diff(signal) / dt, 0.0)
    return np.gradient(rate, dt) if kind == "smooth_acceleration" else rate


def _write(path: Path, rig: Rig, recorded: dict, noise: dict) -> None:
    """A CSV: each output with its noise, then rounded to its converter's steps."""
    columns = [np.arange(rig.samples) * rig.dt]
    for name, signal in recorded.items():
        sigma, step = noise.get(name, (0.0, 0.0))
        signal = signal + sigma * rig.rng.standard_normal(len(signal))
        columns.append(np.round(signal / step) * step if step else signal)
    table = np.column_stack(columns)
    np.savetxt(path, table, delimiter=",", header=",".join(("t", *recorded)), comments="", fmt="%.12g")


# -- files -------------------------------------------------------------------------------------------------------------


def _plant(rig: Rig) -> str:
    """Content of the plant's file."""
    step = rig.dt if rig.rng.random() < 0.5 else rig.dt / 2
    lines = [f"step = {step!r}", f"outputs = {json.dumps(rig.predict)}", "[inputs]"]
    lines += [f"{name} = {json.dumps(unit)}" for name, unit in rig.inputs.items()]
    lines += ["[derived]", *(f"{name} = {json.dumps(how)}" for name, how in rig.derived.items())] if rig.derived else []
    lines += ["[parameters]", *(f"{s} = [{v!r}, {json.dumps(u)}]" for s, (v, u, _) in rig.parameters.items())]
    lines += ["[states]"]
    for symbol, entries in rig.states.items():
        lines.append(f"{symbol} = {{ {', '.join(f'{k} = {json.dumps(v)}' for k, v in entries.items())} }}")
    for name, (symbol, unit, terms) in rig.definitions.items():
        inner = ", ".join(f"{k} = {json.dumps(v)}" for k, v in terms.items())
        lines += [f"[definitions.{name}]", f"{symbol} = {{ unit = {json.dumps(unit)}, {inner} }}"]
    for name, (state, storage, terms) in rig.equations.items():
        inner = ", ".join(f"{k} = {json.dumps(v)}" for k, v in terms.items())
        lines += [f"[equations.{name}]", f"{state} = {{ storage = {json.dumps(storage)}, {inner} }}"]
    return "\n".join(lines) + "\n"


def _sheet(rig: Rig, recorded: dict) -> tuple[str, dict]:
    """(content of rig.toml, noise and step of each output's sensor)."""
    rng, told = rig.rng, str(rig.rng.choice(TOLD))
    rig.traits.append(f"told {told}")
    lines = ['plant = "plant.toml"', f"sample_time_s = {rig.dt!r}", f"predict = {json.dumps(rig.predict)}"]
    if rig.samples > 100 and rig.chance(0.5, "window"):
        lines.append(f"window_s = {rig.dt * int(rng.integers(10, 40))!r}")
    elif rig.chance(0.15, "settle"):
        lines.append(f"settle_s = {10 * rig.dt!r}")
    uncertain = {s: p for s, p in rig.parameters.items() if p[2]}
    if rig.kind in ("network", "static") and rig.chance(0.1, "anew"):
        lines.append(f"anew = {json.dumps([next(iter(uncertain))])}")
    lines += ["[parameters]", *(f"{s} = {p[0]!r}" for s, p in rig.parameters.items())]
    lines += ["[tolerance]", *(f"{s} = {p[2]!r}" for s, p in uncertain.items())]
    noise = {}
    for name in recorded:
        unit = rig.inputs.get(name) or rig.states.get(name, {}).get("unit")
        unit = unit or next(u for s, u, _ in rig.definitions.values() if s == name)
        lines += [f"[channels.{name}]", f"unit = {json.dumps(unit)}"]
        lines += [f"role = {json.dumps('input' if name in rig.inputs else 'output')}"]
        if name in rig.inputs:
            continue
        sigma = float(f"{rig.size[name] * 10 ** rng.uniform(-4, -1.5):.3g}")
        kind = str(rng.choice(TOLD[:4])) if told == "some" else told
        if name == "still" and rng.random() < 0.5:
            sigma, noise[name] = 1e-3, (0.0, 0.0)
            lines += ["noise_rms = 1e-3"] if kind != "none" else []
            continue
        noise[name] = (0.0 if kind == "resolution" else sigma, sigma if kind in ("resolution", "both") else 0.0)
        lines += [f"noise_rms = {noise[name][0]!r}"] if kind in ("noise", "both") else []
        lines += [f"resolution = {noise[name][1]!r}"] if kind in ("resolution", "both") else []
    return "\n".join(lines) + "\n", noise


def _effects(rig: Rig) -> str:
    """Content of effects.toml: one or two effects that fit the plant, of any form that an effect may have."""
    rng, form, out = rig.rng, rig.form, []
    given = [n for n in rig.inputs if n not in rig.derived and n != "t"]
    places = {n: e[0] for n, e in rig.equations.items()} | {n: d[0] for n, d in rig.definitions.items()}
    forms = ["term", "shaped", "sensor"] + (["filter"] if given else []) + (["state"] if rig.states else [])
    for i, kind in enumerate(form.choice(forms, int(form.integers(0, 3)), replace=False)):
        rig.traits.append(f"effect {kind}")
        place, symbol = list(places.items())[int(form.integers(len(places)))]
        x = symbol if place in rig.equations else "u0"
        typical = float(f"{10 ** rng.uniform(-3, 3):.2g}")
        where, bounds = place, rng.choice(["", ", low = 0.0"])
        body = [f"parameters.s{i} = {{ typical = {typical!r}{bounds} }}"]
        if kind == "term":
            body += [f'terms."{place}.t{i}" = "s{i} * {x}"']
        elif kind == "shaped":
            body += [f"parameters.w{i} = {{ typical = 1.0, low = 1e-6, guess = [0.3, 3.0], shape = true }}"]
            body += [f'terms."{place}.t{i}" = "-s{i} * tanh({x} / w{i})"']
        elif kind == "sensor":
            channel = str(form.choice([y for y in rig.predict if y in rig.states] or [""]))
            if not channel:
                continue
            where, x = channel, channel
            body += [f'terms."sensor_{channel}.t{i}" = "s{i} * {channel}"']
        elif kind == "filter":
            where = x = str(form.choice(given))
            how = str(rng.choice(["delay", "lag", "offset", "dead_zone", "play", "skew", "lag_from_rest"]))
            body += [f'filters.{x} = "{how} s{i}"']
        else:
            body += [f'terms."{place}.t{i}" = "s{i} * extra{i}"', f'states.extra{i} = {{ unit = "1" }}']
            body += [f"parameters.pace{i} = {{ typical = {10 * rig.dt!r}, low = {rig.dt!r}, shape = true }}"]
            body += [f'equations_of.own{i} = {{ state = "extra{i}", terms = {{ r = "({x} - extra{i}) / pace{i}" }} }}']
        head = [f"[effect{i}]", f'means = "effect {i}"', f"equations = {json.dumps([where])}"]
        out += [*head, f"depends_on = {json.dumps([x] if x in rig.predict or x in given else [])}", *body]
    return "\n".join(out) + "\n" if out else ""
