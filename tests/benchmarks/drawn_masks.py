"""The loss if a shot coded by a laboratory's masks is reconstructed with the masks as drawn, and its causes.

    python -m tests.benchmarks drawn_masks

Shots of the simulator's scenes, 96 x 128 px, coded with masks that are blurred, leaking unevenly, shifted by 0.1 px and
clipped (`tests.stability.laboratory`), stated open or closed. It prints the PSNR of the decode with the true, the
stated and the registered masks; then that of registered masks corrected by figures that one shot does not determine:
their mean brightness, and that with the leakage of each pixel, both by least squares against the true masks.
"""

from dataclasses import replace

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.records import Shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.registration.register import register
from tests.stability.benches import Bench
from tests.stability.changes import crisp

SIZE = (96, 128)
SCENES = ("boxes", "planes", "ball", "thicket")


def run() -> None:
    """Print the table."""
    print("| scene | true masks, dB | stated | registered | brightness given | and each pixel's leak | widening, px |")
    print("|---|---|---|---|---|---|---|")
    for scene in SCENES:
        shot = Bench(scene, kind="laboratory").expose(SIZE)
        found = register(crisp(shot))
        true, masks = shot.masks.astype(np.float64), found.shot.masks.astype(np.float64)
        brighter = masks * float((masks * true).sum() / (masks * masks).sum())
        closed = 1 - brighter
        leak = ((true - brighter) * closed).sum(axis=0) / np.maximum((closed * closed).sum(axis=0), 1e-9)
        figures = [_psnr_db(shot, one) for one in (true, crisp(shot).masks, masks, brighter, brighter + leak * closed)]
        told = " | ".join(f"{figure:.2f}" for figure in figures)
        print(f"| {scene} | {told} | {found.misfit.widening_px:+.3f} |", flush=True)


def _psnr_db(shot: Shot, masks: F32 | F64) -> float:
    """Decode with these masks."""
    assert shot.truth.views is not None
    views = gap_tv(replace(shot, masks=np.clip(masks, 0, 1).astype(np.float32)))
    return float(np.mean(psnr_per_view(views, shot.truth.views)))
