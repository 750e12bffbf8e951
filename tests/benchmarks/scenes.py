"""Scenes for benchmarks, with footprints on the image similar to those of a fitted scene."""

import numpy as np
import torch
from torch import Tensor

from gs2ci.render.gaussians import Gaussians
from tests.render import se3


def fitted_like(count: int, size: tuple[int, int], seed: int = 0) -> tuple[Gaussians, Tensor]:
    """Return Gaussians and intrinsics: curved surfaces before a background, some floaters.

    Footprints have a median sigma of 1.3 px at 20 000 Gaussians in 256 x 256 (their areas add up to the same
    coverage at other counts), a long tail, and opacities anywhere between 0 and 1.
    """
    rng = np.random.default_rng(seed)
    focal = 1.1 * max(size)
    surfaces, background = int(0.6 * count), int(0.25 * count)
    floaters = count - surfaces - background
    which = rng.integers(0, 12, surfaces)
    ball = rng.normal(size=(surfaces, 3))
    ball *= (rng.uniform(0.25, 0.55, 12)[which] / np.linalg.norm(ball, axis=1))[:, None]
    centres = rng.uniform([-1, -0.9, 2.6], [1, 0.9, 4.4], (12, 3))
    wall = rng.uniform(-1, 1, (background, 2)) * 3.6
    means = np.concatenate(
        [
            centres[which] + ball,
            np.column_stack([wall, 6.5 + np.sin(0.7 * wall[:, 0])]),
            rng.normal([0, 0, 4], [1, 1, 0.8], (floaters, 3)),
        ]
    )
    sigma_px = 1.3 * max(size) / 256 * np.sqrt(20_000 / count) * np.exp(rng.normal(0, 0.55, count))
    sigma_px[rng.random(count) < 0.02] *= rng.uniform(4, 10)
    scales = (sigma_px * means[:, 2] / focal)[:, None] * np.exp(rng.normal(0, 0.5, (count, 3))) * [1, 1, 0.5]
    opacity = rng.beta(1.0, 1.2, count).clip(0.01, 0.995)
    order = rng.permutation(count)
    scene = Gaussians(
        means=means,
        log_scales=np.log(scales),
        quaternions=rng.normal(size=(count, 4)),
        opacity_logits=np.log(opacity / (1 - opacity)),
        colours=rng.uniform(0, 1, (count, 3)),
    ).map(lambda a: torch.tensor(a[order], dtype=torch.float32))
    height, width = size
    return scene, torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])


def small_motion(views: int, seed: int = 0) -> Tensor:
    """Return poses [V, 4, 4] along a few centimetres, with a little rotation."""
    rng = np.random.default_rng(seed)
    along = np.linspace(-0.5, 0.5, views)[:, None]
    twists = along * [0.25, 0, 0.05, 0, 0.06, 0] + rng.normal(0, 0.01, (views, 6))
    return se3.exp(torch.tensor(twists, dtype=torch.float32))


def random_masks(views: int, size: tuple[int, int], open_share: float, seed: int = 0) -> Tensor:
    """Return binary masks [V, H, W] with this share of open pixels."""
    rng = np.random.default_rng(seed)
    return torch.tensor(rng.random((views, *size)) < open_share, dtype=torch.float32)
