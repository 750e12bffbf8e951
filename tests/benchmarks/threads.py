"""How much sooner a whole reconstruction ends on more threads, by stage; are its bits the same?

    python -m tests.benchmarks threads

Each number of threads is a process of its own, one after the other; the first is begun twice, and counted the second
time, so that all kernels have been compiled. Seconds are of the clock, by the innermost stage that the leading fit is
in; several fits share the threads. `busy` is how many threads were at work in the mean: processor seconds over seconds.
The digest is of views, depth and path.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_THREADS` | numbers of threads | 1, 2, 4 ... up to the machine's |
| `GS2CI_CASES` | scenes, as in `sizes` | photographs0 |
| `GS2CI_SIZES` | height and width, px | 264x352 |
| `GS2CI_VIEWS` | masks of an exposure of photographs | 8 |
| `GS2CI_PRESET` | the preset | standard |
| `GS2CI_SEED` | of masks, noise and the reconstruction | 0 |
"""

import hashlib
import json
import os
import sys
import time
from typing import Any

import numpy as np

from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.presets.named import preset
from tests.benchmarks.sizes import Meter, metered, taken
from tests.processes import ONE_THREAD, answer_of

LEAST_S = 0.2


def one() -> None:
    """Reconstruct one case and print what it took as JSON."""
    name, size = sys.argv[1], tuple(int(side) for side in sys.argv[2].split("x"))
    settings = preset(os.environ["GS2CI_PRESET"])  # type: ignore[arg-type]
    seed, views = int(os.environ["GS2CI_SEED"]), int(os.environ["GS2CI_VIEWS"])
    pipeline.reconstruct(taken(name, (64, 64), views, seed)[0], settings)  # compiles
    shot, _ = taken(name, (size[0], size[1]), views, seed)
    meter, began_s, began_cpu_s = Meter(), time.monotonic(), time.process_time()
    with metered(meter):
        result = pipeline.reconstruct(shot, settings).result
    wall_s, cpu_s = time.monotonic() - began_s, time.process_time() - began_cpu_s
    digest = hashlib.sha256()
    for array in (result.views, result.depth, result.world_to_camera):
        if array is not None:
            digest.update(np.ascontiguousarray(array).tobytes())
    print(json.dumps({"wall_s": wall_s, "cpu_s": cpu_s, "stages": meter.wall_s, "digest": digest.hexdigest()[:12]}))


def run() -> None:
    """Reconstruct every case on every number of threads, and print."""
    most = len(os.sched_getaffinity(0))
    doubled = [2**k for k in range(most.bit_length()) if 2**k <= most]
    numbers = [int(n) for n in os.environ.get("GS2CI_THREADS", "").split()] or doubled
    for name in os.environ.get("GS2CI_CASES", "photographs0").split():
        for size in os.environ.get("GS2CI_SIZES", "264x352").split():
            _compare(name, size, numbers)


def _compare(name: str, size: str, numbers: list[int]) -> None:
    rows = []
    _reconstructed(name, size, numbers[0])  # compiles what the small case does not call
    for threads in numbers:
        row = _reconstructed(name, size, threads)
        rows.append(row)
        sooner, busy = rows[0]["wall_s"] / row["wall_s"], row["cpu_s"] / row["wall_s"]
        print(
            f"{name} {size}, {threads} threads: {row['wall_s']:.1f} s, {sooner:.2f} times as fast as on {numbers[0]}, "
            f"{busy:.1f} busy, {row['digest']}",
            flush=True,
        )
    for stage in sorted(rows[0]["stages"], key=lambda stage: -rows[0]["stages"][stage]):
        seconds = [row["stages"].get(stage, 0.0) for row in rows]
        if max(seconds) >= LEAST_S:
            print(f"    {stage:34}" + "".join(f"{s:8.1f}" for s in seconds), flush=True)


def _reconstructed(name: str, size: str, threads: int) -> dict[str, Any]:
    wanted = {"GS2CI_PRESET": "standard", "GS2CI_SEED": "0", "GS2CI_VIEWS": "8"}
    own = {key: str(threads) if key.startswith(("NUMBA", "OMP_NUM")) else v for key, v in ONE_THREAD.items()}
    return answer_of("tests.benchmarks.threads", [name, size], {**wanted, **os.environ, **own})
