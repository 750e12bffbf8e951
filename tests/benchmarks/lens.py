"""The loss by a lens with distortion, known and unknown: views through it, and the scene seen by a pinhole.

    python -m tests.benchmarks lens

Three scenes of the simulator's library, 128 × 96 px, without a lens, with a barrel and with a pincushion of 0.2.
"""

import time
from dataclasses import replace

import numpy as np
import torch

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.radiance import Renderer
from tests.stability.benches import Bench, build

SIZE = (96, 128)
SCENES = ("boxes", "motorcycle", "thicket")
SETTINGS = Settings(
    fit=CoarseSettings(
        iterations=250,
        densify_every=50,
        hold_out=HoldOut(share=0.04, look_every=25, patience=75, growth_patience=25),
    ),
    fits=1,
)


def run() -> None:
    """Reconstruct and print a line for each."""
    print(f"{'scene':12} {'k1':>5} {'lens':9}   views, dB   scene's own views, dB   by a pinhole, dB   seconds")
    for scene in SCENES:
        for k1 in (0.0, -0.2, 0.2):
            shot = Bench(scene, parallax_px=5.0, effects=(LensDistortion(k1),) if k1 else ()).expose(SIZE)
            told = {"none": shot} if not k1 else {"known": shot, "not told": replace(shot, distortion=None)}
            for name, known in told.items():
                began_s = time.monotonic()
                figures = "   ".join(f"{figure:5.2f}" for figure in figures_of(scene, known))
                print(f"{scene:12} {k1:5} {name:9}   {figures}   {time.monotonic() - began_s:5.1f}", flush=True)


def figures_of(scene: str, shot: Shot) -> tuple[float, float, float]:
    """Reconstruct; return the PSNR of the views, of the scene's, and of the scene's by a pinhole."""
    found = reconstruct(shot, SETTINGS)
    truth, true_poses = shot.truth.views, shot.truth.world_to_camera
    assert truth is not None
    assert true_poses is not None
    assert shot.intrinsics is not None
    poses, camera = (torch.from_numpy(a).float() for a in (found.result.world_to_camera, shot.intrinsics))
    with torch.no_grad():
        seen, _ = load_backend().views(found.scene, poses, camera, SIZE)
    straight, _ = Renderer().views(build(scene, SIZE), true_poses)
    return (
        mean_psnr(found.result.views, truth),
        mean_psnr(found.result.scene_views, truth),
        mean_psnr(seen.numpy(), straight),
    )


def mean_psnr(views: F32, truth: F32) -> float:
    """Return the mean over the views, dB."""
    return float(np.mean(psnr_per_view(views, truth)))
