"""What the cameras behind V4L2 and GenICam share: reading, discarding, and letting go of a device that disappeared.

Here: `StreamedSensor`. Not here: opening, setting up and streaming (`v4l2/driver.py`, `genicam/driver.py`), the checks
of a frame (`frame_checks`).
"""

import contextlib
from abc import abstractmethod
from collections.abc import Callable, Iterator
from typing import Final, Generic

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import DisconnectedError, DriverError, TriggerTimeoutError
from gs2ci_drivers.frame_checks import FrameChecks, Taken
from gs2ci_drivers.sensor import Frame, Sensor, SensorConfig, SensorStatus

WARM_UP_PATIENCE_S: Final = 5.0
"""How long a warm-up frame may take beyond its exposure: USB cameras need seconds to begin."""
MAX_DISCARD: Final = 256
"""Limit on the frames that `discard` discards, so that it ends even if frames arrive faster than it reads them."""


class StreamedSensor(Sensor, Generic[Taken]):
    """A camera whose frames are fetched one by one and then checked.

    A device that disappears is released at once; `configure` or `start` opens it again, so that after a replug the same
    object can go on capturing.

    Args:
        name: Name of the device in the rig file, for messages.
        clock: The clock of all waits.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        super().__init__(name, clock)
        self._checks: FrameChecks[Taken] | None = None

    @abstractmethod
    def _is_open(self) -> bool:
        """Return whether the device is open; it is not after it disappeared."""

    @abstractmethod
    def _fetch(self, timeout_s: float) -> Taken | None:
        """Wait for the next frame; None if there is none in time."""

    @abstractmethod
    def _probe(self) -> None:
        """Request something from the open device, which fails if it is gone."""

    @abstractmethod
    def _let_go(self) -> None:
        """Release a device that is gone."""

    def _do_read(self, timeout_s: float, not_before_ns: int, trigger_index: int | None) -> Frame:
        try:
            with self._noticing_loss():
                checks = self._running()
                taken, checks.held = checks.held, None
                if taken is None:
                    taken = self._fetch(timeout_s)
                if taken is None:
                    raise TriggerTimeoutError(self.name, checks.frame_index, timeout_s)
                return checks.check(taken, not_before_ns)
        except DriverError as error:
            if trigger_index is not None:
                error.at_trigger(trigger_index)
            raise

    def _do_discard(self) -> int:
        with self._noticing_loss():
            checks = self._running()
            dropped = 0
            while dropped < MAX_DISCARD and (taken := checks.held or self._fetch(0.0)) is not None:
                checks.held = None
                checks.pass_over(taken)
                dropped += 1
        return dropped

    def _do_status(self) -> SensorStatus:
        with self._noticing_loss():
            self._require_connection("status")
            self._probe()
        checks = self._checks
        if checks is None:
            return SensorStatus(self._streaming)
        return SensorStatus(self._streaming, checks.delivered, checks.lost, checks.corrupt)

    def _running(self) -> FrameChecks[Taken]:
        self._require_connection("read")
        assert self._checks is not None  # frames are read from a started sensor only
        return self._checks

    def _require_connection(self, asked: str) -> None:
        if not self._is_open():
            raise DisconnectedError(self.name, asked, "it was disconnected earlier")

    def _pass_warm_up(self, config: SensorConfig, fetch: Callable[[float], object]) -> None:
        """Fetch the warm-up frames and drop them.

        Raises:
            TriggerTimeoutError: One did not come.
        """
        patience_s = WARM_UP_PATIENCE_S + config.exposure_s
        for index in range(config.warm_up_frames):
            if fetch(patience_s) is None:
                raise TriggerTimeoutError(self.name, index, patience_s)

    @contextlib.contextmanager
    def _noticing_loss(self) -> Iterator[None]:
        """Release everything if the device turns out to be gone."""
        try:
            yield
        except DisconnectedError:
            self._let_go()
            raise
