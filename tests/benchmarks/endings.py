"""Whether processes end whose kernels ran in threads: starts of a process that computes, and how many of them ended.

    python -m tests.benchmarks endings
    GS2CI_STARTS=500 python -m tests.benchmarks endings

A process counts as one that did not end if it still runs `DEADLINE_S` after its last line. A library of oneTBB's, whose
threads have been seen to spin at the end of a process, is looked for among what each has loaded.
"""

import os
import subprocess
import sys
import time
from typing import Final

DEADLINE_S: Final = 60.0

_PROGRAM: Final = """
import numpy as np
from pathlib import Path
from gs2ci.reconstruct.decode.kernels import denoise_planes
for _ in range(20):
    denoise_planes(np.random.default_rng(0).random((8, 64, 64), np.float32), 0.1, 5)
print("tbb" if "libtbb" in Path("/proc/self/maps").read_text() else "none", flush=True)
"""


def run() -> None:
    starts = int(os.environ.get("GS2CI_STARTS", "500"))
    ended, with_tbb, longest_s = 0, 0, 0.0
    for _ in range(starts):
        with subprocess.Popen([sys.executable, "-c", _PROGRAM], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            with_tbb += process.stdout.readline().strip() == "tbb"
            began_s = time.monotonic()
            try:
                ended += process.wait(DEADLINE_S) == 0
                longest_s = max(longest_s, time.monotonic() - began_s)
            except subprocess.TimeoutExpired:
                process.kill()
    print(f"{starts} starts, {ended} ended (after at most {longest_s:.1f} s), {with_tbb} with oneTBB")
