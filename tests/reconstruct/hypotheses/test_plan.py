"""What is foreseen of a race before anything is fitted."""

import pytest

from gs2ci.reconstruct.fit.coarse.pace import Timed
from gs2ci.reconstruct.hypotheses.plan import PlannedStep, RacePlan, fit_seconds
from gs2ci.reconstruct.pipeline import plan
from gs2ci.reconstruct.presets.named import rescheduled
from gs2ci.reconstruct.settings import Settings
from tests.tables.cases import Case

SURE, DOUBTFUL = "other density rule (1 more)", "the path found in its views, or other density rule"


def test_only_what_is_certain_counts_in_the_time_of_a_run():
    steps = (PlannedStep("a fit", 4.0, "always"), PlannedStep("another", 2.0, "perhaps", certain=False))
    foreseen = RacePlan(steps, spent_s=1.0)
    assert (foreseen.seconds, foreseen.most_s) == (5.0, 7.0)
    registration, one, other, whole = str(foreseen).splitlines()
    assert "1.0 s" in registration
    assert one.startswith("a fit")
    assert other.startswith("if: another")
    assert whole.startswith("in all")
    assert "5.0 s; at most 7.0 s" in whole


@pytest.mark.parametrize(("path_error", "second"), [(1.0, SURE), (0.0, DOUBTFUL)])
def test_a_still_scene_has_two_fits_and_the_second_is_what_is_in_doubt(path_error, second):
    shot = Case("boxes", scene="boxes", size=(48, 64), views=4).shot(0)
    settings = Settings()
    criteria = settings.geometry.criteria
    strict = Settings(
        fit=rescheduled(settings.fit, 40),
        geometry=type(settings.geometry)(criteria=type(criteria)(path_error=path_error)),
        poses="tracks",
    )
    found = plan(shot, strict)
    certain = [step.what for step in found.steps if step.certain]
    assert certain[0] == "fit along the path of tracks"
    assert certain[1] == second
    assert 0 < found.spent_s < found.seconds < found.most_s


def test_fits_side_by_side_take_longer_than_one_and_moments_cost(monkeypatch):
    class Fits:
        settings = Settings()

    monkeypatch.setattr("numba.get_num_threads", lambda: 2)
    monkeypatch.setattr(Timed, "iteration_s", 0.1)
    one, two = (fit_seconds(Fits, Timed(2), beside) for beside in (1, 2))
    assert one < two < 2 * one
    # The population grows, up to twice as many at the end.
    assert one == pytest.approx(0.1 * Settings().fit.iterations * 1.5)
