"""Bounds in scenes, behind masks and in company that are made to exceed them."""

import dataclasses

import numpy as np
import pytest
import torch

from gs2ci_sims.effects.base import LightStage
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import Blooming, DarkCurrent, FullWell, Persistence
from gs2ci_sims.effects.flicker import IlluminationDrift
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import HotPixels, Prnu, ReadNoise, RowNoise, ShotNoise
from gs2ci_sims.effects.photons import GhostReflection, ModulatorPsf
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.effects.stage import StageVibration
from gs2ci_sims.effects.views import Defocus, LensDistortion, OpticsPsf, Vignetting
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain, sensor_effects
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.preview import preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.scenes.rgbd import motorcycle
from gs2ci_sims.sensor import SensorFigures
from gs2ci_sims.signals import View
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask

SIZE = (48, 64)
# At rest a change may be as large as its bound; views are of float32.
ROUNDED = 1 + 1e-5
RENDERER = Renderer()


def rig_for(masks):
    return RigFigures(light=Light(1000.0), modulator=ModulatorFigures(masks=len(masks)))


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
    shares = []
    for seed in seeds:
        device = dataclasses.replace(rig, device_seed=seed)
        bound = effect.bound(preview(scene, path, masks, device, RENDERER, effects=(*company, effect)), device)
        with_it, without = (
            read_out(integrate(scene, path, masks, chain, renderer=RENDERER), chain)
            for chain in (EffectChain(effects, seed, device) for effects in ((*company, effect), company))
        )
        change = with_it - without
        rms, peak = float(np.sqrt(np.square(change).mean())), float(np.abs(change).max())
        shares.append((_share(rms, bound.rms_dn), _share(peak, bound.peak_dn)))
    return np.max(shares, axis=0)


def _share(change_dn, bound_dn):
    """Return which share of a bound is reached; readings of some hundred DN are rounded to 1e-9 DN or so."""
    if change_dn < 1e-6:
        return 0.0
    return change_dn / bound_dn if bound_dn > 0 else np.inf


def only(scene, seen):
    """Return a scene with those Gaussians alone whose image, columns and rows [G], is among the given ones."""
    gaussians = scene.gaussians
    pose = torch.as_tensor(scene.world_to_camera)
    places = gaussians.means.double() @ pose[:3, :3].T + pose[:3, 3]
    image = places @ torch.as_tensor(scene.intrinsics).T
    return dataclasses.replace(
        scene, gaussians=gaussians.map(lambda part: part[seen(*(image[:, :2] / image[:, 2:]).T)])
    )


def in_corners(scene, side_px):
    """Return a scene of which nothing lies farther from the sensor's corners."""
    (height, width), side = scene.size, side_px
    return only(scene, lambda x, y: ((x < side) | (x > width - side)) & ((y < side) | (y > height - side)))


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
        change_dn = rig.sensor.quantum_efficiency * rig.dn_per_e * (light - cut_light)
        assert 0 < np.sqrt(np.square(change_dn).mean()) <= ROUNDED * whole.kernel_bound(look, rig, reach).rms_dn


@pytest.mark.parametrize("samples", [1, 2])
def test_a_spectrum_holds_all_of_what_pixels_show(scene, samples):
    look = preview(scene, still(scene), opened(SIZE), rig_for(opened(SIZE)), Renderer(supersampling=samples))
    noise = np.random.default_rng(4).random((1, SIZE[0] * samples, SIZE[1] * samples, 3), np.float32)
    look = dataclasses.replace(look, fine_views=noise - 0.5)
    assert look.filtered(np.ones_like)[0] == pytest.approx(np.sqrt(np.square(look.views).mean()), rel=0.02)


def striped(scene, disc_px, focus_depth, near_share):
    """Return stripes that a disc takes most of, on two depths, a lens, and a preview of this.

    The discs of the lens are of that size on most of the sensor, and 1.64 times as large, where they take less of the
    stripes, on a share of its rows.
    """
    far, focal_px = 2 * focus_depth, scene.intrinsics[0, 0]
    lens = Defocus(disc_px / (focal_px / focus_depth - focal_px / far), focus_depth)
    near = 1 / (1 / focus_depth + 1.64 * disc_px / (focal_px * lens.aperture))
    depth = np.full(SIZE, far)
    depth[: round(near_share * SIZE[0])] = near
    scene = dataclasses.replace(scene, depth=depth)
    wave = 0.5 + 0.5 * np.cos(5.14 / disc_px * 2 * (np.arange(SIZE[1]) + 0.5))
    picture = np.broadcast_to(wave[None, :, None], (*SIZE, 3)).copy()
    look = preview(scene, still(scene), opened(SIZE), rig_for(opened(SIZE)), RENDERER)
    fine = picture.repeat(look.samples, axis=0).repeat(look.samples, axis=1).astype(np.float32)
    return lens, depth, picture, dataclasses.replace(look, fine_views=fine[None])


@pytest.mark.parametrize("disc_px", [1.5, 2.0, 3.0, 10.0])
@pytest.mark.parametrize("near_share", [0.05, 0.5])
def test_defocus_keeps_within_its_bound_where_a_narrower_disc_takes_more_than_the_widest(scene, disc_px, near_share):
    lens, depth, picture, look = striped(scene, disc_px, 2.0, near_share)
    seen = lens.apply(View(picture, scene.intrinsics, 0, depth), look.rig, np.random.default_rng(0))
    change_dn = look.full_scale_dn * (seen.radiance - picture)
    bound = lens.bound(look, look.rig)
    assert 0.3 * bound.rms_dn < np.sqrt(np.square(change_dn).mean()) <= ROUNDED * bound.rms_dn
    assert np.abs(change_dn).max() <= bound.peak_dn


@pytest.mark.parametrize("disc_px", [2.0, 8.0])
def test_defocus_keeps_within_its_bound_where_each_pixel_has_the_depth_that_changes_it_most(scene, disc_px):
    lens, depth, _, look = striped(scene, disc_px, 2.0, 0.5)
    picture = np.random.default_rng(1).random((*SIZE, 1)).repeat(3, axis=2)
    fine = picture.repeat(look.samples, axis=0).repeat(look.samples, axis=1).astype(np.float32)
    look = dataclasses.replace(look, fine_views=fine[None])

    def changed(depths):
        view = View(picture, scene.intrinsics, 0, depths)
        return lens.apply(view, look.rig, np.random.default_rng(0)).radiance - picture

    apart = np.array([changed(np.full(SIZE, one)) for one in (depth.min(), depth.max())])
    worst = changed(np.where(np.abs(apart).argmax(axis=0)[..., 0] == 0, depth.min(), depth.max()))
    assert look.full_scale_dn * np.sqrt(np.square(worst).mean()) <= ROUNDED * lens.bound(look, look.rig).rms_dn


@pytest.mark.parametrize("side_px", [4, 8])
@pytest.mark.parametrize("k1", [-0.02, -0.005, 0.02])
@pytest.mark.parametrize("parallax_px", [0.0, 1.0])
def test_a_lens_keeps_within_its_bound_where_all_detail_lies_in_the_corners(side_px, k1, parallax_px):
    scene = in_corners(planes(np.random.default_rng(0), (96, 128)), side_px)
    path = stage_move_for_parallax(scene, parallax_px, 0.2) if parallax_px else still(scene)
    assert max(reached(scene, LensDistortion(k1), opened(scene.size, 2), path=path)) <= ROUNDED


def test_lens_defocus_and_blur_keep_within_their_bounds_beside_each_other(scene):
    every = (LensDistortion(-0.05), Defocus(0.2, 3.0), OpticsPsf(0.5))
    for light in (scene, within(scene), beside(scene)):
        for effect in every:
            found = reached(light, effect, company=tuple(one for one in every if one is not effect))
            assert max(found) <= ROUNDED


@pytest.mark.parametrize("share", [0.005, 0.5])
def test_defocus_is_bounded_for_the_few_pixels_that_are_nearest_and_for_a_camera_that_comes_near(scene, share):
    depth = np.full(SIZE, 4.0)
    depth[: max(round(share * SIZE[0]), 1), :12] = 1.0
    flat, lens = dataclasses.replace(scene, depth=np.full(SIZE, 4.0)), Defocus(0.1, 4.0)
    rig = rig_for(opened(SIZE))
    for seen, path, sharp in (
        (flat, still(flat), True),
        (dataclasses.replace(scene, depth=depth), still(scene), False),
        (flat, StageMove((0.0, 0.0, 3.0 / rig.exposure_s)), False),
    ):
        look = preview(seen, path, opened(SIZE), rig, RENDERER, effects=(lens,))
        assert (lens.bound(look, rig).rms_dn == 0) == sharp


DARK = {
    "noise about 0": (SensorFigures(black_level_dn=0.0, read_noise_e=30.0), ()),
    "noise that reaches 0": (SensorFigures(black_level_dn=40.0, read_noise_e=30.0), ()),
    "rows that reach 0": (SensorFigures(black_level_dn=5.0), (RowNoise(8.0),)),
    "a black level that has drifted below 0": (SensorFigures(), (BlackLevel(-100.0),)),
    "one that has drifted near 0, and noise": (SensorFigures(read_noise_e=9.0), (BlackLevel(-62.0),)),
}


@pytest.mark.parametrize("case", DARK)
def test_the_converter_keeps_within_its_bound_where_dark_readings_are_clipped_at_0(scene, case):
    sensor, others = DARK[case]
    dark = np.zeros((1, *SIZE), np.float32)
    rig = dataclasses.replace(rig_for(dark), sensor=sensor)
    converter = Quantisation(sensor.bits)
    company = (*(effect for effect in sensor_effects(sensor) if effect.name != converter.name), *others)
    found = reached(scene, converter, dark, company, rig=rig, seeds=range(4))
    assert 0.01 < found[0] <= max(found) <= ROUNDED
    decided = plan(SimulationTask(scene, still(scene), dark, rig, (MotionBlur(), *company, converter)), PlanChoice(2.0))
    assert converter.name in {effect.name for effect in decided.effects}


def test_a_converter_whose_black_level_is_above_all_noise_rounds_and_nothing_else(scene):
    rig = rig_for(opened(SIZE))
    look = preview(scene, still(scene), opened(SIZE), rig, RENDERER, effects=(ReadNoise(2.9), BlackLevel(20.0)))
    assert Quantisation(12).bound(look, rig).rms_dn == 0.5


CHARGED = [
    DarkCurrent(2000.0),
    DarkCurrent(1e5),
    HotPixels(0.05, 2e4),
    Persistence(0.5, 0.1, 0.0, 3000.0),
    ShotNoise(),
    Prnu(0.05),
    FullWell(800.0),
    Blooming(0.5),
    Quantisation(9),
]


@pytest.mark.parametrize("effect", CHARGED, ids=str)
@pytest.mark.parametrize("departure", [-0.2, 0.05, 0.2])
@pytest.mark.parametrize("photons", [0.0, 1000.0, 15000.0])
def test_a_bound_on_charge_holds_before_an_amplifier_that_bends(scene, effect, departure, photons):
    """The amplifier is steepest at no charge where it bends upwards, at the full well where it bends downwards."""
    rig = RigFigures(light=Light(photons), modulator=ModulatorFigures(masks=2))
    own = [FullWell(rig.sensor.full_well_e), GainNonlinearity(departure), DarkCurrent(3000.0)]
    company = [one for one in own if one.name != effect.name]
    found = reached(scene, effect, opened(SIZE, 2), company, rig=rig, seeds=range(2))
    assert max(found) <= ROUNDED


MOSAIC = BayerFilter("RGGB")
IN_COLOUR = [
    Vignetting(4.0),
    FiniteContrast(),
    IlluminationDrift(0.5),
    GhostReflection(0.05, 3.0),
    MaskEdges(0.4),
    Misregistration(0.3, 0.2),
    ModulatorPsf(0.5),
    OpticsPsf(0.5),
    OpticsPsf(3.0),
    LensDistortion(-0.05),
    StageVibration(5e-3, 30.0),
    Prnu(0.05),
    ShotNoise(),
    FullWell(600.0),
    GainNonlinearity(0.1),
]


def coloured(scene, colour):
    """Return the scene with hardly any light of the other colours."""
    gaussians = scene.gaussians
    share = torch.full((3,), 0.05)
    share[colour] = 1.0
    return dataclasses.replace(scene, gaussians=dataclasses.replace(gaussians, colours=gaussians.colours * share))


def colour_masks(colour):
    """Return two masks that are open at the pixels of one colour, and one that is open at the others."""
    own = (
        MOSAIC.apply(np.broadcast_to(np.arange(3.0), (*SIZE, 3)), RigFigures(), np.random.default_rng(0))[..., 0]
        == colour
    )
    return np.stack([own, own, ~own]).astype(np.float32)


@pytest.mark.parametrize("effect", IN_COLOUR, ids=str)
@pytest.mark.parametrize("parallax_px", [0.0, 0.6])
def test_a_bound_holds_where_a_mosaic_records_the_brightest_colour(scene, effect, parallax_px):
    for lit, masks in (
        (coloured(scene, 1), opened(SIZE, 2)),
        (coloured(scene, 1), colour_masks(1)[:2]),
        (coloured(scene, 0), colour_masks(0)),
        (scene, colour_masks(1)[:2]),
    ):
        rig = rig_for(masks)
        path = stage_move_for_parallax(lit, parallax_px, rig.exposure_s) if parallax_px else still(lit)
        found = reached(lit, effect, masks, (MOSAIC,), path)
        assert max(found) <= ROUNDED


def test_light_that_the_relay_brings_to_pixels_of_its_colour_counts(scene):
    """All light is red and falls between the red pixels: without the relay's blur none of it is recorded."""
    lit, masks = coloured(scene, 0), colour_masks(0)[2:]
    look = preview(lit, still(lit), masks, rig_for(masks), RENDERER, effects=(MOSAIC, ModulatorPsf(0.6)))
    red_e = look.light_e[..., :1].repeat(3, axis=2) * np.array([1.0, 0.0, 0.0])

    def recorded(reach):
        blur = ModulatorPsf(0.6, reach=reach)
        return look.recorded(EffectChain((blur,), 0, look.rig).through(LightStage.PHOTONS, red_e))

    change_dn = look.rig.dn_per_e * (recorded(8.0) - recorded(2.0))
    assert 0 < np.sqrt(np.square(change_dn).mean()) <= ModulatorPsf(0.6).kernel_bound(look, look.rig, 2.0).rms_dn
