"""Feature tracks from the reference view to every other view by pyramidal Lucas-Kanade.

Here: detection, tracking and its two checks. Not here: any camera model. Positions follow the renderer: the centre of
the pixel in row r and column c lies at (c + 0.5, r + 0.5).
"""

from dataclasses import dataclass
from typing import Annotated, Final

import cv2
import numpy as np
from pydantic import AfterValidator, Field

from gs2ci.core.arrays import F32, F64, U8, Bool
from gs2ci.core.bounds import LARGEST_WINDOW_PX, Bounded, odd
from gs2ci.reconstruct.geometry.tracks.brightened import brightened
from gs2ci.reconstruct.measurement.lens import CENTRE_OFFSET

# Decoded views contain pixel-sized residue of the masks; this blur removes it and preserves corners.
RESIDUE_BLUR_PX = 0.8
_DRIFT_LIMIT_PX = 3.0
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 0.005)


@dataclass(frozen=True)
class TrackSettings(Bounded):
    """What to track.

    Args:
        corners: At most so many corners are tried.
        quality: Least corner strength, relative to the strongest.
        spacing_px: Least distance between corners.
        forward_backward_px: Largest distance of a point from its start when it is tracked to the next view and back.
        window_px: Side of the patch around a corner that is tracked in the other views.
    """

    corners: int = 2500
    quality: float = 0.005
    spacing_px: float = 5.0
    forward_backward_px: float = 1.0
    # OpenCV takes no smaller one.
    window_px: Annotated[int, Field(ge=3, le=LARGEST_WINDOW_PX), AfterValidator(odd)] = 21


USUAL_TRACKS: Final = TrackSettings()


@dataclass(frozen=True)
class Tracks:
    """Points of the reference view and their positions in the other views.

    Args:
        positions: [P, N, 2] float64 as (x, y) in pixels, NaN where a view does not see the point.
        reference: Index of the view in which every point was detected.
    """

    positions: F64
    reference: int

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def seen(self) -> Bool:
        """Get which views see which points, [P, N]."""
        return ~np.isnan(self.positions[..., 0])

    def keep(self, chosen: Bool) -> "Tracks":
        """Take the chosen points only, [P] bool."""
        return Tracks(self.positions[chosen], self.reference)

    def seen_by_at_least(self, views: int) -> "Tracks":
        """Take the points that at least so many views see, the reference among them."""
        return self.keep(self.seen.sum(1) >= views)


def grey_levels(views: F32) -> list[U8]:
    """Turn views, [N, H, W, C] in full scales, into slightly blurred 8-bit luminance, N times [H, W]."""
    images = []
    for view in brightened(views):
        eight_bit = np.clip(view * 255, 0, 255).astype(np.uint8)
        blurred = cv2.GaussianBlur(eight_bit, (0, 0), RESIDUE_BLUR_PX)
        images.append(cv2.cvtColor(blurred, cv2.COLOR_RGB2GRAY) if view.shape[2] == 3 else blurred)
    return images


def find_corners(views: F32, reference: int, settings: TrackSettings = USUAL_TRACKS) -> F64:
    """Detect corners of the reference view, strongest first; [P, 2] as (x, y) in px, P may be 0."""
    image = grey_levels(views[[reference]])[0]
    corners = cv2.goodFeaturesToTrack(image, settings.corners, settings.quality, settings.spacing_px)
    if corners is None:  # a view without any texture
        return np.empty((0, 2))
    return corners.reshape(-1, 2).astype(np.float64) + CENTRE_OFFSET


def find_tracks(views: F32, reference: int, corners: F64, settings: TrackSettings = USUAL_TRACKS) -> Tracks:
    """Follow corners of the reference view through its neighbours to both ends of the exposure.

    Args:
        views: [N, H, W, C] float32 in [0, 1], in the order of exposure; C is 1 or 3.
        reference: Index of the view to start from.
        corners: What to follow, [P, 2] px.
        settings: What counts as found.

    Returns:
        P tracks.

    A point is lost for good at the first view where tracking fails or does not lead back. Steps from view to view
    accumulate drift; so each point is tracked again directly from the reference view, starting at the position that the
    steps gave, and replaced if both agree within 3 px.
    """
    positions = np.full((len(corners), len(views), 2), np.nan)
    positions[:, reference] = corners
    if len(corners):
        images = grey_levels(views)
        for order in (range(reference + 1, len(views)), range(reference - 1, -1, -1)):
            _follow(images, reference, order, positions, settings)
    return Tracks(positions, reference)


def refine_tracks(views: F32, reference: int, predicted: F64, settings: TrackSettings = USUAL_TRACKS) -> Tracks:
    """Track points again, directly from the reference view, starting where a known motion predicts them.

    Args:
        views: As for `find_tracks`.
        reference: As for `find_tracks`.
        predicted: Predicted position of each point in each view, [P, N, 2] px; exact for the reference view.
        settings: What counts as found.

    Returns:
        P tracks. With so good a start no pyramid is needed, whose coarse levels mix near and far; and a point that is
        lost in one view may be found in the next.
    """
    positions = np.full(predicted.shape, np.nan)
    positions[:, reference] = predicted[:, reference]
    images = grey_levels(views)
    start = (predicted[:, reference] - CENTRE_OFFSET).astype(np.float32)
    for i in range(len(views)):
        if i == reference or not len(start):
            continue
        guess = (predicted[:, i] - CENTRE_OFFSET).astype(np.float32)
        found, ok = _there_and_back(images[reference], images[i], start, settings, guess)
        ok &= (np.linalg.norm(found - guess, axis=1) < _DRIFT_LIMIT_PX) & _inside(found, images[i])
        positions[ok, i] = found[ok] + CENTRE_OFFSET
    return Tracks(positions, reference)


def within(tracks: Tracks, shown: Bool) -> Tracks:
    """Drop positions outside the pixels that the sensor sees, `shown`, [H, W], and points that start outside them."""
    height, width = shown.shape
    at = np.nan_to_num(tracks.positions).astype(int).clip(0, (width - 1, height - 1))
    positions = np.where(shown[at[..., 1], at[..., 0]][..., None], tracks.positions, np.nan)
    return Tracks(positions, tracks.reference).keep(~np.isnan(positions[:, tracks.reference, 0]))


def _follow(images: list[U8], reference: int, order: range, positions: F64, settings: TrackSettings) -> None:
    """Fill `positions` of the views in `order`, each reached from the one before."""
    start = (positions[:, reference] - CENTRE_OFFSET).astype(np.float32)
    previous, points, alive = reference, start, np.ones(len(start), np.bool_)
    for i in order:
        ahead, found = _there_and_back(images[previous], images[i], points, settings)
        alive &= found
        direct, found_direct = _flow(images[reference], images[i], start, settings.window_px, ahead)
        agree = found_direct & (np.linalg.norm(direct - ahead, axis=1) < _DRIFT_LIMIT_PX)
        points = np.where(agree[:, None], direct, ahead)
        alive &= _inside(points, images[i])
        positions[alive, i] = points[alive] + CENTRE_OFFSET
        previous = i


def _there_and_back(
    source: U8, target: U8, points: F32, settings: TrackSettings, guess: F32 | None = None
) -> tuple[F32, Bool]:
    """Track points to another view, from a good guess without a pyramid; tell which lead back to where they were."""
    levels = {} if guess is None else {"pyramid_levels": 0}
    there, found = _flow(source, target, points, settings.window_px, guess, **levels)
    start = None if guess is None else points + (there - guess)
    back, found_back = _flow(target, source, there, settings.window_px, start, **levels)
    return there, found & found_back & (np.linalg.norm(back - points, axis=1) < settings.forward_backward_px)


def _inside(points: F32, image: U8) -> Bool:
    height, width = image.shape
    inside = (points >= 0) & (points <= (width - 1, height - 1))
    return inside[:, 0] & inside[:, 1]


def _flow(
    source: U8,
    target: U8,
    points: F32,
    window_px: int,
    guess: F32 | None = None,
    pyramid_levels: int = 4,
) -> tuple[F32, Bool]:
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        points,
        None if guess is None else guess.copy(),
        winSize=(window_px, window_px),
        maxLevel=pyramid_levels,
        criteria=_STOP,
        flags=0 if guess is None else cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return moved, status[:, 0] == 1
