"""What the Warp backend has of its own: devices, lists that are kept, a rendering that is differentiated once."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.settings import RasterSettings

pytest.importorskip("warp", reason="Warp is not installed")

import warp as wp

from gs2ci.render.warp.backend import WarpBackend


def coded(backend, case, reuse):
    return backend.coded(case.scene, case.poses, case.intrinsics, backend.code(case.masks), reuse=reuse)


def test_a_device_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(InputError, match=r"no device 'cuda:7'.*cpu"):
        WarpBackend(device="cuda:7")


def test_lists_serve_as_often_as_the_settings_say(make):
    case, backend = make(), WarpBackend(RasterSettings(relist_every=3))
    reuse, mask_set = backend.reuse(), backend.code(case.masks)
    first, *others = (backend.coded(case.scene, case.poses, case.intrinsics, mask_set, reuse=reuse) for _ in range(4))
    assert reuse.listings == 2
    for one in others:
        assert torch.equal(one, first)


def test_kept_lists_follow_gaussians_within_their_margin(make, change):
    case, backend = make(), WarpBackend(RasterSettings(relist_every=9, list_margin_px=4.0))
    reuse, mask_set = backend.reuse(), backend.code(case.masks)
    backend.coded(case.scene, case.poses, case.intrinsics, mask_set, reuse=reuse)
    moved = change(case, means=case.scene.means + torch.tensor([0.01, -0.01, 0.0]))
    kept = backend.coded(moved.scene, case.poses, case.intrinsics, mask_set, reuse=reuse)
    assert reuse.listings == 1
    torch.testing.assert_close(kept, coded(backend, moved, None), rtol=1e-5, atol=1e-5)


def test_lists_are_made_anew_for_another_population_or_other_masks(make, change):
    case, backend = make(), WarpBackend(RasterSettings(relist_every=9))
    reuse, mask_set = backend.reuse(), backend.code(case.masks)
    backend.coded(case.scene, case.poses, case.intrinsics, mask_set, reuse=reuse)
    fewer = change(case, **{name: tensor[:30] for name, tensor in case.scene.parameters().items()})
    backend.coded(fewer.scene, case.poses, case.intrinsics, mask_set, reuse=reuse)
    coded(backend, fewer, reuse)
    assert reuse.listings == 3


def test_lists_are_scanned_and_sorted_on_the_device_where_they_lie(make, monkeypatch):
    case, backend, current, found = make(), WarpBackend(), [], []

    @contextmanager
    def device_as_current(device):
        current.append(device)
        yield
        current.pop()

    for name in ("array_scan", "radix_sort_pairs"):
        work = getattr(wp.utils, name)
        monkeypatch.setattr(
            wp.utils, name, lambda *given, work=work, **how: (found.append(list(current)), work(*given, **how))
        )
    monkeypatch.setattr(wp, "ScopedDevice", device_as_current)
    coded(backend, case, None)
    assert found == [["cpu"], ["cpu"]]


def test_a_rendering_is_differentiated_once(make):
    case, backend = make(), WarpBackend()
    _, pull = backend.coded_with_pull(case.scene, case.poses, case.intrinsics, backend.code(case.masks))
    gradient = torch.ones(*case.size, 3).numpy()
    pull(gradient)
    with pytest.raises(RuntimeError, match="differentiated twice"):
        pull(gradient)


def test_fits_in_two_threads_render_what_one_does(make):
    case = make()
    alone = coded(WarpBackend(), case, None)

    def often(backend):
        return [coded(backend, case, None) for _ in range(20)]

    with ThreadPoolExecutor(2) as threads:
        for images in threads.map(often, [WarpBackend(), WarpBackend()]):
            assert all(torch.equal(image, alone) for image in images)
