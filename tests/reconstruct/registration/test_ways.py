"""Corrections of masks are accepted where decodes of pixels with known masks are better for them, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot
from gs2ci.reconstruct.registration.fine import MisfitEstimate
from gs2ci.reconstruct.registration.misfit import Misfit
from gs2ci.reconstruct.registration.ways import Rim, Way, chosen, way_of

VIEWS = 8


def pattern(rng, side):
    return (rng.random((VIEWS, side, side)) < 0.5).astype(float)


def shifted(seed, side, shift_px, *, is_right):
    """A shot whose masks lie displaced by so much, or are others altogether; its masks as stated."""
    rng = np.random.default_rng(seed)
    stated = pattern(rng, side)
    were = pattern(rng, side)
    if is_right:
        were[:, shift_px:, shift_px:] = stated[:, :-shift_px, :-shift_px]
    scene = gaussian_filter(rng.random((side, side)), 2)
    scene = 0.1 + 0.8 * (scene - scene.min()) / np.ptp(scene)
    reading = (were * scene).sum(axis=0) + rng.normal(0, 0.03, (side, side))
    return Shot(reading[..., None].astype(np.float32), stated.astype(np.float32)).check()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("side", "shift_px"), [(96, 32), (128, 24)])
def test_readings_averaged_where_no_mask_is_known_do_not_speak_for_a_displacement(side, shift_px, seed):
    for is_right in (True, False):
        shot = shifted(seed, side, shift_px, is_right=is_right)
        way = way_of(shot, MisfitEstimate(Misfit().moved(shift_px, shift_px), {}))
        assert (chosen(shot, [way], None, 0) is way) == is_right


@pytest.mark.parametrize("seed", range(4))
def test_single_pixels_whose_masks_hardly_pass_light_do_not_outweigh_all_others(seed):
    """As at the border of displaced masks, where readings are those of unknown elements: decodes divide by little."""
    rng = np.random.default_rng(seed)
    stated = pattern(rng, 96)
    were = 0.8 * stated + 0.2 * np.roll(stated, 1, axis=2)
    scene = 0.1 + 0.8 * gaussian_filter(rng.random((96, 96)), 2)
    shot = Shot((were * scene).sum(axis=0)[..., None].astype(np.float32), stated.astype(np.float32)).check()
    were.reshape(VIEWS, -1)[:, rng.choice(96 * 96, 24, replace=False)] = 1e-3
    way = Way(replace(shot, masks=were.astype(np.float32)), Misfit(), {}, "", Rim(np.zeros(shot.size, bool)))
    assert chosen(shot, [way], None, 0) is way
    assert chosen(way.shot, [replace(way, shot=shot)], None, 0) is None
