"""The schedule for several exposures."""

from dataclasses import replace

import pytest

from gs2ci.reconstruct.exposures.joint import shared_schedule
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings


def test_the_schedule_of_one_exposure_is_unchanged():
    assert shared_schedule(CoarseSettings(), 1, 1.0) == CoarseSettings()


@pytest.mark.parametrize("count", [2, 3, 8, 32])
def test_looks_and_turns_of_the_density_rule_are_whole_rounds_apart_and_as_many(count):
    one, many = CoarseSettings(), shared_schedule(CoarseSettings(), count, 2.0).check()
    between = (many.iterations, many.densify_every, many.hold_out.look_every, many.hold_out.patience)
    assert all(number % count == 0 for number in between)
    assert many.iterations == pytest.approx(one.iterations * count**0.5, abs=count)
    assert many.iterations / many.hold_out.look_every == pytest.approx(
        one.iterations / one.hold_out.look_every, rel=0.2
    )
    assert many.gaussians_per_pixel == 2 * one.gaussians_per_pixel


def test_a_population_without_bound_stays_without():
    unbounded = replace(CoarseSettings(), gaussians_per_pixel=None, most_gaussians=100)
    assert shared_schedule(unbounded, 4, 2.0).gaussians_per_pixel is None
