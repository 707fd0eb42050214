"""The model of a plant: its equations in C, and the steps of `plants.simulate`, with its parameters to be set."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from greygate.compiler.verilog import render
from greygate.errors import InputError
from greygate.export.model import Model, Variable
from greygate.export.wrapped import wrapped
from greygate.plants.expressions import Call, Name, Node, Number, Operation, Signed, names, parse
from greygate.plants.plant import Equation, Plant
from greygate.plants.simulator import coupled, weights

FUNCTIONS = {"abs": "fabs", "min": "least", "max": "greatest", "sign": "sign_of"}  # the others have C's own names


def model(plant: Plant) -> Model:
    """The model of a plant. A communication step is divided into equal steps of about `plant.step`.

    Raises InputError for a plant without a state, which has nothing to step, and for an output that is an input.
    """
    if not plant.states:
        raise InputError(f"plant {plant.name}: has no state; an FMU of a static plant is not made here")
    if through := [o for o in plant.outputs if o in plant.inputs]:
        raise InputError(f"plant {plant.name}: the output {through[0]} is an input; leave it out of `outputs`")
    initial = plant.initial()
    inputs = tuple(Variable(s, unit, 0.0, plant.derived.get(s, "")) for s, unit in plant.inputs.items())
    parameters = tuple(Variable(s, p.unit, p.value, p.meaning) for s, p in plant.parameters.items())
    outputs = tuple(Variable(s, plant.unit(s)) for s in plant.outputs)
    seen = tuple(Variable(s, state.unit) for s, state in plant.states.items() if s not in plant.outputs)
    n = len(initial)
    within = wrapped(plant) if plant.outside is not None else None
    made = Model(
        name=plant.name,
        meaning=f"plant {plant.name}",
        period=plant.step,
        discrete=False,
        inputs=inputs,
        parameters=parameters,
        outputs=outputs,
        seen=seen,
        state=(f"double x[{n}];", f"double low[{n}];", f"double high[{n}];", *(within.state if within else ())),
        includes=(),
        sources={},
        resources=within.files if within else {},
    )
    return replace(made, sources={"model.c": _source(plant, made, within.source if within else "")})


def _source(plant: Plant, made: Model, inner: str) -> str:
    plant = plant if plant.outside is None else plant.without(*plant.outside.own)
    states = list(plant.states)
    place = {v.name: i for i, v in enumerate(made.variables)}
    fixed = {v.name: place[v.name] for v in made.parameters}
    given = {v.name: place[v.name] for v in (*made.inputs, *made.parameters)}
    used = names(t for equation in plant.equations.values() for t in equation.texts)
    bounds = [
        (f"m->{which}[{j}]", getattr(state, which), free)
        for j, state in enumerate(plant.states.values())
        for which, free in (("low", "-INFINITY"), ("high", "INFINITY"))
    ]
    shown = (*made.outputs, *made.seen)
    rates = (-1 if s.rate is None else states.index(s.rate) for s in plant.states.values())
    context = {
        "states": len(states),
        "weights": "\n".join(f"    {{{', '.join(map(_fraction, row))}}}," for row in weights()),
        "starts": made.starts,
        "parameters": "\n".join(_quantities(fixed)),
        "initial": "\n".join(f"    m->x[{j}] = {_bound(s.initial, '')};" for j, s in enumerate(plant.states.values())),
        "limits": "\n".join(f"    {to} = {_bound(bound, free)};" for to, bound, free in bounds),
        "known": "\n".join([*_quantities(given), *_states(states, "m->x")]),
        "definitions": "\n".join(_defined(plant, plant.outputs)),
        "outputs": "\n".join(f"    m->value[{place[v.name]}] = q_{v.name};" for v in shown),
        "moving": "\n".join(
            [*_quantities(given), *_states(states, "x"), *_defined(plant, used), *_rates(plant, states)]
        ),
        "inner": inner,
        "rates": f"{{{', '.join(map(str, rates))}}}",
    }
    return render("plant.c", context, "greygate.export")


def _fraction(weight: str) -> str:
    over, _, under = weight.partition("/")
    return f"{over}.0 / {under}.0" if under else f"{over}.0"


def _quantities(places: Mapping[str, int]) -> Iterator[str]:
    for symbol, i in places.items():
        yield f"    const double q_{symbol} = m->value[{i}];"
        yield f"    (void)q_{symbol};"


def _states(states: Iterable[str], array: str) -> Iterator[str]:
    for j, symbol in enumerate(states):
        yield f"    const double q_{symbol} = {array}[{j}];"
        yield f"    (void)q_{symbol};"


def _defined(plant: Plant, symbols: Iterable[str]) -> Iterator[str]:
    for d in plant.needed(symbols):
        yield f"    const double q_{d.symbol} = {_sum(d.terms)};"


def _rates(plant: Plant, states: list[str]) -> Iterator[str]:
    for group in coupled(plant):
        if len(group) > 1:
            yield from _solved(group, states)
        else:
            (e,) = group
            yield f"    dx[{states.index(e.state)}] = ({_sum(e.terms)}) / ({c(e.storage)});"


def _solved(group: list[Equation], states: list[str]) -> Iterator[str]:
    """Elimination without pivots, as in `plants.simulate`."""
    n = len(group)
    yield f"    double a[{n}][{n}];"
    yield f"    double b[{n}];"
    for i, e in enumerate(group):
        yield f"    b[{i}] = {_sum(e.terms)};"
        of = {e.state: e.storage, **e.couples}
        yield from (f"    a[{i}][{j}] = {c(of.get(o.state, '0'))};" for j, o in enumerate(group))
    for k in range(n):
        for i in range(k + 1, n):
            ratio = f"(a[{i}][{k}] / a[{k}][{k}])"
            yield f"    b[{i}] -= {ratio} * b[{k}];"
            yield from (f"    a[{i}][{j}] -= {ratio} * a[{k}][{j}];" for j in reversed(range(k, n)))
    for i in reversed(range(n)):
        known = "".join(f" - (a[{i}][{j}] * dx[{states.index(group[j].state)}])" for j in range(i + 1, n))
        yield f"    dx[{states.index(group[i].state)}] = (b[{i}]{known}) / a[{i}][{i}];"


def _bound(bound: float | str | None, free: str) -> str:
    return free if bound is None else c(bound) if isinstance(bound, str) else repr(float(bound))


def _sum(terms: Mapping[str, str]) -> str:
    return " + ".join(c(text) for text in terms.values()) or "0.0"


def c(expression: str) -> str:
    """An expression in C; the symbol x is the variable q_x."""
    return _c(parse(expression).tree)


def _c(node: Node) -> str:
    match node:
        case Number(value):
            return repr(float(value))
        case Name(symbol):
            return f"q_{symbol}"
        case Signed(sign, of):
            return f"({sign}{_c(of)})"
        case Operation(constant=float(value)) | Call(constant=float(value)):
            return f"({value!r})"
        case Operation("**", base, exponent):
            n = _whole(exponent)
            return f"pow({_c(base)}, {_c(exponent)})" if n is None else f"whole({_c(base)}, {n})"
        case Operation(sign, left, right):
            return f"({_c(left)} {sign} {_c(right)})"
        case Call("when", (condition, value)):
            return f"(({_c(condition)} != 0.0) ? {_c(value)} : 0.0)"
        case Call(function, given):
            return f"{FUNCTIONS.get(function, function)}({', '.join(map(_c, given))})"


def _whole(node: Node) -> int | None:
    match node:
        case Number(int(value)):
            return value
        case Signed("-", Number(int(value))):
            return -value
    return None
