"""Where no effect of the table fits: in which equation something is missing, on what it depends, and a term for it.

Each equation in turn is given a sum of basis functions of the measured signals; the one whose sum removes most of the
misfit is where it is. Of its functions a few are chosen forward, and they are the term called `unknown`.
"""

from itertools import combinations

import numpy as np

from greygate.mismatch.effects import Effect, Free
from greygate.mismatch.fit import Fit
from greygate.mismatch.search import Hypothesis, Search

TERMS = 4  # basis functions in a closure, at most
DURATION, SPEED, ACCELERATION = 20.0, 0.1, 1.0  # s, m/s, m/s^2: by which signals are scaled
WORTH = 0.03  # of the misfit that a further function must remove


def bases(search: Search) -> dict[str, dict[str, tuple[str, tuple[str, ...]]]]:
    """Equation -> name -> (expression of unit size, what it depends on)."""
    rig = search.rig
    plant = search.final.model.plant
    out: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {}
    if rig.window is None:
        given = rig.inputs[0]
        reach = float(np.ptp(search.final.model.recording[given]))
        x = f"min(max({given}, 0.0), {reach})"  # beyond what was seen it stays as it was
        basis = {"t": (f"t / {DURATION}", ("t",)), "t2": (f"(t / {DURATION})**2", ("t",)),
                 "x": (f"{x} / {reach}", ("x",)), "x2": (f"({x} / {reach})**2", ("x",)),
                 "x3": (f"({x} / {reach})**3", ("x",)),
                 "v": (f"v / {SPEED}", ("v",)), "abs_v": (f"abs(v) / {SPEED}", ("v",)),
                 "sign_v": (f"tanh(20 * v / {SPEED})", ("v",)),
                 "fast": (f"max(abs(v) / {SPEED} - 0.5, 0.0)", ("v",)),
                 "a": (f"a / {ACCELERATION}", ("a",)), "abs_a": (f"abs(a) / {ACCELERATION}", ("a",)),
                 "xt": (f"{x} * t / {reach * DURATION}", ("x", "t")),
                 "xv": (f"{x} * v / {reach * SPEED}", ("x", "v")),
                 "sin_t": (f"sin(6.283185307179586 * t / {DURATION})", ("t",)),
                 "cos_t": (f"cos(6.283185307179586 * t / {DURATION})", ("t",))}  # fmt: skip
        for k in range(1, 13):
            basis[f"sin{k}"] = (f"sin({k} * 3.141592653589793 * {x} / {reach})", ("x",))
            basis[f"cos{k}"] = (f"cos({k} * 3.141592653589793 * {x} / {reach})", ("x",))
        for k in range(24):
            at = (k + 0.5) / 24 * reach
            basis[f"bump{k}"] = (f"exp(-(({x} - {at}) / {reach / 24})**2)", ("x",))
        out["transmission"] = basis
        if "slip" in plant.states:
            out["slip"] = {n: (f"({e}) * travel", d) for n, (e, d) in basis.items() if not n.startswith("bump")}
        return out
    x, v = "x / 0.03", f"v / {SPEED}"
    a, b = "(p_a - 1e7) / 1e7", "(p_b - 1e7) / 1e7"
    t = f"t / {DURATION}"
    u = f"{rig.inputs[-1]} / {1.5 if rig.inputs[-1] == 'v_c' else 6.0}"
    basis = {
        "one": ("1.0", ()), "x": (x, ("x",)), "x2": (f"({x})**2", ("x",)), "x3": (f"({x})**3", ("x",)),
        "v": (v, ("v",)), "abs_v": (f"abs({v})", ("v",)), "vv": (f"({v}) * abs({v})", ("v",)),
        "sign_v": (f"tanh(20 * {v})", ("v",)), "x_sign_v": (f"({x}) * tanh(20 * {v})", ("x", "v")),
        "x2_sign_v": (f"({x})**2 * tanh(20 * {v})", ("x", "v")), "x2v": (f"({x})**2 * {v}", ("x", "v")),
        "xv": (f"({x}) * {v}", ("x", "v")), "p_a": (a, ("p_a",)), "p_b": (b, ("p_b",)),
        "dp": (f"({a}) - ({b})", ("p_a", "p_b")), "t": (t, ("t",)),
        "tv": (f"({t}) * {v}", ("t", "v")), "t_dp": (f"({t}) * (({a}) - ({b}))", ("t", "p_a", "p_b")),
        "t_sign_v": (f"({t}) * tanh(20 * {v})", ("t", "v")),
        "u": (u, (rig.inputs[-1],)), "uu": (f"({u}) * abs({u})", (rig.inputs[-1],)),
        "tu": (f"({t}) * {u}", ("t", rig.inputs[-1])),
    }  # fmt: skip
    scales = {"motion": 300.0, "continuity_a": 1e-6, "continuity_b": 1e-6}
    for equation in scales:
        out[equation] = {name: (f"{scales[equation]} * ({e})", d) for name, (e, d) in basis.items()}
    return out


def _normal(base: Fit, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and right side of the base's unknowns and the basis functions, scaled to a unit diagonal."""
    k = len(base.unknowns)
    flat = np.concatenate([base.slopes, columns], axis=2).reshape(-1, k + columns.shape[2])
    gram, pull = flat.T @ flat, -(flat.T @ base.projected.reshape(-1))
    gram[np.diag_indices(k)] += base.weight
    pull[:k] -= base.weight * base.numbers
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return gram / np.outer(scale, scale), pull / scale


def _saved(gram: np.ndarray, pull: np.ndarray, use) -> float:
    """Cost that these columns together save."""
    use = list(use)
    inner = gram[np.ix_(use, use)] + 1e-9 * np.eye(len(use))
    return float(pull[use] @ np.linalg.solve(inner, pull[use]))


def _subset(gram, pull, k: int, mine: list[int], plain: float, total: float) -> tuple[float, list[int]]:
    """(cost saved, columns): the smallest set of `mine` to which a further function adds little."""
    fixed = list(range(k))
    singles = sorted(mine, key=lambda j: -_saved(gram, pull, [*fixed, j]))
    chosen, gain = [singles[0]], _saved(gram, pull, [*fixed, singles[0]]) - plain
    for size in range(2, TERMS + 1):
        if size == 2:
            trials = [list(pair) for pair in combinations(mine, 2)]
        else:
            trials = [[*chosen, j] for j in mine if j not in chosen]
        saved = [(_saved(gram, pull, [*fixed, *use]) - plain, use) for use in trials]
        most, use = max(saved)
        if most - gain < WORTH * total:
            break
        # of those nearly as good, the one declared first: plain powers before waves and bumps
        near = [u for g, u in saved if g > most - 0.01 * total]
        use = min(near, key=sum)
        chosen, gain = use, _saved(gram, pull, [*fixed, *use]) - plain
    return gain, chosen


def closure(search: Search, calibrated: Fit) -> tuple[dict, Fit]:
    """(where and effect for the diagnosis, fit with the unknown term)."""
    effects: dict[str, Effect] = {}
    for equation, basis in bases(search).items():
        for name, (expression, depends) in basis.items():
            symbol = f"unknown_{equation}_{name}"
            effects[symbol] = Effect(
                symbol, f"unknown term in {equation}", (search.rig.plant.name,), (equation,), depends,
                (Free(symbol, 1e-6 if search.rig.window is None and equation != "slip" else
                      1e-4 if search.rig.window is None else 1.0, "", reported=symbol),),
                terms={f"{equation}.{symbol}": f"{symbol} * ({expression})"}, of="unknown",
            )  # fmt: skip
    joined = {**search.effects, **effects}
    again = Search(search.rig, search.final.model.recording, joined)
    again.effects = joined
    problem = again.screen
    base = again.base(problem)
    columns, keys = [], list(effects)
    for key in keys:
        unknowns = [again._unknown(f) for f in effects[key].free]
        start = {**base.values, **{f.symbol: 0.0 for f in effects[key].free}}
        column, _ = problem.eliminate(problem.slopes(unknowns, start, base.shifts, base.errors), None, base.basis)
        columns.append(column)
    gram, pull = _normal(base, np.concatenate(columns, axis=2))
    k = len(base.unknowns)
    plain = _saved(gram, pull, range(k))
    total = float(np.sum(base.projected**2)) - problem.count * 0.9 / float(np.mean(base.temper**2)) - plain
    best: dict[str, tuple[float, list[str]]] = {}
    for equation in {effects[key].equations[0] for key in keys}:
        mine = [k + j for j, key in enumerate(keys) if effects[key].equations[0] == equation]
        best[equation] = _subset(gram, pull, k, mine, plain, total)
    equation, (gain, at) = max(best.items(), key=lambda item: item[1][0])
    chosen = [keys[j - k] for j in at]
    hypothesis = Hypothesis(tuple(chosen))
    fit = again.fit(problem, hypothesis, base.values, base.shifts)
    fit = again.fit(again.final, hypothesis, fit.values)
    depends = list(dict.fromkeys(v for key in chosen for v in effects[key].depends_on))
    reported = "transmission" if search.rig.window is None else equation
    effect = {
        "id": "unknown",
        "equations": [reported],
        "confidence": round(min(gain / max(total, 1e-9), 1.0), 4),
        "parameters": {
            s: {"value": fit.values[s], "ci95": [fit.values[s] - 1.96 * fit.deviation(s),
                                                 fit.values[s] + 1.96 * fit.deviation(s)], "unit": "",
                 "place": effects[s].equations[0],
                "term": effects[s].terms[f"{effects[s].equations[0]}.{s}"]}
            for s in chosen
        },
        "not_told_apart_from": [],
    }  # fmt: skip
    regime = f"a term of {', '.join(depends) or 'constant size'}"
    where = [{"equation": reported, "depends_on": depends, "regime": regime}]
    return {"where": where, "effect": effect, "gain": gain / max(total, 1e-9)}, fit
