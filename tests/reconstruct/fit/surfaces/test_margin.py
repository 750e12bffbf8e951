"""Scenes continued beyond the borders of all views, and fits that go on with them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code
from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.coarse.state import FitState
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.surfaces.margin import MarginSettings, MarginSource, margin
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, SurfaceSettings
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.reconstruct.paper.density.mcmc import Mcmc
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import joined
from tests.reconstruct.fit.plane_fits import QUICK, UNJUDGED, FaultyBackend, run

SIZE = (40, 56)
FOCAL_PX = 60.0
INTRINSICS = np.array([[FOCAL_PX, 0, 28], [0, FOCAL_PX, 20], [0, 0, 1]])
VIEWS = 5
DEPTH = 2.0
STEP_PX = 3.0  # what a step of the path shifts the plane in the picture
LEFT, RIGHT = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)


def path(views=VIEWS, step_px=STEP_PX):
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = -(np.arange(views) - (views - 1) / 2) * step_px * DEPTH / FOCAL_PX
    return poses


def shot_of(size=SIZE, **parts):
    masks = np.ones((VIEWS, *size), np.float32)
    shot = Shot(np.ones((*size, 3), np.float32), masks, np.ones(VIEWS, np.float32), intrinsics=INTRINSICS, **parts)
    return shot.check()


@pytest.fixture(scope="module")
def renderer():
    return ShotRenderer(shot_of(), INTRINSICS, load_backend())


def halves(size=SIZE):
    """Views whose left half is red and whose right half is blue, all alike, of a plane at one depth."""
    views = np.empty((VIEWS, *size, 3), np.float32)
    views[:, :, : size[1] // 2] = LEFT
    views[:, :, size[1] // 2 :] = RIGHT
    return MarginSource((0, 2, 4), dict(enumerate(views)), np.full((3, *size), 1 / DEPTH, np.float32))


def at(points, pose):
    """Project points to pixels of a pinhole."""
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    return (in_camera[:, :2] / in_camera[:, 2:]) * FOCAL_PX + (28, 20), in_camera[:, 2]


def inside(places, by=0.0):
    return ((places >= -by) & (places < np.array(SIZE[::-1]) + by)).all(axis=1)


def test_they_lie_a_stride_to_a_step_outside_every_view_and_just_behind_the_surface(renderer, scattered):
    poses = path()
    found = margin(renderer, scattered(3), poses, halves(), MarginSettings(most=0.5))
    points = found.means.double().numpy()
    pixels = [at(points, pose)[0] for pose in poses]
    stride = MarginSettings().stride
    assert not np.any([inside(places, by=stride - 1) for places in pixels])
    assert np.any([inside(places, by=stride + STEP_PX + 1.01) for places in pixels], axis=0).all()
    np.testing.assert_allclose(points[:, 2], 1.02 * DEPTH, rtol=1e-6)
    # All around: beyond the first view's border to one side, beyond the last one's to the other, above and below.
    assert pixels[0][:, 0].min() < 0 or pixels[-1][:, 0].min() < 0
    assert pixels[0][:, 0].max() > SIZE[1] or pixels[-1][:, 0].max() > SIZE[1]
    assert pixels[2][:, 1].min() < 0
    assert pixels[2][:, 1].max() > SIZE[0]


def test_a_view_from_one_step_beyond_the_path_shows_little_of_the_seam(renderer, scattered):
    poses = path()
    found = margin(renderer, scattered(3), poses, halves(), MarginSettings(most=0.5))
    beyond = poses[-1] @ np.linalg.inv(poses[-2]) @ poses[-1]
    images, alphas = load_backend().views(
        found, torch.from_numpy(beyond[None]).float(), torch.from_numpy(INTRINSICS).float(), SIZE
    )
    strip = slice(SIZE[1] - int(STEP_PX), SIZE[1])
    # A stride next to the border is left to what the scene itself shows there.
    assert alphas[0, :, strip].min() > 0.6
    assert alphas[0, :, strip].mean() > 0.85
    shown = (images / alphas[..., None].clamp(min=1e-6))[0, :, strip].numpy()
    np.testing.assert_allclose(shown, np.broadcast_to(RIGHT, shown.shape), atol=1e-4)


def test_colours_are_those_of_the_nearest_border(renderer, scattered):
    found = margin(renderer, scattered(3), path(), halves(), MarginSettings(most=0.5))
    leftmost = found.means[:, 0] < found.means[:, 0].min() + 0.05
    rightmost = found.means[:, 0] > found.means[:, 0].max() - 0.05
    assert (found.colours[leftmost] == torch.tensor(LEFT)).all()
    assert (found.colours[rightmost] == torch.tensor(RIGHT)).all()


def test_grey_views_give_grey_gaussians_and_fields_of_the_scene_are_empty_in_them(renderer, scattered):
    seen = halves()
    seen = replace(seen, views={number: view[..., :1] for number, view in seen.views.items()})
    scene = replace(scattered(3), motion=torch.ones(3, 2, 3), harmonics=torch.ones(3, 3, 3))
    found = margin(renderer, scene, path(), seen, MarginSettings())
    assert (found.colours[:, 0] == found.colours[:, 2]).all()
    assert not found.motion.any()
    assert not found.harmonics.any()
    assert len(joined([scene, found]).check()) == 3 + len(found)


def test_width_is_a_step_of_the_path_within_its_bound(renderer, scattered):
    def reach(step_px, most):
        found = margin(renderer, scattered(3), path(step_px=step_px), halves(), MarginSettings(stride=1, most=most))
        above = at(found.means.double().numpy(), np.eye(4))[0][:, 1]
        return -above.min()

    assert reach(1.0, 0.5) < reach(4.0, 0.5) <= 6.0
    assert 2.0 < reach(40.0, 1 / 28) <= 3.0
    assert reach(0.0, 0.5) > 1.4  # a camera at rest: one pixel


def test_borders_without_a_surface_are_not_continued(renderer, scattered):
    seen = halves()
    nothing = replace(seen, inverse_depth=np.zeros_like(seen.inverse_depth))
    assert margin(renderer, scattered(3), path(), nothing, MarginSettings()) is None
    one_side = nothing.inverse_depth.copy()
    one_side[:, :, -1] = 1 / DEPTH
    found = margin(renderer, scattered(3), path(), replace(seen, inverse_depth=one_side), MarginSettings(most=0.5))
    assert (found.colours == torch.tensor(RIGHT)).all()


def test_cameras_that_look_back_see_nothing_of_what_lies_behind_them(renderer, scattered):
    poses = path()
    poses[2:, :3, :3] = np.diag([-1.0, 1.0, -1.0])
    found = margin(renderer, scattered(3), poses, halves(), MarginSettings(most=0.5))
    assert (found.means[:, 2] > 0).any()
    assert (found.means[:, 2] < 0).any()
    assert torch.isfinite(found.means).all()


def test_behind_a_lens_they_lie_outside_what_the_sensor_sees(scattered):
    shot = shot_of(distortion=np.array([-0.3, 0.02, 0, 0, 0]))
    lens = Lens.of(shot)
    bent = ShotRenderer(shot, INTRINSICS, load_backend(), lens)
    found = margin(bent, scattered(3), path(), halves(), MarginSettings(most=0.5))
    for pose in path():
        in_camera = found.means.double().numpy() @ pose[:3, :3].T + pose[:3, 3]
        canvas = lens.canvas_intrinsics
        column, row = np.floor(in_camera[:, :2] / in_camera[:, 2:] * canvas.diagonal()[:2] + canvas[:2, 2]).T
        height, width = lens.seen.shape
        there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        assert not lens.seen[row[there].astype(int), column[there].astype(int)].any()


def fitted(moving_plane, margin_settings, **parts):
    surfaces = SurfaceSettings((Search(0.5, 1e-2, 2e-4),), margin=margin_settings)
    return run(moving_plane, replace(QUICK, surfaces=surfaces, **parts))


@pytest.mark.slow
def test_a_fit_goes_on_with_them_and_leaves_them_as_they_are(moving_plane):
    fit, holdout = fitted(moving_plane, MarginSettings(), densify_until=0.9)
    plain, _ = fitted(moving_plane, None, densify_until=0.9)
    assert plain.outside is None
    assert 0 < int(fit.outside.sum()) < len(fit.scene) / 2
    outside = fit.scene.map(lambda tensor: tensor[fit.outside])
    # Adam would have changed each by up to its whole step in every iteration.
    torch.testing.assert_close(torch.sigmoid(outside.opacity_logits), torch.full((len(outside),), 0.95))
    assert holdout.residual_rms(fit.views) < 1.1 * holdout.residual_rms(plain.views)
    assert [point.loss for point in fit.curve[:3]] == [point.loss for point in plain.curve[:3]]


@pytest.mark.slow
@pytest.mark.parametrize("rule", [Mcmc(), Osgr.generous()], ids=lambda rule: rule.name)
def test_density_rules_pass_over_them(moving_plane, monkeypatch, rule):
    whole, added = FitState._continue_outwards, []

    def watched(state, found):
        added.append(found)
        whole(state, found)

    monkeypatch.setattr(FitState, "_continue_outwards", watched)
    rates = {"density": rule, "densify_every": 4, "densify_until": 0.95, "gaussians_per_pixel": 0.5}
    fit, _ = fitted(moving_plane, MarginSettings(), hold_out=UNJUDGED, **rates)
    (found,) = added
    assert int(fit.outside.sum()) == len(found)
    # Places and sizes may change, together with those of the whole scene.
    for name in ("opacity_logits", "colours"):
        before, after = found.parameters()[name], fit.scene.parameters()[name][fit.outside]
        assert torch.equal(after.flatten().sort().values, before.flatten().sort().values), name


@pytest.mark.slow
@pytest.mark.parametrize("later", [1, 2, 5])
def test_a_fit_that_is_set_back_behind_the_last_search_searches_again_and_gets_them_again(
    moving_plane, monkeypatch, later
):
    """It runs away so many renderings after they were added, before any look has made a later state the best."""
    whole, due = FitState._continue_outwards, []

    def watched(state, found):
        whole(state, found)
        due.append(later)

    def faulty(call):
        if len(due) != 1:
            return False
        due[0] -= 1
        return due[0] == 0

    monkeypatch.setattr(FitState, "_continue_outwards", watched)
    surfaces = SurfaceSettings((Search(0.25, 1e-2, 2e-4), Search(0.5, 1e-2, 2e-4)))
    fit, _ = run(moving_plane, replace(QUICK, surfaces=surfaces), backend=FaultyBackend(faulty))
    (note,) = fit.notes
    assert note.code is Code.ROLLED_BACK_NOT_FINITE
    assert note.figures["best"] <= 30 <= note.figures["iteration"] < 40
    assert len(due) == 2
    assert fit.outside.any()
    assert fit.curve[-1].iteration == 60


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"stride": 0}, "stride = 0 in MarginSettings"),
        ({"most": 0.0}, "most = 0.0 in MarginSettings"),
        ({"most": float("nan")}, "most = nan in MarginSettings"),
    ],
)
def test_settings_without_meaning_are_refused(wrong, said):
    with pytest.raises(InputError, match=said):
        MarginSettings(**wrong).check()
