"""A photograph with measured disparity as a Gaussian scene that a camera can move in.

Here: the construction of a scene from picture and disparity, and the Middlebury motorcycle of scikit-image. Not here:
the filling of holes and hidden surfaces (`layers`), the conversion of surfaces to Gaussians (`surfels`).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from skimage import data

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci.core.records import check_intrinsics
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.layers import Layer, clean_rims, fill_holes, hidden_layer, without_flying_pixels
from gs2ci_sims.scenes.surfels import Surfels, from_inverse_depth, gaussians_from_surfels, join

# A step of one pixel of disparity between neighbours is a depth edge: the two separate by one pixel when the
# camera moves by the whole stereo baseline.
JUMP_PX: Final = 1.0
# The hidden surfaces extend as far as a camera sees that moves by half the stereo baseline to either side.
REACH: Final = 0.5
# Share of the frame outside the suggested camera's image on each side, which the camera sees when it moves.
MARGIN: Final = 0.06


@dataclass(frozen=True)
class DisparityPhoto:
    """A rectified photograph with the disparity of every pixel.

    Args:
        name: Name for reports.
        colour: [H, W, 3] in [0, 1].
        disparity_px: Offset to the second camera's image, [H, W], in pixels; not finite for unmeasured pixels.
        intrinsics: [3, 3], pixel centres at +0.5.
        baseline_m: Distance between the cameras.
        principal_offset_px: Second camera's principal point minus the first's, along x (Middlebury's doffs).
    """

    name: str
    colour: F64
    disparity_px: F64
    intrinsics: F64
    baseline_m: float
    principal_offset_px: float = 0.0

    def __post_init__(self) -> None:
        check_intrinsics(self.intrinsics)
        if self.colour.shape != (*self.disparity_px.shape, 3):
            raise InputError(
                f"photograph {self.name!r}: colour {self.colour.shape}, disparity {self.disparity_px.shape}",
                allowed="[H, W, 3] and [H, W]",
            )
        if not np.isfinite(self.colour).all() or self.colour.min() < 0 or self.colour.max() > 1:
            raise InputError(f"photograph {self.name!r} has colours outside [0, 1]", remedy="divide by full scale")
        measured = self.disparity_px[np.isfinite(self.disparity_px)]
        if self.baseline_m <= 0 or not len(measured) or measured.min() + self.principal_offset_px <= 0:
            raise InputError(
                f"photograph {self.name!r}: its disparities on a baseline of {self.baseline_m} m give no depth",
                allowed="a positive baseline, and disparity + principal_offset_px > 0 wherever it is finite",
            )

    def inverse_depth(self, disparity_px: F64) -> F64:
        """Turn disparity into inverse depth, 1/m: (d + offset) / (baseline x focal length).

        Scharstein et al., GCPR 2014; Middlebury's calibration files.
        """
        return (disparity_px + self.principal_offset_px) / (self.baseline_m * self.intrinsics[0, 0])


def motorcycle_photo() -> DisparityPhoto:
    """Load the Middlebury 2014 motorcycle at a quarter of its size, as scikit-image ships it (500 x 741).

    Camera, baseline and principal offset are those documented at `skimage.data.stereo_motorcycle`. Middlebury counts
    from the first pixel's centre at full size, and scikit-image divided by 4: (4 c + 0.5) / 4 = c + 0.125 in our
    coordinates.
    """
    left, _, disparity = data.stereo_motorcycle()
    return DisparityPhoto(
        name="motorcycle",
        colour=left / 255.0,
        disparity_px=disparity.astype(np.float64),
        intrinsics=np.array([[994.978, 0.0, 311.193 + 0.125], [0.0, 994.978, 254.877 + 0.125], [0.0, 0.0, 1.0]]),
        baseline_m=0.193001,
        principal_offset_px=31.086,
    )


def motorcycle(size: tuple[int, int] = (272, 400)) -> Scene:
    """Build the motorcycle scene for a camera of the given image size."""
    return seen_at(size, *_motorcycle())


@lru_cache(maxsize=1)
def _motorcycle() -> tuple[DisparityPhoto, Surfels, F64]:
    # Benches and tables build this scene many times in several sizes, which differ in the camera alone.
    return completed(motorcycle_photo())


def completed(photo: DisparityPhoto) -> tuple[DisparityPhoto, Surfels, F64]:
    """Fill a photograph's holes and hidden surfaces; return it, its surfels and the front surface's disparity, px."""
    measured = without_flying_pixels(photo.disparity_px, JUMP_PX)
    disparity = fill_holes(measured, photo.colour, JUMP_PX)
    front = clean_rims(Layer(disparity, photo.colour, np.ones(disparity.shape, dtype=bool)), JUMP_PX)
    hidden = hidden_layer(front, JUMP_PX, REACH)
    jump = JUMP_PX / (photo.baseline_m * photo.intrinsics[0, 0])
    surfels = [
        from_inverse_depth(photo.inverse_depth(layer.disparity), layer.colour, layer.present, photo.intrinsics, tear)
        for layer, tear in ((front, jump), (hidden, np.inf))
    ]
    return photo, join(surfels), disparity


def seen_at(size: tuple[int, int], photo: DisparityPhoto, surfels: Surfels, disparity: F64) -> Scene:
    """Place the suggested camera in front of surfels."""
    intrinsics = _framed(photo.intrinsics, (disparity.shape[0], disparity.shape[1]), size)
    depth = 1.0 / photo.inverse_depth(_sampled(disparity, photo.intrinsics, intrinsics, size))
    return Scene(photo.name, gaussians_from_surfels(surfels), intrinsics, size, depth)


def _framed(intrinsics: F64, full: tuple[int, int], size: tuple[int, int]) -> F64:
    """Scale the camera so that an image of `size` shows the full frame less a margin on all sides."""
    scale = max(small / ((1 - 2 * MARGIN) * large) for small, large in zip(size, full, strict=True))
    framed = intrinsics.copy()
    framed[:2] *= scale
    framed[0, 2] -= 0.5 * (scale * full[1] - size[1])
    framed[1, 2] -= 0.5 * (scale * full[0] - size[0])
    return framed


def _sampled(values: F64, source: F64, target: F64, size: tuple[int, int]) -> F64:
    """Get the source camera's value nearest to each target pixel, for cameras that differ in intrinsics only."""
    index = []
    for axis, count in ((1, size[0]), (0, size[1])):
        slopes = (np.arange(count) + 0.5 - target[axis, 2]) / target[axis, axis]
        position = np.floor(slopes * source[axis, axis] + source[axis, 2]).astype(int)
        index.append(np.clip(position, 0, values.shape[1 - axis] - 1))
    return np.asarray(values[np.ix_(index[0], index[1])])
