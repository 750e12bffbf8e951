"""Every fault of the V4L2 twin and every errno: a typed error in time, and the next capture works."""

import contextlib
import errno
import select
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gs2ci_drivers.failures import (
    AccessError,
    DeviceFaultError,
    DisconnectedError,
    DriverError,
    FrameCorruptError,
    FrameLostError,
    FrameStaleError,
    OutOfRangeError,
    RefusedError,
    TriggerTimeoutError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.sensor import FrameFlag
from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.node import Dequeued, VideoNode
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_drivers.v4l2.streaming import BufferQueue
from gs2ci_sims.faults import KNOWN

Build = Callable[..., Any]
TIMEOUT_S = 0.25

FRAME_FAULTS = {
    "v4l2.trigger_missed": (TriggerTimeoutError, {}, "no frame 1"),
    "v4l2.stalled": (TriggerTimeoutError, {}, "no frame 1"),
    "v4l2.frame_late": (TriggerTimeoutError, {"value": 5.0}, "no frame 1"),
    "v4l2.frame_corrupt": (FrameCorruptError, {}, "frame 1 .*V4L2_BUF_FLAG_ERROR"),
    "v4l2.frame_short": (FrameCorruptError, {}, "frame 1 .*6144 bytes instead of 12288"),
    "v4l2.frame_noisy": (FrameCorruptError, {}, "frame 1 .*0 to 1023"),
    "v4l2.stream_broken": (DeviceFaultError, {}, "EIO"),
    "v4l2.stream_ended": (DeviceFaultError, {}, "LAST"),
    "v4l2.source_changed": (DeviceFaultError, {}, "SOURCE_CHANGE"),
    "v4l2.frame_stale": (FrameStaleError, {"value": 3.0}, r"frame 1 was taken 2\.9\d s before"),
}


@pytest.mark.parametrize("fault", sorted(FRAME_FAULTS))
def test_a_fault_of_one_frame_is_told_in_time_with_its_index(bench: Build, fault: str) -> None:
    kind, extra, message = FRAME_FAULTS[fault]
    b = bench()
    b.begin()
    b.faults.inject(fault, skip=1, **extra)
    b.fire(2)
    b.sensor.read(TIMEOUT_S, trigger_index=0)
    begin_s = b.world.clock.now_s()
    with pytest.raises(kind, match=f"cam0, trigger 1: .*{message}") as caught:
        b.sensor.read(TIMEOUT_S, not_before_ns=b.world.clock.now_ns(), trigger_index=1)
    assert b.world.clock.now_s() - begin_s <= TIMEOUT_S + 1e-9
    assert caught.value.trigger_index == 1
    assert getattr(caught.value, "frame_index", 1) == 1
    b.capture_works()


def test_a_gap_is_told_first_and_the_frame_behind_it_comes_next(bench: Build) -> None:
    b = bench()
    b.begin()
    b.faults.inject("v4l2.frame_dropped", skip=1, times=2)
    b.fire(4)
    b.sensor.read(TIMEOUT_S)
    with pytest.raises(FrameLostError, match=r"2 frame.* from frame 1 on") as caught:
        b.sensor.read(TIMEOUT_S, trigger_index=1)
    assert (caught.value.frame_index, caught.value.lost) == (1, 2)
    frame = b.sensor.read(TIMEOUT_S)
    assert frame.sequence == 3
    assert FrameFlag.AFTER_LOSS in frame.flags
    np.testing.assert_array_equal(frame.pixels[0, :4], [7, 8, 9, 10])  # dropped frames cost no light
    b.capture_works()


def test_frames_that_find_no_buffer_are_a_gap(bench: Build) -> None:
    b = bench()
    b.begin(buffers=2)
    b.fire(5)
    b.world.clock.sleep_s(0.5)
    assert [b.sensor.read(TIMEOUT_S).sequence for _ in range(2)] == [0, 1]
    b.fire()
    with pytest.raises(FrameLostError, match=r"3 frame.* from frame 2 on"):
        b.sensor.read(TIMEOUT_S)
    assert b.sensor.read(TIMEOUT_S).sequence == 5
    assert b.sensor.status().lost == 3


def test_a_first_frame_with_a_number_above_zero_means_loss(bench: Build) -> None:
    b = bench()
    b.faults.inject("v4l2.first_number", value=2, skip=1)
    b.begin()
    b.fire()
    with pytest.raises(FrameLostError, match=r"2 frame.* from frame 0 on"):
        b.sensor.read(TIMEOUT_S)
    b.capture_works()


def test_a_repeated_number_is_a_corrupt_frame_and_the_count_goes_on(bench: Build) -> None:
    b = bench()
    b.begin()
    b.faults.inject("v4l2.frame_repeated")
    b.fire(3)
    assert b.sensor.read(TIMEOUT_S).sequence == 0
    with pytest.raises(FrameCorruptError, match="number 0 arrived before"):
        b.sensor.read(TIMEOUT_S)
    assert b.sensor.read(TIMEOUT_S).sequence == 1
    assert b.sensor.status().corrupt == 1


def test_a_corrupt_frame_does_not_stop_the_stream(bench: Build) -> None:
    b = bench()
    b.begin()
    b.faults.inject("v4l2.frame_corrupt")
    b.fire(2)
    with pytest.raises(FrameCorruptError):
        b.sensor.read(TIMEOUT_S)
    assert b.sensor.read(TIMEOUT_S).sequence == 1


def test_a_double_trigger_is_seen_as_one_frame_too_many(bench: Build) -> None:
    b = bench()
    b.begin()
    b.faults.inject("v4l2.trigger_doubled")
    b.fire()
    b.sensor.read(TIMEOUT_S)
    assert b.sensor.read(TIMEOUT_S).sequence == 1
    with pytest.raises(TriggerTimeoutError, match="no frame 2"):
        b.sensor.read(TIMEOUT_S)


def test_stamps_of_another_clock_are_not_called_stale(bench: Build) -> None:
    b = bench(monotonic=False)
    b.begin()
    b.faults.inject("v4l2.frame_stale", value=500.0)
    b.fire()
    frame = b.sensor.read(TIMEOUT_S, not_before_ns=b.world.clock.now_ns())
    assert FrameFlag.STAMPED_MONOTONIC not in frame.flags


def test_a_timeout_waits_exactly_as_long_as_it_was_told(bench: Build) -> None:
    b = bench()
    b.begin()
    begin_s = b.world.clock.now_s()
    with pytest.raises(TriggerTimeoutError, match=r"after 0\.7 s") as caught:
        b.sensor.read(0.7)
    assert b.world.clock.now_s() - begin_s == pytest.approx(0.7)
    assert caught.value.waited_s == 0.7


def test_wake_ups_without_a_frame_are_survived_and_a_storm_of_them_is_a_fault(bench: Build) -> None:
    b = bench()
    b.begin()
    b.faults.inject("v4l2.wake_empty", times=5)
    b.fire()
    assert b.sensor.read(TIMEOUT_S).sequence == 0
    b.faults.inject("v4l2.wake_empty", times=1000)
    with pytest.raises(DeviceFaultError, match="64 wake-ups without a frame"):
        b.sensor.read(TIMEOUT_S)
    b.faults.clear()
    b.capture_works()


def test_a_missing_event_interface_is_no_reason_not_to_capture(bench: Build) -> None:
    b = bench(has_events=False)
    b.begin()
    b.capture_works()


def test_pre_triggers_that_the_sensor_ignores_show_as_a_timeout(bench: Build) -> None:
    b = bench(ignored_triggers=2)
    b.begin()
    b.fire(2)
    with pytest.raises(TriggerTimeoutError, match="no frame 0"):
        b.sensor.read(TIMEOUT_S)
    b.fire()
    assert b.sensor.read(TIMEOUT_S).sequence == 0


# ---- errnos

IOCTLS = [
    "QUERYCAP",
    "ENUM_FMT",
    "G_FMT",
    "TRY_FMT",
    "S_FMT",
    "QUERY_EXT_CTRL",
    "QUERYMENU",
    "G_EXT_CTRLS",
    "S_EXT_CTRLS",
    "REQBUFS",
    "QUERYBUF",
    "QBUF",
    "SUBSCRIBE_EVENT",
    "STREAMON",
    "STREAMOFF",
    "DQBUF",
]
STEPS = ["open", "mmap", "poll", *(f"VIDIOC_{name}" for name in IOCTLS)]
ERRNOS = {
    errno.ENODEV: DisconnectedError,
    errno.ENXIO: DisconnectedError,
    errno.EIO: DeviceFaultError,
    errno.EPIPE: DeviceFaultError,
    errno.ENOSPC: DeviceFaultError,
    errno.ENOMEM: DeviceFaultError,
    errno.EBUSY: AccessError,
    errno.EACCES: AccessError,
    errno.EPERM: AccessError,
    errno.ERANGE: OutOfRangeError,
    errno.ENOTTY: UnsupportedError,
    errno.EINVAL: RefusedError,
    errno.EFAULT: RefusedError,
}
# Here an errno has a meaning of its own in the protocol, and is not the end of the call.
ANSWERS = {
    ("VIDIOC_ENUM_FMT", errno.EINVAL): UnsupportedError,
    ("VIDIOC_QUERY_EXT_CTRL", errno.EINVAL): UnsupportedError,
    ("VIDIOC_QUERY_EXT_CTRL", errno.ENOTTY): UnsupportedError,
    ("VIDIOC_QUERYMENU", errno.EINVAL): None,
    ("VIDIOC_S_EXT_CTRLS", errno.EINVAL): OutOfRangeError,
    ("VIDIOC_SUBSCRIBE_EVENT", errno.EINVAL): None,
    ("VIDIOC_SUBSCRIBE_EVENT", errno.ENOTTY): None,
}


def capture(b: Any) -> None:
    b.begin()
    b.fire()
    b.sensor.read(TIMEOUT_S, trigger_index=0)
    b.sensor.stop()


@pytest.mark.parametrize("number", sorted(ERRNOS), ids=lambda n: errno.errorcode[n])
@pytest.mark.parametrize("step", STEPS)
def test_any_errno_at_any_step_is_a_typed_error_and_the_next_capture_works(
    bench: Build, step: str, number: int
) -> None:
    b = bench()
    b.faults.inject("v4l2.call_fails", value=number, about=step)
    wanted = ANSWERS.get((step, number), ERRNOS[number])
    begin_s = b.world.clock.now_s()
    if wanted is None:
        capture(b)
    else:
        with pytest.raises(wanted):
            capture(b)
    assert b.world.clock.now_s() - begin_s <= 1.0
    assert b.faults.struck == [("v4l2.call_fails", step)]
    b.sensor.connect()
    b.capture_works()
    b.sensor.close()
    assert b.twin.calls[-1] == "close"


@pytest.mark.parametrize("step", STEPS)
def test_an_unplug_at_any_step_is_told_and_after_a_replug_the_same_object_captures(bench: Build, step: str) -> None:
    b = bench()
    b.faults.inject("v4l2.unplugged", about=step)
    with pytest.raises(DisconnectedError):
        capture(b)
    with pytest.raises(DriverError):
        capture(b)
    b.twin.plug_in()
    b.sensor.stop()
    b.sensor.connect()
    b.capture_works()


@pytest.mark.parametrize("when_s", [0.0005, 0.002, 0.1])
def test_an_unplug_while_waiting_ends_the_wait_at_once(bench: Build, when_s: float) -> None:
    b = bench()
    b.begin()
    b.fire()
    b.sensor.read(TIMEOUT_S)
    begin_s = b.world.clock.now_s()
    b.world.clock.after(when_s, b.twin.unplug)
    with pytest.raises(DisconnectedError, match="trigger 1"):
        b.sensor.read(10.0, trigger_index=1)
    assert b.world.clock.now_s() - begin_s == pytest.approx(when_s)
    with pytest.raises(DisconnectedError):
        b.sensor.read(10.0)
    with pytest.raises(DisconnectedError):
        b.sensor.status()
    b.sensor.stop()
    b.twin.plug_in()
    b.sensor.start()  # without configure: the settings are applied again
    b.fire()
    assert b.sensor.read(TIMEOUT_S).pixels.shape == (64, 96)


def test_stop_after_an_unplug_tells_it_and_counts_as_stopped(bench: Build) -> None:
    b = bench()
    b.begin()
    b.twin.unplug()
    with pytest.raises(DisconnectedError):
        b.sensor.stop()
    b.sensor.stop()
    b.twin.plug_in()
    b.capture_works()


def test_close_never_raises_whatever_fails(bench: Build) -> None:
    for step in ("STREAMOFF", "REQBUFS", "EXT_CTRLS"):
        b = bench()
        b.begin()
        b.faults.inject("v4l2.call_fails", value=errno.EIO, about=step, times=9)
        b.sensor.close()
        assert b.twin.calls[-1] == "close"


def test_a_failing_stop_still_gives_the_buffers_back(bench: Build) -> None:
    b = bench()
    b.begin()
    b.faults.inject("v4l2.call_fails", value=errno.EIO, about="STREAMOFF")
    with pytest.raises(DeviceFaultError, match="STREAMOFF"):
        b.sensor.stop()
    b.capture_works()


def test_a_control_that_the_camera_ignores_is_told_as_clamped(bench: Build) -> None:
    b = bench()
    b.faults.inject("v4l2.control_ignored", about="IO Mode")
    b.begin(controls={"io_mode": 3})
    assert b.sensor.applied_controls[-1].clamped
    assert [note for note in b.sensor.incidents if "io_mode = 3 was requested, " in note]


def test_an_exposure_that_the_camera_ignores_is_seen_in_the_settings(bench: Build) -> None:
    b = bench()
    b.faults.inject("v4l2.control_ignored", about="Exposure")
    b.begin(exposure_s=0.4e-3)
    assert b.sensor.settings.exposure_s == pytest.approx(20 * 10e-6)


def test_every_fault_of_the_twin_has_a_test() -> None:
    whole_captures = Path(__file__).parents[2] / "system" / "fault_cases.csv"
    text = "".join(path.read_text() for path in (*Path(__file__).parent.glob("test_*.py"), whole_captures))
    assert [name for name in KNOWN if name.startswith("v4l2.") and name not in text] == []


# ---- fuzz


@pytest.mark.parametrize("seed", range(40))
def test_any_few_failing_calls_end_in_typed_errors_only(bench: Build, seed: int) -> None:
    rng = np.random.default_rng(seed)
    b = bench()
    for _ in range(rng.integers(1, 5)):
        # EINVAL is a legal answer to a query (no such entry), after which the camera has one ability less.
        number = int(rng.choice(sorted(ERRNOS.keys() - {errno.EINVAL})))
        b.faults.inject("v4l2.call_fails", value=number, skip=int(rng.integers(0, 90)))
    for _ in range(4):
        with contextlib.suppress(DriverError):
            capture(b)
        with contextlib.suppress(DriverError):
            b.sensor.stop()
    b.faults.clear()
    b.sensor.connect()
    b.capture_works()


@pytest.mark.parametrize("seed", range(60))
def test_any_bytes_from_the_kernel_give_a_typed_error_or_a_frame(bench: Build, seed: int, monkeypatch: Any) -> None:
    """A kernel gone mad: some answers are overwritten with random bytes; nothing hangs, nothing else escapes."""
    rng = np.random.default_rng(seed)
    b = bench()
    ioctl = b.twin.ioctl

    def mad(fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        result = ioctl(fd, request, argument, payload)
        if rng.random() < 0.05:
            for target in (argument, payload):
                if target is not None:
                    at = int(rng.integers(0, len(target)))
                    noise = rng.bytes(min(8, len(target) - at))
                    target[at : at + len(noise)] = noise
        return int(result)

    monkeypatch.setattr(b.twin, "ioctl", mad)
    begin_s = b.world.clock.now_s()
    with contextlib.suppress(DriverError):
        capture(b)
    b.sensor.close()
    assert b.world.clock.now_s() - begin_s < 5.0


# -- what no fault of the twin brings about ----------------------------------------------------------------------


def test_a_warm_up_frame_that_never_comes_is_told_in_time_and_the_next_start_works(
    bench: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    b = bench()
    b.sensor.connect()
    b.sensor.configure(replace(b.config, warm_up_frames=2))
    with monkeypatch.context() as patch:
        patch.setattr(BufferQueue, "take", lambda queue, timeout_s: None)
        with pytest.raises(TriggerTimeoutError, match="no frame 0 after"):
            b.sensor.start()
    b.capture_works()


@pytest.mark.parametrize(
    ("event", "error", "says"),
    [
        (select.POLLHUP, DisconnectedError, "POLLHUP"),
        (select.POLLERR, DeviceFaultError, "the stream failed"),
    ],
)
def test_a_poll_that_reports_trouble_without_a_reason_is_a_typed_error(
    bench: Build, monkeypatch: pytest.MonkeyPatch, event: int, error: type[DriverError], says: str
) -> None:
    b = bench()
    b.begin()
    monkeypatch.setattr(b.twin, "poll", lambda fd, events, timeout_s: event)
    monkeypatch.setattr(VideoNode, "dequeue_buffer", lambda node: None)
    with pytest.raises(error, match=says):
        b.sensor.read(1.0)


def test_a_buffer_that_was_never_given_out_is_a_fault(bench: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    b = bench()
    b.begin()
    got = VideoNode.dequeue_buffer

    def another(node: VideoNode) -> Dequeued | None:
        buffer = got(node)
        return buffer and replace(buffer, index=77)

    monkeypatch.setattr(VideoNode, "dequeue_buffer", another)
    b.fire()
    with pytest.raises(DeviceFaultError, match="buffer 77 of 4 came back"):
        b.sensor.read(1.0)


@pytest.mark.parametrize(
    ("stated", "says"),
    [
        ({"stride": 3}, "3 bytes per line"),
        ({"size_bytes": 10}, "buffers of 10 bytes for frames of"),
    ],
)
def test_a_kernel_that_states_an_impossible_frame_is_a_fault(
    bench: Build, monkeypatch: pytest.MonkeyPatch, stated: dict[str, int], says: str
) -> None:
    b = bench()
    b.sensor.connect()
    read = VideoNode._read_format
    monkeypatch.setattr(VideoNode, "_read_format", lambda node, fmt: replace(read(node, fmt), **stated))
    with pytest.raises(DeviceFaultError, match=says):
        b.sensor.configure(b.config)


def test_a_present_format_that_nobody_can_unpack_is_refused_with_those_there_are(
    bench: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    b = bench()
    b.sensor.connect()
    present = VideoNode.get_format
    monkeypatch.setattr(VideoNode, "get_format", lambda node: replace(present(node), code="MJPG"))
    with pytest.raises(UnsupportedError, match=r"'MJPG' cannot be unpacked; allowed: .*set `format`"):
        b.sensor.configure(replace(b.config, fourcc=""))


def test_a_sensor_that_settles_on_another_bus_format_is_refused(bench: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    b = bench(V4l2Options(trigger_adapter="control", subdevice="/dev/v4l-subdev0"), on_subdevice=True)
    b.sensor.connect()
    call = VideoNode.call

    def settled(node: VideoNode, request: int, argument: bytearray, *others: Any, **named: Any) -> bool:
        answered = call(node, request, argument, *others, **named)
        if request == abi.SUBDEV_S_FMT:
            abi.SubdevFormat.from_buffer(argument).format.code = 0x1234
        return answered

    monkeypatch.setattr(VideoNode, "call", settled)
    with pytest.raises(RefusedError, match=r"refused with 0x1234.*settled on another bus format"):
        b.sensor.configure(b.config)


def test_a_node_that_was_closed_refuses_everything(bench: Build) -> None:
    node = VideoNode(bench().twin, "/dev/video0", "cam0")
    node.close()
    for use in (node.identity, lambda: node.wait(0.1)):
        with pytest.raises(WrongStateError, match="the node has been closed"):
            use()


@pytest.mark.parametrize("number", [errno.EPIPE, errno.ENOLINK])
def test_a_pipeline_that_is_not_set_up_is_told_with_what_to_do(bench: Build, number: int) -> None:
    """rp1-cfe's link from csi2 to its node is off after each start (raspberrypi/libcamera issue 194, media-ctl -p)."""
    b = bench()
    b.faults.inject("v4l2.call_fails", value=number, about="VIDIOC_STREAMON")
    with pytest.raises(DeviceFaultError, match=r"enable the links .* with media-ctl: docs/bench.md"):
        b.begin()
