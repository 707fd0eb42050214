"""A linear model without a start and without iterations: poles by a subspace, the rest by least squares.

The past of inputs and output foretells the future of the output through the state alone. So the part of the future that
the past explains, beside what future inputs make of it, has the rank of the state, and its columns are what a free
state shows: from these come the poles (PO-MOESP: Verhaegen 1994; Ljung 1999, 10.6). No kept library serves: nfoursid
takes one recording, and memory for the square of its samples.
"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from greygate.identify.ladder import LOOP, Orders, own
from greygate.models.network import Network, Port
from greygate.models.training.record import Record

ROWS = 3  # times the order, in samples: of the past, and of the future
RANK = 1e-10  # of the largest singular value, below which columns of a least-squares problem are dependent


def subspace(orders: Orders, output: Port, start: Network, pieces: Sequence[Record]) -> Network | None:
    """The linear model `start` with poles and weights by the subspace of `pieces`; None where they are too short.

    orders: of `start`, with taps one sample apart.
    """
    inputs = start.inputs
    parts = [_part(p, inputs, orders, output) for p in pieces]
    denominator = poles(parts, orders.order)
    if denominator is None:
        return None
    found = numerators(parts, denominator, orders.order)
    loop = own(LOOP, [p.name for p in (*inputs, output)])
    values = {f"{loop}.{output.name}_z{i}": -denominator[i] for i in orders.feedback} | {f"{loop}.bias": found[-1]}
    taps = [f"{loop}.{p.name}_z{d}" for p, delays in orders.inputs(inputs).items() for d in delays]
    values |= dict(zip(taps, found[:-1], strict=True))
    return start.with_parameters({n: np.full(v.shape, values[n]) for n, v in start.parameters().items()})


Part = tuple[np.ndarray, np.ndarray]  # inputs (N, m), each late by its delay, and output (N,), normalised


def _part(record: Record, inputs: Sequence[Port], orders: Orders, output: Port) -> Part:
    late = [
        np.concatenate([np.full(min(d, len(record)), s[0]), s[: max(len(record) - d, 0)]])
        for s, d in ((p.normalised(record.inputs[p.name]), d) for p, d in zip(inputs, orders.delays, strict=True))
    ]
    return np.stack(late, axis=1), output.normalised(record.targets[output.name])


def poles(parts: Sequence[Part], order: int) -> np.ndarray | None:
    """Denominator (order + 1,), its first entry 1; None where the parts are too short for their rows."""
    rows = ROWS * (order + 1)
    blocks = []
    for u, y in parts:
        if len(y) < 2 * rows:
            continue
        past_u, future_u = _hankel(u, rows)
        past_y, future_y = _hankel(y[:, None], rows)
        known = np.hstack([np.ones((len(future_u), 1)), future_u])  # with what every level adds
        blocks.append(np.hstack([known, past_u, past_y, future_y]))
    if not blocks or sum(map(len, blocks)) < blocks[0].shape[1]:
        return None
    triangle = np.asarray(np.linalg.qr(np.concatenate(blocks), mode="r")).T
    past, last = known.shape[1], triangle.shape[0] - rows
    shown, size, _ = np.linalg.svd(triangle[last:, past:last])  # the future that the past explains
    observed = shown[:, :order] * np.sqrt(size[:order])
    state = np.linalg.lstsq(observed[:-1], observed[1:], rcond=None)[0]
    return np.real(np.poly(state))


def _hankel(signals: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Past and future (columns, rows * signals) of signals (N, m): a row for each window of 2 * rows samples."""
    windows = np.lib.stride_tricks.sliding_window_view(signals, 2 * rows, axis=0)  # (columns, m, 2 rows)
    past, future = windows[:, :, :rows], windows[:, :, rows:]
    return past.reshape(len(windows), -1), future.reshape(len(windows), -1)


def numerators(parts: Sequence[Part], denominator: np.ndarray, order: int) -> np.ndarray:
    """Weights of each input's order + 1 taps, and the bias, whose free run over the parts errs least.

    Each part begins in a state of its own, which is fitted, too.
    """
    known, free = [], []
    for u, _ in parts:
        ones = np.ones((len(u), 1))
        signals = np.hstack([_taps(column, order) for column in u.T] + [ones])
        known.append(lfilter([1.0], denominator, signals, axis=0))
        begun = np.zeros((len(u), order))
        begun[: min(order, len(u))] = np.eye(order)[: len(u)]
        free.append(lfilter([1.0], denominator, begun, axis=0))
    count, rest = known[0].shape[1], [np.zeros((len(k), order * len(parts))) for k in known]
    for i, (whole, response) in enumerate(zip(rest, free, strict=True)):
        whole[:, i * order : (i + 1) * order] = response
    columns = np.hstack([np.concatenate(known), np.concatenate(rest)])
    with np.errstate(over="ignore"):
        size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    if not np.isfinite(size).all():  # of poles far outside the unit circle, whose free run is useless
        return np.zeros(count)
    found = np.linalg.lstsq(columns / size, np.concatenate([y for _, y in parts]), rcond=RANK)[0]
    return (found / size)[:count]


def _taps(signal: np.ndarray, order: int) -> np.ndarray:
    """The signal (N,) 0 to `order` samples late (N, order + 1); before it began it stood where it begins."""
    padded = np.concatenate([np.full(order, signal[0]), signal])
    return np.stack([padded[order - i : len(padded) - i] for i in range(order + 1)], axis=1)
