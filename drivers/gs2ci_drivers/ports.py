"""Where bytes leave us: the three ports that drivers speak through, and nothing of what is said.

    HidPort   64-byte reports (DLPC900)             links.usb_hid
    BytePort  a stream of bytes (serial, USB bulk)  links.serial_line, links.usb_bulk
    SysPort   system calls on a device node (V4L2)  links.v4l2_sys

Rules every implementation keeps, the twins' included:

- nothing blocks longer than its timeout;
- silence is not an error: `read` returns b"" and `poll` returns 0 when nothing came in time;
- a dead port raises OSError with an errno (ENODEV, EIO, ...), a write not taken in time raises TimeoutError;
  drivers turn these into the errors of `gs2ci_drivers.failures`;
- `close` may be called twice and never raises.

Here: the interfaces and the port guard that translates errors. Not here: recording and replaying what passed
(`gs2ci_drivers.trace`), the real ports (`gs2ci_drivers.links`).
"""

import errno
import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

from gs2ci_drivers.failures import AccessError, DisconnectedError, NoAnswerError

MappedMemory = mmap.mmap
"""A kernel buffer in our address space; a twin hands out anonymous memory of the same type."""

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
        """Receive one report (shorter when the device cut it short), or b"" when none came in time.

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
        """Receive 1 to `max_bytes` bytes as soon as there are any, or b"" when none came in time.

        With `timeout_s` 0 it returns what is there already: the way to drain a line.

        Raises:
            OSError: The port is gone.
        """
        ...

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        ...


@runtime_checkable
class SysPort(Protocol):
    """The system calls that a device node needs, as the kernel has them."""

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
            payload: The memory that a pointer inside `argument` shows to (`v4l2_ext_controls.controls`,
                `v4l2_buffer.m.planes`), also read and written in place. The caller has set the pointer to it
                already; it is named here so that a twin, a trace and a replay need not follow raw addresses.

        Raises:
            OSError: With the kernel's errno.
        """
        ...

    def mmap(self, fd: int, length: int, offset: int) -> MappedMemory:
        """Map `length` bytes of a buffer, shared, readable and writable; unmapped by its own `close()`."""
        ...

    def copy_out(self, mapping: MappedMemory, length: int) -> bytes:
        """Copy the first `length` bytes of a mapped buffer: the one way by which pixels leave it."""
        ...

    def poll(self, fd: int, events: int, timeout_s: float) -> int:
        """Wait for any of `events` (select.POLLIN, ...); return those that came, 0 when none did in time."""
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


@contextmanager
def port_errors(device: str, asked: str, *, timeout_s: float = 0.0, trigger_index: int | None = None) -> Iterator[None]:
    """Turn what a port raises into the typed errors of drivers.

    Args:
        device: Name of the device.
        asked: What is being done.
        timeout_s: The timeout that was given to the port, for the message.
        trigger_index: Which trigger is being served, if any.

    Raises:
        NoAnswerError: A write was not taken in time (TimeoutError).
        AccessError: Permission denied, busy, or no such node (EACCES, EPERM, EBUSY, ENOENT).
        DisconnectedError: Any other OSError.
    """
    try:
        yield
    except TimeoutError as error:
        raise NoAnswerError(device, f"{asked} (write)", timeout_s, trigger_index=trigger_index) from error
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EPERM, errno.EBUSY, errno.ENOENT):
            raise AccessError(
                device,
                f"the port cannot be used ({error})",
                asked=asked,
                remedy="run `gs2ci doctor`: it prints the udev rules to install and who holds the port",
                trigger_index=trigger_index,
            ) from error
        raise DisconnectedError(device, asked, error, trigger_index=trigger_index) from error
