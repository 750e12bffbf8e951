"""The mask modulator's interface: what a DMD, an LCoS or a moving mask has in common.

The public methods check and keep the order of calls; a driver writes only the private `_do_*` hooks. The order:

    connect → upload → (turn) → arm → start → wait_done → disarm → close

Promises that every implementation keeps and `tests/contracts/test_modulator.py` tests: connecting changes
nothing on the device; `disarm` may be called in any state and more than once; `close` may be called twice; every
wait has a deadline on the driver's clock; a failed call leaves a state from which `disarm` and `upload` work.

Here: the abstract class, its states and reports. Not here: the sequence to be shown (`gs2ci_drivers.pattern_sequence`),
bytes (each driver's package), how shots are put together (`gs2ci_drivers.acquisition`).
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from gs2ci.core.clock import Clock
from gs2ci_drivers.device import Device
from gs2ci_drivers.failures import NoAnswerError, WrongStateError
from gs2ci_drivers.pattern_sequence import ModulatorInfo, PatternSequence, check_sequence

POLL_S = 0.02
"""Interval of polling whether a device still runs: long compared with one exchange, too short for people to notice."""
FINE_POLL_S = 1e-3
"""Interval near the expected end: a capture compares the time of the end with the last frame's, to within a mask."""
UploadProgress = Callable[[float], None]
"""Called with the share of the upload that is done, 0 to 1."""


class ModulatorState(Enum):
    """The state of a modulator."""

    IDLE = "idle"
    """Connected; no sequence of this session is loaded."""
    LOADED = "loaded"
    """A sequence of this session is on the device."""
    ARMED = "armed"
    """The next `start` begins within `start_latency_s`."""
    RUNNING = "running"
    FAULT = "fault"
    """The device says that it cannot work; see the status' faults."""


@dataclass(frozen=True)
class UploadReport:
    """What an upload did.

    Args:
        sequence: The sequence as the device holds it, with its quantised times.
        payload_bytes: Bytes of pattern data sent.
        seconds: Time it took on the driver's clock.
    """

    sequence: PatternSequence
    payload_bytes: int
    seconds: float


@dataclass(frozen=True)
class ModulatorStatus:
    """What a modulator reports of itself.

    Args:
        state: Its state.
        faults: Faults in the device's own terms, empty when there are none.
        notes: Further readings worth showing (temperatures, registers).
    """

    state: ModulatorState
    faults: tuple[str, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PulseVerdict:
    """The conclusion from a counted number of trigger pulses.

    Args:
        agrees: Whether the number is the expected one and all settings that it depends on are stated in the rig file.
        said: What was seen, in words.
        remedy: What to do if it does not agree.
        settings: Keys of [modulator] that would make it agree, with their values.
        inverted: Whether the pulses came with the masks that should have none, and none with those that should.
    """

    agrees: bool
    said: str
    remedy: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    inverted: bool = False


class Modulator(Device[ModulatorInfo, ModulatorStatus]):
    """A device that shows masks in a timed sequence.

    Closing it does not stop a running sequence.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        super().__init__(name, clock)
        self._loaded: PatternSequence | None = None
        self._armed = False
        self._meanwhile: Callable[[float], None] | None = None

    @property
    def loaded(self) -> PatternSequence | None:
        """Get the sequence on the device with its quantised times, or None."""
        return self._loaded

    def check(self, sequence: PatternSequence) -> PatternSequence:
        """Return the sequence with its times quantised as the device will keep them.

        Raises:
            OutOfRangeError: Shape, depth, levels, a time or the number of masks is beyond the device.
            UnsupportedError: The trigger output cannot do what the sequence needs.
        """
        check_sequence(self.name, self.info, sequence)
        kept_s = self.info.quantise_s
        return replace(
            sequence,
            exposure_s=kept_s(sequence.exposure_s),
            dark_s=kept_s(sequence.dark_s),
            pause_s=kept_s(sequence.pause_s),
        )

    def upload_eta_s(self, sequence: PatternSequence) -> float:
        """Return how long `upload` will take, before it starts.

        Raises:
            OutOfRangeError, UnsupportedError: As `check`.
        """
        return self._do_upload_eta_s(self.check(sequence))

    def turn_eta_s(self, sequence: PatternSequence) -> float:
        """Return how long `turn` will take, before the upload.

        Raises:
            OutOfRangeError, UnsupportedError: As `check`.
        """
        return self._do_turn_eta_s(self.check(sequence))

    def upload(self, sequence: PatternSequence, progress: UploadProgress | None = None) -> UploadReport:
        """Put a sequence on the device; the one before is lost, also when this fails.

        Raises:
            OutOfRangeError, UnsupportedError: As `check`; nothing was sent.
            LinkError, RefusedError, DeviceFaultError: On the way.
        """
        sequence = self.check(sequence)
        self._loaded, self._armed = None, False
        begin_s = self.clock.now_s()
        payload_bytes = self._do_upload(replace(sequence, first=0), progress or (lambda share: None))
        if sequence.first:
            self._do_turn(sequence)
        self._loaded = sequence
        return UploadReport(sequence, payload_bytes, self.clock.now_s() - begin_s)

    def turn(self, first: int) -> None:
        """Let the loaded sequence begin with another mask, from 0; those before it follow after the last one.

        Raises:
            WrongStateError: Nothing is loaded.
            OutOfRangeError: There is no such mask.
            LinkError, RefusedError, DeviceFaultError: On the way; the sequence is lost then.
        """
        self._require_open("turn")
        sequence = self.check(replace(self._require_loaded("turn"), first=first))
        self._loaded, self._armed = None, False
        self._do_turn(sequence)
        self._loaded = sequence

    def arm(self) -> None:
        """Do all that takes time, so that the next `start` begins within `start_latency_s`.

        Raises:
            WrongStateError: Nothing is loaded.
            LinkError, RefusedError, DeviceFaultError: The device cannot run the sequence.
        """
        loaded = self._require_loaded("arm")
        self._require_open("arm")
        self._do_arm(loaded)
        self._armed = True

    def start(self) -> None:
        """Show the armed sequence; returns at once. It must be armed again for the next run.

        Raises:
            WrongStateError: Not armed.
            LinkError, RefusedError: The device did not start.
        """
        self._require_open("start")
        if self._loaded is None or not self._armed:
            raise WrongStateError(self.name, "not armed", asked="start", remedy="call arm() first")
        self._armed = False
        self._do_start(self._loaded)

    def keep_time(self, until_s: float) -> None:
        """Wait until `until_s` on the driver's clock and show the masks that become due meanwhile.

        A caller that serves a sensor calls this while a sequence runs on a device whose masks the host steps
        (`hardware_timed` is false). For a device with a clock of its own this only waits.

        Raises:
            SequenceError: The host was too late for a mask.
            LinkError, RefusedError: The command did not reach the device, or was refused.
        """
        self._require_open("keep_time")
        self._do_keep_time(until_s)

    def wait_done(self, timeout_s: float, meanwhile: Callable[[float], None] | None = None) -> None:
        """Wait until the running sequence has ended by itself.

        Args:
            timeout_s: How long to wait.
            meanwhile: What else there is to do until a time on the driver's clock, while a device with a clock of its
                own is not to be asked; what it raises ends the wait.

        Raises:
            NoAnswerError: Still running after `timeout_s`.
            SequenceError: It did not end as planned.
            LinkError: The device is gone.
        """
        self._require_open("wait_done")
        self._meanwhile = meanwhile
        try:
            self._do_wait_done(timeout_s)
        finally:
            self._meanwhile = None

    def disarm(self) -> None:
        """Stop a running sequence and show nothing; allowed in any state, any number of times.

        The uploaded sequence stays, unless the device cannot keep it (then `loaded` is None).

        Raises:
            LinkError, RefusedError: The command did not reach the device, or was refused.
        """
        self._require_open("disarm")
        self._armed = False
        self._do_disarm()

    def _state_if(self, running: bool, faults: tuple[str, ...] = ()) -> ModulatorState:
        """Return the state of a device that does not tell its own: by what it was asked for last, unless it fails."""
        if faults:
            return ModulatorState.FAULT
        if running:
            return ModulatorState.RUNNING
        if self._armed:
            return ModulatorState.ARMED
        return ModulatorState.IDLE if self._loaded is None else ModulatorState.LOADED

    def interpret_pulses(self, counted: int) -> PulseVerdict:
        """Say what a number of pulses of the trigger output during one whole run of the loaded sequence means.

        Raises:
            WrongStateError: No sequence is loaded.
        """
        return self._do_interpret_pulses(self._require_loaded("interpret pulses"), counted)

    def _require_loaded(self, asked: str) -> PatternSequence:
        if self._loaded is None:
            raise WrongStateError(self.name, "no sequence is loaded", asked=asked, remedy="call upload() first")
        return self._loaded

    def other_polarity(self) -> PulseVerdict | None:
        """Return the keys of [modulator] that make the gate line active at its other level, as a verdict's settings.

        None if the device has no such setting.
        """
        self._require_open("other_polarity")
        return self._do_other_polarity()

    def _wait_while(self, running: Callable[[], bool], timeout_s: float, asked: str, end_s: float) -> None:
        """Poll until a sequence no longer runs, or raise NoAnswerError: for devices that do not report the end.

        `end_s` is when it ends at the earliest; from shortly before that on, polling is more frequent.
        """
        until_s = self.clock.now_s() + timeout_s
        while running():
            left_s = until_s - self.clock.now_s()
            if left_s <= 0:
                raise NoAnswerError(
                    self.name, asked, timeout_s, remedy="wait longer, or disarm a sequence that runs for ever"
                )
            near = self.clock.now_s() > end_s - POLL_S
            next_s = self.clock.now_s() + min(FINE_POLL_S if near else POLL_S, left_s)
            if self._meanwhile is not None and not near:
                self._meanwhile(next_s)
            self.clock.sleep_s(next_s - self.clock.now_s())

    @abstractmethod
    def _do_upload_eta_s(self, sequence: PatternSequence) -> float:
        """Estimate the upload's time."""

    @abstractmethod
    def _do_upload(self, sequence: PatternSequence, progress: UploadProgress) -> int:
        """Send a checked sequence, which begins with its first mask; return the bytes of pattern data sent."""

    def _do_turn(self, sequence: PatternSequence) -> None:
        """Begin with another mask: the masks are sent anew; overridden by drivers that need not do so."""
        self._do_upload(sequence.in_order(), lambda share: None)

    def _do_turn_eta_s(self, sequence: PatternSequence) -> float:
        """Estimate the time of `_do_turn`; overridden with it."""
        return self._do_upload_eta_s(sequence)

    @abstractmethod
    def _do_arm(self, sequence: PatternSequence) -> None:
        """Prepare to start; raise an error if the device reports a fault."""

    @abstractmethod
    def _do_start(self, sequence: PatternSequence) -> None:
        """Start and confirm that it started."""

    def _do_keep_time(self, until_s: float) -> None:
        """Wait until a time; overridden by drivers whose masks the host steps."""
        self.clock.sleep_s(until_s - self.clock.now_s())

    def _do_interpret_pulses(self, sequence: PatternSequence, counted: int) -> PulseVerdict:
        """Compare with what was requested; overridden if firmware revisions interpret a setting differently."""
        expected = sequence.pulses
        said = f"{counted} pulses were seen and {expected} expected"
        return PulseVerdict(counted == expected, said, "check the trigger cable and the sensor's trigger")

    def _do_other_polarity(self) -> PulseVerdict | None:
        """Return the settings of the other polarity; overridden by drivers of devices that have it."""
        return None

    @abstractmethod
    def _do_wait_done(self, timeout_s: float) -> None:
        """Wait for the end."""

    @abstractmethod
    def _do_disarm(self) -> None:
        """Stop in any state; first discard the bytes that an interrupted exchange may have left."""
