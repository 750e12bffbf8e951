"""A scene as the shot's camera shows it: the coded measurement, the views, and the depths in them.

Here: the renderer with what a shot says of the sensor (masks, weights, mono or mosaic) and a camera matrix. Not here:
any fitting.
"""

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement import coding
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend, Reuse
from gs2ci.render.screen import ScreenStatistics

_OPAQUE = 0.5  # a depth is one surface's where at least half of the light is stopped
_CHANNELS = 3  # of an image
_SLICES = 16 * _CHANNELS
_TINY = torch.finfo(torch.float32).tiny  # a slice that stops nothing is never the one in which half is reached


class ShotRenderer:
    """Renders scenes as one shot's sensor sees them.

    Args:
        shot: The measurement; of its masks and weights, `transmissions` are the products wᵢ Mᵢ, [N, H, W].
        intrinsics: Camera matrix in px, [3, 3].
        backend: The renderer.
    """

    def __init__(self, shot: Shot, intrinsics: F64, backend: Backend) -> None:
        self.size = shot.size
        self.distortion = shot.distortion
        self.intrinsics = torch.from_numpy(intrinsics).float()
        self.transmissions = torch.from_numpy(shot.masks * shot.weights[:, None, None])
        self._backend = backend
        self._mask_set = backend.code(self.transmissions)
        self._channels = coding.cfa_channels(shot.cfa, shot.size) if shot.cfa else None
        self._mono = shot.channels == 1

    def reuse(self) -> Reuse:
        """Return what the renderings of a population may share from now on."""
        return self._backend.reuse()

    def measurement(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        reuse: Reuse | None = None,
        screen: ScreenStatistics | None = None,
    ) -> Tensor:
        """Render the coded measurement, [H, W, C], from the poses under the masks, [N, 4, 4]; differentiable.

        What may be shared with other renderings, and who records what the screen saw: see `Backend.coded`.
        """
        image = self._backend.coded(scene, world_to_camera, self.intrinsics, self._mask_set, screen, reuse)
        if self._channels is not None:
            return coding.select(image, self._channels)
        return image.mean(dim=2, keepdim=True) if self._mono else image

    def views(self, scene: Gaussians, world_to_camera: Tensor) -> F32:
        """Render views from any poses [V, 4, 4]: [V, H, W, C] float32, not clamped; C is 1 for a mono shot."""
        with torch.no_grad():
            images, _ = self.images(scene, world_to_camera)
        return (images.mean(dim=3, keepdim=True) if self._mono else images).numpy()

    def images(self, scene: Gaussians, world_to_camera: Tensor, colours: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Render images [V, H, W, 3] and alphas [V, H, W] from any poses [V, 4, 4]; differentiable.

        `colours`, [V, G, 3], stand for the scene's own where they are given.
        """
        return self._backend.views(scene, world_to_camera, self.intrinsics, self.size, colours=colours)

    def depths(self, scene: Gaussians, world_to_camera: F64) -> F32:
        """Render depths along the optical axis, [V, H, W]: up to there half of what the scene stops is stopped.

        A median, not a mean: the little light that passes a near surface and is stopped by a far one would draw a mean
        to where nothing is, and how little it is differs from fit to fit. Zero where less than half of the light is
        stopped. Found to within one slice: 1 / `_SLICES` of the Gaussians before the camera, sorted by depth.
        """
        poses = torch.from_numpy(np.asarray(world_to_camera)).float()
        along_axis = (scene.means @ poses[:, 2, :3].T + poses[:, 2, 3]).T
        along_axis = torch.where(along_axis > 0, along_axis, torch.inf)  # nothing is drawn behind a camera
        in_order = along_axis.sort(dim=1).values
        with torch.no_grad():
            ranks, alphas = self._median_ranks(scene, poses, along_axis, in_order)
        depths = in_order.gather(1, ranks.flatten(1)).view_as(alphas)
        return torch.where(alphas >= _OPAQUE, depths, 0.0).numpy()

    def _median_ranks(
        self, scene: Gaussians, poses: Tensor, along_axis: Tensor, in_order: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Render the scene up to one depth after another, and see between which two it stops half of its light.

        Args:
            scene: G Gaussians.
            poses: [V, 4, 4].
            along_axis: Their depths, [V, G]; infinite where they are not drawn.
            in_order: The same in ascending order.

        Returns:
            Which Gaussian in order of depth it is, [V, H, W], and what is stopped in all, [V, H, W].
        """
        ends = _slice_ends(in_order)
        up_to = in_order.gather(1, ends[:, 1:].clamp(min=0))
        ranks = before = torch.zeros(len(poses), *self.size)
        for first in range(0, _SLICES, _CHANNELS):
            shown = along_axis[..., None] <= up_to[:, None, first : first + _CHANNELS]
            stopped, alphas = self.images(scene, poses, shown.float())
            half = alphas / 2
            for channel in range(_CHANNELS):
                now, (begin, end) = (
                    stopped[..., channel],
                    ends[:, first + channel :, None, None].float()[:, :2].unbind(1),
                )
                share = (half - before) / (now - before).clamp(min=_TINY)
                ranks = torch.where((before < half) & (now >= half), begin + share * (end - begin), ranks)
                before = now
        return ranks.ceil().long().clamp(min=0), alphas


def _slice_ends(in_order: Tensor) -> Tensor:
    """Cut the Gaussians before each camera, [V, G], into slices of equal number: the last of each, [V, _SLICES + 1].

    A slice begins after the end of the one before it; the first begins after −1.
    """
    last = in_order.isfinite().sum(dim=1, keepdim=True) - 1
    return (torch.linspace(0, 1, _SLICES + 1) * (last + 1) - 1).round().long()
