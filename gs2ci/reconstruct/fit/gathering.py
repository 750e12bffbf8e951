"""The statistics for density rules, gathered while the fit runs.

Here: the screen statistics since the rule was last applied, and the error attributed to Gaussians. Not here: how rules
use them (`density/`).
"""

from collections.abc import Callable

import torch
from torch import Tensor

from gs2ci.reconstruct.fit.density.base import GaussianStatistics
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.screen import ScreenStatistics


class Gathering:
    """Gathers the screen statistics, and converts them to the unit that rules expect.

    Args:
        renderer: Renders for the shot.
        count: Number of Gaussians at the start.
        per_open_share: Whether gradients are divided by the share of open pixels.
    """

    def __init__(self, renderer: ShotRenderer, count: int, *, per_open_share: bool = True) -> None:
        self._renderer = renderer
        masks = renderer.transmissions
        # The loss is a mean over all pixels. A view whose mask opens a quarter of them receives a quarter of the
        # gradient that it would receive as a photograph, for which the rules' thresholds were found.
        open_share = max(float(masks.mean()) / renderer.exposure, torch.finfo(masks.dtype).tiny)
        # Each moment of a mask gets its share of the mask's light.
        self._gradient_factor = renderer.moments_per_mask * (1.0 / open_share if per_open_share else 1.0)
        self.screen = ScreenStatistics.empty(count)

    def start_again(self, count: int) -> None:
        """Discard the statistics, since the Gaussians are new now."""
        self.screen = ScreenStatistics.empty(count)

    def evidence(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        error: Callable[[], Tensor],
        *,
        extent: float,
        cap: int,
        iteration: int,
    ) -> GaussianStatistics:
        """Return the statistics in the form that a rule takes.

        Args:
            scene: The present Gaussians.
            world_to_camera: The present poses, [N, 4, 4].
            error: Returns the error of each pixel of the predicted measurement, [H, W].
            extent: See `GaussianStatistics`.
            cap: See `GaussianStatistics`.
            iteration: See `GaussianStatistics`.
        """
        return GaussianStatistics(
            screen_gradient=self.screen.mean_gradient() * self._gradient_factor,
            screen_radius=self.screen.radius_px / max(self._renderer.size),
            blended_error=lambda: self._blended(scene.detach(), world_to_camera.detach(), error()),
            extent=extent,
            cap=cap,
            iteration=iteration,
        )

    def _blended(self, scene: Gaussians, world_to_camera: Tensor, error: Tensor) -> Tensor:
        """Return each Gaussian's part in the error of a view, in the view where it is largest, [G].

        An image is the sum of blending weights times colours, so this part is the gradient, by the Gaussian's colour,
        of the product of image and error (Rota Bulò et al. 2024, section 3.1).
        """
        views = len(world_to_camera)
        colours = torch.zeros(views, len(scene), 3, requires_grad=True)
        images, _ = self._renderer.images(scene, world_to_camera, colours)
        open_pixels = (self._renderer.transmissions > 0).to(images.dtype)
        torch.autograd.backward((images[..., 0] * open_pixels * error.to(images.dtype)).sum())
        assert colours.grad is not None
        return colours.grad[..., 0].amax(dim=0)
