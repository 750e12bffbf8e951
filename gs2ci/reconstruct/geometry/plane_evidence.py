"""The depth of plain areas, estimated from the measurement itself, one plane for each area.

With noise, a plain area soon gets a wrong depth, mostly that of things in front of it, and the fit renders it so: from
then on, any comparison of its views confirms the error. The measurement does not share it. Over thousands of readings
the weak texture of a wall shows where it is: for the right plane, a texture estimated from two thirds of the readings
predicts the others better than for any other plane. So for each plain area the plane with the best prediction is
searched for, and the area is moved to it if it surely predicts better than the present map, and than no texture at all:
of the many planes that are tried in pure noise, one often predicts better than the map by chance.

Here: areas, planes, the comparison with a map. Not here: where readings look (`sightlines`), the texture
(`texture_kernels`), maps (`surface_map`).
"""

from dataclasses import dataclass
from typing import Final, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.reconstruct.geometry.plain import plain_pixels, rays_through
from gs2ci.reconstruct.geometry.sightlines import Sightlines
from gs2ci.reconstruct.geometry.sweep import difference, features_of
from gs2ci.reconstruct.geometry.texture_kernels import prediction_errors, without_slow

# Noise of fitted views is blotchy: plain areas are found after a blur of so many px.
_PLAIN_BLUR_PX: Final = 1.5
# Pixels nearer than this to the edge of an area, px, may see other surfaces in some views.
_EDGE_PX: Final = 3
# Plain pixels up to this far, px, around those that see the plane in all views are moved to it too.
_BEYOND_PX: Final = 12
# Around an area, the views may differ on the plane by so much more than on the map, in medians of the difference; they
# are blurred, and differences averaged over a window.
_ALLOWED: Final = 1.0
_DIFFER_BLUR_PX: Final = 1.0
_DIFFER_WINDOW_PX: Final = 5
# The smallest area, as a share of the picture: smaller ones do not distinguish planes in noise.
_LEAST_SHARE: Final = 0.005
_LEAST_PIXELS: Final = 300
_MOST_ASKED: Final = 4
# A plane is searched for with at most so many readings around the middle of an area, to bound time and memory.
_MOST_READINGS: Final = 32_768
# Side of blocks of an area, px; each may lie on another surface.
_BLOCK_PX: Final = 24
# Each third of the readings is predicted from the other two. To save time, only one of the thirds is predicted for the
# first planes of areas with many readings.
_FOLDS: Final = 3
_MANY: Final = 4096
# Parallax along the whole path, px: the distance of the first planes, and the later steps of the search.
_FIRST_STEP_PX: Final = 4.0
_STEPS_PX: Final = (2.0, 1.0, 1.0, 0.5)
_MOST_PLANES: Final = 16
# By how many standard errors a plane has to be better than the map over an area, and than no texture. In noise without
# any texture, planes were better than the map by 2.1 to 3.5 in 24 walls of 60; of 13 planes in noise none was better
# than no texture by more than 0.5. Of a texture a fifth as strong as it, 14 of 16 planes were better than both by 3.5
# and more. Of a texture of 0.15 of it, on a map 12 px off, 24 walls of 30 are moved, and 9 with a limit of 3; on maps
# 1 px off, of 60 walls with textures of 0.2 and 0.3, one is moved rightly and 5 wrongly, and none with a limit of 3.
_CLEARLY: Final = 2.1
# By how many standard errors of independent readings it may be worse than the map within windows of an area.
_WORSE: Final = 2.0
# Two readings predict each other with the same weight, so that in noise the product of their errors is part of what
# both gain. A sum over all readings counts each product twice, and its variance is twice that of independent gains
# (Hoeffding 1948: a degenerate U-statistic).
_COUNTED: Final = 2.0
_WINDOW_PX: Final = 31
# The least share of an area that has to be left after the windows in which the map is better.
_LEAST_TAKEN: Final = 0.6
# Weights of the penalty on a texture's roughness: the search starts with one of them and goes on with the one that
# predicts best. One that is far too large prefers planes that hardly move, which interpolation does not blur.
_SMOOTH: Final = (0.5, 2.0, 8.0, 32.0)
_FIRST_SMOOTH: Final = 2.0
# What varies more slowly than this, px, is taken from the views, since it carries no information on depth.
_SLOW_PX: Final = 6.0


@dataclass(frozen=True)
class Readings:
    """A measurement in the form that is compared with planes.

    Args:
        light: Mean over the channels, [H, W]; for a mosaic, its readings.
        open_share: Transmission of each pixel at each moment, with the views' weights, [V, H, W].
        world_to_camera: Poses at these moments, [V, 4, 4]: those of the views, or several within each mask.
        usable: Pixels whose readings may be used, [H, W].
        rays: Of the pixels, at z = 1, [H, W, 2].
        channels: For a mosaic, which channel each pixel sees, [H, W]; None: the mean of all.
    """

    light: F32
    open_share: F32
    world_to_camera: F64
    usable: Bool
    rays: F32
    channels: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class _Asked:
    """Some readings, and the data that predict them."""

    at: tuple[NDArray[np.int64], NDArray[np.int64]]
    sightlines: Sightlines
    light: F64
    channel: NDArray[np.int64]
    fold: NDArray[np.int64]

    @classmethod
    def of(cls, readings: Readings, where: Bool) -> Self:
        rows, columns = np.nonzero(where)
        at = rows.astype(np.int64), columns.astype(np.int64)
        channel = np.zeros(len(rows), np.int64) if readings.channels is None else readings.channels[at]
        fold = np.random.default_rng(len(at[0])).integers(0, _FOLDS, len(at[0]))
        rays = np.concatenate([readings.rays[at], np.ones((len(at[0]), 1))], axis=1).astype(np.float64)
        sightlines = Sightlines.of(readings.open_share, *at, rays)
        return cls(at, sightlines, readings.light[at].astype(np.float64), channel, fold)


class PlaneEvidence:
    """Judges planes by how well they predict a measurement.

    Args:
        readings: The measurement.
        view: The view in whose picture the texture lies, of a fit, [H, W, C] in full scales: what varies slowly is
            taken from it.
        world_to_camera: Its pose, [4, 4].
        intrinsics: [3, 3], px.
    """

    def __init__(self, readings: Readings, view: F32, world_to_camera: F64, intrinsics: F64) -> None:
        self.smooth = _FIRST_SMOOTH
        self._poses = readings.world_to_camera @ np.linalg.inv(world_to_camera)
        self._intrinsics = intrinsics
        slow = cv2.GaussianBlur(view, (0, 0), _SLOW_PX).reshape(view.shape)
        slow = slow if readings.channels is not None else slow.mean(axis=2, keepdims=True)
        self._slow = np.ascontiguousarray(slow.transpose(2, 0, 1))

    def of_planes(self, asked: _Asked, planes: F64, *, hurried: bool = False) -> F64:
        """Return the squared prediction errors of readings, [P, K], by planes n, [P, 3], with n . X = 1.

        Hurried, they are 0 for two thirds of the readings if these are many.
        """
        return self._of_planes(asked, planes, np.full(len(planes), self.smooth), hurried=hurried)

    def of_map(self, asked: _Asked, inverse_depth: F32) -> F64:
        """Return the squared prediction errors by a map of the reference view's inverse depth, [H, W]."""
        places = asked.sightlines.on_map(inverse_depth, self._poses, self._intrinsics)
        errors: F64 = self._errors(asked, places, _FOLDS, np.array([self.smooth]))[0]
        return errors

    def without_texture(self, asked: _Asked, plane: F64) -> F64:
        """Return the squared errors of readings, [K], by what is known of the view on a plane, [3], and a constant."""
        (places,) = asked.sightlines.on_planes(plane[None], self._poses, self._intrinsics)
        lines = asked.sightlines
        left = without_slow(places, lines.begin, lines.share, asked.light, self._slow, asked.channel)
        squares: F64 = (left - left.mean()) ** 2
        return squares

    def tune(self, asked: _Asked, plane: F64) -> None:
        """Choose the penalty with which a plane predicts readings best."""
        errors = self._of_planes(asked, np.tile(plane, (len(_SMOOTH), 1)), np.array(_SMOOTH), hurried=True)
        self.smooth = _SMOOTH[int(np.argmin(errors.sum(axis=1)))]

    def _of_planes(self, asked: _Asked, planes: F64, smooth: F64, *, hurried: bool) -> F64:
        places = asked.sightlines.on_planes(planes, self._poses, self._intrinsics)
        return self._errors(asked, places, 1 if hurried and len(asked.light) > _MANY else _FOLDS, smooth)

    def _errors(self, asked: _Asked, places: F64, folds: int, smooth: F64) -> F64:
        return prediction_errors(
            places, asked.sightlines, asked.light, self._slow, asked.channel, asked.fold, folds, smooth
        )


@dataclass(frozen=True)
class FoundPlane:
    """A plane that the measurement prefers to a map.

    Args:
        plane: n with n . X = 1 in the reference view, [3].
        where: Pixels that see it in every view, [H, W].
        elsewhere: Pixels of its area where the map predicts better, [H, W].
        errors: By how many standard errors it predicts better than the map.
    """

    plane: F64
    where: Bool
    elsewhere: Bool
    errors: float


def found_planes(
    readings: Readings,
    views: F32,
    world_to_camera: F64,
    intrinsics: F64,
    reference: int,
    inverse_depth: F32,
    span: tuple[float, float],
    parallax_px: float,
) -> list[FoundPlane]:
    """Find planes for the plain areas of a fit's views that predict the measurement better than a map.

    Args:
        readings: The measurement.
        views: [N, H, W, C] in full scales.
        world_to_camera: Pose of the reference view, [4, 4].
        intrinsics: [3, 3], px.
        reference: Which of the views it is.
        inverse_depth: The map of the reference view, [H, W].
        span: Farthest and nearest inverse depth.
        parallax_px: Parallax along the whole path at an inverse depth of 1, px.
    """
    plain = readings.usable & np.all([_away_from_edges(view) for view in views], axis=0)
    waiting, found = _areas(plain), []
    asked_for = 0
    while waiting and asked_for < _MOST_ASKED:
        area = waiting.pop(0)
        asked_for += 1
        asked = _Asked.of(readings, area)
        part = _Asked.of(readings, _around_middle(area))
        # Anew for each area: the penalty that suits one says nothing about the next.
        evidence = PlaneEvidence(readings, views[reference], world_to_camera, intrinsics)
        start = _best_depth(evidence, part, span, parallax_px)
        if start is None:
            continue
        evidence.tune(part, start)
        plane = _best_plane(evidence, part, evidence.of_map(part, inverse_depth), start, parallax_px)
        on_plane = evidence.of_planes(asked, plane[None])[0]
        taken, errors = _taken(area, asked, evidence.of_map(asked, inverse_depth) - on_plane)
        of_texture = _errors((evidence.without_texture(asked, plane) - on_plane)[taken[asked.at]])
        if min(errors, of_texture) < _CLEARLY:
            continue
        found.append(FoundPlane(plane, taken, area & ~taken, errors))
        rest = _areas(area & ~taken)
        waiting = sorted([*waiting, *rest], key=lambda one: -one.sum())
    return found


def with_plane(
    inverse_depth: F32, views: F32, found: FoundPlane, from_view: F64, to_reference: F64, intrinsics: F64
) -> F32:
    """Return a map of a view, [H, W], with the plain pixels in and around an area moved to its plane.

    Args:
        inverse_depth: Of the first of the views, [H, W].
        views: In full scales, [N, H, W, C]. Pixels around the area are moved only if the views differ there hardly more
            than on the map: the borders of things in front of the area may be as plain as the area itself.
        found: The plane.
        from_view: The views' poses relative to the first, [N, 4, 4].
        to_reference: The reference view's pose relative to the first, [4, 4].
        intrinsics: [3, 3], px.
    """
    plain = _plain(views[0])
    near = cv2.dilate(found.where.astype(np.uint8), np.ones((2 * _BEYOND_PX + 1, 2 * _BEYOND_PX + 1), np.uint8)) > 0
    # Held-out pixels are holes of one pixel.
    inside = cv2.morphologyEx(found.where.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0
    rays = rays_through(plain.shape, intrinsics)
    # n . (R X + t) = 1.
    own = found.plane @ to_reference[:3, :3] / (1 - found.plane @ to_reference[:3, 3])
    on_plane = (rays @ own).astype(np.float32)
    described = features_of(views, _DIFFER_BLUR_PX)
    before, after = (
        difference(depth, described, from_view, intrinsics, _DIFFER_WINDOW_PX) for depth in (inverse_depth, on_plane)
    )
    no_worse = after <= before + _ALLOWED * np.median(before)
    asked = plain & near & ~found.elsewhere & (inside | no_worse)
    _, labels = cv2.connectedComponents(asked.astype(np.uint8), connectivity=4)
    reached = np.zeros(int(labels.max()) + 1, bool)
    reached[labels[inside & asked]] = True
    reached[0] = False
    changed: F32 = np.where(reached[labels], on_plane, inverse_depth)
    return changed


def _taken(area: Bool, asked: _Asked, gain: F64) -> tuple[Bool, float]:
    """Return an area without the parts where the map is better, [H, W], and by how many errors the plane is better.

    The errors are 0 if the map is better in much of the area: then the plane is a compromise between surfaces.
    """
    taken = area & ~_worse_within(area, asked, gain)
    share = taken.sum() / area.sum()
    return taken, _errors(gain[taken[asked.at]]) if share >= _LEAST_TAKEN else 0.0


@dataclass(frozen=True)
class _Blocks:
    """Blocks of readings.

    Args:
        number: Of each reading's block, [K].
        count: Of blocks.
    """

    number: NDArray[np.int64]
    count: int

    @classmethod
    def of(cls, asked: _Asked) -> Self:
        rows, columns = (at // _BLOCK_PX for at in asked.at)
        _, number = np.unique(rows * (int(columns.max()) + 1) + columns, return_inverse=True)
        return cls(number, int(number.max()) + 1)

    def sums(self, values: F64) -> F64:
        """Return the sum over each block of values, [K]."""
        found: F64 = np.bincount(self.number, values, self.count).astype(np.float64)
        return found


def _errors(gain: F64) -> float:
    """Return by how many standard errors the mean of the readings' gains, [K], is above 0."""
    scatter = float(gain.std()) if len(gain) else 0.0
    return float(gain.mean()) / scatter * (len(gain) / _COUNTED) ** 0.5 if scatter > 0 else 0.0


def _worse_within(area: Bool, asked: _Asked, gain: F64) -> Bool:
    """Mark the pixels of an area around which, in a window, the plane is worse than the map, [H, W]."""
    image = np.zeros((3, *area.shape))
    image[:, asked.at[0], asked.at[1]] = np.stack([np.ones_like(gain), gain, gain**2])
    count, mean, square = (cv2.boxFilter(one, -1, (_WINDOW_PX, _WINDOW_PX), normalize=False) for one in image)
    count = np.maximum(count, 1)
    mean, square = mean / count, square / count
    error = np.sqrt(np.maximum(square - mean**2, 0) / count)
    worse: Bool = mean < -_WORSE * error
    return worse


def _plain(view: F32) -> Bool:
    return plain_pixels(cv2.GaussianBlur(view, (0, 0), _PLAIN_BLUR_PX).reshape(view.shape))


def _away_from_edges(view: F32) -> Bool:
    plain = _plain(view)
    window = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1))
    away: Bool = cv2.erode(plain.astype(np.uint8), window) > 0
    return away


def _areas(where: Bool) -> list[Bool]:
    """Return the connected areas that are large enough, the largest first, [H, W] each."""
    # Held-out pixels are holes of one pixel.
    closed = cv2.morphologyEx(where.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    least = max(_LEAST_PIXELS, _LEAST_SHARE * where.size)
    large = [k for k in range(1, count) if stats[k, cv2.CC_STAT_AREA] >= least]
    large.sort(key=lambda k: -stats[k, cv2.CC_STAT_AREA])
    return [(labels == k) & where for k in large]


def _around_middle(area: Bool) -> Bool:
    """Keep the pixels nearest to the middle of an area, as many as the search for a plane uses, [H, W]."""
    if area.sum() <= _MOST_READINGS:
        return area
    rows, columns = np.nonzero(area)
    distance = np.hypot(rows - np.median(rows), columns - np.median(columns))
    nearest = np.argsort(distance, kind="stable")[:_MOST_READINGS]
    part = np.zeros_like(area)
    part[rows[nearest], columns[nearest]] = True
    return part


def _best_depth(evidence: PlaneEvidence, asked: _Asked, span: tuple[float, float], parallax_px: float) -> F64 | None:
    """Return the plane of constant depth that predicts an area best, [3].

    None if it lies at an end of the range, which exceeds that of the scene: then the readings do not determine a depth.
    """
    count = int(np.clip((span[1] - span[0]) * parallax_px / _FIRST_STEP_PX, 3, _MOST_PLANES))
    planes = np.zeros((count, 3))
    planes[:, 2] = np.linspace(*span, count)
    best = int(np.argmin(evidence.of_planes(asked, planes, hurried=True).sum(axis=1)))
    return planes[best] if 0 < best < count - 1 else None


def _best_plane(evidence: PlaneEvidence, asked: _Asked, before: F64, start: F64, parallax_px: float) -> F64:
    """Search from a plane for the one that predicts best; blocks that the map predicts better count as the map, [3]."""
    across = asked.sightlines.rays[:, :2]
    middle, reach = across.mean(axis=0), np.maximum(across.std(axis=0), 1e-6)
    blocks = _Blocks.of(asked)
    by_map = blocks.sums(before)

    def planes_of(at: F64) -> F64:
        """Return planes of inverse depths in the middle, and their changes one standard deviation right and down."""
        slopes = at[:, 1:] / reach
        return np.column_stack([slopes, at[:, 0] - slopes @ middle])

    def left(at: F64) -> list[float]:
        """Return the errors; blocks that the map predicts better are another surface."""
        errors = evidence.of_planes(asked, planes_of(at))
        return [float(np.minimum(blocks.sums(one), by_map).sum()) for one in errors]

    at = np.array([start[2], 0.0, 0.0])
    (least,) = left(at[None])
    for step in _STEPS_PX:
        for axis in range(3):
            # Both signs at once, so that threads have enough to share.
            tried = np.stack([at, at])
            tried[:, axis] += np.array([step, -step]) / parallax_px
            for now, there in zip(left(tried), tried, strict=True):
                if now < least:
                    at, least = there, now
                    break
    found: F64 = planes_of(at[None])[0]
    return found
