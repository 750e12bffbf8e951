"""Gaussians that move between the views: the definition by finite differences, the kernels by the definition."""

from dataclasses import replace

import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.gaussians import Gaussians
from tests.render.backends import to_the_end
from tests.render.reference import ReferenceBackend

TOLERANCE = 2e-4
"""Relative, in the 2-norm, as for still scenes (`cpu/test_parity.py`)."""


def moving(case, rows=2, size=0.1):
    generator = torch.Generator().manual_seed(3)
    motion = size * torch.randn(len(case.scene), rows, 3, generator=generator)
    return replace(case, scene=replace(case.scene, motion=motion))


def times(case):
    return torch.linspace(-1, 1, len(case.poses))


def rendered(backend, case, *, whole_views):
    dtype = torch.float64 if isinstance(backend, ReferenceBackend) else torch.float32
    scene = case.scene.map(lambda tensor: tensor.detach().to(dtype).clone().requires_grad_())
    poses = case.poses.to(dtype).clone().requires_grad_()
    if whole_views:
        output, _ = backend.views(scene, poses, case.intrinsics, case.size, times=times(case))
    else:
        output = backend.coded(scene, poses, case.intrinsics, backend.code(case.masks), times=times(case))
    weights = torch.randn(output.shape, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    (output.double() * weights).sum().backward()
    found = {name: tensor.grad for name, tensor in scene.parameters().items()}
    return {"output": output.detach(), "poses": poses.grad, **found}


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("whole_views", [False, True])
def test_kernels_follow_the_definition(make, with_margin, rows, whole_views, fast):
    # 37 Gaussians leave spare lanes in the last block.
    case = with_margin(lambda seed: make(seed=seed, count=37), whole_views=whole_views)
    for size in (0.1, 0.09, 0.11, 0.08):
        case = moving(case, rows, size)
        reference = ReferenceBackend()
        truth = rendered(reference, case, whole_views=whole_views)
        if reference.margin > 2e-5:
            break
    assert reference.margin > 2e-5
    found = rendered(to_the_end(fast), case, whole_views=whole_views)
    for name, wanted in truth.items():
        error = torch.linalg.vector_norm(found[name].double() - wanted)
        assert error <= TOLERANCE * torch.linalg.vector_norm(wanted), name
    assert torch.linalg.vector_norm(truth["motion"]) > 0


def test_definition_follows_finite_differences(make):
    case = moving(make(count=6, size=(7, 9)))
    backend = ReferenceBackend()
    mask_set, when = backend.code(case.masks), times(case).double()
    fixed = case.scene.map(torch.Tensor.double)

    def coded(motion):
        return backend.coded(replace(fixed, motion=motion), case.poses, case.intrinsics, mask_set, times=when)

    assert fixed.motion is not None
    assert torch.autograd.gradcheck(coded, fixed.motion.clone().requires_grad_(), eps=1e-6, atol=1e-6, fast_mode=True)


def test_a_moment_of_a_moving_scene_is_a_still_scene(make):
    case = moving(make())
    backend = CpuBackend()
    when = times(case)
    together, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, times=when)
    depths = backend.depths(case.scene, case.poses, case.intrinsics, case.size, times=when)
    for view, moment in enumerate(when.tolist()):
        still, pose = case.scene.at(moment), case.poses[view][None]
        assert still.motion is None
        alone, _ = backend.views(still, pose, case.intrinsics, case.size)
        torch.testing.assert_close(together[view], alone[0], rtol=0, atol=1e-5)
        torch.testing.assert_close(
            depths.depth[view], backend.depths(still, pose, case.intrinsics, case.size).depth[0], rtol=1e-3, atol=1e-3
        )


def test_motion_of_nothing_changes_nothing(make):
    case = make()
    resting = replace(case.scene, motion=torch.zeros(len(case.scene), 2, 3))
    backend = CpuBackend()
    one, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size)
    other, _ = backend.views(resting, case.poses, case.intrinsics, case.size, times=times(case))
    assert torch.equal(one, other)


def test_powers_of_time_weigh_the_rows():
    scene = Gaussians(
        *(torch.zeros(1, 3), torch.zeros(1, 3), torch.zeros(1, 4), torch.zeros(1), torch.zeros(1, 3)),
        motion=torch.tensor([[[1.0, 0, 0], [0, 1.0, 0]]]),
    )
    found = scene.means_at(torch.tensor([-1.0, 0.5]))
    torch.testing.assert_close(found[:, 0], torch.tensor([[-1.0, 1.0, 0], [0.5, 0.25, 0]]))
    torch.testing.assert_close(scene.at(0.5).means, torch.tensor([[0.5, 0.25, 0]]))


def test_moving_scene_wants_times(make):
    case = moving(make())
    for backend in (CpuBackend(), ReferenceBackend()):
        with pytest.raises(InputError, match="at no time"):
            backend.views(case.scene, case.poses, case.intrinsics, case.size)
        with pytest.raises(InputError, match="times of the poses"):
            backend.views(case.scene, case.poses, case.intrinsics, case.size, times=torch.zeros(1))


def test_motion_of_another_shape_is_refused(make):
    scene = make().scene
    for wrong in (torch.zeros(len(scene), 3), torch.zeros(len(scene), 0, 3), torch.zeros(3, 2, 3)):
        with pytest.raises(InputError, match="motion of the Gaussians"):
            replace(scene, motion=wrong).check()
