"""The kernel's frame buffers: requested, mapped, queued, read, and released in the inverse order.

Here: `BufferQueue`. Not here: what a frame means (`driver`). Imported by `driver` only.
"""

import select
from collections.abc import Callable
from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import DeviceFaultError, DisconnectedError, DriverError
from gs2ci_drivers.ports import MappedMemory
from gs2ci_drivers.v4l2 import abi
from gs2ci_drivers.v4l2.node import Dequeued, VideoNode, errno_errors

MAX_IDLE_WAKES: Final = 64
"""How often poll may report a frame that is not there before the driver counts as broken; it keeps `take` finite."""

_BAD: Final = select.POLLERR | select.POLLHUP | select.POLLNVAL
_EVENTS: Final = {
    abi.EventType.SOURCE_CHANGE: "SOURCE_CHANGE: the picture's size or format changed during the stream",
    abi.EventType.EOS: "EOS: the device ended the stream",
}


class BufferQueue:
    """Frame buffers of one node, from REQBUFS to REQBUFS 0.

    Args:
        node: An open capture node whose format is set.
        clock: The clock of all waits.
        count: How many buffers to request.

    Raises:
        DriverError: As `gs2ci_drivers.v4l2.node.raise_typed`; buffers requested before are released.
    """

    def __init__(self, node: VideoNode, clock: Clock, count: int) -> None:
        self._node = node
        self._clock = clock
        self._maps: list[MappedMemory] = []
        self._streaming = False
        try:
            given = node.request_buffers(count)
            if given < 1:
                raise DeviceFaultError(node.device, f"VIDIOC_REQBUFS {count}", ["no buffer was given"])
            for index in range(given):
                place = node.query_buffer(index)
                with errno_errors(node.device, f"mmap buffer {index}"):
                    self._maps.append(node.port.mmap(node.fd, place.length, place.offset))
        except DriverError:
            self._give_back()
            raise

    @property
    def count(self) -> int:
        """Get how many buffers the kernel allocated."""
        return len(self._maps)

    def start(self) -> None:
        """Queue every buffer, subscribe to events, start streaming."""
        for index in range(self.count):
            self._node.queue_buffer(index)
        for event in _EVENTS:
            self._node.subscribe(event)
        self._node.stream_on()
        self._streaming = True

    def pause(self) -> None:
        """Stop streaming: all frames are dropped, the next start counts from 0."""
        self._node.stream_off()
        self._streaming = False

    def take(self, timeout_s: float) -> tuple[Dequeued, bytes] | None:
        """Wait for a filled buffer; copy it out and queue it again. Return None when none came in time.

        Raises:
            DisconnectedError: The device is gone.
            DeviceFaultError: The stream broke down, ended, or the source changed.
        """
        deadline_s = self._clock.now_s() + timeout_s
        for _ in range(MAX_IDLE_WAKES):
            came = self._node.wait(max(0.0, deadline_s - self._clock.now_s()))
            if came & select.POLLPRI and not came & _BAD:
                self._check_event()
            # If poll reports an error, DQBUF raises the reason.
            buffer = self._node.dequeue_buffer() if came & (select.POLLIN | _BAD) else None
            if buffer is not None:
                return buffer, self._copy_and_requeue(buffer)
            if came & _BAD:
                raise self._unexplained(came)
            if not came and self._clock.now_s() >= deadline_s:
                return None
        raise DeviceFaultError(
            self._node.device, "poll", [f"{MAX_IDLE_WAKES} wake-ups without a frame: the camera driver is broken"]
        )

    def _unexplained(self, came: int) -> DriverError:
        if came & select.POLLHUP:
            return DisconnectedError(self._node.device, "poll", "POLLHUP")
        return DeviceFaultError(self._node.device, "poll", ["POLLERR: the stream failed"])

    def _check_event(self) -> None:
        kind = self._node.dequeue_event()
        if kind in _EVENTS:
            raise DeviceFaultError(self._node.device, "VIDIOC_DQEVENT", [_EVENTS[abi.EventType(kind)]])

    def _copy_and_requeue(self, buffer: Dequeued) -> bytes:
        if buffer.index >= self.count:
            raise DeviceFaultError(
                self._node.device, "VIDIOC_DQBUF", [f"buffer {buffer.index} of {self.count} came back"]
            )
        mapping = self._maps[buffer.index]
        length = min(buffer.bytes_used, len(mapping))
        with errno_errors(self._node.device, f"copy buffer {buffer.index}"):
            data = self._node.port.copy_out(mapping, length)
        self._node.queue_buffer(buffer.index)
        return data[buffer.data_offset :]

    def release(self) -> None:
        """Stop streaming, unmap and free.

        Raises:
            DriverError: The first error, after the remaining steps were done.
        """
        error = self._give_back()
        if error is not None:
            raise error

    def _give_back(self) -> DriverError | None:
        first: DriverError | None = None
        steps: list[Callable[[], object]] = [self._node.stream_off] if self._streaming else []
        steps += [self._unmap, lambda: self._node.request_buffers(0)]
        self._streaming = False
        for step in steps:
            try:
                step()
            except DriverError as error:
                first = first or error
        return first

    def _unmap(self) -> None:
        while self._maps:
            self._maps.pop().close()
