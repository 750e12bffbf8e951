"""`SysPort` over the running Linux kernel: open, ioctl, mmap, poll and small files, with no knowledge of V4L2.

Here: system calls. Not here: the requests made with them (`gs2ci_drivers.v4l2`). `gs2ci.rig` and the tests on a real
kernel create one.
"""

import fcntl
import glob
import mmap
import os
import select
import time
from pathlib import Path

from gs2ci_drivers.ports import MappedMemory


class KernelSysPort:
    """The system calls of this computer."""

    def open(self, path: str) -> int:
        """Open a device node for reading and writing, non-blocking; return its descriptor.

        Raises:
            OSError: With the kernel's errno.
        """
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self, fd: int) -> None:
        """Close a descriptor; unknown and closed ones are ignored."""
        try:
            os.close(fd)
        except OSError:
            return

    def ioctl(self, fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        """Call ioctl with a structure that is read and written in place; return its result.

        The kernel follows the pointer inside `argument`; `payload` is a parameter only to keep that memory alive.

        Raises:
            OSError: With the kernel's errno.
        """
        del payload
        while True:
            try:
                return int(fcntl.ioctl(fd, request, argument, True))
            except InterruptedError:  # a signal; Python retries poll and read by itself, but not ioctl
                continue

    def mmap(self, fd: int, length: int, offset: int) -> MappedMemory:
        """Map `length` bytes of a buffer, shared, readable and writable; unmapped by its own `close()`.

        Raises:
            OSError: With the kernel's errno.
        """
        return mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset)

    def copy_out(self, mapping: MappedMemory, length: int) -> bytes:
        """Copy the first `length` bytes of a mapped buffer."""
        return mapping[:length]

    def poll(self, fd: int, events: int, timeout_s: float) -> int:
        """Wait for any of `events`; return those that occurred, with POLLERR, POLLHUP, POLLNVAL; 0 if none did in time.

        Raises:
            OSError: With the kernel's errno.
        """
        waiter = select.poll()
        waiter.register(fd, events)
        return next((came for _, came in waiter.poll(max(0.0, timeout_s) * 1e3)), 0)

    def clock_ns(self) -> int:
        """Get CLOCK_MONOTONIC, by which the kernel stamps frames, in nanoseconds."""
        return time.monotonic_ns()

    def list_nodes(self, pattern: str) -> list[str]:
        """List the paths that match a shell pattern (`/dev/video*`), sorted."""
        return sorted(glob.glob(pattern))

    def read_file(self, path: str) -> bytes:
        """Read a small file of /sys or /proc.

        Raises:
            OSError: With the kernel's errno.
        """
        return Path(path).read_bytes()

    def write_file(self, path: str, data: bytes) -> None:
        """Write a small file of /sys, such as a module's parameter.

        Raises:
            OSError: With the kernel's errno.
        """
        Path(path).write_bytes(data)
