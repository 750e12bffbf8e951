"""Regions of interest and level triggers on the kernel's own test camera: an HDMI input that crops, on video0.

vivid has no trigger. Its private control `menu` stands for a VC-MIPI driver's `trigger_mode`: what is shown is that a
gated set-up passes the real control calls and that what was found is put back. Its picture stands still.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import AccessError, FrameLostError, OutOfRangeError, UnsupportedError
from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.sensor import Frame, SensorConfig, TriggerMode
from gs2ci_drivers.v4l2.abi import ControlFlag
from gs2ci_drivers.v4l2.controls import ControlTable
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.v4l2.node import VideoNode
from gs2ci_drivers.v4l2.options import V4l2Options

PORT = KernelSysPort()
NODE = "/dev/video0"
STILL = {"osd_text_mode": 2, "horizontal_movement": 3, "vertical_movement": 3, "test_pattern": 20}
LEVEL_VALUES = {TriggerMode.FREE_RUN: 1, TriggerMode.LEVEL: 3}
PATIENCE_S = 30.0


def sensor_with(**options: object) -> V4l2Sensor:
    settings = V4l2Options.model_validate(
        {"port": NODE, "trigger_adapter": "none", "fixed_exposure_s": 0.01, "first_sequence": -1, **options}
    )
    return V4l2Sensor("cam0", PORT, WallClock(), settings)


@pytest.fixture(autouse=True)
def as_loaded() -> None:
    """Put back what an earlier check left set: the driver refuses private controls off their defaults."""
    for path in (NODE,):
        node = VideoNode(PORT, path, "hand")
        table = ControlTable(node)
        for control in table:
            idle = control.settable and control.has_value and not control.flags & ControlFlag.INACTIVE
            if idle and table.get(control.cid) != control.default:
                table.set(control.cid, control.default)
        node.close()


@pytest.fixture
def sensor() -> Iterator[V4l2Sensor]:
    sensor = sensor_with()
    sensor.connect()
    yield sensor
    sensor.close()


@pytest.fixture
def hand() -> Iterator[ControlTable]:
    """A second opener's hand on the controls."""
    node = VideoNode(PORT, NODE, "hand")
    yield ControlTable(node)
    node.close()


def next_whole(sensor: V4l2Sensor) -> Frame:
    for _ in range(50):
        try:
            return sensor.read(PATIENCE_S)
        except FrameLostError:  # an emulated machine is slow
            continue
    raise AssertionError("no whole frame")


def picture(sensor: V4l2Sensor, **region: int | None) -> np.ndarray:
    sensor.configure(SensorConfig(fourcc="GREY", trigger=TriggerMode.FREE_RUN, controls=STILL, **region))
    sensor.start()
    next_whole(sensor)
    pixels = next_whole(sensor).pixels
    sensor.stop()
    return pixels


def test_a_region_is_the_part_of_the_whole_picture_that_it_names(sensor: V4l2Sensor) -> None:
    largest = sensor.info.formats[0]
    whole = picture(sensor, height=largest.height, width=largest.width)
    assert np.unique(whole[0]).size > 50
    for top, left in ((100, 64), (0, 0), (largest.height - 200, largest.width - 320)):
        part = picture(sensor, height=200, width=320, top=top, left=left)
        np.testing.assert_array_equal(part, whole[top : top + 200, left : left + 320])
        placed = {applied.control: (applied.requested, applied.applied) for applied in sensor.applied_controls}
        assert (placed["top"], placed["left"]) == ((top, top), (left, left))
    # The whole sensor again, after a region.
    np.testing.assert_array_equal(picture(sensor, height=largest.height, width=largest.width), whole)


def test_a_region_beyond_the_sensor_is_refused_with_its_size(sensor: V4l2Sensor) -> None:
    largest = sensor.info.formats[0]
    with pytest.raises(OutOfRangeError, match=f"inside {largest.height} x {largest.width}"):
        picture(sensor, height=200, width=320, top=largest.height - 100, left=0)


def test_a_gate_is_set_by_the_private_control_and_what_was_found_is_put_back(hand: ControlTable) -> None:
    hand.set("menu", 4)
    sensor = sensor_with(trigger_adapter="control", trigger_control="menu", trigger_values=LEVEL_VALUES, readout_s=0.01)
    assert sensor.connect().only_gated
    with pytest.raises(UnsupportedError, match='mode = "gate"'):
        sensor.configure(SensorConfig(height=200, width=320, fourcc="GREY", trigger=TriggerMode.EDGE))
    got = sensor.configure(SensorConfig(height=200, width=320, fourcc="GREY", trigger=TriggerMode.LEVEL))
    assert (got.trigger, hand.get("menu")) == (TriggerMode.LEVEL, 3)
    sensor.start()
    next_whole(sensor)
    sensor.stop()
    sensor.close()
    assert hand.get("menu") == 4


def test_a_gate_needs_to_know_how_long_reading_out_takes() -> None:
    sensor = sensor_with(trigger_adapter="control", trigger_control="menu", trigger_values=LEVEL_VALUES)
    sensor.connect()
    with pytest.raises(UnsupportedError, match="readout_s"):
        sensor.configure(SensorConfig(height=200, width=320, fourcc="GREY", trigger=TriggerMode.LEVEL))
    sensor.close()


def test_a_module_without_the_parameter_is_named_with_what_to_do() -> None:
    assert Path("/sys/module/vivid/parameters").is_dir()
    for module in ("vivid", "imx296"):
        with pytest.raises((UnsupportedError, AccessError), match=module):
            sensor_with(trigger_adapter="module", trigger_module=module).connect()
