"""What is handed over errs no more than the decode and the scene, with the truth at hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.findings import Code
from gs2ci.core.records import Shot, Truth
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.decode.patches.within_time import patch_decode
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.combining.combination import Candidate
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.fusion import _decoded, _polished, hand_over, polish_seconds
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.noise import noise_of_readings
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.settings import Settings

SIZE, VIEWS = (48, 64), 5
SETTINGS = Settings()
UNPOLISHED = replace(SETTINGS, polish=None)


@pytest.fixture(autouse=True)
def unfollowed(monkeypatch):
    """Where scenes err over time: nowhere, unless a test says otherwise, as drawn errors of views do so too."""
    where = np.zeros(SIZE, np.float32)
    monkeypatch.setattr("gs2ci.reconstruct.fusion.followed_by_other_alone", lambda *_: where)
    return where


def picture(seed, sigma_px):
    grey = gaussian_filter(np.random.default_rng(seed).random((SIZE[0], SIZE[1] + 16)), sigma_px)
    return (grey - grey.min()) / np.ptp(grey)


def moving(seed=0, sigma_px=1.5):
    """A picture that moves by a pixel from view to view."""
    wide = picture(seed, sigma_px)
    return np.stack([wide[:, k : k + SIZE[1]] for k in range(VIEWS)]).astype(np.float32)[..., None]


def look_at(truth, noise=0.0, share=0.05):
    rng = np.random.default_rng(1)
    masks = (rng.random((VIEWS, *SIZE)) < 0.4).astype(np.float32)
    light = np.einsum("nhw,nhwc->hwc", masks, truth) + rng.normal(0, noise, (*SIZE, 1))
    holdout = Holdout.of(Shot(light.astype(np.float32), masks, truth=Truth(truth)).check(), share, 0)
    return FirstLook(holdout, gap_tv(holdout.seen), geometry=None, brightness=None)


def handed(first, mean, best=None, settings=SETTINGS, *, polish=False):
    ensemble = SimpleNamespace(views=mean, best=SimpleNamespace(views=mean if best is None else best))
    polishing = (PatchSettings(iterations=32, first_sigma=25 / 255),) if polish else ()
    refine = Refinement(first.holdout, settings.residual)
    return hand_over(first, ensemble, refine, settings, polishing)


def psnr(views, truth):
    return float(-10 * np.log10(np.mean((np.clip(views, 0, 1) - truth) ** 2)))


def astray(truth, by=0.05, sigma_px=2.0, seed=3):
    """Views of a fit that errs smoothly, each in its own way."""
    error = gaussian_filter(np.random.default_rng(seed).normal(0, 1, truth.shape), (0, sigma_px, sigma_px, 0))
    return (truth + np.float32(by) * (error / error.std())).astype(np.float32)


@pytest.mark.parametrize("noise", [0.0, 0.03, 0.3])
@pytest.mark.parametrize("sigma_px", [0.7, 6.0], ids=["textured", "smooth"])
@pytest.mark.parametrize("by", [0.01, 0.05, 0.3])
def test_it_is_never_clearly_under_the_better_of_decode_and_scene(noise, sigma_px, by):
    truth = moving(sigma_px=sigma_px)
    first = look_at(truth, noise)
    mean, best = astray(truth, by), astray(truth, 1.2 * by, seed=4)
    given = handed(first, mean, best)
    assert psnr(given.views, truth) > max(psnr(best, truth), psnr(gap_tv(first.holdout.shot), truth)) - 0.1


def test_a_scene_that_shows_something_else_leaves_the_decode_of_all_pixels():
    truth = moving(sigma_px=3.0)
    first = look_at(truth)
    given = handed(first, moving(seed=9))
    assert given.verdict == "decode"
    assert psnr(given.views, truth) > psnr(first.decoded, truth)
    assert Code.VIEWS_COMBINED not in [note.code for note in given.notes]


@pytest.mark.parametrize(("noise", "gained_db"), [(0.0, 0.5), (0.05, 0.3), (0.3, 0.3)])
def test_what_a_scene_that_fails_leaves_is_noise_only_as_far_as_a_decode_bears_it_out(noise, gained_db):
    """Without noise a decode that weighs it lacks detail; with much noise, one that weighs none shows it."""
    truth = moving()
    first = look_at(truth, noise)
    given = handed(first, moving(seed=9))
    assert psnr(given.views, truth) > psnr(gap_tv(first.holdout.shot), truth) + gained_db


@pytest.mark.parametrize("settings", [SETTINGS, UNPOLISHED], ids=["polished", "unpolished"])
def test_in_a_hurry_the_measurement_is_decoded_once_more_and_no_oftener(monkeypatch, settings):
    truth, decoded = moving(), []
    first = look_at(truth)

    def noted(shot, *how, **more):
        decoded.append(shot[0])
        return gap_tv(shot, *how, **more)

    monkeypatch.setattr("gs2ci.reconstruct.fusion.gap_tv", noted)
    given = handed(first, astray(truth, by=0.3), settings=Budget.beforehand(settings))
    assert [shot is first.holdout.shot for shot in decoded] == [True]
    assert psnr(given.views, truth) > psnr(gap_tv(first.holdout.shot), truth) - 0.3
    decoded.clear()
    handed(first, astray(truth, by=0.3), settings=settings)
    assert len(decoded) > 1


def test_the_time_of_polishing_is_foreseen_from_its_first_step(monkeypatch):
    moments_s = iter([5.0, 5.5])
    monkeypatch.setattr("gs2ci.reconstruct.fusion.time.monotonic", lambda: next(moments_s))
    first = look_at(moving())
    assert polish_seconds(first.holdout, first.decoded, PatchSettings.polish_sparsely()) == 0.5 * (12 + 4)


def by_patches(first):
    brief = PatchSettings(iterations=4, first_sigma=40 / 255, last_sigma=25 / 255)
    views = patch_decode(first.holdout.seen, brief)
    return replace(first, decoded=views, decoder="patches-quick", sigma=brief.last_sigma)


def test_a_brief_decode_by_patches_goes_on_as_the_settings_say_and_gains_by_it():
    truth = moving(sigma_px=1.0)
    first, mean = by_patches(look_at(truth, share=0.1)), astray(truth, 0.12)
    longer = handed(first, mean, settings=replace(SETTINGS, long_decode=PatchSettings(iterations=24)))
    briefer = handed(first, mean, settings=replace(SETTINGS, long_decode=None))
    assert psnr(longer.views, truth) > psnr(briefer.views, truth) + 0.2
    assert psnr(briefer.views, truth) > psnr(first.decoded, truth)


def test_a_brief_decode_that_has_no_share_as_it_is_is_not_gone_on_with(monkeypatch):
    truth = moving()
    first = by_patches(look_at(truth))
    monkeypatch.setattr("gs2ci.reconstruct.fusion._FAR_OFF", np.inf)
    monkeypatch.setattr("gs2ci.reconstruct.fusion._decoded", None)
    assert handed(first, truth).verdict == "refined"


def test_a_right_scene_is_handed_over_as_it_is_and_no_decode_is_made_again(monkeypatch):
    truth = moving()
    monkeypatch.setattr("gs2ci.reconstruct.fusion.gap_tv", None)
    given = handed(look_at(truth, 0.01), truth)
    assert given.verdict == "refined"
    assert psnr(given.views, truth) > 45


def test_fits_that_err_apart_from_the_best_are_combined_with_it_and_a_note_says_so():
    truth = moving()
    given = handed(look_at(truth, share=0.2), astray(truth, 0.08), astray(truth, 0.08, seed=4), UNPOLISHED)
    assert given.verdict == "refined"
    (note,) = [note for note in given.notes if note.code is Code.VIEWS_COMBINED]
    assert 0.2 < note.figures["scene"] < 0.8
    assert given.heldout_rms["refined"] < given.heldout_rms["scene"]


def test_noise_is_not_put_back():
    truth = moving(sigma_px=3.0)
    mean = astray(truth, 0.02)
    first = look_at(truth, noise=0.3, share=0.4)  # many pixels: in so much noise few could not tell
    refined = Refinement(first.holdout, SETTINGS.residual).by_all_pixels(mean)
    assert psnr(refined, truth) < psnr(mean, truth) - 3
    assert psnr(handed(first, mean).views, truth) > psnr(mean, truth) - 0.1


@pytest.mark.parametrize("sigma_px", [1.0, 3.0], ids=["textured", "smooth"])
@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_additions_to_the_scene_err_less_where_noise_is_weighed(noise, sigma_px):
    truth = moving(sigma_px=sigma_px)
    first, mean = look_at(truth, noise), astray(truth, 0.05)
    weighed, none = noise_of_readings(first.holdout, mean), np.zeros_like(first.holdout.shot.measurement)
    for made in (
        lambda known: _polished(first.holdout, mean, SETTINGS.polish, known).full,
        lambda known: Refinement(first.holdout, SETTINGS.residual, known).by_all_pixels(mean),
    ):
        assert psnr(made(weighed), truth) > psnr(made(none), truth) + 0.3


def test_noise_is_weighed_in_a_decode_where_held_out_pixels_bear_it_out():
    truth = moving(sigma_px=3.0)
    first = look_at(truth, 0.3, share=0.2)
    known, none = noise_of_readings(first.holdout, truth), np.zeros_like(first.holdout.shot.measurement)
    weighed, plain = (_decoded(first, SETTINGS, noise) for noise in (known, none))
    assert psnr(weighed.full, truth) > psnr(plain.full, truth) + 1
    assert first.holdout.residual_rms(weighed.blind) < first.holdout.residual_rms(plain.blind)
    far_too_much = _decoded(first, SETTINGS, 1000 * known)
    np.testing.assert_array_equal(far_too_much.blind, first.decoded)
    np.testing.assert_array_equal(far_too_much.full, gap_tv(first.holdout.shot, SETTINGS.decode))


def test_patches_go_on_from_refined_views_where_held_out_pixels_bear_it_out():
    truth = moving(sigma_px=1.0)
    first = look_at(truth, share=0.1)
    mean = astray(truth, 0.1, sigma_px=1.0)
    plain, polished = (handed(first, mean, settings=UNPOLISHED, polish=polish) for polish in (False, True))
    assert Code.VIEWS_POLISHED in [note.code for note in polished.notes]
    assert psnr(polished.views, truth) > psnr(plain.views, truth)


def test_the_sparse_polish_goes_on_from_what_the_dense_one_came_to(monkeypatch):
    truth = moving(sigma_px=1.0)
    first, mean, begun = look_at(truth, share=0.1), astray(truth, 0.12), []

    def polished(holdout, views, how, noise):
        begun.append(views)
        return Candidate(views, views)

    monkeypatch.setattr("gs2ci.reconstruct.fusion._polished", polished)
    for polish in (False, True):
        handed(first, mean, polish=polish)
    assert psnr(begun[1], truth) > psnr(begun[0], truth) + 0.2


def test_a_sparse_polish_has_a_share_by_what_it_gains_and_a_note_says_so():
    truth = moving(sigma_px=1.0)
    first = look_at(truth, share=0.1)
    mean = astray(truth, 0.1, sigma_px=1.0)
    plain, polished = (handed(first, mean, settings=settings) for settings in (UNPOLISHED, SETTINGS))
    (note,) = [note for note in polished.notes if note.code is Code.VIEWS_OF_PATCHES]
    assert 0.5 < note.figures["share"] <= 1
    assert psnr(polished.views, truth) > psnr(plain.views, truth) + 0.5
    assert Code.VIEWS_OF_PATCHES not in [note.code for note in plain.notes]


def test_nothing_is_polished_where_the_decode_is_all_that_would_be_handed_over(monkeypatch):
    monkeypatch.setattr("gs2ci.reconstruct.fusion._polished", None)
    assert handed(look_at(moving(sigma_px=3.0)), moving(seed=9)).verdict == "decode"


def test_where_the_scene_errs_over_time_and_the_decode_does_not_its_views_are_handed_over(unfollowed):
    truth = moving(sigma_px=1.0)
    first = look_at(truth, share=0.1)
    wrong = truth.copy()
    wrong[:, :, :20] = truth[:, :, :20].mean(axis=0)
    plain = handed(first, wrong)
    unfollowed[:, :20] = 1
    found = handed(first, wrong)
    (note,) = [note for note in found.notes if note.code is Code.SCENE_NOT_FOLLOWING]
    assert note.figures["share"] == pytest.approx(20 / SIZE[1])
    assert Code.SCENE_NOT_FOLLOWING not in [note.code for note in plain.notes]
    left, right = np.s_[:, :, :16], np.s_[:, :, 28:]
    assert psnr(found.views[left], truth[left]) > psnr(plain.views[left], truth[left]) + 0.5
    assert psnr(found.views[right], truth[right]) > psnr(first.decoded[right], truth[right]) + 5
    assert found.verdict == "refined"


@pytest.mark.parametrize("how", ["nothing held out", "no residual"])
def test_where_nothing_chooses_the_scene_stands(how):
    truth = moving()
    first = look_at(truth, share=0.0 if how == "nothing held out" else 0.05)
    settings = replace(SETTINGS, residual=None) if how == "no residual" else SETTINGS
    best = astray(truth, 0.1)
    given = handed(first, truth, best, settings)
    assert given.verdict == "scene"
    assert given.views is best
    assert (Code.UNJUDGED in [note.code for note in given.notes]) == (how == "nothing held out")


def test_views_that_err_so_that_it_is_seen_come_with_a_doubt_that_says_by_how_much():
    """Fits follow what they see: their views, in which a residual of 0.02 or of 0.15 of full scale was put back."""
    truth = moving(sigma_px=0.7)
    first = look_at(truth, share=0.2)
    decode = Refinement(first.holdout, SETTINGS.residual).decode

    def refine(views):
        return views + decode(first.holdout.coded(views))

    assert Code.VIEWS_ERR not in [note.code for note in handed(first, refine(astray(truth, 0.02))).notes]
    given = handed(first, refine(astray(truth, 0.15, sigma_px=1.0)))
    (note,) = [note for note in given.notes if note.code is Code.VIEWS_ERR]
    rms = float(np.sqrt(np.mean((given.views - truth) ** 2)))
    assert note.figures["share"] == pytest.approx(rms, rel=0.2)
