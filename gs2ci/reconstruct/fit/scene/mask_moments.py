"""Motion of the camera while one mask is displayed: each mask gets as many moments as the motion requires.

A mask is displayed for some time, and transmits the mean of what the camera sees meanwhile. If detail moves by a large
part of a pixel in that time, a fit with one pose for each mask explains the measurement by a blurred scene. Here a mask
is the mean of K views along a continuous path: between neighbouring poses the twist is quadratic in time (exact for
steady and evenly accelerated motion). K follows from a bound on the blur, and is one for every mask if the blur is
negligible. The fit gets no further parameters; motion quicker than the masks' (a vibration of several periods within
one) is not modelled.

Here: when masks are open, their moments and poses, the bound. Not here: rendering (`rendering.py`), the record of it
(`record`).
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Final, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, PositiveInt
from torch import Tensor

from gs2ci.core.arrays import F32, F64, rms_of
from gs2ci.core.bounds import Bounded
from gs2ci.core.cameras import in_world
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.records import Shot
from gs2ci.core.run_figures import MaskMomentsSection
from gs2ci.reconstruct.choices import WithinMask
from gs2ci.reconstruct.fit.scene.rigid import MomentsOfPath
from gs2ci.reconstruct.geometry.depth.view_depths import project
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.motion import rays

# Motion is measured at one in so many pixels of the middle view, along rows and columns.
_STRIDE_PX: Final = 3
# If the image moves by more than this share of its shorter side while one mask is displayed, neighbouring views share
# too little for any path to be estimated from them: such a path is an error, and one pose for each mask does less harm.
_FARTHEST: Final = 0.5
# A mean over d px removes the frequency 1 / d, which pictures hold from 2 px on: moments recover only part of such
# detail along the motion. 2.9 px cost 2.5 to 3.0 dB, 5.6 px 4.4 (`python -m tests.stability --only motion:`).
_BLURS_PX: Final = 2.0


def mask_times(views: int) -> Tensor:
    """Return when each of so many masks was open, [N] float32: from −1, the first, to 1, the last, evenly.

    One mask alone is open at 0.
    """
    return torch.linspace(-1, 1, views) if views > 1 else torch.zeros(views)


@dataclass(frozen=True)
class MaskMomentSettings(Bounded):
    """How many moments a mask gets.

    Args:
        within_mask: "still": one pose for each mask, for a camera that stands still during each mask, or a measurement
            coded in software from still pictures; "moving": the camera moves on, and masks get the moments that they
            need; None: as the shot states, and "still" if it states nothing. The readings tell the two apart only if
            the motion is large (docs/decisions/sub-exposure-samples.md), so this is not guessed.
        tolerance: Largest blur of a view by motion within a mask, in full scales, root mean square over its pixels
            (`bounds`).
        most: Most moments of one mask.
    """

    within_mask: WithinMask | None = None
    tolerance: Annotated[float, Field(gt=0)] = 0.01
    most: PositiveInt = 8

    def of(self, shot: Shot) -> "MaskMomentSettings":
        """Return the settings for a shot, which may state whether the camera moves while a mask is displayed.

        Raises:
            InputError: It states something else.
        """
        return replace(self, within_mask=self.within_mask or stated_within_mask(shot) or "still")


def stated_within_mask(shot: Shot) -> WithinMask | None:
    """Get whether the camera moves while a mask is displayed, as a shot's provenance states it; None if it does not.

    Captures state it by the stage's program, simulated exposures by how they were sampled.

    Returns:
        `provenance["within_mask"]`.

    Raises:
        InputError: It is neither "still" nor "moving".
    """
    stated = shot.provenance.get("within_mask")
    if stated is None or stated in get_args(WithinMask):
        return stated
    raise InputError(
        f"{shot.name} states for the camera's motion while a mask is shown: within_mask = {stated!r}",
        allowed='"still", "moving", or nothing',
        remedy="correct the shot's provenance, or give `gs2ci reconstruct --within-mask`",
    )


@dataclass(frozen=True)
class MaskMoments:
    """The moments of each mask.

    Args:
        moments: How many, [N], each at least 1.
        open_share: Share of its interval for which each mask is displayed, evenly about its middle, [N].
        motion_px: How far the image moves meanwhile, root mean square, [N].
        bounds: Upper bound on the blur of each view with one pose, in full scales, [N].
    """

    moments: tuple[int, ...]
    open_share: tuple[float, ...]
    motion_px: tuple[float, ...] = ()
    bounds: tuple[float, ...] = ()

    @property
    def count(self) -> int:
        """Get the number of moments of all masks, V."""
        return sum(self.moments)

    @property
    def per_mask(self) -> float:
        """Get how many moments a mask has on average."""
        return self.count / len(self.moments)

    @cached_property
    def offsets(self) -> Tensor:
        """Get the time of each moment, from the middle of its mask, in intervals between masks, [V] float64.

        A mask's moments are the middles of equal parts of the time for which it is displayed.
        """
        return torch.tensor(
            [
                share * ((part + 0.5) / count - 0.5)
                for count, share in zip(self.moments, self.open_share, strict=True)
                for part in range(count)
            ],
            dtype=torch.float64,
        )

    @cached_property
    def of_mask(self) -> Tensor:
        """Get the mask to which each moment belongs, [V]."""
        return torch.repeat_interleave(torch.arange(len(self.moments)), torch.tensor(self.moments))

    @cached_property
    def times(self) -> Tensor:
        """Get the time of each moment in the unit of the scene's motion, [V] float32 (`mask_times`)."""
        times = mask_times(len(self.moments))
        between = float(times[1] - times[0]) if len(times) > 1 else 0.0
        return times[self.of_mask] + between * self.offsets.float()

    def split(self, transmissions: Tensor) -> Tensor:
        """Share each mask's light, [N, H, W], among its moments, [V, H, W]."""
        shares = 1 / torch.tensor(self.moments, dtype=transmissions.dtype)
        return (transmissions * shares[:, None, None])[self.of_mask]

    def along(self, world_to_camera: Tensor) -> MomentsOfPath:
        """Return the poses at every moment, with their gradient, from those in the middle of each mask, [N, 4, 4]."""
        here = self.of_mask.numpy()
        alone = np.asarray(self.moments)[here] == 1
        return MomentsOfPath(world_to_camera.detach().numpy(), self.offsets.numpy(), here, alone)

    @property
    def note(self) -> Finding:
        """Get the finding about the moments."""
        motion_px = max(self.motion_px, default=0.0)
        code = Code.MASKS_BLUR if motion_px >= _BLURS_PX else Code.MASKS_HAVE_MOMENTS
        return finding(code, motion_px=motion_px, most=max(self.moments))

    def summary(self) -> MaskMomentsSection:
        """Return the figures for the report."""
        return MaskMomentsSection(list(self.moments), list(self.motion_px), list(self.bounds))


def needed(geometry: Geometry, views: F32, open_share: F64, settings: MaskMomentSettings) -> MaskMoments | None:
    """Return the moments that a path requires; None if one for each mask is enough.

    Args:
        geometry: First path and depth.
        views: Decoded, of the size of the geometry's depth, [N, H, W, C]: the gradients of the middle one are used.
        open_share: Share of its interval for which each mask is displayed, [N].
        settings: What is tolerated; unless they say that the camera moves, one moment is enough.
    """
    path = geometry.world_to_camera
    if len(path) < 2 or settings.within_mask != "moving":
        return None
    motion, found = bounds(geometry, path, views[geometry.reference], open_share)
    if motion.max() > _FARTHEST * min(geometry.inverse_depth.shape):
        return None
    moments = tuple(int(min(max(math.ceil(one / settings.tolerance), 1), settings.most)) for one in found)
    if max(moments) == 1:
        return None
    return MaskMoments(moments, tuple(open_share.tolist()), tuple(motion.tolist()), tuple(found.tolist()))


def motion_px(geometry: Geometry, world_to_camera: F64, open_share: F64) -> F64:
    """Return how far the image moves while each mask is displayed, the median over its pixels, [N, 2] as (x, y) px.

    Args:
        geometry: Depth of the middle view.
        world_to_camera: The path, [N, 4, 4], N at least 2.
        open_share: As for `needed`, [N].
    """
    _, _, within = _within_masks(geometry, world_to_camera, open_share)
    shown = [moved[np.isfinite(moved).all(axis=1)] for moved in within]
    return np.stack([np.median(moved, axis=0) if len(moved) else np.zeros(2) for moved in shown])


def bounds(geometry: Geometry, world_to_camera: F64, view: F32, open_share: F64) -> tuple[F64, F64]:
    """Bound the blur by motion within each mask, root mean square over the pixels.

    A pixel's light is the mean over the time for which the mask is displayed. If the image moves by d across a slope of
    g per pixel, this mean differs from the value in the middle by the mean of |offset| g = d g / 4 at most (a ramp
    averages out, the two sides of an edge do not). With K moments the bound is K times smaller.

    Args:
        geometry: Depth of the middle view.
        world_to_camera: The path, [N, 4, 4].
        view: The middle view, [H, W, C].
        open_share: As for `needed`, [N].

    Returns:
        How far the image moves within each mask, root mean square in px, [N]; and the bounds in full scales, [N].
    """
    rows, columns, within = _within_masks(geometry, world_to_camera, open_share)
    across, down = (np.gradient(view.astype(np.float64), axis=axis)[rows, columns] for axis in (1, 0))
    slopes = np.stack([across, down], axis=-1)  # [P, C, (x, y)]
    motion, found = [], []
    for moved in within:
        shown = np.isfinite(moved).all(axis=1)
        motion.append(_rms(moved[shown]) * math.sqrt(2))
        # The mean of |offset| over an interval of length d about its middle is d / 4.
        found.append(_rms((slopes[shown] * moved[shown, None]).sum(axis=-1)) / 4)
    return np.array(motion), np.array(found)


def _within_masks(
    geometry: Geometry, world_to_camera: F64, open_share: F64
) -> tuple[NDArray[np.intp], NDArray[np.intp], list[F64]]:
    """Return rows and columns of some pixels, [P], and their motion in each mask, [P, 2] px; NaN behind a camera."""
    height, width = geometry.inverse_depth.shape
    rows, columns = np.mgrid[1 : height - 1 : _STRIDE_PX, 1 : width - 1 : _STRIDE_PX].reshape(2, -1)
    directions = rays(np.stack([columns, rows], axis=1) + 0.5, geometry.intrinsics)
    in_middle = directions / geometry.inverse_depth[rows, columns].astype(np.float64)[:, None]
    points = in_world(in_middle, world_to_camera[geometry.reference])
    masks, half = np.arange(len(world_to_camera)), np.asarray(open_share, np.float64) / 2
    first, last = (MomentsOfPath(world_to_camera, at, masks, masks < 0).exact for at in (-half, half))
    seen = ([project(points, pose, geometry.intrinsics)[0] for pose in poses] for poses in (first, last))
    return rows, columns, [after - before for before, after in zip(*seen, strict=True)]


def _rms(values: F64) -> float:
    return rms_of(values) if values.size else 0.0
