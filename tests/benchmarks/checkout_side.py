"""One side of `checkouts`: reads measurements as lines of JSON, reconstructs each, and answers with lines of JSON.

It runs with the packages of any checkout since bb9e2cb, so it uses nothing that was added later; measurements come as
files, since simulators differ as well.
"""

import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch
from scipy.linalg import expm, logm

from gs2ci.core.arrays import F32
from gs2ci.core.storage import read_shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.run_report import build_report
from gs2ci.reconstruct.pipeline import Reconstruction, reconstruct
from gs2ci.render.backend import load_backend

try:
    from gs2ci.reconstruct.presets.named import preset
except ModuleNotFoundError:  # of a checkout whose presets are one file still
    from gs2ci.reconstruct.presets import preset  # type: ignore[no-redef, attr-defined]


class Asked(TypedDict):
    """A measurement (an exposure file) and how to reconstruct it.

    `between` is whether its true disparity is that of a place between two cameras, `fits` None for as many fits as the
    preset has.
    """

    file: str
    between: bool
    seed: int
    preset: str
    fits: int | None


class Found(TypedDict):
    """What came out; None where it is not known. A view for `between_db` is in a file beside the measurement."""

    seconds: float
    psnr_db: float
    nate: float | None
    median_px: float | None
    far_off: float | None
    scene_db: float | None
    between_db: float | None
    depth_off: float | None


def answer(asked: Asked) -> Found:
    """Reconstruct one measurement; the seed draws all that the reconstruction draws."""
    shot = read_shot(Path(asked["file"]))
    settings = preset(asked["preset"])  # type: ignore[arg-type]
    if asked["fits"] is not None:
        settings = replace(settings, fits=asked["fits"])
    if "GS2CI_MOTION" in os.environ and hasattr(settings, "motion"):
        settings = replace(settings, motion=os.environ["GS2CI_MOTION"])  # type: ignore[arg-type]
    began_s = time.process_time()
    found = reconstruct(shot, replace(settings, seed=settings.seed + asked["seed"]))
    seconds = time.process_time() - began_s
    report = build_report(shot, found.result)
    # Checkouts until 29 November 2026 have a section of the report, which figures the errors.
    errors = report.depth.errors() if hasattr(report.depth, "errors") else report.depth
    if errors is None and asked["between"]:
        from tests.benchmarks.depth import between  # noqa: PLC0415  of this checkout alone, so only where it is needed

        errors = between(found)
    return {
        "seconds": seconds,
        "psnr_db": float("nan") if report.psnr_db is None else report.psnr_db.mean,
        "nate": None if report.trajectory is None else report.trajectory.nate,
        "median_px": None if errors is None else errors.median_px,
        "far_off": None if errors is None else errors.far_off_share,
        "scene_db": _mean_db(found.result.scene_views, shot.truth.views),
        "between_db": _between_db(found, shot.size, Path(asked["file"]).with_suffix(".npy")),
        "depth_off": None if errors is None else errors.median_rel,
    }


def _mean_db(views: F32 | None, truth: F32 | None) -> float | None:
    return None if views is None or truth is None else float(np.mean(psnr_per_view(views, truth)))


def _between_db(found: Reconstruction, size: tuple[int, int], file: Path) -> float | None:
    """Score the scene from half way between the two middle poses, whose true view is in a file, [1, H, W, 3]."""
    if not file.is_file():
        return None
    before, after = found.result.world_to_camera[len(found.result.world_to_camera) // 2 - 1 :][:2]
    half = expm(logm(after @ np.linalg.inv(before)) / 2).real @ before
    pose, intrinsics = (torch.from_numpy(one).float() for one in (half[None], found.result.intrinsics))
    images, truth = load_backend().views(found.scene, pose, intrinsics, size)[0].detach().numpy(), np.load(file)
    # Scenes have three colours, those of grey exposures as well.
    return _mean_db(images if truth.shape[3] == 3 else images.mean(axis=3, keepdims=True), truth)


def main() -> None:
    """Answer until nothing more is asked."""
    # What a stage prints goes where errors go: the pipe is for answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
