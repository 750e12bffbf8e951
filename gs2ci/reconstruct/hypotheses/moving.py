"""Still or moving: when moving scenes are fitted, from which starts, and what the report says of it.

    still fit ─► does its residual follow the masks' times, or err its views over time? ─► a moving scene ─► the better

The fit of a still scene mistakes the motion of things for that of the camera, or leaves it in the residual. A
regression that needs no fit (`measurement.moving`) tests whether motion explains the residual; and the brightness of
the still scene's views may surely err over time in places where that of the decode does not (`measurement.over_time`).
The errors of still scenes follow the masks' times too, so that a moving scene only enters the race. It starts from the
flow between the best views so far, with the camera at rest unless its path was given. The held-out pixels choose; a
moving scene has more freedom than a still one, and has to be clearly better.

Here: when, from which start, and the record of it. Not here: the motion (`fit.scene.motion`), the fits (`fitting`), the
choice (`race`).
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.run_figures import MotionSection
from gs2ci.reconstruct.choices import MotionMode
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.scene.mask_moments import mask_times
from gs2ci.reconstruct.fit.scene.motion import moving_share
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.geometry.depth.view_depths import largest_turn_deg, turns_far
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE
from gs2ci.reconstruct.geometry.kinds import PathSource
from gs2ci.reconstruct.geometry.sources.direct import at_rest
from gs2ci.reconstruct.hypotheses.hypothesis import Origin
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.moving import LeftByMotion, left_by_motion
from gs2ci.reconstruct.measurement.over_time import VISIBLE
from gs2ci.render.gaussians import Gaussians

# The names of the attempts in reports.
STILL: Final = "still"
MOVING: Final = Origin.MOVING.value

# The least share of the still fits' residual that motion has to explain, or the least share of blocks in which it
# surely does: a first-order model explains little of a motion that is wider than the detail that moves
# (docs/decisions/moving-scenes.md).
_LEAST_EXPLAINED: Final = 0.015
_LEAST_SURELY: Final = 0.08
# The share by which a moving scene has to reduce the residual at the held-out pixels.
_LEAST_GAIN: Final = 0.02
# A still scene whose held-out residual is at least this many times that of the decode explains hardly more than views
# that share no scene. Where a box crosses half the picture it was 1.02 times as large; on paths that tracks confirm,
# 0.6 to 0.8 times (`python -m tests.stability --only "moving object"`).
BEHIND_DECODE: Final = 0.95
# The same for a whole decode by similar patches, which may move. Photographs far apart, along a path that is right:
# 1.03 times; a real fan, along a path that explains its turning badly: 1.23 times.
BEHIND_PATCHES: Final = 1.1
# The share of the picture in which the still scene surely errs over time, and the decode does not, from which on moving
# scenes are tried. Still scenes had none (39 drawn measurements); photographs far apart, 2 %.
_LEAST_UNFOLLOWED: Final = 0.03
# Moving fits of scenes at rest move by up to a pixel if the path or the depth is wrong: only more is reported as
# motion, px.
_SURELY_PX: Final = 2.0
# What moves less than this over the whole exposure is not reported as moving, px.
_WORTH_SAYING_PX: Final = 0.5
# If the picture, averaged over a few pixels, changes by less than what is visible between the middle of the exposure
# and its ends, no motion is visible there.
_CHANGE_WINDOW_PX: Final = 3


@dataclass(frozen=True)
class MotionQuestion:
    """The tests made before any moving scene is fitted.

    Args:
        left: What motion would explain of the best still fit's residual; None if it was not tested.
        unfollowed: The share of the picture in which the still scene surely errs over time and the decode does not.
    """

    left: LeftByMotion | None = None
    unfollowed: float = 0.0

    @property
    def speaks_for_motion(self) -> bool:
        """Get whether a moving scene should be fitted."""
        by_residual = self.left is not None and (
            self.left.explained >= _LEAST_EXPLAINED or self.left.surely >= _LEAST_SURELY
        )
        return by_residual or self.unfollowed >= _LEAST_UNFOLLOWED


@dataclass(frozen=True)
class MotionReport:
    """Why the scene was fitted as still or as moving.

    Args:
        asked: The mode that the settings request.
        question: The tests made before.
        heldout_rms: The held-out residual of each attempt, by its name.
        chosen: The name of the attempt that was chosen.
        moves: Whether Gaussians move in it.
    """

    asked: MotionMode
    question: MotionQuestion = MotionQuestion()
    heldout_rms: tuple[tuple[str, float | None], ...] = ()
    chosen: str = ""
    moves: bool = False

    @property
    def tried(self) -> bool:
        """Get whether fits that move were made."""
        return self.moves or bool(self.heldout_rms)

    @property
    def polishing(self) -> tuple[PatchSettings, ...]:
        """Get the dense schedules by which the patch decode may continue from refined views, unless things surely rest.

        The first changes nearly right ones little; the second is for those that err by a few hundredths of full scale.
        """
        little, much = (PatchSettings(iterations=n, first_sigma=sigma / 255) for n, sigma in ((8, 10), (32, 25)))
        left = dict(self.heldout_rms)
        rests = not self.moves and clearly_less(left.get(STILL), left.get(MOVING))
        return (little, much) if self.tried and not rests else ()

    def summary(self, speeds: "Speeds | None") -> MotionSection:
        """Return the figures for the report."""
        left = self.question.left
        return MotionSection(
            asked=self.asked,
            tried=self.tried,
            moves=self.moves,
            explained=None if left is None else left.explained,
            blocks=None if left is None else left.surely,
            unfollowed=self.question.unfollowed,
            heldout_rms=dict(self.heldout_rms),
            chosen=self.chosen,
            gaussians_share=None if speeds is None else speeds.gaussians_share,
            pixels_share=None if speeds is None else speeds.pixels_share,
            median_px=None if speeds is None else speeds.median_px,
            most_px=None if speeds is None else speeds.most_px,
        )

    def notes(self, speeds: "Speeds | None", path: F64 | None) -> Findings:
        """Report what moves, or that moving scenes were tried and not confirmed.

        Args:
            speeds: Of the scene; None if it is still.
            path: World-to-camera poses, [N, 4, 4], of a path or of a camera known to be at rest; None if neither was
                found.
        """
        if speeds is not None and speeds.most_px < _SURELY_PX:
            return (finding(Code.MOTION_SMALL, most_px=speeds.most_px),)
        if speeds is not None:
            share, median_px = speeds.pixels_share, speeds.median_px
            if path is not None and turns_far(path):
                turn_deg = largest_turn_deg(path)
                return (finding(Code.MOTION_AROUND, share=share, median_px=median_px, turn_deg=turn_deg),)
            # Where most of the picture moves and no camera path was found, the camera may have moved instead.
            whole = path is None and share > 0.5
            code = Code.MOTION_OR_CAMERA if whole else Code.SCENE_MOVES
            return (finding(code, share=share, median_px=median_px, most_px=speeds.most_px),)
        left = self.question.left
        if left is not None and self.heldout_rms:
            return (finding(Code.MOTION_NOT_TAKEN, explained=left.explained),)
        return ()


@dataclass(frozen=True)
class Speeds:
    """How far things move in the picture over the whole exposure, seen from the camera of the middle view.

    Args:
        displacement_px: Displacement of what each pixel shows, [H, W, 2] float32 as (x, y).
        pixels_share: Share of pixels that visibly move by at least half a pixel.
        gaussians_share: Share of the Gaussians' opacity that moves at all.
        median_px: Median displacement of the moving pixels; 0 if none moves.
        most_px: Their 99th percentile.
    """

    displacement_px: F32
    pixels_share: float
    gaussians_share: float
    median_px: float
    most_px: float


def rested(first: FirstLook) -> FirstLook:
    """Return the first look with a camera at rest, since an estimated path may be the motion of things.

    A given path is kept, and so is a camera that was found to stand still or only to turn.
    """
    if not (first.geometry.has_path and first.geometry.is_estimated):
        return first
    rest = at_rest(first.geometry)
    return replace(first, geometry=replace(rest, source=PathSource.TRACKS, notes=(*rest.notes, PLANE_NOTE)))


def ask(holdout: Holdout, views: F32) -> LeftByMotion:
    """Test whether motion explains the residual that still views, [N, H, W, C], leave of the measurement."""
    return left_by_motion(holdout, views, mask_times(len(views)).double().numpy())


def clearly_less(one: float | None, other: float | None) -> bool:
    """Tell whether a held-out residual is so much smaller than another that this is not chance."""
    return one is not None and other is not None and one < (1 - _LEAST_GAIN) * other


def speeds(renderer: ShotRenderer, scene: Gaussians, world_to_camera: F64) -> Speeds | None:
    """Measure how far things move in the picture; None for a scene without motion.

    What moves without changing the picture, such as a plain wall along itself, counts as at rest.

    Args:
        renderer: Of the shot.
        scene: The Gaussians.
        world_to_camera: Poses of all views, [N, 4, 4].
    """
    if scene.motion is None:
        return None
    middle = len(world_to_camera) // 2
    pose = torch.from_numpy(world_to_camera[middle]).float()
    scene = scene.detach()
    ends = [_on_screen(scene.at(moment).means, pose, renderer.intrinsics) for moment in (-1.0, 1.0)]
    shift = ends[1] - ends[0]
    colours = torch.cat([shift, torch.ones(len(scene), 1)], dim=1)[None]
    image, _ = renderer.images(scene, pose[None], colours, torch.zeros(1))
    weight = image[0, :, :, 2:].clamp(min=1e-3)
    shown = renderer.views(scene, pose[None].repeat(3, 1, 1), torch.tensor([-1.0, 0.0, 1.0]))
    change = np.abs(shown[[0, 2]] - shown[1]).max(axis=(0, 3))
    visible = cv2.blur(change, (_CHANGE_WINDOW_PX, _CHANGE_WINDOW_PX)) >= VISIBLE
    displacement: F32 = (image[0, :, :, :2] / weight).numpy() * visible[..., None]
    length = np.linalg.norm(displacement, axis=2)
    moves = length >= _WORTH_SAYING_PX
    return Speeds(
        displacement_px=displacement,
        pixels_share=float(moves.mean()),
        gaussians_share=moving_share(scene),
        median_px=float(np.median(length[moves])) if moves.any() else 0.0,
        most_px=float(np.quantile(length[moves], 0.99)) if moves.any() else 0.0,
    )


def _on_screen(means: torch.Tensor, pose: torch.Tensor, intrinsics: torch.Tensor) -> torch.Tensor:
    """Project centres, [G, 3], to pixels, [G, 2]; those behind the camera get some finite place."""
    points = means @ pose[:3, :3].T + pose[:3, 3]
    slopes = points[:, :2] / points[:, 2:].clamp(min=1e-2)
    return slopes * intrinsics.diagonal()[:2] + intrinsics[:2, 2]
