"""One V4L2 device node: each request as a method, each errno as a typed error.

Here: filling in structures, calling, reading them; the only state is the descriptor. Not here: the order of calls
(`driver`), buffers (`streaming`), controls (`controls`). Imported by the rest of this package.
"""

import ctypes
import errno
import os
import select
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, NoReturn, TypeVar

from gs2ci_drivers.failures import (
    AccessError,
    DeviceFaultError,
    DisconnectedError,
    OutOfRangeError,
    RefusedError,
    UnsupportedError,
    WrongStateError,
)
from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.v4l2 import abi

S = TypeVar("S", bound=ctypes.Structure)

LARGEST_PX: Final = 16384
"""A side that no sensor has: the driver answers with its largest."""
_GONE: Final = {errno.ENODEV, errno.ENXIO, errno.ESHUTDOWN}
_ACCESS: Final = {
    errno.EACCES: "no permission, or the value is read-only",
    errno.EPERM: "no permission",
    errno.ENOENT: "there is no such node",
    errno.EBUSY: "it is in use: by another program, or by buffers that are still allocated",
}
_FAULTS: Final = {
    errno.EIO: "EIO: the transfer from the sensor failed",
    errno.EPIPE: "EPIPE: the stream has ended, or the formats along the media pipeline do not agree",
    errno.ENOLINK: "ENOLINK: the media pipeline has a link missing",
    errno.ENOSPC: "ENOSPC: the bus has no bandwidth left for this format and frame rate",
    errno.ENOMEM: "ENOMEM: the kernel has no memory for so many or so large buffers",
    errno.EPROTO: "EPROTO: the device violated the bus protocol",
    errno.ETIMEDOUT: "ETIMEDOUT: the device did not answer its kernel driver",
}

_PIPELINE: Final = (
    "enable the links from the sensor to this node and give each pad on the way the sensor's own format, with "
    "media-ctl: docs/bench.md has the commands for a Raspberry Pi 5"
)
"""What to do where the formats of a pipeline differ, or a link is off (rp1_cfe/cfe.c: media_pipeline_start)."""


def allocate(layout: type[S]) -> tuple[S, bytearray]:
    """Allocate a zeroed structure; return it with the bytes that it is a view of."""
    raw = bytearray(ctypes.sizeof(layout))
    return layout.from_buffer(raw), raw


def raise_typed(device: str, asked: str, error: OSError) -> NoReturn:
    """Turn an errno of V4L2 into a typed error.

    Raises:
        DisconnectedError: ENODEV, ENXIO or ESHUTDOWN: unplugged.
        AccessError: EACCES, EPERM, ENOENT or EBUSY.
        DeviceFaultError: EIO, EPIPE, ENOLINK, ENOSPC, ENOMEM, EPROTO or ETIMEDOUT.
        OutOfRangeError: ERANGE.
        UnsupportedError: ENOTTY.
        WrongStateError: EBADF: the node has been closed.
        RefusedError: EINVAL and every other errno.
    """
    number = error.errno or 0
    if number in _GONE:
        raise DisconnectedError(device, asked, error) from error
    if number in _ACCESS:
        raise AccessError(
            device,
            f"{errno.errorcode[number]}: {_ACCESS[number]}",
            asked=asked,
            remedy="close other programs that use the camera; `gs2ci doctor` prints the udev rules to install",
        ) from error
    if number in _FAULTS:
        raise DeviceFaultError(device, asked, [_FAULTS[number]]) from error
    if number == errno.ERANGE:
        raise OutOfRangeError(device, "ERANGE: the driver does not take this value", asked=asked) from error
    if number == errno.ENOTTY:
        raise UnsupportedError(
            device,
            "ENOTTY: the driver does not know this request",
            asked=asked,
            remedy="choose a video capture node; `gs2ci devices` lists them",
        ) from error
    if number == errno.EBADF:
        raise WrongStateError(device, "the node has been closed", asked=asked) from error
    meaning = "the driver does not know this value, index or order of calls" if number == errno.EINVAL else ""
    code = errno.errorcode.get(number, str(number))
    raise RefusedError(device, asked, code, meaning or os.strerror(number)) from error


@contextmanager
def errno_errors(device: str, asked: str) -> Iterator[None]:
    """Run system calls and translate the errors that they raise by `raise_typed`."""
    try:
        yield
    except OSError as error:
        raise_typed(device, asked, error)


@dataclass(frozen=True)
class Identity:
    """The answer of a node to VIDIOC_QUERYCAP.

    Args:
        driver: Kernel module.
        card: Name of the camera.
        bus: The bus address where it is plugged in.
        version: Kernel version of the driver, `6.1.0`.
        caps: What this node can do.
    """

    driver: str
    card: str
    bus: str
    version: str
    caps: abi.Cap

    @property
    def buffer_type(self) -> abi.BufferType | None:
        """Get the kind of queue that captures frames: single-plane if both are offered, None if neither is."""
        if abi.Cap.VIDEO_CAPTURE in self.caps:
            return abi.BufferType.VIDEO_CAPTURE
        if abi.Cap.VIDEO_CAPTURE_MPLANE in self.caps:
            return abi.BufferType.VIDEO_CAPTURE_MPLANE
        return None


@dataclass(frozen=True)
class NodeFormat:
    """A frame's format from the kernel: four-character code, pixels, bytes per line, bytes per buffer, planes."""

    code: str
    width: int
    height: int
    stride: int
    size_bytes: int
    planes: int


@dataclass(frozen=True)
class Region:
    """A region of the pixel array: first row and column, rows and columns."""

    top: int
    left: int
    height: int
    width: int


@dataclass(frozen=True)
class BufferPlace:
    """Offset and length for mapping a buffer's plane, from VIDIOC_QUERYBUF."""

    length: int
    offset: int


@dataclass(frozen=True)
class Dequeued:
    """A filled buffer as VIDIOC_DQBUF returned it.

    Args:
        index: Which buffer; must be queued again.
        bytes_used: Filled bytes, header included.
        data_offset: Bytes of header before the pixels (multi-plane only).
        flags: The kernel's flags.
        time_ns: The kernel's time stamp.
        sequence: The kernel's frame number since STREAMON, modulo 2³².
    """

    index: int
    bytes_used: int
    data_offset: int
    flags: abi.BufferFlag
    time_ns: int
    sequence: int


class VideoNode:
    """An open V4L2 node.

    Args:
        port: The system calls.
        path: The node, `/dev/video0` or `/dev/v4l-subdev0`.
        device: Name of the device for messages.
        of_subdevice: Whether it is the sensor's own node.

    Every method raises the errors of `raise_typed`.
    """

    def __init__(self, port: SysPort, path: str, device: str, *, of_subdevice: bool = False) -> None:
        self.port = port
        self.path = path
        self.device = device
        self._of_subdevice = of_subdevice
        self.buffer_type = abi.BufferType.VIDEO_CAPTURE
        with errno_errors(device, f"open {path}"):
            self._fd: int = port.open(path)

    def close(self) -> None:
        """Close the node; a second call does nothing."""
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            self.port.close(fd)

    def call(
        self,
        request: int,
        argument: bytearray,
        asked: str,
        payload: bytearray | None = None,
        *,
        unless: Container[int | None] = (),
    ) -> bool:
        """Make one request, on the structure's bytes in place; `asked` names it in messages.

        Returns:
            False if it failed with one of the errnos of `unless`.
        """
        try:
            if self._fd < 0:
                raise OSError(errno.EBADF, os.strerror(errno.EBADF))
            self.port.ioctl(self._fd, request, argument, payload)
        except OSError as error:
            if error.errno not in unless:
                raise_typed(self.device, asked, error)
            return False
        return True

    def identity(self) -> Identity:
        """Return who drives the node and what it can do; later requests use the buffer type found."""
        cap, raw = allocate(abi.Capability)
        self.call(abi.Ioctl.QUERYCAP, raw, "VIDIOC_QUERYCAP")
        everything = abi.Cap(cap.capabilities)
        caps = abi.Cap(cap.device_caps) if abi.Cap.DEVICE_CAPS in everything else everything
        version = ".".join(str(cap.version >> shift & 0xFF) for shift in (16, 8, 0))
        found = Identity(_text(cap.driver), _text(cap.card), _text(cap.bus_info), version, caps)
        self.buffer_type = found.buffer_type or self.buffer_type
        return found

    def formats(self) -> list[str]:
        """List the four-character codes of the pixel formats on offer."""
        codes: list[str] = []
        for index in range(4096):  # a driver whose list never ends must not block the program
            entry, raw = allocate(abi.FormatDescription)
            entry.index, entry.type = index, self.buffer_type
            if not self.call(abi.Ioctl.ENUM_FMT, raw, "VIDIOC_ENUM_FMT", unless=(errno.EINVAL,)):
                break
            if not entry.pixelformat >> 31:  # the top bit marks big-endian words
                codes.append(abi.fourcc_name(entry.pixelformat))
        return codes

    def get_format(self) -> NodeFormat:
        """Return the format in force."""
        fmt, raw = allocate(abi.Format)
        fmt.type = self.buffer_type
        self.call(abi.Ioctl.G_FMT, raw, "VIDIOC_G_FMT")
        return self._read_format(fmt)

    def set_format(self, code: str, width: int, height: int) -> NodeFormat:
        """Request a format; return the one that the driver set, which may differ in every field."""
        return self._negotiate(abi.Ioctl.S_FMT, code, width, height)

    def try_format(self, code: str, width: int, height: int) -> NodeFormat:
        """Return the format that the driver would set; nothing is changed."""
        return self._negotiate(abi.Ioctl.TRY_FMT, code, width, height)

    def _negotiate(self, request: abi.Ioctl, code: str, width: int, height: int) -> NodeFormat:
        fmt, raw = allocate(abi.Format)
        fmt.type = self.buffer_type
        pix = fmt.fmt.pix_mp if self._mplane else fmt.fmt.pix
        pix.width, pix.height, pix.pixelformat, pix.field = width, height, abi.fourcc(code), abi.FIELD_NONE
        if self._mplane:
            pix.num_planes = 1
        self.call(request, raw, f"VIDIOC_{request.name} {code.strip()} {width}x{height}")
        return self._read_format(fmt)

    @property
    def _mplane(self) -> bool:
        return self.buffer_type is abi.BufferType.VIDEO_CAPTURE_MPLANE

    def _read_format(self, fmt: abi.Format) -> NodeFormat:
        if self._mplane:
            pix = fmt.fmt.pix_mp
            plane, planes = pix.plane_fmt[0], int(pix.num_planes)
            stride, size = plane.bytesperline, plane.sizeimage
        else:
            pix, planes = fmt.fmt.pix, 1
            stride, size = pix.bytesperline, pix.sizeimage
        return NodeFormat(abi.fourcc_name(pix.pixelformat), pix.width, pix.height, stride, size, planes)

    def set_bus_format(self, bus_codes: Sequence[int], width: int, height: int) -> tuple[int, int, int]:
        """Set the format on pad 0 of a sub-device; return code, width and height that it set.

        Args:
            bus_codes: The format to request, then others that will do if the sensor settles on one of them.
            width: Columns.
            height: Rows.

        Raises:
            RefusedError: It set another bus format, or refused.
            LinkError: It does not answer.
        """
        fmt, raw = allocate(abi.SubdevFormat)
        fmt.which, fmt.pad = abi.FORMAT_ACTIVE, 0
        fmt.format.width, fmt.format.height, fmt.format.code = width, height, bus_codes[0]
        fmt.format.field = abi.FIELD_NONE
        asked = f"VIDIOC_SUBDEV_S_FMT 0x{bus_codes[0]:04X} {width}x{height}"
        self.call(abi.SUBDEV_S_FMT, raw, asked)
        if fmt.format.code not in bus_codes:
            raise RefusedError(
                self.device,
                asked,
                f"0x{fmt.format.code:04X}",
                "the sensor settled on another bus format",
                remedy="choose a pixel format with the sensor's own bit depth and mosaic",
            )
        return fmt.format.code, fmt.format.width, fmt.format.height

    def largest_px(self) -> tuple[int, int]:
        """Return the largest width and height that a sub-device's own node has, tried only."""
        fmt, raw = allocate(abi.SubdevFormat)
        fmt.format.width = fmt.format.height = LARGEST_PX
        self.call(abi.SUBDEV_S_FMT, raw, "VIDIOC_SUBDEV_S_FMT (try)")
        return fmt.format.width, fmt.format.height

    def get_region(self, target: abi.SelectionTarget) -> Region | None:
        """Return a region of the pixel array; None if the driver has none."""
        selection, raw = self._selection(target)
        request = abi.SUBDEV_G_SELECTION if self._of_subdevice else abi.Ioctl.G_SELECTION
        if self.call(request, raw, "VIDIOC_G_SELECTION", unless=(errno.EINVAL, errno.ENOTTY, errno.ENODATA)):
            return _region(selection)
        return None

    def set_region(self, region: Region, target: abi.SelectionTarget = abi.SelectionTarget.CROP) -> Region:
        """Request a region; return the one that the driver set, which may be moved and widened.

        Args:
            region: The region.
            target: Which region: the one that is read out, or where it is written in the frame.
        """
        selection, raw = self._selection(target)
        selection.r.left, selection.r.top = region.left, region.top
        selection.r.width, selection.r.height = region.width, region.height
        asked = f"VIDIOC_S_SELECTION {region.width}x{region.height} at {region.left}, {region.top}"
        self.call(abi.SUBDEV_S_SELECTION if self._of_subdevice else abi.Ioctl.S_SELECTION, raw, asked)
        return _region(selection)

    def _selection(self, target: abi.SelectionTarget) -> tuple[abi.Selection | abi.SubdevSelection, bytearray]:
        if self._of_subdevice:
            pad, pad_raw = allocate(abi.SubdevSelection)
            pad.which, pad.pad, pad.target = abi.FORMAT_ACTIVE, 0, target
            return pad, pad_raw
        selection, raw = allocate(abi.Selection)
        # The kernel takes the single-plane type for both kinds of queue (V4L2 manual, VIDIOC_G_SELECTION).
        selection.type, selection.target = abi.BufferType.VIDEO_CAPTURE, target
        return selection, raw

    def request_buffers(self, count: int) -> int:
        """Request `count` kernel buffers (0 frees them); return how many were allocated."""
        req, raw = allocate(abi.RequestBuffers)
        req.count, req.type, req.memory = count, self.buffer_type, abi.MEMORY_MMAP
        self.call(abi.Ioctl.REQBUFS, raw, f"VIDIOC_REQBUFS {count}")
        return int(req.count)

    def query_buffer(self, index: int) -> BufferPlace:
        """Return where buffer `index` can be mapped."""
        buffer, raw, plane, payload = self._buffer(index)
        self.call(abi.Ioctl.QUERYBUF, raw, f"VIDIOC_QUERYBUF {index}", payload)
        if plane is not None:
            return BufferPlace(plane.length, plane.m.mem_offset)
        return BufferPlace(buffer.length, buffer.m.offset)

    def queue_buffer(self, index: int) -> None:
        """Queue buffer `index` for the driver to fill."""
        _, raw, _, payload = self._buffer(index)
        self.call(abi.Ioctl.QBUF, raw, f"VIDIOC_QBUF {index}", payload)

    def dequeue_buffer(self) -> Dequeued | None:
        """Take the oldest filled buffer, or None if there is none yet (EAGAIN)."""
        buffer, raw, plane, payload = self._buffer(0)
        if not self.call(abi.Ioctl.DQBUF, raw, "VIDIOC_DQBUF", payload, unless=(errno.EAGAIN,)):
            return None
        return Dequeued(
            index=buffer.index,
            bytes_used=buffer.bytesused if plane is None else plane.bytesused,
            data_offset=0 if plane is None else plane.data_offset,
            flags=abi.BufferFlag(buffer.flags),
            time_ns=buffer.timestamp.sec * 1_000_000_000 + buffer.timestamp.usec * 1_000,
            sequence=buffer.sequence,
        )

    def _buffer(self, index: int) -> tuple[abi.Buffer, bytearray, abi.Plane | None, bytearray | None]:
        buffer, raw = allocate(abi.Buffer)
        buffer.index, buffer.type, buffer.memory = index, self.buffer_type, abi.MEMORY_MMAP
        if not self._mplane:
            return buffer, raw, None, None
        plane, payload = allocate(abi.Plane)
        buffer.m.planes, buffer.length = ctypes.addressof(plane), 1
        return buffer, raw, plane, payload

    def stream_on(self) -> None:
        """Start streaming; frame numbers restart."""
        try:
            self.call(abi.Ioctl.STREAMON, self._type_argument(), "VIDIOC_STREAMON")
        except DeviceFaultError as error:
            if isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.EPIPE, errno.ENOLINK):
                error.remedy = _PIPELINE
            raise

    def stream_off(self) -> None:
        """Stop streaming; every queued and filled buffer is dropped."""
        self.call(abi.Ioctl.STREAMOFF, self._type_argument(), "VIDIOC_STREAMOFF")

    def _type_argument(self) -> bytearray:
        return bytearray(int(self.buffer_type).to_bytes(4, "little"))

    def subscribe(self, event: abi.EventType) -> bool:
        """Subscribe to an event; return False if the driver does not have it."""
        sub, raw = allocate(abi.EventSubscription)
        sub.type = event
        asked = f"VIDIOC_SUBSCRIBE_EVENT {event.name}"
        return self.call(abi.Ioctl.SUBSCRIBE_EVENT, raw, asked, unless=(errno.EINVAL, errno.ENOTTY))

    def dequeue_event(self) -> int | None:
        """Take the oldest event's type, or None when there is none."""
        event, raw = allocate(abi.V4l2Event)
        there = self.call(abi.Ioctl.DQEVENT, raw, "VIDIOC_DQEVENT", unless=(errno.ENOENT, errno.EAGAIN))
        return int(event.type) if there else None

    def wait(self, timeout_s: float) -> int:
        """Wait for a frame or an event; return poll's mask (POLLIN, POLLPRI, POLLERR, POLLHUP), 0 after `timeout_s`.

        Raises:
            WrongStateError: The node has been closed.
            LinkError: The wait failed.
        """
        if self._fd < 0:
            raise WrongStateError(self.device, "the node has been closed", asked="poll")
        with errno_errors(self.device, "poll"):
            return self.port.poll(self._fd, select.POLLIN | select.POLLPRI, timeout_s)

    @property
    def fd(self) -> int:
        """Get the descriptor, for mapping buffers."""
        return self._fd


def _region(selection: abi.Selection | abi.SubdevSelection) -> Region:
    return Region(selection.r.top, selection.r.left, selection.r.height, selection.r.width)


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")
