"""What twins below a port have in common: a device that can be unplugged, and that one session at a time may open.

Not here: what goes over the port (`serial_twin`, `dlpc900`, `alp`).
"""

from abc import ABC, abstractmethod
from errno import EBUSY, EIO, ENODEV
from typing import Any, ClassVar, Generic, TypeVar

from gs2ci_sims.faults import FaultSet

SessionOf = TypeVar("SessionOf", bound="Session[Any]")
TwinOf = TypeVar("TwinOf", bound="Plugged[Any]")


class Plugged(ABC, Generic[SessionOf]):
    """A device that is plugged in.

    Args:
        faults: The faults to inject.
    """

    def __init__(self, faults: FaultSet | None) -> None:
        self.faults = faults or FaultSet()
        self.plugged = True
        self._session: SessionOf | None = None

    def open(self) -> SessionOf:
        """Open it as the operating system does.

        Raises:
            OSError: ENODEV when unplugged, EBUSY when open already.
        """
        if not self.plugged:
            raise OSError(ENODEV, "No such device")
        if self._session is not None:
            raise OSError(EBUSY, "Device or resource busy")
        self._session = self._begin_session()
        return self._session

    def unplug(self) -> None:
        """Unplug the device; an open session fails from now on."""
        self.plugged = False
        self._session = None
        self._lose()

    def plug_in(self) -> None:
        """Plug the device in again; a new session has to be opened."""
        self.plugged = True

    @abstractmethod
    def _begin_session(self) -> SessionOf:
        """Return a new session."""

    @abstractmethod
    def _lose(self) -> None:
        """Lose what unplugging loses."""

    def _closed(self) -> None:
        """React to the end of a session; most devices ignore it."""
        return


class Session(Generic[TwinOf]):
    """One opening of a device.

    Args:
        twin: The device.
    """

    what: ClassVar[str] = "port"

    def __init__(self, twin: TwinOf) -> None:
        self._twin = twin
        self._open = True

    def close(self) -> None:
        """Close the session; a second call does nothing."""
        if self._open:
            self._open = False
            if self._twin._session is self:
                self._twin._session = None
                self._twin._closed()

    def _require_open(self) -> None:
        if not self._open:
            raise OSError(EIO, f"the {self.what} is closed")

    def _require_alive(self) -> None:
        self._require_open()
        if not self._twin.plugged or self._twin._session is not self:
            raise OSError(ENODEV, "No such device (it may have been disconnected)")
