from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.design.candidates import CaptureCandidate
from gs2ci.rig.design.telling import readings_of, told, wanted_views
from tests.small_benches import bench_of


@pytest.fixture
def tell(tmp_path):
    """Foresee the views of a small bench by one candidate, with changes to it and to the bench's optics."""

    def found(full_scale_e_per_s=1e5, **changed):
        bench = bench_of(
            tmp_path, optics={"full_scale_e_per_s": full_scale_e_per_s}, capture={"from_mm": 71.0, "to_mm": 79.0}
        )
        candidate = replace(CaptureCandidate(4, 0.25, 1, 8.0, 1), **changed)
        own = bench.table.capture
        wanted = wanted_views(bench, own, None)
        return told(bench, wanted, readings_of(bench, candidate.capture(own), candidate.exposures))

    return found


def test_further_exposures_and_more_light_tell_more(tell):
    assert tell(exposures=4).psnr_db > tell().psnr_db + 1
    assert tell(1e5).psnr_db > tell(2e3).psnr_db + 1


def test_more_masks_in_the_same_time_are_harder_to_tell_apart(tell):
    assert tell(masks=16).decoded > tell(masks=4).decoded


def test_a_longer_path_makes_views_differ_more(tell):
    assert tell(travel_mm=8.0).decoded > tell(travel_mm=1.0).decoded


def test_a_short_path_leaves_the_depth_and_what_lies_beyond_it_open(tell):
    short, whole = tell(travel_mm=0.5), tell(travel_mm=8.0)
    assert short.depth > whole.depth
    assert short.unseen > whole.unseen


def test_clipped_readings_tell_nothing(tell):
    bright = tell(3e6, density=0.5)
    assert bright.saturated > 0.9
    assert bright.psnr_db < tell(1e5, density=0.5).psnr_db - 3


def test_coarse_elements_tell_less_of_fine_textures(tell):
    assert tell(element=8).texture > tell(element=1).texture


def test_the_power_of_the_error_is_that_of_its_parts(tell):
    found = tell()
    power = 10 ** (-found.psnr_db / 10)
    assert power > found.texture + found.depth + found.unseen + found.decoded > 0.5 * power


def test_views_are_wanted_along_the_rig_files_path_or_as_far_as_is_said(tmp_path):
    bench = bench_of(tmp_path)
    own = bench.table.capture
    lengths = [np.ptp(wanted_views(bench, own, mm).poses[:, 0, 3]) for mm in (None, 4.0)]
    assert lengths[1] == pytest.approx(2 * lengths[0])


def test_views_along_a_path_of_a_camera_at_rest_are_refused(tmp_path):
    bench = bench_of(tmp_path, capture={"axis": ""})
    assert len(wanted_views(bench, bench.table.capture, None).poses) == 1
    with pytest.raises(InputError, match=r"views along 4 mm of a path on a bench whose .capture. names no axis"):
        wanted_views(bench, bench.table.capture, 4.0)
