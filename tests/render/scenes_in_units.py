"""Drawn scenes in any unit of length, their pictures, and how alike two of them look. For the tests of files."""

import math
from dataclasses import replace

import numpy as np
import torch

from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import coefficients
from tests.render.backends import load_backend

UNITS = (1e-3, 1.0, 20.0, 1e6)
SIZE = (31, 43)


def drawn(seed: int, unit: float = 1.0, degree: int = 0, count: int = 400) -> Gaussians:
    """Draw a cloud 2 to 10 units before a camera at the origin, needles and discs among it, sizes of a pixel or so."""
    draws = torch.Generator().manual_seed(seed)

    def even(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=draws, dtype=torch.float64)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=draws, dtype=torch.float64)

    focal, depth = 1.1 * max(SIZE), 2 + 8 * even(count)
    across = (even(count, 2) - 0.5) * depth[:, None] * torch.tensor([SIZE[1], SIZE[0]]) / focal * 1.2
    sizes = (depth / focal * torch.exp(1 + 0.5 * normal(count)))[:, None] * torch.exp(0.7 * normal(count, 3))
    return Gaussians(
        unit * torch.cat([across, depth[:, None]], dim=1),
        (unit * sizes).log(),
        normal(count, 4),
        2 * normal(count),
        even(count, 3),
        harmonics=0.15 * normal(count, coefficients(degree), 3) if degree else None,
    ).map(torch.Tensor.float)


def scaled(scene: Gaussians, scale: float) -> Gaussians:
    """Multiply all lengths of a scene."""
    own = scene.map(torch.Tensor.double)
    own = replace(own, means=scale * own.means, log_scales=own.log_scales + math.log(scale))
    return own.map(torch.Tensor.float)


def shown(scene: Gaussians, unit: float = 1.0) -> np.ndarray:
    """Render three views, in a unit in which the renderer's nearest depth is far before the scene."""
    poses = torch.eye(4)[None].repeat(3, 1, 1)
    poses[1, 0, 3], poses[2, 1, 3] = 0.2, -0.1
    focal = 1.1 * max(SIZE)
    intrinsics = torch.tensor([[focal, 0, SIZE[1] / 2 + 3.0], [0, focal, SIZE[0] / 2 - 2.0], [0, 0, 1]])
    with torch.no_grad():
        images, _ = load_backend().views(scaled(scene, 1 / unit), poses, intrinsics, SIZE)
    return images.clamp(0, 1).numpy()


def psnr_db(one: np.ndarray, other: np.ndarray) -> float:
    return -10 * math.log10(max(float(np.mean((one - other) ** 2)), 1e-12))
