"""Surfaces within a fit: when they are sought, in what, and what is kept."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.coarse import exposure
from gs2ci.reconstruct.fit.optimiser.poses import PoseSettings
from gs2ci.reconstruct.fit.surfaces.depth_field import DepthFieldSettings
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, SurfaceSettings, find_surfaces
from gs2ci.reconstruct.measurement.coding import Coding
from tests.reconstruct.fit.plane_fits import QUICK, run

pytestmark = pytest.mark.slow


def test_surfaces_have_a_say_once_they_are_sought_and_the_measurement_has_the_last_word(moving_plane):
    plain, _ = run(moving_plane)
    drawn, _ = run(
        moving_plane, replace(QUICK, surfaces=SurfaceSettings((Search(0.5, 1e-2, 2e-4), Search(0.8, 1e-2, 2e-4))))
    )
    # Up to iteration 30 both are the same.
    assert [point.loss for point in drawn.curve[:3]] == [point.loss for point in plain.curve[:3]]
    assert drawn.curve[3].loss != plain.curve[3].loss
    assert drawn.curve[-1].heldout < 1.2 * plain.curve[-1].heldout


def test_regions_move_together_from_the_first_search_on(moving_plane):
    surfaces = SurfaceSettings((Search(0.5, 1e-2, 2e-4),))
    fits = [
        run(moving_plane, replace(QUICK, surfaces=replace(surfaces, depth_field=one)))[0]
        for one in (None, DepthFieldSettings())
    ]
    losses = [[point.loss for point in fit.curve] for fit in fits]
    assert losses[0][:3] == losses[1][:3]
    assert losses[0][3] != losses[1][3]
    assert fits[1].curve[-1].heldout < 1.2 * fits[0].curve[-1].heldout


def test_what_is_handed_over_has_been_through_the_surfaces_though_views_get_worse(moving_plane, monkeypatch):
    def wrong(*arguments):
        found = find_surfaces(*arguments)
        return replace(found, inverse_depth=3 * found.inverse_depth)

    monkeypatch.setattr(exposure, "find_surfaces", wrong)
    settings = SurfaceSettings((Search(0.5, 3.0, 3.0),), every=1)
    fit, holdout = run(moving_plane, replace(QUICK, surfaces=settings))
    before = [point.heldout for point in fit.curve if point.iteration <= 30]
    after = {point.iteration: point.heldout for point in fit.curve if point.iteration > 30}
    assert min(before) < min(after.values())
    assert holdout.residual_rms(fit.views) == pytest.approx(min(after.values()), rel=1e-6)
    assert fit.stopped.figures["best"] in after


def test_surfaces_are_sought_in_the_views_that_would_be_handed_over(moving_plane, monkeypatch):
    swept, predicted = [], []

    def watched(renderer, scene, poses, views, settings, seed, search):
        shown = renderer.exposed(scene, torch.from_numpy(poses).float())
        swept.append((search, views - shown, Coding.of(renderer.shot).forward(torch.from_numpy(shown)), predicted[-1]))
        return find_surfaces(renderer, scene, poses, views, settings, seed, search)

    monkeypatch.setattr(exposure, "find_surfaces", watched)
    searches = (Search(0.3, 1e-2, 2e-4), Search(0.6, 3e-2, 1e-3))
    shot = moving_plane[0]
    missing = np.full((*shot.masks.shape, shot.channels), 0.25, np.float32)

    def decode(coded):
        predicted.append(coded)
        return missing

    run(moving_plane, replace(QUICK, surfaces=SurfaceSettings(searches)), decode=decode)
    assert [search for search, *_ in swept] == list(searches)
    for _, added, coded, asked_of in swept:
        np.testing.assert_allclose(added, 0.25, atol=1e-5)
        np.testing.assert_allclose(asked_of, coded, atol=1e-4)


def test_a_search_that_finds_nothing_leaves_what_was_found_before(moving_plane, monkeypatch):
    given = SurfaceSettings((Search(0.3, 1e-2, 1e-2), Search(0.6, 3e-2, 1e-3)), margin=None)
    once = replace(given, searches=given.searches[:1])
    found, _ = run(moving_plane, replace(QUICK, surfaces=once))

    def first_only(*arguments):
        return find_surfaces(*arguments) if arguments[6] == given.searches[0] else None

    monkeypatch.setattr(exposure, "find_surfaces", first_only)
    kept, _ = run(moving_plane, replace(QUICK, surfaces=given))
    assert np.array_equal(kept.views, found.views)


def test_without_parallax_no_surface_is_sought(moving_plane):
    shot, geometry = moving_plane
    still = replace(geometry, verdict="rotation_only")
    settings = replace(QUICK, surfaces=SurfaceSettings())
    plain, _ = run((shot, still), QUICK)
    fit, _ = run((shot, still), settings)
    assert np.array_equal(fit.views, plain.views)


def test_turning_is_exchanged_for_travel_unless_the_path_was_given_or_poses_stay(moving_plane):
    shot, geometry = moving_plane
    surfaces = SurfaceSettings((Search(0.3, 1e-2, 1e-3),), margin=None)
    free = replace(QUICK, surfaces=surfaces)
    without = replace(free, surfaces=replace(surfaces, depth_field=DepthFieldSettings(exchange=None)))
    one, two = (run(moving_plane, settings)[0] for settings in (free, without))
    assert not np.array_equal(one.world_to_camera, two.world_to_camera)
    for told in ((shot, replace(geometry, source="stage")), (shot, replace(geometry, source="file"))):
        one, two = (run(told, settings)[0] for settings in (free, without))
        assert np.array_equal(one.world_to_camera, two.world_to_camera)
    fixed = PoseSettings(refine=False)
    one, two = (run(moving_plane, replace(settings, poses=fixed))[0] for settings in (free, without))
    assert np.array_equal(one.views, two.views)
