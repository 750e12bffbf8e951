"""The whole reconstruction of measurements of each kind: masks, colours, dead rows, uneven light, motion in a mask."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.findings import Code
from gs2ci.core.progress import Silent
from gs2ci.core.records import Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct import observe
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMomentSettings
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.registration.register import Registered
from tests.reconstruct.pipeline.boards import HEIGHT, QUICK, SHORT, VIEWS, WIDTH, expose, wall_with_a_board

pytestmark = pytest.mark.slow


def test_dead_rows_are_left_out_and_cost_little(shot, found_soon):
    measurement = shot.measurement.copy()
    measurement[8:40:4] = 0
    result = reconstruct(replace(shot, measurement=measurement), SHORT).result
    unpolished = reconstruct(replace(shot, measurement=measurement), replace(SHORT, polish=None)).result
    assert any("8 of 48 rows read one value throughout" in note.sentence for note in result.notes)
    whole, damaged, before = (
        np.mean(psnr_per_view(r.views, shot.truth.views)) for r in (found_soon.result, result, unpolished)
    )
    # Patches gain most where all rows are there.
    assert damaged > whole - 5
    assert damaged > before - 0.2


def test_grey_masks_and_unequal_weights_are_part_of_the_model():
    views = wall_with_a_board()
    rng = np.random.default_rng(6)
    masks = np.clip((rng.random(views.shape[:3]) < 0.35) * rng.uniform(0.5, 1, views.shape[:3]), 0, 1).astype("f4")
    weights = rng.uniform(0.7, 1, VIEWS).astype(np.float32)
    coded = (weights[:, None, None, None] * masks[..., None] * views).sum(axis=0)
    result = reconstruct(expose(views, masks, weights=weights, measurement=coded), QUICK).result
    assert result.heldout_rms[result.verdict] < 0.8 * result.heldout_rms["decode"]
    assert np.mean(psnr_per_view(result.views, views)) > np.mean(psnr_per_view(result.decode, views)) + 3


def test_a_mono_measurement_gives_mono_views_better_than_their_decode():
    views = wall_with_a_board(channels=1)
    result = reconstruct(expose(views), QUICK).result
    assert result.views.shape == (VIEWS, HEIGHT, WIDTH, 1)
    assert np.mean(psnr_per_view(result.views, views)) > np.mean(psnr_per_view(result.decode, views)) + 3


def test_a_mosaic_gives_colour_views_better_than_their_decode():
    views = wall_with_a_board()
    shot = expose(views)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    channel = rows % 2 + columns % 2  # RGGB: red where both are even, blue where both are odd
    mosaic = np.take_along_axis(shot.measurement, channel[..., None], axis=2)
    result = reconstruct(replace(shot, measurement=mosaic, cfa="RGGB").check(), QUICK).result
    assert result.views.shape == (VIEWS, HEIGHT, WIDTH, 3)
    assert np.mean(psnr_per_view(result.views, views)) > np.mean(psnr_per_view(result.decode, views))


def test_a_lamp_that_flickers_is_told_of_once_and_in_the_predicted_measurement(shot):
    told = replace(shot, weights=np.array([1.3, 0.8, 1.2, 0.7, 1.3, 0.9], np.float32))
    hold_out = HoldOut(share=0.1, look_every=20)
    result = reconstruct(told, replace(SHORT, fits=1, fit=replace(SHORT.fit, hold_out=hold_out))).result
    lit = told.weights * np.array(result.brightness)
    np.testing.assert_allclose(lit / lit.mean(), 1, atol=0.1)
    assert len([note for note in result.notes if note.code is Code.WEIGHTS_CORRECTED]) == 1
    exact = np.einsum("n,nhw,nhwc->hwc", lit, told.masks, result.views)
    np.testing.assert_allclose(result.predicted_measurement, exact, atol=1e-4)


def test_masks_of_a_camera_that_goes_on_have_moments_and_the_views_show_the_middle_of_each(shot):
    hold_out = HoldOut(share=0.1, look_every=20)
    settings = replace(SHORT, fits=1, fit=replace(SHORT.fit, hold_out=hold_out))
    listener = Silent()
    moving = replace(settings, mask_moments=MaskMomentSettings("moving", tolerance=1e-4, most=2))
    result = reconstruct(shot, moving, listener).result
    assert result.mask_moments.moments == [2] * VIEWS
    assert next(note.sentence for note in result.notes if note.code is Code.MASKS_HAVE_MOMENTS) in listener.sentences
    exact = np.einsum("nhw,nhwc->hwc", shot.masks, result.exposed_views)
    np.testing.assert_allclose(result.predicted_measurement, exact, atol=1e-4)
    # The middle of a mask is sharper than the mean over it.
    sharp, meant = (np.abs(np.diff(views, axis=2)).mean() for views in (result.views, result.exposed_views))
    assert sharp > meant
    assert (result.scene_views != result.exposed_views).any()
    settled = reconstruct(shot, replace(settings, mask_moments=MaskMomentSettings("still", tolerance=1e-4))).result
    assert settled.mask_moments is None
    assert settled.exposed_views is None


def test_views_of_uneven_light_stay_as_they_were_seen_where_weights_tell_nothing(shot):
    light = np.array([1.3, 0.8, 1.2, 0.7, 1.3, 0.7], np.float32)
    lit = (shot.truth.views * light[:, None, None, None]).astype(np.float32)
    exposed = replace(expose(lit), truth=Truth(views=lit))
    hold_out = HoldOut(share=0.1, look_every=20)
    settings = replace(SHORT, fits=1, fit=replace(SHORT.fit, hold_out=hold_out))
    result = reconstruct(exposed, settings, score=lambda views: float(np.mean(psnr_per_view(views, lit)))).result
    assert result.brightness is None
    assert result.light.views == "as-seen"
    used = np.array(result.light.used)
    np.testing.assert_allclose(used / used.mean(), light / light.mean(), atol=0.1)
    for views in (result.views, result.scene_views, result.decode):
        seen = views.mean(axis=(1, 2, 3))
        np.testing.assert_allclose(seen / lit.mean(axis=(1, 2, 3)), 1, atol=0.15)
    exact = np.einsum("nhw,nhwc->hwc", exposed.masks, result.views)
    np.testing.assert_allclose(result.predicted_measurement, exact, atol=1e-4)
    assert result.curve[-1].psnr_db > np.mean(psnr_per_view(result.decode, lit)) - 1


def test_readings_that_registration_averaged_judge_no_views(shot, monkeypatch):
    averaged = np.zeros(shot.size, bool)
    averaged[:, :8] = True
    judging = []

    def stopped(holdout, *_):
        judging.append(holdout.pixels)
        raise InterruptedError

    monkeypatch.setattr(observe, "register", lambda given, *_: Registered(given, averaged=averaged))
    monkeypatch.setattr(observe, "look", stopped)
    monkeypatch.setattr(observe, "look_closer", stopped)
    with pytest.raises(InterruptedError):
        reconstruct(shot, replace(SHORT, fit=replace(SHORT.fit, hold_out=HoldOut(share=0.2))))
    assert judging[0].any()
    assert not judging[0][averaged].any()
