"""The float64 definition of the similarity, a plane seen by a moving camera, and a scene of scattered Gaussians."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import numba
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.losses.ssim import C1, C2, SIGMA_PX, WINDOW
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.render.gaussians import Gaussians


def _similarity(image: torch.Tensor, target: torch.Tensor, window_px: int = WINDOW) -> torch.Tensor:
    """Mean SSIM of [H, W, C] float64, Wang et al. 2004, eq. 13; zero padding, data range 1."""
    reach = torch.arange(window_px, dtype=torch.float64) - window_px // 2
    taps = torch.exp(-(reach**2) / (2 * (SIGMA_PX * window_px / WINDOW) ** 2))
    window = torch.outer(taps, taps) / taps.sum() ** 2

    def local_mean(planes: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(planes[:, None], window[None, None], padding=window_px // 2)[:, 0]

    a, b = image.permute(2, 0, 1), target.permute(2, 0, 1)
    mean_a, mean_b = local_mean(a), local_mean(b)
    variance_a, variance_b = local_mean(a * a) - mean_a**2, local_mean(b * b) - mean_b**2
    covariance = local_mean(a * b) - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
    structure = (2 * covariance + C2) / (variance_a + variance_b + C2)
    return (luminance * structure).mean()


@pytest.fixture(scope="session")
def similarity_definition() -> Callable[..., torch.Tensor]:
    return _similarity


@pytest.fixture(scope="session")
def threads() -> Callable[[int], AbstractContextManager[None]]:
    """Run a block with so many threads of Numba and torch; skips where this machine has fewer."""

    @contextmanager
    def limited(count: int) -> Iterator[None]:
        if count > numba.config.NUMBA_NUM_THREADS:
            pytest.skip(f"Numba was started with {numba.config.NUMBA_NUM_THREADS} threads")
        before = numba.get_num_threads(), torch.get_num_threads()
        numba.set_num_threads(count)
        torch.set_num_threads(count)
        try:
            yield
        finally:
            numba.set_num_threads(before[0])
            torch.set_num_threads(before[1])

    return limited


@pytest.fixture(scope="session")
def scattered() -> Callable[..., Gaussians]:
    """Make G Gaussians at random places one unit before the camera: `scattered(count, seed=0)`."""

    def make(count: int, seed: int = 0, logits: float | None = None) -> Gaussians:
        rng = np.random.default_rng(seed)
        opacity = rng.normal(0, 1, count) if logits is None else np.full(count, logits)
        return Gaussians(
            means=torch.tensor(rng.uniform(-0.5, 0.5, (count, 3)) + np.array([0, 0, 1]), dtype=torch.float32),
            log_scales=torch.tensor(rng.normal(-3, 0.3, (count, 3)), dtype=torch.float32),
            quaternions=torch.tensor(rng.normal(size=(count, 4)), dtype=torch.float32),
            opacity_logits=torch.tensor(opacity, dtype=torch.float32),
            colours=torch.tensor(rng.random((count, 3)), dtype=torch.float32),
        )

    return make


@pytest.fixture(scope="session")
def moving_plane() -> tuple[Shot, Geometry]:
    """A textured plane at depth 1, a camera that shifts its image by a pixel per view, and random masks."""
    views, height, width = 4, 32, 40
    rng = np.random.default_rng(3)
    texture = gaussian_filter(rng.random((height, width + views, 3)), (1.5, 1.5, 0))
    texture = (texture - texture.min()) / np.ptp(texture)
    images = np.stack([texture[:, views - i : views - i + width] for i in range(views)]).astype(np.float32)
    masks = (rng.random((views, height, width)) < 0.4).astype(np.float32)
    focal = 40.0
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = (np.arange(views) - views // 2) / focal
    shot = Shot(
        measurement=(masks[..., None] * images).sum(axis=0),
        masks=masks,
        weights=np.ones(views, np.float32),
        intrinsics=np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]),
    ).check()
    geometry = Geometry(
        world_to_camera=poses,
        intrinsics=np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]),
        focal_source="file",
        inverse_depth=np.ones((height, width), np.float32),
        reference=views // 2,
        tracks=100,
        reprojection_rms_px=0.1,
        parallax_px=2.0,
        verdict="full",
        notes=(),
    )
    return shot, geometry
