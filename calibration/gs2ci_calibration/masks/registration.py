"""Registration: the place on the modulator that each sensor pixel sees, to a few thousandths of a pixel.

Stripes of a Gray code give a first map, for any flips, rotations and pixel ratios (`gray_code`). A textured pattern
refines it: the image predicted through the map is compared with the measured one tile by tile, and the map (affine,
then of a higher degree if the tiles require it) and the relay's blur are adjusted until the two agree.
Here: that fit and its standard errors. Not here: taking the frames (`registration_step`), predicting masks
(`predicted`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gs2ci.core.arrays import F64, Bool
from gs2ci_calibration.masks.imaging import PixelMap
from gs2ci_calibration.masks.registration_fit import Fitted, Textures, fit
from gs2ci_calibration.refusals import CalibrationError, Reason

DEGREES: Final = (1, 3, 5)
"""Degrees of the map: affine first; a cubic and a quintic only if the tiles clearly show that they are needed."""
RATIO_TOLERANCE: Final = 0.03
"""Largest relative difference of the pixel ratio from the rig file's: it displaces masks by two pixels at a distance of
64 px from the middle."""
SHIFTS_PER_COEFFICIENT: Final = 1.5
"""Fewest tile shifts for each coefficient: with fewer, a map of higher degree is undetermined near the border."""
BEND_PROBABILITY: Final = 1e-3
"""Probability of taking an affine map for a bent one."""


@dataclass(frozen=True)
class Registration:
    """The map from sensor to modulator, with its errors.

    Args:
        pixels: The map.
        covariance: Covariance of its coefficients in the order u0, v0, u1, v1, ..., [2K, 2K], from the scatter between
            tiles.
        variance_px2: Variance of the relay's blur, in sensor pixels squared.
        variance_se_px2: Its standard error.
        residual_rms_px: Rms scatter of the tiles' own shifts around the map.
        tiles: How many tiles the fit uses.
        dropped: How many were left out because they do not show the pattern.
    """

    pixels: PixelMap
    covariance: F64
    variance_px2: float
    variance_se_px2: float
    residual_rms_px: float
    tiles: int
    dropped: int

    @property
    def sigma_px(self) -> float:
        """Get the standard deviation of the relay's blur, in sensor pixels."""
        return float(np.sqrt(max(self.variance_px2, 0.0)))

    @property
    def coefficient_se(self) -> F64:
        """Get the standard errors of the map's coefficients, [K, 2] modulator pixels."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 2)

    @property
    def rms_se_px(self) -> float:
        """Get the standard error of the map, rms over the sensor, in sensor pixels."""
        y, x = np.mgrid[: self.pixels.size[0] : 8, : self.pixels.size[1] : 8] + 0.5
        basis = self.pixels.basis(x, y).reshape(-1, len(self.pixels.coefficients))
        second = basis.T @ basis / len(basis)
        square = sum(float(np.sum(second * self.covariance[axis::2, axis::2])) for axis in (0, 1))
        return float(np.sqrt(square) / np.mean(self.pixels.ratio))

    @property
    def orientation(self) -> str:
        """Get how the modulator's image lies on the sensor, in words."""
        return orientation(self.pixels)

    @property
    def turn_mrad(self) -> float:
        """Get the rotation of the image beyond its orientation, clockwise on the sensor."""
        linear = self.pixels.modulator_from_sensor[:, :2]
        square = np.rint(linear / np.abs(linear).max())
        if abs(np.linalg.det(square)) < 0.5:  # rotated by nearly 45 degrees: no multiple of 90 degrees is near
            square = np.eye(2)
        small = np.linalg.inv(square) @ linear
        return float(1e3 * np.arctan2(small[0, 1] - small[1, 0], small[0, 0] + small[1, 1]))

    def bend_px(self) -> float:
        """Return the difference between the map and its affine part, rms over the sensor, sensor pixels."""
        if self.pixels.degree == 1:
            return 0.0
        u, v = self.pixels.everywhere()
        y, x = np.mgrid[: self.pixels.size[0], : self.pixels.size[1]] + 0.5
        basis = PixelMap(self.pixels.size, np.zeros((3, 2))).basis(x, y).reshape(-1, 3)
        both = np.column_stack([u.ravel(), v.ravel()])
        straight, *_ = np.linalg.lstsq(basis, both, rcond=None)
        rest = np.square(both - basis @ straight).sum(axis=1).mean()
        return float(np.sqrt(rest) / np.mean(self.pixels.ratio))


_ORIENTATIONS: Final = {
    ((1, 0), (0, 1)): "upright",
    ((-1, 0), (0, 1)): "mirrored left to right",
    ((1, 0), (0, -1)): "mirrored top to bottom",
    ((-1, 0), (0, -1)): "upside down",
    ((0, 1), (1, 0)): "mirrored along its diagonal",
    ((0, -1), (-1, 0)): "mirrored along its other diagonal",
    ((0, 1), (-1, 0)): "turned clockwise",
    ((0, -1), (1, 0)): "turned anticlockwise",
}


def orientation(pixels: PixelMap) -> str:
    """Return the orientation of the modulator's image on the sensor: upright, mirrored, rotated, in words."""
    linear = pixels.modulator_from_sensor[:, :2]
    square = np.rint(linear / np.abs(linear).max()).astype(int)
    key = ((int(square[0, 0]), int(square[0, 1])), (int(square[1, 0]), int(square[1, 1])))
    return _ORIENTATIONS.get(key, "turned by nearly 45 degrees")


def require_orientation(pixels: PixelMap, wanted: str) -> None:
    """Compare the orientation of the modulator's image with the required one, in words; "any" accepts all.

    Raises:
        CalibrationError: It has another orientation.
    """
    found = orientation(pixels)
    if wanted not in (found, "any"):
        raise CalibrationError(
            "registration",
            Reason.FLIPPED,
            f"the modulator's image is {found}; by the rig file it is {wanted}",
            remedy="turn the modulator or its image back; if this is how the bench is built, say so as orientation in "
            "[calibration]",
        )


def require_ratio(pixels: PixelMap, superpixel: int) -> None:
    """Compare the pixel ratio with the rig file's.

    Raises:
        CalibrationError: It differs.
    """
    for axis, ratio in zip(("columns", "rows"), pixels.ratio, strict=True):
        if abs(ratio / superpixel - 1) > RATIO_TOLERANCE:
            raise CalibrationError(
                "registration",
                Reason.NOT_REGISTERED,
                f"one sensor pixel spans {ratio:.3f} modulator {axis}; by the rig file {superpixel}",
                allowed=f"within {RATIO_TOLERANCE:.0%}",
                remedy="set superpixel in [registration], or change the relay's magnification",
            )


def register(
    patterns: Sequence[NDArray[Any]] | NDArray[Any],
    shares: Sequence[F64],
    valid: Bool,
    coarse: PixelMap,
    *,
    light: F64 | None = None,
    degree: int | None = None,
) -> Registration:
    """Refine a map until predicted and measured images of textured patterns agree.

    Args:
        patterns: The patterns shown, each [Hm, Wm] in [0, 1] (`checker`, a random mask).
        shares: The image of each, (frame - off) / (on - off), [H, W].
        valid: Pixels that can be trusted, [H, W].
        coarse: A map that is accurate to about half a square of the pattern.
        light: Brightness of the field, [H, W]; None for an even field.
        degree: Degree of the map; None chooses it by the tiles.

    Raises:
        CalibrationError: Too few tiles show the pattern, they lie on one line, the pattern is another one or
            inverted, or the fit does not converge.
    """
    textures = Textures(patterns, shares, valid, light)
    fitted = fit(textures, coarse)
    if degree is None:
        fitted = _as_bent_as_needed(textures, fitted)
    elif degree > fitted.pixels.degree:
        fitted = fit(textures, fitted.pixels.raised(degree), fitted.variance_px2)
    return Registration(
        pixels=fitted.pixels,
        covariance=fitted.covariance(),
        variance_px2=fitted.variance_px2,
        variance_se_px2=fitted.variance_se(),
        residual_rms_px=fitted.scatter_px(),
        tiles=int(fitted.kept.sum()),
        dropped=fitted.dropped,
    )


def _as_bent_as_needed(textures: Textures, fitted: Fitted) -> Fitted:
    """Raise the map's degree as long as the tiles require it and determine it."""
    for higher in DEGREES[DEGREES.index(fitted.pixels.degree) + 1 :]:
        raised = fitted.pixels.raised(higher)
        if 2 * fitted.kept.sum() < SHIFTS_PER_COEFFICIENT * raised.coefficients.size:
            break
        try:
            bent = fit(textures, raised, fitted.variance_px2)
        except CalibrationError:  # these tiles do not determine a map of this degree: the one before is kept
            break
        if not _is_bent(fitted, bent):
            break
        fitted = bent
    return fitted


def _is_bent(straight: Fitted, bent: Fitted) -> bool:
    """Return whether the tiles' shifts need the higher degree, by an F test."""
    common = straight.kept & bent.kept
    more = 2 * (len(bent.pixels.coefficients) - len(straight.pixels.coefficients))
    rest = 2 * int(common.sum()) - 2 * len(bent.pixels.coefficients)
    if rest <= more:
        return False
    unexplained = float(bent.misfit[common].sum())
    gained = float(straight.misfit[common].sum()) - unexplained
    return gained / more > stats.f.isf(BEND_PROBABILITY, more, rest) * unexplained / rest
