"""Memory of a task's own, within kernels."""

import numpy as np

from gs2ci.core.kernels import helper
from gs2ci.render.cpu.workspace import CACHE_LINE_BYTES

_FLOATS_OF_LINE = CACHE_LINE_BYTES // 4


@helper()
def aligned_zeros(count):
    """Return zeros [count] float32 that begin with a cache line, as a vector does that lies in one.

    Numba's own begin anywhere at 32 bytes, and every other such vector then lies across two lines.
    """
    raw = np.zeros(count + _FLOATS_OF_LINE, np.float32)
    ahead = (raw.ctypes.data % CACHE_LINE_BYTES) // 4
    begin = (_FLOATS_OF_LINE - ahead) % _FLOATS_OF_LINE
    return raw[begin : begin + count]
