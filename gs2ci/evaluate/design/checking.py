"""How well exposures serve: their reconstruction, judged by the views that are wanted.

Here: this. Not here: the exposures (`gs2ci.rig.design`), what is foreseen of them without a reconstruction.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.evaluate.novel_views import NovelViews, score_novel_views
from gs2ci.evaluate.trajectory import align
from gs2ci.reconstruct.choices import PresetName
from gs2ci.reconstruct.exposures.joint import reconstruct_together
from gs2ci.reconstruct.presets.named import preset

# Of several exposures' time, the share that grows with their number: each is observed by itself. The rest, the common
# fit, grows with its root (`gs2ci.reconstruct.exposures.joint`). Four together take 0.57 of the time of four
# (`python -m tests.benchmarks exposures`).
_EACH: Final = 0.15


@dataclass(frozen=True)
class Checked:
    """What a reconstruction gave.

    Args:
        psnr_db: Of the wanted views, in the recovered scene; of the mean of their square errors.
        views_db: Of the views of the first exposure.
        seconds: Of computing.
    """

    psnr_db: float
    views_db: float
    seconds: float


def checked(
    shots: Sequence[Shot],
    wanted: NovelViews,
    intrinsics: F64,
    name: PresetName,
    seed: int,
    clock: Callable[[], float] = time.monotonic,
) -> Checked:
    """Reconstruct exposures together, and judge the scene by the wanted views.

    Args:
        shots: Exposures of the same path, with true poses and views. Their masks are taken to be calibrated, and poses
            of a stage, if there are any, to be right.
        wanted: The views that are wanted.
        intrinsics: Of these, [3, 3].
        name: A preset.
        seed: Of every random draw.
        clock: The time, s.

    Raises:
        Gs2ciError: The exposures cannot be reconstructed.
    """
    settings = replace(preset(name), seed=seed, uncertainty=False)
    # In a small picture tracks tell so little that they may seem to contradict a stage that is right.
    poses = "auto" if shots[0].telemetry_world_to_camera is None else "stage"
    settings = replace(settings, poses=poses, registration=replace(settings.registration, mode="off"))
    began_s = clock()
    joint = reconstruct_together(shots, settings)
    seconds = clock() - began_s
    recorded, path = shots[0].truth.views, shots[0].truth.world_to_camera
    assert recorded is not None
    assert path is not None
    alignment = align(joint.result.world_to_camera, np.concatenate([path] * len(joint.parts)))
    scores = score_novel_views(joint.scene, alignment, intrinsics, wanted)["psnr_db"]["per_view"]
    error = float(np.mean(np.square(joint.parts[0].views - recorded, dtype=np.float64)))
    return Checked(mean_db(scores), -10 * float(np.log10(max(error, 1e-12))), seconds)


def mean_db(values: Sequence[float]) -> float:
    """Return the peak signal-to-noise ratio of the mean of square errors, dB."""
    return -10 * float(np.log10(np.mean(10 ** (-np.asarray(values, np.float64) / 10))))


def expected_seconds(pace_s: float, masks: int, exposures: int, pixels: int) -> float:
    """Return how long a reconstruction is expected to take.

    Args:
        pace_s: Seconds per view and pixel of one exposure (`pace`).
        masks: Views of an exposure.
        exposures: How many.
        pixels: Of the picture.
    """
    return pace_s * masks * pixels * _share(exposures)


def pace(seconds: float, masks: int, exposures: int, pixels: int) -> float:
    """Return the seconds per view and pixel of one exposure, from how long a reconstruction took."""
    return seconds / (masks * pixels * _share(exposures))


def _share(exposures: int) -> float:
    return float(_EACH * exposures + (1 - _EACH) * np.sqrt(exposures))
