"""Effects of scene, optics and modulator against their closed forms."""

import dataclasses

import numpy as np
import pytest
from scipy.special import j1

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.kernels import blurred, blurred_inside, disc, discrete_gaussian, gaussian_loss, gaussian_tail
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.photons import Dust, GhostReflection, ModulatorPsf
from gs2ci_sims.effects.views import LAYER_STEP_PX, MOST_TAKEN, Defocus, LensDistortion, OpticsPsf, Vignetting
from gs2ci_sims.rig import ModulatorFigures, Optics, RigFigures
from gs2ci_sims.scene import camera_looking_ahead
from gs2ci_sims.signals import View

RIG = RigFigures()
SIZE = (41, 61)
CAMERA = camera_looking_ahead(SIZE, 40.0)


def rng(seed=0):
    return np.random.default_rng(seed)


def spot(row, column, sigma=1.5):
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    image = np.exp(-0.5 * ((rows - row) ** 2 + (columns - column) ** 2) / sigma**2)
    return image[..., None].repeat(3, axis=2)


def moments(image):
    """Return centre and variance along the rows and columns."""
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    mass = image / image.sum()
    centre = np.array([(mass * rows).sum(), (mass * columns).sum()])
    return centre, np.array([(mass * (rows - centre[0]) ** 2).sum(), (mass * (columns - centre[1]) ** 2).sum()])


@pytest.mark.parametrize("sigma", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("frequency", [0.0625, 0.25])
def test_the_mtf_of_the_optics_psf_is_that_of_the_discrete_gaussian(sigma, frequency):
    wave = 1 + np.cos(2 * np.pi * frequency * (np.arange(64) + 0.5))
    image = np.broadcast_to(wave[None, :, None], (40, 64, 3)).copy()
    seen = OpticsPsf(sigma, 10.0).apply(View(image, CAMERA), RIG, rng()).radiance
    kept = np.exp(sigma**2 * (np.cos(2 * np.pi * frequency) - 1))
    np.testing.assert_allclose(seen - 1, kept * (image - 1), atol=1e-6)
    assert 1 - kept <= gaussian_loss(sigma, np.array(frequency)) + 1e-12


def test_a_gaussian_kernel_keeps_its_variance_at_any_width_and_states_its_tail():
    for sigma in (0.1, 0.7, 3.0):
        kernel = discrete_gaussian(sigma, 30.0)
        place = np.arange(len(kernel)) - len(kernel) // 2
        assert (kernel * place**2).sum() == pytest.approx(sigma**2, rel=1e-6)
        cut = discrete_gaussian(sigma, 2.0)
        whole = discrete_gaussian(sigma, 30.0)
        middle = whole[len(whole) // 2 - len(cut) // 2 :][: len(cut)]
        assert gaussian_tail(sigma, 2.0) == pytest.approx(1 - middle.sum(), abs=1e-12)


def test_no_blur_is_the_image_itself():
    image = rng().uniform(size=(9, 9, 3))
    assert blurred(image, 0.0, 8.0) is image
    assert disc(0.5).tolist() == [[1.0]]


@pytest.mark.parametrize(("size", "sigma", "margin"), [((21, 30), 1.5, 9), ((9, 12), 20.0, 4), ((9, 9), 0.0, 2)])
def test_a_blur_without_its_margin_is_the_inside_of_the_whole_one(size, sigma, margin):
    view = View(rng().uniform(size=(*size, 3)), CAMERA, margin)
    inside = blurred_inside(view.radiance, sigma, 4.0, margin)
    np.testing.assert_allclose(inside, view.inner(blurred(view.radiance, sigma, 4.0)), atol=1e-14)
    assert inside.shape == (size[0] - 2 * margin, size[1] - 2 * margin, 3)


def test_a_disc_has_the_variance_of_a_disc_and_its_transfer_function():
    kernel = disc(8.0)
    _, variance = moments(kernel)
    assert variance == pytest.approx([8.0**2 / 16 + 1 / 12] * 2, rel=0.01)
    wave = np.cos(2 * np.pi * 0.05 * (np.arange(len(kernel)) - len(kernel) // 2))
    x = np.pi * 8.0 * 0.05
    assert (kernel * wave).sum() == pytest.approx(2 * j1(x) / x * np.sinc(0.05), abs=2e-3)


def test_no_disc_takes_more_of_a_cosine_than_its_variance_allows_or_than_the_most():
    across, down = (side.ravel() for side in np.meshgrid(np.linspace(0, 0.5, 41), np.linspace(0, 0.5, 41)))
    before, most = 0.0, 0.0
    for diameter in np.arange(1.5, 24.0, LAYER_STEP_PX):
        kernel = disc(diameter)
        place = np.arange(len(kernel)) - len(kernel) // 2
        variance = kernel.sum(axis=1) @ place**2
        waves = [np.cos(2 * np.pi * np.outer(side, place)) for side in (down, across)]
        taken = np.abs(1 - np.einsum("fi,ij,fj->f", waves[0], kernel, waves[1]))
        assert variance > before
        assert (taken <= 2 * np.pi**2 * variance * (across**2 + down**2) + 1e-12).all()
        before, most = variance, max(most, taken.max())
    assert 0.99 * MOST_TAKEN < most < MOST_TAKEN


def test_defocus_spreads_a_point_by_aperture_times_the_difference_of_inverse_depths():
    image = np.zeros((*SIZE, 3))
    image[20, 30] = 1.0
    lens = Defocus(aperture=0.5, focus_depth=2.0)
    diameter = CAMERA[0, 0] * 0.5 * (1 / 2.0 - 1 / 3.0)
    seen = lens.apply(View(image, CAMERA, 0, np.full(SIZE, 3.0)), RIG, rng()).radiance[..., 0]
    assert seen.sum() == pytest.approx(1.0)
    _, variance = moments(seen)
    assert variance == pytest.approx([diameter**2 / 16] * 2, rel=0.05)


def test_what_lies_in_focus_or_nowhere_stays_sharp():
    image = rng().uniform(size=(*SIZE, 3))
    for depth in (2.0, np.nan):
        seen = Defocus(0.5, 2.0).apply(View(image, CAMERA, 0, np.full(SIZE, depth)), RIG, rng()).radiance
        np.testing.assert_allclose(seen, image, atol=1e-12)


@pytest.mark.parametrize("k1", [-0.3, 0.3])
def test_lens_distortion_moves_a_spot_along_its_radius_by_browns_polynomial(k1):
    row, column = 10.0, 50.0
    middle = np.array([CAMERA[1, 2], CAMERA[0, 2]]) - 0.5
    offset = (np.array([row, column]) - middle) / CAMERA[0, 0]
    expected = middle + CAMERA[0, 0] * offset * (1 + k1 * (offset**2).sum())
    seen = LensDistortion(k1).apply(View(spot(row, column), CAMERA), RIG, rng()).radiance[..., 0]
    centre, _ = moments(seen)
    np.testing.assert_allclose(centre, expected, atol=0.06)
    assert np.linalg.norm(expected - [row, column]) > 0.3


def test_a_distortion_that_folds_the_image_is_refused():
    with pytest.raises(InputError, match="folds the image"):
        LensDistortion(-20.0).sources_px(SIZE, CAMERA)


def test_vignetting_is_the_fourth_power_of_the_cosine():
    seen = Vignetting().apply(View(np.ones((*SIZE, 3)), CAMERA), RIG, rng()).radiance
    angle = np.arctan((0.5 - CAMERA[0, 2]) / CAMERA[0, 0])
    assert seen[20, 0, 0] == pytest.approx(np.cos(angle) ** 4)
    assert seen[20, 30, 0] == pytest.approx(1.0)


def test_vignetting_follows_the_angle_also_of_pixels_that_are_no_squares():
    tall = CAMERA.copy()
    tall[1, 1] *= 3
    tangent = np.array([(0.5 - tall[0, 2]) / tall[0, 0], (0.5 - tall[1, 2]) / tall[1, 1]])
    seen = Vignetting(2.0).apply(View(np.ones((*SIZE, 3)), tall), RIG, rng()).radiance
    assert seen[0, 0, 0] == pytest.approx(1 / (1 + tangent @ tangent))


def test_relay_blur_and_diffraction_add_in_quadrature():
    rig = RigFigures(optics=Optics(f_number=16.0, wavelength_nm=600.0), modulator=ModulatorFigures(pitch_um=8.0))
    airy_px = 0.42 * 0.6 * 16.0 / 8.0
    assert ModulatorPsf(0.3).total_sigma_px(rig) == pytest.approx(np.hypot(0.3, airy_px))
    light = np.zeros((31, 31, 3))
    light[15, 15] = 100.0
    seen = ModulatorPsf(0.3).apply(light, rig, rng())[..., 1]
    assert seen.sum() == pytest.approx(100.0)
    assert moments(seen)[1] == pytest.approx([0.3**2 + airy_px**2] * 2, rel=1e-6)


def test_a_misregistered_element_covers_its_pixels_by_the_overlap_of_squares():
    mask = np.zeros((1, 9, 9), dtype=np.float32)
    mask[0, 4, 4] = 1.0
    moved = Misregistration(right_px=0.25, down_px=-0.5).apply(mask, RIG, rng())
    np.testing.assert_allclose(moved[0, 3:5, 4:6], [[0.5 * 0.75, 0.5 * 0.25]] * 2)
    assert moved.sum() == pytest.approx(1.0)


def test_a_turned_and_magnified_mask_lands_where_the_affine_map_says():
    mask = np.zeros((1, 41, 41), dtype=np.float32)
    mask[0, 20, 38:40] = 1.0
    moved = Misregistration(turn_mrad=100.0, magnification=0.9).apply(mask, RIG, rng())
    centre, _ = moments(moved[0])
    reach = 0.9 * 18.5
    np.testing.assert_allclose(centre, [20 + reach * np.sin(0.1), 20 + reach * np.cos(0.1)], atol=0.1)


def test_no_misregistration_is_none():
    masks = (rng().random((2, 8, 9)) < 0.5).astype(np.float32)
    np.testing.assert_allclose(Misregistration().apply(masks, RIG, rng()), masks, atol=1e-12)


def test_the_off_level_of_closed_masks_has_its_median_and_its_spread():
    seen = FiniteContrast(25.0, 0.62, 2.0).apply(np.zeros((1, 200, 200), dtype=np.float32), RIG, rng())
    low, median, high = np.quantile(seen, [0.1, 0.5, 0.9])
    assert median == pytest.approx(1 / 25, rel=0.05)
    assert high / low == pytest.approx(np.exp(2 * 1.2816 * 0.62), rel=0.1)
    assert np.array_equal(FiniteContrast().apply(np.ones((1, 5, 5)), RIG, rng()), np.ones((1, 5, 5)))


def test_leakage_of_a_single_pixel_is_the_median():
    assert FiniteContrast(50.0).leakage((1, 1), rng())[0, 0] == pytest.approx(0.02)


def test_mask_edges_spread_an_element_by_their_variance():
    mask = np.zeros((1, 21, 21), dtype=np.float32)
    mask[0, 10, 10] = 1.0
    assert moments(MaskEdges(0.7).apply(mask, RIG, rng())[0])[1] == pytest.approx([0.49, 0.49], rel=1e-6)


def test_only_what_is_in_the_ball_moves_and_by_velocity_times_time(small_scene):
    centre = tuple(float(v) for v in small_scene.gaussians.means[0])
    moving = ObjectMotion(centre, 0.3, (1.0, -2.0, 0.5)).apply(lambda _time_s: small_scene.gaussians, RIG, rng())
    shift = (moving(0.2).means - small_scene.gaussians.means).numpy()
    inside = np.linalg.norm(small_scene.gaussians.means.numpy() - centre, axis=1) <= 0.3
    assert 0 < inside.sum() < len(inside)
    np.testing.assert_allclose(shift[inside], np.broadcast_to([0.2, -0.4, 0.1], (inside.sum(), 3)), atol=1e-6)
    assert not shift[~inside].any()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Defocus(-1.0, 2.0),
        lambda: Defocus(1.0, 0.0),
        lambda: LensDistortion(np.nan),
        lambda: Vignetting(-1.0),
        lambda: OpticsPsf(-0.1),
        lambda: OpticsPsf(1.0, 0.0),
        lambda: ModulatorPsf(np.inf),
        lambda: Dust(-1.0, 1.0, 1.0),
        lambda: Dust(1.0, 129.0, 1.0),
        lambda: Dust(1.0, 1.0, np.nan),
        lambda: GhostReflection(0.6),
        lambda: GhostReflection(0.1, -1.0),
        lambda: Misregistration(magnification=0.0),
        lambda: FiniteContrast(1.0),
        lambda: FiniteContrast(25.0, -0.1),
        lambda: MaskEdges(101.0),
        lambda: ObjectMotion((0.0, 0.0, 0.0), 0.0, (1.0, 0.0, 0.0)),
    ],
)
def test_figures_out_of_range_are_refused_when_the_effect_is_made(make):
    with pytest.raises(InputError, match="allowed"):
        make()


def test_effects_are_records_whose_fields_a_rig_file_can_name():
    assert [entry.name for entry in dataclasses.fields(Defocus)] == ["aperture", "focus_depth"]


@pytest.mark.parametrize(("diameter", "cone"), [(2.0, 9.0), (6.0, 20.0), (0.5, 4.0)])
def test_a_particle_smaller_than_the_cone_takes_its_share_of_the_cones_disc(diameter, cone):
    shadow = Dust(1.0, diameter, cone).shadow()
    assert shadow[shadow.shape[0] // 2, shadow.shape[1] // 2] == pytest.approx((diameter / cone) ** 2, rel=0.02)
    assert shadow.sum() == pytest.approx(np.pi / 4 * diameter**2, rel=1e-9)  # what is lost in all is its area


def test_a_particle_on_the_sensor_itself_is_black():
    shadow = Dust(1.0, 7.0, 0.0).shadow()
    assert shadow.max() == pytest.approx(1.0, abs=1e-3)  # as a disc is drawn
    assert shadow.sum() == pytest.approx(np.pi / 4 * 49, rel=1e-3)


def test_dust_stays_where_it_is_and_particles_that_overlap_multiply():
    dust, light = Dust(40.0, 3.0, 8.0), np.full((*SIZE, 3), 50.0)
    first, second = (dust.apply(light, RIG, rng(4)) for _ in range(2))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, dust.apply(light, RIG, rng(5)))
    assert (first >= 0).all()
    assert first.mean() < 49.5
    assert np.array_equal(Dust(0.0, 3.0, 8.0).apply(light, RIG, rng(4)), light)
    crowd = Dust(2000.0, 3.0, 8.0).transmission(SIZE, rng())
    expected = np.exp(-2000 * Dust(1.0, 3.0, 8.0).shadow().sum() / np.prod(SIZE))
    assert crowd[8:-8, 8:-8].mean() == pytest.approx(expected, rel=0.3)


def test_a_ghost_stands_opposite_with_its_share_of_the_light_and_its_blur():
    image = spot(10, 45)
    ghost = (GhostReflection(0.02, 9.0).apply(image, RIG, rng()) - image)[..., 0]
    centre, variance = moments(ghost)
    np.testing.assert_allclose(centre, [SIZE[0] - 1 - 10, SIZE[1] - 1 - 45], atol=1e-6)
    assert ghost.sum() == pytest.approx(0.02 * image[..., 0].sum(), rel=1e-9)
    np.testing.assert_allclose(variance, 1.5**2 + 9.0**2 / 16, rtol=0.05)  # of a disc: d^2 / 16 along each axis


@pytest.mark.parametrize("blur_px", [0.0, 3.3, 12.0])
def test_turn_and_blur_of_a_ghost_make_no_images_rms_larger(blur_px):
    image = rng(2).standard_normal((*SIZE, 1))
    ghost = GhostReflection(0.5, blur_px).apply(image, RIG, rng()) - image
    assert np.sqrt(np.square(ghost).mean()) <= 0.5 * np.sqrt(np.square(image).mean()) * (1 + 1e-12)


def test_places_of_one_lens_are_kept_apart_from_those_of_another_camera_size_or_lens():
    other = CAMERA * np.array([[1.1], [1.0], [1.0]])
    asked = [(LensDistortion(0.1), SIZE, CAMERA), (LensDistortion(0.2), SIZE, CAMERA)]
    asked += [(LensDistortion(0.1), SIZE, other), (LensDistortion(0.1), (SIZE[0] + 2, SIZE[1]), CAMERA)]
    found = [lens.sources_px(size, camera) for lens, size, camera in asked]
    assert len({places.tobytes() for places in found}) == len(asked)
    assert LensDistortion(0.1).sources_px(SIZE, CAMERA) is found[0]
    with pytest.raises(ValueError, match="read-only"):
        found[0][:] = 0
