"""The trigger line by experiment: which masks pulse, what the sensor makes of it, and what its time stamps mean.

A short sequence is shown twice, once with only its first mask open and once with all others: how many frames come says
how the modulator reads its settings, and their light says with which mask each began. Then frames of two lengths of
exposure say what a time stamp is the time of.

Here: the experiments and what they say. Not here: words and remedies (`doctor`), what a count of pulses means for a
modulator (`Modulator.judge_pulses`). Nothing here needs a plan: plans are refused until these are known.
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
"""With 4 masks in 3 passes every reading of a DLPC900's settings gives another number of pulses: 1, 2, 3, 9, 12, 36."""
MASK_S: Final = 0.05
PAUSE_S: Final = 0.1
"""Between passes for a gated sensor, at least: a sensor that exposes in them is noticed."""
STAMP_MASK_S: Final = 0.25
"""Long masks for the stamps: what is looked for must stand out of the host's milliseconds."""
LOOK_S: Final = 0.1
GLANCE_S: Final = 1e-3
"""While the host steps the masks it has no time to wait for frames."""
PATIENCE_S: Final = 1.0
MOST_FRAMES: Final = 200
SURE: Final = 5.0
"""Standard errors by which the light of two looks must differ to say something."""
LEAST_DN: Final = 0.5
SHORTEST_TOLD_S: Final = 1e-3
"""A readout shorter than this hides behind the computer's delays: begin and end of a frame are then the same."""


@dataclass(frozen=True)
class TriggerRun:
    """What one run of a sequence brought.

    Args:
        frames: The frames that came.
        lost: How many more had been exposed.
        fired_s: When the modulator was told to start, on the devices' clock.
        ended_s: When it had come to rest, at the latest.
        exposure_s: Of each frame.
    """

    frames: tuple[Frame, ...]
    lost: int
    fired_s: float
    ended_s: float
    exposure_s: float

    @property
    def count(self) -> int:
        """Get how many frames were exposed."""
        return len(self.frames) + self.lost

    @property
    def level_dn(self) -> tuple[float, float]:
        """Get the mean reading over all pixels and its standard error by the frames' scatter, DN."""
        means = np.array([frame.pixels.mean(dtype=np.float64) for frame in self.frames])
        noise = max(float(frame.pixels.std(dtype=np.float64)) / frame.pixels.size**0.5 for frame in self.frames)
        scatter = float(means.std(ddof=1)) if len(means) > 1 else 0.0
        return float(means.mean()), max(scatter, noise) / len(means) ** 0.5


@dataclass(frozen=True)
class PulsesFound:
    """What the trigger pulses are like.

    Args:
        verdict: By their number.
        by_light: Whether pulses come with the masks that the settings say, as far as light tells: None where too
            little of it comes through the masks.
    """

    verdict: PulseVerdict
    by_light: bool | None


@dataclass(frozen=True)
class GateFound:
    """What the gate line is like.

    Args:
        count: Frames that came of `PASSES` passes.
        by_time: Whether frames end with the masks, rather than with the pauses between passes; None without frames.
        by_light: Whether their light is that of the masks; None where too little light comes through them to say.
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
    """What time stamps mean, by measuring.

    Args:
        meaning: It; None where nothing can be said, for the reason in `why`.
        assumed: What frames are taken to mean now.
        why: How that was seen.
    """

    meaning: StampMeaning | None
    assumed: StampMeaning
    why: str


def look(devices: Devices, config: SensorConfig, sequence: PatternSequence) -> TriggerRun:
    """Show a sequence once, whatever pulses it sends, and take all frames that come of it.

    Args:
        devices: The rig's devices, connected.
        config: The sensor's set-up, trigger and exposure included.
        sequence: What to show.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    modulator, sensor, clock = devices.modulator, devices.sensor, devices.clock
    setup = sensor.configure(config)
    frames: list[Frame] = []
    with Steps() as steps:
        steps.do("modulator dark", modulator.disarm, modulator.disarm)
        modulator.upload(sequence)
        steps.do("sensor on", sensor.start, sensor.stop)
        modulator.arm()
        sensor.discard()
        fired_s = clock.now_s()
        _start(devices)
        ended_s = fired_s + (modulator.info.start_latency_s or 0.0) + sequence.duration_s
        patience_s = setup.exposure_s + setup.readout_s + PATIENCE_S
        while len(frames) < MOST_FRAMES:
            try:
                if not modulator.info.hardware_timed:
                    modulator.keep_time(clock.now_s() + LOOK_S)
                frames.append(sensor.read(LOOK_S if modulator.info.hardware_timed else GLANCE_S))
            except TriggerTimeoutError:
                # A controller that reads its count otherwise may run several times as long as it was meant to.
                if modulator.status().state is ModulatorState.RUNNING:
                    ended_s = clock.now_s()
                elif clock.now_s() > ended_s + patience_s:
                    break
            except (FrameLostError, FrameCorruptError):
                continue
        status = sensor.status()
    return TriggerRun(tuple(frames), status.lost + status.corrupt, fired_s, ended_s, setup.exposure_s)


def _start(devices: Devices) -> None:
    """Start; a sequence that is over at the first look was shorter than stated, which its frames will tell."""
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
    verdict = devices.modulator.judge_pulses(looks[0].count)
    if looks[0].count != looks[1].count:
        said = f"{looks[0].count} and then {looks[1].count} pulses were seen in two runs of the same length"
        verdict = PulseVerdict(False, said, "check the trigger cable and its shield, and the sensor's trigger")
    return PulsesFound(verdict, _with_the_first(looks, verdict))


def _with_the_first(looks: Sequence[TriggerRun], verdict: PulseVerdict) -> bool | None:
    """Return whether light says the same as the number: frames that begin with the first mask see it and no other."""
    if not all(one.frames for one in looks):
        return None
    (with_first, error), (without, other_error) = (one.level_dn for one in looks)
    difference = with_first - without
    if abs(difference) < max(SURE * float(np.hypot(error, other_error)), LEAST_DN):
        return None
    return (difference > 0) is not verdict.inverted


def check_gate(devices: Devices, config: SensorConfig) -> GateFound:
    """Find out whether a gated sensor exposes while masks are on show or while they are not, by time and by light.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    mask_s, _ = _times(devices)
    pause_s = max(2 * mask_s, 2 * PAUSE_S)
    config = replace(config, trigger=TriggerMode.LEVEL, exposure_s=MASKS * mask_s)
    opened = np.ones(MASKS, np.uint8)
    looks = [
        look(devices, config, replace(_sequence(devices, is_open, mask_s, TriggerOut.GATE, PASSES), pause_s=pause_s))
        for is_open in (opened, 0 * opened)
    ]
    by_time = None
    if looks[0].frames:
        # The last frame comes when the last masks have ended, or as long before as they are on show.
        due_s = looks[0].fired_s + PASSES * (MASKS * mask_s + pause_s) - pause_s
        by_time = looks[0].frames[-1].t_host_ns * 1e-9 > due_s - MASKS * mask_s / 2
    by_light = None
    if all(one.frames for one in looks):
        (level, error), (dark, dark_error) = (one.level_dn for one in looks)
        by_light = True if level - dark > max(SURE * float(np.hypot(error, dark_error)), LEAST_DN) else None
    return GateFound(looks[0].count, by_time, by_light)


def check_stamps(devices: Devices, config: SensorConfig, *, gated: bool) -> StampsFound:
    """Find out what the sensor's time stamps are the time of, by exposures of two lengths.

    The stamp of a start of exposure does not move when the exposure grows, the others move with it; and a frame's end
    is stamped when it arrives, its begin one readout earlier.

    Args:
        devices: The rig's devices, connected.
        config: The sensor's set-up; trigger and exposure are filled in.
        gated: Whether the sensor exposes while its line is held; masks then last as long as exposures.

    Raises:
        DriverError: A device failed; all are at rest.
    """
    mask_s, shortest_s = _times(devices)
    mask_s = max(mask_s, STAMP_MASK_S)
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
    why = f"exposures {grown_s * 1e3:.0f} ms longer are stamped {(longer_s - shorter_s) * 1e3:.0f} ms later"
    if longer_s - shorter_s < grown_s / 2:
        return StampsFound(StampMeaning.START_OF_EXPOSURE, assumed, why)
    arrival_s = float(np.median([one.t_host_ns - one.t_kernel_ns for part in looks for one in part.frames])) * 1e-9
    why += f", and frames arrive {arrival_s * 1e3:.1f} ms after their stamp with a readout of {readout_s * 1e3:.1f} ms"
    if readout_s < SHORTEST_TOLD_S and assumed is not StampMeaning.START_OF_EXPOSURE:
        return StampsFound(assumed, assumed, why)
    meaning = StampMeaning.START_OF_FRAME if arrival_s > readout_s / 2 else StampMeaning.END_OF_FRAME
    return StampsFound(meaning, assumed, why)


_OPEN: Final = np.ones(2, np.uint8)
_STAMPS: Final = FrameFlag.STAMPED_AT_START | FrameFlag.STAMPED_AT_FRAME_START


def _times(devices: Devices) -> tuple[float, float]:
    """Return a time per mask that leaves room for a frame of each, and a short exposure."""
    modulator, sensor = devices.modulator.info, devices.sensor.info
    shortest_s = modulator.min_exposure_s[min(modulator.min_exposure_s)]
    exposure_s = min(max(MASK_S / 10, sensor.min_exposure_s, 2 * shortest_s), sensor.max_exposure_s)
    return max(MASK_S, 4 * exposure_s), exposure_s


def _sequence(devices: Devices, is_open: U8, mask_s: float, trigger: TriggerOut, passes: int) -> PatternSequence:
    info = devices.modulator.info
    bits = min(info.min_exposure_s)
    masks = np.zeros((len(is_open), info.height, info.width), np.uint8)
    masks[is_open > 0] = 2**bits - 1
    return PatternSequence(masks, bits, mask_s, repeats=passes, trigger=trigger)
