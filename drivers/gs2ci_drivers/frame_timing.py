"""Comparing frames with the triggers that they answer, by their time stamps.

Here: what is recorded while one start of the modulator is served (`Fire`), and the checks. Not here: the capture
(`acquisition.py`), checks of a frame by itself (`frame_checks.py`).
"""

from dataclasses import dataclass, field

from gs2ci_drivers.failures import ExposureError, ExtraFrameError, SequenceError, TriggerTimeoutError
from gs2ci_drivers.modulator import Modulator
from gs2ci_drivers.plan import CapturePlan, Mode
from gs2ci_drivers.sensor import Frame, FrameFlag, Sensor

END_TOLERANCE_S = 2e-3
CLOCK_TOLERANCE = 1e-3
"""By how much a time by the modulator's clock and by the computer's may differ, jitter of one exchange included."""
PERIOD_TOLERANCE = 0.25
"""Share of the period by which a frame's time stamp may be off before a trigger counts as missed or doubled."""


@dataclass
class Fire:
    """What is recorded while one start of the modulator is served."""

    fired_ns: int = 0
    rest_mm: dict[str, float] = field(default_factory=dict)
    crossed_s: float = 0.0
    position_error_mm: float = 0.0
    reference_ns: int = 0
    """Stamp of the frame that the others are compared with."""
    reference_index: int = 0
    done_s: float = 0.0
    frames: int = 0


class FrameTiming:
    """Checks the frames of a capture against its plan.

    Args:
        plan: The capture.
        sensor: The sensor that took the frames, set up for the capture.
        modulator: The modulator that sends the triggers.
    """

    def __init__(self, plan: CapturePlan, sensor: Sensor, modulator: Modulator) -> None:
        self._plan = plan
        self._sensor = sensor
        self._modulator = modulator

    def check(self, fire: Fire, frame: Frame) -> None:
        """Check by its time stamp that a frame answers the trigger it is counted for, and count it.

        Raises:
            TriggerTimeoutError: It is late by more than a quarter of the period: a trigger was missed.
            ExtraFrameError: It is early by more than that: a trigger was doubled, or the line has the wrong polarity.
            ExposureError: It arrived before an exposure of the stated length could have ended.
        """
        index = fire.frames
        fire.frames += 1
        self._check_stamp(fire, frame, index)
        self._check_length(fire, frame, index)

    def _check_stamp(self, fire: Fire, frame: Frame, index: int) -> None:
        """Compare a frame's stamp with the start of the modulator, then with the frames before."""
        plan = self._plan
        if index == 0:
            self._check_start(fire, frame)
        if not fire.reference_ns or not frame.flags & FrameFlag.STAMPED_MONOTONIC:
            fire.reference_ns, fire.reference_index = frame.t_kernel_ns, index
            return
        expected_s = self._due_s(index) - self._due_s(fire.reference_index)
        late_s = (frame.t_kernel_ns - fire.reference_ns) * 1e-9 - expected_s
        if plan.settings.continuous:  # over minutes, two clocks drift apart by more than the tolerance
            fire.reference_ns, fire.reference_index = frame.t_kernel_ns, index
        if late_s > PERIOD_TOLERANCE * plan.frame_period_s:
            raise TriggerTimeoutError(self._sensor.name, index, late_s)
        if late_s < -PERIOD_TOLERANCE * plan.frame_period_s:
            raise ExtraFrameError(
                self._sensor.name,
                f"frame {index} came {-late_s:.3g} s before its trigger could",
                remedy="look for reflections on the trigger line or a second source of triggers",
            )

    def _check_length(self, fire: Fire, frame: Frame, index: int) -> None:
        """Check that the frame arrived no earlier than its exposure could have ended, whatever its stamp means.

        A camera that counts exposure in another unit than assumed exposes for a tenth of the time and looks normal.
        """
        if not frame.flags & FrameFlag.STAMPED_MONOTONIC:
            return  # the time of its arrival may be of another clock, too
        short_s = self._end_s(fire, index) - frame.t_host_ns * 1e-9
        if short_s > END_TOLERANCE_S:
            exposed_s = max(self._plan.exposure_s - short_s, 0.0)
            raise ExposureError(self._sensor.name, index, self._plan.exposure_s, exposed_s)

    def earliest_s(self, fire: Fire) -> float:
        """Return when the exposure of the next frame can have ended, at the earliest, on the computer's clock."""
        return self._end_s(fire, fire.frames)

    def _end_s(self, fire: Fire, index: int) -> float:
        return fire.fired_ns * 1e-9 + (self._due_s(index) + self._plan.exposure_s) * (1 - CLOCK_TOLERANCE)

    def _due_s(self, index: int) -> float:
        """Return when the trigger of a frame is due, from the first one of its fire."""
        shot, within = divmod(index, self._plan.frames_per_shot)
        return shot * self._plan.sequence.period_s + within * self._plan.frame_period_s

    def _check_start(self, fire: Fire, frame: Frame) -> None:
        """Check that the first exposure did not begin before the modulator was started.

        A sensor that is gated by a line of the wrong polarity exposes until the masks appear.
        """
        if not frame.flags & FrameFlag.STAMPED_MONOTONIC:
            return
        began_s = frame.began_s(self._plan.exposure_s, self._sensor.settings.readout_s)
        early_s = fire.fired_ns * 1e-9 - began_s
        if early_s > END_TOLERANCE_S:
            raise ExtraFrameError(
                self._sensor.name,
                f"the exposure of the first frame began {early_s:.3g} s before the modulator was started",
                remedy="check the polarity of the trigger line, what time stamps mean, and whether the sensor counts "
                "exposure in another unit: `gs2ci doctor` does all three",
            )

    def check_end(self, fire: Fire, last: Frame) -> None:
        """Check that the last exposure began early enough for all of its masks.

        If a trigger comes with a later mask than it should (the trigger setting's polarity on the modulator is not the
        configured one), its frame looks normal, but the sequence ends before the frame's last mask is due.

        Raises:
            SequenceError: It began too late.
        """
        plan, readout_s = self._plan, self._sensor.settings.readout_s
        if not last.flags & FrameFlag.STAMPED_MONOTONIC:
            return  # a time of another clock
        # A stamp of a frame's end is late by its transfer, for which the readout time is the only known estimate.
        late_s = 0.0 if last.flags & (FrameFlag.STAMPED_AT_START | FrameFlag.STAMPED_AT_FRAME_START) else readout_s
        one_mask = plan.settings.mode is Mode.PER_MASK
        shown_s = plan.sequence.exposure_s if one_mask else float(plan.sequence.windows_s()[-1, 1])
        delay_s = self._modulator.info.delay_s(plan.sequence.trigger)
        appeared_s = last.began_s(plan.exposure_s, readout_s) - delay_s - self._sensor.settings.trigger_delay_s
        short_s = appeared_s + shown_s - fire.done_s
        if short_s > late_s + END_TOLERANCE_S + CLOCK_TOLERANCE * plan.sequence.duration_s:
            raise SequenceError(
                self._modulator.name,
                "fire",
                [f"the sequence ended {short_s:.3g} s before the masks of its last trigger could have been shown"],
                remedy="the trigger came with a later mask: check the firmware profile and the trigger's polarity",
            )
