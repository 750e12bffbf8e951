"""Frames of our own, written to v4l2loopback as a camera would, come back through the driver byte for byte."""

import fcntl
import os
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest

from gs2ci.core.clock import WallClock
from gs2ci_drivers.failures import FrameCorruptError, FrameLostError, TriggerTimeoutError
from gs2ci_drivers.links.v4l2_sys import KernelSysPort
from gs2ci_drivers.sensor import SensorConfig, TriggerMode
from gs2ci_drivers.v4l2.driver import V4l2Sensor
from gs2ci_drivers.v4l2.options import V4l2Options

NODE = "/dev/video50"
S_FMT, OUTPUT, FIELD_NONE = 0xC0D05605, 2, 1
HEIGHT, WIDTH = 48, 64


class Writer:
    """The camera's side of the loopback: sets the format and writes whole frames."""

    def __init__(self, code: str, item_bytes: int) -> None:
        self._fd = os.open(NODE, os.O_RDWR)
        form = bytearray(208)
        stride = WIDTH * item_bytes
        struct.pack_into("<I", form, 0, OUTPUT)
        struct.pack_into("<II4sIII", form, 8, WIDTH, HEIGHT, code.encode(), FIELD_NONE, stride, stride * HEIGHT)
        fcntl.ioctl(self._fd, S_FMT, form)
        assert struct.unpack_from("<II4s", form, 8) == (WIDTH, HEIGHT, code.encode())

    def write(self, frame: np.ndarray) -> None:
        data = frame.tobytes()
        assert os.write(self._fd, data) == len(data)

    def close(self) -> None:
        os.close(self._fd)


@contextmanager
def sending(writer: Writer, frames: list[np.ndarray]) -> Iterator[None]:
    """Write the frames again and again until the end of the block."""
    done = threading.Event()

    def run() -> None:
        while not done.is_set():
            for frame in frames:
                writer.write(frame)
                time.sleep(0.05)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def reader(code: str) -> V4l2Sensor:
    options = V4l2Options(port=NODE, trigger_adapter="none", fixed_exposure_s=0.01, first_sequence=-1)
    sensor = V4l2Sensor("cam0", KernelSysPort(), WallClock(), options)
    sensor.connect()
    sensor.configure(SensorConfig(HEIGHT, WIDTH, code.strip(), trigger=TriggerMode.FREE_RUN))
    sensor.start()
    return sensor


def indices_seen(sensor: V4l2Sensor, frames: list[np.ndarray]) -> set[int]:
    """Read until every frame has been seen; assert that each picture is exactly one of them."""
    seen: set[int] = set()
    for _ in range(200):
        try:
            pixels = sensor.read(20.0).pixels
        except (FrameLostError, FrameCorruptError):
            # An emulated machine is slow, and the loopback hands its first frame out twice under one number.
            continue
        matches = [i for i, frame in enumerate(frames) if np.array_equal(frame, pixels)]
        assert len(matches) == 1
        seen |= set(matches)
        if len(seen) == len(frames):
            break
    return seen


@pytest.mark.parametrize(("code", "dtype"), [("GREY", "u1"), ("RGGB", "u1"), ("Y16 ", "<u2")])
def test_our_frames_come_back_byte_exact(code: str, dtype: str) -> None:
    rng = np.random.default_rng(3)
    top = np.iinfo(dtype).max
    frames = [rng.integers(0, top + 1, (HEIGHT, WIDTH)).astype(dtype) for _ in range(5)]
    with closing(Writer(code, np.dtype(dtype).itemsize)) as writer:
        writer.write(frames[0])
        with sending(writer, frames), closing(reader(code)) as sensor:
            assert indices_seen(sensor, frames) == set(range(len(frames)))
            assert sensor.status().corrupt <= 1


def test_silence_ends_in_a_timeout_naming_the_frame() -> None:
    with closing(Writer("GREY", 1)) as writer:
        writer.write(np.zeros((HEIGHT, WIDTH), np.uint8))
        with closing(reader("GREY")) as sensor:
            sensor.discard()
            begin = time.monotonic()
            with pytest.raises(TriggerTimeoutError, match="trigger 3"):
                sensor.read(1.0, trigger_index=3)
            assert 1.0 <= time.monotonic() - begin < 20.0
