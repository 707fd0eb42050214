"""Modules of PyTorch with all their options, and functions element by element: each a module that takes one step.

A case's module is asked by PyTorch itself, in float64 and eval mode, and is then imported.
"""

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace

import numpy as np
import torch
from imported_models import free_run, signal
from torch import nn
from torch.nn import functional as F

from greygate.errors import InputError
from greygate.models.importers.pytorch import from_torch

STEPS = 20
AGREED = 1e-6  # of the largest that an output is
DOUBLE = torch.float64


class On(nn.Module):
    """A function of x and of the parts that it is given, and of states if it has any."""

    def __init__(self, how: Callable, **parts: object):
        super().__init__()
        self.how = how
        for name, part in parts.items():
            setattr(self, name, part)

    def forward(self, x, *states):
        return self.how(self, x, *states)


@dataclass(frozen=True)
class Case:
    group: str
    name: str
    build: Callable[[], nn.Module]
    inputs: int = 6
    starts: tuple = ()
    sequence: bool = False


@dataclass(frozen=True)
class Found:
    """verdict: right, refused, wrong or traceback. largest: of the difference, by the largest of the output."""

    verdict: str
    said: str = ""
    largest: float = 0.0


def tried(case: Case) -> Found:
    """What becomes of a case; a module that PyTorch itself does not run is refused, too."""
    torch.manual_seed(1)
    module = case.build().double().eval()
    x = 1.5 * signal(STEPS, case.inputs)
    try:
        wanted = answered(copy.deepcopy(module), x, case)
    except Exception as error:
        wanted, why = np.zeros((STEPS, 1)), error
    try:
        names = [f"u{k}" for k in range(case.inputs)], [f"y{k}" for k in range(wanted.shape[1])]
        network = from_torch(module, *names, state=[np.array(s) for s in case.starts])
    except InputError as error:
        return Found("refused" if "\n" not in str(error) else "traceback", str(error))
    except Exception as error:
        return Found("traceback", f"{type(error).__name__}: {error}")
    if not wanted.any():
        return Found("wrong", f"PyTorch itself does not run it: {why}")
    scale = np.maximum(np.abs(wanted).max(0), 1e-9)
    largest = float((np.abs(free_run(network, x) - wanted) / scale).max())
    return Found("right" if largest <= AGREED else "wrong", "", largest)


def answered(module: nn.Module, x: np.ndarray, case: Case) -> np.ndarray:
    """(steps, outputs), with the states fed on."""
    with torch.no_grad():
        if case.sequence:
            return module(torch.tensor(x)).numpy().reshape(len(x), -1)
        states, rows = [torch.tensor(np.array(s), dtype=DOUBLE) for s in case.starts], []
        for row in x:
            found = module(torch.tensor(row), *states)
            y, *states = found if isinstance(found, tuple) else (found,)
            rows.append(y.double().numpy().ravel())
        return np.array(rows)


def text(options: dict) -> str:
    return ", ".join(f"{k}={getattr(v, '__name__', v)}" for k, v in options.items())


def grid(**choices: list) -> Iterator[dict]:
    """Every combination."""
    for values in product(*choices.values()):
        yield dict(zip(choices, values, strict=True))


# -- activations -----------------------------------------------------------------------------------------------------

ACTIVATIONS: dict[type, list[dict]] = {
    nn.Tanh: [{}], nn.Sigmoid: [{}], nn.Identity: [{}], nn.Softsign: [{}], nn.Tanhshrink: [{}], nn.LogSigmoid: [{}],
    nn.ReLU: list(grid(inplace=[False, True])), nn.ReLU6: list(grid(inplace=[False, True])),
    nn.LeakyReLU: list(grid(negative_slope=[0.0, 0.01, 0.3, 1.0, 1.7, -0.2], inplace=[False, True])),
    nn.PReLU: list(grid(num_parameters=[1, 3], init=[0.25, -0.5])),
    nn.RReLU: list(grid(lower=[0.1, 0.2], upper=[0.3, 0.4], inplace=[False, True])),
    nn.Hardtanh: list(grid(min_val=[-1.0, -0.3, 0.1], max_val=[0.2, 1.0, 6.0], inplace=[False, True])),
    nn.Hardsigmoid: list(grid(inplace=[False, True])), nn.Hardswish: list(grid(inplace=[False, True])),
    nn.SiLU: list(grid(inplace=[False, True])), nn.Mish: list(grid(inplace=[False, True])),
    nn.ELU: list(grid(alpha=[1.0, 0.4], inplace=[False, True])), nn.SELU: list(grid(inplace=[False, True])),
    nn.CELU: list(grid(alpha=[1.0, 0.4], inplace=[False, True])), nn.GELU: list(grid(approximate=["none", "tanh"])),
    nn.Softplus: list(grid(beta=[1.0, 2.0], threshold=[20.0, 1.0])),
    nn.Softshrink: list(grid(lambd=[0.0, 0.5, 0.2])), nn.Hardshrink: list(grid(lambd=[0.0, 0.5, 0.2])),
    nn.Threshold: list(grid(threshold=[0.1, -0.4], value=[0.7, 0.0], inplace=[False, True])),
    nn.GLU: list(grid(dim=[-1, 0, 1])), nn.Softmax: list(grid(dim=[-1, 0])), nn.Softmin: list(grid(dim=[-1])),
    nn.LogSoftmax: list(grid(dim=[-1])), nn.Softmax2d: [{}],
    nn.MultiheadAttention: [{"embed_dim": 6, "num_heads": 2}],
}  # fmt: skip


def activations() -> Iterator[Case]:
    shapes = {"(6)": (6,), "(1, 6)": (1, 6), "(1, 3, 2)": (1, 3, 2)}
    for kind, options in ACTIVATIONS.items():
        for (shape, dims), chosen in product(shapes.items(), options):
            attention = kind is nn.MultiheadAttention

            def build(kind=kind, dims=dims, chosen=chosen, attention=attention):
                return On(
                    lambda s, x: (
                        s.a(*[s.first(x).reshape(dims)] * 3)[0] if attention else s.a(s.first(x).reshape(dims))
                    ),
                    first=nn.Linear(6, 6),
                    a=kind(**chosen),
                )

            yield Case("activations", f"{kind.__name__}({text(chosen)}) of {shape}", build)


# -- norms -----------------------------------------------------------------------------------------------------------


def normed(kind: type, dims: tuple, *given: object, **options: object) -> Case:
    def build():
        norm = kind(*given, **options)
        for name, held in norm.state_dict().items():  # as after training
            if held.is_floating_point():
                held.copy_(torch.rand(held.shape) + 0.5 if "var" in name else torch.randn(held.shape))
        return On(lambda s, x: s.n(s.first(x).reshape(dims)), first=nn.Linear(6, 6), n=norm)

    return Case("norms", f"{kind.__name__}({', '.join(map(str, given))}, {text(options)}) of {dims}", build)


def norms() -> Iterator[Case]:
    flags = {"affine": [True, False], "track_running_stats": [True, False], "eps": [1e-5, 0.1]}
    for options in grid(**flags, momentum=[0.1, None]):
        for dims in [(1, 6), (1, 3, 2), (1, 2, 3), (1, 6, 1), (2, 3), (3, 2, 1)]:
            yield normed(nn.BatchNorm1d, dims, dims[1], **options)
        yield normed(nn.BatchNorm2d, (1, 2, 1, 3), 2, **options)
        yield normed(nn.BatchNorm3d, (1, 2, 1, 3, 1), 2, **options)
    for options in grid(**flags):
        yield normed(nn.InstanceNorm1d, (1, 2, 3), 2, **options)
        yield normed(nn.InstanceNorm1d, (2, 3), 2, **options)
        yield normed(nn.InstanceNorm2d, (1, 2, 3, 1), 2, **options)
    for options in grid(elementwise_affine=[True, False], bias=[True, False]):
        yield normed(nn.LayerNorm, (6,), 6, **options)
        yield normed(nn.LayerNorm, (2, 3), (2, 3), **options)
    for options in grid(elementwise_affine=[True, False], eps=[None, 0.1]):
        yield normed(nn.RMSNorm, (1, 6), 6, **options)
    for options in grid(num_groups=[1, 3], affine=[True, False]):
        yield normed(nn.GroupNorm, (1, 6, 1), **options, num_channels=6)
    for options in grid(size=[2], alpha=[1e-4, 0.5], beta=[0.75], k=[1.0, 2.0]):
        yield normed(nn.LocalResponseNorm, (1, 6, 1), **options)
    yield normed(nn.CrossMapLRN2d, (1, 6, 1, 1), 2)


# -- recurrent -------------------------------------------------------------------------------------------------------

RECURRENT = {
    nn.RNN: [{"nonlinearity": "tanh"}, {"nonlinearity": "relu"}],
    nn.GRU: [{}],
    nn.LSTM: [{}, {"proj_size": 2}],
}


def recurrent() -> Iterator[Case]:
    flags = {"num_layers": [1, 2, 3], "bias": [True, False], "batch_first": [False, True], "dropout": [0.0, 0.3]}
    for kind, own in RECURRENT.items():
        for more, options in product(own, grid(**flags, bidirectional=[False, True])):
            chosen = {**more, **options}
            if chosen["num_layers"] == 1 and chosen["dropout"]:
                continue
            name = f"{kind.__name__}({text(chosen)})"

            def made(kind=kind, chosen=chosen):
                return kind(2, 3, **chosen)

            def sequence(made=made):
                return On(lambda s, x: s.r(x)[0], r=made())

            def batch(made=made, first=chosen["batch_first"]):
                axis = 0 if first else 1
                return On(lambda s, x: s.r(x.unsqueeze(axis))[0].squeeze(axis), r=made())

            def window(made=made):  # six inputs are three steps, each time from zero
                return On(lambda s, x, h: (s.r(x.reshape(3, 2))[0].sum() + h, h), r=made())

            yield Case("sequences", f"{name} along the sequence", sequence, 2, (), True)
            yield Case("sequences", f"{name} along a batch of one", batch, 2, (), True)
            yield Case("sequences", f"{name} along a window within a step", window, 6, (np.zeros(1),))
            yield from given_states(kind, chosen, name, made)
    yield from oddities()


def given_states(kind: type, chosen: dict, name: str, made: Callable) -> Iterator[Case]:
    rows = chosen["num_layers"] * (2 if chosen["bidirectional"] else 1)
    rng = np.random.default_rng(3)
    wide = rng.normal(size=(rows, 3))
    h = rng.normal(size=(rows, chosen.get("proj_size", 3)))
    if kind is nn.LSTM:

        def long(made=made):
            def step(s, x, h, c):
                y, (h, c) = s.r(x[None], (h, c))
                return y, h, c

            return On(step, r=made())

        yield Case("sequences", f"{name} with given states", long, 2, (h, wide))
        return

    def short(made=made):
        return On(lambda s, x, h: s.r(x[None], h), r=made())

    def fixed(made=made):
        return On(lambda s, x: s.r(x, s.h)[0], r=made(), h=torch.tensor(h))

    def held(made=made):
        def step(s, x):
            y, s.n.h = s.r(x, s.n.h)
            return y

        module = On(step, r=made(), n=nn.Module())
        module.n.register_buffer("h", torch.tensor(h))
        return module

    yield Case("sequences", f"{name} with given states", short, 2, (h,))
    yield Case("sequences", f"{name} from a constant state", fixed, 2, (), True)
    yield Case("sequences", f"{name} with its state in a buffer", held, 2, (), True)


def oddities() -> Iterator[Case]:
    """Sequences whose steps are no steps of the network."""

    def over(how):
        return lambda: On(how, r=nn.GRU(2, 3))

    yield Case("sequences", "GRU, its last step", over(lambda s, x: s.r(x)[0][-1:].expand(len(x), 3)), 2, (), True)
    yield Case("sequences", "GRU, the mean of its steps", over(lambda s, x: s.r(x)[0] - s.r(x)[0].mean(0)), 2, (), True)
    yield Case("sequences", "GRU, backwards", over(lambda s, x: s.r(x.flip(0))[0]), 2, (), True)
    yield Case("sequences", "GRU along the batch", over(lambda s, x: s.r(x[None])[0][0]), 2, (), True)
    yield Case("sequences", "GRU behind cumsum", over(lambda s, x: s.r(x.cumsum(0))[0]), 2, (), True)
    yield Case("sequences", "GRU from its own end", over(lambda s, x: s.r(x, s.r(x)[1])[0]), 2, (), True)
    yield Case("sequences", "GRU behind a convolution in time", lambda: On(
        lambda s, x: s.r(s.c(F.pad(x.T[None], (1, 0)))[0].T)[0], r=nn.GRU(2, 3), c=nn.Conv1d(2, 2, 2)
    ), 2, (), True)  # fmt: skip
    yield Case("sequences", "GRU and LSTM in turn", lambda: On(
        lambda s, x: s.l(s.r(x)[0])[0] + x[:, :1], r=nn.GRU(2, 3), l=nn.LSTM(3, 2)
    ), 2, (), True)  # fmt: skip
    yield Case("sequences", "packed", over(lambda s, x: s.r(nn.utils.rnn.pack_sequence([x]))[0].data), 2, (), True)


CELLS = {
    nn.RNNCell: list(grid(bias=[True, False], nonlinearity=["tanh", "relu"])),
    nn.GRUCell: list(grid(bias=[True, False])),
    nn.LSTMCell: list(grid(bias=[True, False])),
}


def cells() -> Iterator[Case]:
    rng = np.random.default_rng(4)
    for kind, choices in CELLS.items():
        for chosen, batch in product(choices, [(), (1,), (3,)]):
            inputs = 2 * int(np.prod(batch))
            starts = tuple(rng.normal(size=(*batch, 3)) for _ in range(2 if kind is nn.LSTMCell else 1))

            def step(s, x, *states, batch=batch, two=kind is nn.LSTMCell):
                after = s.c(x.reshape(*batch, 2), states if two else states[0])
                return (after[0], *after) if two else (after, after)

            def alone(s, x, batch=batch, two=kind is nn.LSTMCell):
                after = s.c(x.reshape(*batch, 2))
                return after[0] if two else after

            def build(how=step, kind=kind, chosen=chosen):
                return On(how, c=kind(2, 3, **chosen))

            name = f"{kind.__name__}({text(chosen)}), batch {batch}"
            yield Case("cells", f"{name}, given states", build, inputs, starts)
            yield Case("cells", f"{name}, default states", lambda build=build, alone=alone: build(alone), inputs)


# -- layers ----------------------------------------------------------------------------------------------------------

LAYERS: list[tuple[str, Callable, tuple]] = [
    *((f"Linear(bias={b}) of {d}", lambda b=b, d=d: nn.Linear(d[-1], 4, bias=b), d)
      for b in (True, False) for d in ((6,), (1, 6), (2, 3), (1, 2, 3))),
    *((f"Dropout{k}(p={p}, inplace={i})", lambda k=k, p=p, i=i: getattr(nn, f"Dropout{k}")(p, i), d)
      for k, d in (("", (6,)), ("1d", (1, 3, 2)), ("2d", (1, 3, 2, 1)), ("3d", (1, 3, 2, 1, 1)))
      for p in (0.0, 0.5, 1.0) for i in (False, True)),
    *((f"{k}(p={p})", lambda k=k, p=p: getattr(nn, k)(p), (1, 6)) for k in ("AlphaDropout", "FeatureAlphaDropout")
      for p in (0.2,)),
    *((f"Flatten({a}, {b})", lambda a=a, b=b: nn.Flatten(a, b), (1, 2, 3)) for a in (0, 1) for b in (-1, 1, 2)),
    *((f"Unflatten(1, {s})", lambda s=s: nn.Unflatten(1, s), (1, 6)) for s in ((2, 3), (3, -1), (1, 6, 1))),
    *((f"Conv1d({text(o)})", lambda o=o: nn.Conv1d(2, 4, **o), (1, 2, 3)) for o in [
        *grid(kernel_size=[1, 2, 3], stride=[1, 2], bias=[True, False]),
        *grid(kernel_size=[2, 3], padding=[1, "same"], padding_mode=["zeros", "circular", "reflect", "replicate"]),
        *grid(kernel_size=[2], dilation=[1, 2], groups=[1, 2])]),
    *((f"ConvTranspose1d({text(o)})", lambda o=o: nn.ConvTranspose1d(2, 4, **o), (1, 2, 3)) for o in [
        *grid(kernel_size=[2, 3], stride=[1, 2], padding=[0, 1], output_padding=[0], bias=[True, False]),
        *grid(kernel_size=[2], stride=[2], output_padding=[1], groups=[1, 2], dilation=[1, 2])]),
    *((f"Conv2d({text(o)})", lambda o=o: nn.Conv2d(1, 2, 2, **o), (1, 1, 2, 3)) for o in grid(bias=[True, False])),
    *((f"AvgPool1d({text(o)})", lambda o=o: nn.AvgPool1d(**o), (1, 2, 3)) for o in grid(
        kernel_size=[2, 3], stride=[None, 1], padding=[0, 1], ceil_mode=[False, True],
        count_include_pad=[True, False])),
    *((f"AdaptiveAvgPool1d({n})", lambda n=n: nn.AdaptiveAvgPool1d(n), (1, 2, 3)) for n in (1, 2, 3)),
    *((f"MaxPool1d({n})", lambda n=n: nn.MaxPool1d(n), (1, 2, 3)) for n in (1, 2, 3)),
    ("AdaptiveMaxPool1d(2)", lambda: nn.AdaptiveMaxPool1d(2), (1, 2, 3)),
    *((f"LPPool1d({n}, 2)", lambda n=n: nn.LPPool1d(n, 2), (1, 2, 3)) for n in (1.0, 2.0)),
    *((f"{k}({p})", lambda k=k, p=p: getattr(nn, k)(p), (1, 2, 3))
      for k in ("ReflectionPad1d", "ReplicationPad1d", "ZeroPad1d", "CircularPad1d") for p in (1, (0, 2))),
    ("ConstantPad1d(1, 0.7)", lambda: nn.ConstantPad1d(1, 0.7), (1, 2, 3)),
    *((f"Upsample({text(o)})", lambda o=o: nn.Upsample(**o), (1, 2, 3)) for o in [
        *grid(scale_factor=[2], mode=["nearest"]), *grid(size=[5], mode=["linear"], align_corners=[True, False])]),
    ("PixelShuffle(1)", lambda: nn.PixelShuffle(1), (1, 2, 3, 1)),
    ("ChannelShuffle(2)", lambda: nn.ChannelShuffle(2), (1, 6, 1)),
    ("Fold", lambda: nn.Fold((2, 3), 1), (1, 1, 6)), ("Unfold", lambda: nn.Unfold(2), (1, 1, 2, 3)),
    ("CosineSimilarity", lambda: On(lambda s, x: F.cosine_similarity(x[:3], x[3:], 0)), (6,)),
    ("PairwiseDistance", lambda: On(lambda s, x: F.pairwise_distance(x[:3], x[3:])), (6,)),
    ("Bilinear of x and x", lambda: On(lambda s, x: s.b(x[:3], x[3:]), b=nn.Bilinear(3, 3, 2)), (6,)),
    *((f"Bilinear(bias={b}) of x and a constant",
       lambda b=b: On(lambda s, x: s.b(x[:3], s.k), b=nn.Bilinear(3, 3, 2, bias=b), k=nn.Parameter(torch.randn(3))),
       (6,)) for b in (True, False)),
    ("Embedding of a constant", lambda: On(lambda s, x: x[:3] * s.e(torch.tensor(1)), e=nn.Embedding(4, 3)), (6,)),
    ("Embedding of x", lambda: On(lambda s, x: s.e((x > 0).long()), e=nn.Embedding(2, 3)), (6,)),
    ("EmbeddingBag of a constant",
     lambda: On(lambda s, x: x[:3] * s.e(torch.tensor([[1, 2]]))[0], e=nn.EmbeddingBag(4, 3)), (6,)),
    ("weight_norm", lambda: nn.utils.parametrizations.weight_norm(nn.Linear(6, 4)), (6,)),
    ("spectral_norm", lambda: nn.utils.parametrizations.spectral_norm(nn.Linear(6, 4)), (6,)),
    ("orthogonal", lambda: nn.utils.parametrizations.orthogonal(nn.Linear(6, 6)), (6,)),
    ("TransformerEncoderLayer", lambda: nn.TransformerEncoderLayer(6, 2, 8), (1, 6)),
    ("Sequential in training mode",
     lambda: nn.Sequential(nn.Linear(6, 6), nn.BatchNorm1d(6), nn.Dropout(0.5)).train(), (1, 6)),
    ("ModuleList", lambda: On(lambda s, x: sum(m(x) for m in s.m), m=nn.ModuleList([nn.Linear(6, 2)] * 3)), (6,)),
]  # fmt: skip


def layers() -> Iterator[Case]:
    for name, build, dims in LAYERS:
        yield Case(
            "layers",
            name,
            lambda b=build, d=dims: On(lambda s, x: s.l(s.first(x).reshape(d)), first=nn.Linear(6, 6), l=b()),
        )


# -- functions -------------------------------------------------------------------------------------------------------

a, b, m = (slice(0, 3), slice(3, 6), (2, 3))
C3 = torch.tensor([0.5, -1.5, 2.0], dtype=DOUBLE)
W = torch.arange(18.0, dtype=DOUBLE).reshape(2, 3, 3) / 10 - 0.7


def reduced(name: str, dims: object, keep: bool) -> Callable:
    return lambda x: getattr(torch, name)(x.reshape(m), dim=dims, keepdim=keep)


FUNCTIONS: dict[str, Callable] = {
    **{f"add alpha={k}": lambda x, k=k: torch.add(x[a], x[b], alpha=k) for k in (1, 2, -0.5)},
    **{f"sub alpha={k}": lambda x, k=k: torch.sub(x[a], x[b], alpha=k) for k in (1, 2, -0.5)},
    **{f"sub of a constant alpha={k}": lambda x, k=k: torch.sub(C3, x[b], alpha=k) for k in (1, 2)},
    **{f"rsub alpha={k}": lambda x, k=k: torch.rsub(x[a], x[b], alpha=k) for k in (1, 2, -0.5)},
    **{f"rsub {k} alpha=3": lambda x, k=k: torch.rsub(x, k, alpha=3) for k in (1, 0.5)},
    "1 - x": lambda x: 1 - x,
    "x - 1": lambda x: x - 1,
    "-x": lambda x: -x,
    "+x": lambda x: +x,
    "mul": lambda x: x[a] * x[b],
    "mul by 2": lambda x: 2 * x,
    "mul by a constant": lambda x: x[a] * C3,
    "mul of an outer grid": lambda x: x[a, None] * x[None, b],
    "mul of itself": lambda x: x * x * x,
    "addcmul": lambda x: torch.addcmul(x[a], x[b], x[a], value=0.5),
    "addcdiv": lambda x: torch.addcdiv(x[a], x[b], C3),
    "lerp": lambda x: torch.lerp(x[a], x[b], 0.3),
    "lerp by a signal": lambda x: torch.lerp(C3, x[a], x[b]),
    **{
        f"div by a constant, {k}": lambda x, k=k: torch.div(x[a], C3, rounding_mode=k) for k in (None, "floor", "trunc")
    },
    "div by a number": lambda x: x / 3,
    "div by a signal": lambda x: x[a] / (x[b] + 4),
    "div of 1": lambda x: 1 / (x + 4),
    "reciprocal": lambda x: torch.reciprocal(x + 4),
    "floor_divide": lambda x: x // 2,
    "fmod": lambda x: torch.fmod(x, 0.7),
    "remainder": lambda x: x % 0.7,
    "true_divide": lambda x: torch.true_divide(x, 7),
    **{f"pow {n}": lambda x, n=n: x**n for n in (0, 1, 2, 3, 4, -1, 0.5, 2.0, 3.0)},
    "pow of a constant": lambda x: 2**x,
    "pow of two signals": lambda x: (x[a] + 3) ** x[b],
    "pow of several": lambda x: x ** torch.tensor([0, 1, 2, 3, 2, 1]),
    "pow of several and 4": lambda x: x[a] ** torch.tensor([2.0, 3.0, 4.0]),
    "square": torch.square,
    "sqrt": lambda x: (x + 4).sqrt(),
    "rsqrt": lambda x: (x + 4).rsqrt(),
    "exp": torch.exp,
    "expm1": torch.expm1,
    "log": lambda x: torch.log(x + 4),
    "log1p": lambda x: torch.log1p(x + 3),
    "sin": torch.sin,
    "cos": torch.cos,
    "atan": torch.atan,
    "erf": torch.erf,
    "sinh": torch.sinh,
    "cosh": torch.cosh,
    "abs": torch.abs,
    "sign": torch.sign,
    "sgn": torch.sgn,
    "floor": torch.floor,
    "ceil": torch.ceil,
    "round": torch.round,
    "round to 1": lambda x: torch.round(x, decimals=1),
    "trunc": torch.trunc,
    "frac": torch.frac,
    "heaviside": lambda x: torch.heaviside(x, torch.tensor(0.5, dtype=DOUBLE)),
    "copysign": lambda x: torch.copysign(x[a], x[b]),
    "maximum": lambda x: torch.maximum(x[a], x[b]),
    "minimum": lambda x: torch.minimum(x[a], x[b]),
    "maximum of a constant": lambda x: torch.maximum(C3, x[b]),
    "fmax": lambda x: torch.fmax(x[a], x[b]),
    "max": torch.max,
    "amax": lambda x: x.amax(0),
    "argmax": lambda x: x.argmax(),
    "max of a dim": lambda x: x.max(0)[0],
    "median": torch.median,
    "sort": lambda x: x.sort()[0],
    "topk": lambda x: x.topk(2)[0],
    "clamp": lambda x: x.clamp(-0.3, 0.8),
    "clamp to min": lambda x: x.clamp(min=0.2),
    "clamp to max": lambda x: x.clamp(max=0.2),
    "clamp to arrays": lambda x: torch.clamp(x[a], C3 - 3, C3),
    "clamp to an array": lambda x: torch.clamp(x[a], max=C3),
    "clamp to signals": lambda x: torch.clamp(x[a], min=x[b]),
    "clamp to two signals": lambda x: torch.clamp(x[:2], x[2:4], x[4:]),
    "clamp turned round": lambda x: x.clamp(0.8, -0.3),
    "clamp to inf": lambda x: x.clamp(-0.3, float("inf")),
    "clamp to -inf, inf": lambda x: x.clamp(-float("inf"), float("inf")),
    "clamp to 1e6": lambda x: x.clamp(-1e6, 1e6),
    "clamp to 1e30": lambda x: x.clamp(-1e30, 1e30),
    "clamp_": lambda x: (2 * x).clamp_(-0.3, 0.8),
    "clamp_min": lambda x: x.clamp_min(0.1),
    "clamp_max": lambda x: x.clamp_max(0.1),
    "clip": lambda x: x.clip(-0.1, 0.1),
    "clamp to one number": lambda x: x.clamp(0.5, 0.5),
    "where >": lambda x: torch.where(x[a] > 0.2, x[a], x[b]),
    "where >=": lambda x: torch.where(x[a] >= x[b], 2.0, x[b]),
    "where <": lambda x: torch.where(x[a] < 0.2, x[a], 0.0),
    "where <=": lambda x: torch.where(x[b] >= C3, x[a], C3),
    "where not": lambda x: torch.where(~(x[a] > 0), x[a], x[b]),
    "where ==": lambda x: torch.where(x == 0.5, x, 2 * x),
    "where and": lambda x: torch.where((x[a] > 0) & (x[b] > 0), x[a], x[b]),
    "where of a constant": lambda x: torch.where(C3 > 0, x[a], x[b]),
    "where of numbers": lambda x: torch.where(x > 0, 1.0, -1.0),
    "where broadcast": lambda x: torch.where(x[:1] > 0, x[a], x[b, None]),
    "mask times x": lambda x: (x > 0) * x,
    "mask as numbers": lambda x: (x > 0).double() - (x < 0.5).double(),
    "mask or": lambda x: ((x[a] > 0) + (x[b] > 0)).double(),
    "mask counted": lambda x: (x > 0).sum().double(),
    "logical_not of numbers": lambda x: torch.logical_not(x).double(),
    "masked_fill": lambda x: x.masked_fill(x > 0.3, 0.3),
    "masked_fill of a constant": lambda x: x[a].masked_fill(C3 > 0, 0.3),
    "x[x > 0]": lambda x: x[x > 0],
    "long": lambda x: x.long() + x,
    "int": lambda x: x.int() * 1.0,
    "float": lambda x: x.float().double(),
    "half": lambda x: x.half().double(),
    "bool": lambda x: x.bool() * x,
    "double": lambda x: x.double(),
    "sum as int": lambda x: x.sum(dtype=torch.int64) * 1.0,
    "view as int": lambda x: x.view(torch.int64) * 1.0,
    "complex": lambda x: torch.complex(x[a], x[b]).abs(),
    "fft": lambda x: torch.fft.rfft(x).real,
    **{
        f"{f} dims={d} keepdim={k}": reduced(f, d, k)
        for f in ("sum", "mean", "var", "std", "amax", "logsumexp", "norm")
        for d in (0, -1, (0, 1))
        for k in (False, True)
    },
    **{f"prod dim={d}": lambda x, d=d: x.reshape(m).prod(d) for d in (0, 1)},
    "prod": torch.prod,
    "sum": torch.sum,
    "mean": torch.mean,
    "var": torch.var,
    "nansum": torch.nansum,
    "cumsum": lambda x: x.cumsum(0),
    "cumprod": lambda x: x.cumprod(0),
    "diff": torch.diff,
    "diff prepend": lambda x: torch.diff(x, prepend=x[:1]),
    "trace": lambda x: x[:4].reshape(2, 2).trace(),
    "cat": lambda x: torch.cat([x[b], x[a], C3]),
    "cat of whole numbers": lambda x: torch.cat([x[a], torch.tensor([1, 2])]),
    **{f"cat dim={d}": lambda x, d=d: torch.cat([x.reshape(m), 2 * x.reshape(m)], d) for d in (0, 1, -1, -2)},
    **{f"stack dim={d}": lambda x, d=d: torch.stack([x.reshape(m), W[0, :2]], d) for d in (0, 1, 2, -1)},
    **{
        f"roll {k} dims={d}": lambda x, k=k, d=d: x.reshape(m).roll(k, d)
        for k, d in ((1, 0), (-1, 1), ((1, 2), (0, 1)), (1, None))
    },
    "flip": lambda x: x.reshape(m).flip(0, 1),
    "rot90": lambda x: torch.rot90(x.reshape(m)),
    "tile": lambda x: x.tile(2),
    "repeat": lambda x: x.repeat(2, 1),
    "repeat_interleave": lambda x: x.repeat_interleave(2),
    "expand": lambda x: x.expand(2, -1),
    "index": lambda x: x[[5, 0, 2, 2]],
    "index of a mask": lambda x: x[a][C3 > 0],
    "index of two": lambda x: x.reshape(m)[[0, 1], [2, 0]],
    "index step": lambda x: x[1::2],
    "index_select": lambda x: x.index_select(0, torch.tensor([3, 1])),
    "x[..., None]": lambda x: x[..., None],
    "index of a signal": lambda x: x[(x[:1] > 0).long()],
    "gather": lambda x: x.gather(0, torch.tensor([3, 1])),
    "take": lambda x: x.take(torch.tensor([3, 1])),
    "narrow": lambda x: x.narrow(0, 1, 3),
    "diagonal": lambda x: x.reshape(m).diagonal(),
    "diag": lambda x: x[a].diag(),
    "tril": lambda x: x.reshape(m).tril(),
    "triu": lambda x: x.reshape(m).triu(1),
    "unfold": lambda x: x.unfold(0, 3, 2),
    "unbind": lambda x: x.reshape(m).unbind(1)[2],
    "split": lambda x: x.split([1, 3, 2])[1],
    "split unevenly": lambda x: x.split(4)[1],
    "chunk": lambda x: x.chunk(4)[1],
    "tensor_split": lambda x: x.tensor_split(4)[1],
    "transpose": lambda x: x.reshape(m).transpose(0, 1),
    "permute": lambda x: x.reshape(1, 2, 3).permute(2, 0, 1),
    "T": lambda x: x.reshape(m).T,
    "movedim": lambda x: x.reshape(1, 2, 3).movedim(0, 2),
    "squeeze": lambda x: x.reshape(1, 6, 1).squeeze(),
    "squeeze dim": lambda x: x.reshape(1, 6, 1).squeeze(-1),
    "view -1": lambda x: x.view(3, -1),
    "flatten": lambda x: x.reshape(1, 2, 3).flatten(1),
    "as_strided": lambda x: x.as_strided((2, 2), (1, 2)),
    "pad": lambda x: F.pad(x, (1, 2), value=0.3),
    **{f"pad {k}": lambda x, k=k: F.pad(x.reshape(1, 2, 3), (1, 2), k) for k in ("reflect", "replicate", "circular")},
    "scatter": lambda x: torch.zeros(6, dtype=DOUBLE).scatter(0, torch.tensor([3, 1]), x[:2]),
    "scatter_add": lambda x: x.scatter_add(0, torch.tensor([3, 3]), x[:2]),
    "index_add": lambda x: x.index_add(0, torch.tensor([3, 3]), x[:2]),
    "meshgrid": lambda x: torch.meshgrid(x[:2], x[2:], indexing="ij")[1],
    "block_diag": lambda x: torch.block_diag(x.reshape(m), W[0]),
    "view += 1": lambda x: in_place(x, lambda y: y[:2].add_(1.0)),
    "view *= x": lambda x: in_place(x, lambda y: y[a].mul_(y[b])),
    "row = 0": lambda x: in_place(x, lambda y: y.reshape(m)[0].zero_()),
    "y[2] = x[0]": lambda x: in_place(x, lambda y: y.__setitem__(2, x[0])),
    "y[[1, 3]] = x": lambda x: in_place(x, lambda y: y.__setitem__([1, 3], x[:2])),
    "copy_": lambda x: in_place(x, lambda y: y[b].copy_(x[a])),
    "y[mask] = 0": lambda x: in_place(x, lambda y: y.__setitem__(y > 0.2, 0.2)),
    "T.add_": lambda x: in_place(x, lambda y: y.view(m).T[0].add_(1)),
    "fill_": lambda x: in_place(x, lambda y: y[1:3].fill_(0.4)),
    "swap": lambda x: in_place(x, lambda y: y[a].copy_(y[b].clone())),
    "x.add_(1)": lambda x: x.add_(1),
    "x[0] = 1": lambda x: in_place(x, lambda y: x.__setitem__(0, 1.0)) + x,
    "addmm": lambda x: torch.addmm(x[:2], x.reshape(m), W[0][:, :2], beta=0.5, alpha=2),
    "mm": lambda x: torch.mm(W[0], x.reshape(3, 2)),
    "addmv": lambda x: torch.addmv(C3, W[0], x[a], beta=0.5),
    "mv": lambda x: torch.mv(x.reshape(m), C3),
    "dot": lambda x: torch.dot(C3, x[a]),
    "baddbmm": lambda x: torch.baddbmm(W, x.view(2, 3, 1).expand(2, 3, 3), W, beta=0.3, alpha=1.5),
    "bmm": lambda x: torch.bmm(W, x.view(2, 3, 1)),
    "addbmm": lambda x: torch.addbmm(W[0], W, x.view(2, 3, 1).expand(2, 3, 3)),
    "addr": lambda x: torch.addr(W[0], C3, x[a]),
    **{
        f"matmul {s} {tuple(t.shape)}": lambda x, s=s, t=t: torch.matmul(x.reshape(s), t)
        for s, t in (
            ((6,), torch.ones(6, 2, dtype=DOUBLE)),
            ((2, 3), W),
            ((2, 1, 3), W),
            ((2, 1, 1, 3), W),
            ((2, 3), C3),
        )
    },
    **{
        f"matmul from the left {s}": lambda x, s=s: torch.matmul(W, x.reshape(s))
        for s in ((3, 2), (2, 3, 1), (1, 3, 2), (2, 1, 3, 1))
    },
    "matmul from the left (3)": lambda x: torch.matmul(W, x[a]),
    "matmul of two signals": lambda x: x.reshape(2, 3) @ x.reshape(3, 2),
    "matmul of constants": lambda x: (W @ W)[0] @ x[a],
    "outer": lambda x: torch.outer(x[a], C3),
    "outer of signals": lambda x: torch.outer(x[a], x[b]),
    **{
        f"einsum {e}": lambda x, e=e: torch.einsum(e, x.reshape(m), W)
        for e in ("ij,ijk->ik", "ij,ijk->k", "bi,cij->bcj", "ij,kjl->ikl")
    },
    "einsum of two signals": lambda x: torch.einsum("i,i->", x[a], x[b]),
    "einsum of one": lambda x: torch.einsum("ij->ji", x.reshape(m)),
    "kron": lambda x: torch.kron(x[a], C3),
    "tensordot": lambda x: torch.tensordot(x.reshape(m), W, 1),
    "cross": lambda x: torch.cross(x[a], C3, dim=0),
    "inner": lambda x: torch.inner(W[0], x[a]),
    "chain": lambda x: torch.linalg.multi_dot([x.reshape(m), W[0], W[1]]),
    "inverse": lambda x: torch.inverse(W[0] + torch.eye(3, dtype=DOUBLE)) @ x[a],
    "softmax of constants": lambda x: torch.softmax(C3, 0) * x[a],
    "rand": lambda x: x + torch.rand(6),
    "randn_like": lambda x: x + torch.randn_like(x),
    "bernoulli": lambda x: torch.bernoulli(torch.sigmoid(x)),
    "randperm": lambda x: x[torch.randperm(6)],
    "normal": lambda x: torch.normal(x, 1.0),
    "multinomial": lambda x: torch.multinomial(torch.sigmoid(x), 2) * 1.0,
    "dropout in training": lambda x: F.dropout(x, 0.4, training=True),
    "alpha_dropout in training": lambda x: F.alpha_dropout(x, 0.4, training=True),
    "rrelu in training": lambda x: F.rrelu(x, training=True),
    "numpy's random": lambda x: x + np.random.rand(),  # noqa: NPY002
    "empty": lambda x: x + 0 * torch.empty(6),
    "batch_norm in training": lambda x: F.batch_norm(x.reshape(3, 2), None, None, training=True),
    "normalize": lambda x: F.normalize(x, dim=0),
    "if x > 0": lambda x: x if x.sum() > 0 else -x,
    "item": lambda x: x * x[0].item(),
    "tolist": lambda x: x + x.tolist()[0],
    "numpy": lambda x: torch.tensor(x.numpy()) + x,
    "int(x)": lambda x: x + int(x[0]),
    "nonzero": lambda x: x.nonzero() * 1.0,
    "cond": lambda x: torch.cond(x.sum() > 0, lambda x: 2 * x, lambda x: -x, (x,)),
    "zeros_like": lambda x: x + torch.zeros_like(x) + 1,
    "full_like": lambda x: x * torch.full_like(x, 0.3),
    "new_zeros": lambda x: torch.cat([x, x.new_zeros(2)]) + x.new_ones(8),
    "arange": lambda x: x * torch.arange(6),
    "linspace": lambda x: x * torch.linspace(0, 1, 6),
    "eye": lambda x: torch.eye(6) @ x,
    "one_hot": lambda x: x * F.one_hot(torch.tensor(2), 6),
    "a number": lambda x: 1.0,
    "a constant": lambda x: torch.ones(2),
    "gives a dict": lambda x: {"y": x},
    "gives a list": lambda x: [x],
    "None": lambda x: None,
    "two": lambda x: (x, x),
    "nested": lambda x: ((x, x),),
    "a string": lambda x: "y",
}


def in_place(x: torch.Tensor, how: Callable) -> torch.Tensor:
    y = 1.5 * x
    how(y)
    return y


def functions() -> Iterator[Case]:
    for name, how in FUNCTIONS.items():
        yield Case("functions", name, lambda how=how: On(lambda s, x: how(s.first(x)), first=nn.Linear(6, 6)))
        yield Case("functions", f"{name}, of x itself", lambda how=how: On(lambda s, x: how(x)))


# -- memory ----------------------------------------------------------------------------------------------------------


def memory() -> Iterator[Case]:
    """What a module keeps from step to step."""

    def kept(how: Callable, **held: object) -> Callable:
        def build():
            module = On(how, l=nn.Linear(6, 3), r=nn.Linear(3, 3))
            for name, value in held.items():
                if name.startswith("b_"):
                    module.register_buffer(name, torch.tensor(value, dtype=DOUBLE if isinstance(value, list) else None))
                else:
                    setattr(module, name, copy.deepcopy(value))
            return module

        return build

    def recurrence(s, x):
        s.b_h = torch.tanh(s.l(x) + s.r(s.b_h))
        return s.b_h

    def attribute(s, x):
        s.h = torch.tanh(s.l(x) + s.r(s.h))
        return s.h

    def counted(s, x):
        s.n += 1
        return s.l(x) * (2.0 if s.n > 3 else 1.0)

    def late(s, x):
        s.n += 1
        return s.l(x) * (2.0 if s.n > 1000 else 1.0)

    def listed(s, x):
        s.past.append(s.l(x))
        return s.past[-1] + s.past[max(0, len(s.past) - 3)]

    def mapped(s, x):
        s.held["h"] = s.l(x) + 0.5 * s.held.get("h", 0.0)
        return s.held["h"]

    def within(s, x):
        s.held.h = s.l(x) + 0.5 * s.held.h
        return s.held.h

    def once(s, x):
        s.first = s.l(x) if s.first is None else s.first
        return s.l(x) - s.first

    def cached(s, x):
        s.eye = torch.eye(3, dtype=DOUBLE) if s.eye is None else s.eye
        return s.l(x) @ s.eye

    def added(s, x):
        s.b_n.add_(1)
        return s.l(x) * s.b_n

    def shifted(s, x):
        s.b_h.copy_(s.b_h.roll(1))
        s.b_h[0] = s.l(x)[0]
        return s.b_h.clone()

    def whole(s, x):
        s.b_n += 1
        return s.l(x) + 0.1 * s.b_n

    def parity(s, x):
        s.b_n += 1
        return s.l(x) * (s.b_n % 2)

    def weight(s, x):
        s.l.bias.data.mul_(0.9)
        return s.l(x)

    def parameter(s, x):
        with torch.no_grad():
            s.l.bias.mul_(0.9)
        return s.l(x)

    def default(s, x, past=[]):  # noqa: B006, that is the case
        past.append(s.l(x))
        return past[-1] + past[len(past) // 2]

    zeros = [0.1, 0.2, -0.3]
    for name, how, held in (
        ("a buffer, bound anew", recurrence, {"b_h": zeros}), ("a buffer, add_", added, {"b_n": zeros}),
        ("a buffer as a delay line", shifted, {"b_h": zeros}), ("a buffer of whole numbers", whole, {"b_n": 0}),
        ("a buffer of whole numbers, its parity", parity, {"b_n": 0}),
        ("an attribute", attribute, {"h": torch.tensor(zeros, dtype=DOUBLE)}), ("a counter", counted, {"n": 0}),
        ("a counter that is read after 1000 steps", late, {"n": 0}), ("a list", listed, {"past": []}),
        ("a dict", mapped, {"held": {}}), ("an object", within, {"held": SimpleNamespace(h=0.0)}),
        ("the first step", once, {"first": None}), ("a cache of a constant", cached, {"eye": None}),
        ("a parameter's data", weight, {}), ("a parameter", parameter, {}), ("a default argument", default, {}),
    ):  # fmt: skip
        yield Case("memory", name, kept(how, **held))


GROUPS = (activations, norms, recurrent, cells, layers, functions, memory)


def cases() -> list[Case]:
    return [case for group in GROUPS for case in group()]
