from dataclasses import replace

import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.settings import RasterSettings
from tests.render.backends import load_backend


def test_defaults_reuse_nothing_and_stop_at_a_ten_thousandth():
    settings = RasterSettings().check()
    assert settings.relist_every == 1
    assert settings.termination_transmittance == 1e-4


@pytest.mark.parametrize("termination", [-1e-9, 1.0, float("nan"), float("inf")])
def test_a_termination_that_is_no_share_of_light_is_refused(termination):
    with pytest.raises(InputError, match=r"termination_transmittance = .* in RasterSettings"):
        RasterSettings(termination_transmittance=termination).check()


@pytest.mark.parametrize(
    ("every", "margin_px"), [(0, 1.0), (-3, 1.0), (4, -0.1), (4, 65.0), (4, float("inf")), (4, float("nan"))]
)
def test_lists_for_no_rendering_or_without_a_margin_are_refused(every, margin_px):
    with pytest.raises(InputError, match=f"(relist_every = {every}|list_margin_px = {margin_px}) in RasterSettings"):
        RasterSettings(relist_every=every, list_margin_px=margin_px).check()


@pytest.mark.parametrize("name", ["cpu", "reference"])
def test_a_backend_refuses_settings_that_make_no_sense(name):
    with pytest.raises(InputError, match="relist_every = 0 in RasterSettings"):
        load_backend(name, RasterSettings(relist_every=0))


def test_the_reference_makes_no_use_of_what_it_may_leave_out(make):
    case = make(count=20, views=2, size=(8, 10), open_share=0.5)
    images = []
    for settings in (RasterSettings(), RasterSettings(termination_transmittance=0.5, relist_every=4)):
        backend = load_backend("reference", settings)
        coding, reuse = backend.code(torch.ones(2, 8, 10)), backend.reuse()
        images.append(backend.coded(case.scene, case.poses, case.intrinsics, coding, reuse=reuse))
    assert torch.equal(*images)


def test_termination_bounds_what_a_pixel_loses(make):
    case = make(count=2000, views=2, size=(30, 40), open_share=1.0)
    scene = replace(case.scene, colours=case.scene.colours.clamp(0, 1))
    images = {}
    for share in (0.0, 1e-4, 1e-2, 0.5):
        backend = load_backend("cpu", RasterSettings(termination_transmittance=share))
        images[share], _ = backend.views(scene, case.poses, case.intrinsics, case.size)
    for share, image in images.items():
        assert (image - images[0.0]).abs().max() <= share
    assert not torch.equal(images[0.5], images[0.0])
