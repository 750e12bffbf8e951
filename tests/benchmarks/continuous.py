"""Continuous captures on simulated devices: their rate against the devices' own times, and memory over an hour.

The small rig of tests/system (DLPC900 with a DLP5500, V4L2 camera of 48 x 64, light by a formula); times are those of
the bench's own clock. `python -m tests.benchmarks continuous` takes some minutes.
"""

import gc
import tempfile
import time
from pathlib import Path

import psutil

from gs2ci.core.progress import Silent
from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import build_bench
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from tests.system.conftest import HEIGHT, WIDTH, StripedLight, small_table

HOUR_S = 3600.0
READINGS = 6


def _rig(capture: dict[str, object]) -> Rig:
    table = small_table(capture={"axis": "", **capture})
    bench = build_bench(table, StripedLight((768 - HEIGHT) // 2, (1024 - WIDTH) // 2))
    bench.modulator = Dlpc900Twin(bench.world, bench.faults["modulator"], name="modulator", dmd=5)
    return Rig(table, "", Path(), bench)


class Listener(Silent):
    """Notes when the first and the last shot came on the bench's clock, and memory on the way."""

    def __init__(self, rig: Rig, shots: int) -> None:
        super().__init__()
        self._rig, self._shots, self._where = rig, shots, ""
        self.first_s = self.last_s = 0.0
        self.memory_mb: list[float] = []

    def stage(self, name: str, total: int | None = None) -> None:
        self._where = name

    def step(self, done: int, **figures: float) -> None:
        if self._where != "shots":
            return
        if done == 1:
            self.first_s = self._rig.clock.now_s()
        self.last_s = self._rig.clock.now_s()
        if done % max(1, self._shots // READINGS) == 0 and self._shots > READINGS:
            gc.collect()
            self.memory_mb.append(psutil.Process().memory_info().rss / 1e6)


def _take(capture: dict[str, object]) -> tuple[Listener, float, float]:
    """Capture; return what was heard, the time that the devices need for one exposure, and seconds of processor."""
    rig = _rig(capture)
    shots = int(str(capture["shots"]))
    began_s = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        devices = rig.open()
        try:
            prepared = prepare(rig, devices)
            heard = Listener(rig, shots)
            record(rig, devices, prepared, Path(folder) / "shot.h5", replace=True, progress=heard)
            setup = devices.sensor.settings
        finally:
            devices.close()
    needed_s = prepared.plan.exposure_s + setup.readout_s
    return heard, needed_s, time.process_time() - began_s


def run() -> None:
    """Print the rates one by one and continuous, then an hour's memory."""
    print("exposures a second on the bench's clock, from the first shot to the last of 40,")
    print("and the share of the rate that exposure and readout allow:")
    for masks, mask_s in ((2, 0.005), (4, 0.02), (8, 0.02)):
        for continuous in (False, True):
            heard, needed_s, _ = _take({"masks": masks, "mask_s": mask_s, "shots": 40, "continuous": continuous})
            rate = 39 / (heard.last_s - heard.first_s)
            how = "continuous" if continuous else "one by one"
            print(f"  {masks} masks of {mask_s * 1e3:3.0f} ms, {how}: {rate:6.2f} /s  {100 * rate * needed_s:5.1f} %")
    period_s = 2 * 0.2 + 0.001
    shots = int(HOUR_S / period_s)
    heard, _, seconds = _take({"masks": 2, "mask_s": 0.2, "shots": shots, "continuous": True})
    lasted_s = heard.last_s - heard.first_s
    print(f"{shots} exposures in {lasted_s:.0f} s on the bench's clock, {seconds:.0f} s of processor")
    print("memory at each sixth, MB: " + ", ".join(f"{one:.1f}" for one in heard.memory_mb))
