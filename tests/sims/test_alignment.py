"""Limits of weighted sums of fields: they hold for every alignment, and the worst one reaches them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gs2ci_sims.alignment import STEPS, TopMean, WeightSet

PIXELS = 400


def rms(field):
    return float(np.sqrt(np.square(field).mean()))


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(seed=st.integers(0, 10**6), masks=st.integers(1, 9), heavy=st.booleans(), aligned=st.booleans())
def test_no_alignment_of_fields_and_weights_exceeds_the_limit(seed, masks, heavy, aligned):
    rng = np.random.default_rng(seed)
    weights = np.abs(rng.standard_cauchy((masks, PIXELS)) if heavy else rng.random((masks, PIXELS)))
    fields = rng.standard_cauchy((masks, PIXELS)) if heavy else rng.standard_normal((masks, PIXELS))
    if aligned:
        # Each field is largest where its mask is most open, all with one sign.
        for weight, field in zip(weights, fields, strict=True):
            field[np.argsort(weight)] = np.sort(np.abs(field))
    each, peak = np.array([rms(field) for field in fields]), float(np.abs(fields).max())
    limit = WeightSet(weights).worst_rms(each, peak)
    assert rms((weights * fields).sum(axis=0)) <= limit * (1 + 1e-9)


def test_one_field_that_stands_on_the_largest_weights_reaches_the_limit():
    weights = np.linspace(0, 1, PIXELS)
    field = np.zeros(PIXELS)
    field[-20:] = 3.0
    top = TopMean(weights)
    assert top.worst_rms(rms(field), 3.0) == pytest.approx(rms(weights * field), rel=2e-3)
    assert top.worst_rms(rms(field), 3.0) >= rms(weights * field)


def test_the_same_field_behind_even_masks_reaches_the_limit_exactly():
    weights = WeightSet([np.full((10, 10), 0.5), np.full((10, 10), 0.25)])
    assert weights.worst_rms_of_one(2.0, 5.0) == pytest.approx(1.5)
    assert weights.largest_sum == pytest.approx(0.75)


def test_one_hot_masks_gain_from_being_open_in_turn():
    """Where one of n masks is open at each pixel, fields of rms 1 add up to n^(1/2) at most, not to n."""
    one_hot = np.eye(16).repeat(25, axis=1)
    assert WeightSet(one_hot).worst_rms(np.ones(16), 4.0) == pytest.approx(4.0)


@pytest.mark.parametrize(("field_rms", "peak"), [(0.0, 1.0), (1.0, 0.0), (1e-30, 1.0)])
def test_nothing_makes_nothing_and_next_to_nothing_next_to_nothing(field_rms, peak):
    assert 0 <= TopMean(np.ones((4, 4))).worst_rms(field_rms, peak) <= field_rms
    assert TopMean(np.zeros((4, 4))).worst_rms(field_rms, peak) == 0


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int64])
def test_shares_of_weights_are_those_of_their_steps_counted_one_by_one(kind):
    weights = (9 * np.random.default_rng(2).random((20, 30))).astype(kind)
    top = TopMean(weights)
    # The largest quarter of the pixels, each at the upper end of its step.
    step = float(weights.max()) / STEPS
    steps = np.sort(np.ceil(weights.ravel() / step - 1e-9))[::-1] * step
    assert top.worst_rms(0.5, 1.0) == pytest.approx(0.5 * float(np.sqrt(np.square(steps[:150]).mean())), rel=1e-6)
