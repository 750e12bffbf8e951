"""A V4L2 camera as a `Sensor`: calls in the order that kernel drivers expect, and recovery after it was unplugged.

Here: `V4l2Sensor` and `list_cameras`. Not here: setting up (`setup`), buffers (`streaming`), the check of a frame
(`judge`), requests (`node`).

Order: open, QUERYCAP, S_FMT (re-read: the driver may change everything), controls (automatic ones off first),
REQBUFS, QUERYBUF + mmap, QBUF of all, SUBSCRIBE_EVENT, STREAMON, STREAMOFF, STREAMON (old frames are dropped, frame
numbers begin at 0), then poll, DQBUF, copy, QBUF; at the end STREAMOFF, munmap, REQBUFS 0, close.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import DisconnectedError, DriverError, TriggerTimeoutError
from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.sensor import (
    Frame,
    Sensor,
    SensorConfig,
    SensorInfo,
    SensorSettings,
    SensorStatus,
    TriggerMode,
)
from gs2ci_drivers.v4l2.controls import Applied
from gs2ci_drivers.v4l2.judge import FrameJudge, TakenBuffer
from gs2ci_drivers.v4l2.node import Identity, VideoNode
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_drivers.v4l2.setup import CameraSetup, OpenCamera
from gs2ci_drivers.v4l2.streaming import BufferQueue

WARM_UP_PATIENCE_S: Final = 5.0
"""How long a warm-up frame may take beyond its exposure: USB cameras need seconds to begin."""
MAX_DISCARD: Final = 256
"""Limit on the frames that `discard` discards, so that it ends even if frames arrive faster than it reads them."""


class V4l2Sensor(Sensor):
    """A camera behind a V4L2 capture node, single-plane or multi-plane.

    If the device disappears, or does not stop, the node is closed at once, so that the kernel frees everything;
    `configure` or `start` opens it again, so that after a replug the same object can go on capturing.

    Args:
        name: Name of the device in the rig file, for messages.
        port: The system calls, real or a twin's.
        clock: The clock of all waits.
        options: What the kernel driver does not report.
    """

    def __init__(self, name: str, port: SysPort, clock: Clock, options: V4l2Options | None = None) -> None:
        super().__init__(name, clock)
        self._port = port
        self._options = options or V4l2Options()
        self._camera: OpenCamera | None = None
        self._config: SensorConfig | None = None
        self._setup: CameraSetup | None = None
        self._queue: BufferQueue | None = None
        self._judge: FrameJudge | None = None

    @property
    def applied_controls(self) -> tuple[Applied, ...]:
        """Get the requested and the resulting value of each control set by the last `configure`."""
        return self._setup.applied if self._setup is not None else ()

    def _do_connect(self) -> SensorInfo:
        try:
            return self._open().describe()
        except DriverError:
            self._shut()
            raise

    def _open(self) -> OpenCamera:
        if self._camera is None:
            self._camera = OpenCamera(self.name, self._port, self.clock, self._options)
        return self._camera

    def _do_configure(self, config: SensorConfig) -> SensorSettings:
        with self._noticing_loss():
            self._setup = self._open().apply(config)
        self._config = config
        self.incidents += [
            f"{self.name}: {one.control} = {one.requested} was requested, {one.applied} is set"
            for one in self._setup.applied
            if one.clamped
        ]
        return self._setup.settings

    def _do_start(self) -> None:
        assert self._config is not None  # the base class starts nothing that is not configured
        with self._noticing_loss():
            if self._camera is None:  # it had disappeared and may be back, without its settings
                self._setup = self._open().apply(self._config)
            assert self._setup is not None
            camera = self._open()
            self._queue = BufferQueue(camera.node, self.clock, self._config.buffers)
            try:
                started_ns = self._run(camera, self._queue, self._config)
            except DriverError:
                self._drop_queue()
                raise
            first = self._options.first_sequence if self._options.first_sequence >= 0 else None
            self._settings = replace(self._setup.settings, buffers=self._queue.count)
            self._judge = FrameJudge(
                self.name, self._setup.geometry, first, started_ns, camera.identity.driver, self._options.stamps
            )

    def _run(self, camera: OpenCamera, queue: BufferQueue, config: SensorConfig) -> int:
        """Stream the warm-up frames by the sensor's own clock, then restart, so that no old frame is left.

        Returns the kernel time before which a frame counts as old.
        """
        triggered = config.trigger is not TriggerMode.FREE_RUN
        free = config.warm_up_frames > 0 and TriggerMode.FREE_RUN in camera.adapter.triggers
        if triggered and free:
            camera.adapter.set_mode(TriggerMode.FREE_RUN)
        queue.start()
        patience_s = WARM_UP_PATIENCE_S + config.exposure_s
        for index in range(config.warm_up_frames if free else 0):
            if queue.take(patience_s) is None:
                raise TriggerTimeoutError(self.name, index, patience_s)
        queue.pause()
        if triggered and free:
            camera.adapter.set_mode(config.trigger)
        started_ns = self._port.clock_ns()  # before STREAMON: an exposure may begin during that call
        queue.start()
        return started_ns

    def _do_read(self, timeout_s: float, not_before_ns: int, trigger_index: int | None) -> Frame:
        try:
            with self._noticing_loss():
                queue, judge = self._running()
                return judge.judge(self._take(queue, judge, timeout_s), not_before_ns)
        except DriverError as error:
            if trigger_index is not None:
                error.at_trigger(trigger_index)
            raise

    def _running(self) -> tuple[BufferQueue, FrameJudge]:
        if self._queue is None or self._judge is None:
            raise DisconnectedError(self.name, "read", "it was disconnected earlier")
        return self._queue, self._judge

    def _take(self, queue: BufferQueue, judge: FrameJudge, timeout_s: float) -> TakenBuffer:
        if judge.held is not None:
            taken, judge.held = judge.held, None
            return taken
        got = queue.take(timeout_s)
        if got is None:
            raise TriggerTimeoutError(self.name, judge.frame_index, timeout_s)
        return TakenBuffer(*got, self._port.clock_ns())

    def _do_discard(self) -> int:
        with self._noticing_loss():
            queue, judge = self._running()
            dropped = 0 if judge.held is None else 1
            if judge.held is not None:
                judge.pass_over(judge.held)
                judge.held = None
            while dropped < MAX_DISCARD and (got := queue.take(0.0)) is not None:
                judge.pass_over(TakenBuffer(*got, self._port.clock_ns()))
                dropped += 1
        return dropped

    def _do_stop(self) -> None:
        queue, self._queue = self._queue, None
        with self._noticing_loss():
            if queue is not None:
                self._release(queue)

    def _release(self, queue: BufferQueue) -> None:
        """Free the buffers; if that fails, close the node, so that the kernel frees them."""
        try:
            queue.release()
        except DriverError:
            self._shut()
            raise

    def _do_status(self) -> SensorStatus:
        with self._noticing_loss():
            if self._camera is None:
                raise DisconnectedError(self.name, "status", "it was disconnected earlier")
            self._camera.node.identity()
        judge = self._judge
        if judge is None:
            return SensorStatus(self._streaming)
        return SensorStatus(self._streaming, judge.delivered, judge.lost, judge.corrupt)

    def _do_close(self) -> None:
        self._drop_queue()
        self._shut()

    @contextlib.contextmanager
    def _noticing_loss(self) -> Iterator[None]:
        """Release everything if the device turns out to be gone."""
        try:
            yield
        except DisconnectedError:
            self._drop_queue()
            self._shut()
            raise

    def _drop_queue(self) -> None:
        queue, self._queue = self._queue, None
        if queue is not None:
            with contextlib.suppress(DriverError):
                self._release(queue)

    def _shut(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()


def list_cameras(port: SysPort) -> list[tuple[str, Identity]]:
    """List the capture nodes with their identities; leave out those that do not answer."""
    found = []
    for path in port.list_nodes("/dev/video*"):
        try:
            with contextlib.closing(VideoNode(port, path, path)) as node:
                identity = node.identity()
        except DriverError:
            continue
        if identity.buffer_type is not None:
            found.append((path, identity))
    return found
