from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import shift as moved
from skimage.data import astronaut

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.tradeoff import trials
from gs2ci.evaluate.tradeoff.trials import BASELINE, KNOBS, TRIALS, chosen_trials, expected_seconds, tried
from gs2ci.reconstruct import observe
from gs2ci.reconstruct.pipeline import Reconstruction
from gs2ci.reconstruct.presets.named import PRESETS
from gs2ci.reconstruct.registration.register import register
from tests.benchmarks import heldout_order


def quick(name):
    """The trial with one fit of three iterations, and without the stages that come when the fit is done."""
    trial = TRIALS[name]
    fit = replace(trial.settings.fit, iterations=3)
    left_out = {"fits": 1, "long_decode": None, "polish": None, "look_again": False, "motion": "off"}
    return replace(trial, settings=replace(trial.settings, fit=fit, **left_out))


@pytest.fixture
def shot(make_run):
    given, _ = make_run(count=3, size=(32, 48))
    coded = np.einsum("nhw,nhwc->hwc", given.masks * given.weights[:, None, None], given.truth.views)
    return replace(given, measurement=coded.astype(np.float32), saturated=None).check()


@pytest.fixture(scope="module")
def photograph():
    """Four views of a photograph that moves, coded by the masks as stated, with noise of 0.01."""
    rng, picture = np.random.default_rng(5), astronaut()[60:300:2, 140:400:2].astype(float) / 255
    views = np.stack([moved(picture, (0.3 * k, -0.7 * k, 0), order=1)[10:58, 10:74] for k in range(4)])
    masks = (rng.random((4, 48, 64)) < 0.33).astype(np.float32)
    coded = (masks[..., None] * views).sum(axis=0) + rng.normal(0, 0.01, views.shape[1:])
    truth = Truth(views.astype(np.float32))
    return Shot(coded.astype(np.float32), masks, np.ones(4, np.float32), truth=truth).check()


def test_the_ladder_goes_from_the_decode_to_the_paper_and_every_other_trial_changes_one_thing():
    assert [t.name for t in chosen_trials(("preset",))] == ["decode", *PRESETS]
    for trial in TRIALS.values():
        trial.settings.check()
        if trial.knob not in ("preset", "resolution"):
            assert trial.settings != PRESETS[BASELINE]


def test_the_baseline_is_tried_whatever_is_varied():
    for knob in KNOBS:
        assert BASELINE in [trial.name for trial in chosen_trials((knob,))]


def test_an_unknown_knob_is_refused_with_the_names():
    with pytest.raises(InputError, match="no knob 'luck'"):
        chosen_trials(("preset", "luck"))


def test_what_a_trial_will_take_follows_from_the_standard_by_fits_iterations_and_pixels():
    expected = {name: expected_seconds(trial, 10.0) for name, trial in TRIALS.items()}
    assert expected["decode"] == 0
    assert expected["draft"] < expected["standard"] == 10.0 < expected["paper"]
    assert expected["half the resolution"] == 2.5
    assert expected["4 fits"] == 4 * expected["1 fit"]
    assert all(expected[name] == 10.0 for name, one in TRIALS.items() if one.knob in ("windows", "precision"))


@pytest.mark.parametrize(
    ("knob", "part", "expected"),
    [
        ("fits", lambda s: s.fits, [1, 4]),
        ("list reuse", lambda s: s.raster.relist_every, [1, 8]),
        ("precision", lambda s: s.raster.termination_transmittance, [0.0, 0.01, 0.1]),
        ("windows", lambda s: s.geometry.tracks.window_px, [11, 31, 21, 21, 21, 21]),
        ("windows", lambda s: s.geometry.sweep.window_px, [7, 7, 5, 11, 7, 7]),
        ("windows", lambda s: s.fit.loss.window_px, [11, 11, 11, 11, 5, 21]),
    ],
)
def test_a_knob_turns_the_setting_that_it_names(knob, part, expected):
    assert [part(trial.settings) for trial in TRIALS.values() if trial.knob == knob] == expected


@pytest.mark.parametrize("name", ["lists for 8 iterations", "blending to 10% of the light", "sweep through 5 px"])
def test_a_turned_knob_still_gives_views(shot, name):
    row = tried(shot, quick(name), seed=1)
    assert 5 < row["psnr_db"] < 60
    assert row["iterations"] == 3


def test_the_benchmark_of_their_order_names_trials_that_exist():
    assert set(heldout_order.NAMES) <= set(TRIALS)


def test_a_row_tells_time_quality_and_what_was_found(shot):
    ticks = iter([10.0, 13.5])
    row = tried(shot, quick("standard"), seed=1, clock=lambda: next(ticks))
    assert row["seconds"] == 3.5
    assert row["trial"] == "standard"
    assert 5 < row["psnr_db"] < 60
    assert 5 < row["heldout_db"] < 60
    assert 0 < row["ssim"] < 1
    assert row["gaussians"] > 0
    assert row["iterations"] == 3


def test_the_decode_alone_and_half_the_resolution_are_judged_at_full_size(shot):
    decode, half = tried(shot, quick("decode"), seed=1), tried(shot, quick("half the resolution"), seed=1)
    assert decode["gaussians"] == 0
    assert None not in (decode["psnr_db"], half["psnr_db"], half["heldout_db"])


def test_without_a_truth_held_out_pixels_alone_judge(shot):
    blind = tried(replace(shot, truth=Truth()), quick("decode"), seed=1)
    assert blind["psnr_db"] is blind["ssim"] is blind["nate"] is None
    assert blind["heldout_db"] == tried(shot, quick("decode"), seed=1)["heldout_db"]


def test_no_trial_sees_the_pixels_that_judge_it(shot, monkeypatch):
    seen = []

    def spied(given, name, settings):
        seen.append(given)
        return np.zeros((*given.masks.shape, 3), np.float32)

    monkeypatch.setattr(trials, "decode_by_name", spied)
    row = tried(shot, TRIALS["decode"], seed=1)
    judges = (seen[0].masks != shot.masks).any(axis=0)
    assert 0.01 < judges.mean() < 0.03
    assert (seen[0].measurement[judges] == 0).all()
    # Views of nothing leave the whole measurement at these pixels unexplained, and nothing else counts.
    rms = np.sqrt(np.mean(shot.measurement[judges].astype(np.float64) ** 2))
    assert row["heldout_db"] == pytest.approx(-20 * np.log10(rms))


@pytest.mark.parametrize("name", ["standard", "half the resolution"])
def test_a_trial_holds_out_no_pixel_that_registration_averaged(photograph, monkeypatch, name):
    # The masks were six pixels further right than stated, and other elements lie in the rim.
    were = np.roll(photograph.masks, 6, axis=2)
    were[:, :, :6] = np.random.default_rng(6).random(were[:, :, :6].shape) < 0.33
    coded = np.einsum("nhw,nhwc->hwc", were, photograph.truth.views).astype(np.float32)
    beside, held_out = replace(photograph, measurement=coded), []

    class Spied(observe.Holdout):
        def __init__(self, shot, pixels):
            super().__init__(shot, pixels)
            held_out.append(pixels)

    monkeypatch.setattr(observe, "Holdout", Spied)
    tried(beside, quick(name), seed=1)
    rim = register(beside, seed=1).averaged
    # Half the resolution: six columns are three.
    assert rim.any()
    assert held_out[0].any()
    assert not held_out[0][:, : np.flatnonzero(rim.any(axis=0)).size // TRIALS[name].shrink].any()


@pytest.mark.parametrize("name", ["decode", "standard", "half the resolution"])
def test_views_are_judged_through_the_masks_that_registration_found(photograph, name):
    beside = replace(photograph, masks=np.roll(photograph.masks, (1, -1), axis=(1, 2)))
    right, found = tried(register(beside).shot, quick(name), seed=1), tried(beside, quick(name), seed=1)
    assert found["psnr_db"] == pytest.approx(right["psnr_db"], abs=0.1)
    assert found["heldout_db"] == pytest.approx(right["heldout_db"], abs=0.1)
    # The views of so short a fit move by 1 dB where masks differ by a thousandth.
    exact = tried(photograph, quick(name), seed=1)
    assert found["psnr_db"] > exact["psnr_db"] - 2


def test_settings_that_do_not_register_are_judged_by_the_masks_as_stated(photograph):
    beside = replace(photograph, masks=np.roll(photograph.masks, (1, -1), axis=(1, 2)))
    trial = quick("decode")
    off = replace(trial.settings.registration, mode="off")
    assert tried(beside, replace(trial, settings=replace(trial.settings, registration=off)), seed=1)["heldout_db"] < 6


def test_views_are_judged_with_the_weights_that_the_run_corrected(photograph):
    wrong = replace(photograph, weights=np.array([0.7, 1.3, 0.8, 1.2], np.float32))
    right = tried(photograph, quick("standard"), seed=1)["heldout_db"]
    assert tried(wrong, quick("standard"), seed=1)["heldout_db"] > right - 2


@pytest.mark.parametrize("name", ["standard", "half the resolution"])
def test_the_light_during_each_mask_is_judged_and_the_middle_of_it_shown(make_run, monkeypatch, name):
    shot, result = make_run(count=3, size=(32, 48))
    even = replace(shot.truth, views=np.full_like(shot.truth.views, 0.5))
    coded = np.einsum("nhw,nhwc->hwc", shot.masks, even.views).astype(np.float32)
    shot = replace(shot, measurement=coded, truth=even)
    factor = TRIALS[name].shrink
    exposed = even.views[:, ::factor, ::factor]
    given = replace(result, views=exposed + np.float32(0.1), exposed_views=exposed)
    asked = []

    def reconstructed(shot, _settings, registered):
        asked.append(registered.shot is shot)
        return Reconstruction(given, None)

    monkeypatch.setattr(trials, "reconstruct", reconstructed)
    row = tried(shot, TRIALS[name], seed=1)
    assert row["heldout_db"] > 90
    assert row["psnr_db"] == pytest.approx(20, abs=0.01)
    assert asked == [True]  # it is registered already


def test_the_time_of_a_trial_includes_its_registration(shot, monkeypatch):
    now = [0.0]

    def slow(given, settings, **others):
        now[0] += 5
        return register(given, settings, **others)

    monkeypatch.setattr(trials, "register", slow)
    assert tried(shot, quick("decode"), seed=1, clock=lambda: now[0])["seconds"] == 5
