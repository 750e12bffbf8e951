"""Whether the camera was at rest, told from the measurement alone: pictures that do not move, pans, arcs.

    python -m tests.benchmarks at_rest

Data: six photographs of scikit-image, moved by resampling, 256 × 256 px, sharp or smoothed (1.5 px), 10 views, grey, 1
% noise; behind random masks, and behind one soft pattern displaced by a pixel from view to view, down or across. The
camera pans over 0 to 8 px, or circles a flat picture by 2° and 6°. And the 43 scenes of `combination`, as they are and
behind one pattern.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from skimage import data

from gs2ci.core.arrays import F32
from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.measurement.at_rest import share_at_rest
from tests.benchmarks.combination import cases
from tests.benchmarks.nonrigid import behind_one_pattern, exposed, exposed_by_one_pattern, noisy

SIDE, VIEWS = 256, 10
TIMES = np.linspace(-0.5, 0.5, VIEWS)
PHOTOGRAPHS = ("coffee", "chelsea", "astronaut", "camera", "coins", "rocket")
PANS_PX = (0.0, 0.3, 1.0, 2.0, 4.0, 8.0)
ARCS_DEG = (2.0, 6.0)
WAY = (1.0, 0.3)


def panned(photograph: F32, length_px: float) -> F32:
    return _seen(photograph, lambda x, y, time: (x + WAY[0] * length_px * time, y + WAY[1] * length_px * time))


def circled(photograph: F32, angle_deg: float) -> F32:
    """See a flat picture by a camera that turns around its middle; a field of view of 53°."""

    def place(x: F32, y: F32, time: float) -> tuple[F32, F32]:
        turn = np.deg2rad(angle_deg) * time
        nearer = 1 + x / SIDE * np.sin(turn)
        return x * np.cos(turn) / nearer, y / nearer

    return _seen(photograph, place)


def _seen(photograph: F32, place: Callable[[F32, F32, float], tuple[F32, F32]]) -> F32:
    down, across = np.mgrid[:SIDE, :SIDE].astype(np.float32) - SIDE / 2
    views = []
    for time in TIMES:
        x, y = place(across, down, float(time))
        places = (x + photograph.shape[1] / 2).astype(np.float32), (y + photograph.shape[0] / 2).astype(np.float32)
        views.append(cv2.remap(photograph, *places, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))
    found: F32 = np.clip(np.stack(views), 0, 1)[..., None]
    return found


def _photograph(name: str, smoothed_px: float) -> F32:
    taken = getattr(data, name)()
    grey = (taken if taken.ndim == 2 else taken[..., :3].mean(axis=2)).astype(np.float32) / 255
    small: F32 = cv2.resize(grey, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA)
    return small if smoothed_px == 0 else cv2.GaussianBlur(small, (0, 0), smoothed_px)


def _behind(views: F32, masks: str) -> Shot:
    if masks == "down":
        return exposed_by_one_pattern(views)
    if masks == "across":
        turned = exposed_by_one_pattern(views.swapaxes(1, 2))
        light, patterns = turned.measurement.swapaxes(0, 1), turned.masks.swapaxes(1, 2)
        return replace(turned, measurement=light, masks=patterns, truth=Truth()).check()
    return noisy(exposed(views), np.random.default_rng(1), 0.01)


def run() -> None:
    made: dict[str, Callable[[F32], F32]] = {
        **{f"pan {length:g} px": partial(panned, length_px=length) for length in PANS_PX},
        **{f"arc {angle:g}°": partial(circled, angle_deg=angle) for angle in ARCS_DEG},
    }
    print("share at rest by photographs, sharp then smoothed:", *PHOTOGRAPHS)
    for name, make in made.items():
        for masks in ("random", "down", "across"):
            shares = [
                share_at_rest(_behind(make(_photograph(photograph, smoothed_px)), masks))
                for smoothed_px in (0.0, 1.5)
                for photograph in PHOTOGRAPHS
            ]
            print(f"{name:10s} {masks:7s}", *(f"{share:.2f}" for share in shares), flush=True)
    for name, make_shot in cases():
        shot = make_shot()
        print(
            f"{name:34s} {share_at_rest(shot):.2f}  one pattern {share_at_rest(behind_one_pattern(shot)):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    run()
