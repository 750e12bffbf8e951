"""Standard errors of an exposure, put together, and of a whole small run."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.cameras import camera_centres, pinhole
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.uncertainty import estimate
from gs2ci.reconstruct.uncertainty.estimate import ExposureFound, PathKnown, standard_errors
from gs2ci.reconstruct.uncertainty.views import ViewsMade
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from tests.reconstruct.uncertainty.conftest import FOCAL_PX, SIZE, path


def discs(depths):
    """Opaque discs over the left and the right half of the picture, at two depths."""
    rows, columns = np.mgrid[1 : SIZE[0] : 2, 1 : SIZE[1] : 2]
    depth = np.where(columns < SIZE[1] / 2, *depths).ravel()
    places = np.stack([columns.ravel() - SIZE[1] / 2, rows.ravel() - SIZE[0] / 2], axis=-1) / FOCAL_PX
    means = np.concatenate([places * depth[:, None], depth[:, None]], axis=1)
    rng = np.random.default_rng(0)
    fields = {
        "means": means,
        "log_scales": np.log(np.tile(depth[:, None], 3) * [1.5 / FOCAL_PX, 1.5 / FOCAL_PX, 0.002]),
        "quaternions": np.tile([1.0, 0, 0, 0], (len(depth), 1)),
        "opacity_logits": np.full(len(depth), 4.0),
        "colours": rng.uniform(0.1, 0.9, (len(depth), 3)),
    }
    return Gaussians(**{name: torch.tensor(values, dtype=torch.float32) for name, values in fields.items()})


@pytest.fixture
def exposed(measured):
    holdout, _, _ = measured()
    poses = path(holdout.shot.views)
    renderer = ShotRenderer(holdout.shot, pinhole(FOCAL_PX, SIZE), load_backend("cpu"))
    scene = discs((2.0, 3.0))
    views = renderer.views(scene, torch.from_numpy(poses).float())
    shot = replace(holdout.shot, measurement=holdout.coded(views) + np.float32(0.01))
    seen = ViewsMade(views, views, None)
    return ExposureFound(Holdout(shot, holdout.pixels), renderer, seen, poses, renderer.stopped_light(scene, poses))


def known(**changes):
    return replace(PathKnown(3, 0.0, None), **changes)


def test_a_still_scene_along_a_path_has_all_standard_errors(exposed):
    found = standard_errors(exposed, known()).check((6, *SIZE))
    for part in (found.views, found.depth, found.positions, found.rotations):
        assert part is not None
        assert part.any()


def test_without_a_path_only_views_have_them(exposed):
    found = standard_errors(exposed, None)
    assert found.views.any()
    assert (found.depth, found.positions, found.rotations) == (None, None, None)
    assert np.array_equal(found.views, standard_errors(exposed, known()).views)


def test_given_poses_are_surer(exposed):
    found = [standard_errors(exposed, known(given=given)) for given in (None, (1e-5, 1e-6))]
    for name in ("depth", "positions", "rotations"):
        assert getattr(found[1], name).mean() < getattr(found[0], name).mean()


def test_an_exposure_beside_others_may_turn_the_more_the_farther_it_is_from_their_middle(exposed):
    own, step = camera_centres(exposed.world_to_camera), np.array([0.4, 0, 0])
    alone = standard_errors(exposed, known())
    inmost, aside = (
        standard_errors(exposed, known(places=np.concatenate(rows)))
        for rows in ((own - step, own, own + step), (own, own + step, own + 2 * step))
    )
    assert np.allclose(inmost.rotations, alone.rotations)
    assert (aside.rotations > 2 * alone.rotations).all()
    # The row bends as one.
    assert np.allclose(aside.positions, inmost.positions)
    assert (aside.positions > alone.positions).all()
    assert np.array_equal(aside.depth, alone.depth)
    given = [standard_errors(exposed, known(given=(1e-5, 1e-6), places=places)).positions for places in (None, own)]
    assert np.array_equal(*given)


def test_tracks_tell_how_sure_depths_are(exposed):
    there = np.zeros((4, 6, 2)) + np.linspace(-0.1, 0.1, 4)[:, None, None]
    found = standard_errors(exposed, known(followed=there))
    assert not np.array_equal(found.depth, standard_errors(exposed, known()).depth)


def test_a_turn_that_fits_show_makes_the_path_unsure_wherever_others_are(exposed, monkeypatch):
    monkeypatch.setattr(estimate, "unseen_turn", lambda *_: 1e-3)  # so few pixels see none at all
    found, sure = (standard_errors(exposed, known(turn=turn)) for turn in (0.2, 0.0))
    assert (found.rotations > sure.rotations).any()
    assert (found.positions > sure.positions).all()
    assert (found.depth >= sure.depth).all()
    assert (found.depth > sure.depth).any()
    sures = (known(turn=turn, places=np.array([[40.0, 0, 0]])) for turn in (0.0, 1e-4))
    beside = [standard_errors(exposed, sure).rotations for sure in sures]
    assert np.array_equal(*beside)
