import numba
import numpy as np
import pytest
from skimage import data

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.decode.denoisers import TotalVariation
from gs2ci.reconstruct.decode.kernels import denoise_coupled, denoise_planes


def coupled_reference(views, weight, coupling, inner):
    """Projected gradient on the dual of ½‖u − x‖² + λ TV(u) in rows, columns and views, float64."""
    scales = (coupling, 1.0, 1.0)
    dual = np.zeros((3, *views.shape))

    def primal():
        divergence = np.zeros_like(views)
        for axis, scale in enumerate(scales):
            shifted = np.roll(dual[axis], 1, axis)
            np.moveaxis(shifted, axis, 0)[0] = 0
            divergence += scale * (dual[axis] - shifted)
        return views + weight * divergence

    for _ in range(inner):
        image = primal()
        for axis, scale in enumerate(scales):
            difference = scale * np.diff(image, axis=axis, append=np.take(image, [-1], axis))
            dual[axis] += difference / ((8 + 4 * coupling**2) * weight)
        dual /= np.maximum(1, np.sqrt((dual**2).sum(0)))
    return primal()


@pytest.mark.parametrize("shape", [(4, 12, 15), (1, 7, 9), (3, 1, 8), (3, 8, 1), (2, 1, 1)])
@pytest.mark.parametrize("coupling", [0.3, 1.0])
def test_coupled_denoiser_agrees_with_its_reference(shape, coupling):
    views = np.random.default_rng(0).random(shape).astype(np.float32)
    expected = coupled_reference(views.astype(np.float64), 0.1, coupling, 7)
    denoise_coupled(views, 0.1, coupling, 7)
    np.testing.assert_allclose(views, expected, atol=3e-6)


def test_next_to_no_coupling_is_no_coupling():
    views = np.random.default_rng(0).random((3, 16, 18)).astype(np.float32)
    apart = views.copy()
    denoise_coupled(views, 0.2, 1e-9, 6)
    denoise_planes(apart, 0.2, 6)
    np.testing.assert_allclose(views, apart, atol=1e-6)


def test_coupled_denoiser_is_the_same_for_any_number_of_threads():
    results = []
    before = numba.get_num_threads()
    try:
        for threads in (1, 2):
            numba.set_num_threads(min(threads, before))
            views = np.random.default_rng(0).random((4, 20, 22)).astype(np.float32)
            denoise_coupled(views, 0.2, 0.5, 8)
            results.append(views)
    finally:
        numba.set_num_threads(before)
    assert np.array_equal(*results)


@pytest.mark.parametrize("denoise", [TotalVariation(), TotalVariation(coupling=0.5)])
@pytest.mark.parametrize("channels", [1, 3])
def test_noise_on_a_photograph_gets_less_at_every_level(denoise, channels):
    photograph = np.moveaxis(data.astronaut()[100:196, 160:260, :channels] / 255, -1, 0)
    for sigma in (25 / 255, 12 / 255):
        noise = np.random.default_rng(0).normal(0, sigma, (2, *photograph.shape))
        denoised = denoise((photograph + noise).astype(np.float32), sigma)
        assert denoised.shape == (2, channels, 96, 100)
        assert denoised.dtype == np.float32
        assert np.sqrt(np.mean((denoised - photograph) ** 2)) < 0.7 * sigma


def test_views_laid_out_in_another_order_are_denoised_too():
    views = np.random.default_rng(0).random((2, 16, 18, 3)).astype(np.float32).transpose(0, 3, 1, 2)
    expected = TotalVariation()(np.ascontiguousarray(views), 0.1)
    assert np.array_equal(TotalVariation()(views, 0.1), expected)


@pytest.mark.parametrize(
    "wrong", [{"weight_per_sigma": 0.0}, {"inner": 0}, {"coupling": -0.1}, {"coupling": np.nan}, {"coupling": np.inf}]
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        TotalVariation(**wrong)
