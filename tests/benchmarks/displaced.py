"""Paths of small motions from displacements of blocks, beside those of tracks in decoded views.

    python -m tests.benchmarks displaced

The sixty measurements of `depth_order`, 128 × 96 px, behind their random masks and behind one soft pattern that is
displaced by a pixel from view to view (1 % noise). For each source: its verdict, the error of its path as a share of
its extent, and the expected one. Displacements leave the order of depth open more often than not: given are the
solution whose cameras agree with the true ones, the mean cost of a block, and the rank correlation of the map of depth
that a fit begins with. Then cameras without parallax, at rest or turning, and videos of things that no camera explains
(`nonrigid`, 128 × 128 px): no path may be claimed. Nothing is fitted.
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.geometry.reversal import turned
from gs2ci.reconstruct.geometry.sources.displaced import blocks_of, displaced_motion
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.depth_order import COUNT, draw
from tests.benchmarks.nonrigid import behind_one_pattern, exposed, exposed_by_one_pattern, videos
from tests.processes import side_by_side
from tests.stability.benches import Bench, still, turning
from tests.tables.order import depth_rank

MASKS = ("random", "one pattern")
WITHOUT_PARALLAX = {"at rest": still, **{f"turns by {degrees:g}°": turning(degrees) for degrees in (0.1, 0.3, 1, 3)}}
SCENES = ("boxes", "thicket", "motorcycle", "ball", "planes", "corridor")
SIDE = 128
# Paths with a smaller error count as found.
FOUND = 0.15


def run() -> None:
    """Print a line for each measurement, and how many paths each source found."""
    found: Counter[str] = Counter()
    for masks in MASKS:
        for line, sources in side_by_side(judge, [(number, masks) for number in range(COUNT)]):
            found.update(f"{masks}: {source}" for source in sources)
            print(line, flush=True)
    print(f"paths off by less than {FOUND}:", ", ".join(f"{name} {count}" for name, count in sorted(found.items())))
    for name, shot in _without_path():
        print(f"{name:40}", _of_displacements(*_estimated(shot)), flush=True)


def judge(task: tuple[int, str]) -> tuple[str, list[str]]:
    """Return the line of a measurement behind masks, and the sources that found its path."""
    number, masks = task
    trial = draw(number)
    shot = trial.shot if masks == MASKS[0] else behind_one_pattern(trial.shot)
    assert shot.truth is not None
    assert shot.truth.world_to_camera is not None
    poses = shot.truth.world_to_camera
    request, tracks, displaced = _estimated(shot)
    right = min(
        (displaced, *(() if displaced.other_order is None else (turned(displaced),))),
        key=lambda one: trajectory_errors(one.world_to_camera, poses).rotation_deg,
    )
    errors = {"tracks": _error(tracks, poses), "displacements": _error(right, poses)}
    rank = depth_rank(1 / right.inverse_depth, trial.scene.depth) if right.verdict == "full" else None
    what = f"{masks}, {trial.kind}, {trial.field_of_view_deg:.0f}°, {trial.parallax_px:.1f} px"
    line = f"{what:45} tracks {tracks.verdict:13} {_path(errors['tracks'], tracks)}   "
    line += f"{_of_displacements(request, tracks, displaced)} {_path(errors['displacements'], right)}"
    line += "" if rank is None else f" rank {rank:+.2f}"
    return line, [source for source, error in errors.items() if error is not None and error < FOUND]


def _estimated(shot: Shot) -> tuple[Request, Geometry, Geometry]:
    """Return the request about a measurement, and its geometries from tracks and from displacements."""
    settings = Settings()
    seen = Holdout.of(shot.check(), settings.fit.hold_out.share, settings.seed).seen
    request = Request.of(seen, gap_tv(seen, settings.decode, Silent()), settings.geometry, None)
    tracks = from_tracks(request, Silent())
    return request, tracks, displaced_motion(request, tracks)


def _error(found: Geometry, poses: np.ndarray) -> float | None:
    return trajectory_errors(found.world_to_camera, poses).nate if found.verdict == "full" else None


def _path(error: float | None, found: Geometry) -> str:
    return "" if error is None else f"off by {error:.3f}, expected {found.path_error_expected:.3f}"


def _of_displacements(request: Request, tracks: Geometry, displaced: Geometry) -> str:
    blocks = blocks_of(request, tracks)
    if blocks is None:
        return "no blocks"
    return f"{len(blocks):3} blocks, cost {blocks.motion().cost:5.2f}, {displaced.verdict}"


def _without_path() -> Iterator[tuple[str, Shot]]:
    for scene in SCENES:
        for name, path in WITHOUT_PARALLAX.items():
            for kind in ("binary", "laboratory"):
                yield f"{scene}, {kind}, {name}", Bench(scene, path=path, kind=kind).expose((96, 128))
    for name, views in videos(SIDE).items():
        yield f"{name}, random", exposed(views)
        yield f"{name}, one pattern", exposed_by_one_pattern(views)


if __name__ == "__main__":
    run()
