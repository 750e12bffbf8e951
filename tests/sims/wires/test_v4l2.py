"""The V4L2 twin as a kernel: raw bytes in, raw bytes or an errno out, and light by the world's clock."""

import errno
import select
import struct
from collections.abc import Callable

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_drivers.ports import SysPort
from gs2ci_sims.wires.v4l2_camera import BITS, PADDING_BYTE, pack_frame, row_bytes
from gs2ci_sims.world import Exposure, World
from tests.twins.v4l2 import CameraModel, V4l2Twin

QUERYCAP, S_FMT, REQBUFS, QUERYBUF = 0x80685600, 0xC0D05605, 0xC0145608, 0xC0585609
QBUF, DQBUF, STREAMON, STREAMOFF = 0xC058560F, 0xC0585611, 0x40045612, 0x40045613
S_EXT_CTRLS, QUERY_EXT_CTRL, SUBSCRIBE, DQEVENT = 0xC0205648, 0xC0E85667, 0x4020565A, 0x80885659
G_EXT_CTRLS, SUBDEV_S_FMT = 0xC0205647, 0xC0585605
TRIGGER_MODE, SINGLE_TRIGGER, PIXEL_RATE, EXPOSURE_AUTO = 0x009819F0, 0x009819F1, 0x009F0902, 0x009A0901
LINE = "dmd0.out2"


class Level:
    """Light that tells the exposure in units of 10 µs."""

    def collect(self, exposure: Exposure) -> np.ndarray:
        level = round((exposure.end_s - exposure.start_s) / 10e-6)
        return np.full((exposure.height, exposure.width), level, np.uint16)


class Kernel:
    """A user of the twin who writes structures by hand."""

    def __init__(self, **model: object) -> None:
        self.world = World(Level())
        self.twin = V4l2Twin(self.world, CameraModel(**{"trigger_line": LINE, **model}))  # type: ignore[arg-type]
        self.fd = self.twin.open("/dev/video0")

    def reqbufs(self, count: int, memory: int = 1, fd: int | None = None) -> int:
        argument = bytearray(struct.pack("<IIIII", count, 1, memory, 0, 0))
        self.twin.ioctl(self.fd if fd is None else fd, REQBUFS, argument)
        return int(struct.unpack_from("<I", argument)[0])

    def buffer(self, request: int, index: int = 0) -> bytearray:
        argument = bytearray(88)
        struct.pack_into("<II", argument, 0, index, 1)
        struct.pack_into("<I", argument, 60, 1)
        self.twin.ioctl(self.fd, request, argument)
        return argument

    def stream(self, request: int) -> None:
        self.twin.ioctl(self.fd, request, bytearray(struct.pack("<I", 1)))

    def control(self, cid: int, value: int) -> None:
        payload = bytearray(struct.pack("<IIIq", cid, 0, 0, value))
        argument = bytearray(32)
        struct.pack_into("<II", argument, 0, 0, 1)
        struct.pack_into("<Q", argument, 24, 0x1000)
        self.twin.ioctl(self.fd, S_EXT_CTRLS, argument, payload)

    def run(self, count: int = 2) -> None:
        self.reqbufs(count)
        for index in range(count):
            self.buffer(QBUF, index)
        self.stream(STREAMON)


def code_of(call: Callable[[], object]) -> str:
    with pytest.raises(OSError, match=r".") as caught:
        call()
    return errno.errorcode[caught.value.errno or 0]


def test_it_is_a_sys_port() -> None:
    assert isinstance(Kernel().twin, SysPort)


def test_who_it_is_in_raw_bytes() -> None:
    k = Kernel()
    argument = bytearray(104)
    k.twin.ioctl(k.fd, QUERYCAP, argument)
    assert argument[0:5] == b"twin\0"
    assert struct.unpack_from("<III", argument, 80) == (0x060100, 0x84000001, 0x04000001)


def test_wrong_calls_fail_as_the_kernel_fails_them() -> None:
    k = Kernel()
    twin, fd = k.twin, k.fd
    assert code_of(lambda: twin.open("/dev/video1")) == "ENOENT"
    assert code_of(lambda: twin.ioctl(99, QUERYCAP, bytearray(104))) == "EBADF"
    assert code_of(lambda: twin.ioctl(fd, 0xC0585604, bytearray(88))) == "ENOTTY"
    assert code_of(lambda: twin.ioctl(fd, QUERYCAP, bytearray(100))) == "EFAULT"
    assert code_of(lambda: k.stream(STREAMON)) == "EINVAL"
    assert code_of(lambda: k.buffer(DQBUF)) == "EINVAL"
    assert code_of(lambda: k.reqbufs(4, memory=2)) == "EINVAL"
    assert code_of(lambda: k.control(0x123, 0)) == "EINVAL"
    assert code_of(lambda: k.control(PIXEL_RATE, 0)) == "EACCES"
    assert code_of(lambda: k.control(TRIGGER_MODE, 9)) == "ERANGE"
    assert code_of(lambda: twin.ioctl(fd, DQEVENT, bytearray(136))) == "ENOENT"
    assert code_of(lambda: twin.ioctl(fd, SUBSCRIBE, bytearray(struct.pack("<I", 4) + bytes(28)))) == "EINVAL"
    assert code_of(lambda: twin.read_file("/sys/module/imx296/parameters/trigger_mode")) == "ENOENT"
    assert twin.poll(99, select.POLLIN, 1.0) == select.POLLNVAL
    assert twin.poll(fd, select.POLLIN, 1.0) == select.POLLERR


def test_wrong_structures_fail_as_the_kernel_fails_them() -> None:
    k = Kernel()
    one = bytearray(32)
    struct.pack_into("<II", one, 0, 0, 1)
    struct.pack_into("<Q", one, 24, 0x1000)
    assert code_of(lambda: k.twin.ioctl(k.fd, S_EXT_CTRLS, one, None)) == "EFAULT"
    trigger = bytearray(struct.pack("<IIIq", SINGLE_TRIGGER, 0, 0, 0))
    assert code_of(lambda: k.twin.ioctl(k.fd, G_EXT_CTRLS, one, trigger)) == "EACCES"
    k.reqbufs(1)
    assert code_of(lambda: k.twin.ioctl(k.fd, STREAMON, bytearray(struct.pack("<I", 9)))) == "EINVAL"
    uvc = Kernel(exposure="absolute")
    assert code_of(lambda: uvc.control(EXPOSURE_AUTO, 2)) == "EINVAL"  # a hole in the menu
    module = Kernel(trigger="module")
    assert code_of(lambda: module.twin.write_file("/sys/module/imx296/parameters/trigger_mode", b"edge")) == "EINVAL"


def test_a_multi_plane_buffer_needs_room_for_its_plane() -> None:
    k = Kernel(multi_plane=True)
    k.twin.ioctl(k.fd, REQBUFS, bytearray(struct.pack("<IIIII", 1, 9, 1, 0, 0)))
    argument = bytearray(88)
    struct.pack_into("<II", argument, 0, 0, 9)
    assert code_of(lambda: k.twin.ioctl(k.fd, QUERYBUF, argument)) == "EFAULT"


def test_a_sub_device_has_one_pad_and_sets_the_size_of_what_streams() -> None:
    k = Kernel(on_subdevice=True)
    sensor = k.twin.open("/dev/v4l-subdev0")
    wanted = bytearray(88)
    struct.pack_into("<IIII", wanted, 0, 1, 1, 16, 8)
    assert code_of(lambda: k.twin.ioctl(sensor, SUBDEV_S_FMT, wanted)) == "EINVAL"
    struct.pack_into("<IIII", wanted, 0, 1, 0, 16, 8)
    k.twin.ioctl(sensor, SUBDEV_S_FMT, wanted)
    k.reqbufs(1)
    k.buffer(QBUF)
    assert code_of(lambda: k.stream(STREAMON)) == "EPIPE"


def test_buffers_keep_the_rules_of_videobuf2() -> None:
    k = Kernel(max_buffers=3)
    assert k.reqbufs(8) == 3
    assert code_of(lambda: k.buffer(QUERYBUF, 3)) == "EINVAL"
    place = k.buffer(QUERYBUF, 1)
    offset, length = struct.unpack_from("<I", place, 64)[0], struct.unpack_from("<I", place, 72)[0]
    assert length >= 64 * 96 * 2
    assert code_of(lambda: k.twin.mmap(k.fd, length, offset + 1)) == "EINVAL"
    assert code_of(lambda: k.twin.mmap(k.fd, length + 1, offset)) == "EINVAL"
    mapping = k.twin.mmap(k.fd, length, offset)
    assert code_of(lambda: k.reqbufs(0)) == "EBUSY"
    k.buffer(QBUF, 1)
    assert code_of(lambda: k.buffer(QBUF, 1)) == "EINVAL"
    k.stream(STREAMON)
    assert code_of(lambda: k.buffer(DQBUF)) == "EAGAIN"
    assert code_of(lambda: k.reqbufs(0)) == "EBUSY"
    assert code_of(lambda: k.twin.ioctl(k.fd, S_FMT, bytearray(struct.pack("<I", 1) + bytes(204)))) == "EBUSY"
    k.stream(STREAMOFF)
    mapping.close()
    assert k.reqbufs(0) == 0


def test_another_descriptor_may_look_but_not_stream() -> None:
    k = Kernel()
    k.run()
    other = k.twin.open("/dev/video0")
    assert code_of(lambda: k.reqbufs(2, fd=other)) == "EBUSY"
    assert code_of(lambda: k.twin.ioctl(other, STREAMOFF, bytearray(struct.pack("<I", 1)))) == "EBUSY"
    k.twin.ioctl(other, QUERYCAP, bytearray(104))
    k.twin.close(k.fd)
    assert k.reqbufs(2, fd=other) == 2


def test_the_trigger_mode_is_grabbed_while_streaming() -> None:
    k = Kernel()
    k.control(TRIGGER_MODE, 1)
    k.run()
    assert code_of(lambda: k.control(TRIGGER_MODE, 0)) == "EBUSY"
    argument = bytearray(struct.pack("<I", TRIGGER_MODE) + bytes(228))
    k.twin.ioctl(k.fd, QUERY_EXT_CTRL, argument)
    assert struct.unpack_from("<I", argument, 72)[0] & 0x2


def test_a_frame_arrives_when_exposure_readout_and_transfer_are_over() -> None:
    k = Kernel(readout_s=3e-3, transfer_s=2e-3, line_s=10e-6, latency_s=1e-4)
    k.control(TRIGGER_MODE, 1)
    k.run()
    begin_s = k.world.clock.now_s()
    k.world.bus.pulse(LINE, 1e-5)
    assert k.twin.poll(k.fd, select.POLLIN, 1.0) == select.POLLIN
    assert k.world.clock.now_s() - begin_s == pytest.approx(1e-4 + 20 * 10e-6 + 3e-3 + 2e-3)
    got = k.buffer(DQBUF)
    seconds, micros = struct.unpack_from("<qq", got, 24)
    assert seconds + micros * 1e-6 == pytest.approx(k.world.clock.now_s(), abs=1e-6)
    assert struct.unpack_from("<I", got, 56)[0] == 0
    assert k.world.exposures[0].start_s - begin_s == pytest.approx(1e-4)


def test_streaming_off_drops_everything_and_numbers_restart() -> None:
    k = Kernel()
    k.control(TRIGGER_MODE, 1)
    k.run()
    for _ in range(2):
        k.world.bus.pulse(LINE, 1e-5)
        assert k.twin.poll(k.fd, select.POLLIN, 1.0) == select.POLLIN
        k.world.clock.sleep_s(0.1)
        k.stream(STREAMOFF)
        assert k.twin.poll(k.fd, select.POLLIN, 0.0) == select.POLLERR
        k.buffer(QBUF, 0)
        k.stream(STREAMON)
    k.world.bus.pulse(LINE, 1e-5)
    k.twin.poll(k.fd, select.POLLIN, 1.0)
    assert struct.unpack_from("<I", k.buffer(DQBUF), 56)[0] == 0


def test_jitter_has_the_spread_of_the_data_sheet_and_the_seed_decides_it() -> None:
    def delays(seed: int) -> np.ndarray:
        world = World(Level())
        model = CameraModel(trigger_line=LINE, latency_s=1e-3, jitter_s=50e-6, readout_s=1e-4)
        k = Kernel()
        k.world, k.twin = world, V4l2Twin(world, model, rng=np.random.default_rng(seed))
        k.fd = k.twin.open("/dev/video0")
        k.control(TRIGGER_MODE, 1)
        k.run(4)
        found = []
        for _ in range(200):
            edge_s = world.clock.now_s()
            world.bus.pulse(LINE, 1e-5)
            k.twin.poll(k.fd, select.POLLIN, 1.0)
            k.buffer(QBUF, struct.unpack_from("<I", k.buffer(DQBUF), 0)[0])
            found.append(world.exposures[-1].start_s - edge_s)
        return np.array(found)

    first = delays(1)
    assert abs(first.mean() - 1e-3) < 15e-6
    assert 40e-6 < first.std() < 60e-6
    np.testing.assert_array_equal(first, delays(1))
    assert not np.array_equal(first, delays(2))


def test_a_slow_crystal_lengthens_exposures() -> None:
    k = Kernel(clock_ppm=10_000.0)
    k.control(TRIGGER_MODE, 1)
    k.run()
    k.world.bus.pulse(LINE, 1e-5)
    k.twin.poll(k.fd, select.POLLIN, 1.0)
    exposure = k.world.exposures[0]
    assert exposure.end_s - exposure.start_s == pytest.approx(200e-6 * 1.01)


def test_an_unplugged_camera_is_gone_until_it_is_plugged_in_with_nothing_set() -> None:
    k = Kernel()
    k.control(TRIGGER_MODE, 1)
    k.run()
    k.twin.unplug()
    k.twin.unplug()
    assert k.twin.poll(k.fd, select.POLLIN, 1.0) == select.POLLERR | select.POLLHUP
    assert code_of(lambda: k.buffer(DQBUF)) == "ENODEV"
    assert k.twin.list_nodes("/dev/video*") == []
    k.twin.plug_in()
    assert code_of(lambda: k.buffer(DQBUF)) == "ENODEV"
    k.fd = k.twin.open("/dev/video0")
    k.run()
    assert k.twin.poll(k.fd, select.POLLIN, 1.0) == select.POLLIN  # free run again


@pytest.mark.parametrize("code", sorted(BITS))
def test_rows_end_in_padding_that_shows_when_the_stride_is_ignored(code: str) -> None:
    stride = row_bytes(code, 8) + 5
    rows = pack_frame(np.zeros((3, 8), np.uint16), code, stride)
    assert (rows[:, -5:] == PADDING_BYTE).all()
    assert not rows[:, :-5].any()


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"formats": ()}, "of format none; allowed: four characters: GREY"),
        ({"formats": ("Y12 ", "MJPG")}, r"of format 'MJPG'; .*change `format` in \[sensor\]"),
        ({"height": 63}, "of 63 rows and .*an even number of rows and a multiple of 4 columns, 4 or more"),
        ({"width": 98}, "and 98 columns"),
        (
            {"height": 2, "width": 4},
            r"of 2 rows and 4 columns.*change `height` and `width` in \[sensor\] and \[world\]",
        ),
    ],
)
def test_a_camera_that_cannot_be_is_refused(model: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        CameraModel(**model)  # type: ignore[arg-type]
