"""The functions of an expression: one line each, for NumPy arrays, and as text for the compiled simulation."""

import inspect

import numpy as np


def sqrt(x):
    return np.sqrt(x)


def exp(x):
    return np.exp(x)


def log(x):
    return np.log(x)


def sin(x):
    return np.sin(x)


def cos(x):
    return np.cos(x)


def tan(x):
    return np.tan(x)


def atan(x):
    return np.arctan(x)


def atan2(y, x):
    return np.arctan2(y, x)


def tanh(x):
    return np.tanh(x)


def sign(x):
    return np.sign(x)


def abs(x):
    return np.abs(x)


def min(x, y):
    return np.minimum(x, y)


def max(x, y):
    return np.maximum(x, y)


def smooth_step(x, width):
    return 0.5 + 0.5 * np.tanh(x / width)


def when(condition, x):
    return np.where(condition != 0.0, x, 0.0)


def orifice(u, p_1, p_2):
    return np.maximum(u, 0.0) * np.sign(p_1 - p_2) * np.sqrt(np.abs(p_1 - p_2))


FUNCTIONS = {
    f.__name__: f
    for f in (sqrt, exp, log, sin, cos, tan, atan, atan2, tanh, sign, abs, min, max, smooth_step, when, orifice)
}


def arguments(name: str) -> int:
    """The number of arguments that the function takes."""
    return FUNCTIONS[name].__code__.co_argcount


def text(name: str) -> str:
    """Its definition in Python."""
    return inspect.getsource(FUNCTIONS[name])
