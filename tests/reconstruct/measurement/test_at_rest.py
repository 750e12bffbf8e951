"""Which share of the picture does not move, from the measurement alone; pictures are drawn, pans by resampling."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.at_rest import share_at_rest
from gs2ci.reconstruct.measurement.displacements import displacements

SIZE, VIEWS = (112, 144), 10
# From -0.5 to 0.5 over the exposure.
EVENLY = np.linspace(-0.5, 0.5, VIEWS)
TO_AND_FRO = -0.5 * np.cos(2 * np.pi * (np.arange(VIEWS) + 0.5) / VIEWS)


def picture(seed=0):
    draw = np.random.default_rng(seed)
    layers = [gaussian_filter(draw.standard_normal((SIZE[0] + 40, SIZE[1] + 40)), size) * size for size in (1.2, 3, 8)]
    return (0.5 + 0.14 * sum(layers) / np.std(sum(layers))).clip(0, 1).astype(np.float32)


def seen(shifts, zoom=None):
    """The picture from displaced places: shifts (x, y) px for each view, and a bend that grows from the middle."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    from_middle = (columns - SIZE[1] / 2) / SIZE[1] * 2
    bends = np.zeros(VIEWS) if zoom is None else zoom
    views = [
        cv2.remap(picture(), columns + 20 + x + bend * from_middle**2, rows + 20 + y, cv2.INTER_CUBIC)
        for (x, y), bend in zip(shifts.astype(np.float32), bends.astype(np.float32), strict=True)
    ]
    return np.stack(views)[..., None]


AT_REST = seen(np.zeros((VIEWS, 2)))


def masks_of(kind):
    draw = np.random.default_rng(2)
    if kind == "random":
        return (draw.random((VIEWS, *SIZE)) < 0.5).astype(np.float32)
    pattern = gaussian_filter((draw.random((SIZE[0] + VIEWS, SIZE[1])) < 0.5).astype(np.float32), 0.5)
    return np.stack([pattern[VIEWS - k : VIEWS - k + SIZE[0]] for k in range(VIEWS)])


def exposed(views, masks, noise=0.005):
    light = np.einsum("nhw,nhwc->hwc", masks, views)
    light += noise * len(masks) / 2 * np.random.default_rng(3).standard_normal(light.shape)
    return Shot(light.astype(np.float32), masks, np.ones(len(masks), np.float32)).check()


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


def test_displacements_of_a_picture_at_rest_have_the_errors_that_they_state():
    found = displacements(exposed(AT_REST, masks_of("random")))
    assert (found.centres_px.min(axis=0).tolist(), found.centres_px.max(axis=0).tolist()) == ([8, 8], [136, 104])
    errors = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    assert np.sqrt(np.mean((found.px / errors) ** 2)) == pytest.approx(1, abs=0.35)


def test_displacements_follow_a_pan():
    found = displacements(exposed(seen(EVENLY[:, None] * (0.6, -0.3)), masks_of("random")))
    # The picture is sampled from displaced places: what it shows moves the other way. Gradients are smoothed, so that
    # fine detail seems to move farther.
    x, y, *to_and_fro = np.median(found.px, axis=0)
    assert -1.2 < x < -0.5
    assert 0.25 < y < 0.6
    assert np.abs(to_and_fro).max() < 0.1


def test_a_mosaic_is_read_colour_by_colour():
    colours = np.array([0.9, 0.6, 0.4], np.float32)
    for along, rests in (((0.0, 0.0), True), ((3.0, 0.0), False)):
        shown = seen(EVENLY[:, None] * along) * colours
        masks = masks_of("random")
        light = exposed(shown, masks, 0.002).measurement
        bayer = np.empty((*SIZE, 1), np.float32)
        for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
            bayer[row::2, column::2, 0] = light[row::2, column::2, channel]
        shot = Shot(bayer, masks, np.ones(VIEWS, np.float32), cfa="RGGB").check()
        assert (share_at_rest(shot) > 0.6) is rests


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
