"""The cost of a whole reconstruction of one scene against the size of its picture: by stage, in seconds and memory.

    python -m tests.benchmarks sizes

Every size is a process of its own, so that its memory is its own. `enlarged` are three photographs that face the
camera, drawn larger than they are by OpenCV: quickly, at any size, but nothing in them is as sharp as the pixels are.
Printed for each: processor seconds and the largest memory of each stage, how many Gaussians there are in the end, PSNR
of the delivered views and the median error of the disparity between neighbouring views, px; then the exponent p of
seconds ∝ pixels^p.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_CASES` | scenes of the simulator, `photographs0` to `photographs2`, and `enlarged` | photographs0 boxes |
| `GS2CI_SIZES` | heights and widths, px | 128x128 256x256 512x512 |
| `GS2CI_VIEWS` | masks of an exposure of photographs | 8 |
| `GS2CI_PRESET` | the preset | draft |
| `GS2CI_ITERATIONS` | of the fit, where only memory is asked for | the preset's |
| `NUMBA_NUM_THREADS` | threads of each process | 1 |
| `GS2CI_SEED` | of masks, noise and the reconstruction | 0 |
"""

import gc
import json
import os
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import skimage.data

from gs2ci.core.arrays import F32
from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.run_report import build_report
from gs2ci.reconstruct import observe, pipeline
from gs2ci.reconstruct.fit.coarse import exposure
from gs2ci.reconstruct.fit.coarse import stage as coarse
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.hypotheses import fitting
from gs2ci.reconstruct.presets.named import preset
from tests.benchmarks.photographs import expose
from tests.processes import ONE_THREAD, answer_of
from tests.tables.cases import Case

EVERY_S = 0.02
STAGES = (
    ("registration", observe, "register"),
    ("first look: decode, path, depth", observe, "look"),
    ("first look: decode, path, depth", observe, "look_closer"),
    ("order of depth", fitting.Fits, "order_of"),
    ("first Gaussians", fitting.Fits, "beginning"),
    ("fits", fitting, "advance_together"),
    ("fits: surfaces", exposure, "find_surfaces"),
    ("fits: looks", coarse.CoarseRun, "_look"),
    ("depth", ShotRenderer, "stopped_light"),
    ("mean of the fits", fitting, "combined"),
    ("choice of views", pipeline, "hand_over"),
    ("record", pipeline, "record"),
)


class Meter:
    """Counts seconds of the processor and of the clock, and samples memory, by the innermost stage that runs."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.wall_s: dict[str, float] = defaultdict(float)
        self.mib: dict[str, float] = defaultdict(float)
        self._stages = ["the rest"]
        self._since_s = time.process_time(), time.monotonic()

    def enter(self, stage: str) -> None:
        """Count for a stage from now on."""
        self._lap()
        self._stages.append(stage)

    def leave(self) -> None:
        """Count for the stage around it again."""
        self._lap()
        self._stages.pop()

    def _lap(self) -> None:
        now_s = time.process_time(), time.monotonic()
        self.seconds[self._stages[-1]] += now_s[0] - self._since_s[0]
        self.wall_s[self._stages[-1]] += now_s[1] - self._since_s[1]
        self._since_s = now_s

    def sample(self, stop: threading.Event) -> None:
        """Look at the memory every few milliseconds until it is time to stop."""
        while not stop.wait(EVERY_S):
            stage = self._stages[-1]
            self.mib[stage] = max(self.mib[stage], resident_mib())

    def around(self, stage: str, work: Callable[..., Any]) -> Callable[..., Any]:
        """Return the same work, counted for a stage."""

        @wraps(work)
        def run(*args: Any, **kwargs: Any) -> Any:
            self.enter(stage)
            try:
                return work(*args, **kwargs)
            finally:
                self.leave()

        return run


def resident_mib() -> float:
    """Return the memory that the process holds (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


@contextmanager
def metered(meter: Meter, stages: Sequence[tuple[str, Any, str]] = STAGES) -> Iterator[None]:
    """Count and sample until the end; stages are names, and where the functions lie that are them."""
    stop = threading.Event()
    sampler = threading.Thread(target=meter.sample, args=(stop,), daemon=True)
    patches = [patch.object(owner, name, meter.around(stage, getattr(owner, name))) for stage, owner, name in stages]
    for each in patches:
        each.start()
    sampler.start()
    try:
        yield
    finally:
        for each in patches:
            each.stop()
        stop.set()
        sampler.join()
        meter.enter("")


def taken(name: str, size: tuple[int, int], views: int, seed: int) -> tuple[Shot, np.ndarray | None]:
    """Expose a case; return as well the true depths, [N, H, W], where the shot's truth does not hold them."""
    if name == "enlarged":
        return enlarged(size, views, seed)
    if name.startswith("photographs"):
        shot, depths, _ = expose(int(name.removeprefix("photographs")), seed, size=size, views=views, noise=0.01)
        return shot, depths
    return Case(name, scene=name, size=size).shot(seed), None


def enlarged(size: tuple[int, int], views: int, seed: int) -> tuple[Shot, F32]:
    """Code views, under random masks a quarter open, of three photographs that face a camera on a straight rail.

    Returns:
        The shot, with 1 % noise, and the true depths, [N, H, W].
    """
    rng, (height, width) = np.random.default_rng(seed), size
    intrinsics = pinhole(1.1 * width, size)
    places = np.linspace(-0.06, 0.06, views)
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = -places
    images, depths = np.zeros((views, height, width, 3), np.float32), np.zeros((views, height, width), np.float32)
    for picture, (x, y, z), wide in (
        (skimage.data.coffee(), (0.0, 0.0, 2.6), 4.6),
        (skimage.data.astronaut(), (-0.42, 0.1, 1.9), 0.75),
        (skimage.data.chelsea(), (0.45, -0.1, 1.5), 0.55),
    ):
        colours = picture.astype(np.float32) / 255
        rows, columns = colours.shape[:2]
        for view, place in enumerate(places):
            # From the photograph's pixels to the picture's.
            scale = intrinsics[0, 0] / z * wide / columns
            left = intrinsics[0, 2] + intrinsics[0, 0] * (x - place) / z - scale * columns / 2
            top = intrinsics[1, 2] + intrinsics[1, 1] * y / z - scale * rows / 2
            there = np.array([[scale, 0, left + scale / 2 - 0.5], [0, scale, top + scale / 2 - 0.5]])
            seen = cv2.warpAffine(np.ones((rows, columns), np.uint8), there, (width, height), flags=cv2.INTER_NEAREST)
            drawn = cv2.warpAffine(colours, there, (width, height), borderMode=cv2.BORDER_REPLICATE)
            images[view][seen > 0], depths[view][seen > 0] = drawn[seen > 0], z
    masks = (rng.random((views, height, width), dtype=np.float32) < 0.25).astype(np.float32)
    measurement = np.zeros((height, width, 3), np.float32)
    for mask, image in zip(masks, images, strict=True):
        measurement += mask[..., None] * image
    measurement += rng.normal(0, 0.01, measurement.shape).astype(np.float32)
    truth = Truth(images, poses)
    weights = np.ones(views, np.float32)
    return Shot(measurement, masks, weights, intrinsics=intrinsics, truth=truth, name="enlarged").check(), depths


def one() -> None:
    """Reconstruct one case and print what it cost as JSON."""
    name, size = sys.argv[1], tuple(int(side) for side in sys.argv[2].split("x"))
    chosen, seed, views = os.environ["GS2CI_PRESET"], int(os.environ["GS2CI_SEED"]), int(os.environ["GS2CI_VIEWS"])
    settings = replace(preset(chosen), seed=42 + seed)  # type: ignore[arg-type]
    if "GS2CI_ITERATIONS" in os.environ:
        settings = replace(settings, fit=replace(settings.fit, iterations=int(os.environ["GS2CI_ITERATIONS"])))
    # Compiles whatever the large one needs.
    pipeline.reconstruct(taken(name, (64, 64), views, seed)[0], settings)
    shot, depths = taken(name, (size[0], size[1]), views, seed)
    gc.collect()
    before_mib, meter, began_s = resident_mib(), Meter(), time.monotonic()
    with metered(meter):
        found = pipeline.reconstruct(shot, settings)
    wall_s = time.monotonic() - began_s
    report = build_report(shot, found.result)
    errors = report.depth
    print(
        json.dumps(
            {
                "wall_s": wall_s,
                "pixels": size[0] * size[1],
                "seconds": meter.seconds,
                "mib": meter.mib,
                "before_mib": before_mib,
                "gaussians": len(found.scene),
                "psnr_db": None if report.psnr_db is None else report.psnr_db.mean,
                "depth_px": (errors.median_px if errors else None) if depths is None else off_px(found, depths),
                "nate": None if report.trajectory is None else report.trajectory.nate,
            }
        )
    )


def off_px(found: pipeline.Reconstruction, depths: np.ndarray) -> float:
    """Return the median error of the disparity between neighbouring views, px, of depths up to a scale."""
    result = found.result
    if result.depth is None:
        return float("nan")
    truth, light = depths.astype(np.float64), result.depth.astype(np.float64)
    seen = (truth > 0) & np.isfinite(truth) & (light > 0)
    poses = result.world_to_camera
    step = np.linalg.norm(np.diff(np.linalg.inv(poses)[:, :3, 3], axis=0), axis=1).mean()
    scale = np.median(truth[seen]) / np.median(light[seen])
    error = np.abs(1 / truth[seen] - 1 / (light[seen] * scale)) * result.intrinsics[0, 0] * step * scale
    return float(np.median(error))


def run() -> None:
    """Reconstruct every case at every size, and print."""
    cases = os.environ.get("GS2CI_CASES", "photographs0 boxes").split()
    sizes = os.environ.get("GS2CI_SIZES", "128x128 256x256 512x512").split()
    wanted = {"GS2CI_PRESET": "draft", "GS2CI_SEED": "0", "GS2CI_VIEWS": "8"}
    for name in cases:
        rows = []
        for size in sizes:
            row = answer_of("tests.benchmarks.sizes", [name, size], {**ONE_THREAD, **wanted, **os.environ})
            rows.append(row)
            print(
                f"{name} {size}: CPU {sum(row['seconds'].values()):.1f} s, {row['wall_s']:.0f} s, "
                f"at most {max(row['mib'].values()):.0f} MiB "
                f"({row['before_mib']:.0f} before), {row['gaussians']} Gaussians, {figure(row['psnr_db'])} dB, "
                f"depth {figure(row['depth_px'])} px, nATE {figure(row['nate'])}"
            )
            for stage, seconds in sorted(row["seconds"].items(), key=lambda item: -item[1]):
                print(f"    {stage:34} {seconds:8.1f} s {row['mib'].get(stage, 0):8.0f} MiB", flush=True)
        if len(rows) > 1:
            pixels = np.log([row["pixels"] for row in rows])
            spent = np.log([sum(row["seconds"].values()) for row in rows])
            print(f"{name}: seconds ∝ pixels^{np.polyfit(pixels, spent, 1)[0]:.2f}", flush=True)


def figure(value: float | None) -> str:
    """Return a figure with three digits, or a dash."""
    return "–" if value is None else f"{value:.3f}"
