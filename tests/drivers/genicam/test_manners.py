"""What GenICam cameras do where one would guess otherwise, by the twin, which has the sources."""

import numpy as np
import pytest

from gs2ci_drivers.failures import FrameLostError, OutOfRangeError, UnsupportedError
from gs2ci_drivers.genicam.driver import GenicamSensor
from gs2ci_drivers.genicam.options import GenicamOptions
from gs2ci_drivers.sensor import SensorConfig, TriggerMode
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.world import Exposure, World
from tests.twins.genicam import GenicamModel, GenicamTwin

LINE = "dmd0.out"


class Level:
    """Light of 400 DN everywhere."""

    def collect(self, exposure: Exposure) -> np.ndarray:
        return np.full((exposure.height, exposure.width), 400, np.uint16)


class Bench:
    def __init__(self, table=None, **model):
        self.world, self.faults = World(Level()), FaultSet()
        self.twin = GenicamTwin(self.world, GenicamModel(**({"trigger_line": LINE} | model)), self.faults)
        options = GenicamOptions.model_validate({"kind": "genicam"} | (table or {}))
        self.sensor = GenicamSensor("cam0", self.twin, self.world.clock, options)
        self.sensor.connect()

    def start(self, mode=TriggerMode.EDGE, **config):
        self.sensor.configure(SensorConfig(**({"exposure_s": 2e-3, "trigger": mode} | config)))
        self.sensor.start()

    def pulse(self, count=1):
        clock = self.world.clock
        for i in range(count):
            clock.after(5e-3 + 0.02 * i, lambda: self.world.bus.pulse(LINE, 1e-3))
        return clock.now_s() + 5e-3

    def take(self, **config):
        self.start(**config)
        self.pulse()
        return self.sensor.read(0.5).pixels


# ---- C1: the least trigger delay


def test_the_least_delay_of_a_blackfly_is_taken_and_counted():
    one = Bench(least_delay_us=9.0)
    one.start()
    rise_s = one.pulse()
    one.sensor.read(0.5)
    assert one.world.exposures[-1].start_s == pytest.approx(rise_s + 9e-6, abs=1e-9)
    assert one.sensor.settings.trigger_delay_s == pytest.approx(9e-6)
    assert one.sensor.settings.recorded["TriggerDelay"] == 9.0


def test_a_delay_below_the_least_is_refused_with_the_limits():
    with pytest.raises(OutOfRangeError, match=r"TriggerDelay = 4.0; allowed: 9 to 1e\+06"):
        Bench({"trigger_delay_s": 4e-6}, least_delay_us=9.0).start()


# ---- a line's debouncer


@pytest.mark.parametrize(("left_us", "least_us"), [(1000.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
def test_a_debouncer_that_delays_triggers_is_set_to_its_least_and_that_is_counted(left_us, least_us):
    """At 1 ms, as another program may leave it, each mask would be exposed a millisecond late, without a word."""
    one = Bench(debouncer_us=(left_us, least_us))
    one.start()
    rise_s = one.pulse()
    one.sensor.read(0.5)
    assert one.world.exposures[-1].start_s == pytest.approx(rise_s + least_us * 1e-6, abs=1e-9)
    assert one.sensor.settings.trigger_delay_s == pytest.approx(least_us * 1e-6)
    told = [line for line in one.sensor.incidents if "LineDebouncerTime" in line]
    assert len(told) == (2 if left_us > least_us else 0)  # one for each line


def test_a_debouncer_that_the_rig_file_asks_for_is_kept_and_counted_and_swallows_shorter_pulses():
    wanted = {"features": {"LineSelector": "Line1", "LineDebouncerTime": 500.0}}
    one = Bench(wanted, debouncer_us=(0.0, 0.0))
    one.start()
    assert one.sensor.settings.trigger_delay_s == pytest.approx(500e-6)
    one.world.clock.after(2e-3, lambda: one.world.bus.pulse(LINE, 100e-6))
    rise_s = one.pulse()
    one.sensor.read(0.5)
    assert [exposure.start_s for exposure in one.world.exposures] == [pytest.approx(rise_s + 500e-6, abs=1e-9)]
    assert one.twin.nodes.read("LineSelector") == "Line1"


# ---- a line that is inverted, or an output


@pytest.mark.parametrize("left", [("Input", True), ("Output", False), ("Output", True), ("Input", False)])
@pytest.mark.parametrize("mode", [TriggerMode.EDGE, TriggerMode.LEVEL])
def test_a_line_that_another_program_left_inverted_or_an_output_triggers_as_it_is_wired(left, mode):
    """Inverted, exposures would begin with the end of a pulse, of 1 ms here, or last while no mask is on show."""
    one = Bench(line_left=left)
    one.start(mode)
    rise_s = one.pulse()
    one.sensor.read(0.5)
    taken = one.world.exposures[-1]
    assert taken.start_s == pytest.approx(rise_s, abs=1e-9)
    assert taken.end_s == pytest.approx(rise_s + (2e-3 if mode is TriggerMode.EDGE else 1e-3), abs=1e-9)
    told = [line for line in one.sensor.incidents if "of Line1 was" in line]
    assert len(told) == (left[0] == "Output") + left[1]
    assert one.twin.nodes.read("LineSelector") == "Line0"
    assert one.twin.nodes.of("LineInverter", "Line0") is left[1]  # the other line is not ours


def test_lines_that_are_not_the_triggers_are_left_as_they_are():
    """The trigger comes in by a counter here, which is no line."""
    one = Bench({"trigger_line": "Counter0End"}, trigger_input="Counter0End", line_left=("Output", True))
    one.twin.nodes._nodes["LineSelector"].symbols = ("Line0", "Line1")
    one.start()
    assert not [line for line in one.sensor.incidents if "has been reset" in line and "Line" in line]


def test_an_inverted_line_that_the_rig_file_asks_for_is_kept():
    one = Bench({"features": {"LineSelector": "Line1", "LineInverter": True}}, line_left=("Input", False))
    one.start()
    rise_s = one.pulse()
    one.sensor.read(0.5)
    assert one.world.exposures[-1].start_s == pytest.approx(rise_s + 1e-3, abs=1e-9)


# ---- rows one after the other


class Flash:
    """Light of 1000 DN in the millisecond from `begin_s` on."""

    begin_s = 0.0

    def collect(self, exposure: Exposure) -> np.ndarray:
        on_s = min(exposure.end_s, self.begin_s + 1e-3) - max(exposure.start_s, self.begin_s)
        return np.full((exposure.height, exposure.width), round(1e6 * max(on_s, 0.0)), np.uint16)


@pytest.mark.parametrize("others", [("Global",), ("GlobalReset",), ("GlobalResetRelease", "Global")])
def test_a_shutter_that_rolls_is_set_to_one_that_shows_all_masks_to_all_rows(others):
    one = Bench(shutters=("Rolling", *others))
    one.start()
    assert one.sensor.settings.rows_s == 0.0
    assert one.sensor.settings.recorded["SensorShutterMode"] == max(others, key=lambda name: name == "Global")
    assert any("SensorShutterMode was Rolling" in line for line in one.sensor.incidents)


def test_a_camera_that_can_only_roll_shows_masks_to_some_rows_and_that_is_told():
    one = Bench(shutters=("Rolling",), readout_s=6e-3)
    one.world.light = Flash()
    one.start()
    one.world.light.begin_s = one.pulse()
    rows = one.sensor.read(0.5).pixels.mean(axis=1)
    assert rows[:16] == pytest.approx(1000, abs=1)
    assert (rows[16:] == 0).all()
    assert any("SensorShutterMode is Rolling" in line for line in one.sensor.incidents)
    assert one.sensor.settings.rows_s == pytest.approx(6e-3)
    wanted = Bench({"features": {"SensorShutterMode": "Rolling"}}, shutters=("Global", "Rolling"))
    wanted.start()
    assert wanted.twin.nodes.read("SensorShutterMode") == "Rolling"


# ---- a link that another program has limited


def test_a_limited_link_is_counted_and_earlier_triggers_are_lost():
    """At 1 MB/s a frame of 64 x 96 px in 16 bits takes 12.3 ms to leave, and exposure and readout take 3."""
    one = Bench(link=(1_000_000, "On"))
    one.start()
    assert one.sensor.settings.link_s == pytest.approx(64 * 96 * 2 / 1e6)
    assert one.sensor.settings.readout_s == pytest.approx(1e-3)
    assert any("1 MB/s" in line and "12.3 ms" in line for line in one.sensor.incidents)
    clock = one.world.clock
    for after_s in (0.0, 5e-3, 13e-3):
        clock.after(5e-3 + after_s, lambda: one.world.bus.pulse(LINE, 1e-3))
    clock.sleep_s(0.1)
    assert len(one.world.exposures) == 2


@pytest.mark.parametrize(("link", "link_s"), [((1_000_000, "Off"), 0.0), ((400_000_000, "On"), 30.7e-6), (None, 0.0)])
def test_a_link_that_limits_nothing_is_not_mentioned(link, link_s):
    one = Bench(link=link)
    one.start()
    assert one.sensor.settings.link_s == pytest.approx(link_s, rel=1e-2)
    assert not [line for line in one.sensor.incidents if "Throughput" in line]


def test_the_rig_file_can_raise_the_limit():
    one = Bench({"features": {"DeviceLinkThroughputLimit": 100_000_000}}, link=(1_000_000, "On"))
    one.start()
    assert one.sensor.settings.link_s == pytest.approx(64 * 96 * 2 / 1e8)


# ---- C2: locked while the trigger is on


@pytest.mark.parametrize("left_on", [False, True])
def test_a_camera_that_locks_its_trigger_while_it_is_on_is_configured_again_and_again(left_on):
    one = Bench(locks_triggers=True)
    if left_on:
        one.twin.nodes.write("TriggerMode", "On")
    for delay_s in (1e-3, 2e-3):
        one.sensor._options = one.sensor._options.model_copy(update={"trigger_delay_s": delay_s})
        assert one.take().mean() == 400
        assert one.sensor.settings.trigger_delay_s == pytest.approx(delay_s)
        one.sensor.stop()
    one.sensor.close()
    assert one.twin.nodes.read("TriggerMode") == ("On" if left_on else "Off")


# ---- C3: numbers that go on


def test_numbers_that_go_on_after_a_stop_are_told_with_their_cure():
    one = Bench(goes_on=True)
    one.take()
    one.sensor.stop()
    one.start()
    one.pulse()
    with pytest.raises(
        FrameLostError, match=r'goes on counting after a stop: set first_frame_id = "any" in \[sensor\]'
    ):
        one.sensor.read(0.5)
    mended = Bench({"first_frame_id": "any"}, goes_on=True)
    for _ in range(3):
        mended.start()
        mended.pulse(2)
        assert [mended.sensor.read(0.5).sequence for _ in range(2)] == [0, 1]
        mended.sensor.stop()


# ---- C4 is in test_leftovers.py; C5: gain as a factor


@pytest.mark.parametrize(
    ("unit", "table", "times"), [("dB", {}, 2.0), ("x", {}, 2.0), ("", {"gain_unit": "factor"}, 2.0)]
)
def test_six_decibels_are_twice_the_reading_whatever_the_cameras_unit(unit, table, times):
    one = Bench(table, gain_unit=unit)
    bright = one.take(gain_db=6.0206).mean()
    assert bright == pytest.approx(400 * times, rel=0.02)


def test_a_gain_without_a_unit_is_refused_until_it_is_stated():
    with pytest.raises(UnsupportedError, match=r"neither decibels nor a factor.*set gain_unit"):
        Bench(gain_unit="").start(gain_db=6.0)
    assert Bench(gain_unit="").take().mean() == 400  # without gain_db, it is at its least


# ---- of the same kind: the unit of times


@pytest.mark.parametrize("unit", ["us", "ms", "ns"])
def test_times_are_in_the_unit_that_the_camera_names(unit):
    one = Bench({"trigger_delay_s": 3e-3}, time_unit=unit, tells="rate", least_delay_us=0.0)
    one.start(exposure_s=4e-3)
    rise_s = one.pulse()
    one.sensor.read(0.5)
    last = one.world.exposures[-1]
    assert last.end_s - last.start_s == pytest.approx(4e-3, rel=1e-3)
    assert last.start_s == pytest.approx(rise_s + 3e-3, abs=1e-4)
    assert one.sensor.settings.exposure_s == pytest.approx(4e-3, rel=1e-3)
    assert one.sensor.info.min_exposure_s == pytest.approx(20e-6)


def test_a_time_in_a_unit_that_is_none_is_refused():
    with pytest.raises(UnsupportedError, match="ExposureTime has the unit 'px'"):
        Bench(time_unit="px")


# ---- C6: optional features of the trigger


def test_a_camera_without_trigger_activation_is_used_for_rising_edges_only():
    assert Bench(has_activation=False).take().mean() == 400
    with pytest.raises(UnsupportedError, match="no feature TriggerActivation"):
        Bench({"trigger_activation": "FallingEdge"}, has_activation=False).start()


def test_a_camera_with_one_trigger_needs_no_selector():
    one = Bench(has_selector=False)
    assert TriggerMode.EDGE in one.sensor.info.triggers
    assert one.take().mean() == 400
    one.sensor.close()
    assert one.twin.nodes.read("TriggerMode") == "Off"
