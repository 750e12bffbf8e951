"""When a geometry may be believed: every criterion, written down once.

Here: the criteria and the verdict on tracks and motion. Not here: finding either, or what to do without
(`initialise`). Only `gs2ci.reconstruct.geometry` imports this file.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs2ci.reconstruct.geometry.motion import Motion, Rotations, wander_px
from gs2ci.reconstruct.geometry.tracks import Tracks

F64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

Verdict = Literal["full", "rotation_only", "static", "unsupported"]


@dataclass(frozen=True)
class Criteria:
    """What tracks and motion must show.

    Args:
        tracks: Fewest tracks. A view has 6 unknowns and a track 1, so 20 tracks in two views leave some redundancy.
        tracks_per_view: Fewest tracks that a view must see to count as supported.
        coverage: Least share of the cells of an 8x8 grid over the reference view that hold a track.
        inliers: Least share of the tracks that the motion explains.
        rms_px: Largest reprojection error of the explained tracks.
        unexplained: Least ratio by which the simpler motion must fail: the errors that rotations leave along the
            tracks to those of the full motion, and those of a camera at rest to those of rotations. On rendered scenes
            seen through masks, pure rotations and no motion gave 1.00 to 1.01, a stage move of 3.7 px 1.20, the usual
            moves 2 and more.
        behind: Largest share of tracks that may lie behind a camera.
    """

    tracks: int = 20
    tracks_per_view: int = 10
    coverage: float = 0.1
    inliers: float = 0.25
    rms_px: float = 2.0
    unexplained: float = 1.15
    behind: float = 0.05


@dataclass(frozen=True)
class Judgement:
    """A verdict, the figures it rests on, and the sentences that say so."""

    verdict: Verdict
    parallax_px: float
    notes: tuple[str, ...]


def supported_views(tracks: Tracks, criteria: Criteria) -> Bool:
    """Find the views that see enough tracks, [N]; the reference view counts as one of them."""
    supported = tracks.seen.sum(0) >= criteria.tracks_per_view
    supported[tracks.reference] = True
    return supported


def coverage(tracks: Tracks, size: tuple[int, int]) -> float:
    """Get the share of an 8x8 grid over the reference view that holds a track."""
    cells = (tracks.positions[:, tracks.reference] / (size[1], size[0]) * 8).astype(int).clip(0, 7)
    return len(np.unique(cells, axis=0)) / 64 if len(cells) else 0.0


def doubts_about_tracks(tracks: Tracks, size: tuple[int, int], criteria: Criteria) -> tuple[str, ...]:
    """Say why these tracks cannot support any motion; nothing if they can."""
    doubts = []
    if len(tracks) < criteria.tracks:
        doubts.append(f"Only {len(tracks)} points could be tracked; {criteria.tracks} are needed.")
    elif (share := coverage(tracks, size)) < criteria.coverage:
        doubts.append(f"The tracked points cover {share:.0%} of the image; {criteria.coverage:.0%} is needed.")
    views = tracks.positions.shape[1]
    supported = int(supported_views(tracks, criteria).sum())
    if supported < 2 or supported < views / 2:
        doubts.append(
            f"Only {supported} of {views} views see {criteria.tracks_per_view} tracked points or more; half of the "
            "views must."
        )
    return tuple(doubts)


def judge(candidates: int, tracks: Tracks, motion: Motion, rotations: Rotations, criteria: Criteria) -> Judgement:
    """Decide what the camera did.

    Args:
        candidates: Number of tracks before those that the motion does not explain were dropped.
        tracks: The explained tracks.
        motion: The full motion fitted to them.
        rotations: Pure rotations fitted to them.
        criteria: What must be shown.
    """
    displacements = tracks.positions - tracks.positions[:, [tracks.reference]]
    displacements[:, tracks.reference] = np.nan
    at_rest, turning, moving = (wander_px(errors) for errors in (displacements, rotations.errors_px, motion.errors_px))
    parallax_px = float(np.sqrt(max(turning**2 - moving**2, 0.0)))
    if turning < criteria.unexplained * moving or turning == 0:
        if at_rest < criteria.unexplained * turning or at_rest == 0:
            note = (
                f"The views differ by {at_rest:.2f} px, as noise does: the camera did not move; no depth can be found."
            )
            return Judgement("static", parallax_px, (note,))
        note = (
            f"Rotations alone explain the tracks to {turning:.2f} px (full motion: {moving:.2f} px): the camera only "
            "turned, so depth cannot be found."
        )
        return Judgement("rotation_only", parallax_px, (note,))
    doubts = []
    if len(tracks) < criteria.inliers * candidates:
        doubts.append(f"The motion explains only {len(tracks)} of {candidates} tracks.")
    if motion.rms_px > criteria.rms_px:
        doubts.append(f"The motion explains the tracks to {motion.rms_px:.2f} px only; {criteria.rms_px} is needed.")
    behind = motion.behind_share
    if behind > criteria.behind:
        doubts.append(f"The motion puts {behind:.0%} of the points behind a camera.")
    return Judgement("unsupported" if doubts else "full", parallax_px, tuple(doubts))
