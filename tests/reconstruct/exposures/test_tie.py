"""Exposures tied without telemetry: in any order and unit, distorted, without a path, from elsewhere, degenerate."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.exposures import tie as module
from gs2ci.reconstruct.exposures.tie import NotTied, Tied, Why, tie
from gs2ci.reconstruct.geometry.kinds import Verdict
from gs2ci.reconstruct.geometry.reversal import reversed_geometry
from tests.reconstruct.exposures.rooms import (
    PLACES,
    SIZE,
    UNITS,
    VIEWS,
    WALL,
    distorted,
    exposure,
    middle,
    off_px,
    path,
    truly,
)

ELSEWHERE = exposure("elsewhere", middle(0.1), seed=9, noise=0.02)


def check(ties, exposures, true, limit_px):
    for number, one in ties.tied.items():
        assert off_px(one.common_from_own, true[number], exposures[number].geometry) < limit_px


def test_each_is_brought_into_the_coordinates_of_the_first(four, four_tied):
    assert [one.name for one in four_tied.all] == [f"shot {k}" for k in range(4)]
    assert list(four_tied.tied) == [0, 1, 2, 3]
    true = truly(PLACES, UNITS)
    check(four_tied, four, true, 0.3)
    for number, one in four_tied.tied.items():
        assert one.common_from_own.scale == pytest.approx(true[number].scale, rel=0.01)
        assert set(one.partners) == set(range(4)) - {number}
        assert one.corners > 100
    assert four_tied.distance_px < 0.2


def test_errors_are_stated_and_none_of_the_first(four_tied):
    first, *others = four_tied.tied.values()
    assert (first.turn_error_deg, first.place_error) == (0, 0)
    for one in others:
        assert 0 < one.turn_error_deg < 1
        assert 0 < one.place_error < 0.1


def test_the_order_does_not_matter(four, four_tied):
    order = [2, 0, 3, 1]
    again = tie([four[k] for k in order])
    check(again, [four[k] for k in order], truly([PLACES[k] for k in order], [UNITS[k] for k in order]), 0.3)
    assert list(again.tied) == [0, 1, 2, 3]


def test_one_from_elsewhere_is_left_out_by_name_and_changes_nothing(four):
    found, alone = tie([four[0], ELSEWHERE, four[1]]), tie(four[:2])
    out = found.left_out[1]
    assert (out.name, out.why) == ("elsewhere", Why.NOTHING_SHARED)
    for with_it, without in zip([found.tied[k] for k in (0, 2)], alone.all, strict=True):
        np.testing.assert_array_equal(with_it.common_from_own.translation, without.common_from_own.translation)
        np.testing.assert_array_equal(with_it.geometry.world_to_camera, without.geometry.world_to_camera)


def test_if_the_first_is_from_elsewhere_the_next_one_gives_the_coordinates(four):
    found = tie([ELSEWHERE, *four[:2]])
    assert list(found.left_out) == [0]
    np.testing.assert_array_equal(found.tied[1].common_from_own.rotation, np.eye(3))
    check(found, [ELSEWHERE, *four], truly([middle(), *PLACES[:2]], [1.0, *UNITS[:2]], first=1), 0.5)


def test_distorted_depths_are_mended_by_what_others_see(four):
    bent = [
        distorted(one, stretch, offset)
        for one, stretch, offset in zip(four, (0.8, 1.2, 0.7, 1.1), (0.2, -0.1, 0.3, 0), strict=True)
    ]
    found = tie(bent)
    for number, one in found.tied.items():
        true, before = four[number].geometry.inverse_depth, bent[number].geometry.inverse_depth
        after = one.geometry.inverse_depth
        # Up to the scale, which the similarity carries.
        error = [np.std(np.log(depth / true)) for depth in (before, after)]
        assert error[1] < max(0.5 * error[0], 0.03)
    assert list(found.tied) == [0, 1, 2, 3]


def test_an_inverted_depth_is_put_right(four):
    inverted = four[1].geometry.inverse_depth
    inverted = (inverted.max() + inverted.min() - inverted).astype(np.float32)
    given = [four[0], replace(four[1], geometry=replace(four[1].geometry, inverse_depth=inverted)), four[2]]
    found = tie(given).tied[1]
    true = four[1].geometry.inverse_depth
    assert np.corrcoef(inverted.ravel(), true.ravel())[0, 1] < -0.9
    assert np.corrcoef(found.geometry.inverse_depth.ravel(), true.ravel())[0, 1] > 0.9


def test_one_whose_order_is_open_and_wrong_is_turned_and_no_right_one(four):
    open_order = [replace(one, geometry=replace(one.geometry, order_errors=1.0)) for one in four]
    wrong = replace(open_order[1], geometry=reversed_geometry(open_order[1].geometry))
    found = tie([open_order[0], wrong, *open_order[2:]])
    assert [one.turned for one in found.tied.values()] == [False, True, False, False]
    check(found, four, truly(PLACES, UNITS), 1.5)
    true = four[1].geometry.inverse_depth
    assert np.corrcoef(wrong.geometry.inverse_depth.ravel(), true.ravel())[0, 1] < -0.9
    assert np.corrcoef(found.tied[1].geometry.inverse_depth.ravel(), true.ravel())[0, 1] > 0.9


def test_one_without_a_path_is_tied_and_its_path_is_found(four):
    plane = replace(
        four[1].geometry,
        inverse_depth=np.ones(SIZE, np.float32),
        world_to_camera=np.tile(np.eye(4), (VIEWS, 1, 1)),
        verdict=Verdict.ROTATION_ONLY,
    )
    found = tie([four[0], replace(four[1], geometry=plane), four[2]]).tied[1]
    assert found.geometry.verdict == Verdict.FULL
    true = path(PLACES[1])
    moved = found.common_from_own.poses(found.geometry.world_to_camera)
    centres = np.linalg.inv(moved)[:, :3, 3] * UNITS[0]
    expected = np.linalg.inv(true @ np.linalg.inv(PLACES[0]))[:, :3, 3]
    # Three noisy views, 0.06 from the first to the last.
    assert np.linalg.norm((centres - centres[1]) - (expected - expected[1]), axis=1).max() < 0.02


def test_a_camera_that_only_turned_between_exposures_is_tied():
    turns = [middle(), middle(turn_deg=(0, 5, 0)), middle(turn_deg=(3, -2, 4))]
    exposures = [exposure(str(k), at, noise=0.02) for k, at in enumerate(turns)]
    found = tie(exposures)
    assert list(found.tied) == [0, 1, 2]
    check(found, exposures, truly(turns, [1.0] * 3), 0.5)


def test_two_exposures_of_one_path_coincide():
    twice = [
        exposure(str(k), middle(), unit=unit, noise=noise) for k, (unit, noise) in enumerate(((1.0, 0.02), (1.6, 0.03)))
    ]
    found = tie(twice)
    check(found, twice, truly([middle()] * 2, (1.0, 1.6)), 0.3)
    assert list(found.tied) == [0, 1]


def test_a_planar_scene_is_tied():
    places = [middle(), middle(0.2, 0.1, (1.0, -4.0, 2.0)), middle(-0.2, 0.0, (0.0, 3.0, 0.0))]
    flat = [exposure(str(k), at, noise=0.02, panel=WALL - 1e-6) for k, at in enumerate(places)]
    found = tie(flat)
    assert list(found.tied) == [0, 1, 2]
    check(found, flat, truly(places, [1.0] * 3), 1.0)


def test_what_cannot_be_tied_is_named_with_its_reason(four):
    views, geometry = four[0].views, four[0].geometry
    nan, infinite, depthless = views.copy(), geometry.world_to_camera.copy(), geometry.inverse_depth.copy()
    nan[0, 3, 4], infinite[1, 0, 3], depthless[5, 5] = np.nan, np.inf, 0
    bad = [
        replace(four[0], name="nan", views=nan),
        replace(four[0], name="infinite", geometry=replace(geometry, world_to_camera=infinite)),
        replace(four[0], name="no depth", geometry=replace(geometry, inverse_depth=depthless)),
        replace(four[0], name="plain", views=np.full_like(views, 0.5)),
    ]
    found = tie([*bad, *four[1:3]])
    assert list(found.tied) == [4, 5]
    assert [(one.name, one.why) for one in found.left_out.values()] == [
        ("nan", Why.NOT_FINITE),
        ("infinite", Why.NOT_FINITE),
        ("no depth", Why.NOT_FINITE),
        ("plain", Why.NO_TEXTURE),
    ]


def test_a_single_exposure_and_none_that_share_anything():
    alone = tie([ELSEWHERE])
    assert isinstance(alone.all[0], Tied)
    assert alone.all[0].common_from_own.scale == 1
    apart = tie([ELSEWHERE, exposure("another", middle(), seed=4, noise=0.02)])
    assert [one.why for one in apart.all] == [Why.NOTHING_SHARED] * 2
    assert apart.distance_px is None
    assert tie([]).all == ()
    broken = replace(ELSEWHERE, views=np.full_like(ELSEWHERE.views, np.nan))
    assert [one.why for one in tie([broken]).all] == [Why.NOT_FINITE]


def test_two_scenes_leave_the_larger_one(four):
    others = [exposure(f"other {k}", at, seed=9, noise=0.02) for k, at in enumerate(PLACES[:2])]
    found = tie([*others, *four[:3]])
    assert list(found.tied) == [2, 3, 4]
    assert {one.why for one in found.left_out.values()} == {Why.APART}


def test_many_exposures_are_matched_with_the_likeliest_partners_only(four, monkeypatch):
    tried = []
    real = module.tie_pair
    monkeypatch.setattr(module, "_ALL_PAIRS", 3)
    monkeypatch.setattr(module, "_PARTNERS", 1)
    monkeypatch.setattr(module, "tie_pair", lambda *given: tried.append(len(given)) or real(*given))
    near = [exposure(f"near {k}", middle(0.02 * k), seed=9, noise=0.02) for k in range(2)]
    found = tie([*near, four[0], four[1]])
    assert tried.count(2) == 2
    assert isinstance(found.all[0], Tied)
    assert isinstance(found.all[2], NotTied)


def test_an_exposure_whose_only_tie_contradicts_the_rest_is_said_so(four, monkeypatch):
    frame = module.closed

    def contradicting(pairs, count):
        kept = {pair: one for pair, one in pairs.items() if 2 not in pair}
        found = frame(kept, count)
        return replace(found, contradicting=tuple(pair for pair in pairs if 2 in pair))

    monkeypatch.setattr(module, "closed", contradicting)
    found = tie(four[:3])
    assert found.left_out[2].why == Why.CONTRADICTED
