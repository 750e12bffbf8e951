"""One scene from several exposures: repeats of a path against noise, and adjacent paths against each path alone.

    python -m tests.benchmarks exposures

Rooms of seven tilted rectangles and two boxes, 72 × 96 px, eight views an exposure, random masks, a quarter open, poses
reported by a stage without error (`tests/exposed_rooms.py`: rendered by the solver's renderer, without a light path).
Default preset, masks not registered. `GS2CI_ROOMS=0:3` takes other rooms than the first three,
`GS2CI_PARTS=repeats,orders,even,determined,adjacent` some of the parts, `GS2CI_COUNTS=1,2,4,8` other numbers of
repeats, `GS2CI_DRAWS=0,1,2` repeats with other masks and noise than those of draw 0.

Repeats: one path, fresh masks, white noise of 5 % of a view's full scale in each reading; 1, 2, 4 and 8 exposures. The
last columns are scenes fitted to eight full views instead, read with the same noise: each exposed for one of the eight
intervals of an exposure, and each for two, which is the light that the masks of a coded exposure let through.

Orders: repeats under the same masks in one order, under the same masks of which each exposure begins with another one,
as a capture shows them, and under fresh ones; 1 % noise, `draft`, PSNR of views and scene.

Even: one exposure and eight, each beginning with another mask, by masks as they are drawn and by a bench's even ones
(`gs2ci.rig.patterns`); 1 % noise, `draft`, PSNR of views and scene.

Determined: noise-free repeats decoded together, by fresh masks and by masks that begin with another one, PSNR of a
room's views without any denoiser and by GAP-TV, by how many.

Adjacent paths: four, side by side, 1 % noise. PSNR of recorded views and of the views in the middle of the gaps between
the paths, the latter from the best single scene for each; path error (nATE) over all poses; error of depth, relative,
mean and median, and its mean within two px of an edge of depth, where no other path sees what is seen, and elsewhere;
processor seconds.
"""

import os
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.cameras import in_world
from gs2ci.core.lens import seen_by
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.core.summed import summed
from gs2ci.evaluate.depth import depth_errors
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.novel_views import NovelViews, score_novel_views
from gs2ci.evaluate.trajectory import align, trajectory_errors
from gs2ci.reconstruct import pipeline
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, plug_and_play
from gs2ci.reconstruct.exposures.joint import reconstruct_together, shared_schedule
from gs2ci.reconstruct.exposures.observing import moved, observe_all
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring
from gs2ci.reconstruct.fit.coarse.stage import CoarseRun
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.geometry.depth.view_depths import grid
from gs2ci.reconstruct.geometry.path.motion import rays
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.observe import Tools
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.rig.config import CaptureTable
from gs2ci.rig.patterns import draw_codes
from gs2ci_drivers.plan import first_mask
from gs2ci_sims.scene import Scene
from tests.exposed_rooms import OPEN_SHARE, VIEWS, adjacent, between, camera, exposed, line, repeated, room, seen

SIZE = (72, 96)
COUNTS = tuple(int(count) for count in os.environ.get("GS2CI_COUNTS", "1,2,4,8").split(","))
ORDERS = ("one order", "each begins with another mask", "fresh masks")
DETERMINED = (1, 2, 4, 6, 8, 10, 12, 16)
NOISE = 0.05
HEADER = "adjacent paths: views, between dB; nATE; depth mean, median; at edges, seen by one path, elsewhere; seconds"
_EDGE_PX, _EDGE_STEP = 2, 0.05


def run() -> None:
    """Print both tables."""
    first, last = (int(part) for part in os.environ.get("GS2CI_ROOMS", "0:3").split(":"))
    rooms = [(number, room(number, SIZE)) for number in range(first, last)]
    parts = os.environ.get("GS2CI_PARTS", "repeats,orders,even,determined,adjacent").split(",")
    counts = "".join(f"{count:>8}" for count in COUNTS)
    if "repeats" in parts:
        print(f"repeats, draw {counts}   scene of 8   of 8 full views   of twice the light")
        draws = [int(draw) for draw in os.environ.get("GS2CI_DRAWS", "0").split(",")]
        for number, scene in rooms:
            for draw in draws:
                print(f"room {number}, {draw}".ljust(14) + _repeats(number + 1000 * draw, scene), flush=True)
    if "orders" in parts:
        print(f"\nviews, scene dB: {', '.join(ORDERS)}")
        for number, scene in rooms:
            for count in COUNTS:
                print(f"room {number}, {count}".ljust(14) + _orders(number, scene, count), flush=True)
    if "even" in parts:
        print("\nviews, scene dB: as drawn, even")
        for number, scene in rooms:
            for count in (1, VIEWS):
                print(f"room {number}, {count}".ljust(14) + _even(number, scene, count), flush=True)
    if "determined" in parts:
        number, scene = rooms[0]
        _print_determined(number, scene)
    if "adjacent" in parts:
        print(HEADER)
        for number, scene in rooms:
            gaps = between()
            shots = adjacent(scene, SIZE, number, noise=0.01)
            print(adjacent_rows(f"room {number}", shots, NovelViews(seen(scene, gaps, SIZE)[0], gaps)), flush=True)


def _print_determined(number: int, scene: Scene) -> None:
    print(f"\nnoise-free repeats of room {number}: without denoiser dB, GAP-TV dB; the same in other orders")
    for count in DETERMINED:
        made = _determined(repeated(scene, SIZE, number, count)), _determined(_turned(scene, number, count, 0.0))
        print(f"{count:3}  {'  '.join(made)}", flush=True)


def _settings() -> Settings:
    settings = Settings()
    return replace(settings, registration=replace(settings.registration, mode="off"))


def _determined(shots: list[Shot]) -> str:
    plain = PlugAndPlaySettings(sigmas=(0.1,), iterations=100)
    decoded = plug_and_play(shots, lambda planes, sigma: planes, plain), gap_tv(shots)
    return "  ".join(f"{_psnr(views, shots[0]):6.2f}" for views in decoded)


def _turned(
    scene: Scene, seed: int, count: int, noise: float, *, turned: bool = True, masks: F32 | None = None
) -> list[Shot]:
    """Expose one path several times by the same masks, in other orders or in one."""
    masks = repeated(scene, SIZE, seed, 1)[0].masks if masks is None else masks
    firsts = [first_mask(start, VIEWS) if turned else 0 for start in range(count)]
    return [
        exposed(scene, line(0.0), SIZE, 100 * seed + k, noise=noise, name=f"{k}", masks=np.roll(masks, -first, axis=0))
        for k, first in enumerate(firsts)
    ]


def _orders(seed: int, scene: Scene, count: int) -> str:
    same, turned = (_turned(scene, seed, count, 0.01, turned=turned) for turned in (False, True))
    return _drafts(same, turned, repeated(scene, SIZE, seed, count, noise=0.01))


def _even(seed: int, scene: Scene, count: int) -> str:
    tables = [CaptureTable(masks=VIEWS, density=OPEN_SHARE, seed=seed, even_masks=even) for even in (False, True)]
    masks = [draw_codes(table, SIZE, Path()).astype(np.float32) for table in tables]
    return _drafts(*(_turned(scene, seed, count, 0.01, masks=each) for each in masks))


def _drafts(*every: list[Shot]) -> str:
    """Reconstruct lists of exposures together; return the PSNR of views and scene of each."""
    settings, figures = preset("draft"), []
    settings = replace(settings, registration=replace(settings.registration, mode="off"))
    for shots in every:
        parts = reconstruct_together(shots, settings).parts
        views_db = float(np.mean([_psnr(part.views, shots[0]) for part in parts]))
        figures.append(f"{views_db:8.2f} {_psnr(parts[0].scene_views, shots[0]):6.2f}")
    return "".join(figures)


def _repeats(seed: int, scene: Scene) -> str:
    shots = repeated(scene, SIZE, seed, max(COUNTS), noise=NOISE)
    delivered, of_scene = [], 0.0
    for count in COUNTS:
        parts = reconstruct_together(shots[:count], _settings()).parts
        delivered.append(float(np.mean([_psnr(part.views, shots[0]) for part in parts])))
        of_scene = _psnr(parts[0].scene_views, shots[0])
    full = [_full_views(seed, scene, shots[0], intervals) for intervals in (1.0, 2.0)]
    figures = "".join(f"{psnr:8.2f}" for psnr in delivered)
    return f"{figures}   {of_scene:10.2f}   {full[0]:15.2f}   {full[1]:18.2f}"


def _full_views(seed: int, scene: Scene, coded: Shot, intervals: float) -> float:
    """Fit a scene to eight full views, from the path and the depth of a coded exposure; return its PSNR."""
    observed = next(observe_all([coded], _settings(), Tools.load(_settings()), Silent(), [None]))
    start = observed.in_common(Similarity.identity())
    views, rng = seen(scene, line(0.0), SIZE)[0], np.random.default_rng([seed, 2])
    exposures = []
    for k in range(VIEWS):
        masks = np.zeros((VIEWS, *SIZE), np.float32)
        masks[k] = 1
        reading = intervals * views[k] + NOISE * rng.standard_normal(views[k].shape)
        weights = np.full(VIEWS, intervals, np.float32)
        shot = Shot(reading.astype(np.float32), masks, weights, intrinsics=camera(SIZE)).check()
        renderer = ShotRenderer(shot, start.geometry.intrinsics, load_backend())
        exposures.append(FittedExposure(Holdout.of(shot, 0.02, k), renderer, start.geometry))
    schedule = shared_schedule(_settings().fit, VIEWS, 1.0)
    fit = CoarseRun(exposures, moved(start.start, Similarity.identity()), schedule, seed, Monitoring())
    fit.advance()
    return _psnr(np.stack([one.views[k] for k, one in enumerate(map(fit.result, range(VIEWS)))]), coded)


def _psnr(views: "np.ndarray", shot: Shot) -> float:
    assert shot.truth.views is not None
    return float(np.mean(psnr_per_view(views, shot.truth.views)))


def adjacent_rows(name: str, shots: list[Shot], between: NovelViews) -> str:
    """Reconstruct paths side by side alone and together; return a line of the table for each.

    Args:
        name: Of the scene.
        shots: With truths.
        between: True views between the paths.
    """
    singles, novel, spent, kinds = [], [], 0.0, kinds_of(shots)
    of_all = [np.concatenate(of_shots) for of_shots in zip(*kinds, strict=True)]
    for shot in shots:
        began = time.process_time()
        found = pipeline.reconstruct(shot, _settings())
        spent += time.process_time() - began
        singles.append(_figures(found.result, [shot], kinds[len(singles)]))
        novel.append(_between(found.result, found.scene, shot, between))
    began = time.process_time()
    joint = reconstruct_together(shots, _settings())
    together_s = time.process_time() - began
    best = float(np.mean(np.max(novel, axis=0)))
    found_between = float(np.mean(_between(joint.result, joint.scene, summed(shots, "all"), between)))
    rows = (
        (name, "alone", np.mean(singles, axis=0), best, spent),
        ("", "together", _figures(joint.result, shots, of_all), found_between, together_s),
    )
    return "\n".join(
        f"{whose:8} {how:9} {own[0]:6.2f} {other:6.2f} {own[1]:.4f} {own[2]:.4f} {own[3]:.4f}"
        f"   {own[4]:.4f} {own[5]:.4f} {own[6]:.4f} {seconds:7.1f}"
        for whose, how, own, other, seconds in rows
    )


def _figures(result: RunResult, shots: list[Shot], kinds: list[Bool]) -> tuple[float, ...]:
    """Return PSNR of the views, nATE, mean and median error of depth, and its means over kinds of pixels."""
    whole = summed(shots, "all")
    assert whole.truth.world_to_camera is not None
    assert whole.truth.depth is not None
    assert result.depth is not None
    errors = depth_errors(result.depth, whole.truth.depth, None)
    assert errors is not None
    nate = trajectory_errors(result.world_to_camera, whole.truth.world_to_camera).nate
    known = (whole.truth.depth > 0) & (result.depth > 0)
    off = np.abs(errors.scale * result.depth - whole.truth.depth) / np.where(known, whole.truth.depth, 1)
    by_kind = [float(off[kind & known].mean()) for kind in kinds]
    return _psnr(result.views, whole), nate or 0.0, errors.abs_rel, errors.median_rel, *by_kind


def kinds_of(shots: list[Shot]) -> list[list[Bool]]:
    """Tell of each shot's pixels, [N, H, W], which lie at edges of depth, which no other path sees, and the rest."""
    found = []
    for shot in shots:
        assert shot.truth.depth is not None
        edges = np.stack([_at_edges(depth) for depth in shot.truth.depth])
        alone = ~np.any([_sees(other, shot) for other in shots if other is not shot], axis=0)
        found.append([edges, ~edges & alone, ~edges & ~alone])
    return found


def _sees(other: Shot, shot: Shot) -> Bool:
    """Tell which pixels of a shot, [N, H, W], show what lies within the middle picture of another."""
    truth, seen_from = shot.truth, other.truth.world_to_camera
    assert truth.world_to_camera is not None
    assert truth.depth is not None
    assert shot.intrinsics is not None
    assert seen_from is not None
    along = rays(grid(shot.size, 1), shot.intrinsics)
    points = [
        in_world(along * depth.reshape(-1, 1), pose)
        for depth, pose in zip(truth.depth, truth.world_to_camera, strict=True)
    ]
    inside, _, _ = seen_by(np.concatenate(points), seen_from[len(seen_from) // 2], shot.intrinsics, shot.size)
    return inside.reshape(truth.depth.shape)


def _at_edges(depth: F32) -> Bool:
    """Tell which pixels lie within two px of an edge of depth, [H, W]."""
    wide = np.ones((2 * _EDGE_PX + 1,) * 2, np.uint8)
    far, near = cv2.dilate(depth, wide), cv2.erode(depth, wide)
    found: Bool = np.asarray(far > (1 + _EDGE_STEP) * near, bool)
    return found


def _between(result: RunResult, fitted: Gaussians, shot: Shot, truth: NovelViews) -> list[float]:
    assert shot.truth.world_to_camera is not None
    assert shot.intrinsics is not None
    alignment = align(result.world_to_camera, shot.truth.world_to_camera)
    found: list[float] = score_novel_views(fitted, alignment, shot.intrinsics, truth)["psnr_db"]["per_view"]
    return found
