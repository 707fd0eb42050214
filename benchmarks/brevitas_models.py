"""Quantized networks by Brevitas, in both its formats. quantized_exports.py runs this in an interpreter of theirs.

python brevitas_models.py FOLDER    writes NAME.onnx and NAME.npz: x (N, 3), y (N, 2)
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import brevitas.nn as qnn
import numpy as np
import torch
from brevitas.export import export_onnx_qcdq, export_qonnx
from brevitas.quant import binary, fixed_point, scaled_int, shifted_scaled_int, ternary
from torch import nn

INPUTS, HIDDEN, OUTPUTS, SAMPLES = 3, 16, 2, 500
FIXED = partial(qnn.QuantLinear, bias=True, weight_quant=fixed_point.Int8WeightPerTensorFixedPoint)
ACT, UNSIGNED = fixed_point.Int8ActPerTensorFixedPoint, fixed_point.Uint8ActPerTensorFixedPoint
ONE = binary.SignedBinaryActPerTensorConst
SHIFTED = shifted_scaled_int.ShiftedUint8ActPerTensorFloat
EACH = scaled_int.Int8WeightPerChannelFloat


def linear(bits: int = 8, **options: object) -> Callable[..., nn.Module]:
    return partial(qnn.QuantLinear, bias=True, weight_bit_width=bits, **options)


def two(
    layer: Callable[..., nn.Module], between: nn.Module, first: nn.Module | None = None, *last: nn.Module
) -> nn.Module:
    """A hidden layer and an output."""
    enter = qnn.QuantIdentity(bit_width=8) if first is None else first
    return nn.Sequential(enter, layer(INPUTS, HIDDEN), between, layer(HIDDEN, OUTPUTS), *last)


class Meeting(nn.Module):
    """Two roads whose codes share a scale; residual: one of them is the input."""

    def __init__(self, residual: bool):
        super().__init__()
        self.enter, self.last = qnn.QuantIdentity(bit_width=8), linear()(INPUTS, OUTPUTS)
        self.ways = nn.ModuleList(linear(6)(INPUTS, INPUTS) for _ in range(2))
        self.shared = qnn.QuantIdentity(bit_width=8, return_quant_tensor=True)
        self.relu, self.residual = qnn.QuantReLU(bit_width=8), residual

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = self.enter(x)
        if self.residual:
            return self.last(self.shared(self.relu(self.ways[0](x)) + x))
        one, other = (self.shared(way(x)) for way in self.ways)
        return self.last(one + other)


def told(bits: int) -> dict[str, object]:
    """Options of an activation that hands on its scale, which a quantized bias needs."""
    return {"bit_width": bits, "return_quant_tensor": True}


MODELS: dict[str, Callable[[], nn.Module]] = {
    "relu": lambda: two(linear(6), qnn.QuantReLU(bit_width=6)),
    "norm": lambda: two(linear(4), nn.Sequential(nn.BatchNorm1d(HIDDEN), qnn.QuantReLU(bit_width=4))),
    "plain input": lambda: two(linear(6), qnn.QuantReLU(bit_width=6), nn.Identity()),
    "quantized output": lambda: two(linear(6), qnn.QuantReLU(bit_width=6), None, qnn.QuantIdentity(bit_width=8)),
    "tanh": lambda: two(linear(6), qnn.QuantTanh(bit_width=6)),
    "sigmoid": lambda: two(linear(6), qnn.QuantSigmoid(bit_width=6)),
    "hardtanh": lambda: two(linear(6), qnn.QuantHardTanh(bit_width=6, min_val=-1.0, max_val=1.0)),
    "float tanh": lambda: two(linear(6), nn.Sequential(nn.Tanh(), qnn.QuantIdentity(bit_width=8))),
    "powers of two": lambda: two(FIXED, qnn.QuantReLU(act_quant=UNSIGNED), qnn.QuantIdentity(act_quant=ACT)),
    "powers of two, tanh": lambda: two(FIXED, qnn.QuantTanh(act_quant=ACT), qnn.QuantIdentity(act_quant=ACT)),
    "bias of 16 bits": lambda: two(
        partial(FIXED, bias_quant=scaled_int.Int16Bias),
        qnn.QuantReLU(act_quant=UNSIGNED, return_quant_tensor=True),
        qnn.QuantIdentity(act_quant=ACT, return_quant_tensor=True),
    ),
    "bias of 32 bits": lambda: two(
        linear(bias_quant=scaled_int.Int32Bias), qnn.QuantReLU(**told(8)), qnn.QuantIdentity(**told(8))
    ),
    "a scale each": lambda: two(linear(5, weight_quant=EACH), qnn.QuantReLU(bit_width=6)),
    "zero points": lambda: two(linear(), qnn.QuantReLU(act_quant=SHIFTED), qnn.QuantIdentity(act_quant=SHIFTED)),
    "zero points of weights": lambda: two(
        linear(weight_quant=shifted_scaled_int.ShiftedUint8WeightPerTensorFloat), qnn.QuantReLU(bit_width=8)
    ),
    "ternary": lambda: two(
        partial(qnn.QuantLinear, bias=True, weight_quant=ternary.SignedTernaryWeightPerTensorConst),
        qnn.QuantReLU(bit_width=4),
    ),
    "binary weights": lambda: two(
        partial(qnn.QuantLinear, bias=True, weight_quant=binary.SignedBinaryWeightPerTensorConst),
        qnn.QuantReLU(bit_width=4),
    ),
    "binary": lambda: two(
        partial(qnn.QuantLinear, bias=True, weight_quant=binary.SignedBinaryWeightPerTensorConst),
        qnn.QuantIdentity(act_quant=ONE),
        qnn.QuantIdentity(act_quant=ONE),
    ),
    "one bit, scale nan": lambda: two(linear(1), qnn.QuantReLU(bit_width=6)),
    "12 and 16 bits": lambda: two(linear(12), qnn.QuantReLU(bit_width=12), qnn.QuantIdentity(bit_width=16)),
    "residual": lambda: Meeting(True),
    "two roads": lambda: Meeting(False),
}


def main(folder: Path) -> None:
    for name, make in MODELS.items():
        for form, export in {"QONNX": export_qonnx, "QCDQ": export_onnx_qcdq}.items():
            torch.manual_seed(0)
            model, file = make(), folder / f"{name}, {form}.onnx"
            with torch.no_grad():
                for _ in range(30):  # scales of activations are learned from what they see
                    model(torch.randn(100, INPUTS))
                model.eval()
                x = torch.randn(SAMPLES, INPUTS)
                y = torch.cat([getattr(v, "value", v) for v in (model(row[None]) for row in x)])
            try:
                export(model, torch.zeros(1, INPUTS), export_path=str(file))
            except (RuntimeError, AssertionError) as error:  # QCDQ has no word for some
                print(f"{file.stem}: {error}")
                continue
            np.savez(file.with_suffix(".npz"), x=x.numpy(), y=y.numpy())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
