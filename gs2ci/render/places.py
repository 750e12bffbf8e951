"""Whether numbers lie on a device, from which reading them back means waiting for it.

Here: the question, for renderers and fits alike. Not here: the choice of a device (`devices.py`).
"""

import torch
from torch import Tensor

_everywhere = False
"""Whether the host counts as a device: tests and counts switch it, since no other device can be had everywhere."""


def count_host_as_device(*, yes: bool) -> None:
    """Let the host's tensors be treated as a device's, or no longer: for tests, and to count a device's work."""
    global _everywhere  # noqa: PLW0603
    _everywhere = yes


def is_apart(device: torch.device) -> bool:
    """Tell whether a device is another one than the host."""
    return _everywhere or device.type != "cpu"


def on_device(tensor: Tensor) -> bool:
    """Tell whether a tensor's numbers lie on a device."""
    return _everywhere or not tensor.is_cpu
