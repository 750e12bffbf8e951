"""Lanes, elementary functions and transposes, one small kernel each."""

import numba
import numpy as np
import pytest

from gs2ci.render.simd import vector
from gs2ci.render.simd.elementary import exp2_blend, exp2_blend_4, exponential, logarithm
from gs2ci.render.simd.lanes import load_transposed, store_rows, transpose, weighted_sums_3, weighted_sums_6
from gs2ci.render.simd.vector import LANES

SIXTEEN = np.arange(LANES, dtype=np.float32)


def apply(function, values):
    """Run a function of one vector over an array whose length is a multiple of 16."""

    @numba.njit
    def loop(source, target):
        for i in range(0, source.size, LANES):
            vector.store(target, i, function(vector.load(source, i)))

    out = np.empty_like(values)
    loop(values, out)
    return out


def padded(values):
    values = np.asarray(values, np.float32)
    return np.concatenate([values, np.ones(-len(values) % LANES, np.float32)])


@pytest.mark.parametrize(
    ("function", "truth", "low", "high", "tolerance"),
    [
        (exponential, np.exp, -87, 87, 1e-5),  # float32 rounding of the argument: 87 * 6e-8
        (exponential, np.exp, -1, 1, 2.5e-7),
        (exp2_blend, np.exp2, -126, 0, 4e-7),
        (vector.square_root, np.sqrt, 0, 1e6, 6e-8),
    ],
)
def test_elementary_function_is_accurate_to_its_promise(function, truth, low, high, tolerance):
    x = np.linspace(low, high, 1 << 12, dtype=np.float32)
    exact = truth(x.astype(np.float64))
    assert (np.abs(apply(function, x) - exact) <= tolerance * np.abs(exact)).all()


def test_logarithm_is_accurate_near_one_and_far_from_it():
    x = np.concatenate([np.geomspace(1e-30, 1e30, 4000), np.linspace(0.5, 2, 1000)])
    x = padded(x)
    exact = np.log(x.astype(np.float64))
    error = np.abs(apply(logarithm, x) - exact)
    assert (error <= 2e-7 * np.maximum(np.abs(exact), 0.02)).all()
    assert apply(logarithm, np.ones(LANES, np.float32)).tolist() == [0] * LANES


def test_exponential_stays_positive_and_finite_beyond_its_range():
    y = apply(exponential, padded([-1e30, -200, 200, 1e30]))
    assert (y > 0).all()
    assert np.isfinite(y).all()


def test_blending_exponential_of_four_gives_the_same_bits_as_of_one():
    @numba.njit
    def of_four(a, out):
        for at in range(0, a.shape[0], 4 * LANES):
            four = exp2_blend_4(
                vector.load(a, at),
                vector.load(a, at + LANES),
                vector.load(a, at + 2 * LANES),
                vector.load(a, at + 3 * LANES),
            )
            for k in range(4):
                vector.store(out, at + k * LANES, four[k])

    x = np.linspace(-126, 0, 64 * LANES, dtype=np.float32)
    out = np.empty_like(x)
    of_four(x, out)
    np.testing.assert_array_equal(out, apply(exp2_blend, x))


def test_minimum_and_maximum_take_the_second_operand_for_nan():
    @numba.njit
    def loop(a, out):
        vector.store(out, 0, vector.minimum(vector.load(a, 0), np.float32(3)))
        vector.store(out, 16, vector.maximum(vector.load(a, 0), np.float32(3)))
        vector.store(out, 32, vector.where_ge(vector.load(a, 0), 2.0, -vector.load(a, 0), 7.0))

    a = SIXTEEN.copy()
    a[0] = np.nan
    out = np.empty(48, np.float32)
    loop(a, out)
    assert out[:5].tolist() == [3, 1, 2, 3, 3]
    assert out[16:21].tolist() == [3, 3, 3, 3, 4]
    assert out[32:36].tolist() == [7, 7, -2, -3]


def test_any_lane_suffices_and_memory_is_reached_lane_by_lane():
    @numba.njit
    def loop(a, whole):
        vector.store_as_int32(whole, 0, vector.floor(vector.load(a, 0)) + vector.ceil(vector.load(a, 0)))
        vector.prefetch(a, 3)
        vector.put(a, 5, vector.get(a, 4) * np.float32(2))
        return vector.any_ge(vector.load(a, 0), 15.4), vector.any_ge(vector.load(a, 0), 15.6)

    a, whole = SIXTEEN + np.float32(0.5), np.empty(LANES, np.int32)
    assert loop(a, whole) == (True, False)
    assert whole.tolist() == [2 * i + 1 for i in range(LANES)]
    assert a[5] == 9


def test_transposes_and_weighted_sums_agree_with_numpy():
    @numba.njit
    def loop(a, weights, out):
        store_rows(out, 0, transpose(transpose(load_transposed(a, 0))))
        for m, total in enumerate(weighted_sums_6(load_transposed(a, 0), weights, 0)):
            vector.store(out, 256 + 16 * m, total)
        for m, total in enumerate(weighted_sums_3(load_transposed(a, 0), weights, 96)):
            vector.store(out, 352 + 16 * m, total)

    rng = np.random.default_rng(0)
    a, weights = rng.normal(size=256).astype(np.float32), rng.normal(size=144).astype(np.float32)
    out = np.empty(400, np.float32)
    loop(a, weights, out)
    np.testing.assert_array_equal(out[:256].reshape(16, 16), a.reshape(16, 16).T)
    np.testing.assert_allclose(out[256:].reshape(9, 16), weights.reshape(9, 16) @ a.reshape(16, 16).T, atol=1e-5)


def test_lanes_are_added_up():
    @numba.njit
    def added(array):
        return vector.sum_of_lanes(vector.load(array, 0))

    assert added(SIXTEEN**2) == (SIXTEEN**2).sum()
    assert np.isnan(added(np.where(SIXTEEN == 3, np.float32(np.nan), SIXTEEN)))
