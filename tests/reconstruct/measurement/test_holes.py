from dataclasses import replace

import numpy as np
import torch

from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.faulty import fill_holes


def with_hole(shot):
    masks = shot.masks.copy()
    masks[:, 8:24, 10:30] = 0
    return replace(shot, masks=masks, measurement=shot.measurement * masks.any(axis=0)[..., None])


def test_specks_between_open_elements_are_no_holes(smooth_shot):
    assert not smooth_shot.masks.any(axis=0).all()
    assert fill_holes(smooth_shot, smooth_shot.truth.views) is smooth_shot


def test_a_hole_shows_the_decoded_views_and_nothing_else_changes(smooth_shot):
    shot, decoded = with_hole(smooth_shot), smooth_shot.truth.views
    filled = fill_holes(shot, decoded)
    changed = (filled.masks != shot.masks).any(axis=0)
    assert changed[12:20, 14:26].all()
    outside = ~changed
    assert outside[:8].all()
    np.testing.assert_array_equal(filled.measurement[outside], shot.measurement[outside])
    expected = Coding.of(filled).forward(torch.from_numpy(decoded)).numpy()
    np.testing.assert_array_equal(filled.measurement[changed], expected[changed])
    np.testing.assert_allclose(filled.measurement[changed].mean(), smooth_shot.measurement.mean(), rtol=0.2)


def test_a_mosaic_is_filled_through_its_colours(smooth_shot):
    mosaic = replace(with_hole(smooth_shot), cfa="RGGB")
    mosaic = replace(mosaic, measurement=Coding.of(mosaic).forward(torch.from_numpy(smooth_shot.truth.views)).numpy())
    filled = fill_holes(mosaic, smooth_shot.truth.views)
    assert filled.measurement.shape == (32, 40, 1)
    assert (filled.measurement[12:20, 14:26] > 0).all()
