"""A whole bench for Bluesky's run engine, and a plan that takes coded frames with it.

Here: `OphydBench`, which `ophyd_bench` makes, and `coded_frames`. Not here: the devices (`axis`, `masks`, `camera`,
`coded`), other plans (Bluesky's own work with them).
"""

from collections.abc import Generator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Self

from bluesky import Msg
from bluesky import plan_stubs as bps
from bluesky import preprocessors as bpp
from ophyd_async.core import (
    DetectorTrigger,
    PathProvider,
    StaticPathProvider,
    TriggerInfo,
    UUIDFilenameProvider,
)

from gs2ci.api.ophyd.axis import StageAxis
from gs2ci.api.ophyd.camera import FrameDetector
from gs2ci.api.ophyd.coded import CodedExposure
from gs2ci.api.ophyd.masks import MaskFlyer
from gs2ci.api.ophyd.worker import Worker
from gs2ci.api.rigs import OpenRig
from gs2ci.rig.intent import intended
from gs2ci_drivers.acquisition import plan_capture
from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.plan import CapturePlan
from gs2ci_drivers.sensor import TriggerMode

FRAME_PATIENCE_S: Final = 10.0
"""How long after its sequence a frame may still come."""
SIMULATED_PATIENCE_S: Final = 120.0
"""The same for a simulated bench, which computes its light, and compiles kernels at first."""


class OphydBench:
    """A bench's devices for ophyd-async; connected when created, at rest and closed at the end.

    Args:
        rig: The rig. Its devices belong to this object until it is closed.
        places: The folder for frames and shots, or ophyd-async's own provider of paths.

    Attributes:
        modulator: Shows masks (`MaskFlyer`).
        sensor: Takes frames (`FrameDetector`).
        axes: The stage's axes by name (`StageAxis`); empty without a stage.
        coded: Takes whole coded exposures into shot files (`CodedExposure`).

    Raises:
        DeviceError: A device does not answer.
        InputError: The rig file's masks do not fit on the modulator.
    """

    def __init__(self, rig: OpenRig, places: "str | Path | PathProvider") -> None:
        if isinstance(places, str | Path):
            places = StaticPathProvider(UUIDFilenameProvider(), Path(places).resolve())
        self._rig, self._call, self._closed = rig, Worker(), False
        try:
            self._connect(places)
        except BaseException:
            self.close()
            raise

    def _connect(self, places: PathProvider) -> None:
        call = self._call
        devices = call.now(lambda: self._rig.devices)
        _, self._settings, self._config = call.now(intended, self._rig.rig, devices)
        self.modulator = MaskFlyer(devices.modulator, call, "modulator")
        self.sensor = FrameDetector(devices.sensor, self._config, call, places, "sensor")
        self.coded = CodedExposure(self._rig, call, places, "coded")
        self.axes: dict[str, StageAxis] = {}
        if devices.stage is not None:
            info = call.now(devices.stage.connect)
            self.axes = {axis: StageAxis(devices.stage, axis, call, f"stage-{axis}") for axis in info.axes}

    def lay_out(self, shots: int) -> tuple[CapturePlan, TriggerInfo]:
        """Plan coded frames of the rig file's masks, camera at rest: for the modulator and for the sensor.

        Raises:
            PlanRefusedError: A limit is broken; names every one.
        """
        settings = replace(self._settings, shots=shots, burst=shots, travel=None)
        plan = self._call.now(plan_capture, self._rig.devices, settings, self._config).require_sound()
        gated = plan.settings.trigger_mode is TriggerMode.LEVEL
        info = TriggerInfo(
            number_of_events=shots * plan.frames_per_shot,
            trigger=DetectorTrigger.EXTERNAL_LEVEL if gated else DetectorTrigger.EXTERNAL_EDGE,
            livetime=0.0 if gated else self._rig.devices.sensor.settings.exposure_s,
            exposure_timeout=plan.sequence.period_s
            + (SIMULATED_PATIENCE_S if self._rig.simulated else FRAME_PATIENCE_S),
        )
        return plan, info

    def close(self) -> None:
        """Bring all to rest and close it; a second call does nothing."""
        if not self._closed:
            self._closed = True
            self._call.now(self._halt)
            self._call.close()

    def _halt(self) -> None:
        """Switch everything off, whatever an aborted plan has left on, and close it."""
        devices = self._rig.opened
        if devices is not None:
            stage = [] if devices.stage is None else [devices.stage.stop]
            for end in (devices.modulator.disarm, devices.sensor.stop, *stage):
                with suppress(DriverError):  # a device that is gone, or was never connected, cannot be on
                    end()
        self._rig.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def coded_frames(
    bench: OphydBench, shots: int = 1, metadata: dict[str, Any] | None = None
) -> Generator[Msg, Any, None]:
    """Take coded frames as a fly scan, camera at rest: a plan for Bluesky's run engine.

    The modulator triggers the sensor in hardware; the frames are in the file that the run's documents name.

    Args:
        bench: The bench.
        shots: Number of frames, each through all masks of the rig file.
        metadata: Added to the run's start document, with the masks' times.

    Raises:
        PlanRefusedError: A limit of a device is broken; nothing was uploaded.
    """
    plan, trigger = bench.lay_out(shots)
    told = {"masks": plan.sequence.count, "mask_s": plan.sequence.exposure_s, "exposure_s": plan.exposure_s}

    def inner() -> Generator[Msg, Any, None]:
        yield from bps.prepare(bench.modulator, plan.sequence, wait=True)
        yield from bps.prepare(bench.sensor, trigger, wait=True)
        yield from bps.declare_stream(bench.sensor, name="primary")
        yield from bps.kickoff_all(bench.sensor, wait=True)
        yield from bps.kickoff_all(bench.modulator, wait=True)
        yield from bps.collect_while_completing([bench.modulator, bench.sensor], [bench.sensor], flush_period=0.5)

    run = bpp.run_wrapper(inner(), md={"plan_name": "coded_frames", **told, **(metadata or {})})  # type: ignore[no-untyped-call]
    yield from bpp.stage_wrapper(run, [bench.modulator, bench.sensor])  # type: ignore[no-untyped-call]
