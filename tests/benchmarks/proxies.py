"""The cost of proxy views: AMDI against the number of views and the share of open pixels, compared with ENI.

RGB measurements of 400 x 600 pixels under random masks, on two threads. AMDI's price follows from the windows that
the masks make it try, so the median and largest window stand beside the seconds; below, the seconds of one window
size for all pixels, by its width: box sums cost the same for any.
"""

import time

import numpy as np
import torch

from gs2ci.core.records import Shot
from gs2ci.reconstruct.paper.proxies.amdi import _box_sums, mask_decoded_views
from gs2ci.reconstruct.paper.proxies.eni import energy_normalised_views
from gs2ci.reconstruct.paper.proxies.planes import coded_planes
from gs2ci.reconstruct.paper.proxies.routing import multiplicity, route

SIZE = (400, 600)
CASES = ((8, 0.25), (8, 0.5), (8, 0.75), (16, 0.25), (32, 0.25))
WIDTHS = (5, 11, 21, 41, 81)


def run() -> None:
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        print(
            f"{SIZE[0]} x {SIZE[1]} RGB, 2 threads\n"
            "  N   open   mu   route   AMDI s   windows (median, largest)   ENI s"
        )
        for n, share in CASES:
            shot = _shot(n, share)
            started = time.perf_counter()
            windows = mask_decoded_views(shot).windows
            amdi_s = time.perf_counter() - started
            eni = ""
            if route(shot) == "eni":
                started = time.perf_counter()
                energy_normalised_views(shot)
                eni = f"{time.perf_counter() - started:.1f}"
            print(
                f"{n:3d}  {share:5.0%}  {multiplicity(shot):4.1f}   {route(shot):5s}  {amdi_s:6.1f}   "
                f"{np.median(windows):.0f}, {windows.max()}   {eni:>20s}"
            )
        _windows()
    finally:
        torch.set_num_threads(threads)


def _windows() -> None:
    plane = coded_planes(_shot(8, 0.5))[0]
    rows = 40
    pixels = np.argwhere(np.ones((rows, SIZE[1]), bool))
    print(f"box sums of 8 views around {len(pixels)} pixels ({rows} rows and as many more as the window reaches):")
    for width in WIDTHS:
        started = time.perf_counter()
        _box_sums(plane, 180, pixels, width // 2)
        print(f"  window {width:3d}: {1e3 * (time.perf_counter() - started):6.0f} ms")


def _shot(n: int, share: float) -> Shot:
    rng = np.random.default_rng(0)
    masks = (rng.random((n, *SIZE)) < share).astype(np.float32)
    views = rng.random((n, 1, 1, 3)).astype(np.float32)
    measured = (masks[..., None] * views).sum(axis=0)
    return Shot(measured, masks, np.ones(n, np.float32)).check()
