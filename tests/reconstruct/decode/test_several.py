"""Several measurements of the same views, decoded as equations at every pixel."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, ReadingNoise, plug_and_play, turned

VIEWS, SIZE = 4, (20, 24)


@pytest.fixture(scope="module")
def views():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / 6
    return np.stack([0.5 + 0.4 * np.sin(x + k / 2) * np.cos(y) for k in range(VIEWS)])[..., None].astype(np.float32)


def repeats(views, count, noise=0.0):
    rng = np.random.default_rng(0)
    shots = []
    for _ in range(count):
        masks = rng.random((VIEWS, *SIZE)).astype(np.float32)
        read = np.einsum("nhw,nhwc->hwc", masks, views)
        shots.append(Shot(read + (noise * rng.standard_normal(read.shape)).astype(np.float32), masks))
    return shots


def same(planes, sigma):
    return planes


def test_equations_stand_at_right_angles_and_say_the_same(views):
    shots = repeats(views, 3)
    masks, read = turned(shots)
    products = np.einsum("knhw,lnhw->klhw", masks, masks)
    assert np.abs(products[~np.eye(3, dtype=bool)]).max() < 1e-5
    np.testing.assert_allclose(np.einsum("knhw,nhwc->kchw", masks, views), read, atol=1e-5)
    energy = np.einsum("kkhw->khw", products)
    assert (np.diff(energy, axis=0) <= 1e-5).all()


def test_more_measurements_than_views_become_as_many_equations_that_say_the_same(views):
    shots = repeats(views, 7, noise=0.1)
    masks, read = turned(shots)
    assert masks.shape == (VIEWS, VIEWS, *SIZE)
    assert read.shape == (VIEWS, 1, *SIZE)
    phi, y = (np.stack([getattr(shot, name) for shot in shots]) for name in ("masks", "measurement"))
    np.testing.assert_allclose(
        np.einsum("knhw,kmhw->nmhw", masks, masks), np.einsum("knhw,kmhw->nmhw", phi, phi), atol=1e-4
    )
    np.testing.assert_allclose(
        np.einsum("knhw,kchw->nchw", masks, read), np.einsum("knhw,khwc->nchw", phi, y), atol=1e-4
    )
    energy = np.einsum("knhw->khw", masks**2)
    assert (np.diff(energy, axis=0) <= 1e-5).all()


def test_of_many_equal_measurements_and_closed_pixels_little_is_left(views):
    (shot,) = repeats(views, 1)
    closed = shot.masks.copy()
    closed[:, 0] = 0
    masks, read = turned([replace(shot, masks=closed)] * 6)
    assert np.isfinite(masks).all()
    assert np.isfinite(read).all()
    assert not masks[:, :, 0].any()
    assert not masks[1:].any()
    np.testing.assert_allclose(masks[0] ** 2, 6 * closed**2, atol=1e-5)


def test_one_step_goes_towards_the_nearest_views_that_explain_all_readings(views):
    shots, start = repeats(views, 3), np.full_like(views, 0.3)
    found = plug_and_play(shots, same, PlugAndPlaySettings(sigmas=(0.1,), iterations=1), start=start)
    phi = np.stack([shot.masks for shot in shots]).transpose(2, 3, 0, 1).astype(np.float64)
    left = np.stack([shot.measurement for shot in shots])[..., 0].transpose(1, 2, 0) - phi @ np.full(VIEWS, 0.3)
    # Accelerated, it goes twice as far as the nearest ones.
    nearest = 0.3 + 2 * np.einsum("hwnk,hwk->nhw", np.linalg.pinv(phi), left)
    # Where two equations say nearly the same, their difference is damped.
    off = np.abs(found[..., 0] - nearest)
    assert np.quantile(off, 0.3) < 1e-4
    assert np.median(off) < 1e-2


def test_as_many_measurements_as_views_determine_them_without_a_denoiser(views):
    settings = PlugAndPlaySettings(sigmas=(0.1,), iterations=60)
    errors = [float(np.abs(plug_and_play(repeats(views, count), same, settings) - views).mean()) for count in (2, 4, 6)]
    assert errors[2] < errors[1] < errors[0]
    assert errors[2] < 1e-3


def test_more_measurements_decode_better(views):
    power = np.full((*SIZE, 1), 0.05**2, np.float32)
    decoded = [gap_tv(repeats(views, count, 0.05), noise=power) for count in (1, 2, 4)]
    errors = [float(np.mean((one - views) ** 2)) for one in decoded]
    assert errors[2] < errors[1] < errors[0]


def test_the_same_measurement_twice_is_one_of_half_the_noise(views):
    (shot,) = repeats(views, 1)
    power = np.full(shot.measurement.shape, 0.04, np.float32)
    twice = plug_and_play([shot, shot], same, start=views, noise=ReadingNoise(power, float))
    once = plug_and_play(shot, same, start=views, noise=ReadingNoise(power / 2, float))
    np.testing.assert_allclose(twice, once, atol=1e-4)


def test_saturated_readings_do_not_count(views):
    first, second = repeats(views, 2)
    spoilt = replace(second, measurement=second.measurement + 5, saturated=np.ones(SIZE, bool))
    settings = PlugAndPlaySettings(sigmas=(0.1,), iterations=3)
    alone = plug_and_play(first, same, settings, start=views + np.float32(0.1))
    np.testing.assert_allclose(
        plug_and_play([first, spoilt], same, settings, start=views + np.float32(0.1)), alone, atol=1e-4
    )


def test_measurements_of_other_views_are_refused(views):
    first, second = repeats(views, 2)
    with pytest.raises(InputError, match="differ in their number of views"):
        plug_and_play([first, replace(second, masks=second.masks[:3], weights=second.weights[:3])], same)
    with pytest.raises(InputError, match="no measurement"):
        turned([])
