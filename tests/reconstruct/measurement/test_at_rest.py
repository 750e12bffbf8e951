"""Which share of the picture does not move, from the measurement alone; pictures are drawn, pans by resampling."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.measurement.at_rest import share_at_rest
from tests.reconstruct.measurement.pans import (
    AT_REST,
    EVENLY,
    SIZE,
    TO_AND_FRO,
    VIEWS,
    exposed,
    masks_of,
    mosaic,
    picture,
    seen,
)


@pytest.mark.parametrize("kind", ["random", "one pattern"])
def test_a_picture_that_does_not_move_is_at_rest(kind):
    assert share_at_rest(exposed(AT_REST, masks_of(kind))) > 0.9


@pytest.mark.parametrize("kind", ["random", "one pattern"])
@pytest.mark.parametrize("along", [(1.0, 0.0), (0.0, 3.0), (6.0, -2.0)])
def test_a_pan_is_none_even_by_one_pixel(kind, along):
    assert share_at_rest(exposed(seen(EVENLY[:, None] * along), masks_of(kind))) == 0


@pytest.mark.parametrize("kind", ["random", "one pattern"])
def test_a_picture_that_bends_is_not_at_rest_though_its_middle_is(kind):
    assert share_at_rest(exposed(seen(np.zeros((VIEWS, 2)), 4 * EVENLY), masks_of(kind))) == 0


def test_a_picture_that_moves_to_and_fro_is_not_at_rest():
    assert share_at_rest(exposed(seen(3 * TO_AND_FRO[:, None] * (1.0, 0.2)), masks_of("random"))) == 0


@pytest.mark.parametrize("kind", ["random", "one pattern"])
def test_what_moves_before_a_picture_at_rest_does_not_hide_that(kind):
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    views = AT_REST.copy()
    for number, view in enumerate(views):
        disc = np.hypot(rows - 40, columns - 30 - 8 * number) < 18
        view[disc] = 0.7 * picture(5)[: SIZE[0], : SIZE[1], None][disc] + 0.3
    share = share_at_rest(exposed(views, masks_of(kind)))
    assert 0.3 < share < 1


def test_a_mosaic_is_read_colour_by_colour():
    colours = np.array([0.9, 0.6, 0.4], np.float32)
    for along, rests in (((0.0, 0.0), True), ((3.0, 0.0), False)):
        shown = seen(EVENLY[:, None] * along) * colours
        masks = masks_of("random")
        light = exposed(shown, masks, 0.002).measurement
        assert (share_at_rest(mosaic(light, masks)) > 0.6) is rests


def test_where_nothing_is_to_be_seen_nothing_is_claimed():
    grey = np.full((VIEWS, *SIZE, 1), 0.5, np.float32)
    masks = masks_of("random")
    assert share_at_rest(exposed(grey, masks)) == 0
    assert share_at_rest(exposed(AT_REST, masks, noise=0.5)) == 0
    assert share_at_rest(exposed(AT_REST, np.ones_like(masks))) == 0
    assert share_at_rest(exposed(AT_REST, np.repeat(masks[:1], VIEWS, axis=0))) == 0
    assert share_at_rest(exposed(AT_REST[:1], masks[:1])) == 0
    small = replace(exposed(AT_REST, masks), measurement=np.ones((9, 9, 1), np.float32), masks=masks[:, :9, :9]).check()
    assert share_at_rest(small) == 0


def test_closed_and_unusable_pixels_are_not_read():
    masks = masks_of("random")
    masks[:, 20:40, 30:90] = 0
    masks[:, :, ::7] = 0
    shot = exposed(AT_REST, masks)
    assert share_at_rest(shot) > 0.9
    spoilt = shot.measurement.copy()
    spoilt[:, ::7] = 7.0
    assert share_at_rest(replace(shot, measurement=spoilt)) == share_at_rest(shot)


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6])
def test_the_unit_of_the_measurement_does_not_matter(scale):
    shot = exposed(AT_REST, masks_of("one pattern"))
    scaled = replace(shot, measurement=(shot.measurement * np.float32(scale)))
    assert share_at_rest(scaled) == pytest.approx(share_at_rest(shot), abs=0.02)
