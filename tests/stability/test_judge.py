"""How hard cases are graded: against the easy case of their own scene, and by depth beside the views."""

from dataclasses import replace

import numpy as np
import pytest

from tests.stability import __main__ as suite
from tests.stability.benches import Scale, build
from tests.stability.cases import CASES, EASY
from tests.stability.judge import DepthScore, Outcome, appraise, depth_score, easy_at, grade_of_depth, run

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
    """A case on a scene of its own, run."""
    case = replace(next(case for case in CASES if case.family == "moving object"), bench=replace(EASY.bench))
    case = replace(case, bench=replace(case.bench, scene="moving"))
    return case, *run(case, SMALL)


def test_a_case_is_graded_against_the_easy_case_of_its_own_scene(moving):
    case, shot, result = moving
    outcome = appraise(case, shot, result, SMALL)
    # The same exposure as the easy case of that scene: nothing is lost against it, whatever another scene reaches.
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


def test_suite_goes_on_from_its_record(tmp_path, monkeypatch):
    record = tmp_path / "cases.jsonl"
    outcome = Outcome("bends", 20.5, loss_db=4.0, said=("a word",), depth_grade="holds", depth=GOOD)
    asked = []

    def one_after_another(work, numbers, jobs):
        asked.append(list(numbers))
        yield from ((number, replace(outcome, psnr_db=float(number)), 0.1) for number in numbers)

    monkeypatch.setattr(suite, "side_by_side", one_after_another)
    first = suite.judge_all([3, 5], 1, record)
    with record.open("ab") as file:
        file.write(b'{"title": "cut')
    again = suite.judge_all([5, 7, 3], 1, record)
    assert asked == [[3, 5], [7]]
    assert set(suite.kept_in(record)) == {3, 5, 7}
    assert list(again) == [5, 7, 3]
    assert {number: again[number] for number in (3, 5)} == first
