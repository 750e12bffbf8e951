"""Tests of pictures in blocks: their numbers, and the covariance of scores that are summed over them."""

import numpy as np

from gs2ci.reconstruct.measurement.blocks import block_numbers, scores_over_blocks


def test_pixels_of_a_block_share_a_number_and_numbers_have_no_gaps():
    row, column = (index.ravel() for index in np.indices((5, 7)))
    numbers = block_numbers(row, column, 3).reshape(5, 7)
    assert numbers[0, 0] == numbers[2, 2] == 0
    assert np.array_equal(np.unique(numbers), np.arange(6))
    assert numbers[2, 3] != numbers[3, 3]
    assert np.array_equal(block_numbers(np.array([0, 9]), np.array([9, 0]), 3), [0, 1])


def test_no_pixels_belong_to_no_block():
    nowhere = np.zeros(0, np.intp)
    assert block_numbers(nowhere, nowhere, 16).size == 0
    assert np.array_equal(scores_over_blocks(np.zeros((2, 0)), nowhere), np.zeros((2, 2)))


def test_scores_that_are_alike_within_a_block_count_once():
    block = np.repeat(np.arange(400), 25)
    of_block = np.random.default_rng(0).standard_normal(400)
    variance = scores_over_blocks(of_block[block][None], block)[0, 0]
    assert np.isclose(variance, 400 * 25**2, rtol=0.3)
