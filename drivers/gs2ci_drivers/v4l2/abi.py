"""The V4L2 ABI of 64-bit Linux: structures, ioctl numbers, control ids and flags, exactly those the driver uses.

Here: layouts and numbers (linux/videodev2.h, linux/v4l2-controls.h, linux/v4l2-subdev.h), no behaviour. Not here: pixel
layouts (`formats`), calls (`node`). The simulated kernel builds the same bytes with code of its own, so that an error
here does not cancel against the same error there.

Packed structures name their layout, which Python requires from 3.19 on and warns of from 3.14 on: "ms" is the only one
that ctypes packs. Without bit fields it is that of the kernel's compilers; earlier versions ignore the name.
"""

import ctypes
import enum
from typing import Final

_READ: Final = 2
_WRITE: Final = 1

u8, u16, u32, u64 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64
s32, s64 = ctypes.c_int32, ctypes.c_int64


class Capability(ctypes.Structure):
    """struct v4l2_capability: who drives the node and what it can do."""

    _fields_ = (
        ("driver", ctypes.c_char * 16),
        ("card", ctypes.c_char * 32),
        ("bus_info", ctypes.c_char * 32),
        ("version", u32),
        ("capabilities", u32),
        ("device_caps", u32),
        ("reserved", u32 * 3),
    )


class FormatDescription(ctypes.Structure):
    """struct v4l2_fmtdesc: one pixel format on offer."""

    _fields_ = (
        ("index", u32),
        ("type", u32),
        ("flags", u32),
        ("description", ctypes.c_char * 32),
        ("pixelformat", u32),
        ("mbus_code", u32),
        ("reserved", u32 * 3),
    )


class PixFormat(ctypes.Structure):
    """struct v4l2_pix_format: geometry of a frame that lies in one plane."""

    _fields_ = (
        ("width", u32),
        ("height", u32),
        ("pixelformat", u32),
        ("field", u32),
        ("bytesperline", u32),
        ("sizeimage", u32),
        ("colorspace", u32),
        ("priv", u32),
        ("flags", u32),
        ("ycbcr_enc", u32),
        ("quantization", u32),
        ("xfer_func", u32),
    )


class PlanePixFormat(ctypes.Structure):
    """struct v4l2_plane_pix_format: size and stride of one plane."""

    _layout_, _pack_ = "ms", 1
    _fields_ = (("sizeimage", u32), ("bytesperline", u32), ("reserved", u16 * 6))


class PixFormatMplane(ctypes.Structure):
    """struct v4l2_pix_format_mplane: geometry of a frame spread over up to eight planes."""

    _layout_, _pack_ = "ms", 1
    _fields_ = (
        ("width", u32),
        ("height", u32),
        ("pixelformat", u32),
        ("field", u32),
        ("colorspace", u32),
        ("plane_fmt", PlanePixFormat * 8),
        ("num_planes", u8),
        ("flags", u8),
        ("ycbcr_enc", u8),
        ("quantization", u8),
        ("xfer_func", u8),
        ("reserved", u8 * 7),
    )


class _FormatUnion(ctypes.Union):
    # The kernel's union also holds struct v4l2_window, whose pointers align it to eight bytes.
    _fields_ = (("pix", PixFormat), ("pix_mp", PixFormatMplane), ("raw_data", u8 * 200), ("_align", u64))


class Format(ctypes.Structure):
    """struct v4l2_format: a buffer type and its format (at byte 8)."""

    _fields_ = (("type", u32), ("fmt", _FormatUnion))


class RequestBuffers(ctypes.Structure):
    """struct v4l2_requestbuffers: how many buffers are requested, and how many were allocated."""

    _fields_ = (
        ("count", u32),
        ("type", u32),
        ("memory", u32),
        ("capabilities", u32),
        ("flags", u8),
        ("reserved", u8 * 3),
    )


class Timeval(ctypes.Structure):
    """struct timeval of 64-bit Linux."""

    _fields_ = (("sec", s64), ("usec", s64))


class Timecode(ctypes.Structure):
    """struct v4l2_timecode; unused, it only takes its place in the buffer."""

    _fields_ = (
        ("type", u32),
        ("flags", u32),
        ("frames", u8),
        ("seconds", u8),
        ("minutes", u8),
        ("hours", u8),
        ("userbits", u8 * 4),
    )


class _PlaneMemory(ctypes.Union):
    _fields_ = (("mem_offset", u32), ("userptr", u64), ("fd", s32))


class Plane(ctypes.Structure):
    """struct v4l2_plane: one plane of a multi-plane buffer."""

    _fields_ = (
        ("bytesused", u32),
        ("length", u32),
        ("m", _PlaneMemory),
        ("data_offset", u32),
        ("reserved", u32 * 11),
    )


class _BufferMemory(ctypes.Union):
    _fields_ = (("offset", u32), ("userptr", u64), ("planes", u64), ("fd", s32))


class Buffer(ctypes.Structure):
    """struct v4l2_buffer: one frame buffer on its way through the queue."""

    _fields_ = (
        ("index", u32),
        ("type", u32),
        ("bytesused", u32),
        ("flags", u32),
        ("field", u32),
        ("timestamp", Timeval),
        ("timecode", Timecode),
        ("sequence", u32),
        ("memory", u32),
        ("m", _BufferMemory),
        ("length", u32),
        ("reserved2", u32),
        ("request_fd", s32),
    )


class QueryExtCtrl(ctypes.Structure):
    """struct v4l2_query_ext_ctrl: name, range and kind of a control."""

    _fields_ = (
        ("id", u32),
        ("type", u32),
        ("name", ctypes.c_char * 32),
        ("minimum", s64),
        ("maximum", s64),
        ("step", u64),
        ("default_value", s64),
        ("flags", u32),
        ("elem_size", u32),
        ("elems", u32),
        ("nr_of_dims", u32),
        ("dims", u32 * 4),
        ("reserved", u32 * 32),
    )


class _MenuItem(ctypes.Union):
    _layout_, _pack_ = "ms", 1
    _fields_ = (("name", ctypes.c_char * 32), ("value", s64))


class QueryMenu(ctypes.Structure):
    """struct v4l2_querymenu: one entry of a menu control."""

    _layout_, _pack_ = "ms", 1
    _fields_ = (("id", u32), ("index", u32), ("u", _MenuItem), ("reserved", u32))


class _ExtControlValue(ctypes.Union):
    _layout_, _pack_ = "ms", 1
    _fields_ = (("value", s32), ("value64", s64), ("ptr", u64))


class ExtControl(ctypes.Structure):
    """struct v4l2_ext_control: one control value (packed)."""

    _layout_, _pack_ = "ms", 1
    _fields_ = (("id", u32), ("size", u32), ("reserved2", u32), ("u", _ExtControlValue))


class ExtControls(ctypes.Structure):
    """struct v4l2_ext_controls: a batch of control values behind a pointer."""

    _fields_ = (
        ("which", u32),
        ("count", u32),
        ("error_idx", u32),
        ("request_fd", s32),
        ("reserved", u32),
        ("controls", u64),
    )


class Timespec(ctypes.Structure):
    """struct timespec of 64-bit Linux."""

    _fields_ = (("sec", s64), ("nsec", s64))


class _EventUnion(ctypes.Union):
    # data[64] in the header; struct v4l2_event_ctrl inside it aligns the union to eight bytes.
    _fields_ = (("data", u8 * 64), ("changes", u32), ("_align", u64))


class V4l2Event(ctypes.Structure):
    """struct v4l2_event: an event that the kernel driver reports (source change, end of stream)."""

    _fields_ = (
        ("type", u32),
        ("u", _EventUnion),
        ("pending", u32),
        ("sequence", u32),
        ("timestamp", Timespec),
        ("id", u32),
        ("reserved", u32 * 8),
    )


class EventSubscription(ctypes.Structure):
    """struct v4l2_event_subscription: which events are wanted."""

    _fields_ = (("type", u32), ("id", u32), ("flags", u32), ("reserved", u32 * 5))


class MbusFrameFormat(ctypes.Structure):
    """struct v4l2_mbus_framefmt: a frame as it runs over the bus between sensor and receiver."""

    _fields_ = (
        ("width", u32),
        ("height", u32),
        ("code", u32),
        ("field", u32),
        ("colorspace", u32),
        ("ycbcr_enc", u16),
        ("quantization", u16),
        ("xfer_func", u16),
        ("flags", u16),
        ("reserved", u16 * 10),
    )


class SubdevFormat(ctypes.Structure):
    """struct v4l2_subdev_format: the format on one pad of a sub-device."""

    _fields_ = (
        ("which", u32),
        ("pad", u32),
        ("format", MbusFrameFormat),
        ("stream", u32),
        ("reserved", u32 * 7),
    )


class Rect(ctypes.Structure):
    """struct v4l2_rect: a region of the pixel array."""

    _fields_ = (("left", s32), ("top", s32), ("width", u32), ("height", u32))


class Selection(ctypes.Structure):
    """struct v4l2_selection: a region, on a capture node."""

    _fields_ = (("type", u32), ("target", u32), ("flags", u32), ("r", Rect), ("reserved", u32 * 9))


class SubdevSelection(ctypes.Structure):
    """struct v4l2_subdev_selection: a region, on a pad of a sub-device."""

    _fields_ = (
        ("which", u32),
        ("pad", u32),
        ("target", u32),
        ("flags", u32),
        ("r", Rect),
        ("stream", u32),
        ("reserved", u32 * 7),
    )


def _ioc(direction: int, number: int, layout: type[ctypes.Structure] | type[ctypes.c_int]) -> int:
    """Encode an ioctl request: direction, size of the argument, type 'V', number (asm-generic/ioctl.h)."""
    return direction << 30 | ctypes.sizeof(layout) << 16 | ord("V") << 8 | number


class Ioctl(enum.IntEnum):
    """The ioctl requests that the driver makes."""

    QUERYCAP = _ioc(_READ, 0, Capability)
    ENUM_FMT = _ioc(_READ | _WRITE, 2, FormatDescription)
    G_FMT = _ioc(_READ | _WRITE, 4, Format)
    S_FMT = _ioc(_READ | _WRITE, 5, Format)
    REQBUFS = _ioc(_READ | _WRITE, 8, RequestBuffers)
    QUERYBUF = _ioc(_READ | _WRITE, 9, Buffer)
    QBUF = _ioc(_READ | _WRITE, 15, Buffer)
    DQBUF = _ioc(_READ | _WRITE, 17, Buffer)
    STREAMON = _ioc(_WRITE, 18, ctypes.c_int)
    STREAMOFF = _ioc(_WRITE, 19, ctypes.c_int)
    QUERYMENU = _ioc(_READ | _WRITE, 37, QueryMenu)
    TRY_FMT = _ioc(_READ | _WRITE, 64, Format)
    G_EXT_CTRLS = _ioc(_READ | _WRITE, 71, ExtControls)
    S_EXT_CTRLS = _ioc(_READ | _WRITE, 72, ExtControls)
    DQEVENT = _ioc(_READ, 89, V4l2Event)
    G_SELECTION = _ioc(_READ | _WRITE, 94, Selection)
    S_SELECTION = _ioc(_READ | _WRITE, 95, Selection)
    SUBSCRIBE_EVENT = _ioc(_WRITE, 90, EventSubscription)
    QUERY_EXT_CTRL = _ioc(_READ | _WRITE, 103, QueryExtCtrl)


# The number 5 again, with another direction and size: sub-devices have a number space of their own.
SUBDEV_S_FMT: Final = _ioc(_READ | _WRITE, 5, SubdevFormat)
SUBDEV_G_SELECTION: Final = _ioc(_READ | _WRITE, 61, SubdevSelection)
SUBDEV_S_SELECTION: Final = _ioc(_READ | _WRITE, 62, SubdevSelection)


class BufferType(enum.IntEnum):
    """enum v4l2_buf_type, the two capture kinds."""

    VIDEO_CAPTURE = 1
    VIDEO_CAPTURE_MPLANE = 9


class Cap(enum.IntFlag):
    """V4L2_CAP_*: what a node can do."""

    VIDEO_CAPTURE = 0x1
    VIDEO_CAPTURE_MPLANE = 0x1000
    STREAMING = 0x04000000
    DEVICE_CAPS = 0x80000000


class BufferFlag(enum.IntFlag):
    """V4L2_BUF_FLAG_*: what the kernel says of a dequeued buffer."""

    ERROR = 0x40
    TIMESTAMP_MONOTONIC = 0x2000
    TIMESTAMP_MASK = 0xE000
    TSTAMP_SRC_SOE = 0x10000
    LAST = 0x100000


class EventType(enum.IntEnum):
    """V4L2_EVENT_*: the events that the driver listens to."""

    EOS = 2
    SOURCE_CHANGE = 5


class ControlType(enum.IntEnum):
    """enum v4l2_ctrl_type: how a control's value is to be read."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    BUTTON = 4
    INTEGER64 = 5
    CTRL_CLASS = 6
    STRING = 7
    BITMASK = 8
    INTEGER_MENU = 9


class ControlFlag(enum.IntFlag):
    """V4L2_CTRL_FLAG_*: why a control cannot be set, what setting it changes, and the flag that requests the next."""

    DISABLED = 0x1
    GRABBED = 0x2
    READ_ONLY = 0x4
    INACTIVE = 0x10
    WRITE_ONLY = 0x40
    MODIFY_LAYOUT = 0x400
    HAS_PAYLOAD = 0x100
    NEXT_COMPOUND = 0x40000000
    NEXT_CTRL = 0x80000000


class Cid(enum.IntEnum):
    """V4L2_CID_*: controls that the driver knows by number."""

    EXPOSURE = 0x00980911
    AUTOGAIN = 0x00980912
    GAIN = 0x00980913
    EXPOSURE_AUTO = 0x009A0901
    EXPOSURE_ABSOLUTE = 0x009A0902
    VBLANK = 0x009E0901
    HBLANK = 0x009E0902
    ANALOGUE_GAIN = 0x009E0903
    PIXEL_RATE = 0x009F0902
    HFLIP = 0x00980914
    VFLIP = 0x00980915


class SelectionTarget(enum.IntEnum):
    """V4L2_SEL_TGT_*: which region is meant."""

    CROP = 0
    CROP_DEFAULT = 1
    CROP_BOUNDS = 2
    COMPOSE = 0x100
    COMPOSE_DEFAULT = 0x101


MEMORY_MMAP: Final = 1
FIELD_NONE: Final = 1
EXPOSURE_MANUAL: Final = 1
FORMAT_ACTIVE: Final = 1
CTRL_WHICH_CUR_VAL: Final = 0
CTRL_WHICH_DEF_VAL: Final = 0x0F000000


def fourcc(name: str) -> int:
    """Encode a four-character code, e.g. `"Y10 "`, as the number the kernel uses."""
    return int.from_bytes(name.ljust(4).encode("ascii"), "little")


def fourcc_name(code: int) -> str:
    """Decode a four-character code; bytes that are no printable ASCII come out as `?`."""
    return "".join(chr(b) if 32 <= b < 127 else "?" for b in (code & 0x7FFFFFFF).to_bytes(4, "little"))
