"""Short names for types of arrays, whose shapes and units are told where they are used; tensors read by numpy; rms."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
U32 = NDArray[np.uint32]
Bool = NDArray[np.bool_]
Size = tuple[int, int]
"""Rows and columns, or height and width in px."""
Rng = np.random.Generator


def on_host(given: Any) -> Any:
    """Return a tensor without its graph and in the host's memory, as numpy reads it; anything else as it is."""
    return given.detach().cpu() if hasattr(given, "detach") else given


def rms_of(values: F32 | F64) -> float:
    """Return the root mean square of numbers, at least one."""
    return float(np.sqrt(np.square(values).mean()))
