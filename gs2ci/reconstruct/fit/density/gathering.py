"""The statistics for density rules, gathered while the fit runs.

Here: the screen statistics since the rule was last applied, and the error attributed to Gaussians. Not here: how rules
use them (`density/`).
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import GaussianStatistics
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.screen import ScreenStatistics

# The default's thresholds were found on pictures of so many pixels and fewer.
_THRESHOLDS_PX: Final = 96 * 128


class Gathering:
    """Gathers the screen statistics, and converts them to the unit that rules expect.

    Args:
        renderers: Render for each exposure.
        count: Number of Gaussians at the start.
        comparable: Whether gradients are given in a unit that does not depend on the share of open pixels, nor on the
            size of a picture of more than 96 x 128 px.
    """

    def __init__(self, renderers: Sequence[ShotRenderer], count: int, *, comparable: bool = True) -> None:
        self._renderers = renderers
        factors = [_gradient_factor(renderer, comparable=comparable) for renderer in renderers]
        self._gradient_factor = float(np.mean(factors))
        self.screen = ScreenStatistics.empty(count, renderers[0].device)

    def evidence(
        self,
        scene: Gaussians,
        paths: Sequence[Tensor],
        errors: Callable[[], Sequence[Tensor]],
        *,
        extent: float,
        cap: int,
        iteration: int,
    ) -> GaussianStatistics:
        """Return the statistics in the form that a rule takes: on the host, where rules decide.

        Args:
            scene: The present Gaussians.
            paths: The present poses in each exposure, [N, 4, 4].
            errors: Returns the error of each pixel of each predicted measurement, [H, W].
            extent: See `GaussianStatistics`.
            cap: See `GaussianStatistics`.
            iteration: See `GaussianStatistics`.
        """
        return GaussianStatistics(
            screen_gradient=(self.screen.mean_gradient() * self._gradient_factor).cpu(),
            screen_radius=(self.screen.radius_px / max(self._renderers[0].size)).cpu(),
            blended_error=lambda: self._most_blended(scene.detach(), paths, errors()).cpu(),
            extent=extent,
            cap=cap,
            iteration=iteration,
        )

    def _most_blended(self, scene: Gaussians, paths: Sequence[Tensor], errors: Sequence[Tensor]) -> Tensor:
        """Return each Gaussian's part in the error of a view, in the view where it is largest, [G]."""
        pairs = zip(self._renderers, paths, errors, strict=True)
        parts = [_blended(renderer, scene, path.detach(), error) for renderer, path, error in pairs]
        return parts[0] if len(parts) == 1 else torch.stack(parts).amax(dim=0)


def _gradient_factor(renderer: ShotRenderer, *, comparable: bool) -> float:
    # Each moment of a mask gets its share of the mask's light.
    factor = float(renderer.moments_per_mask)
    if not comparable:
        return factor
    # The loss is a mean over all pixels. A view whose mask opens a quarter of them receives a quarter of the
    # gradient that it would receive as a photograph.
    masks = renderer.transmissions
    open_share = max(float(masks.mean()) / renderer.exposure, torch.finfo(masks.dtype).tiny)
    # The gradient by a shift of a pixel falls as the number of pixels, half an image size grows as its root.
    height, width = renderer.size
    return factor / open_share * max(1.0, height * width / _THRESHOLDS_PX) ** 0.5


def _blended(renderer: ShotRenderer, scene: Gaussians, world_to_camera: Tensor, error: Tensor) -> Tensor:
    """Return each Gaussian's part in the error of a view of one exposure, in the view where it is largest, [G].

    An image is the sum of blending weights times colours, so this part is the gradient, by the Gaussian's colour, of
    the product of image and error (Rota Bulò et al. 2024, section 3.1).
    """
    views = len(world_to_camera)
    colours = scene.means.new_zeros(views, len(scene), 3).requires_grad_()
    images, _ = renderer.images(scene, world_to_camera, colours)
    open_pixels = (renderer.transmissions > 0).to(images)
    torch.autograd.backward((images[..., 0] * open_pixels * error.to(images)).sum())
    assert colours.grad is not None
    return colours.grad[..., 0].amax(dim=0)
