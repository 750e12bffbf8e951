"""The V4L2 driver on the kernel's own test camera, single-plane on video0 and multi-plane on video1."""

import errno
import time
from collections.abc import Iterator

import numpy as np
import pytest

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import (
    AccessError,
    DeviceFaultError,
    DisconnectedError,
    DriverError,
    FrameCorruptError,
    FrameLostError,
    OutOfRangeError,
    UnsupportedError,
)
from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.sensor import Frame, FrameFlag, SensorConfig, StampMeaning, TriggerMode
from gs2ci_drivers.v4l2.abi import ControlFlag
from gs2ci_drivers.v4l2.controls import ControlTable
from gs2ci_drivers.v4l2.driver import V4l2Sensor, list_cameras
from gs2ci_drivers.v4l2.node import VideoNode
from gs2ci_drivers.v4l2.options import V4l2Options

PORT = KernelSysPort()
NODES = ("/dev/video0", "/dev/video1")
QUIET = {"osd_text_mode": 2, "horizontal_movement": 3, "vertical_movement": 3}
RED, GREY_RAMP = 7, 20
MONO = {"GREY": 8, "Y10": 10, "Y12": 12, "Y16": 16}
PATIENCE_S = 20.0


def sensor_on(path: str) -> V4l2Sensor:
    options = V4l2Options(port=path, trigger_adapter="none", fixed_exposure_s=0.01, first_sequence=-1)
    return V4l2Sensor("cam0", PORT, WallClock(), options)


def config(fourcc: str = "GREY", pattern: int = GREY_RAMP, **controls: int) -> SensorConfig:
    return SensorConfig(
        height=180,
        width=320,
        fourcc=fourcc,
        trigger=TriggerMode.FREE_RUN,
        controls={**QUIET, "test_pattern": pattern, **controls},
    )


def next_whole(sensor: V4l2Sensor, tries: int = 50) -> Frame:
    """Return the next frame; an emulated machine is slow, so frames may be lost on the way, and that is told."""
    for _ in range(tries):
        try:
            return sensor.read(PATIENCE_S)
        except FrameLostError:
            continue
    raise AssertionError("no whole frame")


def read_on(sensor: V4l2Sensor, frames: int, timeout_s: float = PATIENCE_S) -> None:
    """Read raw: whatever the driver has to say comes through."""
    for _ in range(frames):
        sensor.read(timeout_s, trigger_index=7)


def read_on_past_losses(sensor: V4l2Sensor, frames: int) -> None:
    for _ in range(frames):
        next_whole(sensor)


def picture(sensor: V4l2Sensor, settings: SensorConfig) -> np.ndarray:
    sensor.configure(settings)
    sensor.start()
    next_whole(sensor)
    pixels = next_whole(sensor).pixels
    sensor.stop()
    return pixels


@pytest.fixture(autouse=True)
def as_loaded() -> None:
    """Put back what an earlier check left set: the driver refuses private controls off their defaults."""
    for path in NODES:
        node = VideoNode(PORT, path, "hand")
        table = ControlTable(node)
        for control in table:
            idle = control.settable and control.has_value and not control.flags & ControlFlag.INACTIVE
            if idle and table.get(control.cid) != control.default:
                table.set(control.cid, control.default)
        node.close()


@pytest.fixture(params=NODES)
def sensor(request: pytest.FixtureRequest) -> Iterator[V4l2Sensor]:
    sensor = sensor_on(request.param)
    sensor.connect()
    yield sensor
    sensor.close()


@pytest.fixture
def hand() -> Iterator[ControlTable]:
    """A second opener's hand on the controls of video0, to inject faults."""
    node = VideoNode(PORT, NODES[0], "hand")
    yield ControlTable(node)
    node.close()


def test_both_nodes_are_listed() -> None:
    assert [(path, who.driver) for path, who in list_cameras(PORT)] == [(node, "vivid") for node in NODES]


def test_every_format_that_vivid_offers_shows_the_same_picture(sensor: V4l2Sensor) -> None:
    offered = {f.fourcc: f for f in sensor.info.formats}
    assert MONO.keys() | {"RGGB", "BA81", "RG10", "BG12", "RG16", "BYR2"} <= offered.keys()
    grey = picture(sensor, config("GREY"))
    assert np.unique(grey[0]).size > 50
    for fourcc, bits in MONO.items():
        np.testing.assert_array_equal(picture(sensor, config(fourcc)), grey << (bits - 8), err_msg=fourcc)
    for fourcc, fmt in offered.items():
        if fmt.cfa is None:
            continue
        red = picture(sensor, config(fourcc, RED)) >> (fmt.bits - 8)
        at = fmt.cfa.index("R")
        sites = np.zeros((2, 2), bool)
        sites[divmod(at, 2)] = True
        bright = np.tile(sites, (90, 160))
        assert red[bright].min() > 200, fourcc
        assert red[~bright].max() < 50, fourcc


def test_an_odd_size_comes_back_as_the_kernel_made_it(sensor: V4l2Sensor) -> None:
    got = sensor.configure(SensorConfig(height=300, width=500, fourcc="Y10", trigger=TriggerMode.FREE_RUN))
    sensor.start()
    frame = next_whole(sensor)
    assert frame.pixels.shape == (got.format.height, got.format.width)
    assert got.stride >= 2 * got.format.width


def test_stamps_are_the_kernels_monotonic_clock_and_their_source_is_told(sensor: V4l2Sensor) -> None:
    for source, flag in ((0, FrameFlag.NONE), (1, FrameFlag.STAMPED_AT_START)):
        sensor.configure(config(timestamp_source=source))
        sensor.start()
        frames = [next_whole(sensor) for _ in range(3)]
        sensor.stop()
        for frame in frames:
            assert frame.flags & FrameFlag.STAMPED_MONOTONIC
            assert frame.flags & FrameFlag.STAMPED_AT_START == flag
            assert abs(frame.t_kernel_ns - time.monotonic_ns()) < 60e9
        assert frames[0].t_kernel_ns < frames[1].t_kernel_ns < frames[2].t_kernel_ns
        assert frames[0].sequence < frames[1].sequence < frames[2].sequence


@pytest.mark.parametrize(
    ("stated", "flag"),
    [
        (StampMeaning.START_OF_EXPOSURE, FrameFlag.STAMPED_AT_START),
        (StampMeaning.START_OF_FRAME, FrameFlag.STAMPED_AT_FRAME_START),
        (StampMeaning.END_OF_FRAME, FrameFlag.NONE),
    ],
)
def test_what_the_rig_file_says_of_stamps_goes_before_the_kernels_flag(stated: StampMeaning, flag: FrameFlag) -> None:
    """The kernel flags the start of exposure here; uvcvideo does so and stamps the first packet."""
    options = V4l2Options(
        port=NODES[0], trigger_adapter="none", fixed_exposure_s=0.01, first_sequence=-1, stamps=stated
    )
    sensor = V4l2Sensor("cam0", PORT, WallClock(), options)
    sensor.connect()
    sensor.configure(config(timestamp_source=1))
    sensor.start()
    frame = next_whole(sensor)
    sensor.close()
    assert frame.flags & (FrameFlag.STAMPED_AT_START | FrameFlag.STAMPED_AT_FRAME_START) == flag
    late_s = {FrameFlag.STAMPED_AT_START: 0.0, FrameFlag.STAMPED_AT_FRAME_START: 0.01, FrameFlag.NONE: 0.03}[flag]
    assert frame.began_s(0.01, 0.02) == pytest.approx(frame.t_kernel_ns * 1e-9 - late_s, abs=1e-9)


def test_controls_are_clamped_by_the_kernel_and_that_is_told(sensor: V4l2Sensor) -> None:
    sensor.configure(config(brightness=1000, integer_64_bits=-(2**40)))
    applied = {a.control: a for a in sensor.applied_controls}
    assert applied["brightness"].applied == 255
    assert applied["integer_64_bits"].applied == -(2**40)
    with pytest.raises(OutOfRangeError, match=r"1 \(Menu Item 1\), 3 \(Menu Item 3\)"):
        sensor.configure(config(menu=2))
    with pytest.raises(AccessError, match="read_only_integer_32_bits is read-only"):
        sensor.configure(config(read_only_integer_32_bits=1))
    with pytest.raises(UnsupportedError, match="allowed: brightness"):
        sensor.configure(config(brightnes=1))


def test_a_private_control_that_another_program_left_is_refused_and_a_standard_one_reset(hand: ControlTable) -> None:
    hand.set("boolean", 1 - hand.require("boolean").default)
    hand.set("brightness", 7)
    first = sensor_on(NODES[0])
    first.connect()
    with pytest.raises(UnsupportedError, match="boolean = "):
        first.configure(config())
    hand.set("boolean", hand.require("boolean").default)
    assert first.configure(config()).recorded["brightness"] == hand.require("brightness").default
    first.close()


def test_a_second_capture_from_the_same_node_is_refused_as_busy() -> None:
    first, second = sensor_on(NODES[0]), sensor_on(NODES[0])
    first.connect()
    first.configure(config())
    first.start()
    second.connect()
    with pytest.raises(AccessError, match="EBUSY"):
        second.configure(config("Y16"))
    second.close()
    next_whole(first)
    first.close()


def test_warm_up_frames_are_taken_and_gone(sensor: V4l2Sensor) -> None:
    settings = config()
    sensor.configure(
        SensorConfig(height=180, width=320, fourcc="GREY", trigger=TriggerMode.FREE_RUN, warm_up_frames=2, buffers=2)
    )
    sensor.start()
    assert sensor.settings.buffers >= 2
    assert next_whole(sensor).sequence >= 0
    sensor.stop()
    sensor.configure(settings)


def test_a_deadline_is_kept(sensor: V4l2Sensor) -> None:
    sensor.configure(config())
    sensor.start()
    sensor.discard()
    begin = time.monotonic()
    with pytest.raises(DriverError):
        read_on(sensor, 100, timeout_s=0.0)
    assert time.monotonic() - begin < 10.0


# ---- injected faults, all on the single-plane node


@pytest.fixture
def running(hand: ControlTable) -> Iterator[V4l2Sensor]:
    sensor = sensor_on(NODES[0])
    sensor.connect()
    sensor.configure(config())
    sensor.start()
    next_whole(sensor)
    yield sensor
    sensor.close()


def test_a_buffer_with_the_error_flag_is_a_corrupt_frame(running: V4l2Sensor, hand: ControlTable) -> None:
    hand.set("inject_v4l2_buf_flag_error", 1)
    with pytest.raises(FrameCorruptError, match="V4L2_BUF_FLAG_ERROR"):
        read_on_past_losses(running, 10)
    next_whole(running)
    assert running.status().corrupt == 1


def test_dropped_buffers_are_lost_frames(running: V4l2Sensor, hand: ControlTable) -> None:
    hand.set("percentage_of_dropped_buffers", 60)
    try:
        with pytest.raises(FrameLostError, match="lost from frame"):
            read_on(running, 40)
    finally:
        hand.set("percentage_of_dropped_buffers", 0)
    frame = running.read(PATIENCE_S)
    assert frame.flags & FrameFlag.AFTER_LOSS
    assert running.status().lost >= 1


@pytest.mark.parametrize("request_name", ["reqbufs", "qbuf", "streamon"])
def test_a_request_that_fails_is_typed_and_the_next_capture_works(
    running: V4l2Sensor, hand: ControlTable, request_name: str
) -> None:
    running.stop()
    hand.set(f"inject_vidioc_{request_name}_error", 1)
    with pytest.raises(DriverError, match=f"VIDIOC_{request_name.upper()}") as caught:
        running.start()
    assert isinstance(caught.value.__cause__, OSError)
    assert caught.value.__cause__.errno in (errno.EINVAL, errno.ENOMEM, errno.ENOBUFS)
    running.start()
    next_whole(running)


def test_a_fatal_streaming_error_is_a_fault_and_the_next_capture_works(running: V4l2Sensor, hand: ControlTable) -> None:
    hand.set("inject_fatal_streaming_error", 1)
    with pytest.raises(DeviceFaultError, match="EIO"):
        read_on_past_losses(running, 40)
    running.stop()
    running.start()
    next_whole(running)


@pytest.mark.parametrize("stopped", [False, True], ids=["while streaming", "while stopped"])
def test_a_disconnect_is_told_and_after_the_reconnect_the_same_object_captures(stopped: bool) -> None:
    sensor = sensor_on(NODES[0])
    sensor.connect()
    sensor.configure(config())
    sensor.start()
    next_whole(sensor)
    if stopped:
        sensor.stop()
    node = VideoNode(PORT, NODES[0], "hand")
    ControlTable(node).set("disconnect", 1)
    node.close()
    with pytest.raises(DisconnectedError):
        sensor.start() if stopped else read_on_past_losses(sensor, 40)
    # vivid comes back when its last descriptor is closed, which the driver has done.
    sensor.stop()
    sensor.start()
    next_whole(sensor)
    sensor.close()
