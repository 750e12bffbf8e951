"""Lists of Gaussians that outlive a rendering: what they may change, and what they may not."""

import gc
from dataclasses import replace

import numba
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.conventions import TERMINATION_TRANSMITTANCE
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.interface import Reuse
from gs2ci.render.screen import ScreenStatistics
from gs2ci.render.settings import RasterSettings

# Where a cell stops is looked up after every eight entries of its list, and wide lists hold more: so results are
# compared bit for bit where blending never stops, and to the termination's own bound where it does.
NEVER = RasterSettings(termination_transmittance=0.0)


def backend_of(every=4, margin_px=1.0, *, stops=False):
    given = RasterSettings() if stops else NEVER
    return CpuBackend(replace(given, relist_every=every, list_margin_px=margin_px))


def iterate(backend, case, coding, reuse):
    """Render the coded sum and differentiate it; returns it with all gradients."""
    scene = case.scene.map(lambda t: t.detach().clone().requires_grad_())
    poses = case.poses.clone().requires_grad_()
    coded = backend.coded(scene, poses, case.intrinsics, coding, reuse=reuse)
    coded.square().sum().backward()
    return [coded.detach(), *(t.grad for t in scene.parameters().values()), poses.grad]


def fresh(case, *, stops=False):
    backend = CpuBackend(RasterSettings() if stops else NEVER)
    return iterate(backend, case, backend.code(case.masks), None)


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        assert torch.equal(a, b)


def moved(case, change, shift, generator):
    """The case with every mean moved within its image plane: no depth changes, so no order does."""
    steps = torch.rand(len(case.scene), 3, generator=generator) * 2 - 1
    steps[:, 2] = 0
    return change(case, means=case.scene.means + shift * steps)


def upright(case):
    """The case seen from cameras that do not turn, so that a move within the image plane keeps every depth."""
    poses = torch.eye(4).repeat(len(case.poses), 1, 1)
    poses[:, :2, 3] = case.poses[:, :2, 3]
    return replace(case, poses=poses)


def test_lists_that_serve_once_are_not_kept_and_change_no_bit(make):
    case, backend = make(count=300, size=(40, 48)), CpuBackend()
    coding, reuse = backend.code(case.masks), backend.reuse()
    for _ in range(3):
        assert_same(iterate(backend, case, coding, reuse), fresh(case, stops=True))
    assert reuse.listings == 0


@pytest.mark.parametrize("margin_px", [0.0, 1.0, 7.5])
def test_where_nothing_moved_images_and_gradients_are_those_of_fresh_lists(make, margin_px):
    case, backend = make(count=300, size=(40, 48)), backend_of(4, margin_px)
    coding, reuse = backend.code(case.masks), backend.reuse()
    expected = fresh(case)
    for _ in range(4):
        assert_same(iterate(backend, case, coding, reuse), expected)
    assert reuse.listings == 1


def test_where_nothing_moved_early_termination_stays_within_its_bound(make, change):
    case = make(count=3000, size=(40, 48))
    case, backend = change(case, colours=case.scene.colours.clamp(0, 1)), backend_of(4, stops=True)
    coding, reuse = backend.code(case.masks), backend.reuse()
    first, second = (iterate(backend, case, coding, reuse) for _ in range(2))
    assert_same(first, second)
    light = case.masks.sum(0)[..., None]
    assert ((first[0] - fresh(case, stops=True)[0]).abs() <= TERMINATION_TRANSMITTANCE * light + 1e-6).all()


def test_what_moved_within_the_margin_is_as_fresh_lists_have_it(make, change):
    case, backend = upright(make(count=400, size=(40, 48))), backend_of(5, margin_px=2.0)
    coding, reuse = backend.code(case.masks), backend.reuse()
    generator = torch.Generator().manual_seed(1)
    iterate(backend, case, coding, reuse)
    focal = float(case.intrinsics[1, 1])
    for _ in range(4):
        # Nearest Gaussians are two units away: this moves none by more than half a pixel, four times less than 2 px.
        case = moved(case, change, 0.5 * 2.0 / focal, generator)
        assert_same(iterate(backend, case, coding, reuse), fresh(case))
    assert reuse.listings == 1


def test_what_grew_within_the_margin_is_as_fresh_lists_have_it(make, change):
    case, backend = upright(make(count=400, size=(40, 48))), backend_of(2, margin_px=3.0)
    coding, reuse = backend.code(case.masks), backend.reuse()
    iterate(backend, case, coding, reuse)
    grown = change(case, log_scales=case.scene.log_scales + 0.02, opacity_logits=case.scene.opacity_logits + 0.02)
    visible_before = torch.sigmoid(case.scene.opacity_logits) >= 1 / 255
    assert (visible_before == (torch.sigmoid(grown.scene.opacity_logits) >= 1 / 255)).all()
    assert_same(iterate(backend, grown, coding, reuse), fresh(grown))


def test_what_comes_into_the_frame_within_the_margin_is_seen(make, change):
    case, backend = make(count=1, views=1, size=(20, 24), open_share=1.0), backend_of(2, margin_px=3.0)
    case = replace(case, poses=torch.eye(4)[None])
    focal, depth = float(case.intrinsics[0, 0]), 2.0
    left_edge = -float(case.intrinsics[0, 2]) / focal * depth

    def at(beyond_px):
        # Its footprint reaches 2.8 px to each side.
        return change(
            case,
            means=torch.tensor([[left_edge - beyond_px * depth / focal, 0.0, depth]]),
            log_scales=torch.full((1, 3), -3.0),
            opacity_logits=torch.tensor([2.0]),
        )

    coding, reuse = backend.code(case.masks), backend.reuse()
    assert not iterate(backend, at(4.0), coding, reuse)[0].any()
    seen = iterate(backend, at(1.5), coding, reuse)
    assert seen[0].any()
    assert_same(seen, fresh(at(1.5)))


def test_lists_are_made_anew_after_so_many_renderings(make, change):
    case, backend = make(count=100), backend_of(3, margin_px=0.0)
    coding, reuse = backend.code(case.masks), backend.reuse()
    for _ in range(3):
        iterate(backend, case, coding, reuse)
    assert reuse.listings == 1
    far = change(case, means=case.scene.means + torch.tensor([0.4, 0.3, 0.0]))
    assert_same(iterate(backend, far, coding, reuse), fresh(far))
    assert reuse.listings == 2


def test_stale_lists_are_the_approximation_that_is_stated(make, change):
    case, backend = make(count=100), backend_of(2, margin_px=0.0)
    coding, reuse = backend.code(case.masks), backend.reuse()
    iterate(backend, case, coding, reuse)
    far = change(case, means=case.scene.means + torch.tensor([0.4, 0.3, 0.0]))
    outcome = iterate(backend, far, coding, reuse)
    assert all(torch.isfinite(value).all() for value in outcome)
    assert not torch.equal(outcome[0], fresh(far)[0])


def test_another_number_of_gaussians_or_another_coding_makes_lists_anew(make):
    backend = backend_of(8)
    small, other = make(seed=1, count=40), make(seed=2, count=90)
    large = replace(other, masks=small.masks)
    coding, reuse = backend.code(small.masks), backend.reuse()
    for case in (small, large, small):
        assert_same(iterate(backend, case, coding, reuse), fresh(case))
    assert reuse.listings == 3
    again = replace(small, masks=other.masks)
    assert_same(iterate(backend, again, backend.code(again.masks), reuse), fresh(again))
    assert reuse.listings == 4


def test_a_new_population_of_the_same_size_takes_a_new_object(make):
    backend, first = backend_of(8), make(seed=1)
    coding = backend.code(first.masks)
    for case in (first, replace(make(seed=2), masks=first.masks)):
        assert_same(iterate(backend, case, coding, backend.reuse()), fresh(case))


def behind(case, change):
    return change(case, means=case.scene.means * torch.tensor([1.0, 1.0, -1.0]))


def test_everything_behind_the_camera_and_then_before_it(make, change):
    case, backend = make(count=60), backend_of(2)
    coding, reuse = backend.code(case.masks), backend.reuse()
    first = iterate(backend, behind(case, change), coding, reuse)
    assert not first[0].any()
    # Nothing was listed, and until the next listing nothing is seen.
    assert not iterate(backend, case, coding, reuse)[0].any()
    assert_same(iterate(backend, case, coding, reuse), fresh(case))


def test_what_went_behind_the_camera_is_not_drawn_from_old_lists(make, change):
    case, backend = make(count=60), backend_of(4)
    coding, reuse = backend.code(case.masks), backend.reuse()
    iterate(backend, case, coding, reuse)
    outcome = iterate(backend, behind(case, change), coding, reuse)
    assert not any(value.any() for value in outcome)
    # Half of them, so that the rest is blended as if these had never been listed.
    some = torch.arange(60) % 2 == 0
    signs = torch.where(some, -1.0, 1.0)[:, None] * torch.tensor([0.0, 0.0, 1.0]) + torch.tensor([1.0, 1.0, 0.0])
    half = change(case, means=case.scene.means * signs)
    assert_same(iterate(backend, half, coding, reuse), fresh(half))


@pytest.mark.parametrize("count", [0, 1])
def test_no_gaussian_and_one_gaussian_are_rendered_from_kept_lists(make, count):
    case, backend = make(count=count, open_share=1.0), backend_of(3)
    coding, reuse = backend.code(case.masks), backend.reuse()
    for _ in range(4):
        assert_same(iterate(backend, case, coding, reuse), fresh(case))


def test_masks_without_an_open_pixel_are_rendered_from_kept_lists(make):
    case, backend = make(), backend_of(3)
    case = replace(case, masks=torch.zeros_like(case.masks))
    coding, reuse = backend.code(case.masks), backend.reuse()
    for _ in range(2):
        assert not any(value.any() for value in iterate(backend, case, coding, reuse))


def test_what_is_listed_beside_the_frame_does_not_count_as_seen(make):
    case = make(count=400, size=(16, 16))
    records = []
    for backend in (CpuBackend(NEVER), backend_of(4, margin_px=9.0)):
        screen = ScreenStatistics.empty(400)
        scene = case.scene.map(lambda t: t.detach().clone().requires_grad_())
        coding = backend.code(case.masks)
        backend.coded(scene, case.poses, case.intrinsics, coding, screen, backend.reuse()).sum().backward()
        records.append(screen)
    fresh_lists, wide_lists = records
    assert (fresh_lists.sightings < 3).any()
    assert torch.equal(wide_lists.sightings, fresh_lists.sightings)
    assert torch.equal(wide_lists.gradient_sum, fresh_lists.gradient_sum)
    assert torch.equal(wide_lists.radius_px, fresh_lists.radius_px)


def test_threads_change_no_bit_with_kept_lists(make, change):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("Numba was started with one thread")
    outcomes, before = [], numba.get_num_threads()
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            case, backend = make(count=2500, views=3, size=(48, 40)), backend_of(2, stops=True)
            coding, reuse, generator = backend.code(case.masks), backend.reuse(), torch.Generator().manual_seed(3)
            for _ in range(4):
                outcome = iterate(backend, case, coding, reuse)
                case = moved(case, change, 0.02, generator)
            outcomes.append(outcome)
    finally:
        numba.set_num_threads(before)
    assert_same(*outcomes)


def test_a_graph_outlives_the_lists_that_it_was_rendered_from(make):
    backend, cases = backend_of(1000), [make(seed=1), make(seed=2, count=70), make(seed=3, count=55)]
    masks = cases[0].masks
    coding, reuse = backend.code(masks), backend.reuse()
    scenes = [case.scene.map(lambda t: t.detach().clone().requires_grad_()) for case in cases]
    losses = [
        backend.coded(scene, case.poses, case.intrinsics, coding, reuse=reuse).square().sum()
        for scene, case in zip(scenes, cases, strict=True)
    ]
    assert reuse.listings == 3
    for loss in losses:
        loss.backward()
    for scene, case in zip(scenes, cases, strict=True):
        expected = fresh(replace(case, masks=masks))[1:6]
        assert_same([t.grad for t in scene.parameters().values()], expected)


def test_memory_of_lists_comes_back_when_nobody_needs_it(make):
    case, backend = make(), backend_of(2)
    coding, reuse = backend.code(case.masks), backend.reuse()
    for _ in range(5):
        iterate(backend, case, coding, reuse)
    # The one that is in use, none waiting: three listings took turns in it.
    assert reuse.listings == 3
    assert backend.idle_lists == 0
    del reuse
    gc.collect()
    assert backend.idle_lists == 1
    assert backend.idle_workspaces == 1


def test_shared_work_of_another_backend_is_refused(make):
    case, backend = make(), backend_of(2)
    with pytest.raises(InputError, match="shared work of type Reuse given to the cpu backend"):
        backend.coded(case.scene, case.poses, case.intrinsics, backend.code(case.masks), reuse=Reuse())
