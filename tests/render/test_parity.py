"""Fast rasterisers against the float64 definition: outputs and every gradient, in ordinary and hard scenes."""

from dataclasses import replace

import pytest
import torch

from gs2ci.render.conventions import NEAR, TERMINATION_TRANSMITTANCE
from tests.render.backends import load_backend, to_the_end
from tests.render.reference import ReferenceBackend

ORDINARY = 2e-5
"""Typical errors are 1e-6: this leaves room for other instruction sets and unlucky scenes."""
HARD = 1e-4
DEEP = 1e-3
"""The light still to come is found by subtraction, so behind thousands of layers its rounding is all there is."""


@pytest.mark.parametrize("start", [0, 1000])
@pytest.mark.parametrize("size", [(19, 23), (16, 16), (33, 7)])
def test_coded_sum_agrees_with_the_definition(start, size, make, with_margin, hold_to_definition):
    hold_to_definition(with_margin(lambda seed: make(start + seed, size=size)), ORDINARY)


@pytest.mark.parametrize("start", [0, 1000])
def test_views_agree_with_the_definition(start, make, with_margin, hold_to_definition):
    case = with_margin(lambda seed: make(start + seed, size=(13, 18)), whole_views=True)
    hold_to_definition(case, ORDINARY, whole_views=True)


@pytest.mark.parametrize("size", [(1, 1), (1, 37), (40, 1)])
def test_image_one_pixel_wide_or_high_agrees_with_the_definition(size, make, with_margin, hold_to_definition):
    case = with_margin(lambda seed: make(seed, size=size, open_share=1.0, views=2))
    hold_to_definition(case, HARD)


def test_colours_per_view_agree_with_the_definition(make, fast):
    case = make(seed=4, views=2, size=(9, 9))
    colours = torch.rand(2, 40, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    answers = []
    for backend in (to_the_end(fast), ReferenceBackend()):
        own = colours.to(torch.float64 if backend.name == "reference" else torch.float32, copy=True).requires_grad_()
        images, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, colours=own)
        (
            images.double() * torch.linspace(0, 1, images.numel(), dtype=torch.float64).reshape(images.shape)
        ).sum().backward()
        answers.append((images.detach(), own.grad))
    for found, truth in zip(*answers, strict=True):
        torch.testing.assert_close(found.double(), truth, rtol=1e-4, atol=1e-5)


def test_masks_may_be_all_ones_identical_or_partly_empty(make, hold_to_definition, with_margin):
    def build(kind):
        def case_of(seed):
            case = make(seed, size=(14, 17))
            masks = case.masks.clone()
            if kind == "ones":
                masks = torch.ones_like(masks)
            elif kind == "identical":
                masks = masks[:1].repeat(3, 1, 1)
            else:
                masks[:, 3:9], masks[1], masks[:, :, 5] = 0, 0, 0
            return replace(case, masks=masks)

        return case_of

    for kind in ("ones", "identical", "holes"):
        hold_to_definition(with_margin(build(kind)), ORDINARY)


def test_pixels_that_no_mask_opens_stay_zero_and_closed_masks_give_no_gradient(make, run, fast):
    case = make()
    masks = case.masks.clone()
    masks[:, 4:8, 3:] = 0
    outcome = run(load_backend(fast), replace(case, masks=masks))
    assert not outcome.values["coded"][4:8, 3:].any()
    closed = run(load_backend(fast), replace(case, masks=torch.zeros_like(masks)))
    assert all(not value.any() for value in closed.values.values())


def before_and_behind_the_near_plane(case):
    means = case.scene.means.clone()
    means[:12, 2] = torch.tensor([-5, -0.02, -0.01, 0, 0.005, NEAR, 0.0101, 0.011, 0.02, 0.05, 0.1, 0.3])
    return {"means": means}


def needles_and_plates(case):
    log_scales = case.scene.log_scales.clone()
    ratio = torch.log(torch.tensor(1e4))
    log_scales[:10] = log_scales[:10, :1] + 2.0
    log_scales[:10, 1:] -= ratio
    log_scales[10:20] = log_scales[10:20, :1] + 2.0
    log_scales[10:20, 2] -= ratio
    return {"log_scales": log_scales}


def scales_of_all_sizes(case):
    exponents = torch.linspace(-6, 3, 40)
    log_scales = torch.stack([exponents, exponents.roll(7), exponents.roll(23)], dim=1) * torch.log(torch.tensor(10.0))
    return {"log_scales": log_scales, "opacity_logits": case.scene.opacity_logits - 2}


def zero_quaternions(case):
    quaternions = case.scene.quaternions.clone()
    quaternions[:20] = 0
    quaternions[20:25] *= 1e-8
    quaternions[25:30] *= 1e8
    return {"quaternions": quaternions}


def saturated_opacities(case):
    logits = case.scene.opacity_logits.clone()
    logits[:10], logits[10:20] = 20.0, -20.0
    return {"opacity_logits": logits}


def layers_on_one_pixel(case):
    many = 3000
    scene = case.scene.map(lambda t: t[:1].repeat(many, *[1] * (t.ndim - 1)))
    steps = torch.linspace(0, 1, many)
    return {
        "means": torch.stack([0.02 * steps, -0.01 * steps, 2 + steps], dim=1),
        "log_scales": torch.tensor([-3.0, -2.5, -3.5]).repeat(many, 1),
        "quaternions": scene.quaternions,
        "opacity_logits": torch.full((many,), -5.0) + steps,
        "colours": torch.stack([steps, 1 - steps, 0.5 + 0 * steps], dim=1),
    }


def duplicate_points(case):
    return {name: torch.cat([t[:20], t[:20]]) for name, t in case.scene.parameters().items()}


def far_off_the_axis(case):
    means = case.scene.means.clone()
    means[:20, :2] *= 4
    return {"means": means, "log_scales": case.scene.log_scales + 1.0}


HARD_CASES = [
    before_and_behind_the_near_plane,
    needles_and_plates,
    scales_of_all_sizes,
    zero_quaternions,
    saturated_opacities,
    duplicate_points,
    far_off_the_axis,
]


@pytest.mark.parametrize("spoil", HARD_CASES, ids=lambda f: f.__name__)
def test_hard_scene_agrees_with_the_definition(spoil, make, change, with_margin, hold_to_definition):
    def build(seed):
        case = make(seed, size=(15, 12), views=2)
        return change(case, **spoil(case))

    hold_to_definition(with_margin(build), HARD)


def test_thousands_of_layers_on_one_pixel_agree_with_the_definition(make, change, with_margin, hold_to_definition):
    def build(seed):
        case = make(seed, size=(15, 12), views=2)
        return change(case, **layers_on_one_pixel(case))

    hold_to_definition(with_margin(build), DEEP)


def test_needle_across_the_image_keeps_its_digits(make, change, with_margin, hold_to_definition):
    """A diagonal needle 100 times longer than the image: the textbook quadratic form loses four digits here."""

    def build(seed):
        case = make(seed, count=6, size=(60, 60), views=1)
        log_scales = torch.tensor([3.0, -9.0, -9.0]).repeat(6, 1)
        return change(case, log_scales=log_scales, opacity_logits=torch.full((6,), 0.5))

    hold_to_definition(with_margin(build), HARD)


@pytest.mark.parametrize("log_scale", [-80.0, -20.0, 12.0, 17.0, 80.0])
@pytest.mark.parametrize("depth", [0.0100001, 3.0, 1e6])
def test_scales_and_depths_far_outside_any_scene_stay_finite(log_scale, depth, make, change, run, fast):
    case = make(count=33)
    means = case.scene.means.clone()
    means[:, 2] = depth
    case = change(case, means=means, log_scales=torch.full_like(means, log_scale))
    run(load_backend(fast), case).assert_finite()
    run(load_backend(fast), case, whole_views=True).assert_finite()


def test_spans_are_found_again_when_their_buffer_was_too_small(make, change, with_margin, hold_to_definition):
    def build(seed):
        case = make(seed, count=40, size=(150, 9), views=1)
        return change(case, log_scales=case.scene.log_scales + 3, opacity_logits=torch.full((40,), -1.0))

    hold_to_definition(with_margin(build), ORDINARY)


def test_termination_changes_a_pixel_by_no_more_than_it_says(make, change, fast):
    case = make(count=400, open_share=1.0)
    case = change(case, colours=case.scene.colours.clamp(0, 1))
    exact, _ = to_the_end(fast).views(case.scene, case.poses, case.intrinsics, case.size)
    early, _ = load_backend(fast).views(case.scene, case.poses, case.intrinsics, case.size)
    assert 0 < (exact - early).abs().max() <= TERMINATION_TRANSMITTANCE


def test_the_same_bits_come_out_twice(make, run, fast):
    case = make(count=300, size=(40, 48))
    for whole_views in (False, True):
        one, other = (run(load_backend(fast), case, whole_views=whole_views) for _ in range(2))
        one.assert_equal(other)
