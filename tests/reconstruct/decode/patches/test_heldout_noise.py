"""The noise of the readings, from pixels that a decode by similar patches does not see, and what a decode gains."""

import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage import data

from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import decode_signed
from gs2ci.reconstruct.decode.patches import within_time
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.decode.patches.within_time import HeldoutNoise, decode_until, patch_decode
from gs2ci_sims.masks import random_masks

SIDE, VIEWS, OPEN = 40, 6, 0.5


def sliding(noise: float, views: int = VIEWS, seed: int = 0, blur_px: float = 0.0) -> Shot:
    """Code a photograph that slides by 1 px per view; the noise as a share of the mean number of open masks."""
    rng = np.random.default_rng(seed)
    photograph = gaussian_filter((data.camera()[::3, ::3] / 255).astype(np.float32), blur_px)
    truth = np.stack([photograph[20 : 20 + SIDE, 60 + i : 60 + i + SIDE, None] for i in range(views)])
    masks = random_masks(views, (SIDE, SIDE), OPEN, rng)
    coded = (masks[..., None] * truth).sum(axis=0) + noise * OPEN * views * rng.standard_normal((SIDE, SIDE, 1))
    return Shot(coded.astype(np.float32), masks, truth=Truth(views=truth)).check()


def mean_db(shot: Shot, views: np.ndarray) -> float:
    return float(np.mean(psnr_per_view(views, shot.truth.views)))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_noisy_shot_is_decoded_better_than_by_explaining_its_noise(seed: int) -> None:
    shot, settings = sliding(0.04, seed=seed), PatchSettings(iterations=48)
    blindly = patch_decode_from(shot, decode_signed(shot), settings)
    assert mean_db(shot, patch_decode(shot, settings)) > mean_db(shot, blindly) + 1


def test_a_decode_within_a_time_weighs_the_noise_too() -> None:
    shot, settings = sliding(0.04), PatchSettings(iterations=48)
    blindly = patch_decode_from(shot, decode_signed(shot), settings)
    hurried = decode_until(shot, time.monotonic() + 60, settings).views
    assert mean_db(shot, hurried) > mean_db(shot, blindly) + 1


@pytest.fixture
def unasked(monkeypatch: pytest.MonkeyPatch) -> Callable[[Shot, PatchSettings], np.ndarray]:
    """Decode without any hidden pixel."""

    def decode(shot: Shot, settings: PatchSettings) -> np.ndarray:
        with monkeypatch.context() as patched:
            patched.setattr(within_time, "HELDOUT_SHARE", 0.0)
            return patch_decode(shot, settings)

    return decode


def test_shots_without_noise_lose_next_to_nothing_by_being_asked(unasked) -> None:
    lost, settings = [], PatchSettings(iterations=48)
    for seed in range(3):
        shot = sliding(0.0, seed=seed)
        lost.append(mean_db(shot, unasked(shot, settings)) - mean_db(shot, patch_decode(shot, settings)))
    assert np.mean(lost) < 0.1


def test_views_that_err_little_gain_by_being_asked(unasked) -> None:
    gained, settings = [], PatchSettings(iterations=48)
    for seed in range(2):
        shot = sliding(0.0, seed=seed, blur_px=1.5)
        gained.append(mean_db(shot, patch_decode(shot, settings)) - mean_db(shot, unasked(shot, settings)))
    assert np.mean(gained) > 1


def after_steps(
    shot: Shot, rms: list[float], steps: int = 48, sigma: float = 1e-3
) -> tuple[HeldoutNoise, list[np.ndarray]]:
    """Show it views that err by so much at all pixels; also return the power after each step."""
    watch = HeldoutNoise(shot, PatchSettings(iterations=steps), 0)
    powers = []
    for i, error in enumerate(rms):
        views = shot.truth.views + np.float32(error)
        watch.after(np.ascontiguousarray(views.transpose(0, 3, 1, 2)), sigma, i + 1, steps - i - 1)
        powers.append(watch.power.copy())
    return watch, powers


def test_a_residual_that_decreases_shows_no_noise() -> None:
    _, powers = after_steps(sliding(0.0), np.geomspace(0.3, 0.01, 48).tolist())
    assert all(np.median(power) == 0 for power in powers)


def test_a_residual_that_rises_again_is_noise() -> None:
    _, powers = after_steps(sliding(0.0), [*np.geomspace(0.3, 0.05, 30), *np.geomspace(0.05, 0.06, 18)])
    assert np.median(powers[29]) == 0
    # The masks' sum, 3 in the mean and 10.5 in the mean square, times an error of 0.05 to 0.06.
    assert 10.5 * 0.05**2 * 0.8 < np.median(powers[-1]) < 10.5 * 0.06**2 * 1.2


def test_what_belongs_to_the_denoisers_level_is_no_noise_and_the_last_four_steps_count() -> None:
    shot, falls = sliding(0.0), np.geomspace(0.3, 0.03, 30).tolist()
    exact, level, shorter = (
        np.median(after_steps(shot, [*falls, *[0.05] * ones, *[0.06] * (18 - ones)], sigma=sigma)[1][-1])
        for ones, sigma in ((10, 1e-3), (10, 0.05), (14, 1e-3))
    )
    # An error of σ in each view, and half of six masks open.
    assert exact - level == pytest.approx(VIEWS * OPEN * 0.05**2, rel=0.2)
    assert shorter == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(("rise", "shows"), [(1.005, False), (1.015, True)])
def test_a_rise_of_the_residual_by_a_fiftieth_is_noise(rise: float, shows: bool) -> None:
    _, powers = after_steps(sliding(0.0), [*np.geomspace(0.3, 0.05, 30), *[0.05] * 4, *[0.05 * rise] * 14])
    assert bool(np.median(powers[-1]) > 0) is shows


def test_pixels_are_held_out_of_all_but_the_last_steps() -> None:
    _, powers = after_steps(sliding(0.0), [0.1] * 48)
    hidden = [int((power > 1e9).sum()) for power in powers]
    assert hidden[38] == round(0.02 * (powers[0] >= 0).sum() * sliding(0.0).lit.mean())
    assert hidden[39:] == [0] * 9
    _, powers = after_steps(sliding(0.0), [0.1] * 24, 24)
    assert [bool((power > 1e9).any()) for power in powers[17:]] == [True, True, *[False] * 5]


# The masks' sum in the mean square is 3.5 times its sum of squares: an error of all views adds up. Errors of 1.5 times
# the squared level belong to a level.
@pytest.mark.parametrize(("error", "level"), [(0.3, 0.02), (0.011, 0.011 * (3.5 / 1.5) ** 0.5), (0.001, 0.04 / 3)])
def test_a_decode_ends_at_the_level_of_its_views_errors_if_these_are_small(error: float, level: float) -> None:
    watch, _ = after_steps(sliding(0.0), [error] * 48)
    assert watch.last_sigma(0.02) == pytest.approx(level, rel=0.1)


@pytest.mark.parametrize(("views", "steps"), [(2, 48), (VIEWS, 23)])
def test_few_views_or_steps_are_not_watched(views: int, steps: int) -> None:
    watch, _ = after_steps(sliding(0.0, views), [0.001] * steps, steps)
    assert not watch.power.any()
    assert watch.last_sigma(0.02) == 0.02
    assert HeldoutNoise(sliding(0.0), PatchSettings(iterations=24), 0).power.any()
