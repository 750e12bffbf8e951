"""Repeats of a path: which exposures are, their common decode, and what held-out pixels leave of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core.findings import Code
from gs2ci.core.progress import Silent
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.exposures.joint import reconstruct_together
from gs2ci.reconstruct.exposures.observing import observe_all
from gs2ci.reconstruct.exposures.repeats import decode, decoded_together, groups, repeats
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.measurement.brightness import Brightness
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.mechanisms import mechanism
from gs2ci.reconstruct.observe import Tools
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.registration.register import RegistrationSettings
from tests.exposed_rooms import exposed, line, repeated, room

SIZE = (48, 64)
SETTINGS = replace(preset("draft"), registration=RegistrationSettings("off"), motion="off")
NOISE = 0.05
# At this size a move of so much displaces what lies in the middle, 3.5 away, by one px.
ONE_PX = 3.5 / 83


@pytest.fixture(scope="module")
def scene():
    return room(0, SIZE)


@pytest.fixture(scope="module")
def shots(scene):
    return repeated(scene, SIZE, 0, 4, noise=NOISE)


def looked(shot, seed=0, pixels=None):
    holdout = Holdout.of(shot, 0.02, seed) if pixels is None else Holdout(shot, pixels)
    return FirstLook(holdout, gap_tv(holdout.seen, SETTINGS.decode), None, Brightness())


@pytest.fixture(scope="module")
def looks(shots):
    return [looked(shot, seed) for seed, shot in enumerate(shots)]


def test_fresh_masks_of_the_same_path_are_told(looks):
    assert [repeats(looks[0], other) for other in looks[1:]] == [1.0, 1.0, 1.0]


def test_exposures_under_the_same_masks_hold_out_the_same_pixels(shots):
    """A repeat under the same masks would tell the reading of every held-out pixel, and a decode that fits it."""
    seeds = []

    def keeping(number, shot, settings, score):
        seeds.append(settings.seed)
        return lambda: None

    again = replace(shots[0], masks=shots[0].masks.copy())
    list(observe_all([shots[0], shots[1], again], SETTINGS, None, Silent(), [None] * 3, keeping))
    assert seeds[0] == seeds[2] != seeds[1]


@pytest.mark.parametrize(
    "path", [line(0.5 * ONE_PX), line(8.0 * ONE_PX), line(0.0, 0.5 * ONE_PX), line(0.0, length=0.2)]
)
def test_a_path_beside_it_or_of_another_length_is_none(scene, looks, path):
    beside = exposed(scene, path, SIZE, 7, noise=NOISE)
    assert repeats(looks[0], looked(beside)) is None
    assert repeats(looked(beside), looks[0]) is None


def test_more_light_and_more_noise_are_no_other_path(scene, looks):
    noisier = exposed(scene, line(0.0), SIZE, 8, noise=2 * NOISE)
    assert repeats(looks[0], looked(noisier)) == 1.0
    brighter = replace(noisier, measurement=1.3 * noisier.measurement)
    assert repeats(looks[0], looked(brighter)) == pytest.approx(1.3, rel=0.02)
    assert repeats(looked(brighter), looks[0]) == pytest.approx(1 / 1.3, rel=0.02)


def test_nothing_is_told_without_held_out_pixels_light_or_as_many_views(scene, shots, looks):
    unjudged = looked(shots[1], pixels=np.zeros(SIZE, bool))
    dark = looked(replace(shots[1], measurement=np.zeros_like(shots[1].measurement)))
    fewer = looked(exposed(scene, line(0.0, views=6), SIZE, 9, noise=NOISE))
    for other in (unjudged, dark, fewer):
        assert repeats(looks[0], other) is None


def test_a_common_decode_weighs_the_noise_that_held_out_pixels_show(shots, looks):
    found = decode(looks, SETTINGS)
    assert 0.25 * NOISE**2 < found.noise.mean() < 8 * NOISE**2
    own = [look.holdout.residual_rms(look.decoded) for look in looks]
    assert all(after < before for after, before in zip(found.heldout_rms, own, strict=True))
    truth = shots[0].truth.views
    assert np.mean(psnr_per_view(found.views, truth)) > np.mean(psnr_per_view(looks[0].decoded, truth)) + 3


@pytest.fixture(scope="module")
def observed(scene, shots):
    """Two repeats, a brighter one, one of a path beside, and one of which every other reading is wrong."""
    brighter = replace(shots[2], measurement=1.3 * shots[2].measurement, name="brighter")
    beside = exposed(scene, line(0.36), SIZE, 7, noise=NOISE, name="beside")
    every = [*shots[:2], brighter, beside]
    tools = Tools.load(SETTINGS)
    return list(observe_all(every, SETTINGS, tools, Silent(), [None] * len(every))), tools


@pytest.mark.slow
def test_repeats_get_one_decode_path_and_depth_and_others_stay_as_they_are(observed):
    before, tools = observed
    after, notes = decoded_together(before, SETTINGS, tools.geometry_prior, Silent())
    assert [one.repeats for one in after] == [0, 0, 0, None]
    assert after[3] is before[3]
    first, second, brighter = (one.observed.first for one in after[:3])
    assert second.decoded is first.decoded
    assert second.geometry is brighter.geometry is first.geometry
    assert [len(one.holdout.every_shot) for one in (first, second, brighter)] == [3, 3, 3]
    assert brighter.holdout.shot.weights.mean() == pytest.approx(1.3, rel=0.02)
    assert brighter.brightness.factors.mean() == pytest.approx(1.3, rel=0.02)
    assert [(note.code, note.figures["name"], note.figures["others"]) for note in notes] == [
        (Code.EXPOSURES_REPEAT, "repeat 0", "repeat 1, brighter")
    ]


@pytest.mark.parametrize(("other", "code"), [(0, Code.EXPOSURES_REPEAT_MASKS), (1, Code.EXPOSURES_REPEAT)])
def test_repeats_under_the_same_masks_are_said_to_tell_nothing_new(monkeypatch, other, code):
    named = "gs2ci.reconstruct.exposures.repeats"
    masks = np.eye(2), np.ones((2, 2))
    group = [
        SimpleNamespace(number=number, name=name, given=SimpleNamespace(masks=masks[which]))
        for number, (name, which) in enumerate([("a", 0), ("b", other)])
    ]
    monkeypatch.setattr(f"{named}.groups", lambda observed: [observed])
    monkeypatch.setattr(f"{named}._kept", lambda kept, settings: (kept, object()))
    monkeypatch.setattr(f"{named}._with_one_geometry", lambda kept, *_: kept)
    _, notes = decoded_together(group, SETTINGS, None, Silent())
    assert [(note.code, note.figures) for note in notes] == [(code, {"name": "a", "others": "b"})]


def test_they_can_be_left_out():
    without = mechanism("repeats decoded together").without(SETTINGS)
    alone = [object(), object()]
    assert decoded_together(alone, without, None, Silent()) == (alone, ())


@pytest.mark.slow
def test_one_that_its_own_decode_explains_better_is_left_to_itself(observed, monkeypatch):
    before, tools = observed
    # As if the third showed the same views, which it does not.
    monkeypatch.setattr("gs2ci.reconstruct.exposures.repeats.repeats", lambda first, other: 1.0)
    assert [len(group) for group in groups(before)] == [4]
    after, _ = decoded_together(before, SETTINGS, tools.geometry_prior, Silent())
    assert [one.repeats for one in after] == [0, 0, None, None]


@pytest.mark.slow
def test_repeats_of_which_one_is_brighter_and_one_lies_beside_are_better_than_the_first_alone(shots, scene):
    brighter = replace(shots[1], measurement=1.3 * shots[1].measurement, name="brighter")
    alone = reconstruct_together(shots[:1], SETTINGS)
    both = reconstruct_together([shots[0], brighter], SETTINGS)
    assert both.result.notes[0].code is Code.EXPOSURES_REPEAT
    truth = shots[0].truth.views
    before, after = (np.mean(psnr_per_view(found.parts[0].views, truth)) for found in (alone, both))
    assert after > before + 0.5
    # Its views are as bright as it was taken.
    assert np.mean(psnr_per_view(both.parts[1].views / 1.3, truth)) > before
    assert np.sqrt(np.mean((both.result.predicted_measurement - both.shot.measurement) ** 2)) < 0.2
