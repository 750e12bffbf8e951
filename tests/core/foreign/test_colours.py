"""Mosaics that were saved as colour pictures hold one reading for each pixel."""

import numpy as np
import pytest

from gs2ci.core.foreign.colours import one_reading
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import CFA_PATTERNS
from tests.benchmarks.import_forms import mosaic
from tests.core.test_mosaics import coded


@pytest.mark.parametrize("cfa", CFA_PATTERNS)
def test_a_mosaic_with_zeros_in_the_other_colours_is_recognised(scene, take, said, cfa):
    made = scene(height=48, width=64)
    raw = mosaic(made.meas, cfa)
    channel = np.array(["RGB".index(colour) for colour in cfa]).reshape(2, 2)
    where = channel[np.arange(48)[:, None] % 2, np.arange(64)[None] % 2]
    sparse = np.where(where[..., None] == np.arange(3), raw[..., None], 0)
    imported = take(meas=sparse, masks=made.masks)
    assert said(imported, f"taken as a mosaic {cfa}")
    assert imported.shots[0].cfa == cfa
    assert np.allclose(imported.shots[0].measurement[..., 0], raw, rtol=1e-5)


def test_three_equal_channels_are_one_and_a_mosaic_among_them_is_doubted(scene, take, said):
    made = scene(height=48, width=64)
    colourful = mosaic(made.meas * [0.3, 1.0, 0.5], "RGGB")
    imported = take(ImportOptions(scale=1.0), meas=np.dstack([colourful] * 3), masks=made.masks)
    assert said(imported, "three equal channels were taken as one")
    assert said(imported, "looks like a colour mosaic")


@pytest.mark.parametrize(("stated", "contradicted"), [("RGGB", False), ("BGGR", False), ("GRBG", True), ("GBRG", True)])
def test_a_mosaic_that_begins_elsewhere_than_stated_is_named(take, said, stated, contradicted):
    readings, _ = coded(4, "RGGB")
    masks = np.random.default_rng(4).random((6, 72, 96)) < 0.4  # those that `coded` draws
    imported = take(ImportOptions(scale=1.0, cfa=stated), meas=readings, masks=masks)
    assert said(imported, f"the greens stand where RGGB or BGGR has them, not {stated}") == contradicted
    assert imported.shots[0].cfa == stated


def test_a_mosaic_of_colours_that_are_grey_on_average_is_doubted(take, said):
    readings, _ = coded(5, "GRBG")
    masks = np.random.default_rng(5).random((6, 72, 96)) < 0.4  # those that `coded` draws
    imported = take(ImportOptions(scale=1.0), meas=readings, masks=masks)
    assert said(imported, "looks like a colour mosaic (GRBG or GBRG), taken as mono")


def test_colours_stay_colours():
    colours = np.random.default_rng(0).random((1, 8, 8, 3))
    assert one_reading(colours)[0] is colours
    assert one_reading(0 * colours)[2] == ""
    red = colours * [1, 0, 0]
    assert one_reading(red)[2] == ""
