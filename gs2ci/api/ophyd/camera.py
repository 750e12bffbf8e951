"""The sensor as an ophyd-async detector: its own or triggered frames into an HDF5 file that Bluesky's documents name.

Here: `FrameDetector`. Not here: the sensor (`gs2ci_drivers.sensor`), coded exposures (`coded`).
"""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from bluesky.protocols import Status
from ophyd_async.core import (
    AsyncStatus,
    DetectorAcquireLogic,
    DetectorDataLogic,
    DetectorTriggerLogic,
    PathProvider,
    SignalDict,
    SignalR,
    StandardDetector,
    StreamableDataProvider,
    StreamResourceDataProvider,
    StreamResourceInfo,
    soft_signal_r_and_setter,
)

from gs2ci.api.ophyd.worker import SLICE_S, Worker
from gs2ci.core.errors import InputError
from gs2ci_drivers.failures import TriggerTimeoutError
from gs2ci_drivers.sensor import Frame, Sensor, SensorConfig, TriggerMode

FRAMES: Final = "frames"
TOLD: Final = {"sequence": np.int64, "t_kernel_ns": np.int64, "t_host_ns": np.int64, "flags": np.uint32}
"""Data of each frame in the file besides its pixels, as in `gs2ci_drivers.sensor.Frame`."""


class _Taking:
    """Writes the prepared number of frames from the sensor into a file; in the sensor's thread."""

    def __init__(self, sensor: Sensor, config: SensorConfig, call: Worker) -> None:
        self.sensor, self.config, self.call = sensor, config, call
        self.wanted = 0
        self.exposure_s, self.set_exposure = soft_signal_r_and_setter(float, config.exposure_s, units="s")
        self.written, self.set_written = soft_signal_r_and_setter(int, 0)
        self.file: h5py.File | None = None
        self.task: asyncio.Task[None] | None = None

    async def prepare(self, trigger: TriggerMode, count: int, livetime_s: float) -> None:
        await self.stop()
        asked = replace(self.config, trigger=trigger, exposure_s=livetime_s or self.config.exposure_s)
        got = await self.call(self.sensor.configure, asked)
        self.wanted = count
        self.set_exposure(got.exposure_s)

    async def begin(self) -> None:
        await self.call(self.sensor.start)
        self.task = asyncio.create_task(self._take())

    async def _take(self) -> None:
        for _ in range(self.wanted):
            while (frame := await self.call(self._next)) is None:
                await asyncio.sleep(
                    SLICE_S
                )  # a simulated bench's clock advances during the wait: no faster than real time
            await self.call(self._write, frame)
            self.set_written(await self.written.get_value() + 1)
        await self.call(self.sensor.stop)

    def _next(self) -> Frame | None:
        try:
            return self.sensor.read(SLICE_S)
        except TriggerTimeoutError:
            return None

    def _write(self, frame: Frame) -> None:
        assert self.file is not None  # prepared before any frame is taken
        number = len(self.file[FRAMES])
        self.file[FRAMES].resize(number + 1, axis=0)
        self.file[FRAMES][number] = frame.pixels
        for name in TOLD:
            self.file[name].resize(number + 1, axis=0)
            self.file[name][number] = int(getattr(frame, name))
        self.file.flush()

    def open(self, path: Path) -> None:
        self.shut()
        size = self.sensor.settings.format.height, self.sensor.settings.format.width
        self.file = h5py.File(path, "x")
        self.file.create_dataset(FRAMES, (0, *size), np.uint16, maxshape=(None, *size), chunks=(1, *size))
        for name, kind in TOLD.items():
            self.file.create_dataset(name, (0,), kind, maxshape=(None,), chunks=(1024,))

    def shut(self) -> None:
        file, self.file = self.file, None
        if file is not None:
            file.close()

    async def stop(self) -> None:
        task, self.task = self.task, None
        if task is not None:
            task.cancel()
            with suppress(asyncio.CancelledError, Exception):  # its waiter has received the error
                await task
        await self.call(self.sensor.stop)


class _Trigger(DetectorTriggerLogic):
    def __init__(self, taking: _Taking) -> None:
        self._taking = taking

    def config_sigs(self) -> set[SignalR[Any]]:
        return {self._taking.exposure_s}

    def get_deadtime(self, config_values: SignalDict) -> float:
        return self._taking.sensor.settings.readout_s

    async def prepare_internal(self, num: int, livetime: float, deadtime: float) -> None:
        if deadtime:
            raise InputError(
                f"a dead time of {deadtime:g} s", allowed="0: the sensor's own", remedy="trigger it from outside"
            )
        await self._taking.prepare(TriggerMode.FREE_RUN, num, livetime)

    async def prepare_edge(self, num: int, livetime: float) -> None:
        await self._taking.prepare(TriggerMode.EDGE, num, livetime)

    async def prepare_level(self, num: int) -> None:
        await self._taking.prepare(TriggerMode.LEVEL, num, 0.0)


class _Acquire(DetectorAcquireLogic):
    def __init__(self, taking: _Taking) -> None:
        self._taking = taking

    async def start_acquiring(self) -> None:
        await self._taking.begin()

    async def wait_for_idle(self) -> None:
        if self._taking.task is not None:
            await self._taking.task

    async def ensure_stopped(self) -> None:
        await self._taking.stop()


class _Data(DetectorDataLogic):
    def __init__(self, taking: _Taking, places: PathProvider) -> None:
        self._taking, self._places = taking, places

    async def prepare_unbounded(self, datakey_name: str) -> StreamableDataProvider:
        place = self._places(datakey_name)
        path = Path(place.directory_path) / f"{place.filename}.h5"
        await self._taking.call(self._taking.open, path)
        self._taking.set_written(0)
        form = self._taking.sensor.settings.format
        frames = StreamResourceInfo(
            data_key=datakey_name,
            shape=(form.height, form.width),
            chunk_shape=(1, form.height, form.width),
            dtype_numpy=np.dtype(np.uint16).str,
            parameters={"dataset": f"/{FRAMES}"},
        )
        return StreamResourceDataProvider(
            uri=f"{place.directory_uri}{path.name}",
            resources=[frames],
            mimetype="application/x-hdf5",
            collections_written_signal=self._taking.written,
        )

    def get_hinted_fields(self, datakey_name: str) -> Sequence[str]:
        return [datakey_name]

    async def stop(self) -> None:
        await self._taking.stop()
        await self._taking.call(self._taking.shut)


class FrameDetector(StandardDetector):
    """A camera: raw frames [H, W] uint16, as they come, into `frames` of an HDF5 file per run.

    `TriggerInfo.trigger` chooses the sensor's own clock, edges, or gates; `livetime` is the exposure in seconds, 0 the
    configured one. A lost or corrupt frame ends the acquisition with the driver's own error.

    Args:
        sensor: The sensor, connected.
        config: Its configuration; trigger and exposure are filled in at each `prepare`.
        call: The devices' thread.
        places: Names the next file; an existing file is not replaced.
        name: Name in Bluesky's documents.
    """

    def __init__(
        self, sensor: Sensor, config: SensorConfig, call: Worker, places: PathProvider, name: str = ""
    ) -> None:
        self._taking = _Taking(sensor, config, call)
        self.exposure = self._taking.exposure_s
        self.add_detector_logics(_Trigger(self._taking), _Acquire(self._taking), _Data(self._taking, places))
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def complete(self) -> None:  # type: ignore[override]  # it reports no progress
        """Wait for the prepared number of frames."""
        await self._or_its_error(super().complete)

    @AsyncStatus.wrap
    async def trigger(self) -> None:  # type: ignore[override]
        """Take one frame."""
        await self._or_its_error(super().trigger)

    async def _or_its_error(self, begin: Callable[[], Status]) -> None:
        """Wait, but raise an error of the sensor at once: the expected frame will not come."""
        status: Any = begin()
        waiting: asyncio.Task[None] = status.task
        try:
            while not waiting.done():
                taking = self._taking.task
                if taking is not None and taking.done():
                    taking.result()
                await asyncio.wait([waiting], timeout=SLICE_S)
        finally:
            waiting.cancel()
        await waiting
