"""Joins a network from the equations of a plant: exact linear layers, parts for what is not linear, states by delays.

Over the interval from sample k-1 to k a state s moves by step * (sum of its terms) / storage. In these sums stand the
network's own states at k-1, measured signals by their mean over the interval, of a measured position its difference.
Stiff linear states are one layer, exact for inputs that are held (`lags`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from greygate.errors import InputError
from greygate.identify.expert.decisions import Log
from greygate.identify.expert.forms import Form, linear
from greygate.identify.expert.lags import Lag, lags
from greygate.identify.expert.parts import MOST_SIGNALS, Part, part
from greygate.identify.expert.task import Task
from greygate.models.adaptation import frozen
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record
from greygate.plants.expressions import Call, Name, Node, Number, Operation, Signed, names, parse
from greygate.plants.functions import FUNCTIONS

ROOM = 1.25  # factor of a port's scale over what is on record
UNTOLD = 0.75  # relative tolerance of a parameter, where the plant tells none of any
BETWEEN, RICH = (0.1, 0.8), 0.2  # of a rate's largest value; share of the samples in between from which it tells
LEAST = 0.2  # of its nominal value, what is left of a weight: its sign is known


@dataclass(frozen=True)
class Choices:
    """What the expert may choose anew.

    held: inputs that are held over a sample; others go straight from one sample to the next.
    taps: differences from which a rate is taken. larger: how many sizes of the parts to pass over.
    free: whether training may move the weights that the data sheet leaves uncertain.
    unknown: place (equation or definition) -> neurons of a network for what its terms leave out.
    """

    held: frozenset[str] = frozenset()
    taps: int = 1
    larger: int = 0
    free: bool = False
    unknown: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Wire:
    """A signal of the network: what `source` gave `delay` steps ago, times `scale`. values: along the recordings.

    unit: of a symbol of the plant.
    """

    source: str
    scale: float
    values: np.ndarray
    delay: int = 0
    unit: str = ""


@dataclass
class Joined:
    """network; rehearse, bounds: for `train`. states: layer -> (signal, its scale)."""

    network: Network
    rehearse: dict[str, Record]
    bounds: dict[str, tuple[float, float]]
    states: dict[str, tuple[str, float]]


class Wiring:
    """One joining. signals: every signal along the recordings, by the plant's own simulation (N,)."""

    def __init__(
        self, task: Task, signals: Mapping[str, np.ndarray], choices: Choices, parts: dict[str, Part], log: Log
    ):
        self.task, self.signals, self.choices, self.parts, self.log = task, signals, choices, parts, log
        self.plant = task.plant
        self.wires: dict[str, Wire] = {}
        self.forms: dict[tuple[str, bool], Form] = {}
        self.told = any(p.tolerance for p in self.plant.parameters.values())
        ports = [Port(n, self.plant.unit(n), self.size(n), initial=float(signals[n][0])) for n in task.inputs]
        outputs = [Port(n, self.plant.unit(n), self.size(n)) for n in task.targets]
        self.network = Network(self.plant.name, ports, outputs, dt=task.step)
        self.joined = Joined(self.network, {}, {}, {})
        self.lags = {s: lag for lag in lags(task, self.constant_form) for s in lag.states}

    def size(self, symbol: str) -> float:
        return ROOM * float(np.abs(self.signals[symbol]).max()) or 1.0

    def join(self) -> Joined:
        for state in self.task.states:
            if state not in self.lags:
                self.state(state)
        for target in self.task.targets:
            form = self.resolve(target, True)
            self.network.connect(self.layer(f"give_{target}", form, self.size(target)), target)
        self.network.check()
        return self.joined

    # ---- symbols

    def resolve(self, symbol: str, now: bool) -> Form:
        """The form of a symbol: now, at sample k, or over the interval before it."""
        key = (symbol, now and symbol not in self.task.rates)
        if key not in self.forms:
            self.forms[key] = self._resolved(*key)
        return self.forms[key]

    def constant_form(self, symbol: str) -> Form | None:
        parameter = self.plant.parameters.get(symbol)
        if parameter is None:
            return None
        tolerance = parameter.tolerance if self.told else UNTOLD
        return Form(parameter.value, free={"": tolerance} if tolerance else {})

    def _resolved(self, symbol: str, now: bool) -> Form:
        if (constant := self.constant_form(symbol)) is not None:
            return constant
        if symbol in self.task.rates:
            return self.rate(symbol)
        if symbol in self.task.inputs:
            return self.wired(symbol, symbol, self.size(symbol)) if now else self.over_interval(symbol)
        if symbol in self.lags:
            return self.lag(self.lags[symbol], symbol, now)
        if symbol in self.task.states:
            if self.limited(symbol) == 0.0:
                return Form(self.plant.constant(self.plant.states[symbol].initial))
            return self.wired(
                symbol if now else f"{symbol}_before", f"state_{symbol}", self.size(symbol), int(not now), symbol
            )
        found = next((n, d) for n, d in self.plant.definitions.items() if d.symbol == symbol)
        return self.sum(found[0], found[1].terms, now)

    def wired(self, key: str, source: str, scale: float, delay: int = 0, symbol: str = "") -> Form:
        self.wires[key] = Wire(source, scale, self.signals[symbol or key], delay, self.plant.unit(symbol or key))
        return Form(weights={key: 1.0})

    def made(self, key: str, source: str, scale: float, values: np.ndarray) -> Form:
        self.wires[key] = Wire(source, scale, np.broadcast_to(values, len(self.signals[self.task.inputs[0]])))
        return Form(weights={key: 1.0})

    def limited(self, state: str) -> float:
        """The room of a state between its limits."""
        limits = self.plant.states[state]
        ends = [
            self.plant.constant(e) if e is not None else np.inf * s for e, s in ((limits.low, -1), (limits.high, 1))
        ]
        return ends[1] - ends[0]

    def over_interval(self, symbol: str) -> Form:
        turned = self.plant.unit(symbol) == "rad" and np.abs(np.diff(self.signals[symbol])).max() > np.pi
        held = symbol in self.choices.held or turned
        name = f"mean_{symbol}"
        weights = {"now": [[0.0 if held else 0.5]], "before": [[1.0 if held else 0.5]]}
        measured = self.choices.free and not held and symbol in self.plant.inputs
        layer = Layer(weights, [0.0], frozen={"bias"} if measured else {"now", "before", "bias"})
        self.network.add(name, layer, {"now": symbol, "before": (symbol, 1)})
        return self.wired(f"{symbol}_mean", name, self.size(symbol), symbol=symbol)

    def rate(self, symbol: str) -> Form:
        source, _ = self.task.rates[symbol]
        scale, ratio = self.size(symbol), self.size(source) / (self.task.step * self.size(symbol))
        difference = Layer({"now": [[1.0]], "before": [[-1.0]]}, [0.0], frozen={"now", "before", "bias"})
        self.network.add(f"moved_{symbol}", difference, {"now": source, "before": (source, 1)})
        first = {f"d{n}": [[float(n == 0)]] for n in range(self.choices.taps)}
        known = {"bias"} if self.choices.taps > 1 else {"bias", *first}
        self.network.add(f"rate_{symbol}", Layer(first, [0.0], frozen=known))
        for n in range(self.choices.taps):
            self.network.connect(f"moved_{symbol}", f"rate_{symbol}.d{n}", delay=n, gain=ratio)
        why = f"{source} is measured, and {symbol} is its rate"
        self.log("decompose", symbol, f"difference of {source} over the step", why)
        return self.wired(symbol, f"rate_{symbol}", scale)

    def lag(self, lag: Lag, symbol: str, now: bool) -> Form:
        name = f"lag_{'_'.join(lag.states)}"
        if name not in self.network.modules:
            sizes = np.array([self.size(s) for s in lag.states])
            inputs = {u: lag.inputs[:, [j]] / sizes[:, None] * self.size(u) for j, u in enumerate(lag.inputs_from)}
            own = lag.own * sizes[None, :] / sizes[:, None]
            start = np.array([self.signals[s][0] for s in lag.states]) / sizes
            fixed = frozenset({"own", "bias", *inputs})
            self.network.add(name, Layer({"own": own, **inputs}, lag.constant / sizes, initial=start, frozen=fixed))
            self.network.connect(name, f"{name}.own", delay=1)
            mean = {"own": lag.mean_own * sizes[None, :] / sizes[:, None]}
            mean |= {u: lag.mean_inputs[:, [j]] / sizes[:, None] * self.size(u) for j, u in enumerate(lag.inputs_from)}
            self.network.add(f"{name}_mean", Layer(mean, lag.mean_constant / sizes, frozen=fixed))
            self.network.connect(name, f"{name}_mean.own", delay=1)
            for u in lag.inputs_from:
                self.network.connect(u, f"{name}.{u}", delay=1)
                self.network.connect(u, f"{name}_mean.{u}", delay=1)
            what = "one linear layer, exact for a held input, and its mean over the step"
            self.log("decompose", ", ".join(lag.states), what, lag.why)
        key, source = (symbol, name) if now else (f"{symbol}_mean", f"{name}_mean")
        pick = f"{key}_of"
        row = np.array([[float(s == symbol) for s in lag.states]])
        self.network.add(pick, Layer({"lag": row}, [0.0], frozen={"lag", "bias"}), {"lag": source})
        return self.wired(key, pick, self.size(symbol), symbol=symbol)

    # ---- sums

    def sum(self, place: str, terms: Mapping[str, str], now: bool) -> Form:
        """The form of a sum of named terms; what is not linear in it becomes parts."""
        total, bent = Form(), {}
        for term, text in terms.items():
            form = linear(parse(text).tree, lambda symbol: self.resolve(symbol, now))
            if form is None:
                bent[term] = text
            else:
                total = total + form
        if bent:
            total = total + self.bent(place, bent, now)
        if place in self.choices.unknown:
            total = total + self.unknown(place, terms, now)
        return total

    def bent(self, place: str, terms: Mapping[str, str], now: bool) -> Form:
        """A form of the terms that are not linear."""
        suffix = "" if now else "_mean"
        reads = {s: self.resolve(s, now) for s in sorted(names(terms.values()))}
        signals = sorted({key for form in reads.values() for key in form.weights})
        exact = all(_is_exact(parse(text).tree) for text in terms.values())
        if len(signals) <= 2 and not exact:
            return self.parted(place + suffix, terms, reads, signals)
        found = Form()
        for term, text in terms.items():
            name = f"{place}_{term}{suffix}"
            own = {s: reads[s] for s in names([text])}
            inputs = sorted({key for form in own.values() for key in form.weights})
            if _is_exact(parse(text).tree) or len(inputs) > MOST_SIGNALS:
                found = found + self.built(name, parse(text).tree, now)
            else:
                found = found + self.parted(name, {term: text}, own, inputs)
        return found

    def parted(self, name: str, terms: Mapping[str, str], reads: Mapping[str, Form], signals: Sequence[str]) -> Form:
        """One network for the sum of some terms of the same few signals."""

        def function(at: Mapping[str, np.ndarray]) -> np.ndarray:
            scope = {s: form.over(at) for s, form in reads.items()}
            shape = np.shape(next(iter(at.values())))
            return np.broadcast_to(sum(parse(text).over(scope) for text in terms.values()), shape)

        on_record = {s: self.wires[s].values for s in signals}
        ends = {signal: self._ends(self.wires[signal].unit, reads) for signal in signals}
        made = self.made_part(name, function, on_record, ends)
        self.network.add(name, made.network)
        for signal in signals:
            wire = self.wires[signal]
            self.network.connect(wire.source, f"{name}.{signal}", wire.delay, wire.scale / made.scales[signal])
        self.joined.rehearse[name] = made.rehearsal
        return self.made(name, name, made.size, function(on_record))

    def made_part(self, name: str, function, on_record: Mapping[str, np.ndarray], ends: Mapping) -> Part:
        if name not in self.parts:
            self.parts[name] = part(name, function, on_record, ends, self.choices.larger, self.log)
        return self.parts[name]

    def _ends(self, unit: str, reads: Mapping[str, Form]) -> list[float]:
        """Sizes of that unit: the constants that a term reads, and the limits of states."""
        found = [f.constant for s, f in reads.items() if f.is_constant and self.plant.unit(s) == unit]
        limits = [e for s in self.plant.states.values() for e in (s.low, s.high) if e is not None and s.unit == unit]
        found += [self.plant.constant(e) for e in limits]
        return list(dict.fromkeys(abs(e) for e in found if e))

    def unknown(self, place: str, terms: Mapping[str, str], now: bool) -> Form:
        """A network for what the terms of a place leave out; it starts at zero, and enters as the closure says."""
        neurons, name = self.choices.unknown[place], f"unknown_{place}"
        declared = self.plant.closure.places.get(place)
        text = declared.term if declared else "f"
        factors = sorted(names([text]) - {"f"})
        forms = [self.resolve(s, now) for s in (*sorted(names(terms.values())), *factors)]
        forms += [self.resolve(s, now) for s in self.task.inputs]
        for chosen in declared.libraries if declared else ():
            for function, said in self.plant.closure.libraries.get(chosen, {}).items():
                if not names([said]) <= self.plant.symbols:
                    continue  # it reads the limits of a recording
                forms.append(self.built(f"{name}_{function}", parse(said).tree, now))
        signals = sorted({key for form in forms for key in form.weights})
        for key in [n for n in signals if n in self.task.rates and poor(self.wires[n].values)]:
            signals.remove(key)
            self.log("widen", name, f"does not read {key}", "on record it is at rest or at its largest, seldom between")
        network = feedforward(name, signals, [neurons], 0)
        network.modules["out"] = Layer({"hidden1": np.zeros((1, neurons))}, [0.0])
        self.network.add(name, network)
        for signal in signals:
            wire = self.wires[signal]
            self.network.connect(wire.source, f"{name}.{signal}", wire.delay)
        values = self._values()
        largest = max([float(np.abs(form.over(values)).max()) for form in self._sized(terms, now)] or [1.0]) or 1.0
        if not factors:
            return self.made(name, name, largest, np.zeros(1))
        over = max(float(np.abs(self.resolve(s, now).over(values)).max()) for s in factors) or 1.0
        self.forms["f", now] = self.made(name, name, largest / over, np.zeros(1))
        return self.built(f"{name}_term", parse(text).tree, now)

    def _sized(self, terms: Mapping[str, str], now: bool) -> list[Form]:
        """The terms that are linear."""
        found = [linear(parse(text).tree, lambda symbol: self.resolve(symbol, now)) for text in terms.values()]
        return [form for form in found if form is not None]

    def _values(self) -> dict[str, np.ndarray]:
        return {key: wire.values for key, wire in self.wires.items()}

    # ---- states

    def state(self, state: str) -> None:
        """The layer that keeps a state: it adds what the state moves by over each interval."""
        if self.limited(state) == 0.0:
            self.log("decompose", state, "a constant", "its limits leave it no room")
            return
        name = self.task.equations[state]
        equation, scale = self.plant.equations[name], self.size(state)
        total = self.sum(name, equation.terms, False)
        leaks = total.weights.get(f"{state}_before", 0.0) < 0  # then a constant in its sum cannot add up for ever
        storage = linear(parse(equation.storage).tree, lambda s: self.resolve(s, False))
        if storage is None:
            storage = self.built(f"{name}_storage", parse(equation.storage).tree, False)
        step = Form(self.task.step)
        if storage.is_constant:
            move = total.times(Form(self.task.step / storage.constant, free=storage.free))
            why = "its storage is constant"
        else:
            move = self.quotient(f"{name}_over", total.times(step), storage, leaks)
            why = "its storage changes with " + ", ".join(storage.weights)
        size = float(np.abs(move.over(self._values())).max()) or scale
        source = self.layer(f"move_{state}", move, size, leaks and storage.is_constant)
        limits = self._reached(state)
        kept = frozenset({"move", "before", "bias"})
        first = float(self.signals[state][0]) / scale
        level = Layer({"move": [[size / scale]], "before": [[1.0]]}, [0.0], initial=first, frozen=kept)
        self.joined.states[f"state_{state}"] = (state, scale)
        if limits is None:
            self.network.add(f"state_{state}", level, {"move": source, "before": (f"state_{state}", 1)})
        else:
            self._clipped(state, source, level, limits, scale)
        what = "sum and integrator" if storage.is_constant else "sum, divider and integrator"
        self.log("decompose", f"{name} ({state})", f"{what}, exact layers", why)

    def _reached(self, state: str) -> tuple[float, float] | None:
        """The limits of a state that it reaches in the plant's own simulation."""
        limits, seen = self.plant.states[state], self.signals[state]
        low, high = (self.plant.constant(e) if e is not None else None for e in (limits.low, limits.high))
        if low is None or high is None or (seen.min() > low and seen.max() < high):
            return None
        return low, high

    def _clipped(self, state: str, source: str, level: Layer, limits: tuple[float, float], scale: float) -> None:
        low, span = limits[0] / scale, (limits[1] - limits[0]) / scale
        first = float(level.initial[0])
        part = Layer(
            {"level": [[1 / span]]}, [-low / span], "satlin", np.clip((first - low) / span, 0, 1), {"level", "bias"}
        )
        limited = Layer({"part": [[span]]}, [low], initial=first, frozen={"part", "bias"})
        self.network.add(f"free_{state}", level, {"move": source, "before": (f"state_{state}", 1)})
        self.network.add(f"part_{state}", part, {"level": f"free_{state}"})
        self.network.add(f"state_{state}", limited, {"part": f"part_{state}"})
        self.log("decompose", state, f"kept between {limits[0]:.4g} and {limits[1]:.4g}", "it reaches its limits")

    # ---- structure from library networks

    def built(self, name: str, node: Node, now: bool) -> Form:
        """The form of an expression, built operation by operation."""
        form = linear(node, lambda symbol: self.resolve(symbol, now))
        if form is not None:
            return form
        match node:
            case Signed(sign, of):
                return self.built(name, of, now).times(Form(-1.0 if sign == "-" else 1.0))
            case Operation("+" | "-" as sign, left, right):
                b = self.built(f"{name}_r", right, now)
                return self.built(f"{name}_l", left, now) + (b if sign == "+" else b.times(Form(-1.0)))
            case Operation("*", left, right):
                a, b = self.built(f"{name}_l", left, now), self.built(f"{name}_r", right, now)
                return a.times(b) if b.is_constant else b.times(a) if a.is_constant else self.product(name, a, b)
            case Operation("/", left, right):
                a, b = self.built(f"{name}_l", left, now), self.built(f"{name}_r", right, now)
                return a.times(Form(1 / b.constant)) if b.is_constant else self.quotient(name, a, b)
            case Operation("**", left, Number(2)):
                return self.product(name, *[self.built(f"{name}_l", left, now)] * 2)
            case Call(function, given):
                return self.called(name, function, [self.built(f"{name}_{i}", g, now) for i, g in enumerate(given)])
        raise InputError(f"plant {self.plant.name}: {name}: no network is made of this power; write it as a function")

    def called(self, name: str, function: str, given: list[Form]) -> Form:
        values, call = self._values(), cast(Callable[..., np.ndarray], FUNCTIONS[function])
        forms = {f"x{i}": form for i, form in enumerate(given) if not form.is_constant}
        known = {"abs": "absolute", "sign": "sign", "sin": "sine", "cos": "cosine"}.get(function)
        at = {n: form.over(values) for n, form in forms.items()}
        if known and (function in ("abs", "sign") or np.abs(at["x0"]).max() <= np.pi):
            scale = float(np.abs(at["x0"]).max()) if function in ("abs", "sign") else 1.0
            self.network.add(name, library(known))
            self.network.connect(self.layer(f"{name}_in", given[0], scale), f"{name}.x")
            self.log("part", name, f"library network {known}", f"the term holds {function}()")
            size = scale if function == "abs" else 1.0
            return self.made(name, name, size, call(at["x0"]))
        held = [None if not f.is_constant else f.constant for f in given]

        def of(signals: Mapping[str, np.ndarray]) -> np.ndarray:
            return call(*(signals[f"x{i}"] if h is None else h for i, h in enumerate(held)))

        made = self.made_part(name, of, at, {n: [] for n in at})
        self.network.add(name, made.network)
        for n, form in forms.items():
            self.network.connect(self.layer(f"{name}_{n}", form, made.scales[n]), f"{name}.{n}")
        self.joined.rehearse[name] = made.rehearsal
        return self.made(name, name, made.size, of(at))

    def product(self, name: str, a: Form, b: Form) -> Form:
        """Exact, by two squares: ab = ((a + b) / 2)^2 - ((a - b) / 2)^2."""
        values = self._values()
        sizes = [float(np.abs(f.over(values)).max()) or 1.0 for f in (a, b)]
        halves = Layer({"a": [[0.5], [0.5]], "b": [[0.5], [-0.5]]}, [0.0, 0.0], "square", frozen={"a", "b", "bias"})
        self.network.add(f"{name}_squares", halves)
        self.network.add(name, Layer({"squares": [[1.0, -1.0]]}, [0.0], frozen={"squares", "bias"}))
        for port, form, size in zip("ab", (a, b), sizes, strict=True):
            self.network.connect(self.layer(f"{name}_{port}", form, size), f"{name}_squares.{port}")
        self.network.connect(f"{name}_squares", f"{name}.squares")
        self.log("part", name, "a product by two squares", "the term multiplies two signals")
        return self.made(name, name, sizes[0] * sizes[1], a.over(values) * b.over(values))

    def quotient(self, name: str, a: Form, b: Form, offset: bool = False) -> Form:
        """By the library's divider, omega / (1 + gamma), with omega over its whole range."""
        values = self._values()
        over = b.over(values)
        centre = float(over.max() + over.min()) / 2
        reach = float(np.abs(over / centre - 1).max()) if centre else np.inf
        if reach > 0.9:
            raise InputError(f"plant {self.plant.name}: {name}: what is divided by comes near zero; write it otherwise")
        size = float(np.abs(a.over(values)).max()) or 1.0
        self.network.add(name, frozen(library("divider")))
        self.network.connect(self.layer(f"{name}_of", a, size, offset), f"{name}.omega")
        gamma = b.times(Form(1 / centre)) + Form(-1.0)
        self.network.connect(self.layer(f"{name}_by", gamma, 1.0), f"{name}.gamma")
        self.log("part", name, "library network divider", f"what is divided by varies by {reach:.2g} of its mean")
        return self.made(name, name, size / centre, a.over(values) / over)

    def layer(self, name: str, form: Form, scale: float, offset: bool = False) -> str:
        """A linear layer that gives a form over a scale; what the data sheet leaves uncertain may be trained.

        offset: whether a constant may be added.
        """
        weights = {key: [[w * self.wires[key].scale / scale]] for key, w in form.weights.items()}
        known = {key for key in weights if key not in form.free or not self.choices.free}
        self.network.add(
            name,
            Layer(weights, [form.constant / scale], frozen=known if offset and self.choices.free else {*known, "bias"}),
        )
        for key, ((w,),) in weights.items():
            wire = self.wires[key]
            self.network.connect(wire.source, f"{name}.{key}", wire.delay)
            if key not in known and w:
                moved = form.free[key]
                low, high = sorted((w * max(1 - moved, LEAST), w * (1 + moved)))
                self.joined.bounds[f"{name}.{key}"] = (low, high)
        return name


def poor(rate: np.ndarray) -> bool:
    """Whether a rate is seldom on record between rest and its largest, so that nothing tells what depends on it."""
    part = np.abs(rate) / (np.abs(rate).max() or 1.0)
    return float(np.mean((part > BETWEEN[0]) & (part < BETWEEN[1]))) < RICH


def _is_exact(node: Node) -> bool:
    """Whether an expression is products, sums and functions of the library alone."""
    match node:
        case Number() | Name():
            return True
        case Signed(_, of):
            return _is_exact(of)
        case Operation("+" | "-" | "*", left, right):
            return _is_exact(left) and _is_exact(right)
        case Operation("/", left, right):
            return _is_exact(left) and _is_exact(right)
        case Operation("**", left, Number(2)):
            return _is_exact(left)
        case Call("abs" | "sign" | "sin" | "cos", (of,)):
            return _is_exact(of)
    return False
