"""A fit's kernels called where its tensors lie: Numba's on the CPU, their counterparts in Warp on a device.

The steps of a fit are written once, and call their kernels through `call`; what a kernel does is declared twice, and
`tests/reconstruct/fit/kernels/test_device_kernels.py` holds the two to each other. Here: the call. Not here: the
kernels (`*_kernels.py`, `optimiser/view_steps.py`), their counterparts (`device/calls.py`).
"""

from typing import Any

from torch import Tensor

from gs2ci.render.places import on_device


def call(kernel: Any, *arguments: Any) -> Any:
    """Call a kernel, which may write to its arguments.

    Args:
        kernel: Of Numba, by its name.
        arguments: Its arguments; arrays that belong to the fit as tensors, the first of them tells where.

    Returns:
        What it returns: a number on the CPU, a tensor [] on a device, so that nothing has to be read back.
    """
    first = next(one for one in arguments if isinstance(one, Tensor))
    if on_device(first):
        from gs2ci.reconstruct.fit.kernels.device import calls  # noqa: PLC0415  an extra

        return calls.counterpart(kernel.__name__)(*arguments)
    return kernel(*(one.detach().numpy() if isinstance(one, Tensor) else one for one in arguments))
