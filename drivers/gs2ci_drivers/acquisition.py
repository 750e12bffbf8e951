"""A capture: plan → arm → fire → collect → disarm, as steps with inverses.

The plan is checked before anything moves. Whatever goes wrong later, all steps done so far are undone in reverse order:
the modulator shows nothing, the sensor does not stream, the stage is at rest; the error that reaches the caller names
the device and the trigger that was being served. Shots delivered before the error are kept.

Here: the order of the steps. Not here: what a plan is (`gs2ci_drivers.plan`, `planning`), checks of frames against
triggers (`frame_timing`), the stage's positions (`stage_watch`), files (the `sink` that is passed in), light.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.clock import Clock
from gs2ci.core.progress import Progress, Silent
from gs2ci_drivers.failures import (
    DriverError,
    ExtraFrameError,
    FrameCorruptError,
    FrameError,
    FrameLostError,
    PathError,
    TriggerTimeoutError,
)
from gs2ci_drivers.frame_timing import END_TOLERANCE_S, Fire, FrameTiming
from gs2ci_drivers.modulator import POLL_S, Modulator, ModulatorState
from gs2ci_drivers.plan import CapturePlan, CaptureSettings, Mode, with_upload
from gs2ci_drivers.planning import lay_out, sensor_exposure_s
from gs2ci_drivers.sensor import Frame, FrameFlag, Sensor, SensorConfig
from gs2ci_drivers.stage import Stage
from gs2ci_drivers.stage_watch import PATIENCE_S, StageWatch
from gs2ci_drivers.steps import Steps

FRAME_PATIENCE_S = 1.0
"""How long after its readout a frame may still arrive: USB transfer and a busy host."""
STALE_MARGIN_NS = 1_000_000
"""A frame stamped up to 1 ms before the host's time of firing counts as after it: two readings of one clock."""
WATCHED_SHARE = 0.25
"""On a panel whose masks the host steps, a position is read between two masks if it takes less of a mask's time."""


@dataclass(frozen=True)
class Devices:
    """The devices of a rig, open.

    Args:
        modulator: Shows the masks.
        sensor: Takes the frames.
        stage: Moves the camera, or None.
        clock: The clock on which all of them wait.
        also_close: Called after them: wire traces.
    """

    modulator: Modulator
    sensor: Sensor
    stage: Stage | None
    clock: Clock
    also_close: tuple[Callable[[], None], ...] = ()

    def close(self) -> None:
        """Release all devices; never raises, may be called twice."""
        with ExitStack() as closing:  # each is closed, even if closing another fails
            for close in reversed(self.also_close):
                closing.callback(close)
            for device in (self.modulator, self.sensor, self.stage):
                if device is not None:
                    closing.callback(device.close)

    def incidents(self) -> list[str]:
        """Return, and clear, the incidents from which the drivers recovered since the last call."""
        found: list[str] = []
        for device in (self.modulator, self.sensor, self.stage):
            if device is not None:
                found += device.incidents
                device.incidents.clear()
        return found


@dataclass(frozen=True)
class Taken:
    """One shot as taken.

    Args:
        index: Which shot of the capture, from 0.
        frames: Its frames: 1, or one per mask in `Mode.PER_MASK`.
        trigger_index: Index of its first trigger in the capture.
        mask_order: Indices of the plan's masks in the order in which they were shown, N.
        stage_mm: Stage position in the middle of the time that each mask was exposed, [N, K] in the order of the
            stage's axes, or None.
        stage_target_mm: Where it should have been, [N, K], or None.
        stage_error_mm: By how much positions during a sweep may be off, as far as those that were read tell.
        attempts: 1, or more if it had to be repeated.
        incidents: Problems from which drivers recovered meanwhile.
    """

    index: int
    frames: tuple[Frame, ...]
    trigger_index: int
    mask_order: Sequence[int] = ()
    stage_mm: F64 | None = None
    stage_target_mm: F64 | None = None
    stage_error_mm: float | None = None
    attempts: int = 1
    incidents: tuple[str, ...] = ()


Sink = Callable[[Taken], None]


def plan_capture(devices: Devices, settings: CaptureSettings, config: SensorConfig) -> CapturePlan:
    """Connect, set the sensor up and lay the capture out; nothing moves and nothing is uploaded.

    Args:
        devices: The rig's devices.
        settings: The capture that the user wants.
        config: The sensor's set-up; exposure and trigger are filled in here.

    Returns:
        The plan, which may break limits: see `CapturePlan.require_sound`.

    Raises:
        DriverError: A device does not answer, or the sensor refuses its set-up.
    """
    modulator, sensor, stage = devices.modulator, devices.sensor, devices.stage
    modulator_info = modulator.connect()
    sensor_info = sensor.prepare()
    stage_info = stage.connect() if stage is not None else None
    if settings.mode is Mode.PER_MASK and sensor_info.only_gated:
        settings = replace(settings, gated=True)
    needed_s = sensor_exposure_s(settings.rounded_for(modulator_info))
    exposure_s = min(max(needed_s, sensor_info.min_exposure_s), sensor_info.max_exposure_s)
    setup = sensor.configure(replace(config, exposure_s=exposure_s, trigger=settings.trigger_mode))
    plan = lay_out(settings, modulator_info, sensor_info, setup, stage_info)
    try:
        return with_upload(plan, modulator.upload_eta_s(plan.sequence), modulator.turn_eta_s(plan.sequence))
    except DriverError:
        if plan.broken:  # the sequence cannot be sent for the reasons that the plan names
            return plan
        raise


def capture(
    devices: Devices,
    plan: CapturePlan,
    sink: Sink,
    progress: Progress | None = None,
    enough: Callable[[], bool] | None = None,
) -> int:
    """Run a plan; deliver each shot as soon as it is complete.

    Args:
        devices: The rig's devices, with the sensor set up by `plan_capture`.
        plan: The plan.
        sink: Receives each shot; an error that it raises ends the capture.
        progress: Receives the upload and the shots.
        enough: Asked after each start of the modulator whether to end before all shots are taken; meanwhile the
            modulator is dark and the stage at rest; None: never. A continuous capture has one start.

    Returns:
        The number of shots delivered.

    Raises:
        PlanRefusedError: The plan breaks limits; nothing was moved or uploaded.
        DriverError: A device failed; all others are at rest.
    """
    plan.require_sound()
    return _Capture(devices, plan, sink, progress or Silent()).run(enough)


class _Capture:
    """One run of a plan."""

    def __init__(self, devices: Devices, plan: CapturePlan, sink: Sink, progress: Progress) -> None:
        self._devices = devices
        self._plan = plan
        self._sink = sink
        self._progress = progress
        self._timing = FrameTiming(plan, devices.sensor, devices.modulator)
        self._trigger = 0  # the trigger being served
        self._next_trigger = 0
        self._taken = 0
        self._sequence = plan.sequence
        # How long before the start of the travel to start the modulator; each fire corrects it for the next one.
        self._lead_s = devices.modulator.info.expected_start_s
        self._watch = None if devices.stage is None else StageWatch(devices.stage, plan, devices.clock)

    def run(self, enough: Callable[[], bool] | None) -> int:
        try:
            with Steps() as steps:
                self._prepare(steps)
                self._progress.stage("shots", self._plan.settings.shots)
                for fire in range(self._plan.fires):
                    self._begin_with(self._plan.first_mask(fire))
                    self._fire_with_retries()
                    if enough is not None and enough():
                        break
        except DriverError as error:
            error.at_trigger(self._trigger)
            raise
        return self._taken

    def _prepare(self, steps: Steps) -> None:
        """Do what happens once: stage to its start, upload, sensor on."""
        modulator, sensor, stage = self._devices.modulator, self._devices.sensor, self._devices.stage
        sweep, progress = self._plan.sweep, self._progress
        if stage is not None and sweep is not None:
            steps.do("stage to its start", lambda: stage.prepare_sweep(sweep), stage.stop)
        steps.do("modulator dark", modulator.disarm, modulator.disarm)
        progress.stage("upload", 100)
        steps.do(
            "upload",
            lambda: modulator.upload(self._plan.sequence, lambda share: progress.step(round(100 * share))),
        )
        steps.do("sensor on", sensor.start, sensor.stop)

    def _begin_with(self, mask: int) -> None:
        """Have the modulator begin with a mask; the upload put them on it in their order."""
        if mask != self._sequence.first:
            self._trigger = self._next_trigger
            self._sequence = replace(self._sequence, first=mask)
            self._devices.modulator.disarm()
            self._devices.modulator.turn(mask)

    def _fire_with_retries(self) -> None:
        """Serve one start of the modulator; repeat it if frames or the stage's path were bad and the user allows it."""
        attempt, trigger, taken = 1, self._next_trigger, self._taken
        while True:
            try:
                self._fire(attempt)
                return
            except (FrameError, PathError) as error:
                error.at_trigger(self._trigger)
                # A burst of which some shots are already delivered is not repeated.
                if attempt > self._plan.settings.retries or self._taken != taken:
                    raise
                self._devices.sensor.incidents.append(f"{error}; tried again")
                attempt, self._next_trigger = attempt + 1, trigger
                self._rest_for_retry()

    def _rest_for_retry(self) -> None:
        """Stop all devices before another attempt; upload again only if the device lost the sequence."""
        devices = self._devices
        devices.modulator.disarm()
        if devices.stage is not None:
            devices.stage.stop()
        devices.sensor.stop()
        if devices.modulator.loaded is None:
            devices.modulator.upload(self._sequence)
        devices.sensor.start()

    def _fire(self, attempt: int) -> None:
        devices, burst = self._devices, self._plan.settings.burst
        fire = Fire()
        self._trigger = self._next_trigger
        self._start_motion_after_arming()
        fire.fired_ns = round(devices.clock.now_s() * 1e9)
        devices.modulator.start()
        if self._watch is not None:
            self._watch.look()
        if self._plan.settings.continuous:
            self._stream(fire)
            return
        for shot in range(burst):
            first_trigger = self._next_trigger
            frames = tuple(self._collect(fire, attempt, last=shot == burst - 1))
            if shot == burst - 1:
                self._settle(fire, frames[-1])
            self._deliver_shot(fire, shot, first_trigger, frames, attempt)

    def _stream(self, fire: Fire) -> None:
        """Take the exposures of one long run; lost and corrupt ones are named and skipped, unless all of them are."""
        shots, shot = self._plan.settings.shots, 0
        last: Frame | None = None
        missed: FrameError | None = None
        while shot < shots:
            first_trigger = self._next_trigger
            try:
                frames = tuple(self._collect(fire, 1, last=shot == shots - 1))
            except (FrameLostError, FrameCorruptError) as error:
                skipped = error.lost if isinstance(error, FrameLostError) else 1
                self._devices.sensor.incidents.append(f"{error.at_trigger(first_trigger)}; skipped")
                fire.frames += skipped
                self._next_trigger += skipped
                shot += skipped
                last, missed = None, error
                continue
            self._deliver_shot(fire, shot, first_trigger, frames, 1)
            shot, last = shot + 1, frames[-1]
        if missed is not None and not self._taken:
            raise missed
        self._settle(fire, last)

    def _start_motion_after_arming(self) -> None:
        """Arm, then begin the sweep and wait until the stage reaches the part of constant speed."""
        watch, clock = self._watch, self._devices.clock
        if watch is not None:
            watch.prepare()
        self._devices.modulator.arm()
        self._devices.sensor.discard()
        if watch is not None and self._plan.sweep is not None:
            ramp_s = watch.begin()
            # The constant part begins before the travel, by the longest start; the modulator takes only `_lead_s`.
            longest_s = self._devices.modulator.info.start_latency_s or 0.0
            clock.sleep_s(ramp_s + max(longest_s - self._lead_s, 0.0))

    def _collect(self, fire: Fire, attempt: int, *, last: bool) -> Iterator[Frame]:
        """Read the frames of one shot and compare each with its trigger.

        Before the last frame of a fire is read, the modulator is polled to its end: an early stop could not be
        noticed afterwards, and the frame waits in its buffer meanwhile.
        """
        plan, sensor = self._plan, self._devices.sensor
        latency_s = self._devices.modulator.info.start_latency_s or 0.0
        timeout_s = latency_s + plan.frame_period_s + plan.exposure_s + sensor.settings.readout_s + FRAME_PATIENCE_S
        for i in range(plan.frames_per_shot):
            self._trigger = self._next_trigger
            ends = last and i == plan.frames_per_shot - 1
            self._show_masks(fire, ends=ends)
            early: Frame | None = None
            if ends:
                watch = self._watch
                early = self._read_early(fire)
                meanwhile = None if watch is None else watch.look_until
                self._devices.modulator.wait_done(plan.sequence.duration_s + PATIENCE_S, meanwhile)
                fire.done_s = self._devices.clock.now_s()
                if watch is not None:
                    watch.look()
            frame = early or self._read(fire, timeout_s)
            self._timing.check(fire, frame)
            self._next_trigger += 1
            yield replace(frame, flags=frame.flags | FrameFlag.RETRIED) if attempt > 1 else frame

    def _read(self, fire: Fire, timeout_s: float) -> Frame:
        not_before_ns = fire.fired_ns - STALE_MARGIN_NS
        return self._devices.sensor.read(timeout_s, not_before_ns=not_before_ns, trigger_index=self._trigger)

    def _read_early(self, fire: Fire) -> Frame | None:
        """Look for a frame shortly before its exposure can have ended; one that is there was exposed too shortly.

        The time at which a frame is read would not show that: the last one waits until the modulator has ended.
        """
        clock, modulator = self._devices.clock, self._devices.modulator
        until_s = self._timing.earliest_s(fire) - 2 * END_TOLERANCE_S
        if clock.now_s() >= until_s:
            return None
        while until_s - clock.now_s() > POLL_S:  # a look at the modulator takes time, too
            if modulator.status().state is not ModulatorState.RUNNING:
                return None  # it has stopped early, which is found when its end is waited for
            next_s = min(until_s, clock.now_s() + POLL_S)
            if self._watch is not None:
                self._watch.look_until(next_s)
            clock.sleep_s(next_s - clock.now_s())
        clock.sleep_s(until_s - clock.now_s())
        try:
            return self._read(fire, 0.0)
        except TriggerTimeoutError:
            return None

    def _show_masks(self, fire: Fire, *, ends: bool) -> None:
        """Wait for the end of the present exposure and read positions meanwhile, unless the sequence ends with it.

        On a panel whose masks the host steps, show them, and read positions between two masks if there is time enough.
        """
        modulator, plan, watch = self._devices.modulator, self._plan, self._watch
        shot, within = divmod(fire.frames, plan.frames_per_shot)
        one_mask = plan.settings.mode is Mode.PER_MASK
        windows_s = plan.sequence.windows_s()
        ends_s = [plan.sequence.exposure_s] if one_mask else [float(end_s) for end_s in windows_s[:, 1]]
        begin_s = fire.fired_ns * 1e-9 + shot * plan.sequence.period_s + within * plan.frame_period_s
        if modulator.info.hardware_timed:
            if watch is not None and not ends:
                watch.look_until(begin_s + ends_s[-1])
            return
        spare_s = WATCHED_SHARE * plan.sequence.exposure_s
        for end_s in ends_s:
            modulator.keep_time(begin_s + end_s)
            if watch is not None and watch.exchange_s < spare_s:
                watch.look()

    def _settle(self, fire: Fire, last: Frame | None) -> None:
        """Wait until all devices have finished; check that the last frame was in time and that none is left over."""
        devices, plan = self._devices, self._plan
        arrived_s = devices.clock.now_s()
        if last is not None:
            self._timing.check_end(fire, last)
        if self._watch is not None:
            self._watch.settle()
        # The frame of a doubled trigger arrives one exposure and one readout after the regular one.
        waited_s = devices.clock.now_s() - arrived_s
        devices.clock.sleep_s(1.1 * (plan.exposure_s + devices.sensor.settings.readout_s) - waited_s)
        extra = devices.sensor.discard()
        if extra:
            raise ExtraFrameError(
                devices.sensor.name,
                f"{extra} more frame(s) than the {fire.frames} triggers sent",
                remedy="look for reflections on the trigger line or a second source of triggers",
            )

    def _deliver_shot(self, fire: Fire, shot: int, first_trigger: int, frames: tuple[Frame, ...], attempt: int) -> None:
        stage_mm, target_mm = self._stage_at_masks(fire, shot, frames)
        self._sink(
            Taken(
                index=self._taken,
                frames=frames,
                trigger_index=first_trigger,
                mask_order=self._sequence.order,
                stage_mm=stage_mm,
                stage_target_mm=target_mm,
                stage_error_mm=None if self._watch is None else self._watch.error_mm,
                attempts=attempt,
                incidents=tuple(self._devices.incidents()),
            )
        )
        self._taken += 1
        self._progress.step(self._taken)

    def _stage_at_masks(self, fire: Fire, shot: int, frames: tuple[Frame, ...]) -> tuple[F64 | None, F64 | None]:
        """Return the stage's position at each mask's central time, and its target, [N, K] in mm.

        Raises:
            PathError: The stage did not follow its path.
        """
        watch = self._watch
        if watch is None:
            return None, None
        watch.require_undisturbed()
        stamped = frames[0].flags & FrameFlag.STAMPED_MONOTONIC
        unsure_s = 0.0 if stamped else self._devices.modulator.info.start_latency_s or 0.0
        measured, target = watch.at_masks(self._first_mask_s(fire, shot, frames[0]), self._seen_s(), shot, unsure_s)
        if shot == 0:
            self._lead_s = watch.lead_s(self._lead_s, measured, target)
        return measured, target

    def _seen_s(self) -> F64:
        """Return the interval in which each mask was shown and exposed, [N, 2], from the appearance of the first."""
        windows_s, asked = self._plan.sequence.windows_s(), self._plan.settings
        if asked.late_s is None or asked.mode is not Mode.PER_EXPOSURE:
            return windows_s
        modulator, sensor = self._devices.modulator.info, self._devices.sensor.settings
        begin_s = asked.begin_s(modulator.delay_s(self._plan.sequence.trigger), sensor.trigger_delay_s)
        seen_s = np.clip(windows_s, begin_s, begin_s + self._plan.exposure_s + asked.longer_s)
        return np.where(seen_s[:, 1:] > seen_s[:, :1], seen_s, windows_s)

    def _first_mask_s(self, fire: Fire, shot: int, frame: Frame) -> float:
        """Return when a shot's first mask appeared, on the devices' clock."""
        modulator, settings = self._devices.modulator.info, self._devices.sensor.settings
        if not frame.flags & FrameFlag.STAMPED_MONOTONIC:
            return fire.fired_ns * 1e-9 + (modulator.start_latency_s or 0.0) / 2 + shot * self._plan.sequence.period_s
        asked = self._plan.settings
        began_s = frame.began_s(self._plan.exposure_s + asked.longer_s, settings.readout_s)
        return began_s - asked.begin_s(modulator.delay_s(self._plan.sequence.trigger), settings.trigger_delay_s)
