"""The laws that every density rule keeps; for testing a rule of your own.

Here: `check_density_rule`, on a line of Gaussians. Not here: whether a rule is any good (docs/density.md).
"""

import torch

from gs2ci.reconstruct.fit.density.base import DensityRule, GaussianStatistics
from gs2ci.render.gaussians import Gaussians

_COUNT = 60
_CAP = 80


def check_density_rule(rule: DensityRule) -> None:
    """Check the laws that the fit requires of a density rule.

    It does not change the scene that it is given; the same random draws give the same result; all its numbers are
    finite; the population stays within the cap; no two Gaussians continue the same old one; a shake has the shape of
    the means.

    Args:
        rule: The rule.

    Raises:
        AssertionError: It breaks one of the laws.
    """
    assert rule.name, "it has a name"
    for iteration in (0, 100, 500, 3000):
        scene = _line()
        before = {name: tensor.clone() for name, tensor in scene.parameters().items()}
        first, second = (rule.change(scene, _evidence(iteration), torch.Generator().manual_seed(3)) for _ in range(2))
        for name, tensor in scene.parameters().items():
            assert torch.equal(tensor, before[name]), "the scene it is given is left alone"
        for name, tensor in first.scene.parameters().items():
            assert torch.equal(tensor, second.scene.parameters()[name]), "the same draws give the same"
            assert torch.isfinite(tensor).all(), f"{name} is finite"
            assert len(tensor) == len(first.source), f"{name} has a row for each Gaussian"
        assert len(first.source) <= _CAP, "the population stays within the cap"
        continued = first.source[first.source >= 0]
        assert len(torch.unique(continued)) == len(continued), "an old Gaussian is continued once"
        assert int(first.source.max()) < _COUNT, "continued are Gaussians that there were"
        assert int(first.source.min()) >= -1, "newcomers have -1"
        moved = rule.shake(scene, 1e-3, torch.Generator().manual_seed(4))
        assert moved is None or (moved.shape == scene.means.shape and torch.isfinite(moved).all()), "a shake is [G, 3]"


def _line() -> Gaussians:
    draws = torch.Generator().manual_seed(1)
    means = torch.rand(_COUNT, 3, generator=draws) + torch.tensor([0.0, 0.0, 1.0])
    quaternions = torch.zeros(_COUNT, 4)
    quaternions[:, 0] = 1.0
    return Gaussians(
        means=means,
        log_scales=torch.rand(_COUNT, 3, generator=draws) * 3 - 5,
        quaternions=quaternions,
        opacity_logits=torch.rand(_COUNT, generator=draws) * 8 - 4,
        colours=torch.rand(_COUNT, 3, generator=draws),
    )


def _evidence(iteration: int) -> GaussianStatistics:
    draws = torch.Generator().manual_seed(2)
    return GaussianStatistics(
        screen_gradient=torch.rand(_COUNT, generator=draws) * 1e-2,
        screen_radius=torch.rand(_COUNT, generator=draws) * 0.1,
        blended_error=lambda: torch.rand(_COUNT, generator=torch.Generator().manual_seed(5)),
        extent=1.0,
        cap=_CAP,
        iteration=iteration,
    )
