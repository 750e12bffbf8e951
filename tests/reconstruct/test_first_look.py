"""The stages before the fit, on a small rendered scene whose lamp may flicker."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.findings import Code
from gs2ci.core.progress import Silent
from gs2ci.reconstruct import first_look
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.first_look import look, look_closer
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.measurement.brightness import BrightnessSettings
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.paper.proxies.routing import geometry_views, multiplicity
from gs2ci.reconstruct.settings import Settings
from tests.tables.cases import Case

FLICKER = np.array([0.75, 1.2, 0.9, 1.1, 0.8, 1.25], np.float32)


@pytest.fixture(scope="module")
def shot():
    return Case("boxes", scene="boxes", size=(64, 80), views=len(FLICKER)).shot(0)


def with_holdout(shot, light=None):
    """The shot with weights that do not know how its lamp flickered."""
    known = shot if light is None else replace(shot, weights=(shot.weights / light).astype(np.float32))
    return Holdout.of(known, 0.1, 0)


def look_at(holdout, listener=None, **settings):
    laps = []
    found = look(holdout, None, load_geometry_prior("tracks"), Settings(**settings), listener or Silent(), laps.append)
    return found, laps


def test_an_even_lamp_is_looked_at_once_and_nothing_is_corrected(shot):
    holdout = with_holdout(shot)
    found, laps = look_at(holdout)
    assert laps == ["decode", "geometry"]
    assert found.holdout is holdout
    assert found.brightness.factors is None
    assert found.notes == ()
    assert found.geometry.verdict == "full"
    np.testing.assert_array_equal(found.decoded, gap_tv(holdout.seen))


def test_a_lamp_that_flickers_is_found_out_and_said_aloud(shot):
    listener, holdout = Silent(), with_holdout(shot, FLICKER)
    found, laps = look_at(holdout, listener)
    relative = found.brightness.factors / FLICKER
    np.testing.assert_allclose(relative / relative.mean(), 1, atol=0.03)
    assert laps == ["decode", "geometry"] * (len(laps) // 2)
    assert len(laps) >= 4
    assert "0.7" in found.notes[0].sentence
    assert listener.sentences[-1] == found.notes[0].sentence
    truth = shot.truth.views
    blind = gap_tv(holdout.seen)
    assert np.sqrt(np.mean((found.decoded - truth) ** 2)) < 0.7 * np.sqrt(np.mean((blind - truth) ** 2))
    np.testing.assert_allclose(found.holdout.shot.weights, holdout.shot.weights * found.brightness.factors, rtol=1e-6)


def test_where_weights_tell_nothing_the_light_is_believed_and_the_views_stay_as_they_were_seen(shot):
    """Views that were lit unlike one another, under weights that are all alike."""
    lit = (shot.truth.views * FLICKER[:, None, None, None]).astype(np.float32)
    exposed = replace(shot, measurement=(shot.masks[..., None] * lit).sum(axis=0), weights=np.ones_like(FLICKER))
    found, _ = look_at(Holdout.of(exposed, 0.1, 0))
    assert found.brightness.as_seen
    assert found.notes[0].code is Code.LIGHT_AS_SEEN
    assert found.brightness.of_weights is None
    shown = found.brightness.shown(found.decoded)
    errors = [np.sqrt(np.mean((views - lit) ** 2)) for views in (shown, found.decoded)]
    assert errors[0] < 0.75 * errors[1]
    even, _ = look_at(Holdout.of(exposed, 0.1, 0), brightness=BrightnessSettings(light="even"))
    np.testing.assert_array_equal(even.brightness.shown(even.decoded), found.decoded)
    assert even.notes[0].code is Code.WEIGHTS_CORRECTED
    np.testing.assert_array_equal(even.brightness.of_weights, found.brightness.factors)


def test_no_rounds_take_the_weights_as_they_are(shot):
    holdout = with_holdout(shot, FLICKER)
    found, laps = look_at(holdout, brightness=BrightnessSettings(rounds=0))
    assert laps == ["decode", "geometry"]
    assert found.holdout is holdout
    assert found.brightness.factors is None


def test_rounds_end_at_their_number(shot):
    _, laps = look_at(with_holdout(shot, FLICKER), brightness=BrightnessSettings(rounds=1))
    assert laps == ["decode", "geometry"] * 2


def test_a_view_of_weight_zero_keeps_it(shot):
    weights = shot.weights.copy()
    weights[0] = 0
    dark = replace(shot, weights=weights)
    found, _ = look_at(with_holdout(dark, FLICKER))
    assert found.holdout.shot.weights[0] == 0
    factors = found.brightness.factors
    assert factors is None or factors[0] == 1


def test_proxies_of_the_paper_stand_in_for_the_decoded_views(shot):
    holdout = with_holdout(shot)
    views, notes = geometry_views(holdout.seen, "eni", shot)
    assert not np.array_equal(views, gap_tv(holdout.seen))
    assert [note.code for note in notes] == [Code.PROXIES_CHOSEN]


def test_proxies_are_routed_on_the_masks_as_they_are_and_not_on_what_is_seen(make_random_masks):
    """Masks of exactly four open views in a pixel; with a tenth of the pixels closed there are 3.6."""
    shot = make_random_masks
    holdout = Holdout.of(shot, 0.1, 0)
    assert multiplicity(holdout.seen) < 3.7
    found = look(holdout, None, load_geometry_prior("tracks"), Settings(proxy="routed"), Silent(), lambda _: None, shot)
    assert found.notes[0].code is Code.PROXIES_CHOSEN
    assert "AMDI" in found.notes[0].sentence
    assert "4 views" in found.notes[0].sentence


@pytest.fixture
def make_random_masks():
    case = Case("boxes", scene="boxes", size=(48, 64), views=8)
    shot = case.shot(0)
    order = np.random.default_rng(0).random(shot.masks.shape).argsort(axis=0)
    masks = (order < 4).astype(np.float32)
    truth = shot.truth.views
    weights = np.ones(8, np.float32)
    return replace(shot, masks=masks, weights=weights, measurement=(masks[..., None] * truth).sum(axis=0)).check()


@pytest.mark.parametrize(
    ("verdicts", "looks"),
    [(("full",), 1), (("static",), 1), (("rotation_only", "full"), 2), (("rotation_only", "static"), 2)],
)
def test_where_only_a_turn_is_seen_similar_patches_are_asked_once(shot, monkeypatch, verdicts, looks):
    holdout, said, asked = with_holdout(shot), iter(verdicts), []
    whole, _ = look_at(holdout, brightness=BrightnessSettings(rounds=0))

    def looked(holdout, lens, prior, settings, progress, lap, masks_of):
        asked.append(settings.first_look)
        geometry = replace(whole.geometry, verdict=next(said))
        return replace(whole, geometry=geometry, decoder=settings.first_look)

    monkeypatch.setattr(first_look, "look", looked)
    listener = Silent()
    found = look_closer(holdout, None, load_geometry_prior("tracks"), Settings(), listener, [].append)
    assert asked == ["gap-tv", "patches-quick"][:looks]
    assert found.decoder == ("patches-quick" if verdicts == ("rotation_only", "full") else "gap-tv")
    assert any("similar patches" in sentence for sentence in listener.sentences) == (looks == 2)


def test_no_closer_look_is_taken_where_patches_or_proxies_were_asked_for(shot, monkeypatch):
    holdout = with_holdout(shot)
    whole, _ = look_at(holdout, brightness=BrightnessSettings(rounds=0))
    rest = replace(whole, geometry=replace(whole.geometry, verdict="rotation_only"))
    monkeypatch.setattr(first_look, "look", lambda *given: rest)
    for settings in (Settings(first_look="patches"), Settings(proxy="eni")):
        assert look_closer(holdout, None, load_geometry_prior("tracks"), settings, Silent(), [].append) is rest


def test_the_first_look_may_decode_by_patches(shot):
    holdout = with_holdout(shot)
    by_tv, _ = look_at(holdout, brightness=BrightnessSettings(rounds=0))
    by_patches, _ = look_at(holdout, first_look="patches-quick", brightness=BrightnessSettings(rounds=0))
    assert (by_tv.decoder, by_patches.decoder) == ("gap-tv", "patches-quick")
    assert (by_tv.sigma, by_patches.sigma) == (None, PatchSettings.quick().last_sigma)
    errors = [np.sqrt(np.mean((found.decoded - shot.truth.views) ** 2)) for found in (by_patches, by_tv)]
    assert errors[0] < errors[1]
