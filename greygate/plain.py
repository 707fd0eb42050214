"""Results as the JSON that greygate writes: without numpy, finite, one indented text."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """What `json.dumps(..., allow_nan=False)` takes: numpy's numbers and arrays become Python's, NaN and inf None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Sequence):
        return [plain(v) for v in value]
    if isinstance(value, int | np.integer):
        return int(value)
    return float(value) if math.isfinite(value) else None


def json_text(value: object) -> str:
    """The text of a JSON file."""
    return json.dumps(value, indent=1) + "\n"
