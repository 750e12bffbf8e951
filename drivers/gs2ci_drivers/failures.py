"""What can go wrong with a device, as one tree of typed errors.

    DeviceError (gs2ci.core.errors)
    └── DriverError                names the device, the trigger index (when there is one) and what was asked
        ├── LinkError              the bytes were not transferred
        │   ├── AccessError        the port cannot be opened: permissions, already in use, not there
        │   ├── NoAnswerError      nothing, or not enough, within the deadline
        │   ├── BadReplyError      an answer that the protocol does not know
        │   └── DisconnectedError  the device went away while it was in use
        ├── RefusedError           the device understood the request and refused it
        ├── DeviceFaultError       the device reports that it cannot work
        │   ├── MoveFailedError    a stage stopped before its target
        │   ├── ReferenceLostError a stage no longer knows where it is
        │   └── SequenceError      a modulator did not show the requested sequence
        ├── UnsupportedError       the device does not have this ability
        ├── OutOfRangeError        a value that the device cannot take
        ├── PathError              a stage did not follow its path while masks were shown
        ├── WrongStateError        the call came in the wrong order
        ├── PlanRefusedError       a capture plan breaks limits; nothing was moved
        └── FrameError             the sensor and its triggers disagree
            ├── TriggerTimeoutError  no frame came for a trigger
            ├── FrameLostError       the sequence numbers have a gap
            ├── FrameCorruptError    the driver or the kernel marked the payload bad
            ├── FrameStaleError      the frame is older than its trigger
            ├── ExposureError        the frame was exposed for a shorter time than was set
            └── ExtraFrameError      more frames than triggers were sent

Here: the classes, and the command that remedies for a lost reference name. Not here: how they are handled
(`gs2ci_drivers.acquisition`).
"""

from collections.abc import Sequence
from typing import Final, Self

from gs2ci.core.errors import DeviceError

# What remedies name where a stage does not know where it is.
HOME_COMMAND: Final = "gs2ci devices --rig RIG.toml --home"


class DriverError(DeviceError):
    """Base of every failure of a device.

    Args:
        device: Name of the device as the rig file gives it (`dmd0`).
        problem: What happened.
        asked: What the device was asked to do, in its protocol's words if that helps.
        allowed: What would be accepted.
        remedy: What the user can do about it.

    `trigger_index` is which trigger of the capture was being served, from 0, once `at_trigger` has noted it.
    """

    def __init__(
        self,
        device: str,
        problem: str,
        *,
        asked: str = "",
        allowed: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(problem, allowed=allowed, remedy=remedy)
        self.device = device
        self.asked = asked
        self.trigger_index: int | None = None
        self._happened = f"{asked}: {problem}" if asked else problem
        self.problem = self._described()

    def at_trigger(self, trigger_index: int) -> Self:
        """Note which trigger was being served, unless that is known already; return self to be raised."""
        if self.trigger_index is None:
            self.trigger_index = trigger_index
            self.problem = self._described()
        return self

    def _described(self) -> str:
        served = "" if self.trigger_index is None else f", trigger {self.trigger_index}"
        return f"{self.device}{served}: {self._happened}"

    def __str__(self) -> str:
        parts = [self.problem]
        if self.allowed:
            parts.append(f"allowed: {self.allowed}")
        if self.remedy:
            parts.append(f"what to do: {self.remedy}")
        return "; ".join(parts)


class LinkError(DriverError):
    """The bytes did not reach the device, or its answer did not come back."""


class AccessError(LinkError):
    """The port cannot be opened: no permission, already in use, or not there."""


class NoAnswerError(LinkError):
    """Nothing, or not enough, came back within the deadline.

    Args:
        device: Name of the device.
        asked: What was sent.
        waited_s: How long was waited on the device's clock.
    """

    def __init__(self, device: str, asked: str, waited_s: float, *, remedy: str = "") -> None:
        super().__init__(
            device,
            f"no answer within {waited_s:.3g} s",
            asked=asked,
            remedy=remedy or "check power and cable, then run `gs2ci doctor`",
        )
        self.waited_s = waited_s


class BadReplyError(LinkError):
    """An answer came that the protocol does not know.

    Args:
        device: Name of the device.
        asked: What was sent.
        reply: The bytes as received.
        why: What is wrong with them.
        allowed: What would have been a valid answer.
    """

    def __init__(
        self,
        device: str,
        asked: str,
        reply: bytes,
        why: str,
        *,
        allowed: str = "",
    ) -> None:
        shown = repr(reply[:48]) + ("..." if len(reply) > 48 else "")
        super().__init__(
            device,
            f"bad reply {shown}: {why}",
            asked=asked,
            allowed=allowed,
            remedy="check the cable and the baud rate; record a wire trace with `trace = true` if the error returns",
        )
        self.reply = reply


class DisconnectedError(LinkError):
    """The device went away while it was in use.

    Args:
        device: Name of the device.
        asked: What was being done.
        cause: The operating system's words.
    """

    def __init__(self, device: str, asked: str, cause: object) -> None:
        super().__init__(
            device,
            f"the device is gone ({cause})",
            asked=asked,
            remedy="check power and cable, plug it in again and repeat",
        )


class RefusedError(DriverError):
    """The device understood the request and refused it.

    Args:
        device: Name of the device.
        asked: What was asked.
        code: The device's own code for the refusal.
        meaning: What the manual says about that code.
    """

    def __init__(
        self,
        device: str,
        asked: str,
        code: int | str,
        meaning: str,
        *,
        remedy: str = "",
    ) -> None:
        super().__init__(
            device,
            f"refused with {code} ({meaning})",
            asked=asked,
            remedy=remedy or "see `gs2ci devices` for what the device can do",
        )
        self.code = code


class DeviceFaultError(DriverError):
    """The device reports that it cannot work.

    Args:
        device: Name of the device.
        asked: What was being done.
        faults: The faults in the device's own terms with their meaning.
    """

    def __init__(
        self,
        device: str,
        asked: str,
        faults: Sequence[str],
        *,
        remedy: str = "",
    ) -> None:
        super().__init__(
            device,
            "the device reports " + ", ".join(faults),
            asked=asked,
            remedy=remedy or "see the device's manual for this fault, then run `gs2ci doctor`",
        )
        self.faults = tuple(faults)


class MoveFailedError(DeviceFaultError):
    """A stage stopped before its target: stall, limit, emergency stop, or a newer command."""


class ReferenceLostError(DeviceFaultError):
    """A stage has lost its reference position (power cycle, alarm while moving); the user must home it."""


class SequenceError(DeviceFaultError):
    """A modulator did not show the requested sequence: it stopped, was aborted, or sent a wrong number of pulses."""


class UnsupportedError(DriverError):
    """The device does not have this ability."""


class OutOfRangeError(DriverError):
    """A value that the device cannot take."""


class PathError(DriverError):
    """A stage did not follow its path while masks were shown; the shot may be taken again."""


class WrongStateError(DriverError):
    """The call came in the wrong order: not connected, nothing loaded, already running, closed."""


class PlanRefusedError(DriverError):
    """A capture plan breaks limits of the devices; nothing was moved, reset or uploaded.

    Args:
        findings: One sentence per broken limit: what was asked, what is allowed, what to do.
    """

    def __init__(self, findings: Sequence[str]) -> None:
        super().__init__(
            "plan",
            f"{len(findings)} of its checks failed: " + " | ".join(findings),
            remedy="change the [capture] table of the rig file; `gs2ci capture --dry-run` prints the whole plan",
        )
        self.findings = tuple(findings)


class FrameError(DriverError):
    """The sensor's frames and the triggers disagree."""


class TriggerTimeoutError(FrameError):
    """No frame came for a trigger within the deadline.

    Args:
        device: Name of the sensor.
        frame_index: Index of the missing frame since the sensor was started, from 0.
        waited_s: How long was waited on the sensor's clock.
    """

    def __init__(self, device: str, frame_index: int, waited_s: float) -> None:
        super().__init__(
            device,
            f"no frame {frame_index} after {waited_s:.3g} s",
            remedy="check the trigger cable, its level and its polarity; `gs2ci doctor` tests the loop",
        )
        self.frame_index = frame_index
        self.waited_s = waited_s


class FrameLostError(FrameError):
    """The kernel's sequence numbers have a gap: frames were exposed and then dropped.

    Args:
        device: Name of the sensor.
        frame_index: Index of the first missing frame since the sensor was started, from 0.
        lost: How many are missing.
        also: A further remedy.
    """

    def __init__(self, device: str, frame_index: int, lost: int, *, also: str = "") -> None:
        remedy = "raise `buffers` in [sensor], lower the trigger rate, or close other programs"
        super().__init__(
            device,
            f"{lost} frame(s) lost from frame {frame_index} on",
            remedy=f"{remedy}; {also}" if also else remedy,
        )
        self.frame_index = frame_index
        self.lost = lost


class FrameCorruptError(FrameError):
    """The driver marked a frame's payload as bad, or it is shorter than its format.

    Args:
        device: Name of the sensor.
        frame_index: Index of the frame since the sensor was started, from 0.
        why: What is wrong with it.
    """

    def __init__(self, device: str, frame_index: int, why: str) -> None:
        super().__init__(
            device,
            f"frame {frame_index} is corrupt: {why}",
            remedy="check the sensor's cable; allow a second attempt with `retries = 1` in [capture]",
        )
        self.frame_index = frame_index


class FrameStaleError(FrameError):
    """A frame came that is older than the trigger that it should answer.

    Args:
        device: Name of the sensor.
        frame_index: Index of the frame since the sensor was started, from 0.
        age_s: How long before the trigger it was taken.
    """

    def __init__(self, device: str, frame_index: int, age_s: float) -> None:
        super().__init__(
            device,
            f"frame {frame_index} was taken {age_s:.3g} s before its trigger",
            remedy="raise `warm_up_frames` in [sensor]; check that nothing else fires the trigger line",
        )
        self.frame_index = frame_index
        self.age_s = age_s


class ExposureError(FrameError):
    """A frame was exposed for a shorter time than was set.

    Args:
        device: Name of the sensor.
        frame_index: Index of the frame since the modulator was started, from 0.
        set_s: The exposure that was set.
        exposed_s: The longest that it can have been.
    """

    def __init__(self, device: str, frame_index: int, set_s: float, exposed_s: float) -> None:
        super().__init__(
            device,
            f"frame {frame_index} came after an exposure of {exposed_s:.3g} s at most, not {set_s:.3g} s",
            remedy="the camera counts exposure in another unit, ignores its control, or runs by its own clock: "
            "`gs2ci doctor` tells which",
        )
        self.frame_index = frame_index


class ExtraFrameError(FrameError):
    """More frames came than triggers were sent: a doubled trigger, or one from another source."""
