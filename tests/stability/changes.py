"""Changes of a simulated measurement by hand: wrong masks, noise, dead rows, a wrong camera, extreme numbers.

Every change takes a shot and returns another; random changes have their own generator. Not here: measurements
(`benches`), which changes make a case (`cases`).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, shift

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot, Truth

Change = Callable[[Shot], Shot]
SEED = 7


def same(shot: Shot) -> Shot:
    """Leave the shot as it is."""
    return shot


def in_focus(views: F32) -> F32:
    """See true views, [N, H, W, C], as they are."""
    return views


def out_of_focus(sigma_px: float) -> Callable[[F32], F32]:
    """See true views through a lens that is out of focus: nothing tells it from a scene without fine detail."""
    return lambda views: np.asarray(gaussian_filter(views, (0, sigma_px, sigma_px, 0), mode="nearest"))


def noisy(share: float) -> Change:
    """Add white noise, its deviation a share of the brightest reading."""

    def change(shot: Shot) -> Shot:
        sigma = share * float(shot.measurement.max())
        noise = np.random.default_rng(SEED).normal(0.0, sigma, shot.measurement.shape)
        return replace(shot, measurement=(shot.measurement + noise).astype(np.float32))

    return change


def _masks(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Change what is stated of the masks; what was exposed stays."""
    return lambda shot: replace(shot, masks=np.clip(change(shot.masks), 0, 1).astype(np.float32))


def shifted(pixels: float) -> Change:
    """State the masks to lie elsewhere by so many pixels along the rows."""
    return _masks(lambda masks: shift(masks, (0, 0, pixels), order=1, mode="nearest"))


def blurred(sigma_px: float) -> Change:
    """State the masks to be softer than they were."""
    return _masks(lambda masks: gaussian_filter(masks, (0, sigma_px, sigma_px)))


def crisp(shot: Shot) -> Shot:
    """State grey masks as binary ones."""
    return _masks(lambda masks: (masks > 0.5).astype(np.float32))(shot)


def dim(share: float) -> Change:
    """State every mask to let through only this share."""
    return _masks(lambda masks: share * masks)


def miscalibrated(sigma: float) -> Change:
    """Add noise to the calibrated masks."""
    return _masks(lambda masks: masks + np.random.default_rng(SEED).normal(0, sigma, masks.shape))


def permuted(order: Callable[[int], Any]) -> Change:
    """State that the masks were shown in another order."""
    return lambda shot: replace(shot, masks=np.ascontiguousarray(shot.masks[order(shot.views)]))


def backwards(count: int) -> np.ndarray:
    """Order the masks from the last to the first."""
    return np.arange(count)[::-1]


def two_swapped(count: int) -> np.ndarray:
    """Swap the first mask and the one after the next."""
    order = np.arange(count)
    order[[0, 2]] = order[[2, 0]]
    return order


def shuffled(count: int) -> np.ndarray:
    """Order the masks at random."""
    return np.random.default_rng(SEED).permutation(count)


def duplicated(groups: int) -> Change:
    """Show only so many different masks, each for consecutive views, and know it; made from the true views."""

    def change(shot: Shot) -> Shot:
        masks = shot.masks[np.arange(shot.views) * groups // shot.views]
        assert shot.truth.views is not None
        measurement = (masks[..., None] * shot.truth.views).sum(axis=0)
        return replace(shot, masks=masks, measurement=measurement.astype(np.float32))

    return change


def reweighted(spread: float) -> Change:
    """State the masks to have been exposed longer or shorter than they were."""

    def change(shot: Shot) -> Shot:
        factor = np.random.default_rng(SEED).uniform(1 - spread, 1 + spread, shot.views)
        return replace(shot, weights=(shot.weights * factor).astype(np.float32))

    return change


def saturated(share: float, *, told: bool = True) -> Change:
    """Clip this share of the pixels, and say which or not."""

    def change(shot: Shot) -> Shot:
        level = np.quantile(shot.measurement.max(axis=2), 1 - share)
        clipped = (shot.measurement >= level).any(axis=2)
        return replace(
            shot, measurement=np.minimum(shot.measurement, np.float32(level)), saturated=clipped if told else None
        )

    return change


def dead_rows(first: int, last: int, *, every: int = 1, told: bool = False) -> Change:
    """Read zero in rows of the sensor; told, the masks are known to be closed there."""

    def change(shot: Shot) -> Shot:
        dead = np.zeros(shot.size[0], bool)
        dead[first:last:every] = True
        masks = np.where(dead[None, :, None], 0, shot.masks).astype(np.float32) if told else shot.masks
        return replace(shot, measurement=np.where(dead[:, None, None], 0, shot.measurement), masks=masks)

    return change


def hot_pixels(share: float, reading: float) -> Change:
    """Let single pixels read so much, whatever light comes."""

    def change(shot: Shot) -> Shot:
        hot = np.random.default_rng(SEED).random(shot.size) < share
        return replace(shot, measurement=np.where(hot[..., None], np.float32(reading), shot.measurement))

    return change


def offset(by: float) -> Change:
    """Subtract too little or too much of the dark level."""
    return lambda shot: replace(shot, measurement=shot.measurement + np.float32(by))


def scaled(by: float) -> Change:
    """State the measurement in another unit."""
    return lambda shot: replace(shot, measurement=np.float32(by) * shot.measurement)


def mono(shot: Shot) -> Shot:
    """Measure grey instead of colours."""
    assert shot.truth.views is not None
    truth = Truth(shot.truth.views.mean(axis=3, keepdims=True), shot.truth.world_to_camera)
    return replace(shot, measurement=shot.measurement.mean(axis=2, keepdims=True), truth=truth)


def focal(factor: float) -> Change:
    """State a focal length that is off by this factor."""

    def change(shot: Shot) -> Shot:
        assert shot.intrinsics is not None
        intrinsics = shot.intrinsics.copy()
        intrinsics[[0, 1], [0, 1]] *= factor
        return replace(shot, intrinsics=intrinsics)

    return change


def off_centre(share: float) -> Change:
    """State a principal point that is off by a share of the width."""

    def change(shot: Shot) -> Shot:
        assert shot.intrinsics is not None
        intrinsics = shot.intrinsics.copy()
        intrinsics[0, 2] += share * shot.size[1]
        return replace(shot, intrinsics=intrinsics)

    return change


def no_camera(shot: Shot) -> Shot:
    """Know nothing of the camera."""
    return replace(shot, intrinsics=None, distortion=None)


def lens(k1: float) -> Change:
    """State the lens to distort by so much."""
    return lambda shot: replace(shot, distortion=np.array([k1, 0.0, 0.0, 0.0, 0.0]))


def no_distortion(shot: Shot) -> Shot:
    """State the lens to be an ideal one."""
    return replace(shot, distortion=None)


def telemetry(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Report the true poses from the stage, changed."""

    def apply(shot: Shot) -> Shot:
        assert shot.truth.world_to_camera is not None
        return replace(shot, telemetry_world_to_camera=change(shot.truth.world_to_camera.copy()))

    return apply


def translations(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    """Multiply the shift of every pose."""

    def change(poses: np.ndarray) -> np.ndarray:
        poses[:, :3, 3] *= factor
        return poses

    return change


def astray(share: float) -> Callable[[np.ndarray], np.ndarray]:
    """Misplace every pose by so much of the path's extent, root mean square."""

    def change(poses: np.ndarray) -> np.ndarray:
        extent = np.linalg.norm(np.ptp(np.linalg.inv(poses)[:, :3, 3], axis=0))
        poses[:, :3, 3] += share * extent / np.sqrt(3) * np.random.default_rng(5).standard_normal((len(poses), 3))
        return poses

    return change


def moving(step: float) -> Callable[[np.ndarray], np.ndarray]:
    """Add a step to the right between any two views."""

    def change(poses: np.ndarray) -> np.ndarray:
        poses[:, 0, 3] -= step * np.arange(len(poses))
        return poses

    return change


def stretched(poses: np.ndarray) -> np.ndarray:
    """Let the poses' rotations stretch by a tenth, as a scale that was left in does."""
    poses[:, :3, :3] *= 1.1
    return poses


def camera(focal_px: float, centre: float) -> Change:
    """State a camera of this focal length, its principal point at so many times the picture's size."""

    def change(shot: Shot) -> Shot:
        height, width = shot.size
        matrix = np.array([[focal_px, 0, centre * width], [0, focal_px, centre * height], [0, 0, 1]])
        return replace(shot, intrinsics=matrix)

    return change


def scaled_masks(by: float) -> Change:
    """Multiply all masks, however small that makes them."""
    return lambda shot: replace(shot, masks=(by * shot.masks).astype(np.float32))


def true_views(value: float) -> Change:
    """Claim that the truth is this number everywhere."""
    return lambda shot: replace(
        shot, truth=Truth(np.full((shot.views, *shot.size, shot.channels), value, np.float32), None)
    )


def one_pixel(name: str, value: float) -> Change:
    """Set the first number of an array of the record."""

    def change(shot: Shot) -> Shot:
        array = getattr(shot, name).copy()
        array.reshape(-1)[0] = value
        return replace(shot, **{name: array})

    return change
