"""A camera that exposes for a tenth of the time that was set: found whatever its stamps, by captures and the doctor."""

from dataclasses import asdict

import pytest

from gs2ci.rig.doctor import examine
from gs2ci_drivers.failures import ExposureError, ExtraFrameError, PlanRefusedError
from gs2ci_sims.wires.v4l2_camera import STAMPING
from tests.twins.v4l2 import CameraModel, V4l2Twin


def bench_of(make_small, camera_driver, table=None, **model):
    small = make_small(
        dlp5500=True,
        sensor=table or {},
        capture={"masks": 4, "mask_s": 0.02, "shots": 1, "axis": ""},
        world={"camera_driver": camera_driver},
    )
    stamps, flagged = STAMPING[camera_driver]
    camera = CameraModel(**asdict(small.bench.sensor.model) | {"stamps": stamps, "flags_start": flagged} | model)
    small.bench.sensor = V4l2Twin(small.bench.world, camera, small.bench.faults["sensor"])
    return small


def found(small):
    return {finding.what: finding for finding in examine(small.rig)}


@pytest.mark.parametrize(
    ("camera_driver", "error"),
    [("twin", ExposureError), ("unicam", ExtraFrameError), ("uvcvideo", ExtraFrameError), ("other", ExtraFrameError)],
)
def test_a_unit_that_was_stated_wrongly_is_never_silent(make_small, camera_driver, error):
    small = bench_of(make_small, camera_driver, {"exposure_unit_s": 10e-6}, exposure="microseconds")
    with pytest.raises(error, match="in another unit"):
        small.capture()


@pytest.mark.parametrize("camera_driver", ["twin", "unicam", "uvcvideo", "other"])
def test_the_doctor_measures_the_unit_whatever_is_stamped(make_small, camera_driver):
    small = bench_of(make_small, camera_driver, {"exposure_unit_s": 10e-6}, exposure="microseconds")
    unit = found(small)["unit of exposure"]
    assert (unit.verdict, unit.remedy) == ("bad", "set exposure_unit_s = 1e-06 in [sensor]")
    mended = bench_of(make_small, camera_driver, {"exposure_unit_s": 1e-6}, exposure="microseconds")
    assert found(mended)["unit of exposure"].verdict == "ok"
    mended.capture()


@pytest.mark.parametrize("exposure", ["microseconds", "lines"])
def test_a_unit_that_is_not_known_is_refused_by_the_plan_and_measured_by_the_doctor(make_small, exposure):
    small = bench_of(make_small, "unicam", exposure=exposure, tree_known=False)
    with pytest.raises(PlanRefusedError, match=r"unit of exposure is lines of 10 us or microseconds.*gs2ci doctor"):
        small.capture()
    unit = found(small)["unit of exposure"]
    seconds = "1e-06" if exposure == "microseconds" else "1e-05"
    assert (unit.verdict, unit.remedy) == ("bad", f"set exposure_unit_s = {seconds} in [sensor]")


def test_a_sound_camera_has_its_unit_confirmed(make_small):
    assert found(bench_of(make_small, "unicam"))["unit of exposure"].verdict == "ok"


def test_a_camera_whose_exposure_does_not_follow_its_control_is_told(make_small):
    small = bench_of(make_small, "unicam")
    small.bench.sensor._device._shutter._exposure_s = lambda: 0.004
    unit = found(small)["unit of exposure"]
    assert unit.verdict == "bad"
    assert "ignores" in unit.detail
