"""What records cannot tell of the weights that are trained on them."""

import numpy as np

from greygate.models.training.objective import Objective

COLLINEAR = 1e-9  # smallest singular value of the regressors, each of unit length, relative to the largest
CONSTANT = 1e-12  # range of a signal relative to its size: rounding alone
ALIKE = 0.1  # share in a collinear combination, relative to the largest, from which a regressor is named
ROWS = 5000  # samples that are enough to see collinear regressors


def remarks(objective: Objective) -> list[str]:
    """Why the weights may not be found from these records, a sentence each.

    Fewer samples than weights, constant targets, constant inputs, collinear regressors.
    """
    found = []
    if objective.samples < len(objective.free):
        weights = f"{len(objective.free)} free weights: more data, fewer weights or decay"
        found.append(f"{objective.samples} samples for {weights}")
    found += _constant_targets(objective)
    constant, regressors = _regressors(objective)
    return found + constant + _collinear(regressors)


def _constant_targets(objective: Objective) -> list[str]:
    columns = [label for p in objective.flat.outputs for label in p.labels]
    targets = np.concatenate([w.target for w in objective.windows]).T
    return [
        f"target {column} is constant: a bias alone fits it; record it while it moves"
        for column, target in zip(columns, targets, strict=True)
        if _is_constant(target)
    ]


def _is_constant(signal: np.ndarray) -> bool:
    return np.ptp(signal) <= CONSTANT * (1 + np.abs(signal).max())


def _regressors(objective: Objective) -> tuple[list[str], dict[str, np.ndarray]]:
    """(remarks on constant inputs, the other measured signals at each delay at which a layer reads them)."""
    constant, found = [], {}
    depth, links = objective.depth, objective.tables.links
    for name, columns in objective.elements().items():
        delays = {int(d) for s, width, d, _ in links if s == columns[0] and width == len(columns)}
        fed_back = name in objective.flat.modules
        if fed_back and not objective.forced[columns].any():
            continue
        for i, c in enumerate(columns):
            component = name if len(columns) == 1 else f"{name}[{i}]"
            signal = np.concatenate([w.past[depth:, c] for w in objective.windows])
            if not fed_back and len(signal) and _is_constant(signal):
                constant.append(f"input {component} is constant: its weights cannot be told from the biases; excite it")
                continue
            for d in sorted(delays):
                delayed = [w.past[depth - d : len(w.past) - d or None, c] for w in objective.windows]
                found[f"{component}(k-{d})" if d else f"{component}(k)"] = np.concatenate(delayed)
    return constant, found


def _collinear(regressors: dict[str, np.ndarray]) -> list[str]:
    names, signals = list(regressors), list(regressors.values())
    if len(signals) < 2 or len(signals[0]) < 2:
        return []
    x = np.array(signals).T[:: max(1, len(signals[0]) // ROWS)]
    x = x - x.mean(axis=0)
    _, s, v = np.linalg.svd(x / (np.linalg.norm(x, axis=0) + 1e-300), full_matrices=False)
    if not s[-1] < COLLINEAR * s[0]:
        return []
    alike = [n for n, c in zip(names, v[-1], strict=True) if abs(c) > ALIKE * np.abs(v[-1]).max()]
    return [f"regressors {', '.join(alike)} are collinear: leave one out, or excite them apart"]
