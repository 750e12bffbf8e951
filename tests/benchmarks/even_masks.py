"""What a bench's even masks give beside independent draws of the same density (`gs2ci.rig.patterns`).

    python -m tests.benchmarks even_masks

Masks a quarter and half open, 1 % noise. First what moves: the first eight frames of each grey clip of the shared data
(`video_sci`), 128 × 128 px of it, decoded by GAP-TV and by patches. Then still scenes seen from a moving camera: draws
of `larger` at 96 × 128 px, of another seed (`GS2CI_SEED`, 60), by GAP-TV and by a `draft` (delivered views), and by
GAP-TV as a mosaic sees them. PSNR of views in dB: even, and by how much it is more than drawn.
"""

import os
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import patch_decode
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import preset
from gs2ci.rig.config import CaptureTable
from gs2ci.rig.patterns import draw_codes
from tests.benchmarks import larger
from tests.benchmarks.decoders import data_folder

DENSITIES = (0.25, 0.5)
NOISE = 0.01


def run() -> None:
    """Print a row for each measurement and density."""
    print("| measurement | open | GAP-TV | of a mosaic | patches (clips), draft (stills) |\n|---|---|---|---|---|")
    for file in sorted((data_folder() / "video_sci").glob("*.mat")):
        shot = import_shots(file, None, ImportOptions()).shots[0]
        assert shot.truth.views is not None
        clip = Shot(shot.measurement, shot.masks, truth=Truth(shot.truth.views[:, :128, :128]), name=file.stem)
        _print(clip, lambda shot: patch_decode(shot, PatchSettings.quick()))
    seed = int(os.environ.get("GS2CI_SEED", "60"))
    with patch.object(larger, "SIZES", ((96, 128),)):
        stills = [larger.draw(seed, number)[0] for number in range(len(larger.KINDS))]
    for still in stills:
        _print(still, lambda shot: reconstruct(shot, preset("draft")).result.views)


def _print(shot: Shot, recover) -> None:  # type: ignore[no-untyped-def]
    for density in DENSITIES:
        cells = []
        coded = [_coded(shot, density, even=even) for even in (False, True)]
        for decode in (gap_tv, lambda one: gap_tv(_mosaic(one)), recover):
            drawn_db, even_db = (float(np.mean(psnr_per_view(decode(one), one.truth.views))) for one in coded)
            cells.append(f"{even_db:.2f} ({even_db - drawn_db:+.2f})")
        print(f"| {shot.name} | {density} | {' | '.join(cells)} |", flush=True)


def _coded(shot: Shot, density: float, *, even: bool) -> Shot:
    views: F32 | None = shot.truth.views
    assert views is not None
    table = CaptureTable(masks=len(views), density=density, seed=7, even_masks=even)
    masks = draw_codes(table, (views.shape[1], views.shape[2]), Path()).astype(np.float32)
    noise = np.random.default_rng(8).normal(0, NOISE, views.shape[1:])
    measurement = ((masks[..., None] * views).sum(axis=0) + noise).astype(np.float32)
    return replace(shot, measurement=measurement, masks=masks).check()


def _mosaic(shot: Shot) -> Shot:
    """Leave of each colour reading what a mosaic of RGGB sees; grey ones stay."""
    if shot.measurement.shape[2] == 1:
        return shot
    high, wide = shot.size
    colours = np.tile([[0, 1], [1, 2]], (high // 2, wide // 2))[..., None]
    return replace(shot, measurement=np.take_along_axis(shot.measurement, colours, axis=2), cfa="RGGB").check()
