from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.geometry.evidence import carried_view, unexplained
from gs2ci.reconstruct.geometry.initialise import Geometry


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
