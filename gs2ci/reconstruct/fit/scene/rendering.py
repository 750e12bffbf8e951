"""A scene as the shot's camera shows it: the coded measurement, the views, and the depths in them.

Here: the renderer with a shot's sensor (masks, weights, mono or mosaic), a camera matrix and a lens. Not here: when
each mask was open (`mask_moments.py`), any fitting.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32, F64
from gs2ci.core.lens import pixel_centres
from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMoments, mask_times
from gs2ci.reconstruct.fit.scene.rigid import MomentsOfPath
from gs2ci.reconstruct.measurement import coding
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.render.adjoint import Image, Pull, as_image, coded_with_pull
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend, MaskSet, Reuse
from gs2ci.render.sampling import CanvasSampling
from gs2ci.render.screen import ScreenStatistics
from gs2ci.render.stopping import StoppedLight

# Of so many squares of pixels along each side of the picture, one is looked at for the range of depth. A renderer's
# cell is such a square, and takes the same time wherever it lies.
_SQUARE_PX, _ONE_SQUARE_IN = 4, 4


class ShotRenderer:
    """Renders scenes as one shot's sensor sees them.

    Args:
        shot: The measurement; of its masks and weights, `transmissions` are the products wᵢ Mᵢ, [N, H, W].
        intrinsics: Camera matrix in px, [3, 3]; with a lens, that of the pinhole model in the sensor's pixels.
        backend: The renderer.
        lens: The lens of the camera; None for a pinhole. With a lens, every image is rendered as the sensor sees it.
        mask_moments: The moments of each mask; None if one for each is enough.
        one_picture: Whether the camera is at rest before scenes that are, too: every mask sees the same picture, which
            is rendered once. Poses are then those of the first mask; their gradients are left out.
    """

    def __init__(
        self,
        shot: Shot,
        intrinsics: F64,
        backend: Backend,
        lens: Lens | None = None,
        mask_moments: MaskMoments | None = None,
        *,
        one_picture: bool = False,
    ) -> None:
        self.shot = shot
        self.size = shot.size
        self.distortion = shot.distortion
        self.intrinsics = torch.from_numpy(intrinsics).float()
        self.times = mask_times(shot.views)
        self.transmissions = torch.from_numpy(shot.transmissions)
        self._backend = backend
        self.lens = lens
        self._sampling = None if lens is None else lens.sampling
        self._mask_moments = mask_moments
        self._one_picture = one_picture
        self._mask_set = self.code(self.split_transmissions)
        self._channels = coding.cfa_channels(shot.cfa, shot.size) if shot.cfa else None
        self._mono = shot.channels == 1

    @property
    def device(self) -> torch.device:
        """Get where scenes should lie while they are fitted."""
        return self._backend.device

    @property
    def moments_per_mask(self) -> float:
        """Get how many moments a mask has on average; less than one if all masks see one picture."""
        if self._one_picture:
            return 1.0 / self.shot.views
        return 1.0 if self._mask_moments is None else self._mask_moments.per_mask

    @property
    def exposure(self) -> float:
        """Get the mean weight of the masks that got light: the reading of a white pixel under one open mask."""
        weights = self.shot.weights
        return float(weights[weights > 0].mean(dtype=np.float64))

    @property
    def split_transmissions(self) -> Tensor:
        """Get the masks' light shared among all moments, or all of it for the one picture, [V, H, W]."""
        if self._one_picture:
            return self.transmissions.sum(dim=0, keepdim=True)
        return self.transmissions if self._mask_moments is None else self._mask_moments.split(self.transmissions)

    def with_one_moment(self) -> "ShotRenderer":
        """Return a renderer of the same shot that gives each mask one moment."""
        if self._mask_moments is None:
            return self
        matrix = self.intrinsics.double().numpy()
        return ShotRenderer(self.shot, matrix, self._backend, self.lens, one_picture=self._one_picture)

    def reuse(self) -> Reuse:
        """Return a new object that holds what renderings of the same Gaussians may share."""
        return self._backend.reuse()

    def measurement(self, scene: Gaussians, world_to_camera: Tensor, reuse: Reuse | None = None) -> Tensor:
        """Render the coded measurement, [H, W, C], from the poses under the masks, [N, 4, 4]."""
        moments, times, _ = self._moments(world_to_camera.detach())
        with torch.no_grad():
            there = moments.to(scene.means.device)
            image = self._backend.coded(scene, there, self.intrinsics, self._mask_set, None, reuse, times)
        return torch.as_tensor(self._to_channels(as_image(image.float())))

    def measurement_with_pull(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        reuse: Reuse | None = None,
        screen: ScreenStatistics | None = None,
    ) -> tuple[Image, Pull]:
        """Render the coded measurement, [H, W, C]; also return the function that propagates its gradient back.

        The function adds the gradient to the scene's, and returns that by the poses, [N, 4, 4]. Images and gradients
        are arrays, or tensors on the device of a scene that lies on one. For `reuse` and `screen` see `Backend.coded`.
        """
        moments, times, along = self._moments(world_to_camera.detach())
        there = moments.to(scene.means.device)
        image, pull = coded_with_pull(
            self._backend, scene, there, self.intrinsics, self._mask_set, screen, reuse, times
        )

        def pull_channels(gradient: Image) -> Image:
            by_moments: Image = pull(self._to_colours(gradient))
            if self._one_picture:
                return np.zeros(world_to_camera.shape, np.float32)
            return by_moments if along is None else along.by_path(torch.as_tensor(by_moments).cpu().numpy())

        return self._to_channels(image), pull_channels

    def coded_with_pull(self, scene: Gaussians, world_to_camera: Tensor, mask_set: MaskSet) -> tuple[Image, Pull]:
        """Render a sum of views, [V, 4, 4], of a scene that stands still under another mask set, [H, W, 3]."""
        there = world_to_camera.to(scene.means.device)
        return coded_with_pull(self._backend, scene, there, self.intrinsics, mask_set)

    def _to_channels(self, image: Image) -> Image:
        """Return a colour image, [H, W, 3], as the sensor sees it, [H, W, C]."""
        given = torch.as_tensor(image)
        if self._channels is not None:
            return as_image(coding.select(given, self._channels.to(given.device)))
        return as_image(given.mean(dim=2, keepdim=True)) if self._mono else image

    def _to_colours(self, gradient: Image) -> Image:
        """Return the gradient by a colour image, [H, W, 3], from that by the sensor's image, [H, W, C]."""
        given = torch.as_tensor(gradient)
        if self._channels is not None:
            spread = given.new_zeros(*given.shape[:2], 3)
            return as_image(spread.scatter_(2, self._channels[..., None].to(given.device), given))
        return as_image((given / 3).repeat(1, 1, 3)) if self._mono else gradient

    def code(self, masks: Tensor) -> MaskSet:
        """Prepare another mask set, [V, H, W]."""
        return self._backend.code(masks, self._sampling)

    def views(self, scene: Gaussians, world_to_camera: Tensor, times: Tensor | None = None) -> F32:
        """Render views from any poses [V, 4, 4]: [V, H, W, C] float32, not clamped; C is 1 for a mono shot.

        `times`, [V], are when a moving scene is seen; None: one pose for each mask, at its time.
        """
        with torch.no_grad():
            images, _ = self.images(scene, world_to_camera, times=times)
        return (images.mean(dim=3, keepdim=True) if self._mono else images).cpu().numpy()

    def exposed(self, scene: Gaussians, world_to_camera: Tensor) -> F32:
        """Render what each mask saw while it was displayed, the mean of its moments: [N, H, W, C], as `views`.

        The measurement codes these; `views` show the middle of each mask's time.
        """
        if self._one_picture:
            return np.repeat(self.views(scene, world_to_camera[:1]), len(world_to_camera), axis=0)
        if self._mask_moments is None:
            return self.views(scene, world_to_camera)
        poses, times, _ = self._moments(world_to_camera)
        found = np.zeros((*self.transmissions.shape, 1 if self._mono else 3), np.float32)
        for mask, number in enumerate(self._mask_moments.of_mask.tolist()):
            one = self.views(scene, poses[mask : mask + 1], times[mask : mask + 1])
            found[number] += one[0] / self._mask_moments.moments[number]
        return found

    def _moments(self, world_to_camera: Tensor) -> tuple[Tensor, Tensor, MomentsOfPath | None]:
        """Return the poses and times of all moments, or of the one picture, and how masks' poses lead to them."""
        if self._one_picture:
            return world_to_camera[:1], self.times[:1], None
        if self._mask_moments is None:
            return world_to_camera, self.times, None
        along = self._mask_moments.along(world_to_camera)
        return torch.from_numpy(along.poses), self._mask_moments.times, along

    def images(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        colours: Tensor | None = None,
        times: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Render images [V, H, W, 3] and alphas [V, H, W] from any poses [V, 4, 4]; differentiable.

        `colours`, [V, G, 3], replace the scene's own if given; `times` as for `views`.
        """
        when = self._when(scene, times)
        return self._backend.views(
            scene,
            world_to_camera.to(scene.means.device),
            self.intrinsics,
            self.size,
            colours,
            self._sampling,
            times=when,
        )

    def _when(self, scene: Gaussians, times: Tensor | None) -> Tensor | None:
        return self.times if times is None and scene.motion is not None else times

    def stopped_light(
        self, scene: Gaussians, world_to_camera: F64, times: Tensor | None = None, *, some: bool = False
    ) -> StoppedLight:
        """Find at which depths the light of each pixel is stopped, from any poses [V, 4, 4]; `times` as for `views`.

        `some`: of one pixel in 16, for the range of depth.
        """
        scene, sampling = scene.detach(), self._here_and_there if some else self._sampling
        size = self.size if sampling is None else sampling.size
        poses = torch.from_numpy(np.asarray(world_to_camera)).float().to(scene.means.device)
        when = self._when(scene, times)
        return self._backend.depths(scene, poses, self.intrinsics, size, sampling, times=when)

    def depths(self, scene: Gaussians, world_to_camera: F64) -> F32:
        """Render depths along the optical axis, [V, H, W]; zero at pixels where less than half of the light stops."""
        return self.stopped_light(scene, world_to_camera).surface().cpu().numpy()

    @cached_property
    def _here_and_there(self) -> CanvasSampling:
        """Get where squares of pixels look, apart from each other."""
        rows, columns = (np.flatnonzero(np.arange(n) // _SQUARE_PX % _ONE_SQUARE_IN == 0) for n in self.size)
        whole = self._sampling or CanvasSampling(pixel_centres(self.size), (0, 0), self.size)
        return replace(whole, places=np.ascontiguousarray(whole.places[np.ix_(rows, columns)]))
