"""Convex combinations of views, judged by pixels that none of them saw, as they are once those are seen."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.fit.combining.combination import (
    Candidate,
    combined,
    expected_products,
    expected_rms,
    least_on_simplex,
    shares,
)
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.noise import followed, mean_power, noise_of_readings

SIZE, VIEWS = (48, 64), 6


@pytest.fixture(scope="module")
def truth():
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] / SIZE[1]
    views = [0.5 + 0.3 * np.sin(6 * columns + 0.3 * k) * np.cos(5 * rows) for k in range(VIEWS)]
    return np.stack(views).astype(np.float32)[..., None].repeat(3, axis=3)


def holdout_of(truth, noise=0.0, share=0.3, seed=0):
    rng = np.random.default_rng(seed)
    masks = (rng.random((VIEWS, *SIZE)) < 0.4).astype(np.float32)
    light = np.einsum("nhw,nhwc->hwc", masks, truth) + rng.normal(0, noise, (*SIZE, 3))
    return Holdout.of(Shot(light.astype(np.float32), masks, truth=Truth(truth)).check(), share, 0)


@pytest.fixture
def holdout(truth):
    return holdout_of(truth)


def noise_power(holdout, views):
    return mean_power(noise_of_readings(holdout, views), holdout) * followed(holdout, views)


def noisy(views, seed, deviation=0.1):
    return (views + np.random.default_rng(seed).normal(0, deviation, views.shape)).astype(np.float32)


def same(views):
    """Views that do not change where a held-out pixel is seen, as a scene's hardly do."""
    return Candidate(views, views)


def follower(holdout, views):
    """Views that explain each reading that they see, and none that they do not."""
    masks = holdout.shot.masks[..., None]
    light = np.maximum((masks**2).sum(axis=0), 1e-9)

    def moved(left):
        return (views + masks * (left / light)[None]).astype(np.float32)

    left = holdout.shot.measurement - holdout.coded(views)
    return Candidate(moved(np.where(holdout.pixels[..., None], 0, left)), moved(left))


def error(views, truth):
    return float(np.mean((views - truth) ** 2))


def test_the_right_one_stands_alone(holdout, truth):
    found = shares(holdout, {"right": same(truth), "wrong": same(noisy(truth, 1)), "dark": same(0 * truth)}, 0.0)
    assert found == {"right": pytest.approx(1), "wrong": 0.0, "dark": 0.0}


def test_a_combination_that_made_the_measurement_is_found(holdout, truth):
    step = noisy(truth, 2) - truth
    candidates = {"over": truth + step, "under": truth - step / 3}
    found = shares(holdout, {name: same(views) for name, views in candidates.items()}, 0.0)
    assert found == {"over": pytest.approx(0.25, abs=0.01), "under": pytest.approx(0.75, abs=0.01)}
    assert np.allclose(combined(candidates, found), truth, atol=0.01)


def test_two_that_err_alike_and_apart_are_better_together(holdout, truth):
    candidates = {"one": noisy(truth, 3), "other": noisy(truth, 4)}
    found = shares(holdout, {name: same(views) for name, views in candidates.items()}, 0.0)
    assert error(combined(candidates, found), truth) < 0.75 * min(error(views, truth) for views in candidates.values())
    assert sum(found.values()) == pytest.approx(1)


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.2])
def test_the_products_are_those_of_the_views_that_are_handed_over(truth, noise):
    """Against the truth: of a scene's views, and of views that take over what they see, noise and all."""
    holdout = holdout_of(truth, noise)
    candidates = [same(noisy(truth, 5, 0.08)), follower(holdout, noisy(truth, 6, 0.08))]
    found = expected_products(holdout, candidates, noise**2)
    errors = [(truth - one.full)[:, holdout.pixels].astype(float) for one in candidates]
    true = np.array([[np.mean(one * other, axis=2).sum(axis=0).mean() for other in errors] for one in errors])
    np.testing.assert_allclose(found - found[0, 0], true - true[0, 0], atol=0.15 * true.max())


def test_what_no_reading_tells_counts_as_it_was_before(truth):
    """Two that follow the only view's every reading differ where no mask is open: as much as at held-out pixels."""
    masks = (np.random.default_rng(0).random((1, *SIZE)) < 0.4).astype(np.float32)
    shot = Shot(masks[0][..., None] * truth[0], masks, truth=Truth(truth[:1])).check()
    holdout = Holdout.of(shot, 0.3, 0)
    near, far = (noisy(truth[:1], seed, deviation) for seed, deviation in ((20, 0.1), (21, 0.2)))
    found = shares(holdout, {"far": follower(holdout, far), "near": follower(holdout, near)}, 0.0)
    assert found["near"] == pytest.approx(0.8, abs=0.05)


def test_the_change_of_a_view_that_no_reading_measures_is_no_gain(truth):
    """Of a view whose mask has next to no weight: it changes wildly, and nothing shows whether it is right."""
    holdout = holdout_of(truth)
    weights = holdout.shot.weights.copy()
    weights[0] = 1e-6
    coded = (weights[:, None, None, None] * holdout.shot.masks[..., None] * truth).sum(axis=0)
    holdout = Holdout.of(replace(holdout.shot, weights=weights, measurement=coded.astype(np.float32)), 0.1, 0)
    wild = truth.copy()
    wild[0] += 20
    found = shares(holdout, {"right": same(truth), "wild": Candidate(truth, wild)}, 0.0)
    assert found == {"right": pytest.approx(1), "wild": 0.0}


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_what_a_reading_teaches_of_the_views_across_its_masks_is_a_gain(truth, share):
    """An estimate that learns a share of its error changes by that share and by as much that is wrong as it must."""
    holdout = holdout_of(truth)
    blind = noisy(truth, 13, 0.08)
    wrong = noisy(truth, 14, 0.08) - truth
    step = share * (truth - blind) + np.sqrt(share * (1 - share)) * wrong
    candidates = [same(blind), Candidate(blind, (blind + step).astype(np.float32))]
    found = expected_products(holdout, candidates, 0.0)
    powers = [
        ((truth - one.full)[:, holdout.pixels].astype(float) ** 2).mean(axis=2).sum(axis=0).mean() for one in candidates
    ]
    assert found[0, 0] - found[1, 1] == pytest.approx(powers[0] - powers[1], rel=0.25)


def test_pixels_behind_no_open_mask_tell_next_to_nothing(truth):
    """Closed masks leak a hundredth: what is told of noise, divided by so little light, would outweigh all else."""
    rng = np.random.default_rng(3)
    masks = np.maximum(rng.random((VIEWS, *SIZE)) < 0.4, 0.01).astype(np.float32)
    light = np.einsum("nhw,nhwc->hwc", masks, truth) + rng.normal(0, 0.01, (*SIZE, 3))
    leaky = Holdout.of(Shot(light.astype(np.float32), masks).check(), 0.3, 0)
    candidates = {"better": same(noisy(truth, 15, 0.05)), "worse": replace(same(noisy(truth, 16, 0.1)), cancels=True)}
    found = shares(leaky, candidates, 0.02**2)  # four times what it is
    assert found["better"] > 0.6


def test_a_change_behind_no_open_mask_is_an_error(truth):
    """As by masks calibrated with noise: residuals divided by next to no light change the views there, and help where
    masks are open."""
    rng = np.random.default_rng(3)
    masks = np.maximum(rng.random((VIEWS, *SIZE)) < 0.25, 0.03).astype(np.float32)
    light = np.einsum("nhw,nhwc->hwc", masks, truth)
    leaky = Holdout.of(Shot(light.astype(np.float32), masks).check(), 0.3, 0)
    views, dark = noisy(truth, 15, 0.05), (masks.max(axis=0) < 1)[None, :, :, None]
    changed = follower(leaky, views).full + np.float32(0.6) * dark
    assert error(changed, truth) > 2 * error(views, truth)
    found = shares(leaky, {"as it is": same(views), "changed": Candidate(views, changed)}, 1e-6)
    assert found["as it is"] > 0.6


def test_what_follows_each_reading_is_taken_without_noise_and_left_with_much(truth):
    """Both look alike to the held-out pixels, which see neither the readings' detail nor their noise put back.

    Detail lies in places, as it does in pictures: a tenth of the pixels.
    """
    found, places = {}, np.random.default_rng(7).random((*SIZE, 1)) < 0.1
    for noise, detail in ((0.005, 0.25), (0.3, 0.06)):
        holdout = holdout_of(truth, noise)
        scene = np.where(places, noisy(truth, 7, detail), truth)
        candidates = {"follower": follower(holdout, scene), "scene": same(scene)}
        found[noise] = shares(holdout, candidates, noise_power(holdout, scene))
        best = min(error(one.full, truth) for one in candidates.values())
        given = combined({name: one.full for name, one in candidates.items()}, found[noise])
        assert error(given, truth) < 1.05 * best
    assert found[0.005]["follower"] > 0.8
    assert found[0.3]["scene"] > 0.8


def test_noise_is_never_more_than_what_a_candidate_leaves_of_pixels_it_did_not_see(truth):
    """A scene that is wrong everywhere leaves what looks like noise; a decode that foretells readings knows better."""
    holdout = holdout_of(truth, 0.01)
    wrong = noisy(truth, 10, 0.3)
    candidates = {"scene": same(wrong), "decode": follower(holdout, noisy(truth, 11, 0.02))}
    assert noise_power(holdout, wrong) > 100 * 0.01**2
    assert shares(holdout, candidates, noise_power(holdout, wrong))["decode"] > 0.95


def test_behind_a_colour_filter_array_only_the_channel_that_is_read_is_known(truth):
    holdout = holdout_of(truth)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    channel = (rows % 2 + columns % 2)[..., None]
    mosaic = replace(
        holdout.shot, measurement=np.take_along_axis(holdout.shot.measurement, channel, 2), cfa="RGGB"
    ).check()
    of_mosaic = Holdout(mosaic, holdout.pixels)
    blind = noisy(truth, 8, 0.08)
    left = mosaic.measurement - of_mosaic.coded(blind)
    masks = mosaic.masks[..., None]
    step = masks * (left / np.maximum((masks**2).sum(axis=0), 1e-9))[None]
    full = (blind + np.where(np.arange(3) == channel, step, 0)).astype(np.float32)
    found = expected_products(of_mosaic, [same(blind), Candidate(blind, full)], 0.0)
    gained = [np.mean((truth - views)[:, holdout.pixels] ** 2, axis=2).sum(axis=0).mean() for views in (blind, full)]
    assert found[0, 0] - found[1, 1] == pytest.approx(gained[0] - gained[1], rel=0.2)


@pytest.mark.parametrize(
    ("products", "expected"),
    [
        ([[2.0]], [1]),
        ([[1.0, 0.0], [0.0, 1.0]], [0.5, 0.5]),
        ([[1.0, 0.9], [0.9, 3.0]], [0.954, 0.046]),
        ([[1.0, 1.2], [1.2, 3.0]], [1, 0]),
        ([[1.0, 1.0], [1.0, 1.0]], [1, 0]),
        ([[1.0, 3.0], [3.0, 2.0]], [1, 0]),  # indefinite: the stationary point between them is the largest
        ([[1.0, 0.0, 5.0], [0.0, 1.0, 5.0], [5.0, 5.0, 9.0]], [0.5, 0.5, 0]),
    ],
)
def test_the_least_on_the_simplex(products, expected):
    np.testing.assert_allclose(least_on_simplex(np.array(products)), expected, atol=1e-3)


def test_the_least_on_the_simplex_is_the_least_of_a_grid():
    rng = np.random.default_rng(9)
    grid = rng.dirichlet(0.5 * np.ones(4), 4000)
    for _ in range(20):
        root = rng.normal(0, 1, (4, 4))
        products = root @ root.T - 0.5 * np.eye(4)
        found = least_on_simplex(products)
        assert found @ products @ found <= np.einsum("gi,ij,gj->g", grid, products, grid).min() + 1e-12
        assert found.sum() == pytest.approx(1)
        assert found.min() >= 0


def test_the_first_stands_where_nothing_was_held_out(holdout, truth):
    blind = Holdout(holdout.shot, np.zeros(SIZE, bool))
    assert shares(blind, {"first": same(truth), "second": same(noisy(truth, 5))}, 0.0) == {"first": 1.0, "second": 0.0}


def test_a_dark_measurement_gives_shares(holdout, truth):
    dark = Holdout(replace(holdout.shot, measurement=0 * holdout.shot.measurement), holdout.pixels)
    found = shares(dark, {"first": same(0 * truth), "second": same(0 * truth)}, 0.0)
    assert sum(found.values()) == pytest.approx(1)


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_errors_that_cancel_along_the_views_count_for_what_they_are(truth, noise):
    holdout = holdout_of(truth, noise)
    errors = np.random.default_rng(5).normal(0, 0.1, truth.shape)
    errors -= errors.mean(axis=0)
    right_in_sum, other = (truth + errors).astype(np.float32), noisy(truth, 6, 0.08)
    as_given, known = (
        expected_products(holdout, [Candidate(right_in_sum, right_in_sum, cancels=cancels), same(other)], noise**2)
        for cancels in (False, True)
    )
    # What is the same for all, N σ²/|M|², stays in.
    rest = noise**2 * VIEWS * np.mean(1 / (holdout.shot.masks[:, holdout.pixels] ** 2).sum(axis=0))
    power = (errors**2).sum(axis=0).mean()
    assert known[0, 0] - rest == pytest.approx(power, rel=0.2)
    assert as_given[0, 0] - rest < 0.75 * power
    assert known[1, 1] == as_given[1, 1]
    assert known[0, 1] == pytest.approx(rest, abs=0.15 * power)


def test_what_is_not_finite_gets_no_share(holdout, truth):
    broken = Candidate(truth, np.full_like(truth, np.nan))
    assert shares(holdout, {"first": broken, "second": same(truth)}, 0.0) == {"first": 0.0, "second": 1.0}
    assert shares(holdout, {"first": broken, "second": broken}, 0.0) == {"first": 1.0, "second": 0.0}


def test_what_has_no_share_need_not_be_there(truth):
    assert np.array_equal(combined({"first": truth}, {"first": 1.0, "second": 0.0}), truth)


@pytest.mark.parametrize("deviation", [0.02, 0.1])
def test_the_expected_error_is_the_error_where_views_err_in_their_own_ways(truth, holdout, deviation):
    assert expected_rms(holdout, same(noisy(truth, 1, deviation)), 0.0) == pytest.approx(deviation, rel=0.15)


def test_the_noise_of_readings_is_no_error_of_views(truth):
    holdout, views = holdout_of(truth, noise=0.2), noisy(truth, 1, 0.1)
    assert expected_rms(holdout, same(views), 0.2**2) == pytest.approx(0.1, rel=0.25)
    assert expected_rms(holdout, same(views), 0.0) > 0.14
    assert expected_rms(holdout, same(truth), 0.5**2) == pytest.approx(0, abs=0.02)


def test_a_pixel_that_no_mask_opens_errs_as_one_whose_reading_nobody_saw(truth):
    """Views that explain every reading that they see err less there, and not where there is none."""
    holdout = holdout_of(truth)
    views = follower(holdout, noisy(truth, 1))
    unlit = holdout.shot.masks.copy()
    unlit[:, :, ::2] = 0
    half = Holdout(replace(holdout.shot, masks=unlit), holdout.pixels & unlit.any(axis=0))
    few, many = expected_rms(holdout, views, 0.0), expected_rms(half, follower(half, noisy(truth, 1)), 0.0)
    assert few < 0.93 * expected_rms(holdout, same(views.blind), 0.0)
    assert many > few


def test_nothing_is_expected_without_pixels_held_out_or_of_views_that_are_not_finite(truth, holdout):
    assert expected_rms(Holdout(holdout.shot, np.zeros(SIZE, bool)), same(truth), 0.0) is None
    assert expected_rms(holdout, same(np.full_like(truth, np.nan)), 0.0) is None
