"""Graphs, workspaces and threads."""

import gc

import numba
import pytest
import torch

from gs2ci.render.cpu.backend import CpuBackend


def test_result_is_the_same_bit_for_bit_on_one_and_two_threads(make, run):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("Numba was started with one thread")
    case = make(count=2500, views=3, size=(48, 40))
    outcomes = []
    before = numba.get_num_threads()
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            outcomes.append([run(CpuBackend(), case, whole_views=whole) for whole in (False, True)])
    finally:
        numba.set_num_threads(before)
    for one, two in zip(*outcomes, strict=True):
        one.assert_equal(two)


def test_one_view_is_cut_into_bands_with_the_same_result_on_any_threads(make, run):
    case = make(count=600, views=1, size=(64, 64))
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = run(CpuBackend(), case)
    finally:
        numba.set_num_threads(before)
    run(CpuBackend(), case).assert_equal(alone)


def test_same_scene_twice_gives_the_same_bits_in_a_workspace_used_before(make, run):
    backend = CpuBackend()
    first = run(backend, make(seed=1))
    run(backend, make(seed=2, count=500, size=(30, 50)))
    run(backend, make(seed=1)).assert_equal(first)


def test_two_graphs_may_be_alive_at_once(make):
    backend = CpuBackend()
    cases = [make(seed=1), make(seed=2, count=70, size=(30, 22))]

    def gradients(interleaved):
        scenes = [case.scene.map(lambda t: t.clone().requires_grad_()) for case in cases]
        losses = []
        for scene, case in zip(scenes, cases, strict=True):
            coded = backend.coded(scene, case.poses, case.intrinsics, backend.code(case.masks))
            losses.append(coded.square().sum())
            if not interleaved:
                losses[-1].backward()
        if interleaved:
            for loss in losses:
                loss.backward()
        return [t.grad for scene in scenes for t in scene.parameters().values()]

    for one, other in zip(gradients(True), gradients(False), strict=True):
        assert torch.equal(one, other)


def test_workspace_comes_back_after_backward(make):
    backend, case = CpuBackend(), make()
    scene = case.scene.map(lambda t: t.requires_grad_())
    coded = backend.coded(scene, case.poses, case.intrinsics, backend.code(case.masks))
    assert backend.idle_workspaces == 0
    coded.sum().backward()
    assert backend.idle_workspaces == 1


def test_forward_without_backward_gives_its_workspace_back(make):
    backend, case = CpuBackend(), make()
    coding = backend.code(case.masks)
    with torch.no_grad():
        backend.coded(case.scene, case.poses, case.intrinsics, coding)
    assert backend.idle_workspaces == 1
    scene = case.scene.map(lambda t: t.requires_grad_())
    coded = backend.coded(scene, case.poses, case.intrinsics, coding)
    assert backend.idle_workspaces == 0
    del coded
    gc.collect()
    assert backend.idle_workspaces == 1


def test_second_backward_through_one_rendering_is_refused(make):
    backend, case = CpuBackend(), make()
    scene = case.scene.map(lambda t: t.requires_grad_())
    total = backend.coded(scene, case.poses, case.intrinsics, backend.code(case.masks)).sum()
    total.backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="backward ran twice through one rendering"):
        total.backward()


def test_parameters_overwritten_before_backward_are_noticed(make):
    backend, case = CpuBackend(), make()
    scene = case.scene.map(lambda t: t.requires_grad_())
    total = backend.coded(scene, case.poses, case.intrinsics, backend.code(case.masks)).sum()
    with torch.no_grad():
        scene.means += 1
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        total.backward()


@pytest.mark.parametrize("used", ["images", "alphas"])
def test_loss_may_use_images_or_alphas_alone(used, make):
    backend, case = CpuBackend(), make()
    scene = case.scene.map(lambda t: t.requires_grad_())
    outputs = dict(zip(("images", "alphas"), backend.views(scene, case.poses, case.intrinsics, case.size), strict=True))
    outputs[used].sum().backward()
    assert scene.means.grad.abs().sum() > 0
    assert scene.colours.grad.any() == (used == "images")


def test_more_sizes_than_are_kept_can_be_rendered(make):
    backend, case = CpuBackend(), make()
    for _ in range(2):
        for height in range(3, 10):
            images, _ = backend.views(case.scene, case.poses, case.intrinsics, (height, 5))
            assert images.shape == (3, height, 5, 3)


def test_layout_of_the_parameters_in_memory_does_not_matter(make, run, change):
    case = make()
    strided = torch.zeros(40, 7)
    strided[:, 2:5] = case.scene.means
    run(CpuBackend(), change(case, means=strided[:, 2:5])).assert_equal(run(CpuBackend(), case))
