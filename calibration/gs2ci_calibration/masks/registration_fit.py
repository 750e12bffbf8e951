"""The fit behind a registration: Gauss-Newton on images, gathered in tiles.

Every tile of the sensor gives the shift between predicted and measured image there, and its precision: a gradient and a
2 x 2 information matrix. The map's polynomial is fitted to these; its errors follow from the scatter between tiles,
which includes all that the noise of single pixels does not (leakage, dust, a blur that is not Gaussian).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import laplace

from gs2ci.core.arrays import F64, Bool
from gs2ci_calibration.masks.imaging import PixelMap, blurred, monomials, sharp
from gs2ci_calibration.refusals import CalibrationError, Reason

ITERATIONS_MAX: Final = 30
CONVERGED_PX: Final = 2e-5
# The squared residuals have kinks where pixels' edges meet mirrors' edges: there the steps may oscillate. From this
# iteration on steps are halved each time, so that they converge in between; an oscillation of this size is harmless.
HALVED_FROM: Final = 10
SWING_PX: Final = 1e-3
# Beyond this, a step says more about the pattern's edges than about the map.
STEP_MAX_PX: Final = 1.0
# A tile whose misfit exceeds the median by this factor does not show the pattern: dust, a hair.
OUTLYING: Final = 25.0
SETTLING: Final = 4
TILES_MIN: Final = 12
LIGHT_DEGREE: Final = 4
LIGHT_PIXELS: Final = 20_000
# Where the field is darker than this share of its mean, its slope cannot be separated from noise.
LIGHT_MIN: Final = 0.05
TILE_PX: Final = (12, 32)
VARIANCE_START_PX2: Final = 0.5
VARIANCE_MAX_PX2: Final = 25.0
# Share of a tile's pixels that must be valid, and texture (mean square slope, per sensor pixel) that it must show.
TILE_VALID_MIN: Final = 0.5
TEXTURE_MIN: Final = 1e-4
# Scale of the measured pattern relative to the predicted one below which it is another pattern.
LIKENESS_MIN: Final = 0.5


class Textures:
    """The measured images, cut into tiles.

    Args:
        patterns: The patterns shown, each [Hm, Wm] in [0, 1].
        shares: The image of each, [H, W].
        valid: Pixels that can be trusted, [H, W].
        light: Brightness of the field, [H, W]; None for an even field. The relay's blur displaces every pixel's place
            towards brighter light, by its variance times the light's relative slope: some thousandths of a pixel.
    """

    def __init__(
        self,
        patterns: Sequence[NDArray[Any]] | NDArray[Any],
        shares: Sequence[F64],
        valid: Bool,
        light: F64 | None = None,
    ) -> None:
        self.patterns = [np.ascontiguousarray(pattern, dtype=np.float32) for pattern in patterns]
        self.shares = [np.where(valid, share, 0.0) for share in shares]
        self.valid = valid.astype(np.float64)
        self.light = np.ones(valid.shape) if light is None else _smooth(light, valid)
        side = int(np.clip(min(valid.shape) // 10, *TILE_PX))
        self._rows, self._columns = (np.arange(0, length, side) for length in valid.shape)
        self.filled = self.sums(self.valid) / self.sums(np.ones(valid.shape))
        y, x = np.mgrid[: valid.shape[0], : valid.shape[1]] + 0.5
        count = self.sums(np.ones(valid.shape))
        self.x, self.y = self.sums(x) / count, self.sums(y) / count

    def sums(self, image: F64) -> F64:
        """Add an image up within each tile, [T]."""
        down = np.add.reduceat(image, self._rows, axis=0)
        return np.asarray(np.add.reduceat(down, self._columns, axis=1)).ravel()


def _smooth(light: F64, valid: Bool) -> F64:
    """Return the smooth part of the field by a polynomial, without single pixels' response; its mean is 1."""
    height, width = light.shape
    y, x = np.mgrid[:height, :width]
    basis = monomials(2 * x / width - 1, 2 * y / height - 1, LIGHT_DEGREE)
    chosen = np.random.default_rng(0).permutation(np.flatnonzero(valid))[:LIGHT_PIXELS]
    found, *_ = np.linalg.lstsq(basis.reshape(light.size, -1)[chosen], light.ravel()[chosen], rcond=None)
    smooth = basis @ found
    return np.maximum(smooth, LIGHT_MIN * smooth.mean()) / smooth.mean()


@dataclass(frozen=True)
class Fitted:
    """A state of the fit, with the tiles' gradients and information.

    Args:
        pixels: The map.
        variance_px2: Variance of the relay's blur.
        scale: Scale of the measured image relative to the predicted one.
        offset: Offset of the measured image.
        basis: Monomials at the tiles' middles, [T, K].
        information: Information about each tile's shift, [T, 2, 2], per modulator pixel squared.
        gradient: Gradient of each tile's squared residuals by its shift, [T, 2].
        light_information: Information about variance, scale and offset, [3, 3].
        light_gradient: Gradient by these for each tile, [T, 3].
        kept: Tiles that are used, [T].
        dropped: How many tiles do not show the pattern.
    """

    pixels: PixelMap
    variance_px2: float
    scale: float
    offset: float
    basis: F64
    information: F64
    gradient: F64
    light_information: F64
    light_gradient: F64
    kept: Bool
    dropped: int

    @property
    def misfit(self) -> F64:
        """Get the reduction of each tile's squared residuals if it is shifted on its own, [T]."""
        return np.einsum("ti,ti->t", self.gradient, self.shifts)

    @property
    def shifts(self) -> F64:
        """Get each tile's own shift from the map, [T, 2] modulator pixels; 0 for tiles without texture."""
        ready = self.kept[:, None, None]
        solved = np.linalg.solve(np.where(ready, self.information, np.eye(2)), self.gradient[..., None])[..., 0]
        return np.where(self.kept[:, None], solved, 0.0)

    def scatter_px(self) -> float:
        """Return the rms of the tiles' own shifts, in sensor pixels."""
        square = np.square(self.shifts[self.kept]).sum(axis=1).mean()
        return float(np.sqrt(square) / np.mean(self.pixels.ratio))

    def normal(self) -> F64:
        """Return the information about the map's coefficients, [2K, 2K]."""
        basis, info = self.basis[self.kept], self.information[self.kept]
        return np.asarray(np.einsum("tk,tij,tl->kilj", basis, info, basis)).reshape(2 * basis.shape[1], -1)

    def step(self) -> F64:
        """Return the Gauss-Newton step of the coefficients, [K, 2]."""
        right = np.einsum("tk,ti->ki", self.basis[self.kept], self.gradient[self.kept]).ravel()
        return np.asarray(np.linalg.solve(self.normal(), right)).reshape(-1, 2)

    def light_step(self) -> F64:
        """Return the step of variance, scale and offset, [3]."""
        return np.linalg.solve(self.light_information, self.light_gradient[self.kept].sum(axis=0))

    def covariance(self) -> F64:
        """Return the covariance of the coefficients from the scatter between tiles, [2K, 2K].

        The sandwich of White (Econometrica 48 (1980) 817) with tiles as clusters, each gradient raised by its
        leverage as in MacKinnon and White's HC3 (J. Econometrics 29 (1985) 305).
        """
        inverse = np.linalg.inv(self.normal())
        basis, info = self.basis[self.kept], self.information[self.kept]
        by_tile = np.einsum("tk,ij->tikj", basis, np.eye(2)).reshape(len(basis), 2, -1)
        hat = np.einsum("tip,pq,tjq,tjk->tik", by_tile, inverse, by_tile, info, optimize=True)
        left = np.eye(2) - np.transpose(hat, (0, 2, 1))
        raised = np.linalg.solve(left, self.gradient[self.kept][..., None])[..., 0]
        scores = np.einsum("tip,ti->tp", by_tile, raised)
        return inverse @ (scores.T @ scores) @ inverse

    def variance_se(self) -> float:
        """Return the standard error of the variance."""
        inverse = np.linalg.inv(self.light_information)
        scores = self.light_gradient[self.kept]
        return float(np.sqrt((inverse @ (scores.T @ scores) @ inverse)[0, 0]))


def fit(textures: Textures, start: PixelMap, variance_px2: float = VARIANCE_START_PX2) -> Fitted:
    """Fit the map, the blur and the images' scale, from a map that is nearly right.

    Raises:
        CalibrationError: Too few tiles show the pattern, they lie on one line, the pattern is another one or
            inverted, or the fit does not settle.
    """
    pixels, variance, scale, offset = start, variance_px2, 1.0, 0.0
    dropped = np.zeros(len(textures.filled), bool)
    for iteration in range(ITERATIONS_MAX):
        state = _look(textures, pixels, variance, scale, offset, dropped)
        if iteration == SETTLING:
            dropped = _outlying(state)
            state = _look(textures, pixels, variance, scale, offset, dropped)
        step = state.step()
        moved_px = float(np.abs(step).max() / np.mean(pixels.ratio))
        light = state.light_step()
        if iteration > SETTLING and moved_px < CONVERGED_PX and abs(light[0]) < CONVERGED_PX:
            _require_likeness(state)
            return state
        share = 0.5 ** (max(iteration - HALVED_FROM, 0) / 2) * min(1.0, STEP_MAX_PX / max(moved_px, 1e-12))
        pixels = PixelMap(pixels.size, pixels.coefficients + share * step)
        # Blur and scale are fitted only once the images coincide; before, they would absorb the shift.
        if iteration >= 1:
            variance = float(np.clip(variance + np.clip(light[0], -0.5, 0.5), 0.0, VARIANCE_MAX_PX2))
            scale, offset = scale + float(light[1]), offset + float(light[2])
            if variance == 0.0 and light[0] < 0 and moved_px < CONVERGED_PX and iteration > SETTLING:
                _require_likeness(state)
                return state
    if moved_px < SWING_PX:
        _require_likeness(state)
        return state
    raise CalibrationError(
        "registration",
        Reason.NOT_REGISTERED,
        f"the map does not converge: after {ITERATIONS_MAX} steps it still moves by {moved_px:.3g} px",
        allowed=f"{CONVERGED_PX:g} px",
        remedy="hold the bench still, take more frames, or show squares of more pixels",
    )


def _look(textures: Textures, pixels: PixelMap, variance: float, scale: float, offset: float, dropped: Bool) -> Fitted:
    """Predict all images and compute the tiles' gradients and information."""
    tiles = len(textures.filled)
    information, gradient = np.zeros((tiles, 2, 2)), np.zeros((tiles, 2))
    light_information, light_gradient = np.zeros((tiles, 3, 3)), np.zeros((tiles, 3))
    light = textures.light
    blurred_light = blurred(light, variance)
    for pattern, share in zip(textures.patterns, textures.shares, strict=True):
        plain, *slopes = (blurred(image * light, variance) / blurred_light for image in sharp(pattern, pixels))
        residual = textures.valid * (share - scale * plain - offset)
        by_place = [textures.valid * scale * slope for slope in slopes]
        by_light = [textures.valid * image for image in (0.5 * scale * laplace(plain, mode="nearest"), plain)]
        by_light.append(textures.valid)
        for into, sums, columns in (
            (gradient, information, by_place),
            (light_gradient, light_information, by_light),
        ):
            for i, one in enumerate(columns):
                into[:, i] += textures.sums(one * residual)
                for j in range(i, len(columns)):
                    sums[:, i, j] += textures.sums(one * columns[j])
                    sums[:, j, i] = sums[:, i, j]
    textured = _is_textured(textures, information, float(np.mean(pixels.ratio)))
    kept = textured & ~dropped
    basis = pixels.basis(textures.x, textures.y)
    _require_tiles(textures, kept)
    _require_hold(basis[kept])
    return Fitted(
        pixels=pixels,
        variance_px2=variance,
        scale=scale,
        offset=offset,
        basis=basis,
        information=information,
        gradient=gradient,
        light_information=light_information[kept].sum(axis=0),
        light_gradient=light_gradient,
        kept=kept,
        dropped=int(np.sum(dropped & textured)),
    )


def _is_textured(textures: Textures, information: F64, ratio: float) -> Bool:
    """Return the tiles whose texture determines a shift in both directions, [T]."""
    pixels = np.maximum(textures.sums(textures.valid), 1.0) * len(textures.patterns)
    weakest = np.linalg.eigvalsh(information)[:, 0] / pixels * ratio**2
    return (textures.filled > TILE_VALID_MIN) & (weakest > TEXTURE_MIN)


def _outlying(state: Fitted) -> Bool:
    misfit = state.misfit
    return state.kept & (misfit > OUTLYING * float(np.median(misfit[state.kept])))


def _require_tiles(textures: Textures, kept: Bool) -> None:
    if kept.sum() < TILES_MIN:
        raise CalibrationError(
            "registration",
            Reason.NOT_REGISTERED,
            f"the pattern shows in {kept.sum()} of {len(kept)} tiles of the sensor",
            allowed=f"{TILES_MIN} or more",
            remedy="show a pattern with more squares or dots on the whole field, and focus the relay",
        )
    points = np.column_stack([textures.x[kept], textures.y[kept]])
    centred = points - points.mean(axis=0)
    if np.linalg.eigvalsh(centred.T @ centred / len(centred))[0] < 1.0:
        raise CalibrationError(
            "registration",
            Reason.NOT_REGISTERED,
            f"the {kept.sum()} tiles that show the pattern lie on one line",
            allowed="tiles all over the sensor, which an affine map needs",
            remedy="light the whole field",
        )


def _require_hold(basis: F64) -> None:
    """Refuse tiles [T, K] in too few rows or columns for the map's degree: between them it would be undetermined."""
    if np.linalg.matrix_rank(basis) < basis.shape[1]:
        raise CalibrationError(
            "registration",
            Reason.NOT_REGISTERED,
            f"the {len(basis)} tiles that show the pattern lie in too few rows or columns for a map of this degree",
            allowed="tiles all over the sensor",
            remedy="light the whole field",
        )


def _require_likeness(state: Fitted) -> None:
    if state.scale < LIKENESS_MIN:
        raise CalibrationError(
            "registration",
            Reason.WRONG_ORDER,
            f"the recorded image follows the pattern by a factor of {state.scale:.2f}",
            allowed=f"{LIKENESS_MIN} or more",
            remedy="another pattern is shown, or an inverted one: check the order and the polarity of the patterns",
        )
