"""Which hypotheses are fitted, how far, and which one is delivered, by what each leaves of the held-out pixels.

The fits are replaced: a hypothesis leaves what the table says from its first look on.
"""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Silent
from gs2ci.core.run_figures import CurvePoint
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.hypotheses import jury, race
from gs2ci.reconstruct.hypotheses.findings import course_findings
from gs2ci.reconstruct.hypotheses.fitting import Entrant
from gs2ci.reconstruct.hypotheses.hypothesis import OrderFound, RaceOutcome
from gs2ci.reconstruct.measurement.moving import LeftByMotion
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.settings import Settings

LONG = 400
QUIET, LOUD = LeftByMotion(0.0, 0.0), LeftByMotion(0.2, 0.5)
# One block of 16 px, of the first thing's side of the picture, moves.


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit whose views are the number that it leaves."""

    views: np.float64
    scene: object
    beside: bool = False
    world_to_camera: object = None
    intrinsics: object = None


class Run:
    """A fit that leaves the same at each of its looks; it cannot begin if that is not a number."""

    def __init__(self, leaves, schedule, moves):
        self.leaves, self.schedule, self.iterations = leaves, schedule, 0
        self.scene = SimpleNamespace(motion=np.ones(3) if moves else None)

    @property
    def curve(self):
        looks = range(50, self.iterations + 1, 50)
        return tuple(CurvePoint(1.0, done, 0.1, self.leaves, None, 5) for done in looks)

    @property
    def has_ended(self):
        return self.iterations >= self.schedule

    def advance(self, share):
        if np.isnan(self.leaves):
            raise NumericsError("the first iteration of the fit is not finite")
        self.iterations = max(self.iterations, round(share * self.schedule))

    def views(self):
        return np.float64(self.leaves)

    def result(self):
        self.schedule = min(self.schedule, self.iterations)
        return Fit(np.float64(self.leaves), self.scene, world_to_camera=np.eye(4)[None], intrinsics=np.eye(3))


@dataclass
class Fits:
    """Makes fits that leave what a table says, by their origin."""

    leaves: dict
    settings: Settings
    scatter: float = 0.0

    def __post_init__(self):
        # Squares at eight held-out pixels; differences between two of them scatter alike.
        factors = 1 + self.scatter * np.array([-1, 1] * 4)
        self.holdout = SimpleNamespace(
            residual_rms=float,
            seen=None,
            squared_residuals=lambda views: factors * float(views) ** 2,
            shot=SimpleNamespace(size=(64, 64)),
        )
        self.refine, self.progress, self.halt, self.lens, self.mask_moments = (
            (lambda v: v),
            Silent(),
            Halt(),
            None,
            None,
        )
        self.clock = SimpleNamespace(lap=lambda _: None)
        self.averaged = ()

    def enter(self, hypothesis, number, of, began):
        run = Run(self.leaves.get(hypothesis.origin.value, self.leaves["first look"]), LONG, hypothesis.moves)
        return Entrant(number, of, hypothesis, hypothesis.look.geometry, run, LONG, began)

    def advance(self, field, share):
        for one in field:
            one.run.advance(share)
        return tuple(field)

    def order_of(self, look):
        return look, OrderFound(0.3) if self.leaves.get("opens") else OrderFound()

    def mean(self, fits):
        self.averaged = fits
        return SimpleNamespace(best=fits[0], averaged=len(fits))


@pytest.fixture
def first():
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (-0.2, -0.1, 0, 0.1)
    depth = np.tile(np.linspace(1.3, 0.7, 16, dtype=np.float32), (12, 1))
    geometry = Geometry(poses, np.diag([200.0, 200, 1]), "file", depth, 2, 0, 0.0, 0.0, "full", ())
    return FirstLook(None, np.float64(0.10), geometry, None)


def run(
    monkeypatch,
    first,
    leaves,
    order=None,
    *,
    left=QUIET,
    settings=None,
    scatter=0.0,
    followed=lambda *_: np.zeros(1),
):
    """Race from a first look; return the result, and how many iterations each hypothesis got."""
    fits = Fits(leaves, settings or Settings(), scatter=scatter)
    again = "second look" in leaves
    found = replace(first, geometry=replace(first.geometry, verdict="full", path_error_expected=0.01))
    monkeypatch.setattr(race, "second_look", lambda *_: found if again else None)
    matched = replace(first, geometry=replace(first.geometry, source="wide"))
    monkeypatch.setattr(race, "look_far_apart", lambda *_: matched if "wide" in leaves else None)
    monkeypatch.setattr(jury, "ask", lambda *_: left)
    monkeypatch.setattr(jury, "followed_by_other_alone", followed)
    monkeypatch.setattr(jury, "patch_decode_from", lambda *_: np.float64(0.1))
    longer = replace(first, decoder="patches", decoded=np.float64(0.099))
    monkeypatch.setattr(FirstLook, "decoded_longer", lambda *_, **__: longer)
    raced = race.Race(fits).run(first, order or OrderFound())
    return raced, [(one.hypothesis.value, one.iterations) for one in raced.course]


DOUBTFUL, PATHLESS = {"path_error_expected": 0.2}, {"verdict": "rotation_only"}
OPEN = OrderFound(0.4)
FIRST, SECOND = "first look", "second look"
COMPANION, MATCHED = "other density rule", "wide"


@pytest.mark.parametrize(
    ("geometry", "order", "leaves", "fitted", "taken"),
    [
        ({}, None, {FIRST: 0.03}, [(FIRST, 400), (COMPANION, 400)], FIRST),
        ({}, OPEN, {FIRST: 0.03}, [(FIRST, 400), (COMPANION, 400)], FIRST),
        (DOUBTFUL, None, {FIRST: 0.03, SECOND: 0.02}, [(FIRST, 200), (SECOND, 400), (COMPANION, 400)], SECOND),
        (DOUBTFUL, None, {FIRST: 0.022, SECOND: 0.02}, [(FIRST, 400), (SECOND, 400)], SECOND),
        (DOUBTFUL, None, {FIRST: 0.02, SECOND: 0.03}, [(FIRST, 400), (SECOND, 100), (COMPANION, 400)], FIRST),
        (DOUBTFUL, None, {FIRST: 0.02}, [(FIRST, 400), (COMPANION, 400)], FIRST),
        (DOUBTFUL, OPEN, {FIRST: 0.02, SECOND: 0.021}, [(FIRST, 400), (SECOND, 400)], FIRST),
        (PATHLESS, None, {FIRST: 0.03, SECOND: 0.0299}, [(FIRST, 400), (SECOND, 400)], FIRST),
        (PATHLESS, None, {FIRST: 0.03, SECOND: 0.029}, [(FIRST, 400), (SECOND, 400)], SECOND),
        (PATHLESS, None, {FIRST: 0.03, SECOND: 0.029, "opens": True}, [(FIRST, 400), (SECOND, 400)], SECOND),
        (DOUBTFUL, None, {FIRST: 0.02, SECOND: float("nan")}, [(FIRST, 400), (SECOND, 0), (COMPANION, 400)], FIRST),
        ({}, None, {FIRST: 0.12, MATCHED: 0.05}, [(FIRST, 400), (COMPANION, 200), (MATCHED, 400)], MATCHED),
        ({}, None, {FIRST: 0.12, MATCHED: 0.2}, [(FIRST, 400), (COMPANION, 400), (MATCHED, 100)], FIRST),
        ({"source": "stage"}, None, {FIRST: 0.12, MATCHED: 0.05}, [(FIRST, 400), (COMPANION, 400)], FIRST),
    ],
)
def test_what_is_most_in_doubt_is_fitted_beside_the_best(monkeypatch, first, geometry, order, leaves, fitted, taken):
    first = replace(first, geometry=replace(first.geometry, **geometry))
    raced, made = run(monkeypatch, first, leaves, order)
    assert made == fitted
    assert [one.hypothesis.value for one in raced.course if one.outcome == RaceOutcome.LED] == [taken]
    assert sum(iterations == LONG for _, iterations in made) <= 2


MOVES = "moving from the first"


@pytest.mark.parametrize(
    ("left", "leaves", "fitted", "moves"),
    [
        (QUIET, {FIRST: 0.03, MOVES: 0.02}, [(FIRST, 400), (COMPANION, 400)], False),
        (LOUD, {FIRST: 0.03, MOVES: 0.04}, [(FIRST, 400), (COMPANION, 400), (MOVES, 100)], False),
        (LOUD, {FIRST: 0.03, MOVES: 0.031}, [(FIRST, 400), (COMPANION, 400), (MOVES, 200)], False),
        (LOUD, {FIRST: 0.03, MOVES: 0.0298}, [(FIRST, 400), (COMPANION, 400), (MOVES, 400)], False),
        (LOUD, {FIRST: 0.03, MOVES: 0.02}, [(FIRST, 400), (COMPANION, 400), (MOVES, 400)], True),
    ],
)
def test_things_may_move_if_that_is_clearly_better(monkeypatch, first, left, leaves, fitted, moves):
    raced, made = run(monkeypatch, first, leaves, left=left)
    assert made == fitted
    assert raced.motion.moves is moves
    assert sum(iterations == LONG for _, iterations in made) <= 3


def test_motion_that_is_asked_for_is_taken_whatever_it_leaves(monkeypatch, first):
    settings = Settings(motion="on")
    raced, made = run(monkeypatch, first, {FIRST: 0.03, MOVES: 0.05}, settings=settings)
    assert raced.motion.chosen == MOVES
    assert dict(made)[MOVES] == LONG


def test_errors_over_time_are_not_asked_for_where_they_are_left_out(monkeypatch, first):
    """Neither before moving scenes are fitted nor where theirs are compared."""
    settings, leaves = Settings(left_out=(LeftOut.ERRORS_OVER_TIME,)), {FIRST: 0.03, MOVES: 0.02}
    raced, _ = run(monkeypatch, first, leaves, settings=settings, left=LOUD, followed=None)
    assert raced.motion.chosen == MOVES


@pytest.mark.parametrize("opens", [False, True])
def test_an_open_order_of_the_one_taken_is_reported(monkeypatch, first, opens):
    first = replace(first, geometry=replace(first.geometry, **PATHLESS))
    raced, _ = run(monkeypatch, first, {FIRST: 0.03, SECOND: 0.02, "opens": opens})
    assert raced.order == (OrderFound(0.3) if opens else OrderFound())


@pytest.mark.parametrize(("fits", "made"), [(1, 1), (2, 2), (4, 4)])
def test_there_are_as_many_fits_as_are_asked_for(monkeypatch, first, fits, made):
    raced, _ = run(monkeypatch, first, {FIRST: 0.03}, settings=Settings(fits=fits))
    assert len(raced.fits) == made


def test_views_that_raise_the_residual_of_the_mean_by_chance_count(monkeypatch, first):
    first = replace(first, geometry=replace(first.geometry, **DOUBTFUL))
    raced, _ = run(monkeypatch, first, {FIRST: 0.022, SECOND: 0.02}, scatter=4.0)
    assert [float(fit.views) for fit in raced.fits] == [0.02, 0.022]


def test_views_that_surely_raise_the_residual_of_the_mean_do_not_count(monkeypatch, first):
    first = replace(first, geometry=replace(first.geometry, **DOUBTFUL))
    raced, _ = run(monkeypatch, first, {FIRST: 0.022, SECOND: 0.02})
    assert [float(fit.views) for fit in raced.fits] == [0.02]
    (ranked,) = course_findings(raced.course, {})
    assert ranked.code == Code.ATTEMPTS_RANKED
    assert "second look 0.0200, tracks 0.0220" in ranked.sentence


def test_the_course_tells_when_each_entered_and_what_it_left(monkeypatch, first):
    first = replace(first, geometry=replace(first.geometry, **DOUBTFUL))
    raced, _ = run(monkeypatch, first, {FIRST: 0.02, SECOND: 0.03})
    second = raced.course[1]
    assert (second.hypothesis, second.began, second.iterations) == (SECOND, 200, 100)
    assert second.heldout == ((50, 0.03), (100, 0.03))
    assert second.outcome == RaceOutcome.BEHIND


@pytest.mark.parametrize(
    ("motion", "fitted"), [("off", "first look"), ("auto", "first look"), ("on", "moving from the first")]
)
def test_within_a_budget_the_first_path_is_fitted_alone(monkeypatch, first, motion, fitted):
    settings = Budget.beforehand(Settings(motion=motion))
    leaves = {FIRST: 0.02, SECOND: 0.01, "wide": 0.01, "moving from the first": 0.02}
    doubtful = replace(first, geometry=replace(first.geometry, **DOUBTFUL))
    raced, entered = run(monkeypatch, doubtful, leaves, OPEN, settings=settings, left=LOUD)
    assert entered == [(fitted, LONG), (COMPANION, LONG)]
    assert raced.motion.moves == (motion == "on")
