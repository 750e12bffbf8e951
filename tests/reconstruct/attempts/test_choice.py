"""Rest as a beginning, a doubtful path that is fitted alone, and the ranking of attempts."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Silent
from gs2ci.core.run_records import CurvePoint
from gs2ci.reconstruct.attempts import choice
from gs2ci.reconstruct.attempts.attempt import Attempt, How
from gs2ci.reconstruct.attempts.choice import ranking
from gs2ci.reconstruct.first_look import FirstLook, from_rest, needs_rest
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, Geometry
from gs2ci.reconstruct.measurement.moving import LeftByMotion
from gs2ci.reconstruct.moving import MotionQuestion
from gs2ci.reconstruct.settings import Settings


@pytest.fixture(autouse=True)
def unfollowed(monkeypatch):
    """Where still scenes err over time: nowhere, unless a test says otherwise."""
    where = np.zeros((2, 2), np.float32)
    monkeypatch.setattr(choice, "followed_by_other_alone", lambda *_: where)
    return where


@pytest.fixture(autouse=True)
def orders(monkeypatch):
    """The attempts that were asked which order of depth they show: each keeps its own."""
    asked = []

    def keep(_fits, tried):
        asked.append(tried)
        return tried

    monkeypatch.setattr(choice, "in_shown_order", keep)
    return asked


@pytest.fixture
def moving():
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (-0.2, -0.1, 0, 0.1)
    depth = np.tile(np.linspace(1.3, 0.7, 16, dtype=np.float32), (12, 1))
    notes = (finding(Code.UNIFORM_MOTION, share=0.9), finding(Code.DEPTH_ORDER_OPEN, errors=0.5))
    geometry = Geometry(poses, np.diag([200.0, 200, 1]), "file", depth, 2, 0, 0.0, 0.0, "full", notes, source="uniform")
    return FirstLook(None, None, geometry, None)


def test_rest_is_a_plane_before_a_still_camera_and_claims_no_path(moving):
    assert needs_rest(moving)
    rest = from_rest(moving).geometry
    assert (rest.verdict, rest.source, rest.notes) == ("unsupported", "tracks", (PLANE_NOTE,))
    assert np.array_equal(rest.world_to_camera, np.tile(np.eye(4), (4, 1, 1)))
    assert (rest.inverse_depth == 1).all()
    assert not needs_rest(from_rest(moving))


def test_the_ranking_names_every_attempt_and_the_margin():
    (said,) = ranking({"uniform motion": 0.0220, "rest": 0.0200, "second look": 0.0300, "lost": float("inf")}, "rest")
    assert "rest 0.0200, uniform motion 0.0220, second look 0.0300" in said.sentence
    assert "10.0%" in said.sentence
    assert "The scene from rest is used" in said.sentence
    assert "lost" not in said.sentence


@pytest.mark.parametrize("left", [{"tracks": 0.1}, {"tracks": None, "rest": None}, {"tracks": 0.1, "rest": None}])
def test_one_attempt_alone_has_no_ranking(left):
    assert ranking(left, "tracks") == ()


@dataclass(frozen=True)
class Named(FirstLook):
    """A first look that tells its attempts apart."""

    name: str = "first"


class Tries:
    """Makes attempts whose views are the number that they leave of the held-out pixels; keeps how each was made."""

    def __init__(self, leaves):
        self.leaves, self.made, self.completions, self.beside = leaves, [], 0, ()
        self.holdout, self.lens, self.settings = SimpleNamespace(residual_rms=lambda views: views), None, Settings()
        self.refine, self.progress, self.halt = (lambda views: views), Silent(), Halt()
        self.order_open = False

    def attempt(self, look, views, how):
        name = look.name
        self.made.append((name, how))
        fit = SimpleNamespace(views=self.leaves[name], curve=(CurvePoint(1.0, 100, 0.1, 0.03, None, 5),))
        return Attempt(look, look.geometry, (fit,), SimpleNamespace(views=fit.views), ("companion",))

    def settle_order(self, look, *, hurried):
        assert not hurried
        return look

    def with_order(self, _first, tried):
        return tried

    def is_order_open(self, _geometry):
        return self.order_open

    def completed(self, tried, beside=(), left=None):
        assert left == tried.fits[0].views
        self.completions += 1
        self.beside = [fit.views for fit in beside]
        return replace(tried, later=())

    def again(self, monkeypatch, moving):
        def named(look, name):
            return Named(look.holdout, look.decoded, look.geometry, look.brightness, name=name)

        first = named(moving, "first")
        seen = None if self.leaves["second"] is None else named(moving, "second")
        monkeypatch.setattr(choice, "second_look", lambda *_: seen)
        monkeypatch.setattr(choice, "from_rest", lambda look: named(look, "rest"))
        monkeypatch.setattr(choice, "is_wanted", lambda *_: True)
        return choice.Attempts(self)._again(first, self.attempt(first, None, How(alone=True)))


@pytest.mark.parametrize(
    ("leaves", "taken"),
    [
        ({"first": 0.03, "second": 0.02, "rest": 0.05}, "second"),
        ({"first": 0.02, "second": 0.03, "rest": 0.05}, "first"),
        ({"first": 0.03, "second": None, "rest": 0.02}, "rest"),
    ],
)
def test_a_doubtful_path_is_fitted_alone_and_what_is_taken_is_completed(monkeypatch, moving, leaves, taken):
    tries = Tries(leaves)
    best = tries.again(monkeypatch, moving)
    assert best.look.name == taken
    assert (best.later, tries.completions) == ((), 1)
    assert all(how.alone for _, how in tries.made)
    assert tries.beside == sorted(left for name, left in leaves.items() if left is not None and name != taken)


@pytest.mark.parametrize(
    ("leaves", "taken"),
    [({"first": 0.0300, "second": 0.0299}, "first"), ({"first": 0.0300, "second": 0.0290}, "second")],
)
def test_a_path_that_was_not_found_at_first_is_taken_only_if_it_is_clearly_better(monkeypatch, moving, leaves, taken):
    rest = replace(moving, geometry=replace(moving.geometry, source="tracks", verdict="rotation_only", notes=()))
    tries = Tries(leaves)
    best = tries.again(monkeypatch, rest)
    assert best.look.name == taken
    assert tries.beside == [left for name, left in leaves.items() if name != taken]


def test_further_fits_have_to_keep_up_with_those_along_the_first_path(monkeypatch, moving):
    tries = Tries({"first": 0.03, "second": 0.04, "rest": 0.05})
    tries.again(monkeypatch, moving)
    rivals = {name: how.rival for name, how in tries.made}
    assert rivals["first"] is None
    for name in ("second", "rest"):
        assert rivals[name].heldout == {100: 0.03}
        assert rivals[name].iterations == Settings().fit.iterations


@pytest.mark.parametrize(
    ("same_path", "gain", "asked"),
    [(False, 0.0, ["again"]), (True, 0.0, ["first"]), (True, None, ["first", "again"])],
)
def test_motion_is_asked_of_the_first_fit_only_if_its_path_is_kept(monkeypatch, moving, same_path, gain, asked):
    look, other = (SimpleNamespace(**vars(moving), name="first") for _ in range(2))
    tries, seen = Tries({"first": 0.03}), []
    mean = SimpleNamespace(views=0.02, best=SimpleNamespace(scene=SimpleNamespace(motion=None), curve=()))
    again = replace(tries.attempt(look if same_path else other, None, How()), ensemble=mean)

    def question(_, still):
        name = "again" if still is again else "first"
        seen.append(name)
        return MotionQuestion(gain=gain if name == "first" else 0.0)

    monkeypatch.setattr(choice.Attempts, "_again", lambda *_: again)
    monkeypatch.setattr(choice.Attempts, "_far_apart", lambda _, first, tried: (first, tried))
    monkeypatch.setattr(choice.Attempts, "_question", question)
    _, taken, report = choice.Attempts(tries).all(look)
    assert seen == asked
    assert (taken, report.question.gain) == (again, 0.0)


@pytest.mark.parametrize(
    ("source", "verdict", "error", "moves", "released"),
    [
        ("tracks", "unsupported", None, 0.02, False),
        ("tracks", "unsupported", None, 0.0299, True),
        ("uniform", "full", None, 0.02, False),
        ("uniform", "full", None, 0.0299, True),
        ("tracks", "full", 0.3, 0.02, False),
        ("tracks", "full", 0.01, 0.02, True),
        ("file", "full", None, 0.02, True),
        ("stage", "unsupported", None, 0.02, False),
        ("file", "static", None, 0.02, False),
    ],
)
def test_still_fits_are_continued_along_a_sure_path_or_where_new_moving_fits_are_not_clearly_better(
    monkeypatch, moving, source, verdict, error, moves, released
):
    geometry = replace(moving.geometry, source=source, verdict=verdict, path_error_expected=error)
    first = Named(None, 0.05, geometry, None)
    tries, made = Tries({"first": 0.03}), []

    def attempt(look, left):
        mean = SimpleNamespace(views=left, best=SimpleNamespace(scene=SimpleNamespace(motion=None), curve=()))
        return Attempt(look, look.geometry, (), mean)

    def of(how):
        made.append("moving" if how.moving else "still")
        return attempt(first, moves if how.moving else 0.03)

    def release(still):
        made.append("released")
        return attempt(first, 0.025)

    tries.attempt = lambda look, views, how: of(how)
    tries.completed, tries.release = (lambda tried: tried), release
    monkeypatch.setattr(choice.Attempts, "_again", lambda _, __, tried: tried)
    monkeypatch.setattr(choice.Attempts, "_far_apart", lambda _, first, tried: (first, tried))
    monkeypatch.setattr(choice.Attempts, "_question", lambda *_: MotionQuestion(gain=1.0))
    monkeypatch.setattr(choice.Attempts, "_decoded_better", lambda _, look: look)
    _, taken, report = choice.Attempts(tries).all(first)
    assert made == ["still", "moving", *(["released"] if released else [])]
    assert len(report.heldout_rms) == len(made)
    assert taken.ensemble.views == (min(moves, 0.025) if released else moves)


@pytest.mark.parametrize(("moves", "speaks"), [(False, False), (False, True), (True, True), (True, False)])
def test_only_a_scene_at_rest_is_asked_what_hides_what(monkeypatch, moving, orders, moves, speaks):
    best = SimpleNamespace(scene=SimpleNamespace(motion=object() if moves else None))
    taken = Attempt(moving, moving.geometry, (), SimpleNamespace(best=best))
    report = SimpleNamespace(question=SimpleNamespace(speaks_for_motion=speaks))
    monkeypatch.setattr(choice.Attempts, "_all", lambda _, first: (first, taken, report))
    assert choice.Attempts(Tries({})).all(moving) == (moving, taken, report)
    assert orders == ([] if moves or speaks else [taken])


@pytest.mark.parametrize("order_open", [False, True])
def test_the_best_still_scene_is_asked_for_its_order_and_fitted_alone_before(monkeypatch, moving, orders, order_open):
    geometry = replace(moving.geometry, source="tracks", path_error_expected=0.01)
    tries, alone = Tries({"first": 0.03}), []
    tries.order_open = order_open
    look, turned = Named(None, None, geometry, None), Named(None, None, geometry, None)

    def attempt(at, _views, how):
        alone.append(how.alone)
        mean = SimpleNamespace(views=0.03, best=SimpleNamespace(scene=SimpleNamespace(motion=None), curve=()))
        return Attempt(at, geometry, (), mean)

    other = attempt(turned, None, How())
    tries.attempt = attempt
    monkeypatch.setattr(choice.Attempts, "_far_apart", lambda _, first, tried: (first, tried))
    monkeypatch.setattr(choice.Attempts, "_question", lambda *_: MotionQuestion(gain=0.0))
    monkeypatch.setattr(choice, "in_shown_order", lambda _, tried: orders.append(tried) or other)
    _, taken, _ = choice.Attempts(tries).all(look)
    assert alone == [False, order_open]
    assert [tried.look for tried in orders] == [look]
    assert taken is other


def test_a_decode_at_length_is_sparse_and_has_to_be_better():
    tries = Tries({})
    tries.clock = SimpleNamespace(lap=lambda _: None)
    asked = []

    def look(left):
        better = SimpleNamespace(decoded=0.02)
        return SimpleNamespace(
            decoder="gap-tv", decoded=left, decoded_longer=lambda schedule, _: asked.append(schedule) or better
        )

    decoded = choice.Attempts(tries)._decoded_better(look(0.03))
    assert decoded.decoded == 0.02
    kept = choice.Attempts(tries)._decoded_better(look(0.01))
    assert kept.decoded == 0.01
    sparse, dense = asked[0], tries.settings.long_decode
    assert asked == [sparse, sparse]
    assert sparse.iterations == dense.iterations // 2
    assert sparse.lattice.step_px == sparse.lattice.patch_px > dense.lattice.step_px


@pytest.mark.parametrize(
    ("left", "worse"), [((0.3, 0.2, 0.22), True), ((0.3, 0.2, 0.205), False), ((None, None), False), ((), False)]
)
def test_a_fit_got_worse_if_its_residual_ends_clearly_above_its_least(left, worse):
    curve = tuple(CurvePoint(1.0, 50 * (k + 1), 0.1, one, None, 5) for k, one in enumerate(left))
    still = SimpleNamespace(ensemble=SimpleNamespace(best=SimpleNamespace(curve=curve)))
    assert choice._got_worse(still) == worse


@pytest.mark.parametrize(
    ("decoder", "scene", "behind"),
    [("gap-tv", 0.096, True), ("gap-tv", 0.094, False), ("patches", 0.109, False), ("patches", 0.111, True)],
)
def test_a_scene_is_behind_patches_only_if_it_is_clearly_worse(decoder, scene, behind):
    still = SimpleNamespace(
        ensemble=SimpleNamespace(best=SimpleNamespace(views=scene)),
        look=SimpleNamespace(decoder=decoder, decoded=0.1),
    )
    assert choice.Attempts(Tries({}))._is_behind_decode(still) is behind


@pytest.mark.parametrize(
    ("decoder", "decoded", "gain"), [("gap-tv", 0.05, 0.2), ("patches", 0.05, 0.5), ("patches", 0.09, 0.2)]
)
def test_a_whole_decode_by_patches_counts_as_the_steps_that_follow_the_fit_do(monkeypatch, decoder, decoded, gain):
    monkeypatch.setattr(choice, "ask", lambda *_: LeftByMotion(0.1, 0.1, np.zeros((1, 1, 2))))
    monkeypatch.setattr(choice, "patch_decode_from", lambda *_: 0.08)
    tries = Tries({})
    tries.holdout.seen = None
    best = SimpleNamespace(views=0.1, curve=())
    still = SimpleNamespace(
        ensemble=SimpleNamespace(views=0.1, best=best),
        look=SimpleNamespace(decoder=decoder, decoded=decoded, geometry=SimpleNamespace(known_at_rest=False)),
        geometry=SimpleNamespace(verdict="full"),
    )
    assert choice.Attempts(tries)._question(still).gain == pytest.approx(gain)


def test_a_still_scene_that_errs_over_time_needs_no_patches_to_speak_for_motion(monkeypatch, unfollowed):
    monkeypatch.setattr(choice, "ask", lambda *_: LeftByMotion(0.0, 0.0, np.zeros((1, 1, 2))))
    monkeypatch.setattr(choice, "patch_decode_from", None)
    look = SimpleNamespace(decoded=0.05, geometry=SimpleNamespace(known_at_rest=False))
    still = SimpleNamespace(ensemble=SimpleNamespace(views=0.1), look=look)
    assert not choice.Attempts(Tries({}))._question(still).speaks_for_motion
    unfollowed[0] = 0.08
    asked = choice.Attempts(Tries({}))._question(still)
    assert asked.unfollowed == pytest.approx(0.04)
    assert asked.speaks_for_motion


def test_attempts_are_compared_by_views_as_delivered(monkeypatch, unfollowed):
    monkeypatch.setattr(choice, "replaced", lambda views, decoded, where: decoded)
    attempts = choice.Attempts(Tries({}))
    assert attempts._residual(0.3, 0.1) == 0.3
    unfollowed[0] = 1.0
    assert attempts._residual(0.3, 0.1) == 0.1
    assert attempts._residual(0.3) == 0.3


class Apart(Tries):
    """Attempts along a path of tracks and along one of matched features."""

    def __init__(self, leaves, monkeypatch, moving, *, joins, better=True, far=False):
        super().__init__(leaves)
        self.clock, self.asked, self.path = SimpleNamespace(lap=lambda _: None), 0, object()
        geometry = replace(moving.geometry, source="tracks", notes=())
        self.first = Named(None, None, geometry, None, name="first")
        wide = Named(None, None, replace(geometry, source="wide"), None, name="wide")

        def looked(*given):
            self.asked += 1
            assert given[-1] is self.path
            return wide if joins else None

        monkeypatch.setattr(choice, "look_far_apart", looked)
        monkeypatch.setattr(choice, "turns_far", lambda path: far and path is self.path)
        monkeypatch.setattr(choice.Attempts, "_is_behind_decode", lambda _, tried: tried.fits[0].views > 0.05)
        decoder = "patches" if better else "gap-tv"
        monkeypatch.setattr(choice.Attempts, "_decoded_better", lambda _, look: replace(look, decoder=decoder))

    def completed(self, tried, beside=(), left=None):
        assert left == tried.fits[0].views
        self.completions += 1
        self.beside = [fit.views for fit in beside]
        return tried

    def attempt(self, look, views, how):
        tried = super().attempt(look, views, how)
        best = SimpleNamespace(world_to_camera=self.path)
        return replace(tried, ensemble=SimpleNamespace(views=tried.fits[0].views, best=best))

    def taken(self, first=None):
        tried = self.attempt(self.first, None, How())
        self.after, taken = choice.Attempts(self)._far_apart(first or self.first, tried)
        return taken.look.name


@pytest.mark.parametrize(
    ("leaves", "joins", "taken", "asked"),
    [
        ({"first": 0.04, "wide": 0.01}, True, "first", 0),
        ({"first": 0.06, "wide": 0.01}, True, "wide", 1),
        ({"first": 0.06, "wide": 0.07}, True, "first", 1),
        ({"first": 0.06}, False, "first", 1),
    ],
)
def test_a_scene_behind_the_decode_is_tried_along_matched_features(monkeypatch, moving, leaves, joins, taken, asked):
    tries = Apart(leaves, monkeypatch, moving, joins=joins)
    assert tries.taken() == taken
    assert tries.asked == asked
    assert tries.completions == (asked and joins)
    assert list(tries.beside) == ([leaves["first"]] if taken == "wide" else [])
    assert all(how.rival.heldout == {100: 0.03} for name, how in tries.made if name == "wide")


@pytest.mark.parametrize(("leaves", "taken"), [({"first": 0.04, "wide": 0.03}, "wide"), ({"first": 0.04}, "first")])
def test_a_path_that_turns_far_is_matched_again_although_its_scene_is_ahead_of_the_decode(
    monkeypatch, moving, leaves, taken
):
    tries = Apart(leaves, monkeypatch, moving, joins="wide" in leaves, far=True)
    assert (tries.taken(), tries.asked) == (taken, 1)


def test_the_longer_decode_is_kept_and_has_to_be_better(monkeypatch, moving):
    tries = Apart({"first": 0.06}, monkeypatch, moving, joins=False)
    assert (tries.taken(), tries.after.decoder, tries.asked) == ("first", "patches", 1)
    tries = Apart({"first": 0.06}, monkeypatch, moving, joins=True, better=False)
    assert (tries.taken(), tries.after.decoder, tries.asked) == ("first", "gap-tv", 0)


def test_beside_a_motion_without_tracks_features_are_not_matched_after_the_fits_again(monkeypatch, moving):
    tries = Apart({"first": 0.06}, monkeypatch, moving, joins=True)
    untracked = replace(tries.first, geometry=replace(tries.first.geometry, source="uniform"))
    assert (tries.taken(untracked), tries.after.decoder, tries.asked) == ("first", "patches", 0)


@pytest.mark.parametrize("source", ["wide", "stage", "file"])
def test_paths_of_another_source_or_of_features_already_tried_are_not_tried_again(monkeypatch, moving, source):
    tries = Apart({"first": 0.06}, monkeypatch, moving, joins=True)
    partly = finding(Code.VIEWS_JOIN_IN_PART, joined=3, views=8)
    tried_before = replace(tries.first, geometry=replace(tries.first.geometry, notes=(partly,)))
    given = replace(tries.first, geometry=replace(tries.first.geometry, source=source))
    assert (tries.taken(given), tries.taken(tried_before), tries.asked) == ("first", "first", 0)
