"""Views far apart: when their features are matched again, and the first look that follows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.first_look import look
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.path.halves import PathErrors
from gs2ci.reconstruct.geometry.sources.direct import at_rest
from gs2ci.reconstruct.hypotheses import matches
from gs2ci.reconstruct.hypotheses.matches import joins_in_part, look_far_apart
from gs2ci.reconstruct.measurement.brightness import Brightness, BrightnessSettings
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from tests.tables.cases import Case

BRIEF = Settings(long_decode=PatchSettings(iterations=4), brightness=BrightnessSettings(rounds=0))


@pytest.fixture(scope="module")
def seen():
    """A measurement, and its first look, which finds its path."""
    shot = Case("boxes", scene="boxes", size=(64, 80), views=5).shot(0)
    holdout = Holdout.of(shot, 0.1, 0)
    return holdout, look(holdout, None, load_geometry_prior("tracks"), BRIEF, Silent(), [].append)


def answering(monkeypatch, geometry):
    asked = []

    def matched(request, tracks, *, tilted):
        asked.append((request, tracks, tilted))
        return geometry

    monkeypatch.setattr(matches, "matched_motion", matched)
    return asked


def again(first, holdout, settings=BRIEF):
    laps, listener = [], Silent()
    return look_far_apart(first, holdout, None, settings, listener, laps.append), laps, listener.sentences


def test_features_are_matched_in_tilted_pictures_of_a_longer_decode(monkeypatch, seen):
    holdout, first = seen
    lost = replace(first, geometry=at_rest(first.geometry))
    matched = replace(first.geometry, source="wide", notes=(finding(Code.WIDE_MOTION, points=99),))
    asked = answering(monkeypatch, matched)
    found, laps, said = again(lost, holdout)
    ((request, tracks, tilted),) = asked
    assert tilted
    assert tracks is lost.geometry
    assert (found.decoder, found.geometry, found.holdout) == ("patches", matched, holdout)
    assert found.brief_rms == holdout.residual_rms(first.decoded)
    assert (first.brief_rms, first.with_decode_of(found).brief_rms) == (None, found.brief_rms)
    np.testing.assert_array_equal(request.views, found.decoded)
    assert not np.array_equal(found.decoded, first.decoded)
    assert found.brightness.first is not None
    assert laps == ["decode", "geometry"]
    assert matched.notes[0].sentence in said


@pytest.mark.parametrize("what", ["views do not join", "explains no more than rest", "no longer decode"])
def test_otherwise_the_first_look_stays(monkeypatch, seen, what):
    holdout, first = seen
    rest = at_rest(first.geometry)
    # Parts of the matches give other paths, and views warped along this one explain no more than at rest.
    doubtful = replace(rest, verdict="full", path_errors=PathErrors(0.11, 0.0))
    answers = {"views do not join": rest, "explains no more than rest": doubtful}
    asked = answering(monkeypatch, answers.get(what, first.geometry))
    settings = replace(BRIEF, long_decode=None) if what == "no longer decode" else BRIEF
    found, _, _ = again(first, holdout, settings)
    assert found is None
    assert len(asked) == (settings.long_decode is not None)


@pytest.mark.parametrize(
    "look",
    [
        {},
        {"decoder": "patches-quick", "sigma": PatchSettings.quick().last_sigma},
        {"decoder": "patches", "sigma": PatchSettings().last_sigma, "brief_rms": 9.0},
    ],
    ids=["by GAP-TV", "by patches, briefly", "by patches"],
)
def test_weights_that_were_corrected_along_a_wrong_path_are_forgotten(monkeypatch, seen, look):
    holdout, first = seen
    wrong = np.linspace(0.5, 1.5, 5).astype(np.float32)
    relit = Holdout(replace(holdout.shot, weights=holdout.shot.weights * wrong), holdout.pixels)
    answering(monkeypatch, first.geometry)
    lit = replace(first, holdout=relit, brightness=Brightness(None, wrong), **look)
    found, _, _ = again(lit, holdout)
    assert found.holdout is holdout
    assert found.brightness.factors is None
    untouched, _, _ = again(first, holdout)
    np.testing.assert_array_equal(found.decoded, untouched.decoded)
    assert (found.decoder, found.sigma, found.brief_rms) == ("patches", untouched.sigma, untouched.brief_rms)


def test_a_decode_by_patches_is_not_made_again(monkeypatch, seen):
    holdout, first = seen
    answering(monkeypatch, first.geometry)
    found, _, _ = again(replace(first, decoder="patches"), holdout)
    assert found.decoded is first.decoded


def test_a_look_is_of_views_far_apart_if_some_joined(seen):
    _, first = seen
    assert not joins_in_part(first)
    assert joins_in_part(replace(first, geometry=replace(first.geometry, joined=3)))


@pytest.mark.parametrize(("turned_deg", "taken"), [(20.0, True), (0.0, False)])
def test_a_path_that_turns_far_and_agrees_need_not_explain_more_than_rest(monkeypatch, seen, turned_deg, taken):
    holdout, first = seen
    poses = at_rest(first.geometry).world_to_camera.copy()
    poses[0, :3, :3] = Rotation.from_euler("y", turned_deg, degrees=True).as_matrix()
    agreed = replace(at_rest(first.geometry), world_to_camera=poses, verdict="full", path_errors=PathErrors(0.09, 0.0))
    answering(monkeypatch, agreed)
    found, _, _ = again(first, holdout)
    assert (found is not None) == taken


@pytest.mark.parametrize(
    ("moved", "turned_deg", "error", "taken"),
    [
        (0.5, 0.0, 0.02, True),
        (0.02, 0.0, 0.02, False),
        (0.002, 2.0, 0.0, False),
        (0.0, 4.0, 0.02, True),
    ],
)
def test_a_path_that_a_fit_has_already_is_not_fitted_again(monkeypatch, seen, moved, turned_deg, error, taken):
    holdout, first = seen
    answer = replace(first.geometry, source="wide", path_errors=PathErrors(error, 0.0))
    answering(monkeypatch, answer)
    path = answer.world_to_camera.copy()
    path[0, 1, 3] += moved * np.linalg.norm(np.ptp(path[:, :3, 3], axis=0))
    path[0, :3] = Rotation.from_euler("y", turned_deg, degrees=True).as_matrix() @ path[0, :3]
    found = look_far_apart(first, holdout, None, BRIEF, Silent(), [].append, path)
    assert (found is not None) == taken
