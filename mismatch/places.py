"""Where a plant may lack something: its velocities, positions and storages, told by their units and equations.

A velocity may be the rate of a state, a state, a derived input or a definition; a storage is any other state with a
balance of its own. A place says by which name each goes in an entry of `general.toml`.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import combinations

import numpy as np

from greygate.mismatch.rig import Rig
from greygate.plants import units
from greygate.plants.expressions import Name, names, parse, replaced
from greygate.plants.plant import Definition, Equation, Plant

Place = dict[str, str]
"""Placeholder in `general.toml` -> the name that stands for it; the first one names the effect there."""

LENGTHS = ("m", "mm", "cm", "µm", "um", "km", "in", "rad", "mrad", "deg", "°", "rev", "turn", "tick", "count")
ANGLES = ("rad",)  # whose sine and cosine are taken as they are
FAST = ("rpm", "Hz")  # rates that need no second below
LOADS, TILTS = ("payload",), ("gravity_x", "gravity_y", "gravity_z")  # elements that only a simulator has
LONGEST_LINK = 400  # characters: a term may have so many, several times over
TRIED, ABOUT_ONE = 3, (0.5, 2.0)  # values at which it is asked of a term how it goes with its signals
PAIRS = 6  # of states, between which something may flow or act, or of a velocity and an input: the first ones


def places(rig: Rig) -> dict[str, list[Place]]:
    """By the `at` of an entry all places of a rig's plant."""
    plant = rig.plant
    moving, stored = list(_velocities(rig)), list(_storages(rig))
    return {
        "u": [{"u": name} for name in rig.inputs],
        "y": [{"y": name} for name in rig.predict],
        "level": [{"y": name} for name in rig.predict if not _origin(plant, name)],
        "v": moving,
        "x": [place for place in moving if "x" in place],
        "angle": [place for place in moving if "x" in place and plant.unit(place["x"]) in ANGLES],
        "drive": (driven := [p | {"drive": drive} for p in moving if (drive := _drive(rig, p["motion"]))]),
        "ruled": [place for place in driven if _asks(plant, place["drive"]) & {*plant.states}],
        "geared": [place for place in driven if place.get("x") in rig.predict and _known(plant, place)],
        "law": [*_laws(rig)],
        "lossy": [*_resisting(rig)][:PAIRS],
        "pressed": [{"u": u, "v": p["v"], "motion": p["motion"]} for p in moving for u in rig.inputs][:PAIRS],
        "inert": [p | {"storage": s} for p in moving if (s := _storage(plant, p["motion"]))],
        "s": stored,
        "heat": [place for place in stored if plant.unit(place["s"]) == "K"],
        "load": _elements(plant, LOADS),
        "tilt": _elements(plant, TILTS),
        "pair": _pairs(plant, stored, "s", "balance"),
        "bodies": _pairs(plant, [p for p in moving if p["v"] in plant.states], "v", "motion"),
        "springs": (joined := _pairs(plant, [p for p in moving if p["v"] in plant.states and "x" in p], "x", "motion")),
        "links": [*_links(plant, joined)],
    }


def rates(plant: Plant) -> dict[str, str]:
    """Position -> its velocity, both states: as declared, or as the position's balance says."""
    found = {x: state.rate for x, state in plant.states.items() if state.rate}
    for equation in plant.equations.values():
        rate = _copied(equation)
        if rate in plant.states and is_rate(plant.unit(rate)) and not is_rate(plant.unit(equation.state)):
            found.setdefault(equation.state, rate)
    return found


def is_rate(unit: str) -> bool:
    """Whether it is the unit of a speed, or of a speed of rotation."""
    found = units.powers(unit) or {}
    return unit in FAST or any(found == {length: Fraction(1), "s": Fraction(-1)} for length in LENGTHS)


def unit_of_place(plant: Plant, where: str) -> units.Powers | None:
    """The unit of the terms of an equation or a definition."""
    place = _sum(plant, where)
    known = {symbol: plant.unit(symbol) for symbol in plant.symbols}
    if isinstance(place, Definition):
        return units.powers(place.unit)
    for text in place.terms.values():
        if names([text]) and (found := units.of(text, known)) is not None:
            return found
    storage, state = units.of(place.storage, known), units.powers(plant.unit(place.state))
    if storage is None or state is None:
        return None
    return _as_force(units.times(units.times(storage, state), {"s": Fraction(1)}, -1))


def _as_force(unit: units.Powers) -> units.Powers:
    """N for kg m/s^2, N m for kg m^2/s^2, whose angle counts nothing."""
    one, plain = Fraction(1), {symbol: power for symbol, power in unit.items() if symbol != "rad"}
    if unit == {"kg": one, "m": one, "s": -2 * one}:
        return {"N": one}
    return {"N": one, "m": one} if plain == {"kg": one, "m": 2 * one, "s": -2 * one} else unit


def _sum(plant: Plant, where: str) -> Equation | Definition:
    return plant.equations.get(where) or plant.definitions[where]


def _copied(equation: Equation) -> str:
    """The symbol that is the whole right side of a balance; empty where it is more."""
    terms = [*equation.terms.values()]
    tree = parse(terms[0]).tree if len(terms) == 1 and equation.storage == "1" else None
    return tree.symbol if isinstance(tree, Name) else ""


def _velocities(rig: Rig) -> Iterator[Place]:
    plant = rig.plant
    balance = {e.state: name for name, e in plant.equations.items() if not _copied(e)}
    found = rates(plant)
    for x, v in found.items():
        if v in balance:
            yield {"x": x, "v": v, "motion": balance[v]}
    for v, state in plant.states.items():
        if is_rate(state.unit) and v in balance and v not in plant.shown and v not in (*found, *found.values()):
            yield {"v": v, "motion": balance[v]}
    known = {balance[v] for v in plant.states if v in balance and is_rate(plant.unit(v))}
    found = _derived(plant)
    defined = [] if known else [d.symbol for d in plant.definitions.values()]  # else made of those that move
    for v in (*found, *defined):
        where = _entered(rig, v) if is_rate(plant.unit(v)) and v not in rig.predict else ""
        if where and where not in known:  # where a state moves, its own velocity tells more
            yield {"v": v, "motion": where} | ({"x": found[v]} if v in found else {})


def _derived(plant: Plant) -> dict[str, str]:
    """Derived input that is a velocity -> the position that is recorded; of several of one position the smoothest."""
    ways = {v: how.split() for v, how in plant.derived.items() if is_rate(plant.unit(v))}
    best = {source: v for v, (how, source) in sorted(ways.items(), key=lambda item: item[1][0] == "smooth_rate")}
    return {v: source for source, v in best.items()}


def _entered(rig: Rig, v: str) -> str:
    """The sum that a velocity enters, or which a sensor reads; empty where that is itself a position."""
    sums: dict[str, Equation | Definition] = {**rig.plant.definitions, **rig.plant.equations}
    used = [name for name, place in sums.items() if v in names(place.terms.values())]
    used = [name for name in used if name in rig.plant.definitions or not _copied(rig.plant.equations[name])]
    used += [name for name, d in rig.plant.definitions.items() if d.symbol in rig.predict]
    return next((name for name in used if not _is_length(unit_of_place(rig.plant, name))), "")


def _is_length(unit: units.Powers | None) -> bool:
    return unit is not None and (unit in [{length: Fraction(1)} for length in LENGTHS])


def _storages(rig: Rig) -> Iterator[Place]:
    plant = rig.plant
    found = rates(plant)
    for name, equation in plant.equations.items():
        symbol = equation.state
        if symbol in plant.shown:
            continue
        inside = _is_length(units.powers(plant.unit(symbol))) or not units.powers(plant.unit(symbol))
        if inside and symbol not in rig.predict:
            continue  # how far something is bent or how much of it has closed: no stock of anything
        if not (symbol in found or symbol in found.values() or is_rate(plant.unit(symbol)) or _copied(equation)):
            yield {"s": symbol, "balance": name}


def _origin(plant: Plant, channel: str) -> bool:
    """Whether an offset of the channel is no more than another origin: no term asks where the position is."""
    if channel not in plant.states:
        return (units.powers(plant.unit(channel)) or {}).keys() & {*LENGTHS} != set()
    if plant.outside and channel in plant.outside.stepped:
        return False  # weights and joints there know where it is, though no term says so
    asked = {n for e in plant.equations.values() for n in names(e.terms.values())}
    asked |= {n for d in plant.definitions.values() for n in names(d.terms.values())}
    return channel in rates(plant) and channel not in asked


def _drive(rig: Rig, where: str) -> str:
    """The terms of a sum that inputs bring, themselves or through definitions, as one expression."""
    terms, driven = _sum(rig.plant, where).terms.values(), _driven(rig)
    return _summed(text for text in terms if driven & names([text]))


def _summed(terms: Iterable[str]) -> str:
    """Terms as one expression, which has no blank: it stands in the numbers of a table of effects."""
    return "+".join(f"({text.replace(' ', '')})" for text in terms)


def _laws(rig: Rig) -> Iterator[Place]:
    """Definitions that balances have and states move: of a force or a flow, not of a place, a speed or a share."""
    plant = rig.plant
    used = {symbol for e in plant.equations.values() for text in e.terms.values() for symbol in _asks(plant, text)}
    for name, law in plant.definitions.items():
        text = _summed(law.terms.values())
        given = not units.powers(law.unit) or is_rate(law.unit) or _is_length(units.powers(law.unit))
        if law.symbol in used and law.symbol not in rig.predict and _asks(plant, text) & {*plant.states} and not given:
            yield {"f": law.symbol, "law": name, "sum": text}


def _resisting(rig: Rig) -> Iterator[Place]:
    """Terms that take power from what a balance stores or moves: against the sign of its state, and of no other one."""
    plant = rig.plant
    for name, equation in plant.equations.items():
        for term, text in equation.terms.items():
            state, own = equation.state, names([text]) & {*plant.states}
            if own == {state} and state not in plant.shown and _against(text, state):
                text = text.replace(" ", "")
                yield {
                    "r": f"{state}_{term}",
                    "s": state,
                    "balance": name,
                    "resists": text,
                    "loss": f"abs(({text})*{state})",
                }


def _against(text: str, state: str) -> bool:
    """Whether an expression has the sign that a state has not, at a few values of all, those of others above 0."""
    found = parse(text)
    for values in _positive(found.names):
        if not found.over(values) < 0.0 < found.over({**values, state: -values[state]}):
            return False
    return True


def _storage(plant: Plant, where: str) -> str:
    """What a balance multiplies the rate of its state with; empty where that is not all that is moved.

    So it is where a simulator from outside has it, and where a mass matrix has more: less of it may be singular.
    """
    alone = not plant.outside and where in plant.equations and not plant.equations[where].couples
    return plant.equations[where].storage if alone else ""


def _known(plant: Plant, place: Place) -> bool:
    """Whether a drive is known where its position and the inputs are."""
    return not _asks(plant, place["drive"]) & {*plant.states} - {place["x"]}


def _asks(plant: Plant, text: str) -> set[str]:
    """The symbols that an expression names, and those that its definitions name."""
    used = {*names([text])}
    return used | names(t for d in plant.needed(used) for t in d.terms.values())


def _driven(rig: Rig) -> set[str]:
    """The inputs, and what is defined by them."""
    definitions, found = rig.plant.definitions.values(), {*rig.inputs}
    while new := {d.symbol for d in definitions if found & names(d.terms.values())} - found:
        found |= new
    return found


def _elements(plant: Plant, effects: Collection[str]) -> list[Place]:
    """Where a plant's simulator has one of these: its parameter, and what its name says beyond the effect's."""
    found = plant.outside.elements.items() if plant.outside else ()
    return [
        {"b": symbol.removeprefix(f"{effect}_"), "motion": place}
        for (effect, place), symbol in found
        if effect in effects
    ]


def _pairs(plant: Plant, found: list[Place], key: str, where: str) -> list[Place]:
    """Pairs of places whose states have one unit, and whose sums have one.

    What a mass matrix couples are coordinates and not two bodies: what acts between these, acts in one of those.
    """
    out = []
    for one, other in combinations(found, 2):
        if _coupled(plant, one[where], other[where]):
            continue
        alike = plant.unit(one[key]) == plant.unit(other[key]) and one[where] != other[where]
        if alike and unit_of_place(plant, one[where]) == unit_of_place(plant, other[where]):
            out.append({f"{k}_{i}": v for i, place in ((1, one), (2, other)) for k, v in place.items()})
    return out[:PAIRS]


def _links(plant: Plant, pairs: list[Place]) -> Iterator[Place]:
    """Pairs that something links: its terms in both balances, and these with a play, within which they do not act."""
    for pair in pairs:
        (x, other), (v, its) = ([pair[f"{key}_{i}"] for i in (1, 2)] for key in "xv")
        links = [_between(plant, (x, other), (v, its), pair[f"motion_{i}"]) for i in (1, 2)]
        play = f"play_{x}_{other}"
        slack = {
            x: f"({x} - max(min({x} - {other}, {play}), -{play}))",
            v: f"({v} - when(max({play} - abs({x} - {other}), 0), {v} - {its}))",
        }
        if all(links):
            within = {f"slack_{i}": replaced(link, slack) for i, link in enumerate(links, 1)}
            yield pair | {f"link_{i}": link for i, link in enumerate(links, 1)} | within


def _between(plant: Plant, positions: Sequence[str], velocities: Sequence[str], where: str) -> str:
    """The terms of a balance that depend on both positions; empty where not only on how far these are apart."""
    texts = []
    for text in plant.equations[where].texts:
        for definition in reversed(plant.needed(names([text]))):
            whole = " + ".join(f"({t})" for t in definition.terms.values())
            text = replaced(text, {definition.symbol: f"({whole})"})
        if {*positions} <= names([text]):
            texts.append(f"({text})")
    link = " + ".join(texts)
    together = dict.fromkeys(positions, 1.0) | dict.fromkeys(velocities, -1.0)
    return link if 0 < len(link) <= LONGEST_LINK and _unmoved(link, together) else ""


def _unmoved(text: str, together: Mapping[str, float]) -> bool:
    """Whether an expression is the same where some of its symbols move together, at a few values of all."""
    found = parse(text)
    for values in _positive(found.names):
        moved = {s: value + together.get(s, 0.0) for s, value in values.items()}
        if not np.isclose(found.over(values), found.over(moved)):
            return False
    return True


def _positive(symbols: Collection[str]) -> Iterator[dict[str, float]]:
    """A few values above 0 of some symbols."""
    random = np.random.default_rng(0)
    for _ in range(TRIED):
        yield dict(zip(symbols, random.uniform(*ABOUT_ONE, len(symbols)), strict=True))


def _coupled(plant: Plant, one: str, other: str) -> bool:
    """Whether the rate of one balance's state stands in the other balance, or a simulator from outside says so."""
    equations = [plant.equations[name] for name in (one, other) if name in plant.equations]
    states = {equation.state for equation in equations}
    if plant.outside and len({plant.outside.coupled.get(state, state) for state in states}) < len(states):
        return True
    return any(states & {*equation.couples} for equation in equations)
