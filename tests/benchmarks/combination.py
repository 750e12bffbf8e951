"""Whether the views that are handed over are worse than the decode's or the scene's: varied scenes, smooth to moving.

Whole reconstructions of 96 × 72 px, 250 iterations, of the simulator's scenes: textured, smooth, periodic, noisy, of
many views, and with an object that the scene's model does not know; where `GS2CI_SHARED_DATA`, or `../shared/data`
beside the checkout, holds them, pieces of video frames (which no rigid scene explains) and of far-apart photographs as
well. The decode is GAP-TV of all pixels. `given` is what is handed over; the last column is how far it lies under the
better of decode and scene, negative where it is better than both. Half an hour.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.effects.object_motion import ObjectMotion
from tests.stability.benches import INTERVAL_S, Bench, aside, still
from tests.stability.changes import noisy

SIZE = (72, 96)
PIECE = 96
VIDEOS = {"runner": "runner40_cacti.mat", "drop": "drop40_cacti.mat", "traffic": "traffic48_cacti.mat"}


def cases() -> Iterator[tuple[str, Callable[[], Shot]]]:
    """Name every case, and say how its shot is made."""
    for name in ("planes", "thicket", "boxes", "ball", "corridor", "motorcycle"):
        yield name, lambda name=name: Bench(name).expose(SIZE)  # type: ignore[misc]
    for name in ("soft gradient", "chequerboard", "stripes", "grey wall", "spots"):
        yield name, lambda name=name: Bench(name, path=aside(0.05)).expose(SIZE)  # type: ignore[misc]
    for speed in (0.15, 0.6, 2.0):
        way = (speed / (8 * INTERVAL_S), 0.3 * speed / (8 * INTERVAL_S), 0.0)
        thing = ObjectMotion((-0.4, -0.25, 3.0), 0.45, way)
        yield f"object moving by {speed:g}", lambda thing=thing: Bench("moving", effects=(thing,)).expose(SIZE)  # type: ignore[misc]
    for percent in (2, 5, 20):
        yield f"noise {percent} %", lambda percent=percent: noisy(percent / 100)(Bench().expose(SIZE))  # type: ignore[misc]
    yield "40 photons", lambda: Bench(photons=40).expose(SIZE)
    for views in (3, 16, 32):
        yield f"{views} views", lambda views=views: Bench(views=views).expose(SIZE)  # type: ignore[misc]
    yield "camera at rest", lambda: Bench(path=still).expose(SIZE)
    beside = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    data = Path(os.environ.get("GS2CI_SHARED_DATA", beside))
    for name, file in VIDEOS.items():
        if (data / "video_sci" / file).is_file():
            for top, left in ((64, 64), (140, 120)):
                yield (
                    f"video {name}, {top}",
                    lambda path=data / "video_sci" / file, top=top, left=left: _video(path, top, left),  # type: ignore[misc]
                )
    if (data / "fern_photos_wide.npz").is_file():
        for top, left in ((60, 60), (150, 200)):
            yield (
                f"photographs, {top}",
                lambda path=data / "fern_photos_wide.npz", top=top, left=left: _photographs(path, top, left),  # type: ignore[misc]
            )


def _video(path: Path, top: int, left: int) -> Shot:
    stored = loadmat(path)
    rows, columns = slice(top, top + PIECE), slice(left, left + PIECE)
    masks = stored["mask"].transpose(2, 0, 1)[:, rows, columns].astype(np.float32)
    return _coded(masks, stored["orig"].transpose(2, 0, 1)[: len(masks), rows, columns, None])


def _photographs(path: Path, top: int, left: int) -> Shot:
    stored = np.load(path)
    rows, columns = slice(top, top + PIECE), slice(left, left + PIECE)
    return _coded(stored["masks"][:, rows, columns].astype(np.float32), stored["truth"][:, rows, columns])


def _coded(masks: F32, bytes_: np.ndarray) -> Shot:
    views = np.ascontiguousarray(bytes_, np.float32) / np.float32(255)
    light = np.einsum("nhw,nhwc->hwc", masks, views)
    return Shot(light, np.ascontiguousarray(masks), np.ones(len(masks), np.float32), truth=Truth(views)).check()


def run() -> None:
    """Print the table."""
    settings = Settings()
    settings = replace(settings, fit=replace(settings.fit, iterations=250), look_again=False)
    print(f"{'scene':24s} decode   scene   given  verdict    under the better of the two, dB")
    under = []
    for name, make in cases():
        shot = make()
        result = reconstruct(shot, settings).result
        decode, scene, given = (_psnr(views, shot) for views in (gap_tv(shot), result.scene_views, result.views))
        under.append(max(decode, scene) - given)
        print(
            f"{name:24s} {decode:6.2f}  {scene:6.2f}  {given:6.2f}  {result.verdict:8s}  {under[-1]:+.2f}", flush=True
        )
    print(
        f"{len(under)} scenes: {np.mean(under):+.2f} dB on average, {max(under):+.2f} at worst, "
        f"{sum(one > 0.1 for one in under)} by more than 0.1"
    )


def _psnr(views: F32, shot: Shot) -> float:
    assert shot.truth.views is not None
    return float(np.mean(psnr_per_view(np.clip(views, 0, 1), shot.truth.views)))
