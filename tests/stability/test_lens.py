"""A lens with known distortion, end to end: from a simulated exposure to views and scene."""

import numpy as np
import pytest
import torch

from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.radiance import Renderer
from tests.stability.benches import Bench, build

pytestmark = pytest.mark.slow

SIZE = (60, 80)
SETTINGS = Settings(
    fit=CoarseSettings(iterations=120, densify_every=25, hold_out=HoldOut(share=0.04, look_every=20, patience=80)),
    fits=1,
)


def mean_psnr(views, truth):
    return float(np.mean(psnr_per_view(views, truth)))


@pytest.fixture(scope="module")
def bent():
    shot = Bench("boxes", parallax_px=6.0, effects=(LensDistortion(-0.2),)).expose(SIZE)
    return shot, reconstruct(shot, SETTINGS)


def test_a_known_distortion_of_a_fifth_costs_next_to_nothing(bent):
    """Over three seeds: 28.7 to 30.1 dB with it, 28.7 to 29.7 without any distortion; up to 1 dB apart by chance."""
    shot, found = bent
    straight = Bench("boxes", parallax_px=6.0).expose(SIZE)
    without = reconstruct(straight, SETTINGS).result
    assert found.result.geometry.verdict == without.geometry.verdict == "full"
    loss_db = mean_psnr(without.views, straight.truth.views) - mean_psnr(found.result.views, shot.truth.views)
    assert loss_db < 1.8
    assert np.array_equal(found.result.distortion, shot.distortion)
    assert np.array_equal(found.result.intrinsics, shot.intrinsics)
    assert found.result.depth.shape == found.result.views.shape[:3]


def test_the_scene_behind_a_known_lens_is_straight(bent):
    """A pinhole shows it where the world is: 27.3 to 27.5 dB, and 25.2 where the lens had not been told."""
    shot, found = bent
    pinhole, _ = Renderer().views(build("boxes", SIZE), shot.truth.world_to_camera)
    poses, camera = (torch.from_numpy(a).float() for a in (found.result.world_to_camera, shot.intrinsics))
    with torch.no_grad():
        seen, _ = load_backend().views(found.scene, poses, camera, SIZE)
    through_lens_db = mean_psnr(found.result.scene_views, shot.truth.views)
    assert mean_psnr(seen.numpy(), pinhole) > through_lens_db - 0.7
