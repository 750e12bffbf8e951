"""The interface of priors on images.

A prior is frozen: it is called once, before the fine stage, and its results are targets of small weight. Held-out
pixels judge whether they helped (`fine.py`).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import NumericsError


@dataclass(frozen=True)
class SeenViews:
    """Views of a scene, with the data that a prior may need.

    Args:
        images: [V, H, W, 3] float32, full scale 1, not clamped.
        depths: Along the optical axis in scene units, [V, H, W] float32; 0 at pixels where less than half of the light
            is stopped.
        world_to_camera: [V, 4, 4].
    """

    images: F32
    depths: F32
    world_to_camera: F64


@dataclass(frozen=True)
class Question:
    """The input of a prior: pseudo-views to improve, and the data to do so.

    Args:
        pseudo: The scene rendered from the synthesised poses.
        recovered: The scene rendered from the recovered cameras.
        intrinsics: Camera matrix in px, [3, 3].
        distortion: Of the lens of all views, [5] as in `Shot`; None for a pinhole.
    """

    pseudo: SeenViews
    recovered: SeenViews
    intrinsics: F64
    distortion: F64 | None = None


class ImagePrior(Protocol):
    """Makes target images for rendered views."""

    @property
    def name(self) -> str:
        """Get its name in reports."""

    def __call__(self, question: Question) -> F32:
        """Return targets for the pseudo-views, [V, H, W, 3] float32, full scale 1.

        Raises:
            InputError: The prior cannot work on views of this size.
            NumericsError: It failed, or its result is not finite.
        """


def check_targets(name: str, targets: F32, images: F32) -> F32:
    """Return a prior's targets, clamped to [0, 1], if they have the shape of its input and are finite.

    Raises:
        NumericsError: Another shape, or values that are not finite.
    """
    if targets.shape != images.shape:
        raise NumericsError(
            f"the prior {name} made {list(targets.shape)} of images {list(images.shape)}",
            allowed="images of the same size",
            remedy="check the model's export",
        )
    if not np.isfinite(targets).all():
        raise NumericsError(
            f"the prior {name} returned numbers that are not finite",
            allowed="finite numbers",
            remedy="check that the model was exported for values in [-1, 1], and in float32",
        )
    return np.clip(targets, 0, 1).astype(np.float32, copy=False)
