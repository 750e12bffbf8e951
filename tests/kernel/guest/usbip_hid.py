"""Plugs a HID device made of two functions into the kernel's virtual host controller (vhci-hcd).

The USB/IP protocol (Documentation/usb/usbip_protocol.rst) runs over a socket pair of which vhci-hcd gets one end.
The kernel enumerates a full-speed device with one HID interface, interrupt endpoints 0x01 and 0x81 of 64 bytes,
exactly as it would enumerate one behind a cable; only the reports are ours.
"""

import errno
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
FULL_SPEED = 2
FREE_PORT = 4
REPORT = 64
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4
HEAD = struct.Struct(">5I")
GET_DESCRIPTOR, SET_CONFIGURATION, SET_IDLE = 6, 9, 10

# Vendor page, one 64-byte report each way, no report ids.
HID_REPORTS = bytes.fromhex("06 00 ff 09 01 a1 01 15 00 26 ff 00 75 08 95 40 09 01 81 02 09 02 91 02 c0")
HID = struct.pack("<BBHBBBH", 9, 0x21, 0x0111, 0, 1, 0x22, len(HID_REPORTS))


def _device(vendor_id: int, product_id: int) -> bytes:
    return struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0110, 0, 0, 0, 64, vendor_id, product_id, 0x0100, 1, 2, 0, 1)


def _configuration() -> bytes:
    interface = struct.pack("<9B", 9, 4, 0, 0, 2, 3, 0, 0, 0)
    endpoints = b"".join(struct.pack("<BBBBHB", 7, 5, address, 3, REPORT, 1) for address in (0x81, 0x01))
    body = interface + HID + endpoints
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 1, 1, 0, 0x80, 50) + body


def _text(words: str) -> bytes:
    encoded = words.encode("utf-16-le")
    return bytes([2 + len(encoded), 3]) + encoded


class HidOnVhci:
    """A HID device that is plugged in while this lives.

    Args:
        on_report: Gets every report that the host sends; called in the serving thread.
        vendor_id: USB vendor.
        product_id: USB product.
    """

    def __init__(self, on_report: Callable[[bytes], None], vendor_id: int, product_id: int) -> None:
        self._on_report = on_report
        self._descriptors = {
            1: _device(vendor_id, product_id),
            2: _configuration(),
            0x300: b"\x04\x03\x09\x04",
            0x301: _text("gs2ci"),
            0x302: _text("DLPC900"),
            0x22: HID_REPORTS,
            0x21: HID,
        }
        self._lock = threading.Lock()
        self._asking: deque[tuple[int, int]] = deque()  # (number, room) of IN transfers that wait for a report
        self._reports: deque[bytes] = deque()
        self._port = self._free_port()
        self._socket, kernels = socket.socketpair()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        line = f"{self._port} {kernels.fileno()} {1 << 16 | 2 + self._port} {FULL_SPEED}"
        (VHCI / "attach").write_text(line)
        kernels.close()

    @staticmethod
    def _free_port() -> int:
        for line in (VHCI / "status").read_text().splitlines()[1:]:
            hub, port, state = line.split()[:3]
            if hub == "hs" and int(state) == FREE_PORT:
                return int(port)
        raise OSError(errno.EBUSY, "no port of the virtual host controller is free")

    def send(self, report: bytes) -> None:
        """Hand a report to the host."""
        with self._lock:
            self._reports.append(report)
            self._match()

    def unplug(self) -> None:
        """Pull the cable; a second call does nothing."""
        if self._port >= 0:
            (VHCI / "detach").write_text(str(self._port))
            self._port = -1
            self._thread.join(10)
            self._socket.close()

    # ---- the wire

    def _match(self) -> None:
        while self._asking and self._reports:
            number, room = self._asking.popleft()
            self._submitted(number, data=self._reports.popleft()[:room])

    def _submitted(self, number: int, *, status: int = 0, data: bytes = b"", taken: int = 0) -> None:
        tail = struct.pack(">5i8x", status, taken or len(data), 0, 0, 0)
        self._socket.sendall(HEAD.pack(SUBMITTED, number, 0, 0, 0) + tail + data)

    def _receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            part = self._socket.recv(size - len(data))
            if not part:
                raise EOFError
            data += part
        return data

    def _serve(self) -> None:
        try:
            while True:
                self._serve_one()
        except (EOFError, OSError):  # unplugged
            return

    def _serve_one(self) -> None:
        head = self._receive(48)
        command, number, _, inwards, endpoint = HEAD.unpack_from(head)
        if command == UNLINK:
            self._unlink(number, struct.unpack_from(">I", head, 20)[0])
            return
        (length,) = struct.unpack_from(">i", head, 24)
        data = b"" if inwards else self._receive(length)
        if endpoint == 0:
            self._control(number, struct.unpack_from("<BBHHH", head, 40), len(data))
        elif inwards:
            with self._lock:
                self._asking.append((number, length))
                self._match()
        else:
            with self._lock:
                self._submitted(number, taken=len(data))
            self._on_report(data)

    def _unlink(self, number: int, victim: int) -> None:
        with self._lock:
            waiting = [entry for entry in self._asking if entry[0] == victim]
            for entry in waiting:
                self._asking.remove(entry)
            status = -errno.ECONNRESET if waiting else 0
            self._socket.sendall(HEAD.pack(UNLINKED, number, 0, 0, 0) + struct.pack(">i24x", status))

    def _control(self, number: int, setup: tuple[int, ...], sent: int) -> None:
        kind, request, value, _, length = setup
        answer: bytes | None = None
        if request == GET_DESCRIPTOR and kind & 0x80:
            key = value if value >> 8 == 3 else value >> 8
            answer = self._descriptors.get(key)
        elif (kind, request) in ((0x00, SET_CONFIGURATION), (0x21, SET_IDLE)):
            answer = b""
        with self._lock:
            if answer is None:
                self._submitted(number, status=-errno.EPIPE)
            else:
                self._submitted(number, data=answer[:length], taken=sent)
