"""Fits that go wrong or go on: roll-backs, steps that grow again, and errors."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.fit.coarse.stage import MAX_ROLLBACKS
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser
from gs2ci.reconstruct.fit.surfaces.depth_field import DepthField
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, SurfaceSettings
from tests.reconstruct.fit.plane_fits import QUICK, FaultyBackend, Listener, Watching, paused, run

pytestmark = pytest.mark.slow


def test_a_roll_back_makes_lists_anew(moving_plane):
    backend = Watching(1000, when_faulty=lambda call: call == 10)
    fit, _ = run(moving_plane, replace(QUICK, densify_every=1000), backend=backend)
    assert len(fit.notes) == 1
    assert [reuse.listings for reuse in backend.given] == [1, 1]


def test_one_bad_iteration_is_rolled_back_and_told(moving_plane):
    listener = Listener()
    fit, _ = run(moving_plane, backend=FaultyBackend(lambda call: call == 25), listener=listener)
    assert fit.notes == (finding(Code.ROLLED_BACK_NOT_FINITE, iteration=25, best=20),)
    assert listener.sentences == [note.sentence for note in fit.notes]
    assert fit.curve[-1].iteration == 60
    assert fit.curve[-1].loss < 0.6 * fit.curve[0].loss
    assert np.isfinite(fit.views).all()


@pytest.mark.parametrize(("name", "factor"), [("colours", 1e3), ("means", 1e5)])
def test_a_step_that_explodes_is_rolled_back_and_told(moving_plane, monkeypatch, name, factor):
    whole, calls = GaussianOptimiser.step, itertools.count()

    def step(optimiser, *arguments):
        whole(optimiser, *arguments)
        if next(calls) == 25:
            with torch.no_grad():
                optimiser.scene.parameters()[name].mul_(factor)

    monkeypatch.setattr(GaussianOptimiser, "step", step)
    fit, _ = run(moving_plane)
    (note,) = fit.notes
    assert note.code is Code.ROLLED_BACK_EXPLODED
    assert (note.figures["iteration"], note.figures["best"]) == (26, 20)
    assert fit.curve[-1].loss < 0.6 * fit.curve[0].loss
    fit.scene.check()


@pytest.mark.parametrize("spoilt", [40, 60])
def test_a_state_that_is_not_finite_at_a_look_is_not_looked_at(moving_plane, monkeypatch, spoilt):
    """The next iteration goes back from it; at the end of the schedule the best state is the result anyway."""
    whole, calls = GaussianOptimiser.step, itertools.count(1)

    def step(optimiser, *arguments):
        whole(optimiser, *arguments)
        if next(calls) == spoilt:
            with torch.no_grad():
                optimiser.scene.means[0] = torch.nan

    monkeypatch.setattr(GaussianOptimiser, "step", step)
    monkeypatch.setattr(DepthField, "step", lambda *_: None)
    # A search for surfaces, due after the first of these looks, does not begin in that state either.
    fit, _ = run(moving_plane, replace(QUICK, surfaces=SurfaceSettings(searches=(Search(0.66, 1e-3, 1e-3),))))
    rolled_back = [finding(Code.ROLLED_BACK_NOT_FINITE, iteration=40, best=30)] if spoilt == 40 else []
    assert list(fit.notes) == rolled_back
    assert [point.iteration for point in fit.curve] == [look for look in range(10, 70, 10) if look != spoilt]
    fit.scene.check()


def test_what_explodes_before_surfaces_are_found_is_none_to_go_back_to(moving_plane, monkeypatch):
    """With surfaces a fit begins again, with any loss and residual: earlier looks know that the scene is gone."""
    whole, calls = GaussianOptimiser.step, itertools.count(1)

    def step(optimiser, *arguments):
        whole(optimiser, *arguments)
        if next(calls) > 32:
            with torch.no_grad():
                optimiser.scene.means.mul_(1e3)

    monkeypatch.setattr(GaussianOptimiser, "step", step)
    surfaces = SurfaceSettings(searches=(Search(0.56, 1e-3, 1e-3),))
    fit, holdout = run(moving_plane, replace(QUICK, surfaces=surfaces))
    assert fit.stopped.figures["best"] == 30
    assert holdout.residual_rms(fit.views) == pytest.approx(fit.curve[2].heldout, rel=1e-6)


def test_a_paused_fit_that_is_not_finite_shows_its_best_state(moving_plane):
    fit, _ = paused(moving_plane)
    fit.advance(0.5)
    shown = fit.views()
    with torch.no_grad():
        fit._fit.scene.means[0] = torch.nan
    np.testing.assert_allclose(fit.views(), shown, atol=1e-6)
    fit.scene.check()


def test_a_roll_back_forgets_what_the_runaway_taught_regions(moving_plane, monkeypatch):
    forgot = []
    monkeypatch.setattr(DepthField, "forget", lambda one: forgot.append(type(one)))
    monkeypatch.setattr(DepthField, "step", lambda *_: None)
    monkeypatch.setattr(DepthField, "__init__", lambda *_: None)
    settings = replace(QUICK, surfaces=SurfaceSettings(searches=(Search(1.0, 1e-3, 1e-3),)))
    fit, _ = run(moving_plane, settings, backend=FaultyBackend(lambda call: call == 25))
    assert [note.code for note in fit.notes] == [Code.ROLLED_BACK_NOT_FINITE]
    # Once more at the end, when the best state is restored.
    assert forgot == [DepthField] * 2


def test_numbers_that_keep_running_away_end_the_fit_with_a_sentence_and_the_last_good_state(moving_plane):
    fit, holdout = run(moving_plane, backend=FaultyBackend(lambda call: call >= 25))
    assert fit.stopped == finding(Code.FIT_DIVERGED, times=MAX_ROLLBACKS, best=20)
    assert len(fit.notes) == MAX_ROLLBACKS
    assert holdout.residual_rms(fit.views) == pytest.approx(fit.curve[-1].heldout, rel=1e-6)
    fit.scene.check()


def test_a_first_iteration_that_is_not_finite_is_an_error(moving_plane):
    with pytest.raises(NumericsError, match="first iteration"):
        run(moving_plane, backend=FaultyBackend(lambda call: call == 0))
