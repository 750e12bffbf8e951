"""The denoiser by similar patches inside the decoder's loop: what happens to pixels that no group contains."""

import cv2
import numpy as np
import pytest

from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import decode_signed
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.denoiser import SimilarPatches
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, plug_and_play
from gs2ci_sims.masks import random_masks

SIDE, VIEWS, NOISE = 32, 8, 0.03


def wandering_blots(seed: int) -> Shot:
    """Code a picture of two brightnesses with sharp borders, which moves by 1 px per view, with noise."""
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.random((SIDE, SIDE)).astype(np.float32), (0, 0), 2)
    blots = ((smooth > np.median(smooth)) * 0.6 + 0.2).astype(np.float32)
    views = np.stack([np.roll(blots, i, axis=1)[..., None] for i in range(VIEWS)])
    masks = random_masks(VIEWS, (SIDE, SIDE), 0.25, rng)
    coded = (masks[..., None] * views).sum(axis=0) + NOISE * rng.standard_normal((SIDE, SIDE, 1))
    return Shot(coded.astype(np.float32), masks, np.ones(VIEWS, np.float32)).check()


@pytest.mark.parametrize("seed", [1, 6])
def test_pixels_that_most_calls_leave_without_a_patch_stay_near_the_range_of_views(seed: int) -> None:
    # Such a pixel grew threefold and changed its sign at each call that gave it a patch: to 2e7 and 6e5 here.
    shot, settings = wandering_blots(seed), PatchSettings()
    start = decode_signed(shot, settings.start)
    denoiser = SimilarPatches(
        np.ascontiguousarray(start.transpose(0, 3, 1, 2)), settings.lattice, settings.refind_every
    )
    views = plug_and_play(shot, denoiser, PlugAndPlaySettings(sigmas=settings.sigmas, iterations=1), start=start)
    assert views.min() > -1
    assert views.max() < 2
