"""Where a reconstruction renders, and the memory that it is foreseen to take."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError, ResourceError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures.joint import reconstruct_together
from gs2ci.reconstruct.placing import needed_mib, placed
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.cards import Card, Cuda
from gs2ci.render.devices import CudaProbe


def shot_of(height, width, views=8, open_share=0.25):
    masks = np.zeros((views, height, width), np.float32)
    masks[:, :: round(1 / open_share)] = 1
    return Shot(np.zeros((height, width, 3), np.float32), masks, np.ones(views, np.float32))


def computer(free_mib):
    card = Card("cuda:0", "NVIDIA GeForce RTX 4090", (8, 9), 24564, free_mib)
    return CudaProbe(lambda: True, lambda: Cuda((13, 0), (13, 0), (7, 5), (card,)), lambda device: 1e-6)


def test_memory_grows_with_pixels_views_and_gaussians():
    base = needed_mib(shot_of(264, 352), Settings())
    assert base < needed_mib(shot_of(528, 704), Settings())
    assert base < needed_mib(shot_of(264, 352, views=16), Settings())
    assert base < needed_mib(shot_of(264, 352, open_share=1.0), Settings())
    dense = replace(Settings(), fit=replace(Settings().fit, gaussians_per_pixel=0.5))
    assert base < needed_mib(shot_of(264, 352), dense)
    assert base <= needed_mib(shot_of(264, 352), replace(Settings(), stride_px=1))


def test_without_a_share_of_pixels_the_guard_bounds_the_gaussians():
    paper = preset("paper")
    assert paper.fit.gaussians_per_pixel is None
    fewer = replace(paper, fit=replace(paper.fit, most_gaussians=10_000))
    assert needed_mib(shot_of(96, 128), fewer) < needed_mib(shot_of(96, 128), paper)


def test_a_shot_that_is_too_large_for_a_card_is_known_before_it_begins():
    shot = shot_of(264, 352)
    settings = replace(Settings(), device="auto")
    enough = needed_mib(shot, settings)
    assert placed(shot, settings, computer(enough))[0].backend == "warp:cuda:0"
    small, placement = placed(shot, settings, computer(enough - 1))
    assert small.backend == "cpu"
    assert f"needs about {enough} MiB" in placement.notes[0].sentence
    with pytest.raises(ResourceError, match=f"has {enough - 1} MiB free"):
        placed(shot, replace(settings, device="cuda"), computer(enough - 1))


def test_several_exposures_take_the_memory_of_each():
    shot, settings = shot_of(96, 128), replace(Settings(), device="auto")
    enough = needed_mib(shot, settings)
    assert placed(shot, settings, computer(2 * enough), exposures=2)[0].backend == "warp:cuda:0"
    assert placed(shot, settings, computer(2 * enough - 1), exposures=2)[0].backend == "cpu"


def test_several_exposures_refuse_a_device_that_is_not_there_before_they_are_observed():
    shot = shot_of(24, 32)
    with pytest.raises(InputError, match="--device cuda:77"):
        reconstruct_together([shot, shot], replace(Settings(), device="cuda:77"))


def test_a_renderer_that_was_chosen_by_name_is_kept():
    settings = replace(Settings(), backend="warp", device="auto")
    assert placed(shot_of(24, 32), settings, CudaProbe(None, None, None))[0] is settings


def test_settings_in_python_render_on_the_cpu_unless_they_say_otherwise():
    settings, placement = placed(shot_of(24, 32), Settings(), CudaProbe(None, None, None))
    assert (settings.backend, placement.device, placement.notes) == ("cpu", "cpu", ())
