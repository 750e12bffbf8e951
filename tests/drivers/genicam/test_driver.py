"""A GenICam camera through its driver: set-up, region, triggers and their delays, stamps, lost and bad buffers."""

import numpy as np
import pytest

from gs2ci_drivers.failures import (
    AccessError,
    DeviceFaultError,
    DisconnectedError,
    FrameCorruptError,
    FrameLostError,
    FrameStaleError,
    OutOfRangeError,
    RefusedError,
    TriggerTimeoutError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.genicam.driver import GenicamSensor
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.sensor import FrameFlag, SensorConfig, StampMeaning, TriggerMode
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.world import Exposure, World
from tests.twins.genicam import GenicamModel, GenicamTwin

LINE = "dmd0.out"


class Ramp:
    """Light that tells the column, so that a region in the wrong place is seen."""

    def collect(self, exposure: Exposure) -> np.ndarray:
        return np.broadcast_to(np.arange(exposure.width) % 200, (exposure.height, exposure.width)).astype(np.uint16)


class Bench:
    def __init__(self, model: GenicamModel, **table: object) -> None:
        self.world, self.faults = World(Ramp()), FaultSet()
        self.twin = GenicamTwin(self.world, model, self.faults)
        options = GenicamOptions.model_validate({"kind": "genicam"} | table)
        self.sensor = GenicamSensor("cam0", self.twin, self.world.clock, options)
        self.sensor.connect()

    def start(self, mode: TriggerMode = TriggerMode.EDGE, **config: object) -> None:
        self.sensor.configure(SensorConfig(**({"exposure_s": 2e-3, "trigger": mode} | config)))
        self.sensor.start()

    def pulse(self, count: int = 1, width_s: float = 1e-3) -> float:
        """Send pulses 20 ms apart; return when the first one rises."""
        clock = self.world.clock
        for i in range(count):
            clock.after(5e-3 + 0.02 * i, lambda: self.world.bus.pulse(LINE, width_s))
        return clock.now_s() + 5e-3


def bench(model=None, **table):
    return Bench(model or GenicamModel(trigger_line=LINE), **table)


def value(one, name):
    return one.twin.nodes.read(name)


@pytest.mark.parametrize("name", ["Mono8", "Mono12", "Mono12p", "Mono10p", "Mono12Packed", "Mono10Packed", "BayerRG12"])
@pytest.mark.parametrize("padding", [0, 4])
def test_every_pixel_format_gives_the_same_picture(name, padding):
    one = bench(GenicamModel(trigger_line=LINE, formats=("Mono8", "Mono10Packed", name), padding_bytes=padding))
    one.start(fourcc=name)
    one.pulse()
    frame = one.sensor.read(0.5)
    np.testing.assert_array_equal(frame.pixels[3], np.arange(96))
    assert one.sensor.settings.format.cfa == ("RGGB" if name.startswith("Bayer") else None)


@pytest.mark.parametrize(
    ("name", "left"),
    [
        ("BinningHorizontal", 2),
        ("BinningVertical", 2),
        ("ReverseX", True),
        ("Gamma", 0.45),
        ("TestPattern", "GreyHorizontalRamp"),
    ],
)
def test_what_somebody_else_has_left_set_is_set_back_and_told(name, left):
    one = bench()
    neutral = value(one, name)
    one.twin.nodes.write(name, left)
    one.start(height=32, width=48, top=0, left=0)
    one.pulse()
    np.testing.assert_array_equal(one.sensor.read(0.5).pixels[3], np.arange(48))
    assert value(one, name) == neutral
    assert [text for text in one.sensor.incidents if f"{name} was {left} and" in text]


def test_what_the_rig_file_asks_for_is_left_and_bends_the_picture():
    one = bench(features={"ReverseX": True})
    one.twin.nodes.write("ReverseX", True)
    one.start()
    one.pulse()
    np.testing.assert_array_equal(one.sensor.read(0.5).pixels[3], np.arange(96)[::-1])
    assert one.sensor.incidents == []


def test_a_camera_that_will_not_set_it_back_is_refused_rather_than_mirrored():
    one = bench()
    one.twin.nodes.write("ReverseX", True)
    one.faults.inject("genicam.feature_refused", about="ReverseX")
    with pytest.raises(RefusedError, match="ReverseX"):
        one.start()


def test_exposure_gain_and_features_are_set_and_automatics_are_off():
    one = bench(features={"AcquisitionFrameRate": 12.3456})
    one.start(exposure_s=4.56789e-3, gain_db=6.0)
    assert one.sensor.settings.exposure_s == pytest.approx(4.568e-3)  # in steps of 0.5 us
    assert value(one, "ExposureTime") == pytest.approx(4568.0)
    assert value(one, "Gain") == pytest.approx(6.0)
    assert value(one, "ExposureAuto") == value(one, "GainAuto") == "Off"
    assert any("AcquisitionFrameRate = 12.3456 was requested, 12.346" in text for text in one.sensor.incidents)


@pytest.mark.parametrize("tells", ["rate", "allied", "balluff", "limit"])
@pytest.mark.parametrize("mode", list(TriggerMode))
@pytest.mark.parametrize("exposure_s", [2e-5, 1e-3, 0.02, 0.5, 10.0])
@pytest.mark.parametrize(("period_s", "readout_s"), [(1 / 60, 1e-3), (1 / 200, 0.03)])
def test_the_readout_follows_from_the_highest_rate_whatever_the_exposure(tells, mode, exposure_s, period_s, readout_s):
    model = GenicamModel(trigger_line=LINE, own_period_s=period_s, readout_s=readout_s, tells=tells)
    one = bench(model)
    settings = one.sensor.configure(SensorConfig(exposure_s=exposure_s, trigger=mode))
    shortest_s = 20e-6
    assert settings.readout_s == pytest.approx(max(period_s, shortest_s + readout_s), rel=1e-9)
    assert settings.exposure_s == pytest.approx(exposure_s, abs=1e-6)
    if mode is not TriggerMode.LEVEL:
        assert value(one, "ExposureTime") == pytest.approx(exposure_s / 1e-6, abs=0.5)


@pytest.mark.parametrize("mode", [TriggerMode.EDGE, TriggerMode.LEVEL])
def test_a_camera_that_computes_no_rate_needs_its_readout_in_the_rig_file(mode):
    model = GenicamModel(trigger_line=LINE, tells="nothing")
    with pytest.raises(UnsupportedError, match=rf"trigger mode {mode.value}: .*set `readout_s` in \[sensor\]"):
        bench(model).sensor.configure(SensorConfig(exposure_s=1e-3, trigger=mode))
    config = SensorConfig(exposure_s=1e-3, trigger=mode)
    assert bench(model, readout_s=7e-3).sensor.configure(config).readout_s == 7e-3
    free = SensorConfig(exposure_s=1e-3, trigger=TriggerMode.FREE_RUN)
    assert bench(model).sensor.configure(free).readout_s == 0.0


@pytest.mark.parametrize("gone", [("ExposureTime",), ("AcquisitionFrameRate",)])
def test_a_rate_that_cannot_be_compared_is_none(gone):
    one = bench(GenicamModel(trigger_line=LINE, tells="limit"), fixed_exposure_s=2e-3)
    for name in gone:
        del one.twin.nodes._nodes[name]
    with pytest.raises(UnsupportedError, match="readout_s"):
        one.sensor.configure(SensorConfig(exposure_s=2e-3))


def test_a_region_lies_in_the_middle_or_where_it_is_wanted_on_the_cameras_grid():
    one = bench()
    one.start(height=32, width=40)
    assert one.twin.region == (16, 28, 32, 40)
    one.sensor.stop()
    one.start(height=32, width=40, top=10, left=21)
    assert one.twin.region == (10, 20, 32, 40)
    assert any("OffsetX = 21 was requested, 20 is set" in text for text in one.sensor.incidents)
    one.sensor.stop()
    one.start(height=64, width=96)  # wider than the offset left room for
    assert one.twin.region == (0, 0, 64, 96)


def test_a_size_that_the_camera_would_change_is_refused_with_the_nearest():
    one = bench()
    with pytest.raises(OutOfRangeError, match=r"Width = 42; allowed: 8 to 96 by 4; .*nearest is 40"):
        one.sensor.configure(SensorConfig(width=42, height=32))


@pytest.mark.parametrize(
    ("asked", "nearest"), [((47, 60), 46), ((1, 60), 4), ((200, 60), 46), ((46, 61), 60), ((46, 5), 8)]
)
def test_the_nearest_size_is_taken_also_where_the_sensors_own_is_none(asked, nearest):
    """A sensor of 47 x 61 pixels in steps of 2 and 4."""
    one = bench(GenicamModel(trigger_line=LINE, height=47, width=61))
    height, width = asked
    with pytest.raises(OutOfRangeError, match=rf"the nearest is {nearest}: set `(height|width)`") as refused:
        one.sensor.configure(SensorConfig(height=height, width=width))
    name = "height" if "`height`" in refused.value.remedy else "width"
    mended = {"height": height, "width": width} | {name: nearest}
    assert getattr(one.sensor.configure(SensorConfig(**mended)).format, name) == nearest
    whole = one.sensor.configure(SensorConfig()).format
    assert (whole.height, whole.width) == (46, 60)


def test_the_delay_that_is_set_and_the_latency_that_is_known_are_in_the_exposure_and_in_the_settings():
    model = GenicamModel(trigger_line=LINE, latency_s=20e-6)
    one = bench(model, trigger_delay_s=3e-3, trigger_latency_s=20e-6)
    one.start()
    rise_s = one.pulse()
    frame = one.sensor.read(0.5)
    assert one.world.exposures[-1].start_s == pytest.approx(rise_s + 3.02e-3, abs=1e-9)
    assert one.sensor.settings.trigger_delay_s == pytest.approx(3.02e-3)
    assert frame.t_kernel_ns * 1e-9 == pytest.approx(rise_s + 3.02e-3, abs=2e-4)


def test_times_that_are_integers_are_set_to_their_nearest_steps():
    model = GenicamModel(trigger_line=LINE, whole_us=4)
    one = bench(model, trigger_delay_s=9.3e-6)
    one.start(exposure_s=2.0015e-3)
    rise_s = one.pulse()
    one.sensor.read(0.5)
    exposure = one.world.exposures[-1]
    assert one.sensor.settings.exposure_s == pytest.approx(2.0e-3)
    assert exposure.end_s - exposure.start_s == pytest.approx(2.0e-3)
    assert exposure.start_s == pytest.approx(rise_s + 8e-6, abs=1e-9)


def test_a_gated_exposure_lasts_as_long_as_its_line_is_held():
    one = bench(GenicamModel(trigger_line=LINE, exposure_offset_s=1e-4), exposure_offset_s=1e-4)
    one.start(TriggerMode.LEVEL)
    one.pulse(width_s=7e-3)
    one.sensor.read(0.5)
    assert one.world.exposures[-1].end_s - one.world.exposures[-1].start_s == pytest.approx(7.1e-3)


@pytest.mark.parametrize("kind", ["FrameBurstStart", "ExposureStart"])
def test_a_trigger_of_another_kind_that_was_left_on_does_not_hold_frames_up(kind):
    one = bench()
    one.twin.nodes.write("TriggerSelector", kind)
    one.twin.nodes.write("TriggerMode", "On")
    one.start()
    one.pulse()
    assert one.sensor.read(0.5).sequence == 0


def test_the_camera_is_waited_for_until_it_listens_for_triggers():
    one = bench(GenicamModel(trigger_line=LINE, ready_s=0.2))
    begin_s = one.world.clock.now_s()
    one.start()
    assert one.world.clock.now_s() - begin_s >= 0.2
    one.pulse()
    assert one.sensor.read(0.5).sequence == 0


def test_a_camera_that_never_listens_is_named():
    one = bench()
    one.faults.inject("genicam.never_ready")
    with pytest.raises(DeviceFaultError, match="FrameTriggerWait"):
        one.start()


@pytest.mark.parametrize(
    ("stamps", "meaning", "flag"),
    [
        ("start-of-exposure", StampMeaning.START_OF_EXPOSURE, FrameFlag.STAMPED_AT_START),
        ("start-of-frame", StampMeaning.START_OF_FRAME, FrameFlag.STAMPED_AT_FRAME_START),
        ("end-of-frame", StampMeaning.END_OF_FRAME, FrameFlag.NONE),
    ],
)
@pytest.mark.parametrize("chunks", [True, False])
def test_stamps_of_the_cameras_own_clock_are_times_of_the_bench(stamps, meaning, flag, chunks):
    model = GenicamModel(trigger_line=LINE, stamps=stamps, chunks=chunks, clock_ppm=100.0, readout_s=5e-3)
    one = bench(model, stamps=meaning)
    one.start()
    one.world.clock.sleep_s(600.0)  # 60 ms of drift, unless the clocks are compared again
    one.pulse()
    frame = one.sensor.read(0.5)
    assert frame.flags & FrameFlag.STAMPED_MONOTONIC
    assert frame.flags & (FrameFlag.STAMPED_AT_START | FrameFlag.STAMPED_AT_FRAME_START) == flag
    settings = one.sensor.settings
    assert frame.began_s(settings.exposure_s, settings.readout_s) == pytest.approx(
        one.world.exposures[-1].start_s, abs=2e-4
    )


def test_the_clock_of_a_gige_camera_of_the_first_kind_counts_in_ticks():
    one = bench()
    nodes = one.twin.nodes._nodes
    nodes["GevTimestampControlLatch"] = nodes.pop("TimestampLatch")
    ticks = nodes.pop("TimestampLatchValue")
    nodes["GevTimestampValue"] = ticks
    nodes["GevTimestampTickFrequency"] = type(ticks)("integer", 1_000_000_000, fixed=True)
    one.start()
    one.pulse()
    frame = one.sensor.read(0.5)
    assert frame.t_kernel_ns * 1e-9 == pytest.approx(one.world.exposures[-1].start_s, abs=2e-4)


def test_without_a_clock_to_read_frames_carry_the_time_of_their_arrival_and_say_so():
    one = bench(GenicamModel(trigger_line=LINE, stamped=False, chunks=False))
    one.start()
    one.pulse()
    frame = one.sensor.read(0.5)
    assert frame.t_kernel_ns == frame.t_host_ns
    assert not frame.flags & FrameFlag.STAMPED_MONOTONIC


@pytest.mark.parametrize("transport", ["GEV", "U3V"])
def test_a_lost_frame_is_named_also_when_it_is_the_first(transport):
    one = bench(GenicamModel(trigger_line=LINE, transport=transport))
    one.faults.inject("genicam.frame_lost", times=2)
    one.start()
    one.pulse(4)
    with pytest.raises(FrameLostError, match=r"2 frame\(s\) lost from frame 0"):
        one.sensor.read(0.5)
    frame = one.sensor.read(0.5)
    assert frame.sequence == 2
    assert frame.flags & FrameFlag.AFTER_LOSS
    assert one.sensor.status().lost == 2


def test_numbers_of_sixteen_bits_begin_again_at_one():
    one = bench()
    one.start()
    one.twin._frames = 65_534
    one.sensor._checks._next = 65_535
    one.sensor._checks.frame_index = 65_534
    one.faults.inject("genicam.frame_lost", skip=2)
    one.pulse(4)
    assert [one.sensor.read(0.5).sequence for _ in range(2)] == [65_534, 65_535]
    with pytest.raises(FrameLostError, match=r"1 frame\(s\) lost from frame 65536"):
        one.sensor.read(0.5)
    assert one.sensor.read(0.5).sequence == 65_537


def test_frames_that_are_lost_where_numbers_of_sixteen_bits_begin_again_are_counted():
    one = bench()
    one.start()
    one.twin._frames = 65_532
    one.sensor._checks._next = 65_533
    one.sensor._checks.frame_index = 65_532
    one.faults.inject("genicam.frame_lost", skip=1, times=4)
    one.pulse(7)
    assert one.sensor.read(0.5).sequence == 65_532
    with pytest.raises(FrameLostError, match=r"4 frame\(s\) lost from frame 65533"):
        one.sensor.read(0.5)
    assert [one.sensor.read(0.5).sequence for _ in range(2)] == [65_537, 65_538]


def test_a_number_that_comes_again_is_no_new_beginning():
    one = bench()
    one.start()
    one.twin._frames = 65_532
    one.sensor._checks._next = 65_535
    one.pulse()
    with pytest.raises(FrameCorruptError):
        one.sensor.read(0.5)


def test_frames_for_which_no_buffer_is_free_are_lost_by_name():
    one = bench()
    one.start(buffers=2)
    one.pulse(5)
    one.world.clock.sleep_s(0.2)
    assert [one.sensor.read(0.5).sequence for _ in range(2)] == [0, 1]
    one.pulse()
    with pytest.raises(FrameLostError, match=r"3 frame\(s\) lost from frame 2"):
        one.sensor.read(0.5)


def test_an_incomplete_buffer_is_corrupt_and_the_next_one_is_not():
    one = bench()
    one.faults.inject("genicam.incomplete")
    one.start()
    one.pulse(2)
    with pytest.raises(FrameCorruptError, match="frame 0 is corrupt: the buffer is incomplete"):
        one.sensor.read(0.5)
    assert one.sensor.read(0.5).sequence == 1
    assert one.sensor.status().corrupt == 1


def test_a_frame_of_another_size_is_corrupt():
    one = bench()
    one.faults.inject("genicam.other_size")
    one.start()
    one.pulse()
    with pytest.raises(FrameCorruptError, match="62 x 96 pixels instead of 64 x 96"):
        one.sensor.read(0.5)


def test_a_number_that_came_before_is_corrupt_and_the_count_goes_on():
    one = bench()
    one.start()
    one.pulse()
    one.sensor.read(0.5)
    one.twin._frames = 0
    one.pulse()
    with pytest.raises(FrameCorruptError, match="number 1 arrived before"):
        one.sensor.read(0.5)
    one.pulse()
    assert one.sensor.read(0.5).sequence == 1


def test_a_clock_that_begins_again_makes_frames_stale_and_not_early():
    one = bench()
    one.start()
    one.faults.inject("genicam.clock_reset")
    rise_s = one.pulse()
    with pytest.raises(FrameStaleError):
        one.sensor.read(0.5, not_before_ns=round(rise_s * 1e9))


def test_the_trigger_mode_is_put_back_as_it_was_found():
    one = bench()
    one.twin.nodes.write("TriggerMode", "Off")
    one.start()
    assert value(one, "TriggerMode") == "On"
    one.sensor.close()
    assert value(one, "TriggerMode") == "Off"


def test_connecting_writes_nothing():
    one = bench()
    assert not [call for call in one.twin.calls if call.startswith("write")]


def test_a_refused_feature_and_a_held_camera_are_named():
    one = bench()
    one.faults.inject("genicam.feature_refused", about="PixelFormat")
    with pytest.raises(RefusedError, match=r"PixelFormat = Mono8.*access denied"):
        one.sensor.configure(SensorConfig(fourcc="Mono8"))
    two = bench()
    two.sensor.close()
    held = GenicamSensor("cam0", two.twin, two.world.clock, GenicamOptions(kind="genicam"))
    two.faults.inject("genicam.held")
    with pytest.raises(AccessError, match="held by another program"):
        held.connect()


@pytest.mark.parametrize(
    ("table", "error", "text"),
    [
        ({"features": {"Zoom": 1}}, UnsupportedError, "the camera has no feature Zoom"),
        ({"features": {"TestPattern": "Sometimes"}}, UnsupportedError, "TestPattern has no entry 'Sometimes'"),
        ({"features": {"AcquisitionFrameRate": 1e6}}, OutOfRangeError, "AcquisitionFrameRate = 1000000.0"),
        ({"trigger_overlap": "ReadOut"}, UnsupportedError, "no feature TriggerOverlap"),
        ({"trigger_line": "Line7"}, UnsupportedError, "TriggerSource has no entry 'Line7'; allowed: Software, Line0"),
    ],
)
def test_what_the_camera_has_not_is_refused(table, error, text):
    with pytest.raises(error, match=text):
        bench(**table).sensor.configure(SensorConfig())


@pytest.mark.parametrize(
    ("gone", "config", "text"),
    [
        ("TriggerDelay", SensorConfig(), "no feature TriggerDelay.*trigger_delay_s"),
        ("Gain", SensorConfig(gain_db=3.0), "has no gain.*gain_db"),
        ("OffsetY", SensorConfig(height=32, top=4), "no feature OffsetY"),
        ("Height", SensorConfig(height=32), "no feature Height"),
    ],
)
def test_a_feature_that_is_missing_is_named_with_what_to_leave_out(gone, config, text):
    one = bench(trigger_delay_s=1e-3)
    del one.twin.nodes._nodes[gone]
    with pytest.raises(UnsupportedError, match=text):
        one.sensor.configure(config)


def test_a_camera_without_a_raw_format_is_refused_and_a_present_one_that_is_none_too():
    one = bench()
    node = one.twin.nodes._nodes["PixelFormat"]
    node.value = "RGB8"
    with pytest.raises(UnsupportedError, match=r"'RGB8' is no raw one.*set `format`"):
        one.sensor.configure(SensorConfig())
    node.symbols = ("RGB8",)
    again = GenicamSensor("cam0", one.twin, one.world.clock, GenicamOptions(kind="genicam"))
    with pytest.raises(UnsupportedError, match="no raw mono or Bayer format"):
        again.connect()


def test_warm_up_ends_with_an_error_where_no_frame_comes():
    one = bench()
    one.faults.inject("v4l2.stalled")
    with pytest.raises(TriggerTimeoutError, match="no frame 0"):
        one.start(warm_up_frames=2)


def test_a_start_that_is_refused_is_undone_and_the_next_one_works():
    one = bench()
    one.faults.inject("genicam.feature_refused", about="AcquisitionStart")
    with pytest.raises(RefusedError, match=r"AcquisitionStart: refused with GenApi .*access denied.*another program"):
        one.start()
    assert not one.twin.streaming
    one.start()
    one.pulse()
    assert one.sensor.read(0.5).sequence == 0


def test_a_fetch_that_is_refused_is_named_with_its_trigger():
    one = bench()
    one.start()
    one.faults.inject("genicam.feature_refused", about="fetch")
    with pytest.raises(RefusedError, match=r"cam0, trigger 3: fetch: refused with GenApi"):
        one.sensor.read(0.5, trigger_index=3)
    one.pulse()
    assert one.sensor.read(0.5).sequence == 0


def test_a_stop_that_is_refused_is_named_and_closing_closes_the_port_all_the_same():
    one = bench()
    one.start()
    one.faults.inject("genicam.feature_refused", about="AcquisitionStop", times=3)
    with pytest.raises(RefusedError, match="AcquisitionStop: refused with GenApi"):
        one.sensor.stop()
    one.sensor.stop()  # it counts as stopped
    one.sensor.close()
    assert list(one.twin.calls)[-1] == "close"
    assert not one.twin.streaming


def test_closing_closes_the_port_whatever_interrupts_it():
    one = bench()
    one.start()

    def interrupt(name, value):
        raise KeyboardInterrupt

    one.twin.write = interrupt
    with pytest.raises(KeyboardInterrupt):
        one.sensor.close()
    assert list(one.twin.calls)[-1] == "close"


def test_a_camera_that_goes_away_is_told_in_every_call_until_it_is_back():
    one = bench()
    one.start()
    one.twin.unplug()
    with pytest.raises(DisconnectedError):
        one.sensor.status()
    with pytest.raises(DisconnectedError, match="disconnected earlier"):
        one.sensor.read(0.1)
    with pytest.raises(DisconnectedError, match="disconnected earlier"):
        one.sensor.status()
    one.sensor.stop()
    one.twin.plug_in()
    one.sensor.start()  # sets everything up anew
    one.pulse()
    assert one.sensor.read(0.5).sequence == 0
    one.sensor.close()
    with pytest.raises(WrongStateError):
        one.sensor.start()
