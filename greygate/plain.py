"""Results as the JSON that greygate writes: without numpy, finite, one indented text; and types that declare them."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Annotated, Any

import numpy as np


class Json(dict):
    """Keywords of JSON Schema, in `Annotated`; a type among them stands for its schema (greygate/schemas.py)."""

    __hash__ = object.__hash__  # type: ignore[assignment]  # one is no other


Figure = Annotated[float, Json(type=["number", "null"])]  # null where it is not finite
Count = Annotated[int, Json(minimum=0)]
Hash = Annotated[str, Json(pattern="^[0-9a-f]{64}$")]  # SHA-256
SOME = Json(minItems=1)
OTHERS = Json(additionalProperties=True)


def span(low: int, high: int) -> Json:
    """Keywords for a number from low to high."""
    return Json(minimum=low, maximum=high)


def plain(value: Any) -> Any:
    """What `json.dumps(..., allow_nan=False)` takes: numpy's numbers and arrays become Python's, NaN and inf None."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
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
