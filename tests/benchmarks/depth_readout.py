"""How far is rendered depth from the true one, as the median along a ray and as the mean?

    python -m tests.benchmarks depth_readout

Simulated exposures with true depth, reconstructed from the true poses, so that only the fit and the way in which its
depth is read stand between the two: mean relative error after one scale (Eigen et al. 2014), and the share of the
pixels within a ratio of 1.25, in the view that the scene's depth map belongs to.
"""

from dataclasses import replace

import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.evaluate.depth import depth_errors
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.gaussians import Gaussians
from tests.stability.benches import Bench, build

SCENES = ("boxes", "thicket", "motorcycle", "ball", "planes")
SIZE = (96, 128)
SEEDS = (0, 1)
SETTINGS = Settings(poses="stage", fits=1)


def run() -> None:
    ratios = []
    for scene, seed in ((scene, seed) for scene in SCENES for seed in SEEDS):
        shot = Bench(scene=scene).expose(SIZE, seed)
        told = replace(shot, telemetry_world_to_camera=shot.truth.world_to_camera)
        found = reconstruct(told, replace(SETTINGS, seed=seed))
        renderer = ShotRenderer(shot, shot.intrinsics, CpuBackend())
        pose = _at_true_depth(found.result.world_to_camera, shot.truth.world_to_camera, build(scene, SIZE))
        errors = [
            depth_errors(depth, build(scene, SIZE).depth)
            for depth in (renderer.depths(found.scene, pose), _mean_depths(renderer, found.scene, pose))
        ]
        if None in errors:
            print(f"{scene:12} seed {seed}: no depth")
            continue
        said = [f"{error.abs_rel:.4f} ({error.close_share:.1%} within 1.25)" for error in errors]
        print(f"{scene:12} seed {seed}: median {said[0]}, mean {said[1]}", flush=True)
        ratios.append(errors[0].abs_rel / errors[1].abs_rel)
    print(f"error of the median over that of the mean: {np.exp(np.mean(np.log(ratios))):.2f} in the geometric mean")


def _at_true_depth(found: F64, true: F64, scene) -> F64:
    """Carry the pose of the scene's depth map over into the frame that was found, [1, 4, 4]."""
    middle = len(true) // 2
    return (scene.world_to_camera @ np.linalg.inv(true[middle]) @ found[middle])[None]


def _mean_depths(renderer: ShotRenderer, scene: Gaussians, world_to_camera: F64) -> F32:
    """Render the mean of depth along each ray, [V, H, W], as `ShotRenderer.depths` has its median."""
    poses = torch.from_numpy(world_to_camera).float()
    along_axis = (scene.means @ poses[:, 2, :3].T + poses[:, 2, 3]).T
    with torch.no_grad():
        sums, alphas = renderer.images(scene, poses, along_axis[..., None].expand(-1, -1, 3).contiguous())
    return torch.where(alphas >= 0.5, sums[..., 0] / alphas.clamp(min=0.5), 0.0).numpy()
