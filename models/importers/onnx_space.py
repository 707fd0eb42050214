"""Operations of ONNX along axes of space or time: convolutions and pools, as places in the tensor that they read."""

from collections.abc import Callable, Sequence
from functools import reduce
from math import prod
from typing import Any

import numpy as np

from greygate.models.importers.builder import Value, constant, joined


def _patches(
    walk: Any,
    x: Value,
    kernel: Sequence[int],
    strides: Sequence[int] = (),
    pads: Sequence[int] = (),
    dilations: Sequence[int] = (),
    auto_pad: str = "NOTSET",
    ceil_mode: int = 0,
) -> np.ndarray:
    """Of a tensor (N, C, space): the place of each number that a kernel reads, -1 outside.

    Its shape is (N, C, space of the result, one axis of the taps of the kernel).
    """
    n = len(kernel)
    if len(x.shape) != n + 2:
        raise walk.refused(
            f"takes {list(x.shape)}, and its kernel {list(kernel)}: one batch, one of channels, then space"
        )
    steps, apart = list(strides) or [1] * n, list(dilations) or [1] * n
    reach = [(k - 1) * d + 1 for k, d in zip(kernel, apart, strict=True)]
    edges = list(pads) or [0] * (2 * n)
    if auto_pad.startswith("SAME"):
        total = [max((-(-s // t) - 1) * t + r - s, 0) for s, t, r in zip(x.shape[2:], steps, reach, strict=True)]
        less = [t // 2 for t in total]
        more = [t - v for t, v in zip(total, less, strict=True)]
        edges = more + less if auto_pad == "SAME_LOWER" else less + more
    if ceil_mode:
        raise walk.refused("ceil_mode = 1 is not carried; export the model with ceil_mode = 0")
    sizes = [s + edges[k] + edges[k + n] for k, s in enumerate(x.shape[2:])]
    if any(s < r for s, r in zip(sizes, reach, strict=True)):
        raise walk.refused(f"its kernel {list(kernel)} is larger than what it reads, {list(x.shape)}")
    count = prod(x.shape[:2]) * prod((s - r) // t + 1 for s, r, t in zip(sizes, reach, steps, strict=True))
    walk.room(count * prod(kernel) + prod(x.shape[:2]) * prod(sizes))
    places = np.arange(x.size).reshape(x.shape)
    wide = np.pad(places, [(0, 0), (0, 0), *zip(edges[:n], edges[n:], strict=True)], constant_values=-1)
    seen = np.lib.stride_tricks.sliding_window_view(wide, reach, tuple(range(2, n + 2)))
    space = [slice(None, None, t) for t in (*steps, *apart)]
    cut: tuple[Any, ...] = (slice(None), slice(None), *space)
    found = seen[cut]
    return found.reshape(*found.shape[: n + 2], -1)


def _read(x: Value, places: np.ndarray) -> Value:
    """The numbers at places; 0 at -1."""
    return joined([constant(np.zeros(1)), x.moved(np.ravel)], 0).rows(places + 1)


def conv(
    walk: Any,
    x: Value,
    w: Value,
    b: Value | None = None,
    group: int = 1,
    kernel_shape: Sequence[int] = (),
    **options: Any,
) -> Value:
    """Over its whole input it is a Gemm, as MATLAB writes its fully connected layers."""
    weights = walk.fixed(w, "the kernel")
    m, each = weights.shape[:2]
    places = _patches(walk, x, weights.shape[2:], **options)
    parts = []
    for g in range(group):
        own = np.moveaxis(places[:, g * each : (g + 1) * each], 1, -2)  # (N, space, channels, taps)
        flat = _read(x, own.reshape(*own.shape[:-2], -1))
        of = weights[g * m // group : (g + 1) * m // group]
        parts.append(flat.linear(of.reshape(len(of), -1)))
    found = joined(parts, len(parts[0].shape) - 1)
    if b is not None:
        found = found.plus(b)
    return found.moved(lambda i: np.moveaxis(i, -1, 1))


def average(walk: Any, x: Value, kernel_shape: Sequence[int], count_include_pad: int = 0, **options: Any) -> Value:
    places = _patches(walk, x, kernel_shape, **options)
    shares = 1.0 / (places.shape[-1] if count_include_pad else (places >= 0).sum(-1))
    return _read(x, places).summed([-1]).times(shares)


def largest(walk: Any, x: Value, kernel_shape: Sequence[int], storage_order: int = 0, **options: Any) -> Value:
    """The maximum of each patch; a place outside is left out."""
    if len([n for n in walk.node.output if n]) > 1:
        raise walk.refused("its second output says where the largest is; leave that out")
    places = _patches(walk, x, kernel_shape, **options)
    places = np.where(places < 0, places.max(-1, keepdims=True), places)
    taps = (_read(x, places[..., k]) for k in range(places.shape[-1]))
    return reduce(lambda a, b: walk.builder.maximum(a, b, walk.hint), taps)


def whole(how: Callable[[Value, Sequence[int], bool], Value]) -> Callable:
    """A pool over all of space."""
    return lambda walk, x: how(x, list(range(2, len(x.shape))), True)
