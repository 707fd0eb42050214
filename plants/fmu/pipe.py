"""What two processes say to each other: a line of JSON, then the numbers of the arrays that it lists."""

import json
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

KINDS = ("float64", "int64", "bool")
LONGEST = 1 << 26  # bytes of a line


def send(stream: BinaryIO, said: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None) -> None:
    arrays = {name: np.ascontiguousarray(a) for name, a in (arrays or {}).items()}
    listed = [[name, str(a.dtype), a.shape] for name, a in arrays.items()]
    stream.write(json.dumps({**said, "arrays": listed}).encode() + b"\n")
    for a in arrays.values():
        stream.write(a.tobytes())
    stream.flush()


def receive(stream: BinaryIO) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Raises EOFError where the other has ended, ValueError where it says something else."""
    line = stream.readline(LONGEST)
    if not line.endswith(b"\n"):
        raise EOFError
    said = json.loads(line)
    found = {}
    for name, kind, shape in said.pop("arrays"):
        if kind not in KINDS:
            raise ValueError(kind)
        count = int(np.prod(shape)) * np.dtype(kind).itemsize
        data = stream.read(count)
        if len(data) < count:
            raise EOFError
        found[name] = np.frombuffer(data, kind).reshape(shape).copy()
    return said, found
