"""The grades of hard cases: relative to the easy case of their own scene, by views and by depth."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from tests.stability import __main__ as suite
from tests.stability import judge
from tests.stability.benches import Scale, build, turning
from tests.stability.cases import CASES, EASY
from tests.stability.judge import (
    DepthScore,
    Easy,
    Outcome,
    appraise,
    depth_score,
    easy_at,
    easy_run,
    grade_of_depth,
    is_a_warning,
)

SMALL = Scale((40, 48), 40)
GOOD = DepthScore(0.05, 0.9)


@pytest.mark.parametrize(
    ("depth", "easy", "order", "grade"),
    [
        (DepthScore(0.06, 0.88), GOOD, "", "holds"),
        (DepthScore(0.19, 0.71), GOOD, "", "holds"),
        (DepthScore(0.21, 0.9), GOOD, "", "bends"),
        (DepthScore(0.05, 0.69), GOOD, "", "bends"),
        (DepthScore(0.05, -0.1), GOOD, "", "breaks"),
        (None, GOOD, "", "breaks"),
        (GOOD, GOOD, "the path runs backwards", "breaks"),
        (GOOD, DepthScore(0.3, 0.2), "", "unknown"),
        (GOOD, None, "", "unknown"),
    ],
)
def test_depth_is_graded_against_the_easy_case(depth, easy, order, grade):
    assert grade_of_depth(depth, easy, order) == grade


@pytest.fixture(scope="module")
def moving():
    """A case on a scene of its own, run: the same exposure and settings as the easy case of that scene, and its run."""
    case = replace(next(case for case in CASES if case.family == "moving object"), bench=replace(EASY.bench))
    case = replace(case, bench=replace(case.bench, scene="moving"))
    return case, *easy_run("moving", SMALL)


def test_a_case_is_graded_against_the_easy_case_of_its_own_scene(moving):
    case, shot, result = moving
    outcome = appraise(case, shot, result, SMALL)
    # Nothing is lost against the easy case of that scene, whatever another scene reaches.
    assert outcome.loss_db == pytest.approx(0.0, abs=1e-6)
    assert outcome.depth == easy_at("moving", SMALL).depth


def test_views_are_compared_with_what_the_lens_lets_through(moving):
    case, shot, result = moving
    sharp = appraise(case, shot, result, SMALL)
    seen = appraise(replace(case, through_lens=lambda _: result.views), shot, result, SMALL)
    assert seen.psnr_db > sharp.psnr_db + 20
    assert seen.loss_db == pytest.approx(easy_at("moving", SMALL).psnr_db - seen.psnr_db, abs=1e-6)


def test_a_depth_is_scored_after_the_median_scale_and_by_its_order(moving):
    case, shot, result = moving
    true = build("moving", shot.size).depth
    stack = np.repeat(true[None].astype(np.float32), shot.views, axis=0)
    perfect = depth_score(case, shot, replace(result, depth=3 * stack))
    assert perfect.median_rel == pytest.approx(0.0, abs=1e-6)
    assert perfect.rank == pytest.approx(1.0)
    backwards = depth_score(case, shot, replace(result, depth=np.where(stack > 0, 1 / np.maximum(stack, 1e-6), 0)))
    assert backwards.rank == pytest.approx(-1.0)
    assert depth_score(case, shot, replace(result, depth=None)) is None


OPEN = finding(Code.DEPTH_ORDER_OPEN, errors=0.5)


@pytest.fixture
def graded(moving, monkeypatch):
    """Grade the run with another depth, path or truth, beside an easy case that knows the order of depth."""
    case, shot, result = moving
    true = build("moving", shot.size).depth
    monkeypatch.setattr(judge, "easy_at", lambda *_: Easy(20.0, (), "", GOOD))

    def grade(
        depth=true, notes=(), path=shot.truth.world_to_camera, views=shot.truth.views, true_path=None, method="tracks"
    ):
        truth = replace(shot.truth, views=views)
        if true_path is not None:
            truth = replace(truth, world_to_camera=true_path)
        stack = np.repeat(depth[None].astype(np.float32), shot.views, axis=0)
        geometry = replace(result.geometry, method=method)
        changed = replace(result, depth=stack, notes=notes, world_to_camera=path, geometry=geometry)
        return appraise(case, replace(shot, truth=truth), changed, SMALL)

    grade.true, grade.path = true, shot.truth.world_to_camera
    return grade


def backwards(path):
    """A path that goes the other way, its cameras looking where they looked."""
    turned = path.copy()
    turned[:, :3, 3] *= -1
    return turned


def speckle(true, share):
    """Depths without order, and a share of the true ones turned over."""
    rng = np.random.default_rng(0)
    return np.where(rng.random(true.shape) < share, 10 - true, 3 + rng.random(true.shape))


def test_the_right_way_round_passes(graded):
    outcome = graded()
    assert (outcome.order, outcome.order_open, outcome.depth_grade) == ("", "", "holds")
    assert not any("order" in problem for problem in outcome.problems)


def test_depth_clearly_the_wrong_way_round_breaks_said_or_not(graded):
    silent, said = (graded(10 - graded.true, notes) for notes in ((), (OPEN,)))
    for outcome in (silent, said):
        assert outcome.grade == outcome.depth_grade == "breaks"
        assert "near and far are exchanged" in outcome.order
    assert "without a warning" in silent.problems[0]
    assert not said.problems


def test_a_path_backwards_breaks_whatever_depth_is(graded):
    outcome = graded(path=backwards(graded.path))
    assert outcome.grade == "breaks"
    assert "backwards" in outcome.order
    assert "without a warning" in outcome.problems[0]


def test_a_small_share_of_the_wrong_order_is_wrong_if_its_patches_are_many(graded):
    """Specks are many patches: their standard error is small, and a rank between it and -0.3 is none."""
    outcome = graded(speckle(graded.true, 0.5))
    assert -0.3 < outcome.depth.rank < -2 * outcome.depth.rank_error
    assert "exchanged" in outcome.order


def test_an_order_of_chance_is_lost_depth_and_not_inside_out(graded):
    silent, said = (graded(speckle(graded.true, 0.0), notes) for notes in ((), (OPEN,)))
    for outcome in (silent, said):
        assert outcome.order == ""
        assert outcome.grade != "breaks"
        assert outcome.depth_grade in ("bends", "breaks")
    assert "is chance" in silent.problems[0]
    assert not said.problems


def test_where_the_camera_only_turned_order_has_to_be_said_open_and_is_not_graded(graded, moving):
    _, shot, _ = moving
    times = np.linspace(0, 0.16, shot.views)
    path = turning(3)(build("moving", shot.size), 0.16).world_to_camera(times)
    silent, said = (graded(10 - graded.true, notes, true_path=path) for notes in ((), (OPEN,)))
    for outcome in (silent, said):
        assert outcome.order == ""
        assert "a turn explains" in outcome.order_open
        assert outcome.grade != "breaks"
        assert outcome.depth_grade == "unknown"
    assert "without a warning" in silent.problems[0]
    assert not said.problems


def test_a_stage_may_be_taken_at_its_word_where_nothing_shows_an_order(graded):
    even = np.full((8, *graded.true.shape, 3), 0.5, np.float32)
    guessed, told = (graded(graded.true, views=even, method=method) for method in ("tracks", "stage"))
    assert any("without a warning" in problem for problem in guessed.problems)
    assert not any("order" in problem for problem in told.problems)


def test_a_flat_depth_claims_no_order_where_none_can_be_known(graded):
    outcome = graded(np.full_like(graded.true, 3.0), views=np.full((8, *graded.true.shape, 3), 0.5, np.float32))
    assert outcome.order_open == "the scene shows nothing to follow"
    assert not any("order" in problem for problem in outcome.problems)


def test_suite_goes_on_from_its_record(tmp_path, monkeypatch):
    record = tmp_path / "cases.jsonl"
    outcome = Outcome("bends", 20.5, loss_db=4.0, said=("a word",), depth_grade="holds", depth=GOOD)
    asked = []

    def one_after_another(work, numbers, jobs):
        asked.append(list(numbers))
        yield from ((number, replace(outcome, psnr_db=float(number)), 0.1) for number in numbers)

    monkeypatch.setattr(suite, "as_they_end", one_after_another)
    first = suite.judge_all([3, 5], 1, record)
    with record.open("ab") as file:
        file.write(b'{"title": "cut')
    again = suite.judge_all([5, 7, 3], 1, record)
    assert asked == [[3, 5], [7]]
    assert set(suite.kept_in(record)) == {3, 5, 7}
    assert list(again) == [5, 7, 3]
    assert {number: again[number] for number in (3, 5)} == first


@pytest.mark.parametrize(
    ("note", "warns"),
    [
        (finding(Code.MASKS_BLUR, motion_px=4.0, most=2), True),
        (finding(Code.SCENE_MOVES, share=0.1, median_px=1.0, most_px=2.0), True),
        (finding(Code.MOTION_AROUND, share=0.1, median_px=1.0, turn_deg=20.0), True),
        (finding(Code.MASKS_HAVE_MOMENTS, motion_px=1.0, most=2), False),
    ],
)
def test_a_remark_is_no_warning_of_a_loss_but_for_that_of_things_that_move(note, warns):
    assert is_a_warning(note) == warns
