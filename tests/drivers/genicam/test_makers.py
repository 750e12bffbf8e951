"""Features of triggers, links and clocks that only some makers' cameras have, by the twin, which has the sources."""

import pytest

from gs2ci_drivers.failures import DeviceFaultError, TriggerTimeoutError
from gs2ci_drivers.sensor import FrameFlag, SensorConfig, TriggerMode
from tests.drivers.genicam.test_manners import LINE, Bench


def starts_s(one, *after_s):
    """Send an edge at each time after now; return when exposures began after the first one."""
    begin_s = one.world.clock.now_s()
    for later_s in after_s:
        one.world.clock.after(later_s, lambda: one.world.bus.pulse(LINE, 5e-4))
    one.world.clock.sleep_s(0.2)
    return [exposure.start_s - begin_s - after_s[0] for exposure in one.world.exposures]


# ---- the time from a trigger to its exposure


def test_the_delay_that_a_basler_tells_is_counted():
    """111 us on a boA4504: a mask of 105 us, the shortest of a DLPC900, would have gone by."""
    one = Bench({"trigger_delay_s": 1e-3, "trigger_latency_s": 0.0}, latency_s=111e-6, tells_latency=True)
    one.start()
    assert starts_s(one, 5e-3) == [pytest.approx(1e-3 + 111e-6, abs=1e-9)]
    assert one.sensor.settings.trigger_delay_s == pytest.approx(1e-3 + 111e-6)


def test_in_free_run_no_delay_is_counted():
    one = Bench(latency_s=111e-6, tells_latency=True)
    one.start(TriggerMode.FREE_RUN)
    assert one.sensor.settings.trigger_delay_s == 0.0


@pytest.mark.parametrize("asked_s", [0.0, 2e-3])
@pytest.mark.parametrize("left_on", [False, True])
def test_a_delay_that_has_a_switch_is_switched_with_it(asked_s, left_on):
    one = Bench({"trigger_delay_s": asked_s}, delay_switch=True)
    one.twin.nodes.write("TriggerDelay", 700.0)
    one.twin.nodes.write("TriggerDelayEnabled", left_on)
    one.start()
    assert starts_s(one, 5e-3) == [pytest.approx(asked_s, abs=1e-9)]
    assert one.sensor.settings.trigger_delay_s == pytest.approx(asked_s)


NAMES = ("LineDebouncerTimeAbs", "LineDebouncerTimeRaw", "mvLineDebounceTimeRisingEdge", "TriggerFilterRaisingEdge")
NAMES += ("LineFilterWidth", "LineDebounceDuration", "LineDebouncerHighTimeAbs", "lineDebouncingPeriod")


@pytest.mark.parametrize("name", NAMES)
def test_a_debouncer_by_any_makers_name_is_set_to_its_least_and_counted(name):
    one = Bench(debouncer=name, debouncer_us=(300, 20))
    one.start()
    assert starts_s(one, 5e-3) == [pytest.approx(20e-6, abs=1e-9)]
    assert one.sensor.settings.trigger_delay_s == pytest.approx(20e-6)
    assert any(f"{name}[Line1] was 300 and has been reset to 20" in line for line in one.sensor.incidents)


@pytest.mark.parametrize(
    "name", ["LineDebouncerLowTimeAbs", "TriggerFilterFallingEdge", "mvLineDebounceTimeFallingEdge"]
)
def test_a_debouncer_of_the_other_edge_delays_no_exposure(name):
    one = Bench(debouncer=name, debouncer_us=(300, 20))
    one.start()
    assert one.sensor.settings.trigger_delay_s == 0.0


@pytest.mark.parametrize("selected", ["Line0", "Line1"])
def test_a_debouncer_that_outputs_do_not_have_is_reset_on_the_triggers_line(selected):
    one = Bench(debouncer="mvLineDebounceTimeRisingEdge", debouncer_us=(300, 20), outputs=("Line0",))
    one.twin.nodes.write("LineSelector", selected)
    one.start()
    assert starts_s(one, 5e-3) == [pytest.approx(20e-6, abs=1e-9)]
    assert one.sensor.settings.trigger_delay_s == pytest.approx(20e-6)
    assert len([line for line in one.sensor.incidents if "mvLineDebounceTimeRisingEdge" in line]) == 1
    assert one.twin.nodes.read("LineSelector") == selected


# ---- triggers that are kept, doubled, delayed or held, as another program has left it

LEFT = [
    ("TriggerCacheEnable", True, [0.0, 3e-3]),
    ("AcquisitionBurstFrameCount", 3, [0.0, 3e-3, 6e-3]),
    ("ExposureDelay", 400.0, [400e-6]),
    ("SyncInGlitchFilter", 50_000, [50e-6]),
    ("TriggerFilterTime", 150, [150e-6]),
    ("LineDebounceMode", "Deglitch", [100e-6]),
]


@pytest.mark.parametrize(("name", "left", "_"), LEFT)
def test_a_trigger_begins_one_exposure_and_begins_it_at_once(name, left, _):
    one = Bench(left={name: left})
    one.start()
    assert starts_s(one, 5e-3, 6e-3) == [pytest.approx(0.0, abs=1e-9)]  # the second comes too early, and is lost
    assert any(f"{name} was" in line or f"{name}[Line1] was" in line for line in one.sensor.incidents)


@pytest.mark.parametrize(("name", "left", "begins_s"), LEFT)
def test_what_the_rig_file_asks_of_triggers_is_kept(name, left, begins_s):
    lines = {"LineSelector": "Line1"} if name == "LineDebounceMode" else {}
    one = Bench({"features": lines | {name: left}}, left={name: left})
    one.start()
    second = 6e-3 if name == "TriggerCacheEnable" else 0.1
    found = starts_s(one, 5e-3, second)[: len(begins_s)]
    assert found == pytest.approx(begins_s, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "left"), [("AcquisitionFrameRateMode", "On"), ("AcquisitionFrameRateTargetEnable", True)]
)
def test_another_makers_limit_of_the_frame_rate_loses_no_trigger(name, left):
    one = Bench(left={name: left})
    one.start()
    one.pulse(4)  # 20 ms apart; at 25 Hz every second one would be lost
    assert [one.sensor.read(0.5).sequence for _ in range(4)] == [0, 1, 2, 3]


def test_frames_are_not_held_in_the_camera():
    one = Bench(left={"StreamHoldEnable": "On"})
    assert one.take().mean() == 400
    held = Bench({"features": {"StreamHoldEnable": "On"}}, left={"StreamHoldEnable": "On"})
    held.start()
    held.pulse()
    with pytest.raises(TriggerTimeoutError):
        held.sensor.read(0.5)


def test_frames_do_not_wait_to_be_transferred():
    one = Bench(left={"TransferControlMode": "UserControlled"})
    assert one.take().mean() == 400
    basic = Bench(left={"TransferControlMode": "Basic"})
    basic.start()
    assert basic.twin.nodes.read("TransferControlMode") == "Basic"
    assert not [line for line in basic.sensor.incidents if "Transfer" in line]


def test_a_sequencer_of_a_gige_camera_is_switched_off_behind_the_automatic_settings():
    one = Bench(left={"SequenceEnable": True})
    assert one.take().mean() == 400
    assert any("SequenceEnable was True and has been reset to False" in line for line in one.sensor.incidents)


OTHER_NAMES = [{"frame_trigger": "ExposureStart"}, {"left": {"TriggerControlImplementation": "Legacy"}}]
OTHER_NAMES += [{"frame_trigger": "FrameBurstStart", "left": {"AcquisitionBurstFrameCount": 3}}]


@pytest.mark.parametrize("model", OTHER_NAMES)
def test_a_frames_trigger_is_found_by_its_other_names(model):
    one = Bench(**model)
    one.sensor.prepare()
    assert TriggerMode.EDGE in one.sensor.info.triggers
    one.start()
    assert starts_s(one, 5e-3) == [pytest.approx(0.0, abs=1e-9)]


# ---- limits of the exposure


@pytest.mark.parametrize("model", [{"rate_limits": 30.0}, {"left": {"ExposureTimeMode": "UltraShort"}}])
def test_a_limit_of_exposures_that_another_program_left_is_none_of_the_cameras(model):
    """At 30 frames a second 80 ms would be refused on connecting, as longer than the camera can."""
    one = Bench(**model)
    one.sensor.prepare()
    assert one.sensor.info.max_exposure_s == pytest.approx(10.0)
    assert one.sensor.configure(SensorConfig(exposure_s=80e-3, trigger=TriggerMode.EDGE)).exposure_s == 80e-3
    assert len([line for line in one.sensor.incidents if "has been reset" in line]) == 1


@pytest.mark.parametrize("left_us", [20.0, 62.0, 1e6])
@pytest.mark.parametrize("wanted_s", [2e-3, 0.1, 0.5])
def test_exposures_that_are_multiples_of_a_base_are_set_by_the_finest_one(left_us, wanted_s):
    """With the base of 20 us that a scout has at first, 82 ms were the longest; with another left, 1 s the shortest."""
    one = Bench(exposure="ExposureTimeAbs", base_us=left_us)
    assert one.sensor.info.max_exposure_s == pytest.approx(10.0)
    one.start(exposure_s=wanted_s)
    one.pulse()
    one.sensor.read(2.0)
    taken = one.world.exposures[-1]
    assert taken.end_s - taken.start_s == pytest.approx(wanted_s, rel=2e-4)
    assert one.sensor.settings.exposure_s == pytest.approx(taken.end_s - taken.start_s, abs=1e-9)


@pytest.mark.parametrize(("stated_s", "found_s"), [(None, 14e-6), (5e-6, 5e-6), (0.0, 0.0)])
def test_an_exposure_is_as_long_as_a_basler_tells(stated_s, found_s):
    table = {} if stated_s is None else {"exposure_offset_s": stated_s}
    one = Bench(table, exposure_offset_s=14e-6, tells_offset=True)
    one.start()
    one.pulse()
    one.sensor.read(0.5)
    taken = one.world.exposures[-1]
    assert taken.end_s - taken.start_s == pytest.approx(2e-3 + 14e-6, abs=1e-9)
    assert one.sensor.settings.exposure_offset_s == pytest.approx(found_s, abs=1e-9)


# ---- links that are slow by other features than SFNC's


@pytest.mark.parametrize(
    ("model", "link_s", "named"),
    [
        ({"packets": (12_500, 1500)}, 64 * 96 * 2 / 1464 * 1e-4, "GevSCPD adds 0.839 ms"),
        ({"packets": (125_000, 1500)}, 64 * 96 * 2 / 1464 * 1e-3, "GevSCPD adds 8.39 ms"),
        ({"packets": (0, 1500)}, 0.0, ""),
        ({"stream_limit": (1_000_000, True)}, 64 * 96 * 2 / 1e6, "StreamBytesPerSecond is 1 MB/s"),
        ({"stream_limit": (1_000_000, False)}, 0.0, ""),
    ],
)
def test_a_link_that_is_slowed_down_otherwise_is_counted_too(model, link_s, named):
    one = Bench(**model)
    one.start()
    assert one.sensor.settings.link_s == pytest.approx(link_s)
    told = [line for line in one.sensor.incidents if "apart at least" in line]
    assert len(told) == (link_s > 3e-3)
    assert not told or named in told[0]
    gap_s = max(link_s, 3e-3)
    assert len(starts_s(one, 5e-3, 5e-3 + 0.9 * gap_s, 5e-3 + 1.1 * gap_s)) == 2


# ---- exposures and clocks by other names


def test_a_ricohs_exposure_is_set_in_whole_microseconds():
    one = Bench(exposure="ExposureTimeRaw", whole_us=1)
    one.start(exposure_s=2.3456e-3)
    one.pulse()
    one.sensor.read(0.5)
    exposure = one.world.exposures[-1]
    assert one.sensor.settings.exposure_s == pytest.approx(2.346e-3)
    assert exposure.end_s - exposure.start_s == pytest.approx(2.346e-3)
    assert one.sensor.info.min_exposure_s == pytest.approx(20e-6)


def test_a_clock_that_is_latched_into_timestamp_is_read_there():
    one = Bench(latched="Timestamp", clock_ppm=100.0)
    one.start()
    one.pulse()
    frame = one.sensor.read(0.5)
    assert frame.flags & FrameFlag.STAMPED_MONOTONIC
    assert frame.t_kernel_ns * 1e-9 == pytest.approx(one.world.exposures[-1].start_s, abs=2e-4)


def test_a_camera_that_tells_by_trigger_armed_is_waited_for():
    one = Bench(armed=True, ready_s=0.2)
    begin_s = one.world.clock.now_s()
    one.start()
    assert one.world.clock.now_s() - begin_s >= 0.2
    never = Bench(armed=True)
    never.faults.inject("genicam.never_ready")
    with pytest.raises(DeviceFaultError, match="TriggerArmed was false for 2 s"):
        never.start()
