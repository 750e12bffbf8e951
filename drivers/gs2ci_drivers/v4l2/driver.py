"""A V4L2 camera as a `Sensor`: calls in the order that kernel drivers expect, and recovery after it was unplugged.

Here: `V4l2Sensor` and `list_cameras`. Not here: reading (`gs2ci_drivers.streamed_sensor`), setting up (`setup`),
buffers (`streaming`), the checks of a frame (`frame_checks`), requests (`node`).

Order: open, QUERYCAP, S_FMT (re-read: the driver may change everything), controls (automatic ones off first),
REQBUFS, QUERYBUF + mmap, QBUF of all, SUBSCRIBE_EVENT, STREAMON, STREAMOFF, STREAMON (old frames are dropped, frame
numbers begin at 0), then poll, DQBUF, copy, QBUF; at the end STREAMOFF, munmap, REQBUFS 0, close.
"""

import contextlib
from dataclasses import replace

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.ports import SysPort
from gs2ci_drivers.sensor import SensorConfig, SensorInfo, SensorSettings, TriggerMode
from gs2ci_drivers.streamed_sensor import StreamedSensor
from gs2ci_drivers.v4l2.controls import Applied
from gs2ci_drivers.v4l2.frame_checks import KernelFrameChecks, TakenBuffer, first_numbers
from gs2ci_drivers.v4l2.node import Identity, VideoNode
from gs2ci_drivers.v4l2.options import V4l2Options
from gs2ci_drivers.v4l2.setup import CameraSetup, OpenCamera
from gs2ci_drivers.v4l2.streaming import BufferQueue


class V4l2Sensor(StreamedSensor[TakenBuffer]):
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
        self.incidents += self._setup.notes
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
            except BaseException:
                self._drop_queue()
                raise
            first = first_numbers(camera.identity.driver, self._options.first_sequence)
            self._settings = replace(self._setup.settings, buffers=self._queue.count)
            self._checks = KernelFrameChecks(
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
        if free:
            self._pass_warm_up(config, queue.take)
        queue.pause()
        if triggered and free:
            camera.adapter.set_mode(config.trigger)
        started_ns = self._port.clock_ns()  # before STREAMON: an exposure may begin during that call
        queue.start()
        return started_ns

    def _is_open(self) -> bool:
        return self._camera is not None

    def _fetch(self, timeout_s: float) -> TakenBuffer | None:
        assert self._queue is not None
        got = self._queue.take(timeout_s)
        return None if got is None else TakenBuffer(*got, self._port.clock_ns())

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

    def _probe(self) -> None:
        assert self._camera is not None
        self._camera.node.identity()

    def _let_go(self) -> None:
        self._drop_queue()
        self._shut()

    def _do_close(self) -> None:
        self._let_go()

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
