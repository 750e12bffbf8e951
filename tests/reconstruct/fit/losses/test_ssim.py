import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.losses.ssim import C2, WINDOW, SimilarityTo


def textured(size, channels=3, seed=0, level=1.0):
    return (level * np.random.default_rng(seed).random((*size, channels))).astype(np.float32)


def flat(value, size=(24, 31), channels=3):
    return np.full((*size, channels), value, np.float32)


PAIRS = {
    "unrelated textures": (textured((24, 31)), textured((24, 31), seed=1)),
    "bright textures": (textured((24, 31), level=4), textured((24, 31), seed=1, level=4)),
    "nearly equal": (textured((24, 31)), textured((24, 31)) + np.float32(0.01) * textured((24, 31), seed=1)),
    "one channel": (textured((24, 31), 1), textured((24, 31), 1, seed=1)),
    "lower than the window": (textured((4, 31)), textured((4, 31), seed=1)),
    "narrower than the window": (textured((31, 3)), textured((31, 3), seed=1)),
    "one pixel": (textured((1, 1), 1), textured((1, 1), 1, seed=1)),
    "flat": (flat(0.5), flat(0.6)),
    "flat and bright": (flat(4.0), flat(4.1)),
    "flat, and black": (flat(0.3), flat(0.0)),
    "negative": (-textured((24, 31)), textured((24, 31), seed=1)),
}


def hold_to_definition(pair, definition, window_px):
    image, target = pair
    exact = torch.from_numpy(image).double().requires_grad_(True)
    expected = definition(exact, torch.from_numpy(target).double(), window_px)
    expected.backward()

    value, gradient = SimilarityTo(target, window_px)(image)

    assert value == pytest.approx(expected.item(), rel=1e-5, abs=1e-7)
    error = np.linalg.norm(gradient - exact.grad.numpy())
    # Where nothing varies, terms as large as 2 e / C2 cancel; float32 rounds each to 6e-8.
    cancelled = 2 * np.linalg.norm(image - target) / C2 / image.size if np.ptp(target) == 0 else 0.0
    assert error <= max(1e-5 * np.linalg.norm(exact.grad.numpy()), 3e-7 * cancelled)


@pytest.mark.parametrize("name", PAIRS)
def test_value_and_gradient_follow_the_definition(name, similarity_definition):
    hold_to_definition(PAIRS[name], similarity_definition, WINDOW)


@pytest.mark.parametrize("window_px", [3, 7, 21])
@pytest.mark.parametrize("name", ["unrelated textures", "lower than the window", "one channel"])
def test_other_windows_follow_the_definition(name, window_px, similarity_definition):
    hold_to_definition(PAIRS[name], similarity_definition, window_px)


@pytest.mark.parametrize("target", [flat(0.0), flat(0.7), flat(30.0), textured((24, 31))])
def test_an_image_is_wholly_similar_to_itself_and_no_step_improves_it(target):
    value, gradient = SimilarityTo(target)(target)
    assert value == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(gradient, 0, atol=1e-12)


def test_similarity_never_exceeds_one_for_bright_flat_images():
    for level in (1.0, 10.0, 100.0):
        value, _ = SimilarityTo(flat(level))(flat(level * 1.001))
        assert value <= 1.0


def test_the_target_is_not_changed_and_may_be_judged_again():
    target, image = textured((24, 31)), textured((24, 31), seed=1)
    before = target.copy(), image.copy()
    similarity = SimilarityTo(target)
    first = similarity(image)
    similarity(target)
    second = similarity(image)
    assert first[0] == second[0]
    np.testing.assert_array_equal(first[1], second[1])
    np.testing.assert_array_equal(target, before[0])
    np.testing.assert_array_equal(image, before[1])


def test_an_image_that_is_not_contiguous_is_read_as_it_looks():
    image, target = textured((31, 24)).transpose(1, 0, 2), textured((24, 31), seed=1)
    value, gradient = SimilarityTo(target)(image)
    again, same = SimilarityTo(target)(np.ascontiguousarray(image))
    assert value == again
    np.testing.assert_array_equal(gradient, same)


def test_the_number_of_threads_changes_no_bit(threads):
    image, target = textured((64, 96)), textured((64, 96), seed=1)
    results = []
    for count in (1, 2):
        with threads(count):
            results.append(SimilarityTo(target)(image))
    assert results[0][0] == results[1][0]
    np.testing.assert_array_equal(results[0][1], results[1][1])
