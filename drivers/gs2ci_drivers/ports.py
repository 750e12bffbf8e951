"""The six ports through which drivers reach hardware: interfaces only, no protocol.

    HidPort     64-byte reports (DLPC900)                     links.usb_hid
    BytePort    a stream of bytes (serial, USB bulk)          links.serial_line, links.usb_bulk
    SysPort     system calls on a device node (V4L2)          links.v4l2_sys
    CameraPort  named features and filled buffers (GenICam)   links.gentl
    ScreenPort  whole pictures on a video output              links.sdl_screen
    LibraryPort functions of a maker's library in C (ALP)     links.alp_library

Rules every implementation keeps, the twins' included:

- nothing blocks longer than its timeout;
- silence is not an error: `read` returns b"" and `poll` returns 0 when nothing came in time;
- a dead port raises OSError with an errno (ENODEV, EIO, ...), a write not taken in time raises TimeoutError;
  drivers turn these into the errors of `gs2ci_drivers.failures`;
- `close` may be called twice and never raises.

Here: the interfaces and the guard that translates a port's errors. Not here: recording and replaying the traffic
(`gs2ci_drivers.trace`), the real ports (`gs2ci_drivers.links`).
"""

import errno
import mmap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeVar, runtime_checkable

from gs2ci.core.arrays import U8
from gs2ci_drivers.failures import AccessError, BadReplyError, DisconnectedError, NoAnswerError, RefusedError

T = TypeVar("T")

MappedMemory = mmap.mmap
"""A kernel buffer mapped into this process; a twin returns anonymous memory of the same type."""

HID_REPORT_BYTES = 64
"""Length of every HID report, both ways. There is no leading report id; a link that needs one adds it."""


@runtime_checkable
class HidPort(Protocol):
    """A USB HID interface with 64-byte interrupt reports and no report ids."""

    def write(self, report: bytes, timeout_s: float) -> None:
        """Send one report of exactly `HID_REPORT_BYTES` bytes.

        Raises:
            TimeoutError: Not taken within `timeout_s`.
            OSError: The device is gone or the transfer failed.
        """
        ...

    def read(self, timeout_s: float) -> bytes:
        """Receive one report (shorter if the device sent fewer bytes), or b"" if none came in time.

        Raises:
            OSError: The device is gone or the transfer failed.
        """
        ...

    def close(self) -> None:
        """Release the interface; a second call does nothing."""
        ...


@runtime_checkable
class BytePort(Protocol):
    """A stream of bytes in both directions: a serial line, or a pair of USB bulk pipes."""

    def write(self, data: bytes, timeout_s: float) -> None:
        """Send all of `data`.

        Raises:
            TimeoutError: Not all taken within `timeout_s`.
            OSError: The port is gone.
        """
        ...

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Receive 1 to `max_bytes` bytes as soon as there are any, or b"" if none came in time.

        With `timeout_s` 0 it returns the bytes that are already there: the way to drain a line.

        Raises:
            OSError: The port is gone.
        """
        ...

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        ...


@runtime_checkable
class SysPort(Protocol):
    """The system calls that a device node needs, as the kernel provides them."""

    def open(self, path: str) -> int:
        """Open a device node for reading and writing, non-blocking; return its descriptor."""
        ...

    def close(self, fd: int) -> None:
        """Close a descriptor; unknown and closed ones are ignored."""
        ...

    def ioctl(self, fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        """Call ioctl with a structure that is read and written in place; return its result.

        Args:
            fd: Descriptor.
            request: The ioctl's number.
            argument: The structure's bytes.
            payload: The memory that a pointer inside `argument` refers to (`v4l2_ext_controls.controls`,
                `v4l2_buffer.m.planes`), also read and written in place. The caller has already set the pointer to it;
                it is passed here so that a twin, a trace and a replay need not follow raw addresses.

        Raises:
            OSError: With the kernel's errno.
        """
        ...

    def mmap(self, fd: int, length: int, offset: int) -> MappedMemory:
        """Map `length` bytes of a buffer, shared, readable and writable; unmapped by its own `close()`."""
        ...

    def copy_out(self, mapping: MappedMemory, length: int) -> bytes:
        """Copy the first `length` bytes of a mapped buffer: pixels are read only by this call."""
        ...

    def poll(self, fd: int, events: int, timeout_s: float) -> int:
        """Wait for any of `events` (select.POLLIN, ...); return those that occurred, 0 if none did in time."""
        ...

    def clock_ns(self) -> int:
        """Get CLOCK_MONOTONIC, by which the kernel stamps frames, in nanoseconds."""
        ...

    def list_nodes(self, pattern: str) -> list[str]:
        """List the paths that match a shell pattern (`/dev/video*`), sorted."""
        ...

    def read_file(self, path: str) -> bytes:
        """Read a small file of /sys or /proc."""
        ...

    def write_file(self, path: str, data: bytes) -> None:
        """Write a small file of /sys, such as a module's parameter."""
        ...


FeatureValue = int | float | bool | str
"""What a feature of a GenICam camera may hold."""


class FeatureRefusalError(Exception):
    """A camera refused to read, write or run a feature: missing, locked, or out of its range."""


@dataclass(frozen=True)
class CameraIdentity:
    """A camera as a GenTL producer lists it.

    Args:
        vendor: Maker.
        model: Model.
        serial: Serial number.
        transport: Transport layer: "GEV", "U3V", "CXP", ...
    """

    vendor: str
    model: str
    serial: str
    transport: str


@dataclass(frozen=True)
class Feature:
    """The present state of a camera's feature.

    Args:
        kind: Type of its value; a command has no value and is run.
        readable: Whether it can be read now.
        writable: Whether it can be written, or run, now.
        low: Smallest value of a number.
        high: Largest value of a number.
        step: Integers are `low` plus multiples of this.
        symbols: The entries of an enumeration that are available now.
        unit: Unit of a number, as the camera names it.
        selectors: The features that choose which of several values this one has.
    """

    kind: Literal["integer", "float", "boolean", "enumeration", "string", "command", "other"]
    readable: bool = True
    writable: bool = True
    low: float = 0.0
    high: float = 0.0
    step: float = 1.0
    symbols: tuple[str, ...] = ()
    unit: str = ""
    selectors: tuple[str, ...] = ()


@dataclass(frozen=True)
class CameraBuffer:
    """A copy of a buffer that a camera has filled.

    Args:
        data: The image's bytes, without chunks.
        complete: Whether all of it arrived.
        frame_id: The transport's number of the frame; -1 if it is not reported.
        timestamp: The camera's time in its own ticks, None if it is not reported.
        height: Rows that were delivered.
        width: Columns.
        padding_bytes: Bytes behind each row.
        chunks: The data that the camera appended: "ChunkTimestamp", "ChunkFrameID", "ChunkExposureTime", ...
    """

    data: bytes
    complete: bool
    frame_id: int
    timestamp: int | None
    height: int = 0
    width: int = 0
    padding_bytes: int = 0
    chunks: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class CameraPort(Protocol):
    """A camera behind a GenTL producer: features by name (GenApi) and a stream of buffers (GenTL).

    It raises OSError: ENODEV if the camera is gone, EBUSY if another program uses it, ENOENT if there is none.
    """

    def list_cameras(self, producer: str) -> list[CameraIdentity]:
        """List the cameras of a producer.

        Args:
            producer: Its .cti file; "" takes those in the folders of GENICAM_GENTL64_PATH.
        """
        ...

    def open(self, producer: str, serial: str) -> CameraIdentity:
        """Open the camera with this serial number, or the only one for "", without changing anything on it."""
        ...

    def list_features(self) -> list[tuple[str, str]]:
        """List category and name of every feature that the camera shows to its users."""
        ...

    def describe(self, name: str) -> Feature | None:
        """Return the present state of a feature, or None if the camera has none of that name."""
        ...

    def read(self, name: str) -> FeatureValue:
        """Read a feature.

        Raises:
            FeatureRefusalError: Missing or not readable now.
        """
        ...

    def write(self, name: str, value: FeatureValue) -> None:
        """Write a feature.

        Raises:
            FeatureRefusalError: Missing, locked, or beyond its limits.
        """
        ...

    def execute(self, name: str) -> None:
        """Run a command and wait until it is done.

        Raises:
            FeatureRefusalError: Missing or locked.
        """
        ...

    def start(self, buffers: int, chunks: tuple[str, ...]) -> int:
        """Announce and queue buffers and begin the acquisition; return how many there are.

        Args:
            buffers: How many buffers to announce; the producer may need more.
            chunks: Which chunks to read from each buffer, if it has them.

        Raises:
            FeatureRefusalError: The camera refuses; `stop` takes back what has been set up.
        """
        ...

    def fetch(self, timeout_s: float) -> CameraBuffer | None:
        """Wait for a filled buffer, copy it and queue it again; return None if none came in time.

        Raises:
            FeatureRefusalError: The producer refuses.
        """
        ...

    def stop(self) -> None:
        """End the acquisition and take the buffers back; also allowed if none is running.

        Raises:
            FeatureRefusalError: The camera refuses.
        """
        ...

    def clock_ns(self) -> int:
        """Get the computer's CLOCK_MONOTONIC in nanoseconds."""
        ...

    def close(self) -> None:
        """Release the camera; a second call does nothing."""
        ...


@dataclass(frozen=True)
class ScreenOutput:
    """A video output.

    Args:
        name: As the computer names it.
        height: Rows.
        width: Columns.
        refresh_hz: Pictures a second.
    """

    name: str
    height: int
    width: int
    refresh_hz: float


@runtime_checkable
class ScreenPort(Protocol):
    """A video output that is covered by one window.

    If the output is gone, or was never there, calls raise OSError with ENODEV.
    """

    def list_outputs(self) -> list[ScreenOutput]:
        """List the video outputs."""
        ...

    def open(self, name: str) -> ScreenOutput:
        """Cover an output, "" for the last one, with a dark window without frame or pointer."""
        ...

    def straighten(self) -> list[str]:
        """Undo what changes levels between a picture and the panel; return what did, and what may do so still."""
        ...

    def flip(self, levels: U8) -> int:
        """Draw a picture, [H, W] grey, on the output, wait until it is shown, and return the time of that.

        The time is CLOCK_MONOTONIC in nanoseconds.
        """
        ...

    def clock_ns(self) -> int:
        """Get CLOCK_MONOTONIC in nanoseconds."""
        ...

    def close(self) -> None:
        """Uncover the output; a second call does nothing."""
        ...


@runtime_checkable
class LibraryPort(Protocol):
    """The functions of a maker's library in C, called by their names.

    Each returns a code of the library's own, which the driver interprets. OSError: the library cannot be loaded.
    """

    def call(self, function: str, numbers: Sequence[int], data: bytes = b"") -> int:
        """Call a function of whole numbers of 32 bits, and of a block of data behind them if there is one.

        Returns:
            The function's code.
        """
        ...

    def ask(self, function: str, numbers: Sequence[int]) -> tuple[int, int]:
        """Call a function of whole numbers and of a pointer behind them, to which it writes a signed number.

        Returns:
            The function's code, and the number.
        """
        ...

    def close(self) -> None:
        """Make no further call; a second call does nothing."""
        ...


@contextmanager
def port_errors(device: str, asked: str, *, timeout_s: float = 0.0) -> Iterator[None]:
    """Turn the errors that a port raises into the typed errors of drivers.

    Args:
        device: Name of the device.
        asked: What is being done.
        timeout_s: The timeout that was given to the port, for the message.

    Raises:
        NoAnswerError: A write was not taken in time (TimeoutError).
        AccessError: Permission denied, busy, or no such node (EACCES, EPERM, EBUSY, ENOENT).
        DisconnectedError: Any other OSError.
        RefusedError: A camera refused a feature or a command (FeatureRefusalError).
    """
    try:
        yield
    except FeatureRefusalError as error:
        raise RefusedError(
            device, asked, "GenApi", str(error), remedy="another program may hold or have locked the camera"
        ) from error
    except TimeoutError as error:
        raise NoAnswerError(device, f"{asked} (write)", timeout_s) from error
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EPERM, errno.EBUSY, errno.ENOENT):
            raise AccessError(
                device,
                f"the port cannot be used ({error})",
                asked=asked,
                remedy="run `gs2ci doctor`: it prints the udev rules to install and who holds the port",
            ) from error
        raise DisconnectedError(device, asked, error) from error


def with_one_retry(request: Callable[[], T], incidents: list[str]) -> T:
    """Send a request; if its answer is lost or damaged, note that and send it once more.

    Only for requests that change nothing, or that may be repeated: a motion is never sent twice.

    Args:
        request: Sends the request and returns its answer.
        incidents: Receives the problem if there was one.

    Raises:
        NoAnswerError, BadReplyError: No usable answer, twice.
    """
    try:
        return request()
    except (NoAnswerError, BadReplyError) as error:
        incidents.append(f"{error}; asked again")
    return request()
