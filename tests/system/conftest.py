"""A small simulated rig for whole captures: real drivers, wire twins, a scene given by formulae."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gs2ci.core.progress import Silent
from gs2ci.rig.config import RigTable
from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare, record
from gs2ci.rig.simulated import SimulatedBench, build_bench
from gs2ci_sims.wires.dlpc900 import Dlpc900Twin
from gs2ci_sims.world import Exposure

HEIGHT, WIDTH = 48, 64


class StripedLight:
    """Light of a sinusoidal wall: what a pixel collects has a closed form in the camera's position."""

    DN_PER_S = 4e4

    def __init__(self, row: int, column: int) -> None:
        self.row, self.column = row, column

    def radiance(self, world_to_camera: np.ndarray, height: int, width: int) -> np.ndarray:
        shift_px = -50.0 * world_to_camera[0, 3]
        columns = np.arange(width) + shift_px
        return np.tile(0.5 + 0.4 * np.sin(2 * np.pi * columns / 16.0), (height, 1))

    def collect(self, exposure: Exposure) -> np.ndarray:
        light = np.zeros((exposure.height, exposure.width))
        for mask in exposure.masks:
            seen = mask.levels[self.row : self.row + exposure.height, self.column : self.column + exposure.width]
            middle = exposure.world_to_camera_at((mask.start_s + mask.end_s) / 2)
            share = seen / mask.top * (mask.end_s - mask.start_s)
            light += share * self.radiance(middle, exposure.height, exposure.width)
        return np.minimum(np.rint(16.0 + light * self.DN_PER_S), 2**exposure.bits - 1).astype(np.uint16)


@dataclass
class Small:
    """A small rig on its bench."""

    rig: Rig
    bench: SimulatedBench
    out: Path
    said: Silent = field(default_factory=Silent)

    def expected_dn(self, index: int, masks: np.ndarray) -> np.ndarray:
        """What the light's formula says of an exposure, from masks at the sensor and the world's own motion."""
        exposure, light = self.bench.world.exposures[index], self.bench.world.light
        total = np.zeros(masks.shape[1:])
        # A mask that began as the exposure ended is no part of it.
        intervals = [mask for mask in exposure.masks if mask.end_s - mask.start_s > 1e-4]
        for mask, interval in zip(masks, intervals, strict=True):
            pose = exposure.world_to_camera_at((interval.start_s + interval.end_s) / 2)
            total += mask * (interval.end_s - interval.start_s) * light.radiance(pose, *total.shape)
        return np.minimum(16.0 + total * light.DN_PER_S, 4095.0)

    def capture(self, out: Path | None = None) -> Path:
        """Open the rig, capture into a file, close the rig whatever happens."""
        devices = self.rig.open()
        try:
            return record(
                self.rig, devices, prepare(self.rig, devices), out or self.out, replace=True, progress=self.said
            )
        finally:
            devices.close()


def small_table(**changes: dict[str, object]) -> RigTable:
    tables: dict[str, dict[str, object]] = {
        "modulator": {"kind": "dlpc900", "trigger_out_2_bit": "disables", "reply_timeout_s": 1.0},
        "sensor": {
            "kind": "v4l2",
            "height": HEIGHT,
            "width": WIDTH,
            "format": "Y12",
            "black_level_dn": 16.0,
            "full_well_e": 10000.0,
            "electrons_per_dn": 2.5,
        },
        "stage": {"kind": "zaber", "mount": {}},
        "capture": {
            "masks": 4,
            "mask_s": 0.02,
            "shots": 3,
            "axis": "x",
            "from_mm": 74.0,
            "to_mm": 75.0,
            "density": 0.5,
        },
        "optics": {"focal_px": 100.0, "nearest_mm": 200.0},
        "world": {"devices": "ideal", "height": HEIGHT, "width": WIDTH, "scene_units_per_mm": 1.0},
    }
    for name, change in changes.items():
        same = "kind" not in change or change["kind"] == tables.get(name, {}).get("kind")
        tables[name] = {**tables.get(name, {}), **change} if same else change
    if tables["stage"].get("kind") == "grbl" and tables["capture"]["from_mm"] == 74.0:
        tables["capture"] |= {"from_mm": -60.0, "to_mm": -59.0}
    return RigTable.model_validate(tables)


def small_rig(folder: Path, *, dlp5500: bool = False, **changes: dict[str, object]) -> Small:
    """Build the rig in a folder; with the smaller DLP5500 a capture costs half the time."""
    table = small_table(**changes)
    rows, columns = (300, 400) if table.modulator.kind == "scpi" else (1080, 1920)
    if dlp5500 and table.modulator.kind == "dlpc900":
        rows, columns = 768, 1024
    bench = build_bench(table, StripedLight((rows - HEIGHT) // 2, (columns - WIDTH) // 2))
    if dlp5500 and table.modulator.kind == "dlpc900":
        enables = table.world.trigger_out_2_bit == "enables"
        bench.modulator = Dlpc900Twin(
            bench.world, bench.faults["modulator"], name="modulator", dmd=5, bit_enables=enables
        )
    return Small(Rig(table, "small", folder, bench), bench, folder / "shot.h5")


@pytest.fixture
def make_small(tmp_path: Path) -> Callable[..., Small]:
    return partial(small_rig, tmp_path)
