"""The base class of all devices: a name, a clock, and the session from `connect` to `close`.

Here: the base of the three interfaces. Not here: what a modulator, a sensor, a stage do (`modulator`, `sensor`,
`stage`).
"""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import WrongStateError

Info = TypeVar("Info")
Status = TypeVar("Status")


class Device(ABC, Generic[Info, Status]):
    """A device on the bench. Public methods check; a driver writes only the private `_do_*` hooks.

    Args:
        name: Name of the device in the rig file, for messages.
        clock: The clock on which deadlines and waits are kept.
    """

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self.clock = clock
        self._info: Info | None = None
        self._closed = False
        self.incidents: list[str] = []
        """Problems from which the driver recovered without an error (a lost reply requested again, ...), for the
        shot's log."""

    @property
    def info(self) -> Info:
        """Get the device's identity and abilities.

        Raises:
            WrongStateError: Not connected.
        """
        self._require_open("info")
        if self._info is None:
            raise WrongStateError(self.name, "not connected", asked="info", remedy="call connect() first")
        return self._info

    def connect(self) -> Info:
        """Read the device's identity; a second call returns the same.

        Nothing moves, and nothing that answers is changed or reset.

        Raises:
            LinkError: No usable answer, or the port cannot be opened.
            UnsupportedError: It is a device of another kind.
            WrongStateError: Closed before.
        """
        self._require_open("connect")
        if self._info is None:
            self._info = self._do_connect()
        return self._info

    def status(self) -> Status:
        """Read the device's state.

        Raises:
            LinkError: No usable answer.
        """
        self._require_open("status")
        return self._do_status()

    def temperatures_c(self) -> dict[str, float]:
        """Read the temperatures, in degrees Celsius, by the device's own names; empty if it reports none.

        Raises:
            LinkError: No usable answer.
        """
        self._require_open("temperatures_c")
        return self._do_temperatures_c()

    def close(self) -> None:
        """Release the port; never raises, may be called twice."""
        if not self._closed:
            self._closed = True
            self._do_close()

    def _require_open(self, asked: str) -> None:
        if self._closed:
            raise WrongStateError(self.name, "closed", asked=asked, remedy="open the rig again")

    @abstractmethod
    def _do_connect(self) -> Info:
        """Read identity and limits; change nothing; ignore stale answers of an earlier session."""

    @abstractmethod
    def _do_status(self) -> Status:
        """Read state and faults."""

    def _do_temperatures_c(self) -> dict[str, float]:
        """Read temperatures, if the device measures any."""
        return {}

    @abstractmethod
    def _do_close(self) -> None:
        """Release the port without raising."""
