"""How long the report of a run will take: found by writing small ones. For `--budget`; the commands import it.

Here: the rehearsal. Not here: the report (`gs2ci.evaluate.run_folder`), the plan (`gs2ci.reconstruct.budget.plan`).
"""

import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np
import torch

from gs2ci.core.cameras import pinhole
from gs2ci.core.crop import middle_of
from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Shot
from gs2ci.core.run_records import VERDICTS, RunResult
from gs2ci.evaluate.run_folder import write_run
from gs2ci.evaluate.run_report import build_report
from gs2ci.render.gaussians import Gaussians

_WARM_VIEW_PIXELS: Final = 20_000
_VIEW_PIXELS: Final = 160_000


def report_seconds(shot: Shot) -> float:
    """Predict the seconds that writing the run folder of a shot takes, from a crop of it.

    What is written is of the same kinds and sizes; figures that need the truth are taken where it is known.
    """
    _written(middle_of(shot, _WARM_VIEW_PIXELS))  # loads what draws
    crop = middle_of(shot, _VIEW_PIXELS)
    whole_s = _written(crop)
    # Drawing and packing cost the same for every size; figures grow with the pixels.
    began_s = time.monotonic()
    build_report(crop, _blank(crop))
    larger = shot.size[0] * shot.size[1] / (crop.size[0] * crop.size[1])
    return whole_s + (larger - 1) * (time.monotonic() - began_s)


def _written(shot: Shot) -> float:
    """Write a run folder; return the seconds."""
    result = _blank(shot)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        write_run(Path(folder) / "run", shot, result, _one_gaussian())
    return time.monotonic() - began_s


def _blank(shot: Shot) -> RunResult:
    """Make the result of a run that recovered a grey wall."""
    height, width = shot.size
    grey = np.full((shot.views, height, width, shot.channels), 0.5, np.float32)
    return RunResult(
        views=grey,
        scene_views=grey,
        depth=grey[..., 0],
        world_to_camera=np.tile(np.eye(4), (shot.views, 1, 1)),
        intrinsics=pinhole(width, shot.size),
        decode=grey,
        predicted_measurement=shot.measurement,
        curve=(),
        stopped=finding(Code.FIT_ALL_DONE_UNJUDGED, iterations=0),
        seconds={"total": 0.0, "decode": 0.0, "geometry": 0.0, "fit": 0.0},
        gaussians=1,
        notes=(),
        settings={},
        seed=0,
        verdict="scene",
        heldout_rms=dict.fromkeys(VERDICTS),
    )


def _one_gaussian() -> Gaussians:
    one = torch.zeros(1, 3)
    return Gaussians(one + torch.tensor([0.0, 0.0, 1.0]), one, torch.tensor([[1.0, 0, 0, 0]]), torch.zeros(1), one)
