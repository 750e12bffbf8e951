from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.geometry.evidence import Evidence, carried_view, carried_views, unexplained
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.lens import Lens


def true_geometry(scene, **changed):
    given = Geometry(
        world_to_camera=scene.poses,
        intrinsics=scene.intrinsics,
        focal_source="file",
        inverse_depth=scene.inverse_depth,
        reference=len(scene.views) // 2,
        tracks=100,
        reprojection_rms_px=0.1,
        parallax_px=1.0,
        verdict="full",
        notes=(),
    )
    return replace(given, **changed)


def test_the_middle_view_is_carried_to_where_it_belongs(seen):
    """On a bare wall, with no edge of depth to hide anything."""
    scene = seen(depths=(0.8, 0.8))
    geometry = true_geometry(scene, inverse_depth=np.full(scene.inverse_depth.shape, 0.8, np.float32))
    for view in range(len(scene.views)):
        carried = carried_view(scene.views[geometry.reference], geometry, view)
        inner = np.s_[12:-12, 12:-12]
        assert np.abs(carried - scene.views[view])[inner].mean() < 0.01
        still = np.abs(scene.views[geometry.reference] - scene.views[view])[inner].mean()
        assert view == geometry.reference or still > 0.02


def test_the_true_geometry_leaves_less_than_wrong_ones(seen, expose):
    scene = seen()
    shot, truth = expose(scene), true_geometry(scene)
    right = unexplained(shot, scene.views, truth)
    flat = np.ones_like(scene.inverse_depth)
    backwards = scene.poses.copy()
    backwards[:, :3, 3] *= -1
    far = scene.poses.copy()
    far[:, 0, 3] += 100 * np.arange(len(far))
    wrong = {
        "flat": replace(truth, inverse_depth=flat),
        "still": replace(truth, world_to_camera=np.tile(np.eye(4), (5, 1, 1))),
        "backwards": replace(truth, world_to_camera=backwards),
        "far off": replace(truth, world_to_camera=far),
        "half the focal length": replace(truth, intrinsics=np.diag([0.5, 0.5, 1]) @ scene.intrinsics),
    }
    left = {name: unexplained(shot, scene.views, geometry) for name, geometry in wrong.items()}
    assert all(value > 1.03 * right for value in left.values()), (right, left)
    assert left["still"] > 1.5 * right
    assert left["far off"] > 1.5 * right


def test_saturated_pixels_and_closed_masks_say_nothing(seen, expose):
    scene = seen()
    shot = expose(scene)
    blind = np.zeros(shot.size, bool)
    blind[:40] = True
    spoilt = shot.measurement.copy()
    spoilt[:40] += 5
    wanted = unexplained(replace(shot, masks=shot.masks * ~blind), scene.views, true_geometry(scene))
    clipped = replace(shot, measurement=spoilt, saturated=blind)
    closed = replace(shot, measurement=spoilt, masks=shot.masks * ~blind)
    assert unexplained(clipped, scene.views, true_geometry(scene)) == pytest.approx(wanted)
    assert unexplained(closed, scene.views, true_geometry(scene)) == pytest.approx(wanted)


def test_a_scene_behind_a_camera_gives_a_finite_number(seen, expose):
    scene = seen()
    turned = scene.poses.copy()
    turned[1, :3, :3] = np.diag([-1.0, 1, -1])
    assert np.isfinite(unexplained(expose(scene), scene.views, true_geometry(scene, world_to_camera=turned)))


def test_a_part_of_the_pixels_tells_about_the_same_and_always_the_same_part(seen, expose):
    scene = seen()
    shot, geometry = expose(scene), true_geometry(scene)
    whole = unexplained(shot, scene.views, geometry)
    part, again = (Evidence(shot, scene.views, most_pixels=2_000).left(geometry) for _ in range(2))
    assert part == again
    assert part != whole
    assert part == pytest.approx(whole, rel=0.1)


def test_what_is_left_is_what_the_carried_views_leave_behind_a_mosaic_too(seen, expose):
    """Against the whole way by `carried_views` and the measurement model."""
    scene = seen()
    plain = expose(scene)
    mosaic = replace(plain, measurement=np.ascontiguousarray(plain.measurement[..., :1]), cfa="BGGR").check()
    for shot in (plain, mosaic):
        geometry = true_geometry(scene)
        carried = torch.from_numpy(carried_views(scene.views, geometry))
        left = Coding.of(shot).forward(carried).numpy() - shot.measurement
        coded = shot.masks.any(axis=0)
        wanted = np.sqrt(np.mean(left[coded].astype(np.float64) ** 2))
        assert unexplained(shot, scene.views, geometry) == pytest.approx(wanted, rel=1e-5)


def test_behind_a_lens_pixels_look_where_the_lens_sends_them(seen, expose):
    scene = seen()
    shot = replace(expose(scene), distortion=np.array([-0.05, 0, 0, 0, 0.0])).check()
    lens = Lens.of(shot)
    assert lens is not None
    views = lens.straightened(scene.views)
    wall = np.full(views.shape[1:3], 0.8, np.float32)
    geometry = true_geometry(scene, intrinsics=lens.canvas_intrinsics, inverse_depth=wall)
    exposed = Coding.of(shot).forward(torch.from_numpy(carried_views(views, geometry, lens))).numpy()
    taken = replace(shot, measurement=exposed)
    # What is left is the blur of interpolating once more.
    assert unexplained(taken, views, geometry, lens) < 0.01
    assert unexplained(taken, views, geometry) > 0.1


def test_a_measurement_without_light_leaves_nothing(seen, expose):
    scene = seen()
    shot = expose(scene)
    dark = replace(shot, masks=np.zeros_like(shot.masks), measurement=np.zeros_like(shot.measurement))
    assert unexplained(dark, scene.views, true_geometry(scene)) == 0
