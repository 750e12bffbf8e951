"""The frame buffers of the V4L2 twin: memory, queue and states, as the kernel's videobuf2 keeps them.

Here: `BufferRing`, which answers the requests about buffers on plain bytes. Not here: formats, controls, timing
(`v4l2`).
"""

import mmap
import struct
from collections import deque
from dataclasses import dataclass, field
from errno import EAGAIN, EBUSY, EINVAL, EIO, EPIPE

from gs2ci.core.arrays import U8

MMAP_MEMORY = 1
FLAG_MAPPED, FLAG_QUEUED, FLAG_DONE, FLAG_ERROR = 0x1, 0x2, 0x4, 0x40
FLAG_MONOTONIC, FLAG_START_STAMP, FLAG_LAST = 0x2000, 0x10000, 0x100000
PAGE = mmap.PAGESIZE


@dataclass
class Filled:
    """The kernel's description of a filled buffer."""

    bytes_used: int
    flags: int
    time_ns: int
    number: int


@dataclass
class _Slot:
    memory: mmap.mmap
    queued: bool = False
    filled: Filled | None = None
    mapped: bool = False


@dataclass
class BufferRing:
    """The buffers of one capture queue.

    Args:
        kind: Buffer type: 1 single-plane.
    """

    kind: int = 1
    streaming: bool = False
    broken: bool = False
    ended: bool = False
    _slots: list[_Slot] = field(default_factory=list)
    _waiting: deque[int] = field(default_factory=deque)
    _done: deque[int] = field(default_factory=deque)

    @property
    def count(self) -> int:
        """Get the number of buffers."""
        return len(self._slots)

    @property
    def ready(self) -> bool:
        """Get whether a filled buffer can be taken."""
        return bool(self._done)

    @property
    def queued(self) -> int:
        """Get how many buffers wait to be filled."""
        return len(self._waiting)

    def request(self, argument: bytearray, size_bytes: int, most: int) -> None:
        """Answer VIDIOC_REQBUFS.

        Raises:
            OSError: EINVAL: type or memory; EBUSY: streaming, or buffers are still mapped.
        """
        count, kind, memory = struct.unpack_from("<III", argument, 0)
        if kind != self.kind or memory != MMAP_MEMORY:
            raise OSError(EINVAL, "REQBUFS")
        if self.streaming or any(slot.mapped and not slot.memory.closed for slot in self._slots):
            raise OSError(EBUSY, "REQBUFS")
        self.free()
        length = -(-max(1, size_bytes) // PAGE) * PAGE
        self._slots = [_Slot(mmap.mmap(-1, length)) for _ in range(min(count, most))]
        struct.pack_into("<I", argument, 0, len(self._slots))

    def free(self) -> None:
        """Free all buffers; memory that is still mapped exists as long as its mapping."""
        self._slots, self.streaming, self.broken, self.ended = [], False, False, False
        self._waiting.clear()
        self._done.clear()

    def describe(self, argument: bytearray, payload: bytearray | None) -> None:
        """Answer VIDIOC_QUERYBUF.

        Raises:
            OSError: EINVAL: type or index.
        """
        slot, index = self._slot(argument)
        self._write(argument, payload, index, slot)

    def map(self, offset: int, length: int) -> mmap.mmap:
        """Answer mmap.

        Raises:
            OSError: EINVAL: there is no buffer at this offset.
        """
        index = offset // PAGE
        if offset % PAGE or index >= len(self._slots) or length > len(self._slots[index].memory):
            raise OSError(EINVAL, "mmap")
        self._slots[index].mapped = True
        return self._slots[index].memory

    def queue(self, argument: bytearray, payload: bytearray | None) -> None:
        """Answer VIDIOC_QBUF.

        Raises:
            OSError: EINVAL: type, memory, index, or queued already.
        """
        slot, index = self._slot(argument)
        (memory,) = struct.unpack_from("<I", argument, 60)
        if memory != MMAP_MEMORY or slot.queued or slot.filled is not None:
            raise OSError(EINVAL, "QBUF")
        slot.queued = True
        self._waiting.append(index)
        self._write(argument, payload, index, slot)

    def dequeue(self, argument: bytearray, payload: bytearray | None) -> None:
        """Answer VIDIOC_DQBUF.

        Raises:
            OSError: EINVAL: type, or not streaming; EIO: broken; EPIPE: after the last buffer; EAGAIN: none ready.
        """
        (kind,) = struct.unpack_from("<I", argument, 4)
        if kind != self.kind or not self.streaming:
            raise OSError(EINVAL, "DQBUF")
        if self.broken:
            raise OSError(EIO, "DQBUF")
        if not self._done:
            raise OSError(EPIPE if self.ended else EAGAIN, "DQBUF")
        index = self._done.popleft()
        slot = self._slots[index]
        self._write(argument, payload, index, slot)
        slot.filled = None

    def start(self) -> None:
        """Answer VIDIOC_STREAMON.

        Raises:
            OSError: EINVAL: no buffers.
        """
        if not self._slots:
            raise OSError(EINVAL, "STREAMON")
        self.streaming = True

    def stop(self) -> None:
        """Answer VIDIOC_STREAMOFF: every queued and filled buffer is dropped."""
        self.streaming = self.broken = self.ended = False
        self._waiting.clear()
        self._done.clear()
        for slot in self._slots:
            slot.queued, slot.filled = False, None

    def fill(self, data: U8, filled: Filled) -> bool:
        """Put a frame into the oldest waiting buffer; return False if none waits."""
        if not self._waiting:
            return False
        index = self._waiting.popleft()
        slot = self._slots[index]
        if not slot.memory.closed:
            slot.memory[: data.size] = data.tobytes()
        slot.queued, slot.filled = False, filled
        self._done.append(index)
        return True

    def _slot(self, argument: bytearray) -> tuple[_Slot, int]:
        index, kind = struct.unpack_from("<II", argument, 0)
        if kind != self.kind or index >= len(self._slots):
            raise OSError(EINVAL, "buffer")
        return self._slots[index], index

    def _write(self, argument: bytearray, payload: bytearray | None, index: int, slot: _Slot) -> None:
        """Write struct v4l2_buffer."""
        filled = slot.filled or Filled(0, 0, 0, 0)
        flags = filled.flags | (FLAG_MAPPED if slot.mapped else 0) | (FLAG_QUEUED if slot.queued else 0)
        seconds, rest_ns = divmod(filled.time_ns, 1_000_000_000)
        length, offset = len(slot.memory) if not slot.memory.closed else 0, index * PAGE
        struct.pack_into("<III", argument, 0, index, self.kind, filled.bytes_used)
        struct.pack_into("<II", argument, 12, flags, 1)
        struct.pack_into("<qq", argument, 24, seconds, rest_ns // 1000)
        struct.pack_into("<II", argument, 56, filled.number, MMAP_MEMORY)
        struct.pack_into("<Q", argument, 64, offset)
        struct.pack_into("<I", argument, 72, length)
