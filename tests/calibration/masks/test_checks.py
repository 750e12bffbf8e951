import numpy as np
import pytest

from gs2ci_calibration.masks.checks import correlations, require_held_out, require_order
from gs2ci_calibration.masks.imaging import PixelMap
from gs2ci_calibration.refusals import CalibrationError, Reason
from tests.calibration.masks.relays import gaussian_relay

SIZE = (40, 48)
RELAY = gaussian_relay(PixelMap(SIZE, np.array([[55.0, 50.0], [48.0, 0.0], [0.0, 48.0]])), 0.2)
PATTERNS = np.zeros((5, 100, 110), np.uint8)
PATTERNS[:, 10:90, 7:103] = (
    (np.random.default_rng(0).random((5, 40, 48)) < 0.4).repeat(2, axis=1).repeat(2, axis=2).astype(np.uint8)
)
SEEN = RELAY.shares(PATTERNS) + np.random.default_rng(1).normal(0, 0.02, (5, *SIZE))
VALID = np.ones(SIZE, bool)


def refusal(seen, patterns=PATTERNS, valid=VALID):
    with pytest.raises(CalibrationError) as caught:
        require_order(seen, RELAY, patterns, 1, valid, "masks")
    return caught.value


def test_masks_in_order_are_like_their_patterns():
    assert require_order(SEEN, RELAY, PATTERNS, 1, VALID, "masks").min() > 0.98


@pytest.mark.parametrize("order", [(1, 0, 2, 3, 4), (4, 0, 1, 2, 3), (4, 3, 2, 1, 0)])
def test_another_order_is_refused(order):
    found = refusal(SEEN[list(order)])
    assert found.reason is Reason.WRONG_ORDER
    first = next(i for i, j in enumerate(order) if i != j)
    assert f"instead of mask {first}, mask {order[first]} is shown" in str(found)


def test_negatives_are_refused():
    assert refusal(1 - SEEN).reason is Reason.WRONG_POLARITY


@pytest.mark.parametrize(
    ("turn", "name"),
    [
        (lambda m: m[:, :, ::-1], "mirrored left to right"),
        (lambda m: m[:, ::-1], "mirrored top to bottom"),
        (lambda m: m[:, ::-1, ::-1], "upside down"),
    ],
)
def test_masks_another_way_round_are_refused_by_name(turn, name):
    found = refusal(turn(SEEN))
    assert found.reason is Reason.FLIPPED
    assert name in str(found)


def test_shifted_masks_are_refused_with_the_shift():
    found = refusal(np.roll(SEEN, (-4, 5), (1, 2)))
    assert found.reason is Reason.DOES_NOT_FIT
    assert "5 px to the right and -4 px down" in str(found)


def test_masks_like_nothing_that_was_sent_are_refused():
    noise = np.random.default_rng(3).random(SEEN.shape)
    assert refusal(noise).reason is Reason.MISPREDICTED
    assert refusal(np.zeros(SEEN.shape)).reason is Reason.MISPREDICTED


def test_few_pixels_are_not_enough_to_tell_masks_apart():
    valid = np.zeros(SIZE, bool)
    valid[:4, :4] = True
    assert refusal(SEEN, valid=valid).reason is Reason.DEAD_PIXELS


def test_a_mask_without_texture_is_told_by_its_level():
    patterns = np.concatenate([PATTERNS[:2], np.ones((1, 100, 110), np.uint8)])
    seen = np.concatenate([SEEN[:2], np.ones((1, *SIZE))])
    assert require_order(seen, RELAY, patterns, 1, VALID, "masks")[2] == 1.0
    assert refusal(np.concatenate([SEEN[:2], np.zeros((1, *SIZE))]), patterns).reason is Reason.WRONG_ORDER


def test_two_equal_masks_are_in_order_either_way():
    patterns = PATTERNS[[0, 1, 1]]
    assert require_order(SEEN[[0, 1, 1]], RELAY, patterns, 1, VALID, "masks").min() > 0.9


def test_correlations_of_plain_images_are_0_and_not_nan():
    images = np.stack([np.ones(9), np.arange(9.0)])
    assert np.array_equal(np.round(correlations(images, images), 12), [[0, 0], [0, 1]])


def test_the_held_out_mask_has_to_be_like_its_prediction():
    foreseen = RELAY.shares(PATTERNS)[0]
    assert require_held_out(SEEN[0], foreseen, VALID, "masks") > 0.98
    with pytest.raises(CalibrationError) as caught:
        require_held_out(SEEN[1], foreseen, VALID, "masks")
    assert caught.value.reason is Reason.MISPREDICTED
