"""The common interface of renderers.

A backend renders whole views, and the coded sum of views without making images of them. Not here: the available
renderers (`gs2ci.render.backend`).
"""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from gs2ci.render.gaussians import Gaussians
from gs2ci.render.sampling import CanvasSampling
from gs2ci.render.screen import ScreenStatistics
from gs2ci.render.stopping import StoppedLight


@dataclass(frozen=True)
class MaskSet:
    """A mask set prepared by a backend; its other contents are internal to the backend.

    Args:
        views: N.
        size: Height and width, px.
    """

    views: int
    size: tuple[int, int]


class Reuse:
    """Data that renderings of the same Gaussians may share; its contents are internal to the backend.

    It is valid for one population: code that adds, removes, reorders or replaces Gaussians has to get a new one. It may
    be used by one rendering at a time.
    """


class Backend(Protocol):
    """A differentiable renderer of Gaussian scenes over a black background.

    A moving scene is rendered at each pose's time, one with harmonics in the colours that each pose sees
    (`gs2ci.render.harmonics.colours_seen`). World-to-camera matrices have OpenCV axes (x right, y down, z forward);
    pixel centres lie at +0.5. Gradients reach all fields of the scene, per-view colours and the upper three rows of the
    poses. A pose's gradient is that of its twelve numbers; parametrise them by tangent vectors to keep them rigid. The
    intrinsics get no gradient.
    """

    @property
    def name(self) -> str:
        """Get its name for `gs2ci.render.backend.load_backend`."""

    @property
    def device(self) -> torch.device:
        """Get where scenes should lie that are rendered often; those of the host are copied, where this is another."""

    def code(self, masks: Tensor, sampling: CanvasSampling | None = None) -> MaskSet:
        """Prepare a mask set, once.

        Args:
            masks: Mask value times slot weight, [N, H, W] float32, not negative; pixels at 0 are never rendered.
            sampling: Positions of the pixels on the canvas, for a lens; None: the pinhole's own pixel grid.

        Raises:
            InputError: Not [N, H, W], negative or not finite, or a sampling of another size.
        """

    def reuse(self) -> Reuse:
        """Return a new object for the data that renderings of the same Gaussians share."""

    def coded(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None = None,
        reuse: Reuse | None = None,
        times: Tensor | None = None,
    ) -> Tensor:
        """Render the coded measurement Y = sum_i M_i * X_i (paper, eq. 1, without noise).

        Args:
            scene: The Gaussians.
            world_to_camera: The pose under each mask, [N, 4, 4].
            intrinsics: Camera matrix in pixels, [3, 3]; with a sampling, that of the pinhole.
            mask_set: From `code`.
            screen: Filled during the backward pass through this rendering, if given.
            reuse: From `reuse`: results of earlier renderings of these Gaussians, used as far as the backend's settings
                allow; None shares nothing.
            times: Time of each pose, [V], in the unit of the scene's motion; required for a moving scene, ignored for a
                still one.

        Returns:
            Y, [H, W, 3] float32, in the unit of the colours.

        Raises:
            InputError: Shapes disagree, a number is not finite, mask set or `reuse` is another backend's, or `screen`
                is for another number of Gaussians.
        """

    def views(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        size: tuple[int, int],
        colours: Tensor | None = None,
        sampling: CanvasSampling | None = None,
        times: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Render whole views.

        Args:
            scene: The Gaussians.
            world_to_camera: Poses, [V, 4, 4].
            intrinsics: Camera matrix in pixels, [3, 3].
            size: Height and width, px.
            colours: Colours that differ from view to view, [V, G, 3], instead of the scene's own and their harmonics;
                None uses the scene's.
            sampling: Positions of the pixels on the canvas, for a lens; None: the pinhole's own pixel grid.
            times: See `coded`.

        Returns:
            Images [V, H, W, 3] and alphas [V, H, W] (1 where no light passes), float32.

        Raises:
            InputError: Shapes disagree or a number is not finite.
        """

    def depths(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        size: tuple[int, int],
        sampling: CanvasSampling | None = None,
        times: Tensor | None = None,
    ) -> StoppedLight:
        """Find the depths at which the light of each pixel is stopped (`gs2ci.render.stopping`); not differentiable.

        Args:
            scene: The Gaussians.
            world_to_camera: Poses, [V, 4, 4].
            intrinsics: Camera matrix in pixels, [3, 3].
            size: Height and width, px.
            sampling: Where the pixels look, behind a lens; None is the pinhole's own lattice.
            times: See `coded`.

        Returns:
            Maps [V, H, W], float32.

        Raises:
            InputError: Shapes disagree or a number is not finite.
        """
