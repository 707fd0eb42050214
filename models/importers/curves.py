"""Shapes of neuron of other tools, made of what a network has: tables, limits, multiplexers and products.

Each takes the builder, the value, a name for its layers, and the options of its formula. Sources: the documents of
torch.nn and https://onnx.ai/onnx/operators, which agree.
"""

from collections.abc import Callable
from math import pi, sqrt

from greygate.errors import InputError
from greygate.models.importers.builder import Builder, Value, constant

SELU = 1.6732632423543772, 1.0507009873554805  # alpha and gamma of Klambauer 2017
CUBIC = 0.044715  # of gelu's tanh form
LINEAR = 20.0  # argument above which softplus is its argument, to 2e-9


def elu(builder: Builder, x: Value, hint: str, alpha: float = 1.0, scale: float = 1.0, inner: float = 1.0) -> Value:
    """scale x above 0, else scale alpha (exp(inner x) - 1)."""
    if inner <= 0:
        raise InputError(f"it grows without bound below 0 (exp of {-inner:g} times |x|); give it a positive one")
    above = builder.rectified(x, 0.0, hint)
    below = x.plus(above.times(-1.0))
    fallen = builder.activated(below.times(inner), "negexp", hint).plus(constant(-1.0))
    return above.plus(fallen.times(alpha)).times(scale)


def celu(builder: Builder, x: Value, hint: str, alpha: float = 1.0) -> Value:
    """x above 0, else alpha (exp(x / alpha) - 1)."""
    if not alpha:
        raise InputError("its alpha is 0; give it a positive one")
    return elu(builder, x, hint, alpha, inner=1 / alpha)


def selu(builder: Builder, x: Value, hint: str, alpha: float = SELU[0], gamma: float = SELU[1]) -> Value:
    return elu(builder, x, hint, alpha, gamma)


def softplus(builder: Builder, x: Value, hint: str, beta: float = 1.0, threshold: float = LINEAR) -> Value:
    """ln(1 + exp(beta x)) / beta; x where beta x exceeds the threshold."""
    if beta <= 0:
        raise InputError(f"its beta is {beta:g}; give it a positive one")
    n = x.times(beta)
    soft = builder.rectified(n, 0.0, hint).plus(builder.activated(n, "softfall", hint)).times(1 / beta)
    if threshold >= LINEAR:
        return soft
    return builder.chosen(n.times(-1.0).plus(constant(threshold)), soft, x, hint)


def silu(builder: Builder, x: Value, hint: str, alpha: float = 1.0) -> Value:
    """x times the sigmoid of alpha x."""
    return builder.product(x, builder.activated(x.times(alpha), "logsig", hint), hint)


def gelu(builder: Builder, x: Value, hint: str, approximate: str = "none") -> Value:
    """x times the normal distribution at x, or its form by tanh."""
    if approximate == "none":
        return builder.product(x, builder.activated(x, "normal", hint), hint)
    bent = x.plus(builder.power(x, 3, hint).times(CUBIC)).times(2 * sqrt(2 / pi))
    return builder.product(x, builder.activated(bent, "logsig", hint), hint)


def erf(builder: Builder, x: Value, hint: str) -> Value:
    return builder.activated(x.times(sqrt(2)), "normal", hint).times(2.0).plus(constant(-1.0))


def mish(builder: Builder, x: Value, hint: str) -> Value:
    """x tanh(softplus(x))."""
    return builder.product(x, builder.activated(softplus(builder, x, hint), "tansig", hint), hint)


def hardswish(builder: Builder, x: Value, hint: str) -> Value:
    """x times x / 6 + 1 / 2 between 0 and 1."""
    return builder.product(x, builder.clipped(x.times(1 / 6).plus(constant(0.5)), 0.0, 1.0, hint), hint)


def shrunk(builder: Builder, x: Value, hint: str, lambd: float = 0.5, bias: float = 0.0) -> Value:
    """x - bias above lambd, x + bias below -lambd, else 0."""
    low = builder.chosen(x.plus(constant(lambd)), constant(0.0), x.plus(constant(bias)), hint)
    return builder.chosen(x.times(-1.0).plus(constant(lambd)), low, x.plus(constant(-bias)), hint)


def thresholded(builder: Builder, x: Value, hint: str, alpha: float = 1.0) -> Value:
    """x above alpha, else 0."""
    return builder.chosen(x.times(-1.0).plus(constant(alpha)), constant(0.0), x, hint)


def sign(builder: Builder, x: Value, hint: str) -> Value:
    below = builder.chosen(x.times(-1.0), constant(0.0), constant(1.0), hint)
    return builder.chosen(x, below, constant(-1.0), hint)


CURVES: dict[str, Callable[..., Value]] = {
    "Elu": elu, "Celu": celu, "Selu": selu, "Softplus": softplus, "Swish": silu, "Gelu": gelu, "Erf": erf,
    "Mish": mish, "HardSwish": hardswish, "Shrink": shrunk, "ThresholdedRelu": thresholded, "Sign": sign,
}  # fmt: skip
"""By their names in ONNX."""

INSTEAD = {  # operation -> what to write, or to give, in its place
    ("asin", "acos", "sinh", "cosh", "tan", "cumprod", "erfinv", "lgamma"):
        "a layer of tanh that learns it over the range of the recording, or give its result as an input",
    ("round", "floor", "ceil"): "what it rounds, or where with a limit for each step",
    ("sort", "topk"): "maximum and minimum of pairs",
    ("qlinearmatmul", "qgemm", "qlinearconv", "qlinearadd", "qlinearmul", "qlinearsigmoid"):
        "the model in QDQ format (quantize_static(..., quant_format=QuantFormat.QDQ))",
    ("dynamicquantizelinear", "matmulinteger", "convinteger", "dynamicquantizematmul"):
        "a static quantization (quantize_static), whose scales do not depend on the data",
    ("multiheadattention", "attention"): "softmax(q k^T) v out, with MatMul and Softmax",
    ("randomnormallike", "randomuniformlike", "randomnormal", "randomuniform", "bernoulli", "multinomial"):
        "the mean in its place: it draws at random",
    ("resize", "upsample"): "a Linear with the weights of that interpolation",
    ("onehotencoder", "labelencoder"): "each class as a port of 0 or 1, or the number itself in place of its bin",
    ("treeensembleregressor", "svmregressor"): "an MLPRegressor that is trained on its answers",
}  # fmt: skip


def instead(operation: str) -> str:
    """What to write in place of an operation that is not carried, as the end of a sentence."""
    plain = operation.lower().replace("_", "")
    told = next((text for names, text in INSTEAD.items() if plain in names), "")
    return f"write {told}" if told else "replace it, or approximate it by such a part"
