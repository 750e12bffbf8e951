"""A serial line of the computer as a `BytePort`, by pyserial.

Here: opening, reading, writing with timeouts. Not here: any protocol.
"""

import errno
import glob
import termios
from typing import Any, Final

import serial

from gs2ci_drivers.failures import AccessError
from gs2ci_drivers.ports import port_errors

ADAPTERS: Final = ("/dev/serial/by-id/*", "/dev/ttyUSB*", "/dev/ttyACM*")


class SerialLine:
    """A tty that keeps the rules of `BytePort`.

    DTR is high while the line is open and stays high afterwards. Linux raises it on every opening
    (tty_port_block_til_ready), an Arduino Uno resets when it rises, and boards with USB of their own, such as those on
    the RP2040, send only while it is high. So the line is set not to drop DTR on closing (HUPCL off): after the first
    session since the board was plugged in, DTR no longer rises on opening, and nothing is reset. The line is locked
    against other programs.

    Args:
        device: Name of the device, for messages.
        path: The tty ("/dev/ttyUSB0", "/dev/serial/by-id/...").
        baud: Bits per second, 8N1.
        rts_cts: Whether both sides hold each other back by RTS and CTS.

    Raises:
        AccessError: No such node, no permission, or in use.
        DisconnectedError: The node is there but does not work.
    """

    def __init__(self, device: str, path: str, baud: int = 115200, *, rts_cts: bool = False) -> None:
        self._port = serial.Serial(rtscts=rts_cts)
        self._port.port = path
        self._port.exclusive = True
        with port_errors(device, f"open {path}"):
            try:
                self._port.baudrate = baud
                self._port.open()
                _keep_lines_on_close(self._port.fileno())
            except serial.SerialException as error:
                if error.errno in (None, errno.EAGAIN) and "lock" in str(error):
                    raise AccessError(
                        device, f"{path} is in use by another program", asked="open", remedy="close that program"
                    ) from error
                if error.errno == errno.ENOENT:
                    raise _missing(device, path) from error
                raise
            except ValueError as error:
                raise AccessError(
                    device, f"baud rate {baud} ({error})", asked=f"open {path}", allowed="9600, 115200, ..."
                ) from error

    def write(self, data: bytes, timeout_s: float) -> None:
        """Send all of `data`; see `BytePort.write`."""
        self._require_open()
        self._port.write_timeout = max(timeout_s, 1e-3)  # pyserial takes 0 to mean that it must not wait at all
        try:
            self._port.write(data)
        except serial.SerialTimeoutException as error:
            raise TimeoutError(str(error)) from error

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Receive what there is; see `BytePort.read`."""
        self._require_open()
        try:
            waiting = self._port.in_waiting
            self._port.timeout = max(timeout_s, 0.0)
            return bytes(self._port.read(min(max(waiting, 1), max_bytes)))
        except TypeError as error:  # pyserial raises it if the port was closed meanwhile
            raise OSError(errno.EIO, "the port was closed") from error

    def close(self) -> None:
        """Close the tty; a second call does nothing."""
        try:
            self._port.close()
        except OSError:  # unplugged: there is nothing left to close
            return

    def _require_open(self) -> None:
        if not self._port.is_open:
            raise OSError(errno.EIO, "the port is closed")


def serial_line(device: str, table: Any) -> SerialLine:
    """Open the line that a device's table names by its `port` and `baud`.

    Raises:
        AccessError, DisconnectedError: As `SerialLine`.
    """
    return SerialLine(device, table.port, table.baud)


def _missing(device: str, path: str) -> AccessError:
    """Return the error for a tty that is not there, with those that are.

    brltty, a driver of Braille displays that Ubuntu installs, took adapters with the ids of a CH340 or a CP210x from
    every other program until its release 6.5 (github.com/arduino/arduino-ide issue 1788, by its author).
    """
    there = sorted(name for pattern in ADAPTERS for name in glob.glob(pattern))
    return AccessError(
        device,
        f"there is no {path}",
        asked="open",
        allowed=", ".join(there) or "none is there now",
        remedy="check power and cable, and `port` in the rig file; `gs2ci doctor` tries each device. If the kernel's "
        "log says \"claimed by ch341 (or cp210x) while 'brltty' sets config\", the program brltty has taken the "
        "adapter for a Braille display: remove it (`apt remove brltty`) or install its release 6.5 or later, and plug "
        "the adapter in again",
    )


def _keep_lines_on_close(descriptor: int) -> None:
    """Keep DTR and RTS as they are when the line is closed."""
    attributes = termios.tcgetattr(descriptor)
    attributes[2] &= ~termios.HUPCL
    try:
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    except termios.error as error:
        raise OSError(*error.args) from error
