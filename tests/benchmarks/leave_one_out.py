"""What leaving one exposure out changes, foreseen and as it is: fits with and without each exposure.

    python -m tests.benchmarks leave_one_out

Adjacent paths and repeats in rooms, 72 × 96 px, eight views an exposure, masks a quarter open, 1 % and 5 % noise, poses
by a stage (`tests/exposed_rooms.py`), preset draft, masks not registered. `GS2CI_ROOMS=2:3` takes other rooms,
`GS2CI_PRESET=standard` another preset.

For each exposure: the share that it alone sees; how many times as large errors of depth and of the scene's colours at
the others' pixels that it shows as well would be without it, foreseen (`exposures/without_one.py`) and found, root mean
square of colours and median of relative depth errors. At the end the rank correlation of both over all exposures.
"""

import os
from dataclasses import replace

import numpy as np
from scipy.stats import spearmanr

from gs2ci.core.arrays import Bool
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.reconstruct.exposures.joint import reconstruct_together
from gs2ci.reconstruct.exposures.without_one import ViewsTogether
from gs2ci.reconstruct.presets.named import preset
from tests.exposed_rooms import VIEWS, adjacent, repeated, room

SIZE = (72, 96)
COUNT = 4


def run() -> None:
    """Print a row for each exposure."""
    first, last = (int(part) for part in os.environ.get("GS2CI_ROOMS", "0:2").split(":"))
    print("room, exposures              alone   depth foreseen found   colour foreseen found")
    rows: list[tuple[float, float, float, float]] = []
    for number in range(first, last):
        scene = room(number, SIZE)
        for kind, shots in (
            ("path", adjacent(scene, SIZE, number, COUNT, noise=0.01)),
            ("repeat", repeated(scene, SIZE, number, COUNT, noise=0.05)),
        ):
            rows += _rows(number, kind, shots)
    depth, colour = (spearmanr(*np.array(rows).T[pair]).statistic for pair in ([0, 1], [2, 3]))
    print(f"rank correlation of foreseen and found: depth {depth:.2f}, colour {colour:.2f}, {len(rows)} exposures")


def _rows(number: int, kind: str, shots: list[Shot]) -> list[tuple[float, float, float, float]]:
    settings = preset(os.environ.get("GS2CI_PRESET", "draft"))  # type: ignore[arg-type]
    settings = replace(settings, registration=replace(settings.registration, mode="off"))
    whole = reconstruct_together(shots, settings).result
    found = []
    for left_out, said in enumerate(whole.exposures):
        kept = [k for k in range(len(shots)) if k != left_out]
        without = reconstruct_together([shots[k] for k in kept], settings).result
        views = np.concatenate([VIEWS * k + np.arange(VIEWS) for k in kept])
        seen = _seen_by(whole, shots, left_out)[views]
        depth, colour = (
            after / before
            for before, after in zip(
                _errors(whole, views, shots, kept, seen),
                _errors(without, np.arange(len(views)), shots, kept, seen),
                strict=True,
            )
        )
        foreseen = said.without
        assert foreseen is not None
        row = (foreseen.depth_times or np.nan, depth, foreseen.colour_times or np.nan, colour)
        print(f"{number} {kind} {left_out:<20} {foreseen.alone:6.2f}" + "".join(f"{v:12.2f}" for v in row), flush=True)
        found.append(row)
    return found


def _errors(
    result: RunResult, views: np.ndarray, shots: list[Shot], kept: list[int], seen: Bool
) -> tuple[float, float]:
    """Return the median relative error of depth and the rms error of the scene's colours at chosen pixels."""
    depth, colours = (np.concatenate([getattr(shots[k].truth, name) for k in kept]) for name in ("depth", "views"))
    assert result.depth is not None
    known = seen & (depth > 0) & (result.depth[views] > 0)
    off = np.abs(result.depth[views][known] / depth[known] - 1)
    return float(np.median(off)), float(np.sqrt(np.mean(np.square(result.scene_views[views] - colours)[seen])))


def _seen_by(whole: RunResult, shots: list[Shot], exposure: int) -> Bool:
    """Tell which pixels of all views the middle view of an exposure shows as well, by the true depth, [V, H, W]."""
    truth = [shot.truth for shot in shots]
    depth, poses = (np.concatenate([getattr(one, name) for one in truth]) for name in ("depth", "world_to_camera"))
    views = ViewsTogether(
        depth, poses, whole.intrinsics, None, np.ones(len(poses)), np.repeat(range(len(shots)), VIEWS)
    )
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    rays = views.rays(np.stack([columns.ravel(), rows.ravel()], axis=1))
    found = np.zeros(depth.shape, bool)
    for view, pose in enumerate(poses):
        points = (rays * depth[view].reshape(-1, 1) - pose[:3, 3]) @ pose[:3, :3]
        found[view] = views.sees(VIEWS * exposure + VIEWS // 2, points).reshape(SIZE)
    return found
