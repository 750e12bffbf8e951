"""What cameras and their kernel drivers do where one would guess otherwise, by the twin, which has the sources."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci_drivers.failures import (
    AccessError,
    DeviceFaultError,
    DriverError,
    FrameCorruptError,
    FrameLostError,
    RefusedError,
    UnsupportedError,
)
from gs2ci_drivers.sensor import FrameFlag, StampMeaning, TriggerMode
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_sims.wires.shutter import Shutting
from gs2ci_sims.wires.v4l2_camera import REALTIME_S


def options(**changes):
    return V4l2Options.model_validate({"trigger_adapter": "control"} | changes)


def exposed_s(b):
    b.fire()
    b.sensor.read(0.5)
    return b.world.exposures[-1].end_s - b.world.exposures[-1].start_s


# ---- V1: the unit of exposure


def test_vc_mipi_without_libcamera_counts_exposure_in_microseconds(bench):
    b = bench(exposure="microseconds")
    b.begin(exposure_s=8e-3)
    assert exposed_s(b) == pytest.approx(8e-3)
    assert b.sensor.settings.exposure_s == pytest.approx(8e-3)
    assert b.sensor.info.exposure_unsettled == ""
    assert b.sensor.settings.recorded["vertical_blanking"] == 30  # a frame of more lines allows no longer exposures


def test_vc_mipi_whose_device_tree_cannot_be_read_is_not_trusted_with_either_unit(bench):
    for exposure in ("microseconds", "lines"):
        b = bench(exposure=exposure, tree_known=False)
        assert "lines of 10 us or microseconds" in b.sensor.connect().exposure_unsettled
        stated = bench(options(exposure_unit_s=1e-6), exposure=exposure, tree_known=False)
        assert stated.sensor.connect().exposure_unsettled == ""


@pytest.mark.parametrize("asked", [{}, {"horizontal_blanking": 512}])
def test_limits_are_those_of_the_lines_that_a_capture_will_have_whatever_was_left(bench, asked):
    fresh, left = (bench(options(controls=asked), blanks=True) for _ in range(2))
    bank = left.twin._device._controls
    bank.leave("Horizontal Blanking", 9000)
    bank.leave("Vertical Blanking", 700)
    bank._limit_exposure()
    limits = [(info.min_exposure_s, info.max_exposure_s) for info in (fresh.sensor.connect(), left.sensor.connect())]
    assert limits[0] == pytest.approx(limits[1])
    left.begin(exposure_s=8e-3, controls=asked)
    assert left.sensor.settings.exposure_s == pytest.approx(8e-3, rel=2e-2)
    assert exposed_s(left) == pytest.approx(left.sensor.settings.exposure_s)


# ---- NVIDIA's own controls (Jetson)


@pytest.mark.parametrize("exposure_s", [8e-3, 0.1])
@pytest.mark.parametrize("rate_units", [1_000_000, 1000])
def test_a_jetsons_exposure_is_overridden_and_its_frames_are_long_enough(bench, exposure_s, rate_units):
    """Of 100 ms the 21 frames a second of an imx219 would leave 47.5, and the control would read 100000."""
    b = bench(options(readout_s=1e-3), exposure="tegra", rate_units=rate_units)
    b.begin(exposure_s=exposure_s)
    assert exposed_s(b) == pytest.approx(exposure_s)
    assert b.sensor.settings.exposure_s == pytest.approx(exposure_s)
    assert b.sensor.settings.recorded["override_enable"] == 1
    assert b.sensor.info.max_exposure_s == pytest.approx(0.499)  # at 2 frames a second
    assert b.sensor.incidents == []


def test_a_jetsons_unit_may_be_stated_and_its_gain_left_by_another_program_is_named(bench):
    b = bench(options(readout_s=1e-3, exposure_unit_s=2e-6), exposure="tegra")
    b.begin(exposure_s=8e-3)
    assert b.sensor.settings.recorded["exposure"] == 4000
    other = bench(options(readout_s=1e-3), exposure="tegra")
    other.twin._device._controls.leave("Gain", 160)
    with pytest.raises(UnsupportedError, match=r"gain = 160 \(default 16\)"):
        other.begin()
    stated = bench(options(readout_s=1e-3, gain_db_per_unit=0.1), exposure="tegra")
    stated.begin(gain_db=3.0)
    assert stated.sensor.settings.recorded["gain"] == 30


# ---- rows one after the other


class Flash:
    """Light of 500 DN in the millisecond from `begin_s` on."""

    begin_s = 0.0

    def collect(self, exposure):
        on_s = min(exposure.end_s, self.begin_s + 1e-3) - max(exposure.start_s, self.begin_s)
        return np.full((exposure.height, exposure.width), round(5e5 * max(on_s, 0.0)), np.uint16)


@pytest.mark.parametrize(
    ("stated", "model"),
    [
        ({"shutter": "rolling"}, {}),
        ({}, {"sensor": "imx477"}),
        ({}, {"sensor": "imx708"}),
        ({"trigger_adapter": "module", "trigger_module": "imx477"}, {"trigger": "module", "module": "imx477"}),
    ],
)
def test_a_rolling_sensor_shows_a_short_mask_to_some_rows_and_that_is_told(bench, stated, model):
    """64 rows of 60 us begin within 3.84 ms: a flash at the begin of an exposure of 2 ms reaches the first quarter."""
    b = bench(options(**stated), rolls=True, line_s=60e-6, readout_s=64 * 60e-6, **model)
    b.world.light = Flash()
    b.begin(exposure_s=2e-3)
    b.world.light.begin_s = b.world.clock.now_s() + 1e-3
    b.fire()
    rows = b.sensor.read(0.5).pixels.mean(axis=1)
    assert rows[:16] == pytest.approx(500, abs=5)
    assert (rows[32:] == 0).all()
    assert b.sensor.settings.rows_s == pytest.approx(64 * 60e-6)
    assert any("rolling shutter" in line and "3.84 ms" in line for line in b.sensor.incidents)


@pytest.mark.parametrize(
    ("stated", "model"),
    [
        ({"shutter": "global"}, {"sensor": "imx477"}),
        ({}, {"sensor": "imx296"}),
        ({}, {}),
        ({"trigger_adapter": "module", "trigger_module": "ov7251"}, {"trigger": "module", "module": "ov7251"}),
    ],
)
def test_a_sensor_that_exposes_all_rows_at_once_or_of_which_nothing_is_known_is_not_called_rolling(
    bench, stated, model
):
    b = bench(options(**stated), **model)
    b.begin()
    assert b.sensor.settings.rows_s == 0.0


# ---- V3: numbers of the trigger


@pytest.mark.parametrize(
    ("module", "number", "mode"), [("imx477", 2, "edge"), ("imx296", 1, "level"), ("ov7251", 1, "edge")]
)
def test_a_modules_parameter_gets_the_number_that_this_module_takes(bench, module, number, mode):
    b = bench(options(trigger_adapter="module", trigger_module=module), trigger="module", module=module)
    assert b.sensor.connect().triggers == {TriggerMode.FREE_RUN, TriggerMode(mode)}
    b.begin(trigger=TriggerMode(mode))
    assert b.sensor.settings.recorded[f"{module}.trigger_mode"] == str(number)
    b.world.clock.sleep_s(0.5)
    assert not b.world.exposures, "it runs by its own clock"
    b.sensor.close()
    assert b.twin.read_file(f"/sys/module/{module}/parameters/trigger_mode") == b"0\n"


def test_a_module_that_its_device_tree_alone_switches_is_named_with_its_overlay(bench):
    b = bench(options(trigger_adapter="module", trigger_module="ov9282"), trigger="module", module="ov7251")
    with pytest.raises(UnsupportedError, match=r'dtoverlay=ov9281,trigger-mode=1.*trigger_adapter = "outside"'):
        b.sensor.connect()


def test_the_third_number_of_a_control_is_a_gate_for_vision_components_alone(bench):
    """VEYE's 2 is "high-speed continuous trigger mode": an edge, for exposures of the length that is set."""
    assert bench().sensor.connect().triggers == set(TriggerMode)
    b = bench()
    bank = b.twin._device._controls
    bank._controls = {cid: one for cid, one in bank._controls.items() if one.name != "Single Trigger"}
    assert b.sensor.connect().triggers == {TriggerMode.FREE_RUN, TriggerMode.EDGE}


def test_a_module_of_unknown_numbers_is_refused_until_they_are_stated(bench):
    with pytest.raises(UnsupportedError, match=r"numbers of .*imx708.* not known.*set trigger_values"):
        bench(
            options(trigger_adapter="module", trigger_module="imx708"), trigger="module", module="imx708"
        ).sensor.connect()
    stated = options(trigger_adapter="module", trigger_module="imx708", trigger_values={"free-run": 0, "edge": 1})
    b = bench(stated, trigger="module", module="imx708")
    b.begin()
    assert exposed_s(b) == pytest.approx(2e-3)


def test_a_device_tree_that_overrides_the_parameter_is_named(bench):
    table = options(trigger_adapter="module", trigger_module="imx477")
    with pytest.raises(UnsupportedError, match=r"device tree fixes trigger-mode = 1 .*no effect.*dtoverlay"):
        bench(table, trigger="module", module="imx477", tree_trigger=1).sensor.connect()
    b = bench(table, trigger="module", module="imx477", tree_trigger=2)
    assert b.sensor.connect().triggers == {TriggerMode.EDGE}
    b.begin()
    assert exposed_s(b) == pytest.approx(2e-3)


# ---- V4: bits of Jetson's VI5


@pytest.mark.parametrize(("code", "bits"), [("Y10 ", 10), ("Y12 ", 12)])
def test_repeated_top_bits_are_read_and_the_advice_ends_there(bench, code, bits):
    alignment, tried = "low", []
    while alignment not in tried:
        tried.append(alignment)
        b = bench(options(alignment=alignment), formats=(code,), left_aligned=True, repeats_top=True)
        b.begin()
        b.fire()
        try:
            frame = b.sensor.read(0.5)
        except DriverError as error:
            alignment = str(error).split("set alignment = '")[1].split("' in [sensor] for this camera: their top")[0]
    assert tried == ["low", "repeated"]
    height, width = frame.pixels.shape
    np.testing.assert_array_equal(frame.pixels, np.arange(height * width).reshape(height, width) % 2**bits)


@pytest.mark.parametrize(
    ("stated", "truth"), [("high", "repeated"), ("repeated", "high"), ("repeated", "low"), ("high", "low")]
)
def test_each_wrong_alignment_names_the_right_one(bench, stated, truth):
    b = bench(
        options(alignment=stated), formats=("Y12 ",), left_aligned=truth != "low", repeats_top=truth == "repeated"
    )
    b.begin()
    b.fire()
    with pytest.raises(DriverError, match=rf"set alignment = '{truth}' in \[sensor\]"):
        b.sensor.read(0.5)


@pytest.mark.parametrize(
    ("code", "bus_code", "bits"), [("Y16 ", 0x200A, 10), ("RG16", 0x3012, 12), ("Y16 ", 0x202D, 14)]
)
@pytest.mark.parametrize("driver", ["rp1-cfe", "other"])
def test_what_a_raspberry_pi_5_widens_to_sixteen_bits_is_read_as_the_sensor_sends_it(
    bench, code, bus_code, bits, driver
):
    model = {"on_subdevice": True, "bus_code": bus_code, "significant_bits": bits, "driver": driver}
    b = bench(options(subdevice="/dev/v4l-subdev0"), formats=(code,), left_aligned=driver == "rp1-cfe", **model)
    b.begin(fourcc=code.strip())
    b.fire()
    height, width = (pixels := b.sensor.read(0.5).pixels).shape
    np.testing.assert_array_equal(pixels, np.arange(height * width).reshape(height, width) % 2**bits)
    assert b.sensor.settings.format.bits == bits


@pytest.mark.parametrize("code", ["Y10", "RG12", "Y16", "GREY"])
def test_what_rockchips_receiver_packs_is_read_although_its_code_says_words(bench, code):
    b = bench(driver="rkcif", compact=True, width=396)
    b.config = replace(b.config, fourcc=code)
    b.begin(fourcc=code)
    b.capture_works()


def test_a_sensor_of_another_mosaic_is_refused_whatever_is_widened(bench):
    b = bench(options(subdevice="/dev/v4l-subdev0"), formats=("Y16 ",), on_subdevice=True, bus_code=0x3012)
    with pytest.raises(RefusedError, match="settled on another bus format"):
        b.begin()


def test_bits_that_fit_no_alignment_send_nobody_in_circles(bench):
    b = bench(options(significant_bits=10), formats=("Y16 ",))
    b.begin()
    b.fire()
    with pytest.raises(DriverError, match="no alignment of 10 bits fits: set significant_bits"):
        b.sensor.read(0.5)


# ---- V5: switched by other means


@pytest.mark.parametrize("mode", ["edge", "level"])
def test_a_camera_that_was_switched_outside_is_used_as_stated(bench, mode):
    table = options(trigger_adapter="outside", outside_trigger=mode)
    b = bench(table, trigger="outside", outside=Shutting(mode))
    assert b.sensor.connect().triggers == {TriggerMode(mode)}
    b.begin(trigger=TriggerMode(mode))
    b.fire()
    b.sensor.read(0.5)
    assert b.sensor.settings.recorded["trigger, set outside"] == mode


# ---- V6: the first frame's number


def test_unicams_first_number_is_known(bench):
    for first in (0, 1):
        b = bench(driver="unicam", first_number=first, stamps="start-of-frame")
        b.begin()
        b.fire(3)
        assert [b.sensor.read(0.5).sequence for _ in range(3)] == [0, 1, 2]


def test_an_unknown_drivers_first_number_is_named_with_its_cure(bench):
    b = bench(first_number=1)
    b.begin()
    b.fire(2)
    with pytest.raises(FrameLostError, match=r"numbers its first frame 1: set first_sequence = 1 in \[sensor\]"):
        b.sensor.read(0.5)
    mended = bench(options(first_sequence=1), first_number=1)
    mended.begin()
    mended.fire(2)
    assert [mended.sensor.read(0.5).sequence for _ in range(2)] == [0, 1]


def test_a_frame_that_is_lost_later_is_not_explained_by_the_first_number(bench):
    b = bench()
    b.begin()
    b.faults.inject("v4l2.frame_dropped", skip=1)
    b.fire(3)
    b.sensor.read(0.5)
    with pytest.raises(FrameLostError) as lost:
        b.sensor.read(0.5)
    assert "first_sequence" not in str(lost.value)


# ---- V7: the clock of stamps


def test_stamps_of_clock_realtime_are_named_although_they_are_flagged_as_monotonic(bench):
    table = options(trigger_adapter="none", readout_s=1e-3)
    odd = {"exposure": "absolute", "trigger": "none", "stamps": "start-of-frame"}
    b = bench(table, driver="uvcvideo", ahead_s=REALTIME_S, **odd)
    b.begin(trigger=TriggerMode.FREE_RUN)
    with pytest.raises(DeviceFaultError, match=r"1\.79e\+09 s after the frame's arrival.*uvcvideo/parameters/clock"):
        b.sensor.read(0.5)


@pytest.mark.parametrize("ahead_s", [29.0, -0.4])
def test_a_jetsons_stamps_are_of_its_camera_processors_clock_whatever_their_flag(bench, ahead_s):
    """29 s ahead on a Xavier; a clock that nobody sets drifts behind the computer's on a Nano."""
    b = bench(options(readout_s=1e-3), driver="tegra-video", exposure="tegra", ahead_s=ahead_s, stamps="start-of-frame")
    b.begin()
    b.fire(2)
    frames = [b.sensor.read(0.5) for _ in range(2)]
    assert [frame.flags for frame in frames] == [FrameFlag.STAMPED_AT_FRAME_START] * 2
    assert frames[1].t_kernel_ns * 1e-9 == pytest.approx(b.world.exposures[-1].end_s + ahead_s)


def test_a_jetson_that_waits_in_vain_for_a_frame_says_when_the_first_trigger_has_to_come(bench):
    b = bench(options(readout_s=1e-3), driver="tegra-video", exposure="tegra", stamps="start-of-frame", gives_up_s=2.5)
    b.begin()
    with pytest.raises(
        FrameCorruptError, match=r"where 2\.5 s pass without a frame: let the first trigger come sooner"
    ):
        b.sensor.read(4.0)
    b.sensor.stop()
    b.sensor.start()
    assert exposed_s(b) == pytest.approx(2e-3)


def test_a_single_stamp_of_another_clock_is_named_and_the_next_frame_is_right(bench):
    b = bench()
    b.begin()
    b.faults.inject("v4l2.frame_realtime")
    b.fire(2)
    with pytest.raises(DeviceFaultError, match="counts on another clock"):
        b.sensor.read(0.5)
    assert b.sensor.read(0.5).sequence == 1


def test_an_exposure_that_is_shorter_than_set_is_one_in_the_world(bench):
    """What a capture makes of it is in tests/system/test_faults.py."""
    b = bench()
    b.begin()
    b.faults.inject("v4l2.exposed_short")
    assert exposed_s(b) == pytest.approx(2e-4)


def test_stamps_that_count_from_somewhere_in_the_past_are_of_another_clock_too(bench):
    b = bench()
    b.begin()
    b.faults.inject("v4l2.frame_stale", value=90_000.0)
    b.fire()
    with pytest.raises(DeviceFaultError, match=r"9e\+04 s before the frame's arrival"):
        b.sensor.read(0.5)


def test_uvcvideo_stamps_the_first_packet_and_flags_the_start_of_exposure(bench):
    b = bench(driver="uvcvideo", stamps="start-of-frame", flags_start=True)
    b.begin()
    b.fire()
    frame = b.sensor.read(0.5)
    assert frame.flags & FrameFlag.STAMPED_AT_FRAME_START == StampMeaning.START_OF_FRAME.flag
    assert frame.t_kernel_ns * 1e-9 == pytest.approx(b.world.exposures[-1].end_s)


def test_unicam_stamps_the_frames_start_and_flags_nothing(bench):
    b = bench(driver="unicam", stamps="start-of-frame")
    b.begin()
    b.fire()
    frame = b.sensor.read(0.5)
    assert frame.flags & FrameFlag.STAMPED_AT_FRAME_START
    assert frame.t_kernel_ns * 1e-9 == pytest.approx(b.world.exposures[-1].end_s)


def test_a_parameter_that_may_not_be_written_is_told_with_the_modules_number(bench):
    b = bench(options(trigger_adapter="module", trigger_module="imx477"), trigger="module", module="imx477")
    b.faults.inject("v4l2.parameter_denied")
    with pytest.raises(AccessError, match="options imx477 trigger_mode=2"):
        b.begin()
