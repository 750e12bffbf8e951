"""Bounds in scenes, behind masks and in company that are made to exceed them."""

import dataclasses

import numpy as np
import pytest
import torch

from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.optics_psf import OpticsPsf
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.preview import preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, Modulator, Rig
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.rgbd import motorcycle

SIZE = (48, 64)
# At rest a change may be as large as its bound; views are of float32.
ROUNDED = 1 + 1e-5
RENDERER = Renderer()


def rig_for(masks):
    return Rig(light=Light(1000.0), modulator=Modulator(masks=len(masks)))


def opened(size, count=1):
    return np.ones((count, *size), np.float32)


def still(scene):
    return StageMove((0.0, 0.0, 0.0), reference_world_to_camera=scene.world_to_camera)


def reached(scene, effect, masks=None, company=(), path=None, rig=None, seeds=(3,)):
    """Return which share of its bound an effect's change reaches, rms and peak, over exposures of several devices."""
    masks = opened(scene.size) if masks is None else masks
    path = path or still(scene)
    rig = rig or rig_for(masks)
    company = (MotionBlur(5), *company)
    bound = effect.bound(preview(scene, path, masks, rig, RENDERER, effects=(*company, effect)), rig)

    def readings(effects, seed):
        chain = EffectChain(effects, seed, dataclasses.replace(rig, device_seed=seed))
        return read_out(integrate(scene, path, masks, chain, renderer=RENDERER).photons, chain)

    changes = [readings((*company, effect), seed) - readings(company, seed) for seed in seeds]
    rms = max(float(np.sqrt(np.square(change).mean())) for change in changes)
    peak = max(float(np.abs(change).max()) for change in changes)
    return rms / bound.rms_dn, peak / bound.peak_dn


def only(scene, seen):
    """Return a scene with those Gaussians alone whose image, columns and rows [G], is among the given ones."""
    gaussians = scene.gaussians
    pose = torch.as_tensor(scene.world_to_camera)
    places = gaussians.means.double() @ pose[:3, :3].T + pose[:3, 3]
    image = places @ torch.as_tensor(scene.intrinsics).T
    return dataclasses.replace(
        scene, gaussians=gaussians.map(lambda part: part[seen(*(image[:, :2] / image[:, 2:]).T)])
    )


def beside(scene, gap_px=0.0):
    """Return a scene of which nothing lies on the sensor but, all around it, what is beside it."""
    (height, width), gap = scene.size, gap_px
    return only(scene, lambda x, y: (x < -gap) | (x > width + gap) | (y < -gap) | (y > height + gap))


def within(scene):
    """Return a scene of which nothing lies beside the sensor."""
    height, width = scene.size
    return only(scene, lambda x, y: (x > 0) & (x < width) & (y > 0) & (y < height))


@pytest.fixture(scope="module")
def scene():
    return planes(np.random.default_rng(0), SIZE)


@pytest.mark.parametrize("sigma_px", [0.2, 1.0, 3.0, 10.0])
@pytest.mark.parametrize("light", [lambda scene: scene, within, beside], ids=["everywhere", "within", "beside"])
def test_blur_keeps_within_its_bound_however_the_light_lies_about_the_sensor(scene, light, sigma_px):
    assert max(reached(light(scene), OpticsPsf(sigma_px))) <= ROUNDED


@pytest.mark.parametrize(("size", "sigma_px"), [(SIZE, 3.0), (SIZE, 10.0), ((8, 8), 0.3), ((8, 8), 1.0)])
def test_blur_keeps_within_its_bound_where_the_picture_ends_beside_the_sensor(size, sigma_px):
    found = reached(motorcycle(size), OpticsPsf(sigma_px))
    assert 0.5 < found[0] <= max(found) <= ROUNDED


@pytest.mark.parametrize("light", [within, beside])
def test_blur_keeps_within_its_bound_while_the_camera_moves(scene, light):
    lit = light(scene)
    path = stage_move_for_parallax(lit, 1.0, 0.2)
    assert reached(lit, OpticsPsf(2.0), opened(SIZE, 2), path=path)[0] <= ROUNDED


def test_a_kernel_is_cut_off_with_regard_to_the_light_beside_the_sensor(scene):
    lit, whole = beside(scene), OpticsPsf(2.0)
    rig = rig_for(opened(SIZE))
    look = preview(lit, still(lit), opened(SIZE), rig, RENDERER, effects=(MotionBlur(1), whole))
    for reach in (2.0, 3.0):
        cut = dataclasses.replace(whole, reach=reach)
        light, cut_light = (
            integrate(lit, still(lit), opened(SIZE), EffectChain((MotionBlur(1), one), 0, rig), renderer=RENDERER)
            for one in (whole, cut)
        )
        change_dn = rig.sensor.quantum_efficiency * rig.dn_per_e * (light.photons - cut_light.photons)
        assert 0 < np.sqrt(np.square(change_dn).mean()) <= ROUNDED * whole.kernel_bound(look, rig, reach).rms_dn


@pytest.mark.parametrize("samples", [1, 2])
def test_a_spectrum_holds_all_of_what_pixels_show(scene, samples):
    look = preview(scene, still(scene), opened(SIZE), rig_for(opened(SIZE)), Renderer(supersampling=samples))
    noise = np.random.default_rng(4).random((1, SIZE[0] * samples, SIZE[1] * samples, 3), np.float32)
    look = dataclasses.replace(look, fine_views=noise - 0.5)
    assert look.filtered(np.ones_like)[0] == pytest.approx(np.sqrt(np.square(look.views).mean()), rel=0.02)
