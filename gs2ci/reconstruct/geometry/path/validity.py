"""When a geometry is valid: all criteria in one place.

Here: the criteria and the verdict on tracks and motion. Not here: estimating either, or the fallbacks (`initialise`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import Bool, Size
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.reconstruct.geometry.kinds import Verdict
from gs2ci.reconstruct.geometry.path.halves import CELLS, cells
from gs2ci.reconstruct.geometry.path.motion import CameraMotion, wander_px
from gs2ci.reconstruct.geometry.path.rotations import Rotations
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks


@dataclass(frozen=True)
class Criteria:
    """What tracks and motion must satisfy.

    Args:
        tracks: Fewest tracks. A view has 6 unknowns and a track 1, so 20 tracks in two views leave some redundancy.
        tracks_per_view: Fewest tracks that a view must see to count as supported.
        coverage: Least share of the cells of an 8x8 grid over the reference view that hold a track.
        inliers: Least share of the tracks that the motion explains.
        rms_px: Largest reprojection error of the explained tracks.
        unexplained: Least ratio of the errors along the tracks under pure rotations to those under the full motion, per
            degree of freedom. On views decoded from a camera that did not move or only turned it was 0.9 to 1.03,
            with a parallax about as large as the noise 1.15 to 1.5, with more parallax 2 and above. Lens distortion,
            known or not, does not affect it, since all views are distorted alike: ±0.2 in k1 gave 0.97 to 1.02 for
            turning cameras and 1.4 to 3.1 for moving ones, instead of 0.97 to 1.02 and 1.4 to 2.7.
        unexplained_by_two: The same for two views, in which each track has a single error: errors per degree of
            freedom. A translation explains one of their two components; decoded views of turned cameras gave 1.0 to
            1.3.
        agreement: Expected error of the path (`halves`), as a share of its extent, up to which it is accepted as a
            motion even if pure rotations leave hardly larger errors: if a path came from the tracks' errors, each half
            of them would give a different one. For cameras that did not move or only turned it was 0.11 to 0.31, once
            0.10 (`python -m tests.benchmarks no_motion`).
        parallax_px: Least parallax: the part that translation explains beyond the best rotations.
        displacement_px: Median displacement by the best rotations below which the camera counts as still.
        behind: Largest share of tracks that may lie behind a camera.
        turn_deg: Largest turn of a view that sees tracks against the reference view. Tracking already fails for smaller
            turns; a motion that turns more comes from tracks that jumped along a repeating texture.
        path_error: Expected error of the path (`halves`), as a share of its extent, from which on the report doubts it.
            Simulated scenes with texture all over the frame stay below it; small boxes in front of plain walls, whose
            paths err by 7 to 20 %, do not.
        order_errors: By so many standard errors tracks must prefer an order of depth for it to be accepted without
            a doubt. They preferred a wrong order by up to 4, with a principal point that moved and a narrow field of
            view.
    """

    tracks: int = 20
    tracks_per_view: int = 10
    coverage: float = 0.1
    inliers: float = 0.25
    rms_px: float = 2.0
    unexplained: float = 1.1
    unexplained_by_two: float = 1.6
    agreement: float = 0.1
    parallax_px: float = 0.25
    displacement_px: float = 0.5
    behind: float = 0.05
    turn_deg: float = 45.0
    path_error: float = 0.05
    order_errors: float = 6.0


def supported_views(tracks: Tracks, criteria: Criteria) -> Bool:
    """Find the views that see enough tracks, [N]; the reference view counts as one of them."""
    supported: Bool = tracks.seen.sum(0) >= criteria.tracks_per_view
    supported[tracks.reference] = True
    return supported


def coverage(tracks: Tracks, size: Size) -> float:
    """Get the share of an 8x8 grid over the reference view that holds a track."""
    return len(np.unique(cells(tracks, size))) / CELLS**2


def doubts_about_tracks(tracks: Tracks, size: Size, criteria: Criteria) -> Findings:
    """Return the reasons why these tracks cannot support any motion; none if they can."""
    doubts = []
    if len(tracks) < criteria.tracks:
        doubts.append(finding(Code.FEW_TRACKS, tracks=len(tracks), needed=criteria.tracks))
    elif (share := coverage(tracks, size)) < criteria.coverage:
        doubts.append(finding(Code.CLUSTERED_TRACKS, share=share, needed=criteria.coverage))
    views = tracks.positions.shape[1]
    supported = int(supported_views(tracks, criteria).sum())
    if supported < 2 or supported < views / 2:
        each = criteria.tracks_per_view
        doubts.append(finding(Code.FEW_VIEWS_TRACKED, views=supported, of=views, tracks=each))
    return tuple(doubts)


def parallax_px(motion: CameraMotion, rotations: Rotations) -> float:
    """Get the part of the tracks that translation explains beyond the best rotations, root mean square."""
    return float(np.sqrt(max(rotations.rms_px**2 - motion.rms_px**2, 0.0)))


def has_parallax(motion: CameraMotion, rotations: Rotations, criteria: Criteria) -> bool:
    """Decide whether the tracks need a translation of the camera, and not just rotations and noise."""
    if parallax_px(motion, rotations) < criteria.parallax_px:
        return False
    moving = wander_px(motion.errors_px, unknowns=1)
    if moving > 0:
        return wander_px(rotations.errors_px) > criteria.unexplained * moving
    # Two views: each track has 2 errors; the full motion has 1 unknown for each and 6 for the view, rotations only 3.
    sightings = int((~np.isnan(motion.errors_px[..., 0])).sum())
    noise_full = motion.rms_px / np.sqrt(max(sightings - 6, 1))
    noise_rotation = rotations.rms_px / np.sqrt(max(2 * sightings - 3, 1))
    return bool(noise_rotation > criteria.unexplained_by_two * noise_full)


def classify_motion(
    candidates: int, tracks: Tracks, motion: CameraMotion, rotations: Rotations, criteria: Criteria
) -> tuple[Verdict, Findings]:
    """Decide whether the camera moved, only turned or stood still; give reasons for any verdict but "full".

    Args:
        candidates: Number of tracks before those that the motion does not explain were dropped.
        tracks: The explained tracks.
        motion: The full motion fitted to them.
        rotations: Pure rotations fitted to them.
        criteria: What must be satisfied.
    """
    if not has_parallax(motion, rotations, criteria):
        if rotations.displacement_px < criteria.displacement_px:
            return Verdict.STATIC, (finding(Code.CAMERA_STOOD_STILL, displacement_px=rotations.displacement_px),)
        if rotations.rms_px > criteria.parallax_px:  # a parallax that matters may hide in errors of this size
            apart = finding(Code.PARALLAX_MAY_DROWN, rotations_px=rotations.rms_px, motion_px=motion.rms_px)
            return Verdict.ROTATION_ONLY, (apart,)
        return Verdict.ROTATION_ONLY, (finding(Code.CAMERA_ONLY_TURNED, rotations_px=rotations.rms_px),)
    doubts = contradictions(candidates, tracks, motion, criteria)
    return (Verdict.UNSUPPORTED if doubts else Verdict.FULL), doubts


def contradictions(candidates: int, tracks: Tracks, motion: CameraMotion, criteria: Criteria) -> Findings:
    """Return how the tracks contradict a motion; nothing if they confirm it. Arguments as for `classify_motion`."""
    doubts = []
    if len(tracks) < max(criteria.inliers * candidates, criteria.tracks):
        doubts.append(finding(Code.FEW_TRACKS_EXPLAINED, tracks=len(tracks), of=candidates))
    if motion.rms_px > criteria.rms_px:
        doubts.append(finding(Code.TRACKS_BADLY_EXPLAINED, rms_px=motion.rms_px, needed_px=criteria.rms_px))
    if motion.behind_share > criteria.behind:
        doubts.append(finding(Code.POINTS_BEHIND_CAMERA, share=motion.behind_share))
    # Between the reference view and a view that sees tracks.
    turns = Rotation.from_matrix(motion.rotations[tracks.seen.any(axis=0)]).magnitude()
    if (turn_deg := float(np.degrees(np.max(turns, initial=0.0)))) > criteria.turn_deg:
        doubts.append(finding(Code.TURN_TOO_LARGE, turn_deg=turn_deg, most_deg=criteria.turn_deg))
    return tuple(doubts)


def halves_agree(expected: float | None, criteria: Criteria) -> bool:
    """Tell whether halves of the points agree on a path so well that it is a motion, and not their errors.

    Args:
        expected: Error of the path, from halves; None, if it is not known: halves do not agree.
        criteria: With the largest such error.
    """
    return expected is not None and expected <= criteria.agreement


def doubts_about_path(expected: float | None, criteria: Criteria) -> Findings:
    """Return the finding that a path with this expected error is unreliable, or nothing."""
    if expected is None or expected <= criteria.path_error:
        return ()
    return (finding(Code.PATH_UNCERTAIN, share=expected),)
