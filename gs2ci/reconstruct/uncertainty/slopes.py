"""Slopes of pictures: differences between neighbouring pixels."""

import torch
from torch import Tensor


def slopes(values: Tensor) -> list[Tensor]:
    """Return how maps, [..., H, W], change per pixel down and across; 0 along a side of a single pixel."""
    sides = ((axis, values.shape[axis] > 1) for axis in (-2, -1))
    return [torch.gradient(values, dim=axis)[0] if wide else 0 * values for axis, wide in sides]
