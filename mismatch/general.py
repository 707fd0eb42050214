"""The general effects in every place of a rig's plant that they fit, in sizes and units of that plant.

`general.toml` names no machine, no unit and no number of a size: `places` says where an effect may enter, `seen` how
large things are along the recording, and the units of the place give the unit of a parameter.
"""

from collections.abc import Collection, Iterable, Mapping
from fractions import Fraction
from itertools import count, product
from pathlib import Path

import numpy as np

from greygate.errors import InputError
from greygate.mismatch.entries import SENSOR, TIME, Effect, effect_of, entries
from greygate.mismatch.places import Place, places, unit_of_place
from greygate.mismatch.rig import Rig
from greygate.mismatch.seen import SPECK, Seen
from greygate.plants import units
from greygate.plants.expressions import names, replaced
from greygate.plants.recording import Recording

GENERAL = Path(__file__).parent / "general.toml"
SHARE = 0.1  # of the largest term of its place, that a term of typical size has
TWIN = 0.01  # by which that of two effects may: no recording tells such shapes apart
ALIKE = 1e-9  # by which the cosine of two terms along a recording may fall short of 1: one is the other, rescaled
COPIES = ("unit", "rate", "per", "way", "sum", "power")  # ways to take a unit from a signal, or from a sum of terms


def general(
    rig: Rig, recording: Recording, beside: Iterable[Effect] = (), every: bool = False, any_plant: bool = True
) -> dict[str, Effect]:
    """The general effects by key, in every place of the rig's plant that they fit and this recording can excite.

    any_plant: all of them; else those alone that are offered on every rig. every: also those that this recording does
    not excite, as for the simulation of what another one showed; without it, effects of time alone are offered only
    where the noise is told. Where the plant, or an effect `beside` them, has one of their symbols already, they take
    another symbol. A diagnosis reports it by the name that stands in the table. What does along the recording as one
    of those does, in one of its shapes, is not offered under a second name, but for `every`: at rest all do alike. In a
    definition, which says nothing of the direction in which its result acts, a strength may have either sign.
    """
    plant, out, seen, beside = rig.plant, {}, Seen(rig, recording), list(beside)
    elements = plant.outside.elements if plant.outside else {}
    taken = {*plant.symbols, *(symbol for effect in beside for symbol in effect.symbols)}
    had = [columns for effect in beside for columns in _columns(effect, seen)]
    timed = TIME not in plant.symbols or TIME in plant.inputs
    found = places(rig)
    for key, entry in entries(GENERAL).items():
        at = found[entry.pop("at")]
        if not entry.pop("always", False) and not any_plant:
            continue
        if entry.pop("slow", False) and not rig.stated and not every:
            continue
        named = _named(at)
        for name, place in named.items():
            made = _filled(entry, place)
            released = made.pop("frees", {})
            made.setdefault("parameters", released)
            needs = made.pop("needs", [])
            if not timed and _timed(made):
                continue
            if not every and seen.lacks(needs):
                continue
            sized = _sized(made, seen, every)
            if sized is None:
                continue
            if released:
                sized["frees"] = sized.pop("parameters")
            else:
                sized = _renamed(sized, taken)
            if not released and (element := elements.get((key, place.get("motion", "")))):
                sized = _released(sized, element)
            taken |= {*sized.get("parameters", {}), *sized.get("states", {})}
            if "of" in sized and len(named) > 1:
                sized["of"] = f"{sized['of']}_{name}"
            key_here = f"{key}_{name}" if len(named) > 1 else key
            effect = effect_of(GENERAL, key_here, {"plants": [plant.name], **sized})
            if every or not any(_same(own, other) for own in _columns(effect, seen) for other in had):
                out[key_here] = effect
    return out


def unmet(rig: Rig, recording: Recording, any_plant: bool = True) -> dict[str, str]:
    """General effects that fit the rig's plant and that this recording excites in no place -> why in the first."""
    seen, found, out = Seen(rig, recording), places(rig), {}
    for key, entry in entries(GENERAL).items():
        if not entry.get("always", any_plant):
            continue
        lacking = [seen.lacks(_filled(entry.get("needs", []), place)) for place in found[entry["at"]]]
        if lacking and all(lacking):
            out[key] = lacking[0]
    return out


def _named(at: list[Place]) -> dict[str, Place]:
    """Each place by a name of its own: of the first thing in it; of both of a pair; with its sum where that tells."""
    out: dict[str, Place] = {}
    for place in at:
        first = next(iter(place))
        name = "_".join(place[k] for k in place if k.partition("_")[0] == first.partition("_")[0])
        out[name if name not in out else f"{name}_{place.get('motion', len(out))}"] = place
    return out


def _filled(entry, place: Place):
    """`entry` with names in place of placeholders."""
    match entry:
        case dict():
            return {_filled(k, place): _filled(v, place) for k, v in entry.items()}
        case list():
            return [_filled(v, place) for v in entry]
        case str():
            for name, symbol in place.items():
                entry = entry.replace(f"{{{name}}}", symbol)
    return entry


def _timed(entry: Mapping) -> bool:
    """Whether a term asks for the time."""
    return TIME in names(entry.get("terms", {}).values())


def _sized(entry: dict, seen: Seen, every: bool) -> dict | None:
    """`entry` with numbers and units; None where the recording gives a strength no size, or the plant has it."""
    parameters = {s: _numbers(p, seen) for s, p in entry["parameters"].items()}
    if any(p.get("guess") == [] for p in parameters.values()):
        if not every:
            return None
        parameters = {s: {k: v for k, v in p.items() if v != []} for s, p in parameters.items()}
    shapes = {s: p["typical"] for s, p in parameters.items() if p.get("shape")}
    strengths = [s for s in parameters if s not in shapes]
    states = {s: {**state, "unit": _copied(state["unit"], seen)} for s, state in entry.get("states", {}).items()}
    # a state of the effect's own moves little beside what it begins as
    shapes |= {s: float(np.median(seen.of(state["start"], shapes))) for s, state in states.items()}
    for symbol, parameter in parameters.items():
        where, unity = _unity(entry, symbol, strengths)
        if where in seen.rig.plant.definitions and symbol in strengths and parameter.get("low") == 0.0:
            del parameter["low"]
        if "typical" not in parameter:
            column = seen.size(unity, shapes)
            there = not states and _there(seen, where, unity, shapes)  # a state of its own answers late
            if not every and (not column > 0.0 or there):
                return None
            largest = seen.size(where.removeprefix(SENSOR)) if where.startswith(SENSOR) else seen.largest(where)
            parameter["typical"] = SHARE * (largest or 1.0) / (column or 1.0)
        if "unit" not in parameter:
            known = {s: p.get("unit", "") for s, p in {**parameters, **states}.items()}
            parameter["unit"] = unit_of_coefficient(seen.rig, where, unity, known)
    return entry | {"parameters": {s: _ordered(p) for s, p in parameters.items()}, "states": states}


def _released(entry: dict, symbol: str) -> dict:
    """The same effect as a parameter that the plant's simulator has for it; its shapes are the simulator's."""
    strength = next(p for p in entry["parameters"].values() if not p.get("shape"))
    kept = {k: v for k, v in entry.items() if k not in ("parameters", "terms")}
    return kept | {"frees": {symbol: {k: v for k, v in strength.items() if k != "as"}}}


def _numbers(parameter: Mapping, seen: Seen) -> dict:
    """A parameter with numbers and units in place of the texts that stand for them."""
    out = dict(parameter)
    for name in ("typical", "low", "high"):
        if isinstance(text := out.get(name), str):
            out[name] = seen.number(text)
    guess = out.get("guess")
    if isinstance(guess, str):
        out["guess"] = seen.lines(guess.partition(" ")[2])
    elif guess:
        out["guess"] = sorted({seen.number(g) if isinstance(g, str) else g for g in guess})
    if out.get("unit"):
        out["unit"] = _copied(out["unit"], seen)
    return out


def _ordered(parameter: dict) -> dict:
    """The same with bounds that hold `typical`, which is above 0: signals that do not move give none of these."""
    low, high = parameter.get("low", -np.inf), parameter.get("high", np.inf)
    if not parameter.get("shape"):
        parameter["typical"] = abs(parameter["typical"]) or 1.0
    if not low < high:
        parameter = {k: v for k, v in parameter.items() if k not in ("low", "high")}
    elif parameter.get("shape"):
        parameter["typical"] = float(np.clip(parameter["typical"], low, high)) or SPECK
    elif parameter["typical"] > high > 0:
        parameter["typical"] = float(high)
    return parameter


def _copied(unit: str, seen: Seen) -> str:
    """The unit that "unit NAME" (or its "rate", what is "per" it, or the "way" of a velocity) stands for."""
    kind, _, name = unit.partition(" ")
    if kind not in COPIES or not name:
        return unit
    plant = seen.rig.plant
    found = unit_of_place(plant, name) if kind in ("sum", "power") else units.powers(plant.unit(name))
    if found is None:
        return ""
    if kind == "power":
        found = units.times(found, units.powers(plant.unit(plant.equations[name].state)) or {})
    if kind == "per":  # an angle counts nothing
        found = {symbol: -power for symbol, power in found.items() if symbol != "rad"}
    if kind in ("rate", "way"):
        found = units.times(found, {"s": Fraction(1)}, -1 if kind == "rate" else 1)
    return units.written(found)


def _unity(entry: Mapping, symbol: str, strengths: Collection[str]) -> tuple[str, str]:
    """(place, term there) in which `symbol` is 1 and every other strength is 0."""
    for path, text in entry.get("terms", {}).items():
        if symbol in names([text]):
            numbers = {s: "1.0" if s == symbol else "0.0" for s in strengths}
            return path.partition(".")[0], replaced(text, numbers)
    return "", "0.0"


def unit_of_coefficient(rig: Rig, where: str, unity: str, own: Mapping[str, str] | None = None) -> str:
    """What the unit of a place and that of a term leave; empty where one of them is not known."""
    plant = rig.plant
    known = {symbol: plant.unit(symbol) for symbol in plant.symbols} | {TIME: "s"} | dict(own or {})
    if where.startswith(SENSOR):
        whole = units.powers(known[where.removeprefix(SENSOR)])
    else:
        whole = unit_of_place(plant, where) if where else None
    part = units.of(unity, known)
    return "" if whole is None or part is None else units.written(units.times(whole, part, -1))


def _there(seen: Seen, where: str, unity: str, shapes: Mapping[str, float]) -> bool:
    """Whether the place has a term that the data sheet leaves uncertain, and that is this one up to factor and offset.

    A loss to a room that is warm is such a term of a leak: it is the parameter there that is off.
    """
    plant = seen.rig.plant
    table = plant.equations.get(where) or plant.definitions.get(where)
    if table is None:
        return False
    new = seen.of(unity, shapes)
    unsure = {s: p.value or p.reach for s, p in plant.parameters.items() if p.reach}  # what is 0 may be something
    for text in table.terms.values():
        if not names([text]) & unsure.keys():
            continue
        old = seen.of(text, unsure)
        if len(old) == len(new) and (_alike(old, new) or _alike(old - np.mean(old), new - np.mean(new))):
            return True
    return False


def _columns(effect: Effect, seen: Seen) -> list[dict[str, np.ndarray]]:
    """In each of its shapes, place -> what an effect of one strength adds; none where that is not all it does."""
    if len(effect.strengths) != 1 or effect.frees or effect.filters or effect.states or effect.definitions:
        return []
    guesses = [{f.typical, *f.guess} if f.shape else {1.0} for f in effect.free]
    each = (dict(zip((f.symbol for f in effect.free), values, strict=True)) for values in product(*guesses))
    return [column for values in each if (column := _column(effect, seen, values))]


def _column(effect: Effect, seen: Seen, values: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Place -> what an effect of such `values` adds there along the recording."""
    out: dict[str, np.ndarray] = {}
    for path, text in effect.terms.items():
        where = path.partition(".")[0]
        try:
            out[where] = out.get(where, 0.0) + seen.of(text, values)
        except InputError:  # an unknown name: whoever joins the effect to the plant says so
            return {}
    return out


def _same(one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> bool:
    """Whether two effects add the same, up to one factor, in the same places."""
    if not one or set(one) != set(other) or any(len(one[place]) != len(other[place]) for place in one):
        return False
    first, second = (np.concatenate([columns[place] for place in one]) for columns in (one, other))
    return _alike(first, second, TWIN)


def _alike(one: np.ndarray, other: np.ndarray, within: float = ALIKE) -> bool:
    return bool(abs(one @ other) >= (1 - within) * np.linalg.norm(one) * np.linalg.norm(other) > 0)


def _renamed(entry: dict, taken: Collection[str]) -> dict:
    """`entry` with new symbols in place of those that are `taken`."""
    own = {**entry["parameters"], **entry.get("states", {})}
    new = {s: next(f"{s}_{n}" for n in count(2) if f"{s}_{n}" not in {*taken, *own}) for s in own if s in taken}
    if not new:
        return entry

    def text(old: str) -> str:
        return replaced(old, new)

    return entry | {
        "parameters": {new.get(s, s): {"as": s, **p} for s, p in entry["parameters"].items()},
        "terms": {path: text(old) for path, old in entry.get("terms", {}).items()},
        "filters": {name: " ".join(new.get(w, w) for w in t.split()) for name, t in entry.get("filters", {}).items()},
        "states": {new.get(s, s): {**v, "start": text(v["start"])} for s, v in entry.get("states", {}).items()},
        "equations_of": {
            name: {"state": new.get(e["state"], e["state"]), "terms": {t: text(v) for t, v in e["terms"].items()}}
            for name, e in entry.get("equations_of", {}).items()
        },
        "storages": {where: text(old) for where, old in entry.get("storages", {}).items()},
        "wave": {name: [new.get(p, p) for p in pair] for name, pair in entry.get("wave", {}).items()},
    }
