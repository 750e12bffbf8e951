"""The V4L2 ABI of 64-bit Linux: structures, ioctl numbers, control ids and flags, exactly those the driver uses.

Here: layouts and numbers (linux/videodev2.h, linux/v4l2-controls.h, linux/v4l2-subdev.h), no behaviour. Not here: pixel
layouts (`formats`), calls (`node`). The simulated kernel builds the same bytes with code of its own, so that an error
here does not cancel against the same error there.

Packed structures name their layout, which Python requires from 3.19 on and warns of from 3.14 on: "ms" is the only one
that ctypes packs. Without bit fields it is that of the kernel's compilers; earlier versions ignore the name.
"""

import ctypes
import enum
from typing import Any, Final

_READ: Final = 2
_WRITE: Final = 1

_TYPES: Final[dict[str, Any]] = {f"u{bits}": getattr(ctypes, f"c_uint{bits}") for bits in (8, 16, 32, 64)} | {
    "char": ctypes.c_char,
    "s32": ctypes.c_int32,
    "s64": ctypes.c_int64,
}


def fields(declared: str, *parts: type[ctypes.Structure | ctypes.Union]) -> tuple[tuple[str, Any], ...]:
    """Return the fields of a structure that is declared as in the header: a type, its names, [n] behind an array.

    Args:
        declared: "u32 count type; char name[32]".
        parts: The structures and unions that it names as types.
    """
    types = _TYPES | {part.__name__: part for part in parts}
    found = []
    for declaration in declared.split(";"):
        kind, *names = declaration.split()
        for name, _, size in (name.rstrip("]").partition("[") for name in names):
            found.append((name, types[kind] * int(size) if size else types[kind]))
    return tuple(found)


class Capability(ctypes.Structure):
    """struct v4l2_capability: who drives the node and what it can do."""

    _fields_ = fields("char driver[16] card[32] bus_info[32]; u32 version capabilities device_caps reserved[3]")


class FormatDescription(ctypes.Structure):
    """struct v4l2_fmtdesc: one pixel format on offer."""

    _fields_ = fields("u32 index type flags; char description[32]; u32 pixelformat mbus_code reserved[3]")


class PixFormat(ctypes.Structure):
    """struct v4l2_pix_format: geometry of a frame that lies in one plane."""

    _fields_ = fields(
        "u32 width height pixelformat field bytesperline sizeimage colorspace priv flags ycbcr_enc quantization "
        "xfer_func",
    )


class PlanePixFormat(ctypes.Structure):
    """struct v4l2_plane_pix_format: size and stride of one plane."""

    _layout_, _pack_ = "ms", 1
    _fields_ = fields("u32 sizeimage bytesperline; u16 reserved[6]")


class PixFormatMplane(ctypes.Structure):
    """struct v4l2_pix_format_mplane: geometry of a frame spread over up to eight planes."""

    _layout_, _pack_ = "ms", 1
    _fields_ = fields(
        "u32 width height pixelformat field colorspace; PlanePixFormat plane_fmt[8]; "
        "u8 num_planes flags ycbcr_enc quantization xfer_func reserved[7]",
        PlanePixFormat,
    )


class _FormatUnion(ctypes.Union):
    # The kernel's union also holds struct v4l2_window, whose pointers align it to eight bytes.
    _fields_ = fields("PixFormat pix; PixFormatMplane pix_mp; u8 raw_data[200]; u64 _align", PixFormat, PixFormatMplane)


class Format(ctypes.Structure):
    """struct v4l2_format: a buffer type and its format (at byte 8)."""

    _fields_ = fields("u32 type; _FormatUnion fmt", _FormatUnion)


class RequestBuffers(ctypes.Structure):
    """struct v4l2_requestbuffers: how many buffers are requested, and how many were allocated."""

    _fields_ = fields("u32 count type memory capabilities; u8 flags reserved[3]")


class Timeval(ctypes.Structure):
    """struct timeval of 64-bit Linux."""

    _fields_ = fields("s64 sec usec")


class Timecode(ctypes.Structure):
    """struct v4l2_timecode; unused, it only takes its place in the buffer."""

    _fields_ = fields("u32 type flags; u8 frames seconds minutes hours userbits[4]")


class _PlaneMemory(ctypes.Union):
    _fields_ = fields("u32 mem_offset; u64 userptr; s32 fd")


class Plane(ctypes.Structure):
    """struct v4l2_plane: one plane of a multi-plane buffer."""

    _fields_ = fields("u32 bytesused length; _PlaneMemory m; u32 data_offset reserved[11]", _PlaneMemory)


class _BufferMemory(ctypes.Union):
    _fields_ = fields("u32 offset; u64 userptr planes; s32 fd")


class Buffer(ctypes.Structure):
    """struct v4l2_buffer: one frame buffer on its way through the queue."""

    _fields_ = fields(
        "u32 index type bytesused flags field; Timeval timestamp; Timecode timecode; u32 sequence memory; "
        "_BufferMemory m; u32 length reserved2; s32 request_fd",
        Timecode,
        Timeval,
        _BufferMemory,
    )


class QueryExtCtrl(ctypes.Structure):
    """struct v4l2_query_ext_ctrl: name, range and kind of a control."""

    _fields_ = fields(
        "u32 id type; char name[32]; s64 minimum maximum; u64 step; s64 default_value; "
        "u32 flags elem_size elems nr_of_dims dims[4] reserved[32]",
    )


class _MenuItem(ctypes.Union):
    _layout_, _pack_ = "ms", 1
    _fields_ = fields("char name[32]; s64 value")


class QueryMenu(ctypes.Structure):
    """struct v4l2_querymenu: one entry of a menu control."""

    _layout_, _pack_ = "ms", 1
    _fields_ = fields("u32 id index; _MenuItem u; u32 reserved", _MenuItem)


class _ExtControlValue(ctypes.Union):
    _layout_, _pack_ = "ms", 1
    _fields_ = fields("s32 value; s64 value64; u64 ptr")


class ExtControl(ctypes.Structure):
    """struct v4l2_ext_control: one control value (packed)."""

    _layout_, _pack_ = "ms", 1
    _fields_ = fields("u32 id size reserved2; _ExtControlValue u", _ExtControlValue)


class ExtControls(ctypes.Structure):
    """struct v4l2_ext_controls: a batch of control values behind a pointer."""

    _fields_ = fields("u32 which count error_idx; s32 request_fd; u32 reserved; u64 controls")


class Timespec(ctypes.Structure):
    """struct timespec of 64-bit Linux."""

    _fields_ = fields("s64 sec nsec")


class _EventUnion(ctypes.Union):
    # data[64] in the header; struct v4l2_event_ctrl inside it aligns the union to eight bytes.
    _fields_ = fields("u8 data[64]; u32 changes; u64 _align")


class V4l2Event(ctypes.Structure):
    """struct v4l2_event: an event that the kernel driver reports (source change, end of stream)."""

    _fields_ = fields(
        "u32 type; _EventUnion u; u32 pending sequence; Timespec timestamp; u32 id reserved[8]",
        Timespec,
        _EventUnion,
    )


class EventSubscription(ctypes.Structure):
    """struct v4l2_event_subscription: which events are wanted."""

    _fields_ = fields("u32 type id flags reserved[5]")


class MbusFrameFormat(ctypes.Structure):
    """struct v4l2_mbus_framefmt: a frame as it runs over the bus between sensor and receiver."""

    _fields_ = fields("u32 width height code field colorspace; u16 ycbcr_enc quantization xfer_func flags reserved[10]")


class SubdevFormat(ctypes.Structure):
    """struct v4l2_subdev_format: the format on one pad of a sub-device."""

    _fields_ = fields("u32 which pad; MbusFrameFormat format; u32 stream reserved[7]", MbusFrameFormat)


class Rect(ctypes.Structure):
    """struct v4l2_rect: a region of the pixel array."""

    _fields_ = fields("s32 left top; u32 width height")


class Selection(ctypes.Structure):
    """struct v4l2_selection: a region, on a capture node."""

    _fields_ = fields("u32 type target flags; Rect r; u32 reserved[9]", Rect)


class SubdevSelection(ctypes.Structure):
    """struct v4l2_subdev_selection: a region, on a pad of a sub-device."""

    _fields_ = fields("u32 which pad target flags; Rect r; u32 stream reserved[7]", Rect)


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


def fourcc(name: str) -> int:
    """Encode a four-character code, e.g. `"Y10 "`, as the number the kernel uses."""
    return int.from_bytes(name.ljust(4).encode("ascii"), "little")


def fourcc_name(code: int) -> str:
    """Decode a four-character code; bytes that are no printable ASCII come out as `?`."""
    return "".join(chr(b) if 32 <= b < 127 else "?" for b in (code & 0x7FFFFFFF).to_bytes(4, "little"))
