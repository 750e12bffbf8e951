"""Memory and time of one scene from many exposures, against their number; and what is foreseen of the memory.

    python -m tests.benchmarks many_exposures
    GS2CI_SIZE=264x353 GS2CI_COUNTS="1 32" GS2CI_PRESET=standard NUMBA_NUM_THREADS=2 python -m tests.benchmarks \\
        many_exposures

Paths on a lattice before a room, eight views an exposure, random masks, a quarter open, 1 % noise, poses by a stage
(`tests/exposed_rooms.py`). As `gs2ci reconstruct --together` does it: what is done is kept on a disk, and the run
folder is written at the end; one exposure is reconstructed by itself. Every number of exposures is a process of its
own, which has compiled and imported before it counts; printed are processor seconds, seconds of the clock, the largest
memory (`environment.peak_mib`) and what of it was there before, by stage; then how memory and seconds grow with an
exposure, by least squares over numbers from four on, and what that makes for 32.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_COUNTS` | numbers of exposures | 1 2 4 8 16 32 |
| `GS2CI_SIZE` | height and width, px | 64x96 |
| `GS2CI_PRESET` | the preset | draft |
| `GS2CI_ITERATIONS` | of the fit of one exposure, where only memory is asked for | the preset's |
| `NUMBA_NUM_THREADS` | threads of each process | 1 |
"""

import gc
import json
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.evaluate.environment import peak_mib, restart_peak
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.run_folder import write_run
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.exposures import joint
from gs2ci.reconstruct.exposures.foreseen import foreseen_mib
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.sizes import Meter, metered, resident_mib
from tests.exposed_rooms import exposed, line, room
from tests.processes import ONE_THREAD, answer_of

ASKED = 32
STAGES = (
    ("observed", joint, "observe"),
    ("placed", joint, "places"),
    ("fitted", joint, "_fitted"),
    ("views made", joint, "_part"),
    ("views together", joint, "merged"),
    ("run folder", sys.modules[__name__], "write_run"),
)
ACROSS, DOWN = 0.2, 0.15


def lattice(count: int, size: tuple[int, int]) -> list[Shot]:
    """Expose one room from so many places, eight in a row."""
    scene, found = room(0, size), []
    rows = -(-count // 8)
    for number in range(count):
        x = ACROSS * (number % 8 - (min(count, 8) - 1) / 2)
        y = DOWN * (number // 8 - (rows - 1) / 2)
        found.append(exposed(scene, line(x, y), size, number, noise=0.01, name=f"exposure {number}"))
    return found


def one() -> None:
    """Reconstruct so many exposures and print what that took as JSON."""
    count, size = int(sys.argv[1]), tuple(int(side) for side in sys.argv[2].split("x"))
    settings = preset(os.environ["GS2CI_PRESET"])  # type: ignore[arg-type]
    settings = replace(settings, registration=replace(settings.registration, mode="off"))
    if "GS2CI_ITERATIONS" in os.environ:
        settings = replace(settings, fit=replace(settings.fit, iterations=int(os.environ["GS2CI_ITERATIONS"])))
    with tempfile.TemporaryDirectory() as folder:
        _done(lattice(2, (32, 48)), settings, Path(folder) / "first")
    shots = lattice(count, (size[0], size[1]))
    gc.collect()
    restart_peak()
    before_mib, meter, began_s = resident_mib(), Meter(), (time.process_time(), time.monotonic())
    with tempfile.TemporaryDirectory() as folder, metered(meter, STAGES):
        psnr_db = _done(shots, settings, Path(folder))
        kept = sum(file.stat().st_size for file in (Path(folder) / "kept").glob("*")) / 2**20
    took = {"cpu_s": time.process_time() - began_s[0], "wall_s": time.monotonic() - began_s[1]}
    told = {"peak_mib": peak_mib(), "before_mib": before_mib, "foreseen_mib": foreseen_mib(shots)}
    stages = {"mib": dict(meter.mib), "seconds": dict(meter.seconds)}
    print(json.dumps({**took, **told, **stages, "kept_mib": kept, "psnr_db": psnr_db}))


def _done(shots: list[Shot], settings: Settings, folder: Path) -> float:
    if len(shots) == 1:
        alone = pipeline.reconstruct(shots[0], settings)
        shot, result, scene = shots[0], alone.result, alone.scene
    else:
        found = joint.reconstruct_together(shots, settings, Silent(), unfinished=folder / "kept")
        shot, result, scene = found.shot, found.result, found.scene
    write_run(folder / "run", shot, result, scene)
    truth = shot.truth.views
    assert truth is not None
    return float(np.mean(psnr_per_view(result.views, truth)))


def run() -> None:
    """Reconstruct each number of exposures, and print."""
    counts = [int(number) for number in os.environ.get("GS2CI_COUNTS", "1 2 4 8 16 32").split()]
    size, rows = os.environ.get("GS2CI_SIZE", "64x96"), []
    environment = {**ONE_THREAD, "GS2CI_PRESET": "draft", **os.environ}
    for count in counts:
        row: dict[str, Any] = answer_of("tests.benchmarks.many_exposures", [str(count), size], environment)
        rows.append(row)
        print(
            f"{count:3} exposures of {size}: CPU {row['cpu_s']:.1f} s, {row['wall_s']:.0f} s, at most "
            f"{row['peak_mib']:.0f} MiB, {row['before_mib']:.0f} before; foreseen {row['foreseen_mib']}; "
            f"{row['kept_mib']:.0f} MiB kept; {row['psnr_db']:.2f} dB"
        )
        for stage, seconds in row["seconds"].items():
            print(f"    {stage:16} {seconds:8.1f} s {row['mib'].get(stage, 0):8.0f} MiB", flush=True)
    if counts[0] == 1:
        for count, row in zip(counts[1:], rows[1:], strict=True):
            print(f"{count:3} exposures: {row['cpu_s'] / count / rows[0]['cpu_s']:.2f} of the seconds of single runs")
    many = [number for number, count in enumerate(counts) if count >= 4 or len(counts) < 4]
    if len(many) > 1:
        for what, unit in (("peak_mib", "MiB"), ("cpu_s", "CPU s")):
            slope, first = np.polyfit([counts[k] for k in many], [rows[k][what] for k in many], 1)
            print(f"{slope:.1f} {unit} an exposure; {first + ASKED * slope:.0f} for {ASKED} by that")
