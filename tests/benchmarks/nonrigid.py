"""Videos with motion that is not a camera's: decoders, and the result of a reconstruction.

    python -m tests.benchmarks nonrigid
    python -m tests.benchmarks.nonrigid SIDE [WHAT ...]    256 takes decoders at the size of the published clips; WHAT
                                                           of decoders, reconstruct; or names of videos

Data: photographs of scikit-image, moved by resampling: a disc that moves against its background, a disc that rotates in
front of a wall, a photograph that bends, one that grows, rectangles that move independently. Eight views, grey, random
masks of which half is open, no noise. And two as in many laboratories: a ball that falls before a camera at rest and
flattens, three bars that topple, both blurred by their motion. Ten views, grey; one random pattern with soft edges,
displaced by a pixel from view to view, and about 1 % noise. There are no published results for them.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from skimage import data

from gs2ci.core.arrays import F32
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import choose_coupling, gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import decode_until, patch_decode
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from tests.benchmarks.decoders import AS_PUBLISHED

VIEWS = 8
TIMES = np.arange(VIEWS) - (VIEWS - 1) / 2
BUDGET_S = 5.0


def videos(side: int) -> dict[str, F32]:
    """Make the videos, [N, side, side, 1] each."""
    rows, columns = np.mgrid[:side, :side].astype(np.float32)
    middle = (side - 1) / 2
    apart = np.hypot(columns - middle, rows - middle)

    def crossing(time: float) -> F32:
        back = _sampled("camera", columns + 90 - 1.2 * time, rows + 60)
        front = _sampled("astronaut", columns + 80 + 2.5 * time, rows + 30)
        return _before(front, back, np.hypot(columns - middle + 2.5 * time, rows - middle) < 0.22 * side)

    def rotation(time: float) -> F32:
        sine, cosine = np.sin(np.deg2rad(3 * time)), np.cos(np.deg2rad(3 * time))
        x, y = columns - middle, rows - middle
        front = _sampled("coffee", 110 + cosine * x - sine * y, 110 + sine * x + cosine * y)
        return _before(front, _sampled("chelsea", columns + 60, rows + 30), apart < 0.36 * side)

    def deformation(time: float) -> F32:
        x = columns + 70 + 3 * np.sin(2 * np.pi * columns / 60 + 0.5 * time)
        return _sampled("chelsea", x, rows + 40 + 2.5 * np.cos(2 * np.pi * rows / 50 + 0.6 * time) + 0.5 * time)

    def growth(time: float) -> F32:
        grown = 1 + 0.02 * time
        return _sampled(
            "coins", middle + 60 + (columns - middle) * grown + 3 * time, middle + 40 + (rows - middle) * grown
        )

    drawn = np.random.default_rng(3)
    places, ways = drawn.uniform(20, side - 20, (6, 2)), drawn.uniform(-3, 3, (6, 2))

    def rectangles(time: float) -> F32:
        shown = _sampled("astronaut", columns + 60, rows + 100)
        for (x, y), (along, down) in zip(places, ways, strict=True):
            inside = (np.abs(columns - x - along * time) < 9) & (np.abs(rows - y - down * time) < 12)
            shown = _before(_sampled("camera", columns - along * time + 100, rows - down * time + 120), shown, inside)
        return shown

    frames = (crossing, rotation, deformation, growth, rectangles)
    made = {one.__name__: np.stack([np.clip(one(time), 0, 1) for time in TIMES])[..., None] for one in frames}
    return {**made, **{name: _blurred(frame) for name, frame in _before_a_camera_at_rest(side).items()}}


def _before_a_camera_at_rest(side: int) -> dict[str, Callable[[float], F32]]:
    rows, columns = np.mgrid[:side, :side].astype(np.float32)
    scale = side / 256
    back = 0.05 + 0.8 * _sampled("coffee", columns / scale * 0.94 + 60, rows / scale * 0.94)
    front = 0.25 + 0.7 * _sampled("camera", columns / scale * 1.2, rows / scale * 1.2)

    def falling(time: float) -> F32:
        wider = 1 + 0.25 * max(0.0, time - 7)
        x = (columns / scale - 115 - time) / (35 * wider)
        y = (rows / scale - 30 - 14 * min(time, 7.0)) / (35 / wider)
        on_ball = _seen_at(front, scale * (35 * x + 125), scale * (35 * y + 125))
        return _before(on_ball, back, np.hypot(x, y) < 1)

    def toppling(time: float) -> F32:
        shown = back
        for number in range(3):
            angle = np.deg2rad(np.clip(7 * (time - 1.5 * number), 0, 55))
            x, y = columns / scale - 60 - 60 * number, rows / scale - 190
            across, along = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
            bar = _seen_at(front, scale * (across + 100 + 30 * number), scale * (along + 150))
            shown = _before(bar, shown, (np.abs(across) < 7.5) & (along < 0) & (along > -80))
        return shown

    return {"falling": falling, "toppling": toppling}


def _blurred(frame: Callable[[float], F32]) -> F32:
    """Average a video over the time of each of ten masks, [10, side, side, 1]."""
    moments = (np.arange(8) + 0.5) / 8
    views = [np.mean([frame(view + moment) for moment in moments], axis=0) for view in range(10)]
    video: F32 = np.clip(np.stack(views), 0, 1).astype(np.float32)[..., None]
    return video


def _sampled(name: str, columns: F32, rows: F32) -> F32:
    """Take a photograph, made smaller so that it has detail, at the given places."""
    photograph = getattr(data, name)()
    grey = photograph if photograph.ndim == 2 else photograph[..., :3].mean(axis=2)
    small = cv2.resize(grey.astype(np.float32) / 255, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    return _seen_at(small, columns, rows)


def _seen_at(picture: F32, columns: F32, rows: F32) -> F32:
    places = columns.astype(np.float32), rows.astype(np.float32)
    sampled: F32 = cv2.remap(picture, *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return sampled


def _before(front: F32, back: F32, inside: np.ndarray) -> F32:
    share = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 0.7)
    seen: F32 = front * share + back * (1 - share)
    return seen


def exposed(views: F32) -> Shot:
    """Code views by random masks, half open."""
    return _coded(views, (np.random.default_rng(0).random(views.shape[:3]) < 0.5).astype(np.float32))


def exposed_by_one_pattern(views: F32, noise: float = 0.01) -> Shot:
    """Code views by one soft pattern, half open, displaced by a pixel from view to view; noise relative to white."""
    draw, (count, height, width) = np.random.default_rng(0), views.shape[:3]
    pattern = (draw.random((height + count, width)) < 0.5).astype(np.float32)
    soft = cv2.GaussianBlur(pattern, (0, 0), 0.5)
    return noisy(_coded(views, np.stack([soft[count - k :][:height] for k in range(count)])), draw, noise)


def behind_one_pattern(shot: Shot) -> Shot:
    """Code the true views of a shot by one pattern; camera and truth stay."""
    assert shot.truth is not None
    assert shot.truth.views is not None
    again = exposed_by_one_pattern(shot.truth.views)
    return replace(again, intrinsics=shot.intrinsics, truth=shot.truth).check()


def noisy(shot: Shot, draw: np.random.Generator, noise: float) -> Shot:
    """Add noise of light, and some of the readings, relative to white."""
    white = shot.measurement.max()
    spread = 0.5 * noise * white * np.sqrt(shot.measurement / white + 0.05)
    measured = shot.measurement + spread * draw.standard_normal(shot.measurement.shape)
    return replace(shot, measurement=measured.astype(np.float32)).check()


def _coded(views: F32, masks: F32) -> Shot:
    measured = (masks[..., None] * views).sum(axis=0)
    return Shot(measured, masks, np.ones(len(views), np.float32), truth=Truth(views=views)).check()


def run(side: int = 96, wanted: tuple[str, ...] = ()) -> None:
    made = videos(side)
    names = [name for name in made if name in wanted] or list(made)
    what = [part for part in ("decoders", "reconstruct") if part in wanted] or ["decoders", "reconstruct"]
    for name in names:
        shot = exposed_by_one_pattern(made[name]) if name in ("falling", "toppling") else exposed(made[name])
        if "decoders" in what:
            _decoders(name, shot)
        if "reconstruct" in what:
            _reconstruction(name, shot)


def _decoders(name: str, shot: Shot) -> None:
    decoders: dict[str, Callable[[], F32]] = {
        "gap-tv": lambda: gap_tv(shot, choose_coupling(shot, AS_PUBLISHED, 0)),
        "patches-quick": lambda: patch_decode(shot, PatchSettings.quick()),
        "patches": lambda: patch_decode(shot),
        f"patches {BUDGET_S:g} s": lambda: decode_until(shot, time.monotonic() + BUDGET_S).views,
    }
    for decoder, decode in decoders.items():
        began_s, busy_s = time.perf_counter(), time.process_time()
        views = decode()
        passed_s, busy_s = time.perf_counter() - began_s, time.process_time() - busy_s
        print(
            f"{name:12s} {decoder:14s} {_psnr(views, shot):6.2f} dB  {passed_s:5.1f} s, of processors {busy_s:5.1f} s",
            flush=True,
        )


def _reconstruction(name: str, shot: Shot) -> None:
    busy_s = time.process_time()
    found = reconstruct(shot, Settings(), Silent()).result
    views, scene, decode = (_psnr(one, shot) for one in (found.views, found.scene_views, found.decode))
    print(
        f"{name:12s} reconstruct    {views:6.2f} dB  scene {scene:.2f}, decode {decode:.2f}, verdict {found.verdict}, "
        f"motion {found.motion.chosen or 'still'}, of processors {time.process_time() - busy_s:.0f} s",
        flush=True,
    )


def _psnr(views: F32, shot: Shot) -> float:
    assert shot.truth.views is not None
    return float(np.mean(psnr_per_view(views, shot.truth.views)))


if __name__ == "__main__":
    run(int(sys.argv[1]) if len(sys.argv) > 1 else 96, tuple(sys.argv[2:]))
