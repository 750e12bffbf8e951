"""Are the delivered views worse than those of the decode or of the scene? Varied scenes, from smooth to moving.

    python -m tests.benchmarks combination              every scene
    GS2CI_CASES=video python -m tests.benchmarks combination    cases whose names contain that word

Reconstructions of 96 × 72 px: the simulator's scenes, textured, smooth, periodic, noisy, of many views, and with an
object that the scene's model cannot represent; photographs of scikit-image on two planes that move against each other,
sharp and smooth; masks and weights with small errors; and, if `GS2CI_SHARED_DATA`, or `../shared/data` beside the
checkout, contains them, crops of video frames (which no rigid scene explains) and of photographs far apart. The decode
is GAP-TV of all pixels. `given` are the delivered views; the last column is their loss against the better of decode and
scene, negative if they are better than both.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.ndimage import gaussian_filter, rotate, shift
from skimage.data import astronaut, chelsea, coffee, page

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.effects.object_motion import ObjectMotion
from tests.stability.benches import INTERVAL_S, Bench, aside, still
from tests.stability.changes import miscalibrated, noisy, reweighted

SIZE = (72, 96)
PIECE = 96
PHOTOGRAPHS: dict[str, Callable[[], np.ndarray]] = {"astronaut": astronaut, "coffee": coffee, "chelsea": chelsea}
VIDEOS = {"runner": "runner40_cacti.mat", "drop": "drop40_cacti.mat", "traffic": "traffic48_cacti.mat"}


def cases() -> Iterator[tuple[str, Callable[[], Shot]]]:
    """Name every case, and say how its shot is made."""
    yield from _benches()
    yield from _drawn_cases()
    yield from _stored()


def _benches() -> Iterator[tuple[str, Callable[[], Shot]]]:
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
    for share in (0.1, 0.5):
        yield f"{share:g} open", lambda share=share: Bench(open_share=share).expose(SIZE)  # type: ignore[misc]
    yield "laboratory masks", lambda: Bench("boxes", kind="laboratory").expose(SIZE)
    yield "masks known to 5 %", lambda: miscalibrated(0.05)(Bench("thicket", kind="grey").expose(SIZE))
    yield "weights known to 30 %", lambda: reweighted(0.3)(Bench("boxes").expose(SIZE))


def _drawn_cases() -> Iterator[tuple[str, Callable[[], Shot]]]:
    for name, picture in PHOTOGRAPHS.items():
        for blur in (0.0, 2.5):
            yield (
                f"{name}, {'smooth' if blur else 'sharp'}",
                lambda picture=picture, blur=blur: _two_planes(picture()[..., :3], blur),  # type: ignore[misc]
            )
    yield "turning disc", lambda: _turning(0.0)
    yield "turning disc, masks known to 5 %", lambda: _turning(0.05)


def _stored() -> Iterator[tuple[str, Callable[[], Shot]]]:
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


def _two_planes(picture: np.ndarray, blur_px: float) -> Shot:
    """Move a photograph behind a disc of itself, both blurred by so much, and code it with random masks."""
    height, width = SIZE
    step = min(picture.shape[0] // (height + 16), picture.shape[1] // (width + 16))
    sigma = np.hypot(0.4, blur_px) * step
    small = gaussian_filter(picture.astype(float) / 255, (sigma, sigma, 0))[::step, ::step]
    rows, columns = np.ogrid[:height, :width]
    disc = (np.hypot(rows - 0.6 * height, columns - 0.45 * width) < 0.25 * height)[..., None]
    views = []
    for k in range(8):
        far, near = (
            shift(small, (0.1 * pace * k, pace * k, 0), order=1, mode="reflect")[8 : height + 8, 8 : width + 8]
            for pace in (0.3, 0.9)
        )
        views.append(np.where(np.roll(disc, round(0.9 * k), axis=1), near[::-1], far))
    return _coded(_drawn(8), 255 * np.stack(views))


def _turning(noise: float) -> Shot:
    """Turn a disc of text by 6° from view to view before a soft ground, through grey masks known to within noise."""
    height, width = SIZE
    text = page().astype(float)[:height, :height]
    rows, columns = np.mgrid[:height, :width]
    disc = np.hypot(rows - (height - 1) / 2, columns - (width - 1) / 2) < 0.45 * height
    ground = np.broadcast_to(60.0 + 100 * columns / width, SIZE)
    pad = (width - height) // 2
    views = [
        np.where(
            disc, np.pad(rotate(text, 6.0 * k, reshape=False, order=1, mode="nearest"), ((0, 0), (pad, pad))), ground
        )
        for k in range(8)
    ]
    masks = np.random.default_rng(5).random((8, *SIZE)).astype(np.float32)
    shot = _coded(masks, np.stack(views)[..., None])
    return miscalibrated(noise)(shot) if noise else shot


def _drawn(views: int) -> F32:
    return (np.random.default_rng(4).random((views, *SIZE)) < 0.25).astype(np.float32)


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
    under, only = [], os.environ.get("GS2CI_CASES", "")
    for name, make in cases():
        if only not in name:
            continue
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
