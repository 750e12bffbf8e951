"""Scenes fitted to what viewers do, held against the definition of both conventions in float64."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.evaluate.exports.for_viewers import brought_nearer, for_viewers
from gs2ci.render.gaussians import logit
from tests.render.reference import ReferenceBackend, project
from tests.render.scenes_in_units import SIZE, drawn, psnr_db, scaled

FOCAL = 1.1 * max(SIZE)
INTRINSICS = torch.tensor([[FOCAL, 0, SIZE[1] / 2 + 3.0], [0, FOCAL, SIZE[0] / 2 - 2.0], [0, 0, 1]])
DILATION_PX2 = 0.3


def path(unit=1.0):
    poses = torch.eye(4, dtype=torch.float64)[None].repeat(3, 1, 1)
    poses[0, 0, 3], poses[2, 1, 3] = 0.2 * unit, -0.1 * unit
    return poses


def fine(seed, unit=1.0, degree=0):
    """A scene of Gaussians narrower than pixels, with colours beyond 0 to 1, as fits of small pictures make them."""
    scene = drawn(seed, unit, degree, count=200)
    draws = torch.Generator().manual_seed(seed)
    return replace(
        scene,
        log_scales=scene.log_scales - 1.6,
        colours=scene.colours + 0.35 * torch.randn(scene.colours.shape, generator=draws),
    )


def seen(scene, *, light_kept, clamped=True):
    """Draw all views by the float64 definition, as a viewer does."""
    pictures = []
    for pose in path():
        own = scene.map(torch.Tensor.double)
        if clamped and own.harmonics is None:
            own = replace(own, colours=own.colours.clamp(0, 1))
        if light_kept:
            splats = project(own, pose, INTRINSICS.double(), SIZE, own.colours)
            before = torch.linalg.det(splats.covariances - DILATION_PX2 * torch.eye(2)).clamp(min=1e-12)
            kept = torch.ones(len(own), dtype=torch.float64)
            kept[splats.index] = (before / torch.linalg.det(splats.covariances)).sqrt()
            opacity = (torch.sigmoid(own.opacity_logits) * kept).clamp(1e-9, 1 - 1e-9)
            own = replace(own, opacity_logits=logit(opacity))
        pictures.append(ReferenceBackend().views(own, pose[None], INTRINSICS, SIZE)[0][0])
    return torch.stack(pictures).clamp(0, 1).detach().numpy()


@pytest.mark.parametrize(("unit", "degree"), [(1e-3, 0), (1e6, 2)])
def test_a_scene_looks_alike_in_viewers_of_both_conventions(unit, degree):
    """A quarter of the demonstration's colours lay outside 0 to 1, and Spark showed it 8 dB darker (E3)."""
    scene = fine(degree, unit, degree)
    found = for_viewers(scene, path(unit), INTRINSICS, SIZE)
    assert found.scene.colours.min() >= 0
    assert found.scene.colours.max() <= 1
    torch.testing.assert_close(found.scene.means, scene.means)
    own, wanted = scaled(found.scene, 1 / unit), seen(scaled(scene, 1 / unit), light_kept=False, clamped=False)
    kept = psnr_db(seen(own, light_kept=False), wanted)
    light = psnr_db(seen(own, light_kept=True), wanted)
    if degree == 0:  # what it says of itself is so
        np.testing.assert_allclose([found.after.opacity_db, found.after.light_db], [kept, light], atol=0.1)
    assert light > psnr_db(seen(scaled(scene, 1 / unit), light_kept=True), wanted) + 5
    assert min(kept, light) > 24
    assert f"{found.after.light_db:.1f} dB where light is" in found.sentence


def test_the_fit_is_the_same_every_time_and_never_worse_than_clamping():
    scene = fine(3)
    one, other = (for_viewers(scene, path(), INTRINSICS, SIZE, steps=6) for _ in range(2))
    for name, values in one.scene.parameters().items():
        assert torch.equal(values, getattr(other.scene, name))
    plain = for_viewers(scene, path(), INTRINSICS, SIZE, steps=0)
    assert min(plain.after.opacity_db, plain.after.light_db) >= min(plain.before.opacity_db, plain.before.light_db)


def test_a_moving_scene_is_taken_at_the_middle_and_an_empty_one_as_it_is():
    scene = fine(4)
    moving = replace(scene, motion=torch.ones(len(scene), 1, 3))
    found = for_viewers(moving, path(), INTRINSICS, SIZE, steps=2)
    assert found.scene.motion is None
    torch.testing.assert_close(found.scene.means, scene.means)
    nothing = for_viewers(scene.map(lambda tensor: tensor[:0]), path(), INTRINSICS, SIZE)
    assert len(nothing.scene) == 0
    assert math.isfinite(nothing.after.light_db)
    behind = for_viewers(replace(scene, means=-scene.means), path(), INTRINSICS, SIZE, steps=2)
    torch.testing.assert_close(behind.scene.colours, scene.colours.clamp(0, 1))


def test_what_is_brought_nearer_looks_as_before():
    scene = fine(6)
    far = replace(scene, means=scene.means.clone(), log_scales=scene.log_scales.clone())
    middle = -path()[:, :3, 3].mean(dim=0)
    # Some are four thousand times as far away, on the same lines of sight from the middle of the path.
    far.means[:20] = (middle + 4000 * (scene.means[:20].double() - middle)).float()
    far.log_scales[:20] += math.log(4000)
    found, count = brought_nearer(far, path(), 1000.0)
    assert count == 20
    assert found.means.abs().max() < 1000 * 12
    assert psnr_db(seen(found, light_kept=False, clamped=False), seen(far, light_kept=False, clamped=False)) > 60
    torch.testing.assert_close(found.means[20:], scene.means[20:])
