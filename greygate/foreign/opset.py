"""An ONNX model of an old opset as one of a newer, in the other process: its converter is no Python, and may crash."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from greygate.errors import one_line
from greygate.foreign.child import Read, Room, served

MODEL = "model"


def newer(opset: int) -> Read:
    """What gives the bytes of the same model in that opset."""
    from onnx import load_model_from_string, version_converter

    def read(path: Path, room: Room) -> Iterator[tuple[str, Any]]:
        model = load_model_from_string(path.read_bytes())
        try:
            made = version_converter.convert_version(model, opset).SerializeToString()
        except Exception as error:  # of an operator that has no counterpart, or of what is no model
            raise ValueError(one_line(" ".join(str(error).split()))[:200]) from None
        room.take(len(made), MODEL)
        yield MODEL, np.frombuffer(made, np.uint8)

    return read


if __name__ == "__main__":
    sys.exit(served({sys.argv[1]: lambda: newer(int(sys.argv[1]))}, *sys.argv[1:]))
