"""Joins a network from the equations of a plant: exact linear layers, parts for what is not linear, states by delays.

Over the interval from sample k-1 to k the states move as `integration` says: their linear part by its exponential, the
rest in stages. A stage's states are weighted sums of the states at k-1, the inputs and the parts of earlier stages, and
no layers of their own: nothing is rounded between them.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from greygate.errors import InputError
from greygate.identify.expert.acting import acting
from greygate.identify.expert.decisions import Log
from greygate.identify.expert.forms import Form, linear
from greygate.identify.expert.integration import SCHEMES, Scheme, Step, step
from greygate.identify.expert.parts import MOST_SIGNALS, Part, part
from greygate.identify.expert.task import Task
from greygate.models.adaptation import frozen
from greygate.models.families.blocks import feedforward
from greygate.models.families.library import library
from greygate.models.network import Layer, Network, Port
from greygate.models.training.record import Record
from greygate.plants.expressions import Call, Name, Node, Number, Operation, Signed, names, names_of, parse
from greygate.plants.functions import FUNCTIONS

ROOM = 1.25  # factor of a port's scale over what is on record
UNTOLD = 0.75  # relative tolerance of a parameter, where the plant tells none of any
BETWEEN, RICH = (0.1, 0.8), 0.2  # of a rate's largest value; share of the samples in between from which it tells
LEAST = 0.2  # of its nominal value, what is left of a weight: its sign is known
STAGE = re.compile(r"_now|_stage\d+")
NOW = -1  # the stage of what stands at sample k itself
HIGHEST = 8  # power that is built of products


@dataclass(frozen=True)
class Choices:
    """What the expert may choose anew.

    scheme: how a sample is integrated. straight: inputs that go straight from one sample to the next; others are held.
    taps: differences from which a rate is taken. larger: how many sizes of the parts to pass over.
    free: whether training may move the weights that the data sheet leaves uncertain.
    unknown: place (equation or definition) -> neurons of a network for what its terms leave out.
    """

    scheme: Scheme = SCHEMES[0]
    straight: frozenset[str] = frozenset()
    taps: int = 1
    larger: int = 0
    free: bool = False
    unknown: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Wire:
    """A signal of the network: what `source` gave `delay` steps ago, times `scale`; or the sum `form` of such signals.

    values: along the recordings. label: its name in every stage. unit: of a symbol of the plant.
    """

    source: str
    scale: float
    values: np.ndarray
    label: str
    delay: int = 0
    unit: str = ""
    form: Form | None = None


@dataclass
class Joined:
    """network; rehearse, bounds, tied: for `train`. states: layer -> (signal, its scale)."""

    network: Network
    rehearse: dict[str, Record]
    bounds: dict[str, tuple[float, float]]
    states: dict[str, tuple[str, float]]
    tied: list[list[str]] = field(default_factory=list)


class Wiring:
    """One joining. signals: every signal along the recordings, by the plant's own simulation (N,).

    first: the first value of every input.
    """

    def __init__(
        self, task: Task, signals: Mapping[str, np.ndarray], first: Mapping[str, float], choices: Choices,
        parts: dict[str, Part], log: Log,
    ):  # fmt: skip
        self.task, self.signals, self.choices, self.parts, self.log = task, signals, choices, parts, log
        self.plant, self.first = task.plant, first
        self.wires: dict[str, Wire] = {}
        self.forms: dict[tuple[str, int], Form] = {}
        self.realised: dict[str, tuple[str, int, float]] = {}
        self.copies: dict[str, list[str]] = {}
        self.substep = 0
        self.told = any(p.tolerance for p in self.plant.parameters.values())
        ports = [Port(n, self.plant.unit(n), self.size(n), initial=first[n]) for n in task.inputs]
        outputs = [Port(n, self.plant.unit(n), self.size(n)) for n in task.targets]
        self.network = Network(self.plant.name, ports, outputs, dt=task.step)
        self.joined = Joined(self.network, {}, {}, {})
        self.sources = {
            n: acting(self.network, n, self.size(n), task.filters.get(n, ()), first[n], task.step) for n in task.inputs
        }

    def size(self, symbol: str) -> float:
        return ROOM * float(np.abs(self.signals[symbol]).max()) or 1.0

    def join(self) -> Joined:
        self.integrated()
        for target in self.task.targets:
            form = self.resolve(target, NOW)
            for term, text in self.task.readings.get(target, {}).items():
                form = form + self.built(f"reading_{target}_{term}", parse(text).tree, NOW)
            self.network.connect(self.layer(f"give_{target}", form, self.size(target)), target)
        groups = [names for names in self.copies.values() if len(names) > 1]
        own = self.network.parameters()
        moved = {f"{path}.{p}" for path, m in self.network.layers().items() for p in (*m.weights, "bias")
                 if p not in m.frozen}  # fmt: skip
        for group in groups:
            inside = [n.removeprefix(group[0]) for n in own if n.startswith(f"{group[0]}.") and n in moved]
            self.joined.tied += [[f"{name}{path}" for name in group] for path in inside]
        self.network.check()
        return self.joined

    # ---- symbols

    def resolve(self, symbol: str, at: int) -> Form:
        """The form of a symbol in a stage."""
        key = (symbol, at)
        if key not in self.forms:
            self.forms[key] = self._resolved(*key)
        return self.forms[key]

    def constant_form(self, symbol: str) -> Form | None:
        parameter = self.plant.parameters.get(symbol)
        if parameter is None:
            return None
        tolerance = parameter.tolerance if self.told else UNTOLD
        return Form(parameter.value, free={"": tolerance} if tolerance else {})

    def _resolved(self, symbol: str, at: int) -> Form:
        if (constant := self.constant_form(symbol)) is not None:
            return constant
        if symbol in self.task.rates:
            return self.rate(symbol)
        if symbol in self.task.inputs:
            return self.input(symbol, at)
        if symbol in self.task.states:
            if self.limited(symbol) == 0.0:
                return Form(self.plant.constant(self.plant.states[symbol].initial))
            if at == NOW:
                return self.wired(symbol, f"state_{symbol}", symbol)
            return Form(weights={staged(symbol, at): 1.0})
        found = next((n, d) for n, d in self.plant.definitions.items() if d.symbol == symbol)
        return self.sum(found[0], found[1].terms, at)

    def wired(self, key: str, source: str, symbol: str, delay: int = 0) -> Form:
        self.wires[key] = Wire(source, self.size(symbol), self.signals[symbol], symbol, delay, self.plant.unit(symbol))
        return Form(weights={key: 1.0})

    def summed(self, key: str, symbol: str, form: Form) -> Form:
        """A wire for what a symbol is in a stage: a sum of other wires."""
        form = self.expanded(form)
        self.wires[key] = Wire("", self.size(symbol), self.signals[symbol], symbol, 0, self.plant.unit(symbol), form)
        return Form(weights={key: 1.0})

    def expanded(self, form: Form) -> Form:
        """The form of signals that have a source."""
        total = Form(form.constant, free={"": form.free[""]} if "" in form.free else {})
        for key, weight in form.weights.items():
            inner, free = self.wires[key].form, form.free.get(key, 0.0)
            part = Form(weights={key: 1.0}) if inner is None else inner
            total = total + part.times(Form(weight, free={"": free} if free else {}))
        return total

    def source(self, key: str) -> tuple[str, int, float]:
        """(module or input, delay, scale) of a wire; a sum becomes a layer where a part reads it."""
        wire = self.wires[key]
        if wire.form is None:
            return wire.source, wire.delay, wire.scale
        if len(wire.form.weights) == 1 and not wire.form.constant and [*wire.form.weights.values()] == [1.0]:
            return self.source(next(iter(wire.form.weights)))
        if key not in self.realised:
            self.realised[key] = self.layer(f"of_{key}", wire.form, wire.scale), 0, wire.scale
        return self.realised[key]

    def made(self, key: str, source: str, scale: float, values: np.ndarray, label: str = "") -> Form:
        over = np.broadcast_to(values, len(self.signals[self.task.inputs[0]]))
        self.wires[key] = Wire(source, scale, over, label or key)
        return Form(weights={key: 1.0})

    def limited(self, state: str) -> float:
        """The room of a state between its limits."""
        limits = self.plant.states[state]
        ends = [
            self.plant.constant(e) if e is not None else np.inf * s for e, s in ((limits.low, -1), (limits.high, 1))
        ]
        return ends[1] - ends[0]

    def input(self, symbol: str, at: int) -> Form:
        """How an input acts: now, or in the middle of the substep of a stage."""
        now = self.wired(symbol, self.sources[symbol], symbol)
        if at == NOW:
            return now
        before = self.wired(f"{symbol}_before", self.sources[symbol], symbol, 1)
        turned = self.plant.unit(symbol) == "rad" and np.abs(np.diff(self.signals[symbol])).max() > np.pi
        if symbol not in self.choices.straight or turned:
            return before
        share = (self.substep + 1 / 2) / self.choices.scheme.substeps
        form = now.times(Form(share)) + before.times(Form(1 - share))
        return self.summed(f"{symbol}_in{self.substep}", symbol, form)

    def rate(self, symbol: str) -> Form:
        if symbol in self.wires:
            return Form(weights={symbol: 1.0})
        source, _ = self.task.rates[symbol]
        ratio = self.size(source) / (self.task.step * self.size(symbol))
        difference = Layer({"now": [[1.0]], "before": [[-1.0]]}, [0.0], frozen={"now", "before", "bias"})
        self.network.add(f"moved_{symbol}", difference, {"now": source, "before": (source, 1)})
        first = {f"d{n}": [[float(n == 0)]] for n in range(self.choices.taps)}
        known = {"bias"} if self.choices.taps > 1 else {"bias", *first}
        self.network.add(f"rate_{symbol}", Layer(first, [0.0], frozen=known))
        for n in range(self.choices.taps):
            self.network.connect(f"moved_{symbol}", f"rate_{symbol}.d{n}", delay=n, gain=ratio)
        why = f"{source} is measured, and {symbol} is its rate"
        self.log("decompose", symbol, f"difference of {source} over the step", why)
        return self.wired(symbol, f"rate_{symbol}", symbol)

    # ---- states

    def integrated(self) -> None:
        """The layers that keep the states: stage after stage, up to the end of the sample."""
        states = [s for s in self.task.states if self.limited(s) > 0.0]
        for state in set(self.task.states) - {*states}:
            self.log("decompose", state, "a constant", "its limits leave it no room")
        for state in states:
            self.summed(staged(state, 0), state, self.wired(f"{state}_before", f"state_{state}", state, 1))
        scheme, stage = self.choices.scheme, 0
        for self.substep in range(scheme.substeps):
            stage = self.advanced(states, stage, self.task.step / scheme.substeps, scheme.second)
        for state in states:
            self.state(state, self.wires[staged(state, stage)].form or Form())

    def advanced(self, states: Sequence[str], stage: int, h: float, second: bool) -> int:
        """The wires of the states h seconds after a stage; the stage in which they stand."""
        own, held = self.apart(states, stage)
        moved, bent = step(own.values, h), [i for i, form in enumerate(held) if self.reads_parts(form)]
        ahead = [self.moved(states, stage, i, own, held, moved, h) for i in range(len(states))]
        if second and bent:
            stage += 1
            for state, form in zip(states, ahead, strict=True):
                self.summed(staged(state, stage), state, form)
            _, again = self.apart(states, stage)
            change = [b + a.times(Form(-1.0)) for a, b in zip(held, again, strict=True)]
            for i in range(len(states)):
                for m, form in enumerate(change):
                    ahead[i] = ahead[i] + form.times(Form(moved.second[i, m]))
        for state, form in zip(states, ahead, strict=True):
            self.summed(staged(state, stage + 1), state, form)
        return stage + 1

    def reads_parts(self, form: Form) -> bool:
        """Whether it reads what is not linear."""
        return any(
            self.wires[key].unit == "" and self.wires[key].label not in self.plant.symbols for key in form.weights
        )

    def apart(self, states: Sequence[str], stage: int) -> tuple["Own", list[Form]]:
        """The rates of the states in a stage: what they have of the states themselves, and the rest."""
        place = {staged(s, stage): j for j, s in enumerate(states)}
        own, rest = Own(np.zeros((len(states), len(states))), np.zeros((len(states), len(states)))), []
        for i, state in enumerate(states):
            rate = self.state_rate(state, stage)
            for key, weight in rate.weights.items():
                if key in place:
                    own.values[i, place[key]], own.free[i, place[key]] = weight, rate.free.get(key, 0.0)
            rest.append(Form(rate.constant, {k: w for k, w in rate.weights.items() if k not in place},
                             {k: f for k, f in rate.free.items() if k not in place}))  # fmt: skip
        return own, rest

    def moved(
        self, states: Sequence[str], stage: int, i: int, own: "Own", held: Sequence[Form], by: Step, h: float
    ) -> Form:
        """State i after h seconds in which everything but the states stands still."""
        spread, spread_first = own.spread(h)
        total = Form()
        for m, state in enumerate(states):
            if by.own[i, m]:
                free = {staged(state, stage): spread[i, m] / abs(by.own[i, m])} if spread[i, m] else {}
                total = total + Form(0.0, {staged(state, stage): float(by.own[i, m])}, free)
            if by.first[i, m]:
                relative = spread_first[i, m] / abs(by.first[i, m])
                factor = Form(float(by.first[i, m]), free={"": relative} if relative else {})
                total = total + held[m].times(factor)
        return total

    def state_rate(self, state: str, stage: int) -> Form:
        """The rate of a state, in its unit per second."""
        name = self.task.equations[state]
        equation = self.plant.equations[name]
        total = self.sum(name, equation.terms, stage)
        storage = linear(parse(equation.storage).tree, lambda s: self.resolve(s, stage))
        if storage is None:
            storage = self.built(named(f"{name}_storage", stage), parse(equation.storage).tree, stage)
        what = "sum and integrator" if storage.is_constant else "sum, divider and integrator"
        why = "its storage is constant"
        if not storage.is_constant:
            why = "its storage changes with " + ", ".join(self.wires[key].label for key in storage.weights)
        if stage == 0:
            self.log("decompose", f"{name} ({state})", f"{what}, exact layers", why)
        if storage.is_constant:
            return total.times(Form(1 / storage.constant, free=storage.free))
        return self.quotient(named(f"{name}_over", stage), total, storage)

    def state(self, state: str, form: Form) -> None:
        """The layer that keeps a state."""
        scale, limits, name = self.size(state), self._reached(state), f"state_{state}"
        first = float(self.signals[state][0]) / scale
        self.joined.states[name] = (state, scale)
        self.layer(name if limits is None else f"free_{state}", form, scale, first, self.choices.free)
        if limits is not None:
            self._clipped(state, limits, scale, first)

    def _reached(self, state: str) -> tuple[float, float] | None:
        """The limits of a state that it reaches in the plant's own simulation."""
        limits, seen = self.plant.states[state], self.signals[state]
        low, high = (self.plant.constant(e) if e is not None else None for e in (limits.low, limits.high))
        if low is None or high is None or (seen.min() > low and seen.max() < high):
            return None
        return low, high

    def _clipped(self, state: str, limits: tuple[float, float], scale: float, first: float) -> None:
        low, span = limits[0] / scale, (limits[1] - limits[0]) / scale
        part = Layer(
            {"level": [[1 / span]]}, [-low / span], "satlin", np.clip((first - low) / span, 0, 1), {"level", "bias"}
        )
        limited = Layer({"part": [[span]]}, [low], initial=first, frozen={"part", "bias"})
        self.network.add(f"part_{state}", part, {"level": f"free_{state}"})
        self.network.add(f"state_{state}", limited, {"part": f"part_{state}"})
        self.log("decompose", state, f"kept between {limits[0]:.4g} and {limits[1]:.4g}", "it reaches its limits")

    # ---- sums

    def sum(self, place: str, terms: Mapping[str, str], at: int) -> Form:
        """The form of a sum of named terms; what is not linear in it becomes parts."""
        total, bent = Form(), {}
        for term, text in terms.items():
            form = linear(parse(text).tree, lambda symbol: self.resolve(symbol, at))
            if form is None:
                bent[term] = text
            else:
                total = total + form
        if bent:
            total = total + self.bent(place, bent, at)
        if place in self.choices.unknown:
            total = total + self.unknown(place, terms, at)
        return total

    def bent(self, place: str, terms: Mapping[str, str], at: int) -> Form:
        """A form of the terms that are not linear: those that are exact operation by operation, the others as parts."""
        found, curves = Form(), {}
        for term, text in terms.items():
            if is_exact(parse(text).tree, self.plant.parameters):
                found = found + self.built(named(f"{place}_{term}", at), parse(text).tree, at)
            else:
                curves[term] = text
        signals = self._signals(curves.values(), at)
        if curves and len(signals) <= 2:
            return found + self.parted(place, curves, signals, at)
        for term, text in curves.items():
            signals = self._signals([text], at)
            if len(signals) > MOST_SIGNALS:
                found = found + self.built(named(f"{place}_{term}", at), parse(text).tree, at)
            else:
                found = found + self.parted(f"{place}_{term}", {term: text}, signals, at)
        return found

    def _signals(self, texts, at: int) -> list[str]:
        return sorted({key for s in names(texts) for key in self.resolve(s, at).weights})

    def parted(self, place: str, terms: Mapping[str, str], signals: Sequence[str], at: int) -> Form:
        """One network for the sum of some terms of the same few signals."""
        reads = {s: self.resolve(s, at) for s in sorted(names(terms.values()))}
        labels = {key: f"{self.wires[key].label}_in" for key in signals}

        def function(given: Mapping[str, np.ndarray]) -> np.ndarray:
            scope = {s: form.over({key: given[label] for key, label in labels.items()}) for s, form in reads.items()}
            shape = np.shape(next(iter(given.values())))
            return np.broadcast_to(sum(parse(text).over(scope) for text in terms.values()), shape)

        on_record = {labels[s]: self.wires[s].values for s in signals}
        ends = {labels[s]: self._ends(self.wires[s].unit, reads) for s in signals}
        made, name = self.made_part(place, function, on_record, ends), named(place, at)
        self.network.add(name, made.network)
        for key in signals:
            source, delay, scale = self.source(key)
            self.network.connect(source, f"{name}.{labels[key]}", delay, scale / made.scales[labels[key]])
        self.joined.rehearse[name] = made.rehearsal
        self.copies.setdefault(place, []).append(name)
        return self.made(name, name, made.size, function(on_record), place)

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

    def unknown(self, place: str, terms: Mapping[str, str], at: int) -> Form:
        """A network for what the terms of a place leave out; it starts at zero, and enters as the closure says.

        It answers once a sample: what it answered in the first stage holds in the others.
        """
        if at > 0:
            return self.forms[f"unknown_{place}", 0]
        neurons, name = self.choices.unknown[place], named(f"unknown_{place}", at)
        declared = self.plant.closure.places.get(place)
        text = declared.term if declared else "f"
        factors = sorted(names([text]) - {"f"})
        forms = [self.resolve(s, at) for s in (*sorted(names(terms.values())), *factors)]
        forms += [self.resolve(s, at) for s in self.task.inputs]
        for chosen in declared.libraries if declared else ():
            for function, said in self.plant.closure.libraries.get(chosen, {}).items():
                if not names([said]) <= self.plant.symbols:
                    continue  # it reads the limits of a recording
                forms.append(self.built(f"{name}_{function}", parse(said).tree, at))
        signals = sorted({key for form in forms for key in form.weights})
        for key in [n for n in signals if n in self.task.rates and poor(self.wires[n].values)]:
            signals.remove(key)
            self.log("widen", name, f"does not read {key}", "on record it is at rest or at its largest, seldom between")
        network = feedforward(name, signals, [neurons], 0)
        network.modules["out"] = Layer({"hidden1": np.zeros((1, neurons))}, [0.0])
        self.network.add(name, network)
        for signal in signals:
            source, delay, _ = self.source(signal)
            self.network.connect(source, f"{name}.{signal}", delay)
        values = self._values()
        largest = max([float(np.abs(form.over(values)).max()) for form in self._sized(terms, at)] or [1.0]) or 1.0
        if factors:
            over = max(float(np.abs(self.resolve(s, at).over(values)).max()) for s in factors) or 1.0
            self.forms["f", at] = self.made(name, name, largest / over, np.zeros(1))
            found = self.built(f"{name}_term", parse(text).tree, at)
        else:
            found = self.made(name, name, largest, np.zeros(1))
        self.forms[f"unknown_{place}", at] = found
        return found

    def _sized(self, terms: Mapping[str, str], at: int) -> list[Form]:
        """The terms that are linear."""
        found = [linear(parse(text).tree, lambda symbol: self.resolve(symbol, at)) for text in terms.values()]
        return [form for form in found if form is not None]

    def _values(self) -> dict[str, np.ndarray]:
        return {key: wire.values for key, wire in self.wires.items()}

    # ---- operation by operation

    def built(self, name: str, node: Node, at: int) -> Form:
        """The form of an expression, built operation by operation."""
        form = linear(node, lambda symbol: self.resolve(symbol, at))
        if form is not None:
            return form
        match node:
            case Signed(sign, of):
                return self.built(name, of, at).times(Form(-1.0 if sign == "-" else 1.0))
            case Operation("+" | "-" as sign, left, right):
                b = self.built(f"{name}_r", right, at)
                return self.built(f"{name}_l", left, at) + (b if sign == "+" else b.times(Form(-1.0)))
            case Operation("*", left, right):
                a, b = self.built(f"{name}_l", left, at), self.built(f"{name}_r", right, at)
                return a.times(b) if b.is_constant else b.times(a) if a.is_constant else self.product(name, a, b)
            case Operation("/", left, right):
                a, b = self.built(f"{name}_l", left, at), self.built(f"{name}_r", right, at)
                return a.times(Form(1 / b.constant)) if b.is_constant else self.quotient(name, a, b)
            case Operation("**", left, Number(power)) if power in range(2, HIGHEST + 1):
                base = self.built(f"{name}_l", left, at)
                found = base
                for n in range(2, int(power) + 1):
                    found = self.product(f"{name}_{n}", found, base)
                return found
            case Call("when", (condition, of)):
                return self.where(name, condition, self.built(f"{name}_then", of, at), at)
            case Call("exp", (inner,)) if (root := bell(inner)) is not None:
                return self.neuron(name, "radbas", self.built(f"{name}_0", root, at))
            case Call("smooth_step", (x, width)):
                call = Call("tanh", (Operation("/", x, width),))
                return Form(0.5) + self.built(name, call, at).times(Form(0.5))
            case Call(function, given):
                return self.called(name, function, [self.built(f"{name}_{i}", g, at) for i, g in enumerate(given)])
        raise InputError(f"plant {self.plant.name}: {name}: no network is made of this power; write it as a function")

    def neuron(self, name: str, activation: str, form: Form) -> Form:
        """One neuron that answers a form."""
        self.layer(name, form, 1.0, activation=activation)
        layer = cast(Layer, self.network.modules[name])
        return self.made(name, name, 1.0, layer.function.value(np, form.over(self._values())), plain(name))

    def chosen(self, name: str, over: Form, a: Form, b: Form) -> Form:
        """a where `over` is not negative, else b: a multiplexer."""
        values = self._values()
        found = np.where(over.over(values) >= 0, a.over(values), b.over(values))
        scale = float(np.abs(found).max()) or 1.0
        rows = [self.expanded(form) for form in (over, a, b)]
        keys = sorted({key for form in rows for key in form.weights})
        weights = {k: [[form.weights.get(k, 0.0) * self.wires[k].scale / scale] for form in rows] for k in keys}
        layer = Layer(weights, [form.constant / scale for form in rows], "select", frozen={*keys, "bias"})
        self.network.add(name, layer, {k: (self.wires[k].source, self.wires[k].delay) for k in keys})
        return self.made(name, name, scale, found, plain(name))

    def where(self, name: str, condition: Node, form: Form, at: int) -> Form:
        """The form where a condition is not 0, else 0: by a multiplexer where it is max(above, 0), or always.

        Where it is never, all of that is linear.
        """
        known = linear(condition, lambda symbol: self.resolve(symbol, at))
        if known is not None and known.is_constant:
            return form
        match condition:
            case Call("max", (above, Number(0))):
                self.log("part", plain(name), "a multiplexer", "the term acts only where its condition holds")
                over = self.built(f"{name}_if", Signed("-", above), at)
                values = self._values()
                sizes = (float(np.abs(one.over(values)).max()) or 1.0 for one in (form, over))
                return self.chosen(name, over.times(Form(next(sizes) / next(sizes))), Form(), form)  # its sign counts
        why = "no network knows where it is exactly 0; write it as max(..., 0)"
        raise InputError(f"plant {self.plant.name}: {name}: the condition of when(): {why}")

    def called(self, name: str, function: str, given: list[Form]) -> Form:
        if function == "tanh":
            return self.neuron(name, "tansig", given[0])
        if function in ("max", "min", "abs"):
            a, b = given if function != "abs" else (given[0], given[0].times(Form(-1.0)))
            over = a + b.times(Form(-1.0))
            self.log("part", plain(name), "a multiplexer", f"the term holds {function}()")
            return self.chosen(name, over, *((b, a) if function == "min" else (a, b)))
        values, call = self._values(), cast(Callable[..., np.ndarray], FUNCTIONS[function])
        forms = {f"x{i}": form for i, form in enumerate(given) if not form.is_constant}
        known = {"sign": "sign", "sin": "sine", "cos": "cosine"}.get(function)
        at = {n: form.over(values) for n, form in forms.items()}
        if known and (function == "sign" or np.abs(at["x0"]).max() <= np.pi):
            scale = float(np.abs(at["x0"]).max()) if function == "sign" else 1.0
            self.network.add(name, library(known))
            self.network.connect(self.layer(f"{name}_in", given[0], scale), f"{name}.x")
            self.log("part", plain(name), f"library network {known}", f"the term holds {function}()")
            return self.made(name, name, 1.0, call(at["x0"]), plain(name))
        held = [None if not f.is_constant else f.constant for f in given]

        def of(signals: Mapping[str, np.ndarray]) -> np.ndarray:
            return call(*(signals[f"x{i}"] if h is None else h for i, h in enumerate(held)))

        made = self.made_part(plain(name), of, at, {n: [] for n in at})
        self.network.add(name, made.network)
        for n, form in forms.items():
            self.network.connect(self.layer(f"{name}_{n}", form, made.scales[n]), f"{name}.{n}")
        self.joined.rehearse[name] = made.rehearsal
        self.copies.setdefault(plain(name), []).append(name)
        return self.made(name, name, made.size, of(at), plain(name))

    def product(self, name: str, a: Form, b: Form) -> Form:
        """Two forms, each of them scaled to 1, multiplied."""
        values = self._values()
        sizes = [float(np.abs(f.over(values)).max()) or 1.0 for f in (a, b)]
        both = {"a": [[1.0], [0.0]], "b": [[0.0], [1.0]]}
        self.network.add(name, Layer(both, [0.0, 0.0], "product", frozen={*both, "bias"}))
        for port, form, size in zip("ab", (a, b), sizes, strict=True):
            self.network.connect(self.layer(f"{name}_{port}", form, size), f"{name}.{port}")
        self.log("part", plain(name), "a product", "the term multiplies two signals")
        return self.made(name, name, sizes[0] * sizes[1], a.over(values) * b.over(values), plain(name))

    def quotient(self, name: str, a: Form, b: Form) -> Form:
        """By the library's divider, omega / (1 + gamma), with omega over its whole range."""
        values = self._values()
        over = b.over(values)
        centre = float(over.max() + over.min()) / 2
        reach = float(np.abs(over / centre - 1).max()) if centre else np.inf
        if reach > 0.9:
            raise InputError(f"plant {self.plant.name}: {name}: what is divided by comes near zero; write it otherwise")
        size = float(np.abs(a.over(values)).max()) or 1.0
        self.network.add(name, frozen(library("divider")))
        self.network.connect(self.layer(f"{name}_of", a, size, free=self.choices.free), f"{name}.omega")
        gamma = b.times(Form(1 / centre)) + Form(-1.0)
        self.network.connect(self.layer(f"{name}_by", gamma, 1.0, free=self.choices.free), f"{name}.gamma")
        why = f"what is divided by varies by {reach:.2g} of its mean"
        self.log("part", plain(name), "library network divider", why)
        return self.made(name, name, size / centre, a.over(values) / over, plain(name))

    def layer(
        self, name: str, form: Form, scale: float, first: float = 0.0, free: bool = False, activation: str = "linear"
    ) -> str:
        """A layer that gives a form over a scale. free: whether training may move what the data sheet leaves uncertain.

        first: what it gives before the first step.
        """
        form = self.expanded(form)
        weights = {key: [[w * self.wires[key].scale / scale]] for key, w in form.weights.items()}
        known = {key for key in weights if key not in form.free or not free}
        layer = Layer(weights, [form.constant / scale], activation, first, {*known, "bias"})
        self.network.add(name, layer, {key: (self.wires[key].source, self.wires[key].delay) for key in weights})
        for key, ((w,),) in weights.items():
            if key not in known and w:
                moved = form.free[key]
                low, high = sorted((w * max(1 - moved, LEAST), w * (1 + moved)))
                self.joined.bounds[f"{name}.{key}"] = (low, high)
        return name


@dataclass(frozen=True)
class Own:
    """The states' own part of their rates: A in 1/s, and the relative tolerance of each entry."""

    values: np.ndarray
    free: np.ndarray

    def spread(self, h: float) -> tuple[np.ndarray, np.ndarray]:
        """By how much the data sheet leaves the matrices of a step of h seconds uncertain: that of A, and of n."""
        usual = step(self.values, h)
        own, first = np.zeros_like(self.values), np.zeros_like(self.values)
        for i, j in np.argwhere(self.free * self.values):
            moved = self.values.copy()
            moved[i, j] *= 1 + self.free[i, j]
            other = step(moved, h)
            own, first = own + np.abs(other.own - usual.own), first + np.abs(other.first - usual.first)
        return own, first


def staged(state: str, stage: int) -> str:
    """The wire of a state in a stage."""
    return f"{state}_at{stage}"


def named(name: str, at: int) -> str:
    """The name of a module in a stage."""
    name = name.replace(".", "_")
    return name if at == 0 else f"{name}_now" if at == NOW else f"{name}_stage{at}"


def plain(name: str) -> str:
    """The name without its stage."""
    return STAGE.sub("", name)


def poor(rate: np.ndarray) -> bool:
    """Whether a rate is seldom on record between rest and its largest, so that nothing tells what depends on it."""
    part = np.abs(rate) / (np.abs(rate).max() or 1.0)
    return float(np.mean((part > BETWEEN[0]) & (part < BETWEEN[1]))) < RICH


def bell(node: Node) -> Node | None:
    """x of -x**2, as it stands in exp(-x**2)."""
    match node:
        case Signed("-", Operation("**", x, Number(2))):
            return x
    return None


def is_exact(node: Node, fixed: Collection[str]) -> bool:
    """Whether an expression is products, sums and functions that are exact layers, or the library's.

    fixed: names of parameters, of which alone a condition may be that is no level.
    """
    match node:
        case Number() | Name():
            return True
        case Signed(_, of):
            return is_exact(of, fixed)
        case Operation("+" | "-" | "*" | "/", left, right):
            return is_exact(left, fixed) and is_exact(right, fixed)
        case Operation("**", left, Number(power)):
            return power in range(2, HIGHEST + 1) and is_exact(left, fixed)
        case Call("exp", (of,)):
            return (root := bell(of)) is not None and is_exact(root, fixed)
        case Call("when", (Call("max", (above, Number(0))), of)):
            return is_exact(above, fixed) and is_exact(of, fixed)
        case Call("when", (condition, of)):
            return names_of(condition).keys() <= {*fixed} and is_exact(of, fixed)
        case Call("abs" | "sign" | "sin" | "cos" | "tanh" | "max" | "min" | "smooth_step", given):
            return all(is_exact(of, fixed) for of in given)
    return False
