"""The registry, and what every backend promises."""

from dataclasses import replace

import pytest
import torch

from gs2ci.core.errors import InputError
from tests.render.backends import BACKENDS, WARP, load_backend


def test_unknown_backend_is_refused_with_the_names_that_exist():
    with pytest.raises(InputError, match=r"no rendering backend 'cuda'.*cpu, warp"):
        load_backend("cuda")


@pytest.mark.parametrize("name", BACKENDS)
def test_backend_carries_the_name_it_is_loaded_by(name):
    assert load_backend(name).name == name


@pytest.mark.parametrize("name", BACKENDS)
def test_coded_sum_is_the_masked_sum_of_the_views(name, make):
    case, backend = make(), load_backend(name)
    coded = backend.coded(case.scene, case.poses, case.intrinsics, backend.code(case.masks))
    images, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size)
    torch.testing.assert_close(coded, (case.masks[..., None] * images).sum(0), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", BACKENDS)
def test_coding_tells_views_and_size(name, make):
    coding = load_backend(name).code(make(views=3, size=(5, 9)).masks)
    assert (coding.views, coding.size) == (3, (5, 9))


@pytest.mark.parametrize(
    ("name", "other"), [("cpu", "reference"), ("reference", "cpu"), pytest.param("warp", "cpu", marks=WARP.marks)]
)
def test_a_mask_set_of_another_backend_is_refused(name, other, make):
    case = make()
    coding = load_backend(other).code(case.masks)
    with pytest.raises(InputError, match="mask set of type"):
        load_backend(name).coded(case.scene, case.poses, case.intrinsics, coding)


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize("field", ["means", "log_scales", "quaternions", "opacity_logits", "colours"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_scene_that_is_not_finite_is_refused_before_anything_runs(name, field, bad, make, change):
    case, backend = make(), load_backend(name)
    spoilt = getattr(case.scene, field).clone()
    spoilt.view(-1)[3] = bad
    case = change(case, **{field: spoilt})
    with pytest.raises(InputError, match=f"{field} of the Gaussians: 1 of .* NaN or infinite"):
        backend.views(case.scene, case.poses, case.intrinsics, case.size)
    with pytest.raises(InputError, match=field):
        backend.coded(case.scene, case.poses, case.intrinsics, backend.code(case.masks))


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize(
    ("masks", "message"),
    [
        (torch.ones(4, 5), "masks have shape"),
        (torch.ones(2, 0, 5), "masks have shape"),
        (torch.full((2, 4, 5), -0.5), "masks reach down to -0.5"),
        (torch.full((2, 4, 5), float("nan")), "masks: 40 of 40 values are NaN"),
    ],
)
def test_masks_that_make_no_sense_are_refused(name, masks, message):
    with pytest.raises(InputError, match=message):
        load_backend(name).code(masks)


@pytest.mark.parametrize("name", BACKENDS)
def test_number_of_poses_must_be_that_of_the_masks(name, make):
    case, backend = make(views=3), load_backend(name)
    with pytest.raises(InputError, match=r"world_to_camera.*\[3, 4, 4\]"):
        backend.coded(case.scene, case.poses[:2], case.intrinsics, backend.code(case.masks))


@pytest.mark.parametrize("name", BACKENDS)
def test_colours_per_view_must_fit_views_and_gaussians(name, make):
    case, backend = make(views=3, count=40), load_backend(name)
    with pytest.raises(InputError, match=r"colours per view.*\[3, 40, 3\]"):
        backend.views(case.scene, case.poses, case.intrinsics, case.size, colours=torch.zeros(2, 40, 3))


@pytest.mark.parametrize("name", BACKENDS)
def test_impossible_camera_and_size_are_refused(name, make):
    case, backend = make(), load_backend(name)
    with pytest.raises(InputError, match="intrinsics"):
        backend.views(case.scene, case.poses, -case.intrinsics, case.size)
    with pytest.raises(InputError, match="image size"):
        backend.views(case.scene, case.poses, case.intrinsics, (0, 4))


@pytest.mark.parametrize("name", BACKENDS)
def test_double_poses_get_double_gradients(name, make):
    case, backend = make(), load_backend(name)
    poses = case.poses.double().requires_grad_()
    backend.coded(case.scene, poses, case.intrinsics, backend.code(case.masks)).sum().backward()
    assert poses.grad.dtype == torch.float64
    assert poses.grad[:, :3].abs().min() > 0
    assert not poses.grad[:, 3].any()


@pytest.mark.parametrize("name", BACKENDS)
def test_scene_without_gaussians_renders_black(name, make, run):
    case = make()
    empty = replace(case, scene=case.scene.map(lambda t: t[:0]))
    for whole_views in (False, True):
        outcome = run(load_backend(name), empty, whole_views=whole_views)
        assert all(not value.any() for value in outcome.values.values())
        assert outcome.values["d means"].shape == (0, 3)


@pytest.mark.parametrize("name", BACKENDS)
def test_no_poses_give_no_views(name, make):
    case, backend = make(), load_backend(name)
    images, alphas = backend.views(case.scene, case.poses[:0], case.intrinsics, (4, 5))
    assert images.shape == (0, 4, 5, 3)
    assert alphas.shape == (0, 4, 5)
