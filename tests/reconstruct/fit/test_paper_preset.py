"""The numbers of the paper's section IV-A, as the fit will use them."""

import pytest
import torch

from gs2ci.reconstruct.fit.coarse import CoarseSettings
from gs2ci.reconstruct.fit.density.base import GaussianStatistics
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.optimiser import GaussianOptimiser
from gs2ci.reconstruct.presets import paper_settings


@pytest.fixture
def fit():
    return paper_settings().check().fit


def turns(fit):
    shares = ((i, i / fit.iterations) for i in range(fit.iterations))
    return [i for i, s in shares if fit.densify_from <= s < fit.densify_until and i % fit.densify_every == 0]


def test_densification_runs_every_100_iterations_between_500_and_15000(fit):
    assert fit.iterations == 20_000
    assert turns(fit) == list(range(500, 15_000, 100))


def test_the_population_is_bounded_from_iteration_7000_on(fit):
    bounded = [i for i in range(fit.iterations) if i / fit.iterations >= fit.cap_from]
    assert bounded[0] == 7000


def test_opacities_are_reset_every_3000_iterations(fit, scattered):
    rule, reset, still = fit.density, [], torch.zeros(4)
    for i in turns(fit):
        seen = GaussianStatistics(still, still, lambda: still, extent=1.0, cap=9, iteration=i)
        result = rule.change(scattered(4), seen, torch.Generator())
        if "opacity_logits" in result.forget:
            reset.append(i)
    assert reset == [3000, 6000, 9000, 12_000]


def test_rates_decay_from_and_to_those_given(fit, scattered):
    optimiser = GaussianOptimiser(scattered(3), fit.steps, extent=1.0)
    assert optimiser.means_rate(0.0) == pytest.approx(1.6e-4)
    assert optimiser.means_rate(1.0) == pytest.approx(1.6e-6)
    assert (fit.poses.rate, fit.poses.final_rate, fit.poses.every) == (1e-2, 2e-5, 25)


def test_the_objective_and_the_rule_are_those_of_the_paper(fit):
    assert (fit.loss.similarity, fit.loss.opacity, fit.loss.size) == (0.1, 0.01, 0.0)
    assert fit.density == Osgr()
    assert (fit.density.neighbours, fit.density.extra_splits) == (3, 0.05)


def test_no_pixel_is_held_out_and_nothing_ends_it_early(fit):
    assert fit.hold_out.share == 0
    assert min(fit.hold_out.patience, fit.hold_out.growth_patience) >= fit.iterations


def test_it_is_not_the_default(fit):
    assert fit != CoarseSettings()
