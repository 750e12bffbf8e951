"""Recording a rig's shots into a shot file, row by row.

Here: the capture of a rig file from the plan to the finished file, the file's header, the rows. Not here: the file's
layout (`gs2ci.core.storage`), poses from stage positions (`telemetry`), the order of steps on the bench
(`gs2ci_drivers.acquisition`).
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import time_ns
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from gs2ci.core.arrays import F64, U16
from gs2ci.core.cameras import pinhole
from gs2ci.core.errors import StorageError
from gs2ci.core.progress import Progress
from gs2ci.core.records import Truth
from gs2ci.core.storage import CaptureHeader, FrameRow, ShotWriter
from gs2ci.rig.calibrated import Calibrated
from gs2ci.rig.config import RigTable
from gs2ci.rig.intent import intended
from gs2ci.rig.opening import Rig
from gs2ci.rig.ring import WritingRing
from gs2ci.rig.session import SessionLog, note_devices, note_temperatures
from gs2ci.rig.telemetry import Carriage, carriage_of
from gs2ci_drivers.acquisition import Devices, Taken, capture, plan_capture
from gs2ci_drivers.failures import UnsupportedError
from gs2ci_drivers.plan import CapturePlan, CaptureSettings, Mode
from gs2ci_drivers.sensor import Frame, TriggerMode

if TYPE_CHECKING:
    from gs2ci.rig.simulated import SimulatedBench
    from gs2ci_sims.world import Exposure

GUESSED_OPEN_SHARE: Final = 0.5
"""Without any figure of the light, it is assumed that a pixel with this share of the masks open fills the range."""
GUESSED: Final = "guessed"

FORGOTTEN_S: Final = 30.0
"""A continuous capture deletes the history of the simulated world that is older than this."""
FULL_WELL_SHARE: Final = 0.998
"""Readings from this share of the full well on count as clipped: noise puts some clipped pixels below its end."""


@dataclass(frozen=True)
class Prepared:
    """A capture that is planned and not yet started.

    Args:
        plan: The plan, which may break limits.
        codes: Mask levels at the sensor's pixels, [N, H, W].
        calibrated: The measured bench, or None: then the masks are assumed to be as drawn.
    """

    plan: CapturePlan
    codes: U16
    calibrated: Calibrated | None = None

    def _repr_png_(self) -> bytes:
        """Show the first masks as they will be drawn."""
        from gs2ci.core.notebook import png_of, row_of  # noqa: PLC0415  pictures are drawn only when shown

        brightest = max(int(self.codes.max(initial=0)), 1)
        return png_of(row_of(self.codes[:4] / brightest, height=160))

    def _repr_html_(self) -> str:
        from gs2ci.core.notebook import data_uri  # noqa: PLC0415  as above

        picture = f'<img style="max-width:100%" alt="masks as drawn" src="{data_uri(self._repr_png_())}">'
        return f"<div>{picture}{self.plan._repr_html_()}</div>"


def prepare(rig: Rig, devices: Devices, calibrated: Calibrated | None = None) -> Prepared:
    """Connect, draw the masks, set the sensor up and plan; nothing moves and nothing is uploaded.

    Args:
        rig: The rig.
        devices: Its open devices.
        calibrated: The measured bench, from `gs2ci.rig.calibrated.load`.

    Raises:
        DriverError: A device does not answer or refuses its set-up.
        UnsupportedError: The sensor set a frame size other than the requested one.
        InputError: The masks do not fit on the modulator.
    """
    codes, settings, config = intended(rig, devices)
    settings = _timed(replace(settings, measured=calibrated is not None), calibrated)
    plan = plan_capture(devices, settings, config)
    size = (config.height, config.width)
    got = devices.sensor.settings.format
    if (got.height, got.width) != size:
        raise UnsupportedError(
            devices.sensor.name,
            f"it takes {got.height} x {got.width} instead of {size[0]} x {size[1]}",
            asked="configure",
            allowed="a size that the sensor offers; `gs2ci devices` lists them",
            remedy="set height and width in [sensor]",
        )
    return Prepared(plan, codes, calibrated)


def _timed(settings: CaptureSettings, calibrated: Calibrated | None) -> CaptureSettings:
    """Insert the trigger's measured times, except for a gated sensor, whose exposure is timed by other edges."""
    if calibrated is None or calibrated.late_s is None or settings.trigger_mode is not TriggerMode.EDGE:
        return settings
    longer_s = calibrated.longer_s
    return replace(settings, late_s=calibrated.late_s[0], longer_s=0.0 if longer_s is None else longer_s[0])


def record(
    rig: Rig,
    devices: Devices,
    prepared: Prepared,
    out: Path,
    *,
    replace: bool,
    progress: Progress,
    saved: Callable[[Path], object] = lambda partial: None,
    session: SessionLog | None = None,
    enough: Callable[[ShotWriter, SessionLog], bool] | None = None,
) -> Path:
    """Run a prepared capture into a shot file.

    Args:
        rig: The rig.
        devices: Its open devices.
        prepared: From `prepare`.
        out: The shot file; while it is written it is `<out>.partial`.
        replace: Whether a finished file of that name may be replaced.
        progress: Receives upload and shots.
        saved: Called with the file of the rows if the capture ends early with some; never with another capture's file.
        session: The log beside it, begun and closed here; None makes one by the rig file.
        enough: Asked after each start of the modulator whether the file's shots are enough (`until`); None: never.

    Returns:
        The shot file.

    Raises:
        PlanRefusedError: The plan breaks limits; no file is made.
        DriverError: A device failed; rows taken before are in the `.partial`, if there are any.
        StorageError: The file cannot be written.
    """
    plan = prepared.plan.require_sound()
    log = session or SessionLog(out, rig.table.session)
    writer = ShotWriter(out, _header(rig, devices, prepared), replace=replace, sync=rig.table.capture.sync)
    try:
        with writer:
            log.begin(
                rig=rig.table.name,
                simulated=rig.bench is not None,
                file=out.name,
                metadata=rig.table.metadata,
            )
            note_devices(log, devices)
            recorder = _Recorder(rig, devices, prepared, writer, log)
            recorder.note_plan()
            try:
                if plan.settings.continuous:
                    _take_continuously(rig, devices, plan, recorder, progress)
                else:
                    ended = None if enough is None else partial(enough, writer, log)
                    capture(devices, plan, recorder.take, progress, ended)
                recorder.note_incidents()
            except BaseException as error:
                recorder.note_failure(error)
                raise
            note_temperatures(log, devices)
            log.note("end", rows=writer.rows_written)
            return writer.finish()
    except BaseException:
        if writer.rows_written:
            saved(writer.partial)
        else:  # no shot was taken, so there is nothing to recover, and no file is left in the way
            writer.partial.unlink(missing_ok=True)
        raise
    finally:
        log.close()


def _take_continuously(
    rig: Rig, devices: Devices, plan: CapturePlan, recorder: "_Recorder", progress: Progress
) -> None:
    """Take shots as fast as they come and write them in parallel; a simulated world deletes history meanwhile."""
    with WritingRing(recorder.take, rig.table.capture.ring) as ring:

        def keep(taken: Taken) -> None:
            ring.put(taken)
            if rig.bench is not None:
                rig.bench.forget_before(devices.clock.now_s() - FORGOTTEN_S)

        capture(devices, plan, keep, progress)
    recorder.note_ring(ring)


def _header(rig: Rig, devices: Devices, prepared: Prepared) -> CaptureHeader:
    table, plan, calibrated = rig.table, prepared.plan, prepared.calibrated
    picture = devices.sensor.settings.format
    stage = devices.stage
    light = rig.bench.light if rig.bench else None
    # In a continuous capture rows are written while the simulated world goes on: the truth cannot be read then.
    truth = light is not None and plan.settings.mode is not Mode.PER_MASK and not plan.settings.continuous
    cfa: Any = picture.cfa
    masks = prepared.codes.astype(np.float32) / np.float32(2**table.capture.bit_depth - 1)
    header = CaptureHeader(
        rows=plan.settings.shots * plan.frames_per_shot,
        channels=1,
        masks=masks,
        weights=plan.weights.astype(np.float32),
        reading="u2",
        offset_dn=table.sensor.black_level_dn,
        scale_dn=_scale_dn(table, plan, picture.top)[0],
        saturation_dn=float(saturation_of(table, picture.top)),
        cfa=cfa,
        intrinsics=light.scene.intrinsics if light is not None else _intrinsics(table, masks.shape[1:]),
        distortion=light.lens.coefficients if light is not None and light.lens else None,
        stage_axes=len(stage.info.axes) if stage is not None else 0,
        telemetry=_carriage(rig, prepared) is not None,
        truth_views="f4" if truth else "",
        truth_poses=truth,
        truth_depth=truth,
        mask_order=plan.turns,
        name=table.name,
        config=rig.text,
    )
    return header if calibrated is None else _with_calibration(header, calibrated, plan)


def _with_calibration(header: CaptureHeader, calibrated: Calibrated, plan: CapturePlan) -> CaptureHeader:
    """Replace the rig file's values by measured ones; values that were not measured stay."""
    arrays = calibrated.arrays(plan.exposure_s, mosaic=header.cfa is not None)
    found = replace(header, masks=calibrated.masks, saturated_map=True, calibration=arrays)
    if calibrated.weights is not None and plan.settings.mode is not Mode.PER_MASK:
        found = replace(found, weights=calibrated.weights)
    if calibrated.per_pixel:
        found = replace(found, per_pixel=True, offset_dn=float(np.mean(arrays["calib/dark"])))
    if calibrated.saturation_dn is not None:
        found = replace(found, saturation_dn=calibrated.saturation_dn)
    if calibrated.intrinsics is not None:
        found = replace(found, intrinsics=calibrated.intrinsics, distortion=calibrated.distortion)
    return found


def _scale_dn(table: RigTable, plan: CapturePlan, top: int) -> tuple[float, str]:
    """Return the reading of one fully open view at full scale, and the source of the number."""
    optics, sensor = table.optics, table.sensor
    if optics.full_scale_dn:
        return optics.full_scale_dn, "full_scale_dn in [optics]"
    if optics.full_scale_e_per_s and sensor.electrons_per_dn:
        charge_e = optics.full_scale_e_per_s * plan.sequence.exposure_s
        return charge_e / sensor.electrons_per_dn, "full_scale_e_per_s in [optics], electrons_per_dn in [sensor]"
    views = max(1.0, GUESSED_OPEN_SHARE * plan.sequence.count)
    return (top - sensor.black_level_dn) / views, f"{GUESSED}: the sensor's range over half the masks"


def saturation_of(table: RigTable, top: int) -> float:
    """Return the reading, DN, from which on a pixel may be clipped: the well's end or the converter's `top`."""
    sensor = table.sensor
    if sensor.full_well_e and sensor.electrons_per_dn:
        return min(float(top), sensor.black_level_dn + FULL_WELL_SHARE * sensor.full_well_e / sensor.electrons_per_dn)
    return float(top)


def _intrinsics(table: RigTable, size: tuple[int, ...]) -> F64 | None:
    focal_px = table.optics.focal_px
    return None if focal_px is None else pinhole(focal_px, size)


def _carriage(rig: Rig, prepared: Prepared) -> Carriage | None:
    """Return how the stage moves the camera, if it moves during the exposures."""
    plan = prepared.plan
    if plan.sweep is None:
        return None
    return carriage_of(rig.table, plan.settings.travel, prepared.calibrated, plan.sweep.speed_mm_s)


class _Recorder:
    """Turns shots into rows."""

    def __init__(self, rig: Rig, devices: Devices, prepared: Prepared, writer: ShotWriter, log: SessionLog) -> None:
        self._log = log
        self._rig = rig
        self._devices = devices
        self._prepared = prepared
        self._writer = writer
        self._carriage = _carriage(rig, prepared)
        self._unusable = prepared.calibrated.unusable if prepared.calibrated is not None else None
        # The devices' clock counts from some start; the file's host times count from the epoch.
        self._epoch_ns = time_ns() - round(devices.clock.now_s() * 1e9)

    def note_plan(self) -> None:
        """Write the origin of the capture and its plan."""
        modulator, sensor, stage = self._devices.modulator.info, self._devices.sensor.info, self._devices.stage
        self._writer.event(
            "devices",
            modulator=[modulator.model, modulator.serial, modulator.firmware],
            sensor=[sensor.model, sensor.serial, sensor.driver],
            stage=[] if stage is None else [stage.info.model, stage.info.serial, stage.info.firmware],
        )
        plan = self._prepared.plan
        scale = _scale_dn(self._rig.table, plan, self._devices.sensor.settings.format.top)[1]
        if self._prepared.calibrated is not None:
            self._writer.event("calibration", **self._prepared.calibrated.record())
        figures = {figure.what: figure.value for figure in plan.figures}
        self._writer.event("plan", scale=scale, **figures)
        self._log.note("plan", scale=scale, figures=figures)
        settings = dict(self._devices.sensor.settings.recorded)
        self._writer.event("settings", sensor=settings)
        self._log.note("settings", sensor=settings)

    def note_ring(self, ring: WritingRing) -> None:
        """Write how full the ring became, and how often the capture waited for the disk."""
        self._writer.event("ring", size=ring.size, fullest=ring.fullest, waits=ring.waits, waited_s=ring.waited_s)

    def note_incidents(self) -> None:
        """Write the incidents after the last delivered shot, which would otherwise be taken for the next capture's."""
        incidents = self._devices.incidents()
        if incidents:
            self._log.note("after the last shot", incidents=incidents)
        for incident in incidents:
            self._writer.event("incident", message=incident)

    def note_failure(self, error: BaseException) -> None:
        """Write why the capture ended; earlier rows stay. On a full disk the error of the disk is the one reported."""
        with suppress(StorageError):
            self.note_incidents()
        notes = [str(note) for note in getattr(error, "__notes__", [])]
        self._log.note("failed", error=type(error).__name__, message=str(error), notes=notes)
        with suppress(StorageError):
            self._writer.event("failed", error=type(error).__name__, message=str(error), notes=notes)

    def take(self, taken: Taken) -> None:
        """Write one shot, and only then the log's line that it was taken."""
        for incident in taken.incidents:
            self._writer.event("incident", shot=taken.index, message=incident)
        turned = self._prepared.plan.turns
        for i, frame in enumerate(taken.frames):
            self._writer.append(
                frame.pixels,
                frame=self._row(taken, i, frame),
                telemetry_world_to_camera=self._telemetry(taken),
                truth=self._truth(frame),
                saturated=self._unusable,
                mask_order=taken.mask_order if turned else None,
                provenance=self._provenance(taken, i, frame),
            )
        self._log.note("shot", index=taken.index, attempts=taken.attempts, incidents=list(taken.incidents))

    def _row(self, taken: Taken, i: int, frame: Frame) -> FrameRow:
        return FrameRow(
            sequence=frame.sequence,
            t_kernel_ns=frame.t_kernel_ns,
            t_host_ns=frame.t_host_ns + self._epoch_ns,
            flags=int(frame.flags),
            trigger_index=taken.trigger_index + i,
            stage_pos_mm=taken.stage_mm,
            stage_target_mm=taken.stage_target_mm,
        )

    def _provenance(self, taken: Taken, i: int, frame: Frame) -> dict[str, Any]:
        plan = self._prepared.plan
        origin: dict[str, Any] = {
            "source": "simulated rig" if self._rig.bench else "rig",
            "mode": plan.settings.mode.value,
            "exposure_s": plan.exposure_s,
            # A sweep does not stop for masks.
            "within_mask": "still" if plan.sweep is None else "moving",
            "attempts": taken.attempts,
            "taken_at": datetime.fromtimestamp((frame.t_host_ns + self._epoch_ns) / 1e9, UTC).isoformat(),
        }
        scale = _scale_dn(self._rig.table, plan, self._devices.sensor.settings.format.top)[1]
        origin["unit_stated"] = not scale.startswith(GUESSED)
        if self._rig.table.metadata:
            origin["metadata"] = dict(self._rig.table.metadata)
        if plan.settings.mode is Mode.PER_MASK:
            origin["mask_index"] = i
        if self._carriage is not None:
            origin["telemetry"] = dict(self._carriage.provenance)
            stage = self._devices.stage
            if stage is not None and taken.stage_mm is not None:
                place = self._carriage.origin(taken.stage_mm, tuple(stage.info.axes))
                origin["telemetry"]["origin"] = [round(float(part), 9) for part in place]
        bench = None if plan.settings.continuous else self._rig.bench
        exposure = self._exposure_of(bench, frame) if bench else None
        if bench and bench.light and exposure:
            simulated = bench.light.plans.get(exposure.index)
            origin |= {"plan": simulated.record()} if simulated else {}
        return origin

    def _telemetry(self, taken: Taken) -> F64 | None:
        """Return camera poses from stage positions, [N, 4, 4]."""
        stage = self._devices.stage
        if self._carriage is None or stage is None or taken.stage_mm is None:
            return None
        return self._carriage.world_to_camera(taken.stage_mm, tuple(stage.info.axes))

    def _truth(self, frame: Frame) -> Truth | None:
        """Return the true views, on a simulated bench."""
        bench = self._rig.bench
        settings = self._prepared.plan.settings
        if bench is None or settings.mode is Mode.PER_MASK or settings.continuous:
            return None
        light, exposure = bench.light, self._exposure_of(bench, frame)
        if light is None or exposure is None:
            return None
        if len(exposure.masks) != self._prepared.plan.sequence.count:
            return None
        views, poses = light.truth(exposure)
        return Truth(views=views, world_to_camera=poses, depth=light.true_depth(exposure))

    def _exposure_of(self, bench: "SimulatedBench", frame: Frame) -> "Exposure | None":
        """Return the exposure that a frame came from: the one that began at the time of its stamp."""
        readout_s = self._devices.sensor.settings.readout_s
        began_s = frame.began_s(self._prepared.plan.exposure_s, readout_s)
        return min(bench.world.exposures, key=lambda exposure: abs(exposure.start_s - began_s), default=None)
