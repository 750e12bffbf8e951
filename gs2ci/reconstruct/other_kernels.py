"""Calls of the kernels that a small reconstruction does not reach, so that they can be compiled in advance.

Its masks lie where they should, its decode does not couple views, and its Gaussians look
the same from everywhere. Here: one call of each, with arguments of the types that the product hands over; results are
dropped. A kernel that is reached neither here nor by that reconstruction is found by `make wheel`. Not here: the
reconstruction (`gs2ci.api.preparing`).
"""

from dataclasses import replace

import numpy as np
import torch

from gs2ci.reconstruct.decode.denoisers import TotalVariation
from gs2ci.reconstruct.fit.losses import LossWeights, add_regularisers
from gs2ci.reconstruct.registration.sharpen import unshifted
from gs2ci.reconstruct.registration.widening import widened
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians

_SIZE = (8, 8)
_INTRINSICS = np.array([[8.0, 0, 4], [0, 8.0, 4], [0, 0, 1]])


def call_other_kernels() -> None:
    """Call each once."""
    _of_registration()
    TotalVariation(coupling=0.5)(np.zeros((2, 1, *_SIZE), np.float32), 0.1)
    _of_scenes()


def _of_registration() -> None:
    masks = np.zeros((2, *_SIZE))
    widened(masks, 0.1)
    unshifted(masks, 0.1, 0.1)


def _of_scenes() -> None:
    scene = Gaussians(
        means=torch.tensor([[0.0, 0.0, 1.0]]),
        log_scales=torch.full((1, 3), -2.0),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        opacity_logits=torch.zeros(1),
        colours=torch.full((1, 3), 0.5),
        harmonics=torch.zeros(1, 3, 3),
    )
    scene = scene.map(lambda tensor: tensor.requires_grad_())
    intrinsics = torch.from_numpy(_INTRINSICS).float()
    images, alphas = load_backend().views(scene, torch.eye(4)[None].requires_grad_(), intrinsics, _SIZE)
    (images.sum() + alphas.sum()).backward()  # type: ignore[no-untyped-call]
    still = replace(scene, harmonics=None)
    with torch.no_grad():
        add_regularisers(still, LossWeights(size=0.1))
