"""What is fitted to tell near from far, and what is made of it; the fits are replaced."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import NumericsError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.attempts.order_fits import OrderFits, mean_square
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.gaussians import Gaussians

SIZE, VIEWS = (6, 8), 2
SETTINGS = Settings(fit=CoarseSettings(iterations=400))


@pytest.fixture
def holdout():
    shot = Shot(
        measurement=np.zeros((*SIZE, 1), np.float32),
        masks=np.ones((VIEWS, *SIZE), np.float32),
        weights=np.ones(VIEWS, np.float32),
        intrinsics=np.diag([10.0, 10, 1]),
    ).check()
    heldout = np.zeros(SIZE, bool)
    heldout[0] = True
    return Holdout(shot, heldout)


@pytest.fixture
def geometry():
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[1, 0, 3] = 0.1
    depth = np.ones(SIZE, np.float32)
    return Geometry(poses, np.diag([10.0, 10, 1]), "file", depth, 0, 100, 0.3, 2.0, "full", ())


@pytest.fixture
def start():
    means = torch.tensor([[0.0, 0.0, 0.8], [0.1, 0.0, 1.0], [0.0, 0.1, 1.25]])
    return Gaussians(means, torch.full((3, 3), -4.0), torch.eye(4)[:3], torch.zeros(3), torch.full((3, 3), 0.5))


class Fits:
    """Stands for fits: each leaves its residuals, on the pixels that it sees and on those held out, in turn."""

    def __init__(self, *left, fails_at=None):
        self.left, self.fails_at, self.made = left, fails_at, []

    def __call__(self, geometry, settings):
        def fit(member, _progress, _pace):
            number = len(self.made)
            self.made.append((geometry, settings, member))
            if number == self.fails_at:
                raise NumericsError("nothing is finite", allowed="numbers")
            seen, unseen = self.left[number]
            views = np.full((VIEWS, *SIZE, 1), seen / VIEWS, np.float32)
            views[:, 0] = unseen / VIEWS
            return SimpleNamespace(scene=member.start, world_to_camera=geometry.world_to_camera, views=views)

        return fit


def order_fits(holdout, start, fits):
    return OrderFits(holdout, SETTINGS, lambda geometry: (geometry, start), fits)


def test_a_brief_fit_says_what_it_leaves_and_begins_elsewhere_with_another_number(holdout, geometry, start):
    fits = Fits((0.5, 0.5), (0.5, 0.5))
    both = order_fits(holdout, start, fits)
    assert both.brief(geometry, 0) == pytest.approx(0.25)
    both.brief(geometry, 1)
    (_, settings, first), (_, _, second) = fits.made
    assert (settings.iterations, settings.surfaces, settings.relief) == (60, None, None)
    # A reversed path has no standard errors: held poses of the other order would be at a disadvantage.
    assert settings.poses.given_weight == 0
    assert first.start is start
    assert not first.start.means.equal(second.start.means)


def test_a_geometry_begins_once_however_often_it_is_fitted(holdout, geometry, start):
    begun = []
    fits = OrderFits(holdout, SETTINGS, lambda one: begun.append(one) or (one, start), Fits(*[(1, 1)] * 2))
    fits.brief(geometry, 0)
    fits.brief(geometry, 0)
    assert len(begun) == 1


def test_a_brief_fit_that_runs_away_leaves_everything(holdout, geometry, start):
    assert order_fits(holdout, start, Fits(fails_at=0)).brief(geometry, 0) == math.inf


def test_a_reading_that_cannot_be_trusted_is_not_asked(holdout):
    saturated = np.zeros(SIZE, bool)
    saturated[:, 4:] = True
    shot = holdout.shot
    shot = Shot(shot.measurement, shot.masks, shot.weights, saturated=saturated, intrinsics=shot.intrinsics).check()
    views = np.full((VIEWS, *SIZE, 1), 0.5, np.float32)
    views[:, :, 4:] = 9.0
    assert mean_square(Holdout(shot, holdout.pixels), views) == pytest.approx(1.0)
