"""The functions of an expression: for NumPy arrays, and as text for the compiled simulation."""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np


def smooth_step(x, width):
    return 0.5 + 0.5 * np.tanh(x / width)


def when(condition, x):
    return np.where(condition != 0.0, x, 0.0)


def orifice(u, p_1, p_2):
    return np.maximum(u, 0.0) * np.sign(p_1 - p_2) * np.sqrt(np.abs(p_1 - p_2))


NUMPY = {  # function -> what it is called there
    "sqrt": "sqrt", "exp": "exp", "log": "log", "sin": "sin", "cos": "cos", "tan": "tan", "atan": "arctan",
    "atan2": "arctan2", "tanh": "tanh", "sign": "sign", "abs": "abs", "min": "minimum", "max": "maximum",
}  # fmt: skip
FUNCTIONS: dict[str, Callable[..., Any]] = {name: getattr(np, own) for name, own in NUMPY.items()}
FUNCTIONS |= {"smooth_step": smooth_step, "when": when, "orifice": orifice}


def arguments(name: str) -> int:
    """The number of arguments that the function takes."""
    return getattr(np, NUMPY[name]).nin if name in NUMPY else FUNCTIONS[name].__code__.co_argcount


def text(name: str) -> str:
    """Its definition in Python, if it needs one."""
    if name not in NUMPY:
        return inspect.getsource(FUNCTIONS[name])
    return f"{name} = np.{NUMPY[name]}" if name != "abs" else ""  # Python's own is quicker outside of numba
