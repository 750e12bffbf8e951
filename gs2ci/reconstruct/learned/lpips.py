"""LPIPS (Zhang et al. 2018) from an ONNX file that the user supplies, differentiable.

Here: the few operators of such a network, run by torch, so that the distance has a gradient, which ONNX Runtime does
not compute; and the check against ONNX Runtime that the operators agree. Not here: any weights.

The file is the plain export of the original module: two images, [1, 3, H, W] float32 in [−1, 1], in, one number out.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.onnx_models import OnnxModel, fixed_side, onnx_package, run_model

_TRIAL_SIDE: Final = 64  # four halvings leave four pixels
# Tolerance: convolutions sum in a different order in torch and in ONNX Runtime, in float32 over a million terms.
_AGREEMENT: Final = 1e-3

Attributes = Mapping[str, Any]
Operator = Callable[[Sequence[Tensor], Attributes], Tensor]


class Lpips(OnnxModel):
    """A learned perceptual distance in an ONNX file; see `OnnxModel`.

    Args:
        path: The file.

    Raises:
        InputError: The file cannot be used, the package onnx is not installed, the model does not return one number, it
            contains an operator that is not known here, or one whose result differs from ONNX Runtime's.
    """

    name = "LPIPS"
    kind = "an LPIPS model"
    called = "two images [1, 3, H, W] float32 in [-1, 1]; one number comes out"
    missing = "name the ONNX file of an LPIPS of yours, or do without it"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._sides = tuple(fixed_side(side) for side in self.inputs[0].shape[2:])
        self._graph = _Graph(self.path)
        self._check()

    def is_one(self) -> bool:
        """Tell by inputs and outputs whether the file is of this kind."""
        return self.ranks == [4, 4]

    def __call__(self, image: Tensor, target: Tensor) -> Tensor:
        """Compare images [H, W, 3], full scale 1; the gradient reaches `image` only.

        Raises:
            InputError: The file's image size is fixed, and differs.
        """
        if any(side not in (None, had) for side, had in zip(self._sides, image.shape[:2], strict=True)):
            raise InputError(
                f"{self.path.name} compares images of {self._sides[0]} x {self._sides[1]} pixels, not of "
                f"{image.shape[0]} x {image.shape[1]}",
                remedy="export it with dynamic height and width",
            )
        planes = [part.permute(2, 0, 1)[None] * 2 - 1 for part in (image, target.detach())]
        return self._graph.run(planes).sum()

    def _check(self) -> None:
        """Compare the graph with ONNX Runtime."""
        generator = torch.Generator().manual_seed(0)
        sides = [side or _TRIAL_SIDE for side in self._sides]
        trial = [torch.rand(1, 3, *sides, generator=generator) * 2 - 1 for _ in range(2)]
        feed = {one.name: part.numpy() for one, part in zip(self.inputs, trial, strict=True)}
        answers = run_model(self._session, self.path.name, feed, "export it with dynamic height and width")
        wanted = np.asarray(answers[self.outputs[0].name])
        with torch.no_grad():
            found = self._graph.run(trial).numpy()
        if wanted.size != 1 or not np.isfinite(wanted).all():
            raise InputError(f"{self.path.name} returns {list(wanted.shape)} of two images", allowed=self.called)
        if abs(float(found.sum()) - float(wanted.sum())) > _AGREEMENT * max(1e-3, abs(float(wanted.sum()))):
            raise InputError(
                f"{self.path.name} gives {float(found.sum()):.6g} here, but in ONNX Runtime {float(wanted.sum()):.6g}",
                remedy="export the original module without training-time operators (eval())",
            )


class _Graph:
    """A chain of operators as torch runs it."""

    def __init__(self, path: Path) -> None:
        onnx = onnx_package("reading an LPIPS model")
        graph = onnx.load(str(path)).graph
        self._constants: dict[str, Tensor] = {
            one.name: _tensor(onnx.numpy_helper.to_array(one)) for one in graph.initializer
        }
        self._nodes: list[tuple[Operator, list[str], str, Attributes]] = []
        for node in graph.node:
            attributes = {one.name: onnx.helper.get_attribute_value(one) for one in node.attribute}
            if node.op_type == "Constant":
                kind, value = next(iter(attributes.items()))  # "value" is a tensor; "value_floats" etc. are not
                self._constants[node.output[0]] = _tensor(
                    onnx.numpy_helper.to_array(value) if kind == "value" else value
                )
            elif node.op_type in _OPERATORS:
                self._nodes.append((_OPERATORS[node.op_type], list(node.input), node.output[0], attributes))
            else:
                raise InputError(
                    f"{path.name} holds the operator {node.op_type}",
                    allowed=", ".join(sorted((*_OPERATORS, "Constant"))),
                    remedy="export the original LPIPS module in eval mode",
                )
        self._inputs = [one.name for one in graph.input if one.name not in self._constants]
        self._output = graph.output[0].name

    def run(self, images: Sequence[Tensor]) -> Tensor:
        values: dict[str, Tensor] = {**self._constants, **dict(zip(self._inputs, images, strict=True))}
        for operator, inputs, output, attributes in self._nodes:
            values[output] = operator([values[name] for name in inputs if name], attributes)
        return values[self._output]


def _tensor(array: Any) -> Tensor:
    return torch.from_numpy(np.array(array))


def _conv(parts: Sequence[Tensor], attributes: Attributes) -> Tensor:
    bias = parts[2] if len(parts) > 2 else None
    return functional.conv2d(
        _padded(parts[0], attributes, 0.0),
        parts[1],
        bias,
        stride=attributes.get("strides", [1, 1]),
        dilation=attributes.get("dilations", [1, 1]),
        groups=attributes.get("group", 1),
    )


def _max_pool(parts: Sequence[Tensor], attributes: Attributes) -> Tensor:
    return functional.max_pool2d(
        _padded(parts[0], attributes, float("-inf")),
        attributes["kernel_shape"],
        stride=attributes.get("strides", [1, 1]),
        ceil_mode=bool(attributes.get("ceil_mode", 0)),
    )


def _padded(image: Tensor, attributes: Attributes, value: float) -> Tensor:
    top, left, bottom, right = attributes.get("pads", [0, 0, 0, 0])
    return functional.pad(image, (left, right, top, bottom), value=value)


def _axes(parts: Sequence[Tensor], attributes: Attributes) -> list[int]:
    """Return the axes to reduce: an attribute up to operator set 12 or 17, an input from then on."""
    if len(parts) > 1:
        return [int(axis) for axis in parts[1]]
    return list(attributes.get("axes", range(parts[0].ndim)))


def _reducer(reduce: Callable[..., Tensor]) -> Operator:
    def run(parts: Sequence[Tensor], attributes: Attributes) -> Tensor:
        return reduce(parts[0], dim=_axes(parts, attributes), keepdim=bool(attributes.get("keepdims", 1)))

    return run


_OPERATORS: Final[dict[str, Operator]] = {
    "Conv": _conv,
    "MaxPool": _max_pool,
    "Relu": lambda parts, _: functional.relu(parts[0]),
    "Identity": lambda parts, _: parts[0],
    "Add": lambda parts, _: parts[0] + parts[1],
    "Sub": lambda parts, _: parts[0] - parts[1],
    "Mul": lambda parts, _: parts[0] * parts[1],
    "Div": lambda parts, _: parts[0] / parts[1],
    "Pow": lambda parts, _: parts[0] ** parts[1],
    # The derivative of a root at zero is infinite, and zero times infinity is NaN: dead features give such zeros.
    "Sqrt": lambda parts, _: parts[0].clamp(min=torch.finfo(torch.float32).tiny).sqrt(),
    "ReduceSum": _reducer(torch.sum),
    "ReduceMean": _reducer(torch.mean),
}
