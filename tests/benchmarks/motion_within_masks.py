"""The loss by motion within a mask, and its recovery by moments of each mask: simulated exposures, sharp true views.

    python -m tests.benchmarks motion_within_masks
    GS2CI_CASES=boxes python -m tests.benchmarks motion_within_masks    scenes and paths whose names contain that word
    GS2CI_TOLD=1 python -m tests.benchmarks motion_within_masks         the true path is told, as a stage's

The camera goes by so many px of the median depth during each mask, of 8, in pictures of 96 × 72: steadily, ever
faster (from a third of the mean speed to five thirds), or while it trembles. The simulator integrates the light over
each mask; its truth is sharp in the middle of each. "still masks" is the same exposure without motion during a mask
(the camera jumps in between): what the fit could reach. Then the exposure with one pose for each mask, and with
the moments that it asks for; `recovered` is the share of the loss that these take back. One fit each, of 250
iterations. Where the path is told, moments may be 16 and their tolerance a quarter: what these do not take back is lost
in the readings, not in the path.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMomentSettings
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.scene import Scene
from tests.stability.benches import INTERVAL_S, Bench, Scale
from tests.stability.judge import settings_for

SIZE = (72, 96)
VIEWS = 8
SCENES = ("boxes", "planes", "thicket")
PIXELS = (1, 2, 4, 8)
ITERATIONS = 250


@dataclass(frozen=True)
class Moving:
    """A camera that goes aside by a way along its axes that is a function of time.

    Args:
        scene: Its camera begins here.
        way: Scene units at each time, [T, 3] for [T].
        highest_hz: In the motion.
    """

    scene: Scene
    way: Callable[[F64], F64]
    highest_hz: float = 0.0

    def world_to_camera(self, time_s: F64) -> F64:
        """Get the poses at the given times, [T, 4, 4]."""
        poses = np.tile(np.eye(4), (len(time_s), 1, 1))
        poses[:, :3, 3] = -self.way(np.asarray(time_s, np.float64))
        moved: F64 = poses @ self.scene.world_to_camera
        return moved


def going(pixels: float, kind: str) -> Callable[[Scene, float], Moving]:
    """Go by so many px of the median depth a mask, in the mean over the exposure."""

    def path(scene: Scene, duration_s: float) -> Moving:
        each = pixels * scene.median_depth / scene.intrinsics[0, 0] / INTERVAL_S
        direction = np.array([1.0, 0.3, 0.1])
        bend = 2 / (3 * duration_s) * each if kind == "faster" else 0.0
        tremble_hz = 1 / (4 * INTERVAL_S) if kind == "trembling" else 0.0

        def way(time_s: F64) -> F64:
            along = each * time_s
            if bend:
                # From a third of the speed to five thirds of it, wherever the exposure's times begin.
                along = along + bend * (time_s**2 - duration_s * time_s)
            found: F64 = along[:, None] * direction
            if tremble_hz:
                found[:, 1] += each * INTERVAL_S * 0.5 * np.sin(2 * np.pi * tremble_hz * time_s)
            return found

        return Moving(scene, way, tremble_hz)

    return path


def exposed(scene: str, pixels: float, kind: str, *, blurred: bool) -> Shot:
    """Expose; without motion during a mask, each sees one moment, the middle of its interval."""
    # An odd number of nodes has one in the middle, where the truth is; two for each px follow all that pixels resolve.
    blur = MotionBlur(2 * int(np.ceil(pixels)) + 3 if blurred else 1)
    return Bench(scene, views=VIEWS, path=going(pixels, kind), effects=(blur,)).expose(SIZE)


def _mean(result: RunResult, shot: Shot) -> float:
    assert shot.truth.views is not None
    return float(np.mean(psnr_per_view(result.views, shot.truth.views)))


def run() -> None:
    wanted, told = os.environ.get("GS2CI_CASES", ""), bool(os.environ.get("GS2CI_TOLD"))
    known = replace(
        settings_for(Scale(SIZE, ITERATIONS)), fits=1, motion="off", mask_moments=MaskMomentSettings("moving")
    )
    if told:
        moments = MaskMomentSettings("moving", tolerance=MaskMomentSettings().tolerance / 4, most=16)
        known = replace(known, poses="stage", mask_moments=moments)
    print(f"{'':22} {'px':>4} {'still masks':>11} {'one pose':>9} {'moments':>8} {'recovered':>9}  bound   moments")
    for scene in SCENES:
        for kind in ("steady", "faster", "trembling") if scene == "boxes" else ("steady",):
            name = f"{scene}, {kind}"
            if wanted not in name:
                continue
            for pixels in PIXELS:
                _compare(name, pixels, kind, scene, known)


def _compare(name: str, pixels: float, kind: str, scene: str, settings: Settings) -> None:
    still, moving = (exposed(scene, pixels, kind, blurred=blurred) for blurred in (False, True))
    if settings.poses == "stage":
        still, moving = (
            replace(shot, telemetry_world_to_camera=shot.truth.world_to_camera) for shot in (still, moving)
        )
    one = replace(settings, mask_moments=MaskMomentSettings("still"))
    best = _mean(reconstruct(still, one).result, still)
    plain = _mean(reconstruct(moving, one).result, moving)
    found = reconstruct(moving, settings).result
    given, loss = _mean(found, moving), best - plain
    told = found.mask_moments or {"bounds": [0.0], "moments": [1]}
    share = f"{(given - plain) / loss:9.0%}" if loss > 0.3 else f"{'':9}"
    print(
        f"{name:22} {pixels:4g} {best:11.2f} {plain:9.2f} {given:8.2f} {share}  {max(told['bounds']):.4f}  "
        f"{min(told['moments'])} to {max(told['moments'])}",
        flush=True,
    )
