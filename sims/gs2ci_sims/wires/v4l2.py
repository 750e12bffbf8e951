"""A V4L2 camera and the kernel above it: the twin of `gs2ci_drivers.v4l2`, below `SysPort`.

It answers system calls as Linux does. Its time is that of the simulated world: a trigger edge on the world's bus starts
an exposure, during which the world's light falls on the sensor.

Here: `V4l2Twin`: nodes, descriptors, poll, the module's parameter, the plug. Not here: the effect of a request
(`v4l2_device`).
"""

import fnmatch
import select
from collections import deque
from errno import EACCES, EBADF, EFAULT, EINVAL, ENODEV, ENOENT, ENOTTY
from itertools import count
from typing import Any

import numpy as np

from gs2ci.core.arrays import Rng
from gs2ci_drivers.ports import MappedMemory
from gs2ci_sims.faults import FaultSet
from gs2ci_sims.wires.v4l2_camera import STAMPING, CameraModel
from gs2ci_sims.wires.v4l2_device import CaptureDevice, OpenFile
from gs2ci_sims.world import World

_SIZE_MASK = 0x3FFF
CALLS_KEPT = 10_000


class V4l2Twin:
    """A camera with its kernel, as a `SysPort`.

    Args:
        world: The simulated world, with clock, light and trigger bus.
        model: Its data sheet.
        faults: The faults to inject.
        rng: Draws jitter; the default is seeded with 0.
        path: Its capture node.
        subdevice: Its sensor's node, if the model has its controls there.
    """

    _made_device = CaptureDevice

    def __init__(
        self,
        world: World,
        model: CameraModel | None = None,
        faults: FaultSet | None = None,
        *,
        rng: Rng | None = None,
        path: str = "/dev/video0",
        subdevice: str = "/dev/v4l-subdev0",
    ) -> None:
        self.model = model or CameraModel()
        self.faults = faults or FaultSet()
        self.calls: deque[str] = deque(maxlen=CALLS_KEPT)
        """Names of the latest calls, for tests of their order."""
        self._clock = world.clock
        self._device = self._made_device(world, self.model, self.faults, rng or np.random.default_rng(0))
        self._nodes = {path: False} | ({subdevice: True} if self.model.on_subdevice else {})
        self._parameter = f"/sys/module/{self.model.module}/parameters/trigger_mode"
        self._files: dict[int, OpenFile] = {}
        self._descriptors = count(3)
        self._generation = 0
        self._plugged = True

    @property
    def streaming(self) -> bool:
        """Get whether frames are being captured."""
        return self._device.ring.streaming

    @property
    def region(self) -> tuple[int, int, int, int]:
        """Get first row and column, rows and columns of the region that is read out."""
        return self._device.region

    def unplug(self) -> None:
        """Unplug the camera: its nodes disappear, open descriptors fail."""
        if self._plugged:
            self._device.power_down()
            self._plugged = False
            self._generation += 1

    def plug_in(self) -> None:
        """Plug the camera in again, with its default settings."""
        if not self._plugged:
            self._plugged = True
            self._device.power_up()

    def open(self, path: str) -> int:
        """Open a node; return its descriptor.

        Raises:
            OSError: ENOENT: no such node.
        """
        self.calls.append("open")
        self._strike("open")
        if path not in self._nodes or not self._plugged:
            raise OSError(ENOENT, "No such file or directory", path)
        fd = next(self._descriptors)
        self._files[fd] = OpenFile(self._generation, self._nodes[path])
        self._device.opened(self._files[fd])
        for fault, control in (("v4l2.gain_left", "Analogue Gain"), ("v4l2.private_left", "IO Mode")):
            left = self.faults.take(fault)
            if left is not None:
                self._device.leave(control, int(left.value))
        return fd

    def close(self, fd: int) -> None:
        """Close a descriptor; unknown and closed ones are ignored."""
        self.calls.append("close")
        file = self._files.pop(fd, None)
        if file is not None:
            self._device.closed(file)

    def ioctl(self, fd: int, request: int, argument: bytearray, payload: bytearray | None = None) -> int:
        """Answer an ioctl in place.

        Raises:
            OSError: With the errno of the kernel.
        """
        table = self._device.requests | self._device.sensor_requests
        name, handler = table.get(request, (hex(request), None))
        name = f"VIDIOC_{name}"
        self.calls.append(name)
        file = self._alive(fd, name)
        mine = self._device.sensor_requests if file.subdevice else self._device.requests
        if handler is None or request not in mine:
            raise OSError(ENOTTY, f"Inappropriate ioctl for device: {name}")
        if len(argument) != request >> 16 & _SIZE_MASK:
            raise OSError(EFAULT, f"{name} with {len(argument)} bytes")
        handler(file, argument, payload)
        return 0

    def mmap(self, fd: int, length: int, offset: int) -> MappedMemory:
        """Map a buffer.

        Raises:
            OSError: EINVAL: there is no buffer at this offset.
        """
        self.calls.append("mmap")
        self._alive(fd, "mmap")
        return self._device.ring.map(offset, length)

    def copy_out(self, mapping: MappedMemory, length: int) -> bytes:
        """Copy bytes out of a mapped buffer."""
        return mapping[:length]

    def poll(self, fd: int, events: int, timeout_s: float) -> int:
        """Wait for a frame or an event on the world's clock.

        Raises:
            OSError: An injected errno.
        """
        self.calls.append("poll")
        file = self._files.get(fd)
        if file is None:
            return select.POLLNVAL
        if self.faults.take("v4l2.unplugged", "poll"):
            self.unplug()
        self._fail("poll")
        if self.faults.take("v4l2.wake_empty"):
            return select.POLLIN
        self._clock.wait_until(lambda: self._ready(file) != 0, timeout_s)
        return self._ready(file) & (events | select.POLLERR | select.POLLHUP)

    def _ready(self, file: OpenFile) -> int:
        if file.generation != self._generation:
            return select.POLLERR | select.POLLHUP | select.POLLPRI
        ring = self._device.ring
        mask = select.POLLPRI if file.events else 0
        if not ring.streaming or ring.broken or (ring.ended and not ring.ready):
            mask |= select.POLLERR
        return mask | (select.POLLIN if ring.ready else 0)

    def clock_ns(self) -> int:
        """Get the world's time as CLOCK_MONOTONIC."""
        return self._clock.now_ns()

    def list_nodes(self, pattern: str) -> list[str]:
        """List the existing nodes and files."""
        return sorted(fnmatch.filter((*self._nodes, *self.model.files), pattern)) if self._plugged else []

    def read_file(self, path: str) -> bytes:
        """Read the module's parameter, or a property of the device tree.

        Raises:
            OSError: ENOENT: no such file.
        """
        if path in self.model.files:
            return self.model.files[path]
        self._require_parameter(path)
        return self._device.parameter + b"\n"

    def write_file(self, path: str, data: bytes) -> None:
        """Write the module's parameter.

        Raises:
            OSError: ENOENT: no such file; EINVAL: no number; EACCES: injected.
        """
        self._require_parameter(path)
        if self.faults.take("v4l2.parameter_denied"):
            raise OSError(EACCES, "Permission denied", path)
        if not data.strip().isdigit():
            raise OSError(EINVAL, "Invalid argument", path)
        if not self.faults.take("v4l2.parameter_ignored"):
            self._device.parameter = data.strip()

    def _require_parameter(self, path: str) -> None:
        if self.model.trigger != "module" or path != self._parameter:
            raise OSError(ENOENT, "No such file or directory", path)

    def _alive(self, fd: int, name: str) -> OpenFile:
        if fd not in self._files:
            raise OSError(EBADF, "Bad file descriptor")
        self._strike(name)
        file = self._files[fd]
        if file.generation != self._generation:
            raise OSError(ENODEV, "No such device")
        return file

    def _strike(self, name: str) -> None:
        if self.faults.take("v4l2.unplugged", name):
            self.unplug()
            raise OSError(ENODEV, "No such device")
        self._fail(name)

    def _fail(self, name: str) -> None:
        failing = self.faults.take("v4l2.call_fails", name)
        if failing is not None:
            raise OSError(int(failing.value), name)


def simulated(world: World, settings: Any) -> V4l2Twin:
    """Build the twin that a rig file's [sensor] and [world] describe."""
    table, offered = world.stated.table, CameraModel().formats
    rows, columns = table.camera_array or (table.height, table.width)
    stamps, flags_start = STAMPING[table.camera_driver]
    first = (settings.format.ljust(4),) if settings.format else ()
    model = CameraModel(
        height=rows,
        width=columns,
        formats=(*first, *(code for code in offered if code not in first)),
        trigger=settings.trigger_adapter,
        module=settings.trigger_module,
        trigger_line=world.stated.trigger_line,
        latency_s=table.trigger_latency_s,
        jitter_s=table.trigger_jitter_s,
        exposure_offset_s=table.trigger_exposure_offset_s,
        readout_s=table.height * CameraModel.line_s if table.camera_readout_s is None else table.camera_readout_s,
        clock_ppm=table.camera_clock_ppm,
        driver=table.camera_driver,
        stamps=stamps,
        flags_start=flags_start,
        crops=table.camera_array is not None,
        on_subdevice=bool(settings.subdevice),
        rolls=settings.shutter == "rolling",
    )
    return V4l2Twin(world, model, world.stated.faults["sensor"], rng=np.random.default_rng(table.seed))
