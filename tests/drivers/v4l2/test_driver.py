"""The V4L2 driver through its twin: what it sets, in which order, and the pictures that come back."""

import errno
import select
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from gs2ci_drivers.failures import (
    AccessError,
    DeviceFaultError,
    OutOfRangeError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.sensor import FrameFlag, SensorConfig, TriggerMode
from gs2ci_drivers.v4l2.driver import V4l2Sensor, list_cameras
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_sims.wires.v4l2_camera import BITS

Build = Callable[..., Any]
CONTROL = V4l2Options(trigger_adapter="control")


def ramp(index: int, height: int, width: int, bits: int) -> np.ndarray:
    return ((np.arange(height * width).reshape(height, width) + 7 * index) % 2**bits).astype(np.uint16)


@pytest.mark.parametrize("multi_plane", [False, True], ids=["single-plane", "multi-plane"])
@pytest.mark.parametrize("code", sorted(BITS))
def test_every_format_comes_through_pixel_for_pixel(bench: Build, code: str, multi_plane: bool) -> None:
    b = bench(formats=(code,), stride_multiple=64, multi_plane=multi_plane, header_bytes=24)
    b.begin(fourcc=code.strip())
    b.fire(3)
    for index in range(3):
        frame = b.sensor.read(0.5)
        np.testing.assert_array_equal(frame.pixels, ramp(index, 64, 96, BITS[code]))
        assert frame.sequence == index
        assert frame.flags == FrameFlag.STAMPED_MONOTONIC
    settings = b.sensor.settings
    assert settings.stride % 64 == 0
    assert (settings.format.height, settings.format.width, settings.format.bits) == (64, 96, BITS[code])


def test_left_aligned_twelve_bits_in_sixteen_come_out_right_aligned(bench: Build) -> None:
    options = CONTROL.model_copy(update={"significant_bits": 12, "alignment": "high"})
    b = bench(options, formats=("Y16 ",), significant_bits=12, left_aligned=True)
    b.begin()
    b.fire()
    np.testing.assert_array_equal(b.sensor.read(0.5).pixels, ramp(0, 64, 96, 12))
    assert b.sensor.settings.format.top == 4095


def test_the_calls_are_made_in_the_order_that_kernel_drivers_expect(bench: Build) -> None:
    b = bench()
    b.begin(buffers=2)
    b.fire()
    b.sensor.read(0.5)
    b.sensor.close()
    wanted = ["open", "QUERYCAP", "S_FMT", "S_EXT_CTRLS", "REQBUFS", "QUERYBUF", "mmap", "QUERYBUF", "mmap"]
    wanted += ["QBUF", "QBUF", "SUBSCRIBE_EVENT", "SUBSCRIBE_EVENT", "STREAMON", "STREAMOFF", "QBUF", "QBUF"]
    wanted += ["SUBSCRIBE_EVENT", "SUBSCRIBE_EVENT", "STREAMON", "poll", "DQBUF", "QBUF", "STREAMOFF", "REQBUFS"]
    calls = [c for c in (call.removeprefix("VIDIOC_") for call in b.twin.calls) if c in wanted]
    start = calls.index("S_FMT")
    settings_end = calls.index("REQBUFS")
    assert calls[:2] == ["open", "QUERYCAP"]
    assert set(calls[start + 1 : settings_end]) == {"S_EXT_CTRLS"}
    assert calls[settings_end : settings_end + len(wanted) - 4] == wanted[4:]
    assert b.twin.calls[-1] == "close"


def test_connecting_changes_nothing_on_the_device(bench: Build) -> None:
    b = bench()
    b.sensor.connect()
    calls = {call.removeprefix("VIDIOC_") for call in b.twin.calls}
    assert not {"S_FMT", "S_EXT_CTRLS", "REQBUFS", "STREAMON", "SUBDEV_S_FMT"} & calls


def test_info_lists_raw_formats_limits_triggers_and_controls(bench: Build) -> None:
    info = bench(formats=("Y10 ", "pRAA")).sensor.connect()
    assert [(f.fourcc, f.height, f.width, f.bits, f.cfa) for f in info.formats] == [
        ("Y10", 64, 96, 10, None),
        ("pRAA", 64, 96, 10, "RGGB"),
    ]
    assert (info.model, info.serial, info.driver) == ("Twin camera", "platform:twin", "twin 6.1.0")
    assert info.triggers == {TriggerMode.FREE_RUN, TriggerMode.EDGE, TriggerMode.LEVEL}
    assert info.exposure_step_s == pytest.approx(10e-6)
    assert info.controls["exposure"] == "1..90 step 1"
    assert "1 (External)" in info.controls["trigger_mode"]
    assert "pixel_rate" not in info.controls


def test_a_converter_of_fewer_bits_is_told_in_the_formats(bench: Build) -> None:
    info = bench(CONTROL.model_copy(update={"significant_bits": 12}), formats=("Y16 ", "GREY")).sensor.connect()
    assert [f.bits for f in info.formats] == [12, 8]


# ---- exposure and controls


def test_exposure_in_lines_is_quantised_and_told(bench: Build) -> None:
    b = bench(line_s=10e-6)
    b.begin(exposure_s=0.123456e-3)
    assert b.sensor.settings.exposure_s == pytest.approx(120e-6)
    b.fire()
    b.sensor.read(0.5)
    last = b.world.exposures[-1]
    assert last.end_s - last.start_s == pytest.approx(120e-6)


def test_an_exposure_longer_than_the_frame_lengthens_the_blanking_first(bench: Build) -> None:
    b = bench(line_s=10e-6)
    b.begin(exposure_s=0.05)
    assert b.sensor.settings.exposure_s == pytest.approx(0.05)
    b.fire(1)
    b.sensor.read(0.5)
    last = b.world.exposures[-1]
    assert last.end_s - last.start_s == pytest.approx(0.05)


def test_exposure_in_100_us_units_needs_the_automatic_off(bench: Build) -> None:
    options = CONTROL.model_copy(update={"readout_s": 1e-3})
    b = bench(options, exposure="absolute")
    b.begin(exposure_s=2.34e-3)
    assert b.sensor.settings.exposure_s == pytest.approx(2.3e-3)
    b.fire()
    b.sensor.read(0.5)
    last = b.world.exposures[-1]
    assert last.end_s - last.start_s == pytest.approx(2.3e-3)


def test_a_line_time_of_the_users_beats_the_drivers(bench: Build) -> None:
    b = bench(CONTROL.model_copy(update={"exposure_unit_s": 20e-6}), line_s=10e-6)
    b.begin(exposure_s=1e-3)
    assert b.sensor.settings.recorded["gain_automatic"] == 0
    assert b.sensor.settings.exposure_s == pytest.approx(1e-3)


def test_a_camera_without_exposure_control_needs_the_users_word(bench: Build) -> None:
    b = bench(CONTROL.model_copy(update={"readout_s": 1e-3}), exposure="none")
    with pytest.raises(UnsupportedError, match=r"exposure_unit_s.*fixed_exposure_s"):
        b.begin()
    b = bench(CONTROL.model_copy(update={"readout_s": 1e-3, "fixed_exposure_s": 5e-3}), exposure="none")
    b.begin(exposure_s=5e-3)
    assert b.sensor.settings.exposure_s == 5e-3
    b = bench(CONTROL.model_copy(update={"readout_s": 1e-3, "fixed_exposure_s": 5e-3}), exposure="none")
    with pytest.raises(OutOfRangeError, match=r"0\.002 s"):
        b.begin()


def test_an_unknown_readout_time_is_asked_of_the_user_where_it_matters(bench: Build) -> None:
    options = CONTROL.model_copy(update={"fixed_exposure_s": 5e-3})
    b = bench(options, exposure="none")
    with pytest.raises(UnsupportedError, match="set `readout_s`"):
        b.begin(exposure_s=5e-3)
    b.begin(exposure_s=5e-3, trigger=TriggerMode.FREE_RUN)
    assert b.sensor.settings.readout_s == 0.0


def test_readout_is_one_frames_lines_where_the_driver_tells_them(bench: Build) -> None:
    b = bench(line_s=10e-6)
    b.begin()
    assert b.sensor.settings.readout_s == pytest.approx(64 * 10e-6)


def test_controls_are_clamped_by_the_device_and_that_is_told(bench: Build) -> None:
    b = bench()
    b.begin(controls={"Analogue Gain": 1000, "io_mode": 2})
    applied = {a.control: a for a in b.sensor.applied_controls}
    assert (applied["analogue_gain"].requested, applied["analogue_gain"].applied) == (1000, 480)
    assert applied["analogue_gain"].clamped
    assert not applied["io_mode"].clamped


def test_a_control_that_is_not_there_names_the_nearest(bench: Build) -> None:
    b = bench()
    with pytest.raises(UnsupportedError, match=r"analog_gain.*allowed: .*analogue_gain"):
        b.begin(controls={"analog_gain": 1})


def test_a_menu_entry_that_is_not_there_lists_those_that_are(bench: Build) -> None:
    b = bench(CONTROL.model_copy(update={"readout_s": 1e-3}), exposure="absolute")
    with pytest.raises(OutOfRangeError, match=r"1 \(Manual Mode\), 3 \(Aperture"):
        b.begin(controls={"auto_exposure": 2})


def test_a_read_only_control_is_refused_before_it_is_sent(bench: Build) -> None:
    b = bench()
    with pytest.raises(AccessError, match="pixel_rate is read-only"):
        b.begin(controls={"pixel_rate": 1})


def test_a_button_can_be_pressed(bench: Build) -> None:
    b = bench()
    b.begin(controls={"single_trigger": 1})
    assert not b.sensor.applied_controls[-1].clamped


def test_gain_in_db_needs_its_unit(bench: Build) -> None:
    b = bench()
    with pytest.raises(UnsupportedError, match="gain_db_per_unit"):
        b.begin(gain_db=6.0)
    b = bench(CONTROL.model_copy(update={"gain_db_per_unit": 0.1}))
    b.begin(gain_db=6.0)
    assert {a.control: a.applied for a in b.sensor.applied_controls}["analogue_gain"] == 60


REGION = {"crops": True, "height": 1088, "width": 1456}
SUBDEVICE = V4l2Options(trigger_adapter="control", subdevice="/dev/v4l-subdev0", readout_s=1e-3)


def test_controls_and_bus_format_go_to_the_sub_device_where_there_is_one(bench: Build) -> None:
    b = bench(CONTROL.model_copy(update={"subdevice": "/dev/v4l-subdev0"}), on_subdevice=True)
    b.begin(height=32, width=48, fourcc="Y10P")
    assert "VIDIOC_SUBDEV_S_FMT" in b.twin.calls
    b.fire()
    assert b.sensor.read(0.5).pixels.shape == (32, 48)
    b.sensor.close()
    assert list(b.twin.calls)[-2:] == ["close", "close"]


@pytest.mark.parametrize("crops", [True, False])
def test_the_largest_size_is_the_sensors_and_not_what_a_capture_node_accepts(bench: Build, crops: bool) -> None:
    """Beside a sensor's own node any size is accepted; 16384 x 16384 would be the masks' size, too."""
    b = bench(SUBDEVICE, on_subdevice=True, crops=crops, height=1088, width=1456)
    b.twin.calls.clear()
    found = b.sensor.connect().formats
    assert {(one.height, one.width) for one in found} == {(1088, 1456)}
    assert b.twin.region == (0, 0, 1088, 1456)
    b.begin(fourcc="Y10", height=found[0].height, width=found[0].width)
    b.fire()
    assert b.sensor.read(0.5).pixels.shape == (1088, 1456)


def test_without_the_sub_device_such_a_camera_has_no_controls(bench: Build) -> None:
    b = bench(on_subdevice=True)
    with pytest.raises(UnsupportedError, match=r"trigger_mode.*subdevice"):
        b.sensor.connect()


# ---- triggers


def test_the_imx296_exposes_as_long_as_its_line_is_low_plus_the_offset(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="module", readout_s=1e-3), trigger="module", exposure_offset_s=14.26e-6)
    b.begin(trigger=TriggerMode.LEVEL, exposure_s=123.0)
    assert b.sensor.settings.exposure_offset_s == pytest.approx(14.26e-6)
    b.world.bus.drive("dmd0.out2", True)
    b.world.clock.after(1e-3, lambda: b.world.bus.pulse("dmd0.out2", 3e-3, level=False))
    b.sensor.read(0.5)
    last = b.world.exposures[-1]
    assert last.end_s - last.start_s == pytest.approx(3e-3 + 14.26e-6)


@pytest.mark.parametrize("on_subdevice", [True, False])
def test_a_region_is_read_out_from_the_middle_of_a_larger_sensor(bench: Build, on_subdevice: bool) -> None:
    options = SUBDEVICE if on_subdevice else CONTROL
    b = bench(options, on_subdevice=on_subdevice, **REGION)
    b.begin(height=400, width=600, fourcc="Y10")
    assert b.twin.region == (344, 428, 400, 600)
    b.fire()
    assert b.sensor.read(0.5).pixels.shape == (400, 600)


def test_a_region_that_the_sensor_moves_is_told_and_one_that_it_widens_is_refused(bench: Build) -> None:
    b = bench(SUBDEVICE, on_subdevice=True, **REGION)
    b.begin(height=400, width=600, top=101, left=8)
    assert b.twin.region == (104, 8, 400, 600)
    assert [text for text in b.sensor.incidents if "top = 101" in text and "104 is set" in text]
    b.sensor.stop()
    with pytest.raises(UnsupportedError, match=r"reads out 404 x 600 instead.*allowed: 404 x 600"):
        b.begin(height=402, width=600)
    with pytest.raises(OutOfRangeError, match=r"leaves the pixel array.*inside 1088 x 1456"):
        b.begin(height=400, width=600, top=800)


def test_a_place_is_refused_where_the_kernel_driver_knows_no_regions(bench: Build) -> None:
    b = bench()
    with pytest.raises(UnsupportedError, match=r"knows no regions.*subdevice"):
        b.begin(height=32, width=48, left=4)


def test_the_module_parameter_is_taken_in_only_after_power_down_and_the_driver_waits_for_it(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="module", readout_s=1e-3), trigger="module")
    b.begin(trigger=TriggerMode.FREE_RUN)
    b.sensor.read(0.5)
    b.sensor.stop()
    b.begin(trigger=TriggerMode.LEVEL)
    with pytest.raises(Exception, match="no frame 0"):
        b.sensor.read(0.5)


def test_warm_up_runs_by_the_sensors_own_clock_and_leaves_no_trace(bench: Build) -> None:
    b = bench()
    b.begin(warm_up_frames=3)
    assert len(b.world.exposures) >= 3
    b.fire()
    frame = b.sensor.read(0.5)
    assert frame.sequence == 0
    np.testing.assert_array_equal(frame.pixels, ramp(len(b.world.exposures) - 1, 64, 96, 10))


def test_the_trigger_is_put_back_on_close(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="module", readout_s=1e-3), trigger="module")
    b.begin(trigger=TriggerMode.LEVEL)
    path = "/sys/module/imx296/parameters/trigger_mode"
    assert b.twin.read_file(path) == b"1\n"
    b.sensor.close()
    assert b.twin.read_file(path) == b"0\n"


def test_a_module_that_is_not_loaded_is_named(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="module", trigger_module="imx477"), trigger="module")
    with pytest.raises(UnsupportedError, match=r"'imx477' is not loaded.*trigger_module"):
        b.sensor.connect()


def test_a_parameter_that_may_not_be_written_tells_how_to_set_it(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="module", readout_s=1e-3), trigger="module")
    b.faults.inject("v4l2.parameter_denied")
    with pytest.raises(AccessError, match=r"options imx296 trigger_mode=1"):
        b.begin(trigger=TriggerMode.LEVEL)
    b.begin(trigger=TriggerMode.LEVEL)


def test_a_parameter_that_keeps_its_value_is_noticed(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="module", readout_s=1e-3), trigger="module")
    b.faults.inject("v4l2.parameter_ignored")
    with pytest.raises(UnsupportedError, match=r"reads b'0' after b'1'"):
        b.begin(trigger=TriggerMode.LEVEL)


def test_a_trigger_control_without_our_values_is_refused(bench: Build) -> None:
    values = {TriggerMode.EDGE: 77}
    b = bench(V4l2Options(trigger_adapter="control", trigger_values=values))
    with pytest.raises(UnsupportedError, match=r"\[77\].*trigger_values"):
        b.sensor.connect()


def test_a_sensor_without_trigger_runs_freely_only(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="none"), trigger="none")
    with pytest.raises(UnsupportedError, match="free-run"):
        b.begin()
    b.begin(trigger=TriggerMode.FREE_RUN)
    assert [b.sensor.read(0.5).sequence for _ in range(6)] == list(range(6))


def test_edges_closer_than_exposure_and_readout_are_lost_without_a_gap(bench: Build) -> None:
    b = bench(readout_s=5e-3)
    b.begin(exposure_s=2e-3)
    b.fire(4, period_s=4e-3)
    assert [b.sensor.read(0.1).sequence for _ in range(2)] == [0, 1]
    with pytest.raises(Exception, match="no frame 2"):
        b.sensor.read(0.1)


# ---- formats and nodes


def test_what_the_driver_makes_of_the_size_is_read_back(bench: Build) -> None:
    b = bench()
    b.begin(height=51, width=50)
    assert (b.sensor.settings.format.height, b.sensor.settings.format.width) == (50, 48)
    b.fire()
    assert b.sensor.read(0.5).pixels.shape == (50, 48)


def test_a_driver_that_changes_the_size_is_believed(bench: Build) -> None:
    b = bench()
    b.faults.inject("v4l2.size_changed")
    b.begin()
    assert b.sensor.settings.format.height == 32
    b.fire()
    assert b.sensor.read(0.5).pixels.shape == (32, 96)


def test_a_driver_that_answers_with_another_format_is_not_believed(bench: Build) -> None:
    b = bench()
    b.faults.inject("v4l2.format_changed")
    with pytest.raises(UnsupportedError, match=r"answered GREY .* to Y10"):
        b.begin()


def test_fewer_buffers_than_asked_for_will_do(bench: Build) -> None:
    b = bench(max_buffers=2)
    b.begin(buffers=8)
    assert b.sensor.settings.buffers == 2
    b.fire(5)
    assert [b.sensor.read(0.5).sequence for _ in range(5)] == list(range(5))


def test_no_buffer_at_all_is_a_fault(bench: Build) -> None:
    b = bench()
    b.faults.inject("v4l2.buffers_fewer", value=0)
    with pytest.raises(DeviceFaultError, match="no buffer"):
        b.begin()
    b.capture_works()


def test_a_second_opener_is_told_that_the_camera_is_in_use(bench: Build) -> None:
    b = bench()
    b.begin()
    other = V4l2Sensor("cam1", b.twin, b.world.clock, CONTROL)
    other.connect()
    with pytest.raises(AccessError, match="EBUSY"):
        other.configure(b.config)
    other.close()
    b.fire()
    assert b.sensor.read(0.5).sequence == 0


def test_a_camera_without_raw_formats_is_refused_with_those_it_has(bench: Build, monkeypatch: Any) -> None:
    b = bench(formats=("GREY",))
    monkeypatch.setattr("gs2ci_drivers.v4l2.setup.PIXEL_FORMATS", {})
    with pytest.raises(UnsupportedError, match="it offers GREY"):
        b.sensor.connect()


def test_a_node_that_does_not_capture_is_refused(bench: Build, monkeypatch: Any) -> None:
    b = bench()
    monkeypatch.setattr("gs2ci_sims.wires.v4l2_device.CAP_CAPTURE", 0x2)
    with pytest.raises(UnsupportedError, match="no streaming capture node"):
        b.sensor.connect()
    assert b.twin.calls[-1] == "close"


def test_a_missing_node_is_an_access_error(bench: Build) -> None:
    b = bench(V4l2Options(port="/dev/video9"))
    with pytest.raises(AccessError, match="ENOENT"):
        b.sensor.connect()


def test_list_cameras_tells_who_is_there_and_skips_those_that_do_not_answer(bench: Build) -> None:
    b = bench()
    assert [(path, who.card) for path, who in list_cameras(b.twin)] == [("/dev/video0", "Twin camera")]
    b.faults.inject("v4l2.call_fails", value=errno.EACCES, about="open")
    assert list_cameras(b.twin) == []
    b.faults.inject("v4l2.call_fails", value=errno.EIO, about="QUERYCAP")
    assert list_cameras(b.twin) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trigger_adapter": "gpio"}, "trigger_adapter"),
        ({"alignment": "left"}, "alignment"),
        ({"significant_bits": 17}, "significant_bits"),
        ({"fixed_exposure_s": 0.0}, "fixed_exposure_s"),
        ({"readout_s": -1.0}, "readout_s"),
        ({"trigger_module": "../kernel"}, "trigger_module"),
    ],
)
def test_options_that_cannot_be_used_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        V4l2Options(**options)


def test_stopping_twice_and_closing_twice_do_no_harm(bench: Build) -> None:
    b = bench()
    b.sensor.stop()
    b.begin()
    b.sensor.stop()
    b.sensor.stop()
    b.sensor.close()
    b.sensor.close()
    with pytest.raises(WrongStateError, match="closed"):
        b.sensor.read(0.1)


def test_discard_throws_away_what_waits_and_keeps_count(bench: Build) -> None:
    b = bench()
    b.begin()
    b.fire(3)
    b.world.clock.sleep_s(0.2)
    assert b.sensor.discard() == 3
    assert b.sensor.discard() == 0
    b.fire()
    assert b.sensor.read(0.5).sequence == 3


def test_frame_times_are_those_of_the_exposure_on_the_worlds_clock(bench: Build) -> None:
    b = bench(stamps="start-of-exposure", flags_start=True)
    b.begin()
    b.fire()
    frame = b.sensor.read(0.5)
    assert frame.flags & FrameFlag.STAMPED_AT_START
    assert frame.t_kernel_ns == pytest.approx(b.world.exposures[-1].start_s * 1e9, abs=1001)
    assert frame.t_host_ns == b.world.clock.now_ns()


def test_a_frame_that_begins_while_the_start_is_under_way_is_not_stale(bench: Build, monkeypatch: Any) -> None:
    b = bench(V4l2Options(trigger_adapter="none"), trigger="none", stamps="start-of-exposure", flags_start=True)
    ioctl = b.twin.ioctl

    def slow(fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        result = ioctl(fd, request, argument, payload)
        b.world.clock.sleep_s(1e-3)
        return int(result)

    monkeypatch.setattr(b.twin, "ioctl", slow)
    b.begin(trigger=TriggerMode.FREE_RUN)
    assert b.sensor.read(0.5).sequence == 0


def test_frame_numbers_may_wrap(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="control", first_sequence=-1))
    b.faults.inject("v4l2.first_number", value=2**32 - 2, skip=1)
    b.begin()
    b.fire(4)
    assert [b.sensor.read(0.5).sequence for _ in range(4)] == [0, 1, 2, 3]


def test_a_camera_that_goes_on_counting_can_be_declared(bench: Build) -> None:
    b = bench(V4l2Options(trigger_adapter="control", first_sequence=-1), restarts_numbers=False)
    for _ in range(2):
        b.begin()
        b.fire(2)
        assert [b.sensor.read(0.5).sequence for _ in range(2)] == [0, 1]
        b.sensor.stop()


def test_status_counts(bench: Build) -> None:
    b = bench()
    b.sensor.connect()
    assert not b.sensor.status().streaming
    b.begin()
    b.fire()
    b.sensor.read(0.5)
    status = b.sensor.status()
    assert (status.streaming, status.delivered, status.lost, status.corrupt) == (True, 1, 0, 0)


def test_poll_is_asked_for_frames_and_events(bench: Build, monkeypatch: Any) -> None:
    b = bench()
    b.begin()
    asked = []
    poll = b.twin.poll
    monkeypatch.setattr(b.twin, "poll", lambda fd, events, t: asked.append((events, t)) or poll(fd, events, t))
    b.fire()
    b.sensor.read(0.25)
    assert asked == [(select.POLLIN | select.POLLPRI, pytest.approx(0.25))]


def test_a_config_with_nothing_set_takes_the_devices_present_format(bench: Build) -> None:
    b = bench(formats=("Y12P",))
    b.sensor.connect()
    settings = b.sensor.configure(SensorConfig(exposure_s=1e-3))
    assert (settings.format.fourcc, settings.format.height, settings.format.width) == ("Y12P", 64, 96)
