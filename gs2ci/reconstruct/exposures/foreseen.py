"""The memory that a joint run takes, known before anything is computed.

An exposure in work takes as much as a run of it alone. Of each, masks, readings and the fit's own lists of pixels stay
while all are fitted, and its views, depths and their standard errors once they are made. Measured by
`python -m tests.benchmarks many_exposures`.

Here: the estimate, and the sentence. Not here: the memory of a CUDA device (`reconstruct.placing`).
"""

import math
from collections.abc import Sequence
from typing import Final

import psutil

from gs2ci.core.records import Shot

# The program with its libraries, MiB; bytes of a pixel of a view: of the exposure in work, and of every exposure.
_BASE_MIB: Final = 650
_IN_WORK_BYTES: Final = 450
_EACH_BYTES: Final = 205


def foreseen_mib(shots: Sequence[Shot]) -> int:
    """Estimate the largest memory of a joint run that keeps on a disk what is done, MiB."""
    pixels = [shot.views * shot.size[0] * shot.size[1] for shot in shots]
    return _BASE_MIB + math.ceil((_IN_WORK_BYTES * max(pixels) + _EACH_BYTES * sum(pixels)) / 2**20)


def said(shots: Sequence[Shot]) -> str:
    """Say what is foreseen, and what is free."""
    needed, free = foreseen_mib(shots), psutil.virtual_memory().available // 2**20
    enough = "" if needed <= free else ": more than that, so that it may take long or be ended by the system"
    return f"{len(shots)} exposures together take about {needed} MiB of memory, of which {free} are free{enough}."
