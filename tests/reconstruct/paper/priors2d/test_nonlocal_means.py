from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.paper.priors2d.nonlocal_means import NonLocalMeansPrior, grain


def test_the_grain_of_noise_is_its_standard_deviation_on_any_slope():
    rng = np.random.default_rng(0)
    slope = np.linspace(0, 1, 96, dtype=np.float32)[None, :, None] * np.ones((64, 1, 3), np.float32)
    noise = rng.normal(0, 0.05, slope.shape).astype(np.float32)
    assert grain(slope) < 1e-6
    assert grain(slope + noise) == pytest.approx(0.05, rel=0.05)


def test_noise_on_a_pseudo_view_is_lowered(plane):
    question = plane()
    clean = question.pseudo.images
    noisy = (clean + np.random.default_rng(1).normal(0, 0.08, clean.shape)).astype(np.float32)
    cleaned = NonLocalMeansPrior()(replace(question, pseudo=replace(question.pseudo, images=noisy)))
    assert np.square(cleaned - clean).mean() < 0.6 * np.square(noisy - clean).mean()


def test_an_image_without_any_grain_comes_back(plane):
    question = plane()
    flat = replace(question, pseudo=replace(question.pseudo, images=np.full((1, 20, 32, 3), 0.5, np.float32)))
    np.testing.assert_array_equal(NonLocalMeansPrior()(flat), flat.pseudo.images)
