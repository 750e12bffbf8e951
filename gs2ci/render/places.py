"""Whether numbers lie on a device, from which reading them back means waiting for it.

Here: the question, for renderers and fits alike, and the device on which work with arrays of the host is to be done.
Not here: the choice of a device (`devices.py`).
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from typing import Final

import torch
from torch import Tensor

from gs2ci.core.errors import DeviceError, ResourceError

_FULL: Final = re.compile("out of memory|failed to allocate", re.IGNORECASE)
_HOST: Final = torch.device("cpu")
_working: ContextVar[torch.device | None] = ContextVar("device for work with arrays of the host", default=None)

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


@contextmanager
def working_on(device: torch.device) -> Iterator[None]:
    """Let work with arrays of the host that has a version for devices be done on one, in this thread.

    Other threads, unless they run in a copy of this one's context, go on on the host. A CUDA device becomes torch's
    current one, and its usual stream the current stream, whatever they were: on another stream torch's work would wait
    neither for the renderer's nor for that of threads, which begin on the usual one.

    Raises:
        ResourceError: A CUDA device has not enough memory.
        DeviceError: It fails.
    """
    usual = torch.cuda.stream(torch.cuda.default_stream(device)) if device.type == "cuda" else nullcontext()
    before = _working.set(device)
    try:
        with usual:
            yield
    except RuntimeError as error:  # of torch and of Warp alike; a device reports a failure with any later call
        if device.type == "cuda":
            _tell_of_card(device, error)
        raise
    finally:
        _working.reset(before)


def _tell_of_card(device: torch.device, error: RuntimeError) -> None:
    """Say in our words that a card failed, if it was the card."""
    words = (str(error).strip().splitlines() or [""])[0]
    if _FULL.search(words) and "cuda" in words.lower():
        remedy = "end other programs on the card, crop the shot, or take --device cpu"
        raise ResourceError(f"{device} has not enough memory ({words})", remedy=remedy) from error
    if "CUDA" in words:
        remedy = "see what `nvidia-smi` says, update NVIDIA's driver, or take --device cpu"
        raise DeviceError(f"{device} failed ({words})", remedy=remedy) from error


def work_place() -> torch.device:
    """Return the device on which work that torch does on either side is to be done."""
    return _working.get() or _HOST


def working_device() -> torch.device | None:
    """Return the device on which such work is to be done; None: on the host."""
    device = work_place()
    return device if is_apart(device) else None
