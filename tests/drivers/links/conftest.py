"""A USB device made of Python, below pyusb's surface."""

import errno
from collections import deque
from typing import Any

import pytest
import usb.core
import usb.util


class FakeUsb:
    """What the links use of a `usb.core.Device`."""

    def __init__(self, bus: int = 1, port_numbers: tuple[int, ...] = (2, 3)) -> None:
        self.bus = bus
        self.port_numbers = port_numbers
        self.kernel_driver = {0: True, 1: False}
        self.claimed: set[int] = set()
        self.calls: list[str] = []
        self.sent: list[tuple[int, bytes, int]] = []
        self.replies: deque[bytes | Exception] = deque()
        self.fail: dict[str, Exception] = {}
        self.takes: int | None = None

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if name in self.fail:
            raise self.fail[name]

    def is_kernel_driver_active(self, interface: int) -> bool:
        self._call("is_kernel_driver_active")
        return self.kernel_driver[interface]

    def detach_kernel_driver(self, interface: int) -> None:
        self._call("detach")
        self.kernel_driver[interface] = False

    def attach_kernel_driver(self, interface: int) -> None:
        self._call("attach")
        self.kernel_driver[interface] = True

    def write(self, endpoint: int, data: bytes, timeout: int) -> int:
        self._call("write")
        self.sent.append((endpoint, bytes(data), timeout))
        return len(data) if self.takes is None else self.takes

    def read(self, endpoint: int, size: int, timeout: int) -> Any:
        self._call(f"read {timeout}")
        reply = self.replies.popleft() if self.replies else usb.core.USBTimeoutError("timed out", -7, errno.ETIMEDOUT)
        if isinstance(reply, Exception):
            raise reply
        return memoryview(reply)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeUsb:
    """A device that records what is done with it."""
    device = FakeUsb()

    def claim(one: FakeUsb, interface: int) -> None:
        one._call("claim")
        one.claimed.add(interface)

    def release(one: FakeUsb, interface: int) -> None:
        one._call("release")
        one.claimed.discard(interface)

    monkeypatch.setattr(usb.util, "claim_interface", claim)
    monkeypatch.setattr(usb.util, "release_interface", release)
    monkeypatch.setattr(usb.util, "dispose_resources", lambda one: one._call("dispose"))
    return device
