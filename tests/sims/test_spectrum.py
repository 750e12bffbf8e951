import numpy as np

from gs2ci_sims.spectrum import SECTORS, moving_spectrum

SIDE_PX = 64
PIXELS = SIDE_PX**2


def _cosine(samples, across, down):
    """A view of a cosine of these frequencies, cycles per pixel, at the samples' centres."""
    place = (np.arange(SIDE_PX * samples) + 0.5) / samples
    wave = np.cos(2 * np.pi * (across * place + down * place[:, None]))
    return np.repeat(wave[None, ..., None], 3, axis=3).astype(np.float32)


def _all_of(spectrum):
    return spectrum.missed(np.array([0.0, 10.0]), np.ones((2, SECTORS)))


def test_what_two_samples_show_at_a_coarser_frequency_is_found_at_its_own():
    spectrum = moving_spectrum(_cosine(4, 1.25, 0.0), 4, 2, 0.0, PIXELS)
    found = spectrum.frequency[spectrum.power.sum(axis=1).argmax()]
    assert abs(found - 1.25) < 0.03
    aliased = moving_spectrum(_cosine(2, 1.25, 0.0), 2, 2, 0.0, PIXELS)
    assert abs(aliased.frequency[aliased.power.sum(axis=1).argmax()] - 0.75) < 0.03


def test_power_is_that_of_the_pixels_as_drawn_with_fewer_samples():
    for across in (0.3, 0.6, 1.25):
        drawn = _cosine(2, across, 0.0)[0, :, :, 0].reshape(SIDE_PX, 2, SIDE_PX, 2).mean(axis=(1, 3))
        rms, largest = _all_of(moving_spectrum(_cosine(4, across, 0.0), 4, 2, 0.0, PIXELS))
        np.testing.assert_allclose(rms, np.sqrt(np.square(drawn).mean()), rtol=0.04)
        assert largest == 1.0


def test_what_is_seen_beside_the_sensor_counts_in_full():
    drawn = _cosine(2, 0.3, 0.0)
    rms, _ = _all_of(moving_spectrum(drawn, 2, 2, 0.0, PIXELS))
    cropped_rms, _ = _all_of(moving_spectrum(drawn, 2, 2, 0.0, PIXELS // 4))
    np.testing.assert_allclose(cropped_rms, 2 * rms)


def test_a_wider_filter_takes_what_its_transfer_function_says():
    plain, _ = _all_of(moving_spectrum(_cosine(4, 0.5, 0.0), 4, 2, 0.0, PIXELS))
    blurred, _ = _all_of(moving_spectrum(_cosine(4, 0.5, 0.0), 4, 2, 0.05, PIXELS))
    np.testing.assert_allclose(blurred / plain, np.exp(-2 * np.pi**2 * 0.05 * 0.5**2), rtol=0.01)


def test_directions_are_told_apart_but_not_up_from_down():
    for down, sector in ((0.0, 0), (0.1, 1), (-0.1, 1), (0.6, 3)):
        spectrum = moving_spectrum(_cosine(2, 0.2, down), 2, 2, 0.0, PIXELS)
        assert spectrum.power.sum(axis=0).argmax() == sector


def test_an_even_view_has_power_at_no_frequency_but_zero():
    spectrum = moving_spectrum(np.full((1, 96, 128, 3), 0.7, np.float32), 2, 2, 0.0, 48 * 64)
    np.testing.assert_allclose(spectrum.power.sum(), 0.49, rtol=1e-5)
    rms, _ = spectrum.missed(np.array([0.0, 0.01, 3.0]), np.array([[0.0], [1.0], [1.0]]).repeat(SECTORS, axis=1))
    assert rms < 1e-4


def test_shares_of_many_images_at_once_count_as_each_by_itself_and_as_interpolated_between():
    rng = np.random.default_rng(1)
    spectrum = moving_spectrum(rng.random((1, SIDE_PX, SIDE_PX, 3), np.float32), 2, 2, 0.0, PIXELS)
    frequency = np.array([0.0, 0.1, 0.4, 1.2])  # some of the spectrum lies beyond
    shares = rng.random((5, len(frequency), SECTORS))
    rms, largest = spectrum.missed(frequency, shares)
    for number, one in enumerate(shares):
        left = np.stack([np.interp(spectrum.frequency, frequency, sector) for sector in one.T], axis=1)
        assert rms[number] == spectrum.missed(frequency, one)[0]
        np.testing.assert_allclose(rms[number], np.sqrt((spectrum.power * left**2).sum()), rtol=1e-13)
        np.testing.assert_allclose(largest[number], left.max(), rtol=1e-13)
