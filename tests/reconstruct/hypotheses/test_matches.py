"""Views far apart: when their features are matched again, and the first look that follows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.first_look import look
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.sources.direct import at_rest
from gs2ci.reconstruct.hypotheses import matches
from gs2ci.reconstruct.hypotheses.matches import look_far_apart
from gs2ci.reconstruct.measurement.brightness import BrightnessSettings
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from tests.tables.cases import Case

BRIEF = Settings(brightness=BrightnessSettings(rounds=0))


@pytest.fixture(scope="module")
def seen():
    """The first look at a measurement, which finds its path."""
    shot = Case("boxes", scene="boxes", size=(64, 80), views=5).shot(0)
    holdout = Holdout.of(shot, 0.1, 0)
    return look(holdout, None, load_geometry_prior("tracks"), BRIEF, Silent(), [].append)


def answering(monkeypatch, geometry):
    asked = []

    def matched(request, tracks, *, tilted):
        asked.append((request, tracks, tilted))
        return geometry

    monkeypatch.setattr(matches, "wide_motion", matched)
    return asked


def again(first):
    """Match features along a path that no fit has."""
    laps, listener, path = [], Silent(), np.tile(np.eye(4), (5, 1, 1))
    path[:, 2, 3] = range(5)
    return look_far_apart(first, None, BRIEF, listener, laps.append, path), laps, listener.sentences


def test_features_are_matched_in_tilted_pictures(monkeypatch, seen):
    lost = replace(seen, geometry=at_rest(seen.geometry))
    matched = replace(seen.geometry, source="wide", notes=(finding(Code.WIDE_MOTION, points=99),))
    asked = answering(monkeypatch, matched)
    found, laps, said = again(lost)
    ((request, tracks, tilted),) = asked
    assert tilted
    assert tracks is lost.geometry
    assert (found.geometry, found.holdout) == (matched, seen.holdout)
    np.testing.assert_array_equal(request.views, seen.decoded)
    assert found.brightness.first is not None
    assert laps == ["geometry"]
    assert matched.notes[0].sentence in said


@pytest.mark.parametrize("what", ["views do not join", "explains no more than rest"])
def test_otherwise_the_first_look_stays(monkeypatch, seen, what):
    rest = at_rest(seen.geometry)
    # Parts of the matches give other paths, and views warped along this one explain no more than at rest.
    doubtful = replace(rest, verdict="full", path_error_expected=0.11)
    asked = answering(monkeypatch, rest if what == "views do not join" else doubtful)
    found, _, _ = again(seen)
    assert found is None
    assert len(asked) == 1


@pytest.mark.parametrize(("turned_deg", "taken"), [(20.0, True), (0.0, False)])
def test_a_path_that_turns_far_and_agrees_need_not_explain_more_than_rest(monkeypatch, seen, turned_deg, taken):
    poses = at_rest(seen.geometry).world_to_camera.copy()
    poses[0, :3, :3] = Rotation.from_euler("y", turned_deg, degrees=True).as_matrix()
    agreed = replace(at_rest(seen.geometry), world_to_camera=poses, verdict="full", path_error_expected=0.09)
    answering(monkeypatch, agreed)
    found, _, _ = again(seen)
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
    answer = replace(seen.geometry, source="wide", path_error_expected=error)
    answering(monkeypatch, answer)
    path = answer.world_to_camera.copy()
    path[0, 1, 3] += moved * np.linalg.norm(np.ptp(path[:, :3, 3], axis=0))
    path[0, :3] = Rotation.from_euler("y", turned_deg, degrees=True).as_matrix() @ path[0, :3]
    found = look_far_apart(seen, None, BRIEF, Silent(), [].append, path)
    assert (found is not None) == taken
