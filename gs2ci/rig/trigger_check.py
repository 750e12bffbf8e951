"""Tests of the trigger line: which masks send pulses, how the sensor reacts, and what its time stamps mean.

A short sequence is shown twice, once with only its first mask open and once with all the others: the number of frames
shows how the modulator interprets its settings, and their brightness shows with which mask each frame began. Then
frames of two exposure times show which event a time stamp marks.

A run without a trigger shows whether the sensor waits for one, and the growth of the frames' arrival with the exposure
in which unit the sensor counts it.

Here: the experiments and their evaluation. Not here: messages and remedies (`doctor`), the meaning of a pulse count for
a modulator (`Modulator.interpret_pulses`). No capture plan is needed: plans are refused until these results are known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import U8
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.failures import FrameCorruptError, FrameLostError, SequenceError, TriggerTimeoutError
from gs2ci_drivers.modulator import ModulatorState, PulseVerdict
from gs2ci_drivers.pattern_sequence import PatternSequence, TriggerOut
from gs2ci_drivers.sensor import Frame, FrameFlag, SensorConfig, StampMeaning, TriggerMode
from gs2ci_drivers.steps import Steps

MASKS: Final = 4
PASSES: Final = 3
"""With 4 masks in 3 passes each interpretation of a DLPC900's settings gives its own number of pulses: 1, 2, 3, 9, 12
or 36."""
MASK_S: Final = 0.05
PAUSE_S: Final = 0.1
"""Shortest pause between passes for a gated sensor, so that exposures during the pauses are noticed."""
STAMP_MASK_S: Final = 0.25
"""Time of a mask in the test of stamps: long, so that the effect is larger than the host's timing errors of some ms."""
QUIET_S: Final = 0.5
"""How long the sensor is listened to without a trigger: cameras that run freely send frames more often than that."""
ARRIVAL_ERROR_S: Final = 5e-3
"""Uncertainty of the difference of two arrivals, from the computer's delays."""
LOOK_S: Final = 0.1
GLANCE_S: Final = 1e-3
"""Timeout for a frame while the host steps the masks: it must not wait longer."""
PATIENCE_S: Final = 1.0
MOST_FRAMES: Final = 200
"""After this many frames, good or bad, a run ends: a camera that runs freely sends them for ever."""
SURE: Final = 5.0
"""Number of standard errors by which the brightness of two runs must differ for a conclusion."""
LEAST_DN: Final = 0.5
SHORTEST_TOLD_S: Final = 1e-3
"""For a readout shorter than this, start and end of a frame cannot be told apart, because of the computer's delays."""


@dataclass(frozen=True)
class TriggerRun:
    """The frames of one run of a sequence.

    Args:
        frames: The frames received.
        lost: How many more were exposed and lost.
        fired_s: When the modulator was started, on the devices' clock.
        exposure_s: Exposure of each frame.
    """

    frames: tuple[Frame, ...]
    lost: int
    fired_s: float
    exposure_s: float

    @property
    def count(self) -> int:
        """Get how many frames were exposed."""
        return len(self.frames) + self.lost

    @property
    def level_dn(self) -> tuple[float, float]:
        """Get the mean reading over all pixels and its standard error from the frames' scatter, DN."""
        means = np.array([frame.pixels.mean(dtype=np.float64) for frame in self.frames])
        noise = max(float(frame.pixels.std(dtype=np.float64)) / frame.pixels.size**0.5 for frame in self.frames)
        scatter = float(means.std(ddof=1)) if len(means) > 1 else 0.0
        return float(means.mean()), max(scatter, noise) / len(means) ** 0.5


@dataclass(frozen=True)
class PulsesFound:
    """The result of the test of trigger pulses.

    Args:
        verdict: The conclusion from their number.
        by_light: Whether the frames' brightness confirms that conclusion; None if too little light comes through the
            masks.
    """

    verdict: PulseVerdict
    by_light: bool | None


@dataclass(frozen=True)
class GateFound:
    """The result of the test of the gate line.

    Args:
        count: Number of frames from `PASSES` passes.
        by_time: Whether frames end with the masks, rather than with the pauses between passes; None without frames.
        by_light: Whether the frames saw the open masks; None if too little light comes through them to decide.
    """

    count: int
    by_time: bool | None
    by_light: bool | None

    @property
    def right(self) -> bool:
        """Get whether the sensor exposes while the masks are on show, and only then."""
        return self.count == PASSES and self.by_time is True and self.by_light is not False

    @property
    def inverted(self) -> bool:
        """Get whether it exposes while they are not."""
        return self.by_time is False or self.by_light is False


@dataclass(frozen=True)
class StampsFound:
    """The measured meaning of time stamps, and how exposures really grow.

    Args:
        meaning: The event that stamps mark; None if the test cannot decide, for the reason in `why`.
        assumed: The meaning that the present settings assume.
        why: The evidence.
        growth: By how much the frames of the longer exposure arrive later, per second that it is said to be longer;
            None if there is one length of exposure only.
        growth_error: The uncertainty of it, from the computer's delays.
    """

    meaning: StampMeaning | None
    assumed: StampMeaning
    why: str
    growth: float | None = None
    growth_error: float = 0.0


def look(devices: Devices, config: SensorConfig, sequence: PatternSequence) -> TriggerRun:
    """Show a sequence once, whatever pulses it sends, and take all resulting frames.

    Args:
        devices: The rig's devices, connected.
        config: The sensor's set-up, trigger and exposure included.
        sequence: The sequence to show.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    modulator, sensor, clock = devices.modulator, devices.sensor, devices.clock
    setup = sensor.configure(config)
    frames: list[Frame] = []
    bad = 0
    with Steps() as steps:
        steps.do("modulator dark", modulator.disarm, modulator.disarm)
        sequence = modulator.upload(sequence).sequence
        steps.do("sensor on", sensor.start, sensor.stop)
        modulator.arm()
        sensor.discard()
        fired_s = clock.now_s()
        _start(devices)
        ended_s = fired_s + (modulator.info.start_latency_s or 0.0) + sequence.duration_s
        patience_s = setup.exposure_s + setup.readout_s + PATIENCE_S
        while len(frames) + bad < MOST_FRAMES:
            try:
                if not modulator.info.hardware_timed:
                    modulator.keep_time(clock.now_s() + LOOK_S)
                frames.append(sensor.read(LOOK_S if modulator.info.hardware_timed else GLANCE_S))
            except TriggerTimeoutError:
                # A controller that interprets its count differently may run several times as long as planned.
                if modulator.status().state is ModulatorState.RUNNING:
                    ended_s = clock.now_s()
                elif clock.now_s() > ended_s + patience_s:
                    break
            except (FrameLostError, FrameCorruptError):
                bad += 1
        status = sensor.status()
    return TriggerRun(tuple(frames), status.lost + status.corrupt, fired_s, setup.exposure_s)


def _start(devices: Devices) -> None:
    """Start; a sequence that has already ended at the first poll was shorter than planned, as its frames will show."""
    try:
        devices.modulator.start()
    except SequenceError as error:
        devices.modulator.incidents.append(str(error))


def check_pulses(devices: Devices, config: SensorConfig) -> PulsesFound:
    """Find out with which masks the modulator pulses, by the number of frames and by their light.

    Args:
        devices: The rig's devices, connected; the sensor takes an edge.
        config: The sensor's set-up; trigger and exposure are filled in.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    first = np.zeros(MASKS, np.uint8)
    first[0] = 1
    mask_s, exposure_s = _times(devices)
    config = replace(config, trigger=TriggerMode.EDGE, exposure_s=exposure_s)
    looks = [
        look(devices, config, _sequence(devices, is_open, mask_s, TriggerOut.PER_EXPOSURE, PASSES))
        for is_open in (first, 1 - first)
    ]
    verdict = devices.modulator.interpret_pulses(looks[0].count)
    if looks[0].count != looks[1].count:
        said = f"{looks[0].count} and then {looks[1].count} pulses were seen in two runs of the same length"
        verdict = PulseVerdict(False, said, "check the trigger cable and its shield, and the sensor's trigger")
    return PulsesFound(verdict, _with_the_first(looks, verdict))


def _with_the_first(looks: Sequence[TriggerRun], verdict: PulseVerdict) -> bool | None:
    """Return whether brightness confirms the count: frames that begin with the first mask see only that mask."""
    brighter = _brighter(looks)
    return None if brighter is None else brighter is not verdict.inverted


def _brighter(looks: Sequence[TriggerRun]) -> bool | None:
    """Return whether the first of two runs is brighter; None if they hardly differ, or one has no frames."""
    if not all(one.frames for one in looks):
        return None
    (first, error), (second, other_error) = (one.level_dn for one in looks)
    sure = abs(first - second) >= max(SURE * float(np.hypot(error, other_error)), LEAST_DN)
    return first > second if sure else None


def check_gate(devices: Devices, config: SensorConfig) -> GateFound:
    """Find out whether a gated sensor exposes while masks are shown or in the pauses, by time and by brightness.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    mask_s, _ = _times(devices)
    pause_s = devices.modulator.info.at_least_s(max(2 * mask_s, 2 * PAUSE_S))
    config = replace(config, trigger=TriggerMode.LEVEL, exposure_s=MASKS * mask_s)
    opened = np.ones(MASKS, np.uint8)
    looks = [
        look(devices, config, replace(_sequence(devices, is_open, mask_s, TriggerOut.GATE, PASSES), pause_s=pause_s))
        for is_open in (opened, 0 * opened)
    ]
    by_time = None
    if looks[0].frames:
        # The last frame comes when the last pass ends, or, with the wrong polarity, when it begins.
        due_s = looks[0].fired_s + PASSES * (MASKS * mask_s + pause_s) - pause_s
        by_time = looks[0].frames[-1].t_host_ns * 1e-9 > due_s - MASKS * mask_s / 2
    return GateFound(looks[0].count, by_time, _brighter(looks) or None)


def check_waiting(devices: Devices, config: SensorConfig, trigger: TriggerMode) -> int:
    """Return how many frames come while no trigger is sent: none, if the sensor waits for one.

    Args:
        devices: The rig's devices, connected.
        config: The sensor's set-up; trigger and exposure are filled in.
        trigger: What is to begin an exposure.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    modulator, sensor, clock = devices.modulator, devices.sensor, devices.clock
    _, exposure_s = _times(devices)
    setup = sensor.configure(replace(config, trigger=trigger, exposure_s=exposure_s))
    came = 0
    with Steps() as steps:
        steps.do("modulator dark", modulator.disarm, modulator.disarm)
        steps.do("sensor on", sensor.start, sensor.stop)
        until_s = clock.now_s() + QUIET_S + setup.exposure_s + setup.readout_s
        while clock.now_s() < until_s and came < MOST_FRAMES:
            try:
                sensor.read(LOOK_S)
            except TriggerTimeoutError:
                continue
            except (FrameLostError, FrameCorruptError):
                pass
            came += 1
    return came


def check_stamps(devices: Devices, config: SensorConfig, *, gated: bool) -> StampsFound:
    """Find out which event the sensor's time stamps mark, by exposures of two lengths.

    A stamp of the start of exposure does not change with the exposure time, the others become later by the difference.
    A frame's end is stamped when it arrives, its start one readout time earlier.

    Args:
        devices: The rig's devices, connected.
        config: The sensor's set-up; trigger and exposure are filled in.
        gated: Whether the sensor exposes while its line is held; masks then last as long as exposures.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    mask_s, shortest_s = _times(devices)
    mask_s = devices.modulator.info.at_least_s(max(mask_s, STAMP_MASK_S))
    info = devices.sensor.info
    lengths_s = (shortest_s, min(0.6 * mask_s, info.max_exposure_s))
    looks = []
    for exposure_s in lengths_s:
        trigger = TriggerMode.LEVEL if gated else TriggerMode.EDGE
        if gated:
            sequence = _sequence(devices, _OPEN, exposure_s, TriggerOut.GATE_PER_MASK, 1)
            sequence = replace(sequence, dark_s=mask_s)
        else:
            sequence = _sequence(devices, _OPEN, mask_s, TriggerOut.PER_MASK, 1)
        looks.append(look(devices, replace(config, trigger=trigger, exposure_s=exposure_s), sequence))
    if not all(one.frames for one in looks):
        return StampsFound(None, StampMeaning.END_OF_FRAME, "no frame came")
    return _meaning(looks, devices.sensor.settings.readout_s)


def _meaning(looks: Sequence[TriggerRun], readout_s: float) -> StampsFound:
    frame = looks[0].frames[0]
    assumed = next(one for one in StampMeaning if frame.flags & _STAMPS == one.flag)
    if not frame.flags & FrameFlag.STAMPED_MONOTONIC:
        return StampsFound(None, assumed, "the stamps count on a clock of unknown origin")
    shorter_s, longer_s = (one.frames[0].t_kernel_ns * 1e-9 - one.fired_s for one in looks)
    grown_s = looks[1].exposure_s - looks[0].exposure_s
    if grown_s < 2 * LOOK_S / 10:
        return StampsFound(None, assumed, "the sensor has one length of exposure only")
    later_s = (looks[1].frames[0].t_host_ns - looks[0].frames[0].t_host_ns) * 1e-9 - looks[1].fired_s + looks[0].fired_s
    growth = {"growth": later_s / grown_s, "growth_error": ARRIVAL_ERROR_S / grown_s}
    why = f"exposures {grown_s * 1e3:.0f} ms longer are stamped {(longer_s - shorter_s) * 1e3:.0f} ms later"
    if later_s < 2 * ARRIVAL_ERROR_S:
        return StampsFound(None, assumed, f"{why}, and arrive {later_s * 1e3:.0f} ms later", **growth)
    if longer_s - shorter_s < later_s / 2:
        return StampsFound(StampMeaning.START_OF_EXPOSURE, assumed, why, **growth)
    arrival_s = float(np.median([one.t_host_ns - one.t_kernel_ns for part in looks for one in part.frames])) * 1e-9
    why += f", and frames arrive {arrival_s * 1e3:.1f} ms after their stamp with a readout of {readout_s * 1e3:.1f} ms"
    if readout_s < SHORTEST_TOLD_S and assumed is not StampMeaning.START_OF_EXPOSURE:
        return StampsFound(assumed, assumed, why, **growth)
    meaning = StampMeaning.START_OF_FRAME if arrival_s > readout_s / 2 else StampMeaning.END_OF_FRAME
    return StampsFound(meaning, assumed, why, **growth)


_OPEN: Final = np.ones(2, np.uint8)
_STAMPS: Final = FrameFlag.STAMPED_AT_START | FrameFlag.STAMPED_AT_FRAME_START


def _times(devices: Devices) -> tuple[float, float]:
    """Return a time per mask that is long enough for a frame of each mask, and a short exposure."""
    modulator, sensor = devices.modulator.info, devices.sensor.info
    shortest_s = modulator.min_exposure_s[min(modulator.min_exposure_s)]
    exposure_s = min(max(MASK_S / 10, sensor.min_exposure_s, 2 * shortest_s), sensor.max_exposure_s)
    return modulator.at_least_s(max(MASK_S, 4 * exposure_s)), exposure_s


def _sequence(devices: Devices, is_open: U8, mask_s: float, trigger: TriggerOut, passes: int) -> PatternSequence:
    info = devices.modulator.info
    bits = min(info.min_exposure_s)
    masks = np.zeros((len(is_open), info.height, info.width), np.uint8)
    masks[is_open > 0] = 2**bits - 1
    return PatternSequence(masks, bits, mask_s, repeats=passes, trigger=trigger)
