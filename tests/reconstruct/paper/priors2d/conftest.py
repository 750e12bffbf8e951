"""A textured plane at depth 1 before four cameras on a line, and a pseudo-view between two of them."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.reconstruct.paper.priors2d.base import Question, SeenViews

HEIGHT, WIDTH, FOCAL = 20, 32, 30.0


def texture(rng, width):
    noise = gaussian_filter(rng.random((HEIGHT, width, 3)), (1.5, 1.5, 0))
    return ((noise - noise.min()) / np.ptp(noise)).astype(np.float32)


@pytest.fixture
def plane():
    """Make a question: cameras at whole pixels of shift, one pseudo-view at camera 1; details given per camera."""
    rng = np.random.default_rng(0)
    wide = texture(rng, WIDTH + 8)

    def at(shift):
        return wide[:, 4 + shift : 4 + shift + WIDTH]

    def pose(shift):
        pose = np.eye(4)
        pose[0, 3] = -shift / FOCAL
        return pose

    def ask(details=None, shifts=(0, 1, 2, 3), pseudo=1, depth=1.0, distortion=None):
        images = np.stack([at(shift) for shift in shifts])
        depths = np.full((len(shifts), HEIGHT, WIDTH), depth, np.float32)
        return Question(
            pseudo=SeenViews(at(pseudo)[None].copy(), depths[:1].copy(), pose(pseudo)[None]),
            recovered=SeenViews(images, depths, np.stack([pose(shift) for shift in shifts])),
            details=np.zeros_like(images) if details is None else details,
            intrinsics=np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]),
            distortion=distortion,
        )

    return ask
