"""The denoiser by similar patches: the motion along which they are found, and pixels that no group contains."""

import cv2
import numpy as np
import pytest
from skimage import data

from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import decode_signed
from gs2ci.reconstruct.decode.patches import denoiser as patches_denoiser
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.denoiser import SimilarPatches
from gs2ci.reconstruct.decode.patches.flow import Flow
from gs2ci.reconstruct.decode.patches.matching import Lattice, find_groups
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
    start = decode_signed(shot)
    denoiser = SimilarPatches(
        np.ascontiguousarray(start.transpose(0, 3, 1, 2)), settings.lattice, settings.refind_every
    )
    views = plug_and_play(shot, denoiser, PlugAndPlaySettings(sigmas=settings.sigmas, iterations=1), start=start)
    assert views.min() > -1
    assert views.max() < 2


@pytest.mark.parametrize("tint", [(1.0,), (1.0, 1.0, 1.0), (0.9, 0.6, 0.2)])
def test_patches_are_found_along_the_motion_in_grey_and_in_colour(
    tint: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    photograph = (data.camera() / 255).astype(np.float32)
    sliding = np.stack([photograph[100 + i :, 100 + 3 * i :][:80, :96] for i in range(4)])
    flows: list[Flow] = []
    guides: list[np.ndarray] = []

    def find(guide: np.ndarray, flow: Flow, lattice: Lattice, phase: int) -> np.ndarray:
        flows.append(flow)
        guides.append(guide)
        return find_groups(guide, flow, lattice, phase)

    monkeypatch.setattr(patches_denoiser, "find_groups", find)
    views = sliding[:, None] * np.array(tint, np.float32)[:, None, None]
    SimilarPatches(views, Lattice(), 3)(views.copy(), 0.05)
    assert np.median(flows[0].forward, axis=(0, 1, 2)) == pytest.approx((-3, -1), abs=0.1)
    np.testing.assert_allclose(guides[0], views.mean(axis=1), atol=1e-6)
