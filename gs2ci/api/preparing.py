"""Compilation of all kernels in advance: `compile_kernels`.

Here: a small reconstruction that calls most of them. Not here: calls of the others (`gs2ci.reconstruct.other_kernels`),
where machine code is stored (`gs2ci.render.cpu.compile`, and Numba for kernels elsewhere).
"""

import tempfile
import time
from pathlib import Path
from typing import Final

SIZE: Final = (68, 100)
VIEWS: Final = 6
PARALLAX_PX: Final = 6.0
# Long enough that the density rule, the search for surfaces and the check on held-out pixels all run.
ITERATIONS: Final = 60


def compile_kernels() -> float:
    """Compile all kernels for this processor, and keep the machine code on disk.

    Otherwise the first reconstruction after an installation does so, and takes longer.

    Returns:
        The seconds that it took.

    Example:
        >>> gs2ci.compile_kernels() > 0
        True
    """
    from gs2ci.reconstruct.other_kernels import call_other_kernels

    began_s = time.monotonic()
    _reconstruct_something()
    call_other_kernels()
    return time.monotonic() - began_s


def _reconstruct_something() -> None:
    from gs2ci.api.demonstration import write_rig
    from gs2ci.api.reconstruction import reconstruct
    from gs2ci.api.rigs import open_rig
    from gs2ci.core.progress import Silent

    with tempfile.TemporaryDirectory(prefix="gs2ci-compile-") as folder:
        rig = write_rig(Path(folder) / "rig.toml", views=VIEWS, size=SIZE, parallax_px=PARALLAX_PX, seed=0)
        with open_rig(rig) as bench:
            shot = bench.record(Path(folder) / "shot.h5", progress=Silent())
        run = reconstruct(shot, iterations=ITERATIONS, progress=Silent())
        if run.interrupted:
            raise KeyboardInterrupt
        run.save(Path(folder) / "run")
