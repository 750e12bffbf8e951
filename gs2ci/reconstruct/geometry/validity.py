"""When a geometry may be believed: every criterion, written down once.

Here: the criteria and the verdict on tracks and motion. Not here: finding either, or what to do without
(`initialise`). Only `gs2ci.reconstruct.geometry` imports this file.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs2ci.reconstruct.geometry.motion import Motion, Rotations
from gs2ci.reconstruct.geometry.tracks import Tracks

F64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

Verdict = Literal["full", "rotation_only", "static", "unsupported"]

_FEWEST_VIEWS_FOR_COHERENCE = 3


@dataclass(frozen=True)
class Criteria:
    """What tracks and motion must show.

    Args:
        tracks: Fewest tracks. A view has 6 unknowns and a track 1, so 20 tracks in two views leave some redundancy.
        tracks_per_view: Fewest tracks that a view must see to count as supported.
        coverage: Least share of the cells of an 8x8 grid over the reference view that hold a track.
        inliers: Least share of the tracks that the motion explains.
        rms_px: Largest reprojection error of the explained tracks.
        parallax_px: Least strength of the strongest pattern in what the best rotations leave (`parallax_spectrum`).
        parallax_to_noise: Least ratio of the error of pure rotations to that of the full motion, both per degree of
            freedom. An error of a corner in the reference view is common to all views, and a translation explains
            one of its two components: so noise alone reaches √2. It suffices alone, as does the next.
        coherence: Least ratio of the strongest pattern to the weaker half of them. A translation moves all views in
            one pattern, noise moves them in all patterns alike: 1.5 to 2.6 on views decoded from a camera that only
            turned, 4.6 and more where there was parallax, be it half as large as the noise.
        displacement_px: Median displacement by the best rotations below which the camera counts as still.
        behind: Largest share of tracks that may lie behind a camera.
    """

    tracks: int = 20
    tracks_per_view: int = 10
    coverage: float = 0.1
    inliers: float = 0.25
    rms_px: float = 2.0
    parallax_px: float = 0.5
    parallax_to_noise: float = 1.6
    coherence: float = 3.5
    displacement_px: float = 0.5
    behind: float = 0.05


def supported_views(tracks: Tracks, criteria: Criteria) -> Bool:
    """Find the views that see enough tracks, [N]; the reference view counts as one of them."""
    supported: Bool = tracks.seen.sum(0) >= criteria.tracks_per_view
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


def parallax_spectrum(tracks: Tracks, rotations: Rotations) -> F64:
    """Split what rotations leave unexplained into patterns over the views, by strength.

    Args:
        tracks: At least one point.
        rotations: Pure rotations fitted to them.

    Returns:
        Root mean square over the points of each pattern's amplitude over all views, in px, strongest first, [2N - 2].

    These are the singular values of the residual displacements, [P, 2N], less each point's own mean, per root P.
    Points that some view does not see count in those pairs of views that see them.
    """
    seen = tracks.seen.T.astype(np.float64)
    views, points = seen.shape
    left = np.nan_to_num(rotations.residuals_px).transpose(0, 2, 1).reshape(2 * views, points)
    pairs = np.repeat(np.repeat(seen @ seen.T, 2, axis=0), 2, axis=1)
    covariance = left @ left.T / np.maximum(pairs, 1)
    centring = np.kron(np.eye(views) - 1 / views, np.eye(2))
    variances = np.linalg.eigvalsh(centring @ covariance @ centring)[::-1][: 2 * views - 2]
    strengths: F64 = np.sqrt(np.maximum(variances, 0))
    return strengths


def has_parallax(tracks: Tracks, motion: Motion, rotations: Rotations, criteria: Criteria) -> bool:
    """Decide whether the tracks need a translation of the camera, and not just rotations and noise."""
    seen = tracks.seen.copy()
    seen[:, tracks.reference] = False
    sightings, moving = int(seen.sum()), int(seen.any(0).sum())
    spectrum = parallax_spectrum(tracks, rotations)
    if spectrum[0] < criteria.parallax_px:
        return False
    noise_full = motion.rms_px * np.sqrt(sightings / max(2 * sightings - 6 * moving - len(tracks), 1))
    noise_rotation = rotations.rms_px * np.sqrt(sightings / max(2 * sightings - 3 * moving, 1))
    if noise_rotation > criteria.parallax_to_noise * noise_full:
        return True
    # With two or three views there are too few patterns to tell noise by.
    weaker_half = spectrum[len(spectrum) // 2 :]
    return moving >= _FEWEST_VIEWS_FOR_COHERENCE and bool(spectrum[0] > criteria.coherence * np.median(weaker_half))


def judge(
    candidates: int, tracks: Tracks, motion: Motion, rotations: Rotations, criteria: Criteria
) -> tuple[Verdict, tuple[str, ...]]:
    """Decide what the camera did, and say it in sentences unless all is well.

    Args:
        candidates: Number of tracks before those that the motion does not explain were dropped.
        tracks: The explained tracks.
        motion: The full motion fitted to them.
        rotations: Pure rotations fitted to them.
        criteria: What must be shown.
    """
    if not has_parallax(tracks, motion, rotations, criteria):
        if rotations.displacement_px < criteria.displacement_px:
            moved = f"The views differ by {rotations.displacement_px:.2f} px"
            return "static", (f"{moved}: the camera did not move, so depth cannot be found.",)
        explained = f"Rotations alone explain the tracks to {rotations.rms_px:.2f} px"
        return "rotation_only", (f"{explained}: the camera only turned, so depth cannot be found.",)
    doubts = []
    if len(tracks) < max(criteria.inliers * candidates, criteria.tracks):
        doubts.append(f"The motion explains only {len(tracks)} of {candidates} tracks.")
    if motion.rms_px > criteria.rms_px:
        doubts.append(f"The motion explains the tracks to {motion.rms_px:.2f} px only; {criteria.rms_px} is needed.")
    if motion.behind_share > criteria.behind:
        doubts.append(f"The motion puts {motion.behind_share:.0%} of the points behind a camera.")
    return ("unsupported" if doubts else "full"), tuple(doubts)
