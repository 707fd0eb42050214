"""Where no effect of the table fits: in which equation something is missing, on what it depends, and a term for it.

Each equation, and each sensor, in turn is given a sum of a few basis functions of the signals, chosen and judged on
stretches of the recording that its coefficients did not see. The one that removes most of the misfit is where it is;
in an equation its sum is the term called `unknown`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from greygate.mismatch.effects import Effect, Free
from greygate.mismatch.fit import Fit
from greygate.mismatch.model import lagged
from greygate.mismatch.rig import Rig
from greygate.mismatch.search import Hypothesis, Search
from greygate.plants.expressions import replaced
from greygate.plants.plant import Values

STRETCH = 1.0  # s of recording that are learnt from, then judged on, by turns
LAGS = (0.002, 0.005, 0.015)  # s of a sensor that answers late
TERMS = 4  # basis functions in a closure, at most
DURATION, SPEED, ACCELERATION = 20.0, 0.1, 1.0  # s, m/s, m/s^2: by which signals are scaled
SURE = 5.0  # standard deviations of a coefficient, below which its function goes again
WORTH = 0.03  # of the misfit that a further function must remove


Basis = dict[str, tuple[str, tuple[str, ...]]]
"""Name -> (expression of unit size, what it depends on)."""


def bases(search: Search, signals: Mapping[str, np.ndarray]) -> dict[str, Basis]:
    """Equation -> functions that may be missing there. signals: states and inputs along the recording (samples,)."""
    plant = search.final.model.plant
    places = {*plant.equations, *plant.definitions}
    if search.rig.window and places >= {"motion", "continuity_a", "continuity_b"}:
        return _cylinder(search.rig)
    if not search.rig.window and "transmission" in places:
        return _line(search)
    return _any(search, signals)


def held(symbol: str) -> str:
    """A signal that stays as it was beyond what was seen."""
    return f"min(max({symbol}, seen_low_{symbol}), seen_high_{symbol})"


def _line(search: Search) -> dict[str, Basis]:
    out: dict[str, Basis] = {}
    given = search.rig.inputs[0]
    x, reach = f"({held(given)} - seen_low_{given})", f"(seen_high_{given} - seen_low_{given})"
    basis = {"t": (f"t / {DURATION}", ("t",)), "t2": (f"(t / {DURATION})**2", ("t",)),
             "x": (f"{x} / {reach}", ("x",)), "x2": (f"({x} / {reach})**2", ("x",)),
             "x3": (f"({x} / {reach})**3", ("x",)),
             "v": (f"v / {SPEED}", ("v",)), "abs_v": (f"abs(v) / {SPEED}", ("v",)),
             "sign_v": (f"tanh(20 * v / {SPEED})", ("v",)),
             "fast": (f"max(abs(v) / {SPEED} - 0.5, 0.0)", ("v",)),
             "a": (f"a / {ACCELERATION}", ("a",)), "abs_a": (f"abs(a) / {ACCELERATION}", ("a",)),
             "xt": (f"{x} * t / ({reach} * {DURATION})", ("x", "t")),
             "xv": (f"{x} * v / ({reach} * {SPEED})", ("x", "v"))}  # fmt: skip
    for k in range(1, 13):
        basis[f"sin{k}"] = (f"sin({k} * 3.141592653589793 * {x} / {reach})", ("x",))
        basis[f"cos{k}"] = (f"cos({k} * 3.141592653589793 * {x} / {reach})", ("x",))
    for k in range(1, 13):
        basis[f"cycle_sin{k}"] = (f"sin({k} * 3.141592653589793 * t / {DURATION})", ("t",))
        basis[f"cycle_cos{k}"] = (f"cos({k} * 3.141592653589793 * t / {DURATION})", ("t",))
    for k in range(24):
        basis[f"bump{k}"] = (f"exp(-(24.0 * {x} / {reach} - {k + 0.5})**2)", ("x",))
    out["transmission"] = basis
    if "slip" in search.final.model.plant.states:
        out["slip"] = {n: (f"({e}) * travel", d) for n, (e, d) in basis.items() if not n.startswith(("bump", "cycle"))}
    return out


def _cylinder(rig: Rig) -> dict[str, Basis]:
    out: dict[str, Basis] = {}
    x, v = f"{held('x')} / 0.03", f"{held('v')} / {SPEED}"
    a, b = f"({held('p_a')} - 1e7) / 1e7", f"({held('p_b')} - 1e7) / 1e7"
    t = f"t / {DURATION}"
    basis = {
        "one": ("1.0", ()), "x": (x, ("x",)), "x2": (f"({x})**2", ("x",)), "x3": (f"({x})**3", ("x",)),
        "v": (v, ("v",)), "abs_v": (f"abs({v})", ("v",)), "vv": (f"({v}) * abs({v})", ("v",)),
        "sign_v": (f"tanh(20 * {v})", ("v",)), "x_sign_v": (f"({x}) * tanh(20 * {v})", ("x", "v")),
        "x2_sign_v": (f"({x})**2 * tanh(20 * {v})", ("x", "v")), "x2v": (f"({x})**2 * {v}", ("x", "v")),
        "xv": (f"({x}) * {v}", ("x", "v")), "p_a": (a, ("p_a",)), "p_b": (b, ("p_b",)),
        "dp": (f"({a}) - ({b})", ("p_a", "p_b")), "t": (t, ("t",)),
        "tv": (f"({t}) * {v}", ("t", "v")), "t_dp": (f"({t}) * (({a}) - ({b}))", ("t", "p_a", "p_b")),
        "t_sign_v": (f"({t}) * tanh(20 * {v})", ("t", "v")),
    }  # fmt: skip
    for name in reversed(rig.inputs):
        u = f"{held(name)} / seen_high_{name}"
        basis |= {name: (u, (name,)), f"{name}_sign": (f"tanh(20 * {u})", (name,)),
                  f"{name}2": (f"{u} * abs({u})", (name,)), f"t_{name}": (f"({t}) * {u}", ("t", name))}  # fmt: skip
    scales = {"motion": 300.0, "continuity_a": 1e-6, "continuity_b": 1e-6}
    for equation in scales:
        out[equation] = {name: (f"{scales[equation]} * ({e})", d) for name, (e, d) in basis.items()}
    return out


def _any(search: Search, signals: Mapping[str, np.ndarray]) -> dict[str, Basis]:
    """For every balance but that of a position, powers of each signal, as large as the largest term that is there."""
    model = search.final.model
    plant = model.plant
    rates = {state.rate for state in plant.states.values() if state.rate}
    scope = Values(plant, dict(signals))
    scope.update(model.values)
    out: dict[str, Basis] = {}
    for name, equation in plant.equations.items():
        if plant.states[equation.state].rate:
            continue
        size = max(float(np.sqrt(np.mean(np.square(scope.evaluate(term))))) for term in equation.terms.values())
        scale = f"{10.0 ** round(np.log10(max(size, 1e-300)))!r}"
        basis = {"one": ("1.0", ())}
        for s in signals:
            z = f"((2.0 * {held(s)} - seen_low_{s} - seen_high_{s}) / (seen_high_{s} - seen_low_{s}))"
            basis |= {s: (z, (s,)), f"{s}2": (f"{z}**2", (s,)), f"{s}3": (f"{z}**3", (s,))}
            if s in rates:
                basis[f"sign_{s}"] = (f"tanh(20.0 * {s} / seen_high_{s})", (s,))
        out[name] = {key: (f"{scale} * ({e})", on) for key, (e, on) in basis.items()}
    return out


@dataclass(frozen=True)
class _Halves:
    """Normal matrices and right sides of all columns over alternate stretches, scaled; k come from the base."""

    gram: np.ndarray  # (2, n, n)
    pull: np.ndarray  # (2, n)
    k: int

    @classmethod
    def of(cls, base: Fit, columns: np.ndarray) -> "_Halves":
        k, windows = len(base.unknowns), len(base.slopes)
        both = np.concatenate([base.slopes, columns], axis=2)
        problem = base.problem
        stretch = max(round(STRETCH / (problem.block * problem.model.rig.dt)), 1)
        even = (np.arange(windows) // stretch) % 2 == 0
        gram, pull = [], []
        for half in (even, ~even):
            flat, e = both[half].reshape(-1, both.shape[2]), base.projected[half].reshape(-1)
            g, p = flat.T @ flat, -(flat.T @ e)
            g[np.diag_indices(k)] += base.weight / 2
            p[:k] -= base.weight * base.numbers / 2
            gram.append(g)
            pull.append(p)
        scale = np.sqrt(np.maximum(np.diag(gram[0] + gram[1]), 1e-300))
        return cls(np.array(gram) / np.outer(scale, scale), np.array(pull) / scale, k)

    def saved(self, chosen: list[int]) -> float:
        """Cost that the chosen columns save on the half that their coefficients were not fitted to, both ways."""
        use = [*range(self.k), *chosen]
        total = 0.0
        for learn, judge in ((0, 1), (1, 0)):
            g = self.gram[learn][np.ix_(use, use)] + 1e-6 * np.eye(len(use))
            step = np.linalg.solve(g, self.pull[learn][use])
            total += float(2 * self.pull[judge][use] @ step - step @ self.gram[judge][np.ix_(use, use)] @ step)
        return total

    def subset(self, mine: list[int], total: float) -> tuple[float, list[int]]:
        """(cost saved, columns): the smallest set of `mine` to which a further function adds little."""
        plain = self.saved([])
        gain, chosen = max((self.saved([j]) - plain, [j]) for j in mine)
        for size in range(2, TERMS + 1):
            if size == 2:
                trials = [list(pair) for pair in combinations(mine, 2)]
            else:
                trials = [[*chosen, j] for j in mine if j not in chosen]
            saved = [(self.saved(use) - plain, use) for use in trials]
            most = max(saved)[0]
            if most - gain < WORTH * total:
                break
            # of those nearly as good the ones declared first: plain powers before waves and bumps
            gain, chosen = min(((g, use) for g, use in saved if g > most - WORTH / 3 * total), key=lambda t: sum(t[1]))
        return gain, chosen


def _sensors(search: Search, base: Fit) -> dict[tuple[str, str], np.ndarray]:
    """(place, function) -> what a sensor at fault would add to the errors, (samples, channels)."""
    problem, rig = base.problem, search.rig
    predicted = problem.model.target - np.where(np.isfinite(problem.sigma), base.errors, 0.0) * np.where(
        np.isfinite(problem.sigma), problem.sigma, 0.0
    )
    out = {}
    for i, channel in enumerate(rig.predict):
        signal = predicted[:, i]
        rate = np.gradient(signal, rig.dt)
        shapes = {
            "one": np.ones_like(signal),
            "value": signal - signal.mean(),
            "rate": rate,
            "t": problem.model.recording.time,
        }
        shapes |= {f"lag_{1e3 * lag:.0f}_ms": lagged(signal, lag, rig.dt) - signal for lag in LAGS}
        for name, shape in shapes.items():
            column = np.zeros_like(base.errors)
            column[:, i] = (
                -shape / max(float(np.std(shape)), 1e-12 * float(np.abs(shape).max()) + 1e-300) / problem.sigma[:, i]
            )
            out[f"sensor_{channel}", name] = column
    return out


def closure(search: Search) -> tuple[dict, Fit]:
    """(where and effect for the diagnosis, fit with the unknown term)."""
    rig, model = search.rig, search.final.model
    signals = _signals(search)
    seen = {f"seen_low_{symbol}": float(signal.min()) for symbol, signal in signals.items()}
    seen |= {f"seen_high_{symbol}": float(signal.max()) for symbol, signal in signals.items()}
    effects: dict[str, Effect] = {}
    for equation, basis in bases(search, signals).items():
        small = {"slip": 1e-4, "transmission": 1e-6}.get(equation, 1.0)
        for name, (expression, depends) in basis.items():
            symbol = f"unknown_{equation}_{name}"
            free = (Free(symbol, small, "", reported=symbol),)
            term = {f"{equation}.{symbol}": f"{symbol} * ({expression})"}
            effects[symbol] = Effect(
                symbol, f"unknown term in {equation}", (rig.plant.name,), (equation,), depends, free, term, of="unknown"
            )
    limits = tuple(Free(symbol, value, shape=True) for symbol, value in seen.items())
    joined = {**search.effects, **effects, "seen": Effect("seen", "", (rig.plant.name,), (), (), limits)}
    again = Search(rig, model.recording, joined)
    again.effects = joined
    problem = again.final
    base = again.base(problem)
    keys = [(effect.equations[0], key) for key, effect in effects.items()]
    columns = []
    for _, key in keys:
        unknowns = [again._unknown(f) for f in effects[key].free]
        start = {**base.values, **{f.symbol: 0.0 for f in effects[key].free}}
        columns.append(problem.slopes(unknowns, start, base.shifts, base.errors, base.temper))
    if rig.window:
        for (place, name), column in _sensors(search=again, base=base).items():
            keys.append((place, name))
            columns.append(problem.rows(column[:, :, None], base.temper))
    columns = problem.eliminate(np.concatenate(columns, axis=2), None, base.basis)[0]
    halves = _Halves.of(base, columns)
    total = float(np.sum(base.projected**2)) - problem.count * 0.9 / float(np.mean(base.temper**2)) - halves.saved([])
    best = {
        place: halves.subset([halves.k + j for j, key in enumerate(keys) if key[0] == place], total)
        for place in dict.fromkeys(place for place, _ in keys)
    }
    place, (gain, at) = max(best.items(), key=lambda item: item[1][0] - WORTH * total * len(item[1][1]))
    chosen = [keys[j - halves.k][1] for j in sorted(at)]
    share = float(np.clip(gain / max(total, 1e-9), 0.0, 1.0))
    reported = "transmission" if place == "slip" else place
    if place.startswith("sensor_"):
        depends, effect, fit = [place.removeprefix("sensor_")], None, None
    else:
        fit = again.fit(problem, Hypothesis(tuple(chosen)), base.values, base.shifts)
        sure = [key for key in chosen if abs(fit.values[key]) > SURE * fit.deviation(key)]
        if sure and sure != chosen:  # the others were there to bend the straight line that chose them
            chosen, fit = sure, again.fit(problem, Hypothesis(tuple(sure)), fit.values, fit.shifts)
        depends = list(dict.fromkeys(v for key in chosen for v in effects[key].depends_on))
        effect = {
            "id": "unknown",
            "equations": [reported],
            "confidence": round(share, 4),
            "parameters": {s: _parameter(effects[s], fit, seen) for s in chosen},
            "not_told_apart_from": [],
        }
    regime = f"a term of {', '.join(depends) or 'constant size'}, which takes {share:.0%} of the misfit"
    where = [{"equation": reported, "depends_on": depends, "regime": regime}]
    return {"where": where, "effect": effect}, fit


def _signals(search: Search) -> dict[str, np.ndarray]:
    """Inputs and states that move, as recorded, or a rate of what was recorded; other states as simulated."""
    model = search.final.model
    states, inputs = model.states(model.values)
    rates = {state.rate: symbol for symbol, state in model.plant.states.items() if state.rate}
    found = {name: signal for name, signal in inputs.items() if name not in model.plant.derived}
    for symbol, simulated in zip(model.plant.states, states.T, strict=True):
        if symbol in model.recording.channels:
            found[symbol] = model.recording[symbol]
        elif rates.get(symbol) in model.recording.channels:
            found[symbol] = model.smooth_rate(rates[symbol])
        elif symbol in search.rig.plant.states:
            found[symbol] = simulated
    return {symbol: signal for symbol, signal in found.items() if np.isfinite(signal).all() and np.ptp(signal) > 0}


def _parameter(effect: Effect, fit: Fit, seen: dict[str, float]) -> dict:
    """A coefficient as the diagnosis keeps it, with the term it stands in, its limits as numbers."""
    symbol = effect.key
    place, term = effect.equations[0], effect.terms[f"{effect.equations[0]}.{symbol}"]
    term = replaced(term, {name: repr(limit) for name, limit in seen.items()})
    value, reach = fit.values[symbol], 1.96 * fit.deviation(symbol)
    return {"value": value, "ci95": [value - reach, value + reach], "unit": "", "place": place, "term": term}
