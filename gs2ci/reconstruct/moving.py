"""Still or moving: when a scene is let move, from which beginnings, and what is said of it.

    still fits ─► does their residual follow the masks' times? ─► do patches that may move explain more?
    ─► moving fits ─► the better

A still scene takes the motion of things for that of the camera, or leaves it unexplained. What it leaves is asked by a
regression that needs no fit (`measurement.moving`). Fits of scenes at rest err in ways that follow the masks' times
too, so where it speaks for motion a decode by similar patches, which may move, goes on from the fits' views for a few
steps; only where that explains clearly more, or where the still scene explains hardly more than the decode, Gaussians
that move are fitted as well: the still fits go on and are let move, along their path; and fits begin anew, before a
camera at rest, from the flow between the views. The held-out pixels choose, and a moving scene has to be clearly
better: it has more freedom than a still one. Here: when, from where, and the record of it. Not here: the motion
(`fit.motion`), the fits (`fits`), the choice (`attempts`).
"""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import torch

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.reconstruct.choices import MotionMode
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.first_look import FirstLook, from_rest
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.mask_moments import mask_times
from gs2ci.reconstruct.fit.motion import moving_share
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.jury import Jury
from gs2ci.reconstruct.measurement.moving import LeftByMotion, left_by_motion
from gs2ci.render.gaussians import Gaussians

# The attempts, by their names in reports.
STILL: Final = "still"
RELEASED: Final = "released from the still scene"
MOVING: Final = "moving from the first"

# Of the still fits' residual, and of its blocks, so much at least has to follow the times of the masks
# (`python -m tests.benchmarks moving`).
_LEAST_EXPLAINED: Final = 0.01
_LEAST_SURELY: Final = 0.04
# So many of the blocks that speak for motion are enough: what moves by more than its detail is wide explains little to
# first order. A box that crosses half the picture: 0.9 % explained, 37 % of the blocks.
_MANY_BLOCKS: Final = 0.25
# What a moving scene has to take off the residual on the held-out pixels.
LEAST_GAIN: Final = 0.02
# What a few steps of a decode by similar patches have to take off it before moving scenes are tried. From ten still
# measurements they took up to 4.7 %, as detail is alike in many places; from three crops of video 8.3 % and more.
LEAST_PATCH_GAIN: Final = 0.065
# A still scene that leaves so many times what the decode leaves, which knows of no scene, gains nothing by being one:
# where a box crosses half the picture it left 1.02 times as much, on paths that tracks bear out 0.6 to 0.8
# (`python -m tests.stability --only "moving object"`).
BEHIND_DECODE: Final = 0.95
# Where patches take less off it than this, what it lacks is not motion: a real fan, 1.5 %; that box, 4.9 %.
LEAST_GAIN_BEHIND: Final = LEAST_PATCH_GAIN / 2
# Fits of scenes at rest whose path or depth errs are let move by up to a pixel: only more is said to be motion, px.
_SURELY_PX: Final = 2.0
# What moves less than this over the whole exposure is not said to move, px.
_WORTH_SAYING_PX: Final = 0.5
# Where the picture changes by less between the middle of the exposure and its ends, full scale 1, a few pixels around,
# nothing is seen to move.
_VISIBLE_CHANGE: Final = 0.02
_CHANGE_WINDOW_PX: Final = 3


@dataclass(frozen=True)
class MotionQuestion:
    """What was found out before any scene was let move.

    Args:
        left: What motion would explain of the still fits' residual; None where nobody asked.
        gain: By which share a few steps of the patch decode leave less of the held-out pixels than the still scene's
            refined views; None where they were not tried.
        behind_decode: Whether the best still scene leaves hardly less of them than the decode, or more.
    """

    left: LeftByMotion | None = None
    gain: float | None = None
    behind_decode: bool = False

    @property
    def speaks_for_motion(self) -> bool:
        """Get whether scenes that move are worth their fits."""
        return (self.gain or 0.0) >= (LEAST_GAIN_BEHIND if self.behind_decode else LEAST_PATCH_GAIN)


@dataclass(frozen=True)
class MotionReport:
    """How a scene came to move, or not to.

    Args:
        asked: What the settings ask for.
        question: What was found out before.
        heldout_rms: What each attempt leaves of the held-out pixels, by its name.
        chosen: The name of the attempt that was taken.
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
        """Get by which dense schedules the patch decode may go on from the refined views."""
        if self.tried:
            return PatchSettings.polish(), PatchSettings.from_scene()
        return ()

    def summary(self, speeds: "Speeds | None") -> dict[str, object]:
        """Return it as plain values."""
        left = self.question.left
        return {
            "asked": self.asked,
            "tried": self.tried,
            "moves": self.moves,
            "explained": None if left is None else left.explained,
            "blocks": None if left is None else left.surely,
            "patch_gain": self.question.gain,
            "behind_decode": self.question.behind_decode,
            "heldout_rms": dict(self.heldout_rms),
            "chosen": self.chosen,
            "gaussians_share": None if speeds is None else speeds.gaussians_share,
            "pixels_share": None if speeds is None else speeds.pixels_share,
            "median_px": None if speeds is None else speeds.median_px,
            "most_px": None if speeds is None else speeds.most_px,
        }

    def notes(self, speeds: "Speeds | None") -> tuple[Finding, ...]:
        """Say what moves, or that motion was looked for and not borne out."""
        if speeds is not None and speeds.most_px < _SURELY_PX:
            return (finding(Code.MOTION_SMALL, most_px=speeds.most_px),)
        if speeds is not None:
            return (
                finding(
                    Code.SCENE_MOVES,
                    share=speeds.pixels_share,
                    median_px=speeds.median_px,
                    most_px=speeds.most_px,
                ),
            )
        left = self.question.left
        if left is not None and self.heldout_rms:
            return (finding(Code.MOTION_NOT_TAKEN, explained=left.explained),)
        return ()


@dataclass(frozen=True)
class Speeds:
    """How fast things go in the picture, over the whole exposure and seen from the camera of the middle view.

    Args:
        displacement_px: Of what each pixel shows, [H, W, 2] float32 as (x, y).
        pixels_share: Of the pixels that are seen to move by at least half a pixel.
        gaussians_share: Of the Gaussians' opacity that moves at all.
        median_px: How far the moving pixels move, in the median; 0 where none does.
        most_px: The same of the fastest hundredth of them.
    """

    displacement_px: F32
    pixels_share: float
    gaussians_share: float
    median_px: float
    most_px: float


def rested(first: FirstLook) -> FirstLook:
    """Return the first look with a camera at rest: a path that was found may be the motion of things.

    A path that was told stays, and so does a camera that was found to stand still or only to turn.
    """
    found = first.geometry.verdict == "full" and first.geometry.source in ("tracks", "wide", "uniform")
    return from_rest(first) if found else first


def released(fit: CoarseSettings) -> CoarseSettings:
    """Return the schedule by which a fitted still scene is let move: half as long, at half the step, without newcomers.

    A turn of the density rule would set back what has been fitted, and surfaces have had their say.
    """
    return replace(
        fit,
        iterations=max(1, fit.iterations // 2),
        densify_until=0.0,
        surfaces=None,
        relief=None,
        steps=replace(fit.steps, means=fit.steps.means / 2, motion=fit.steps.motion / 3),
    )


def ask(jury: Jury, views: F32) -> LeftByMotion:
    """Ask what still views, [N, H, W, C], leave of the measurement whether something moves."""
    return left_by_motion(jury, views, mask_times(len(views)).double().numpy())


def speaks_for_motion(left: LeftByMotion) -> bool:
    """Tell whether a residual is worth the fits of a moving scene."""
    explains = left.explained >= _LEAST_EXPLAINED and left.surely >= _LEAST_SURELY
    return explains or left.surely >= _MANY_BLOCKS


def speeds(renderer: ShotRenderer, scene: Gaussians, world_to_camera: F64) -> Speeds | None:
    """Measure how fast things move in the picture; None where nothing can.

    What moves without changing the picture, an even wall along itself, is not seen to move and counts as at rest.

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
    visible = cv2.blur(change, (_CHANGE_WINDOW_PX, _CHANGE_WINDOW_PX)) >= _VISIBLE_CHANGE
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
    """Return where centres, [G, 3], are seen, [G, 2] in px; those behind the camera anywhere, but finite."""
    points = means @ pose[:3, :3].T + pose[:3, 3]
    slopes = points[:, :2] / points[:, 2:].clamp(min=1e-2)
    return slopes * intrinsics.diagonal()[:2] + intrinsics[:2, 2]
