"""A radiance field fitted to coded measurements of a wall and a panel before it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.coding import Coding
from tests.reconstruct.conftest import make_views
from tests.tables import field_fit
from tests.tables.field_fit import FieldSettings, fit_field

BRIEF = FieldSettings(iterations=60, pixels=64, samples=10)


@pytest.fixture(scope="module")
def coded():
    """A small shot with truth, its first geometry, and the views' average exposure."""
    seen = make_views(views=4, size=(24, 32), focal=30.0, seed=3)
    masks = (np.random.default_rng(1).random((4, 24, 32)) < 0.5).astype(np.float32)
    measurement = np.einsum("nhw,nhwc->hwc", masks, seen.views).astype(np.float32)
    shot = Shot(measurement, masks, intrinsics=seen.intrinsics, truth=Truth(seen.views, seen.poses), name="wall")
    reference = 2
    geometry = Geometry(
        world_to_camera=seen.poses @ np.linalg.inv(seen.poses[reference]),
        intrinsics=seen.intrinsics,
        focal_source="file",
        inverse_depth=seen.inverse_depth,
        reference=reference,
        tracks=10,
        reprojection_rms_px=0.1,
        parallax_px=1.0,
        verdict="full",
        notes=(),
    )
    exposure = np.maximum(masks.sum(axis=0), 1)[..., None]
    return shot.check(), geometry, np.repeat((measurement / exposure)[None], 4, axis=0)


@pytest.fixture(scope="module")
def fitted(coded):
    shot, geometry, _ = coded
    return fit_field(shot, geometry, BRIEF)


def test_a_field_shows_the_views_better_than_their_mean_exposure(coded, fitted):
    shot, _, average = coded
    views, depth = fitted.seen(fitted.world_to_camera)
    gain = np.mean(psnr_per_view(views, shot.truth.views)) - np.mean(psnr_per_view(average, shot.truth.views))
    assert gain > 3.0
    assert views.shape == shot.truth.views.shape
    assert depth.shape == shot.masks.shape
    assert (depth > 0).all()


def test_its_loss_is_the_mean_error_of_what_the_views_predict(coded):
    shot, _, _ = coded
    readings = field_fit._Readings(shot)
    views = torch.rand(4, 24, 32, 3, generator=torch.Generator().manual_seed(0))
    chosen = torch.arange(len(readings.places))
    lit = torch.from_numpy(np.flatnonzero(shot.lit))
    predicted = Coding.of(shot).forward(views).reshape(-1, 3)[lit]
    wanted = (predicted - torch.from_numpy(shot.measurement).reshape(-1, 3)[lit]).abs().mean()
    assert float(readings.loss(chosen, views.reshape(4, -1, 3)[:, lit])) == pytest.approx(float(wanted), rel=1e-5)


@pytest.mark.parametrize("kind", ["mosaic", "grey"])
def test_a_mosaic_and_a_grey_measurement_are_met_in_their_own_channels(coded, kind):
    shot, _, _ = coded
    measurement = shot.measurement[..., :1]
    other = Shot(measurement, shot.masks, cfa="RGGB" if kind == "mosaic" else None).check()
    readings = field_fit._Readings(other)
    seen = torch.zeros(4, len(readings.places), 3)
    seen[..., 1] = 0.9  # green light alone
    coded_pixels = (other.measurement.shape[0] * other.measurement.shape[1],)
    chosen = torch.arange(min(len(readings.places), *coded_pixels))
    exposure = torch.from_numpy(shot.masks.sum(axis=0)).flatten()[torch.from_numpy(np.flatnonzero(shot.lit))]
    target = torch.from_numpy(measurement).flatten()[torch.from_numpy(np.flatnonzero(shot.lit))]
    rows, columns = readings.places[:, 1].long(), readings.places[:, 0].long()
    share = torch.where((rows + columns) % 2 == 1, 0.9, 0.0) if kind == "mosaic" else torch.full_like(exposure, 0.3)
    assert float(readings.loss(chosen, seen)) == pytest.approx(
        float((share * exposure - target).abs().mean()), rel=1e-4
    )


def test_a_clipped_reading_forgives_what_is_brighter(coded):
    shot, _, _ = coded
    clipped = replace(shot, saturated=np.ones(shot.size, bool))
    readings = field_fit._Readings(clipped)
    chosen = torch.arange(len(readings.places))
    assert float(readings.loss(chosen, torch.full((4, len(chosen), 3), 5.0))) == 0
    assert float(readings.loss(chosen, torch.zeros(4, len(chosen), 3))) > 0


def test_the_reference_view_stays_and_poses_rest_at_first(coded):
    shot, geometry, _ = coded
    found = fit_field(shot, geometry, replace(BRIEF, iterations=3, poses_from=1.0))
    np.testing.assert_allclose(found.world_to_camera, geometry.world_to_camera, atol=1e-6)
    moved = fit_field(shot, geometry, replace(BRIEF, iterations=3, poses_from=0.0))
    np.testing.assert_allclose(moved.world_to_camera[2], np.eye(4), atol=1e-6)
    assert np.abs(moved.world_to_camera[0] - geometry.world_to_camera[0]).max() > 1e-4


@pytest.mark.parametrize("wrong", [{"iterations": 0}, {"rate": 0.0}, {"pose_rate": np.inf}, {"poses_from": 1.5}])
def test_settings_that_make_no_sense_are_refused(coded, wrong):
    shot, geometry, _ = coded
    with pytest.raises(InputError, match="FieldSettings"):
        fit_field(shot, geometry, FieldSettings(**wrong))


def test_a_lens_that_distorts_is_refused(coded):
    shot, geometry, _ = coded
    bent = replace(shot, distortion=np.array([0.1, 0, 0, 0, 0]))
    with pytest.raises(InputError, match="distorts"):
        fit_field(bent, geometry)


def test_a_loss_that_is_not_finite_is_said(coded):
    shot, geometry, _ = coded
    with pytest.raises(NumericsError, match="is not finite"):
        fit_field(shot, geometry, replace(BRIEF, rate=1e30))
