"""Which order of depth is taken, by what brief fits of both leave; the fits are replaced."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code
from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.geometry.initialise import Geometry, OtherOrder
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.reversal import reversed_geometry
from gs2ci.reconstruct.hypotheses.findings import order_findings
from gs2ci.reconstruct.hypotheses.hypothesis import DepthOrder, OrderFound
from gs2ci.reconstruct.hypotheses.order import is_open, mean_square, settle, shortened
from gs2ci.reconstruct.measurement.holdout import Holdout

NEAR_LEFT = np.tile(np.linspace(1.3, 0.7, 128, dtype=np.float32), (96, 1))


CAMERA = np.array([[2000.0, 0, 64], [0, 2000, 48], [0, 0, 1]])


@pytest.fixture
def found():
    """A camera that turns so that the middle of the scene stays put: its travel tells nothing of the order."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (-0.02, -0.01, 0, 0.01)
    poses[:, :3, :3] = Rotation.from_rotvec(-poses[:, 0, 3, None] * [0.0, 1.0, 0.0]).as_matrix()
    return Geometry(poses, CAMERA, "file", NEAR_LEFT, 2, 100, 0.3, 2.0, "full", ())


@pytest.fixture
def carried(found):
    """The same without a turn, as a stage would carry it."""
    poses = found.world_to_camera.copy()
    poses[:, :3, :3] = np.eye(3)
    return replace(found, world_to_camera=poses)


class Fits:
    """Stands for brief fits: what either order leaves, near left and near right, in turn."""

    def __init__(self, *left, luck=()):
        self.left, self.luck, self.tried = left, luck, []

    def __call__(self, geometry, number):
        near_left = geometry.inverse_depth[0, 0] > geometry.inverse_depth[0, -1]
        self.tried.append((near_left, number))
        return self.left[0 if near_left else 1] * (self.luck[number] if near_left and self.luck else 1.0)


def settled(geometry, fits, *, given=False):
    """Return the geometry taken, with what is said of its order."""
    geometry = replace(geometry, source="file") if given else geometry
    taken, order = settle(geometry, lambda one: one, fits)
    return replace(taken, notes=order_findings(order, taken))


def codes(geometry):
    return [note.code for note in geometry.notes]


def near_is_left(geometry):
    return bool(geometry.inverse_depth[0, 0] > geometry.inverse_depth[0, -1])


def test_an_order_that_leaves_clearly_less_stays_after_one_pair_and_without_a_word(found):
    fits = Fits(1.0, 1.5)
    taken = settled(found, fits)
    assert near_is_left(taken)
    assert codes(taken) == []
    assert taken.order_errors > 2
    assert len(fits.tried) == 2


def test_an_order_that_leaves_clearly_more_is_turned_over_with_a_word(found):
    taken = settled(found, Fits(1.5, 1.0))
    assert not near_is_left(taken)
    assert codes(taken) == [Code.DEPTH_ORDER_TURNED]
    assert taken.notes[0].sentence.count("2.5 standard errors") == 1
    assert taken.order_errors > 2
    np.testing.assert_allclose(taken.world_to_camera[:, 0, 3], -found.world_to_camera[:, 0, 3])


def test_what_tracks_found_the_other_way_round_is_taken_rather_than_a_mere_reflection(found):
    other = replace(reversed_geometry(found), reprojection_rms_px=0.77)
    taken = settled(replace(found, other_order=OtherOrder.of(other)), Fits(1.5, 1.0))
    assert taken.reprojection_rms_px == 0.77
    assert taken.other_order is None


def test_pairs_begin_in_turn_with_either_finding_of_the_tracks(found):
    fits = Fits(1.0, 1.0)
    settled(replace(found, other_order=OtherOrder.of(reversed_geometry(found))), fits)
    assert [tried for tried, _ in fits.tried] == [False, True, True, False]
    assert [number for _, number in fits.tried] == [0, 0, 1, 1]


@pytest.mark.parametrize("left", [(1.0, 1.02), (1.02, 1.0), (0.0, 0.0), (float("nan"), 1.0), (1.0, float("inf"))])
def test_orders_that_leave_about_as_much_are_said_to_be_open(found, left):
    taken = settled(found, Fits(*left))
    assert codes(taken) == [Code.DEPTH_ORDER_OPEN]
    assert "may be exchanged" in taken.notes[0].sentence
    assert 0 <= taken.order_errors < 2


def test_pairs_that_contradict_one_another_are_no_evidence(found):
    taken = settled(found, Fits(1.0, 1.0, luck=(0.87, 1.2, 0.85, 1.25)))
    assert codes(taken) == [Code.DEPTH_ORDER_OPEN]


def test_one_finding_and_its_mere_reflection_are_not_sure_by_what_two_findings_are(found):
    """A reflection leaves more for being one, which only the reflection of what tracks found the other way tells."""
    alone, both = (
        settled(found, Fits(1.0, 1.2)),
        settled(replace(found, other_order=OtherOrder.of(reversed_geometry(found))), Fits(1.0, 1.2)),
    )
    assert codes(alone) == [Code.DEPTH_ORDER_OPEN]
    assert codes(both) == []
    assert both.order_errors == pytest.approx(2 * alone.order_errors, abs=0.1)


def test_both_findings_have_their_turn_before_either_is_believed(found):
    """The first pair, of the finding near left, speaks for it by what a reflection alone may leave more."""
    fits = Fits(1.0, 1.0, luck=(0.75, 1.35))
    taken = settled(replace(found, other_order=OtherOrder.of(reversed_geometry(found))), fits)
    assert codes(taken) == [Code.DEPTH_ORDER_OPEN]
    assert len(fits.tried) == 4


def test_what_tracks_say_counts_a_third(found):
    assert codes(settled(replace(found, order_errors=5.7), Fits(1.0, 1.0))) == [Code.DEPTH_ORDER_OPEN]
    assert settled(replace(found, order_errors=5.7), Fits(1.0, 1.0)).order_errors == pytest.approx(1.9)
    assert codes(settled(replace(found, order_errors=6.3), Fits(1.0, 1.0))) == []


def test_a_camera_that_need_not_turn_is_preferred_where_nothing_else_tells(carried):
    for geometry in (carried, replace(reversed_geometry(carried), other_order=OtherOrder.of(carried))):
        taken = settled(geometry, Fits(1.0, 1.0))
        assert near_is_left(taken)
        assert codes(taken) == [Code.DEPTH_ORDER_OPEN]
        assert taken.order_errors == 0.05


def test_a_camera_that_need_not_turn_makes_no_order_sure_that_is_not_sure_without(carried):
    """Of a pair with 2.5 and 1.3 errors: the first is sure alone."""
    both = replace(carried, other_order=OtherOrder.of(reversed_geometry(carried)))
    sure, open_ = settled(both, Fits(1.0, 1.15)), settled(both, Fits(1.0, 1.08))
    assert codes(sure) == []
    assert sure.order_errors == pytest.approx(2.5 + 1.0, abs=0.1)
    assert codes(open_) == [Code.DEPTH_ORDER_OPEN]
    assert open_.order_errors == pytest.approx(1.36, abs=0.1)


def test_short_fits_overrule_a_camera_that_need_not_turn_and_are_sure_by_twice_as_much(carried):
    both = replace(carried, other_order=OtherOrder.of(reversed_geometry(carried)))
    surely, hardly, not_at_all = (settled(both, Fits(left, 1.0)) for left in (1.8, 1.25, 1.04))
    assert not near_is_left(surely)
    assert codes(surely) == [Code.DEPTH_ORDER_TURNED]
    assert not near_is_left(hardly)
    assert codes(hardly) == [Code.DEPTH_ORDER_OPEN]
    assert near_is_left(not_at_all)


def test_how_a_told_path_turns_says_nothing_of_its_sign(carried):
    told, turned = (replace(one, source="file") for one in (carried, reversed_geometry(carried)))
    assert settled(told, Fits(1.0, 1.0), given=True).order_errors == pytest.approx(0.0)
    assert settled(turned, Fits(1.0, 1.0), given=True).order_errors == pytest.approx(0.0)


def test_the_sign_of_a_told_path_decides_where_pixels_do_not(found):
    taken = settled(replace(found, source="file"), Fits(1.02, 1.0), given=True)
    assert near_is_left(taken)
    assert codes(taken) == []


def test_a_told_path_is_not_turned_over_by_what_would_turn_an_untold_one(found):
    assert near_is_left(settled(replace(found, source="file"), Fits(1.18, 1.0), given=True))
    assert not near_is_left(
        settled(replace(found, other_order=OtherOrder.of(reversed_geometry(found))), Fits(1.18, 1.0))
    )


def test_one_pair_however_lucky_does_not_turn_a_told_path_over(found):
    """The first pair speaks for the reverse by ten standard errors; the others, near to nothing, do not all agree."""
    fits = Fits(1.0, 1.0, luck=(2.3, 2.2, 0.99, 2.3))
    taken = settled(replace(found, source="file"), fits, given=True)
    assert near_is_left(taken)
    assert codes(taken) == []
    assert len(fits.tried) == 2 * 4


def test_in_a_smaller_picture_more_is_luck(found):
    small = replace(found, inverse_depth=found.inverse_depth[::4, ::4])
    assert codes(settled(found, Fits(1.0, 1.5))) == []
    assert codes(settled(small, Fits(1.0, 1.5))) == [Code.DEPTH_ORDER_OPEN]


def test_a_told_path_whose_sign_contradicts_the_picture_is_named(found):
    fits = Fits(1.5, 1.0)
    taken = settled(replace(found, source="file"), fits, given=True)
    assert not near_is_left(taken)
    assert codes(taken) == [Code.POSES_SIGN_CONTRADICTED]
    assert "of the file" in taken.notes[0].sentence
    assert taken.source == "file"
    assert len(fits.tried) == 2 * 3


def test_only_a_path_whose_tracks_are_not_sure_is_open(found):
    sure = Criteria().order_errors
    assert is_open(found, Criteria())
    assert is_open(replace(found, order_errors=sure - 0.1), Criteria())
    assert not is_open(replace(found, order_errors=sure), Criteria())
    assert not is_open(replace(found, verdict="static"), Criteria())
    assert not is_open(replace(found, order_given=True, order_errors=-9.0), Criteria())


@pytest.mark.parametrize(
    ("order", "code"),
    [
        (OrderFound(DepthOrder.UNTRIED), Code.DEPTH_ORDER_UNTRIED),
        (OrderFound(DepthOrder.OPEN, 0.4), Code.DEPTH_ORDER_OPEN),
        (OrderFound(DepthOrder.SHOWN, 3.0, times=4.0), Code.DEPTH_ORDER_SHOWN),
        (OrderFound(DepthOrder.LIKELY, 3.0, times=4.0), Code.DEPTH_ORDER_LIKELY),
        (OrderFound(), None),
    ],
)
def test_what_is_known_of_an_order_is_said_only_of_a_path(found, order, code):
    assert [note.code for note in order_findings(order, found)] == ([code] if code else [])
    assert order_findings(order, replace(found, verdict="static")) == ()


def test_a_short_fit_is_judged_by_the_measurement_alone():
    settings = shortened(CoarseSettings(iterations=600))
    assert settings.iterations == 60
    assert settings.surfaces is None
    assert settings.relief is None
    assert settings.steps == replace(CoarseSettings().steps, in_view=None)
    assert settings.poses.given_weight == 0


def test_a_reading_that_cannot_be_trusted_is_not_asked():
    rng = np.random.default_rng(0)
    masks, views = np.ones((3, 4, 5), np.float32), rng.random((3, 4, 5, 1)).astype(np.float32)
    saturated = np.zeros((4, 5), bool)
    saturated[1, 2] = True
    coded = views.sum(axis=0)
    shot = Shot(measurement=coded, masks=masks, weights=np.ones(3, np.float32)).check()
    assert mean_square(Holdout.of(shot, 0.1, 0), views) == pytest.approx(0, abs=1e-10)
    off = coded.copy()
    off[1, 2] = 9.0
    assert mean_square(Holdout.of(replace(shot, measurement=off), 0.1, 0), views) > 1
    trusted = replace(shot, measurement=off, saturated=saturated)
    assert mean_square(Holdout.of(trusted, 0.1, 0), views) == pytest.approx(0, abs=1e-10)
