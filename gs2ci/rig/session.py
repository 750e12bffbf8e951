"""The log of a capture, beside its shot file: operator, time, devices, temperatures and events.

`<shot file>.session.jsonl` holds JSON lines, each with the time (UTC), a level and an event. At level "debug" every
command and answer on every port is a line, too; long blocks (patterns, pixels) appear as length and checksum. The file
is created when the capture begins and written line by line, so that it also documents a capture that failed.

Here: the file. Not here: the shot file's own events (`gs2ci.core.storage`), traces that can be played back
(`gs2ci_drivers.trace`).
"""

import getpass
import json
import platform
import socket
import sys
import zlib
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, TextIO

from gs2ci import __version__
from gs2ci.core.clock import Clock
from gs2ci.core.errors import StorageError, reason_of
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.trace import Call, CallLog

SCHEMA: Final = "gs2ci.session/1"
SUFFIX: Final = ".session.jsonl"
Level = Literal["off", "info", "debug"]
"""Contents of a session log: nothing, the events, or every command and answer as well."""
_SHOWN_BYTES: Final = 64
"""Commands of all supported devices are shorter; longer blocks are patterns and pixels."""


class SessionLog:
    """The log of one capture.

    Args:
        shot: The shot file beside which the log lies.
        level: How much it contains.
    """

    def __init__(self, shot: Path, level: Level) -> None:
        self.shot = shot
        self.path = shot.with_name(shot.name + SUFFIX)
        self.level = level
        self._waiting: list[str] = []
        self._file: TextIO | None = None
        self._broken = False

    def begin(self, **figures: Any) -> None:
        """Open the file; write who starts the capture, the events noted before, and these figures.

        Raises:
            StorageError: The file cannot be written.
        """
        if self.level == "off" or self._file is not None:
            return
        head = _line("info", "begin", {"session": SCHEMA, **_user_and_programs(), **figures})
        try:
            self._file = self.path.open("w", encoding="utf-8", buffering=1)
        except OSError as error:
            raise StorageError(
                f"the session log {self.path} cannot be written ({reason_of(error)})",
                remedy='check the folder and its free space, or set session = "off" in the rig file',
            ) from error
        before, self._waiting = self._waiting, []
        for line in (head, *before):
            self._put(line)

    def note(self, event: str, **figures: Any) -> None:
        """Write an event."""
        if self.level != "off":
            self._put(_line("info", event, figures))

    def wire(self, device: str, clock: Clock) -> "CallLog | None":
        """Return the recorder of a device's traffic; None below level "debug"."""
        return _Traffic(self, device, clock) if self.level == "debug" else None

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def debug(self, event: str, **figures: Any) -> None:
        """Write a call on a port, at level "debug"."""
        if self.level == "debug":
            self._put(_line("debug", event, figures))

    def _put(self, line: str) -> None:
        if self._file is None:
            self._waiting.append(line)
        elif not (self._broken or self._file.closed):
            try:
                self._file.write(line)
            except OSError:  # a full disk ends the log; writing the shot file decides whether it ends the capture
                self._broken = True


@dataclass(frozen=True)
class _Traffic(CallLog):
    """One device's calls as lines of a session log."""

    log: SessionLog
    device: str
    clock: Clock

    def put(self, call: Call) -> None:
        told = {
            "args": call.args,
            "sent": [_shown(data) for data in call.sent],
            "got": [_shown(data) for data in call.got],
            "result": call.result,
            "error": call.error,
        }
        kept = {key: value for key, value in told.items() if value not in ([], None, "")}
        self.log.debug("call", device=self.device, op=call.op, clock_s=round(call.t_s, 9), **kept)

    def close(self) -> None:
        """Do nothing: the log outlives the device."""


def note_devices(log: SessionLog, devices: Devices) -> None:
    """Write each device's identity, and its temperatures if it reports any."""
    for kind, info in _infos(devices):
        log.note("device", device=kind, **info)
    note_temperatures(log, devices)


def note_temperatures(log: SessionLog, devices: Devices) -> None:
    """Write the temperatures that devices report; a device that does not answer does not end the capture."""
    if log.level == "off":
        return
    for device in (devices.modulator, devices.sensor, devices.stage):
        if device is None:
            continue
        try:
            found = device.temperatures_c()
        except DriverError as error:
            log.note("temperatures", device=device.name, problem=str(error))
        else:
            if found:
                log.note("temperatures", device=device.name, celsius=found)


def _infos(devices: Devices) -> list[tuple[str, dict[str, str]]]:
    modulator, sensor, stage = devices.modulator.info, devices.sensor.info, devices.stage
    found = [
        ("modulator", {"model": modulator.model, "serial": modulator.serial, "firmware": modulator.firmware}),
        ("sensor", {"model": sensor.model, "serial": sensor.serial, "driver": sensor.driver}),
    ]
    if stage is not None:
        info = stage.info
        found.append(("stage", {"model": info.model, "serial": info.serial, "firmware": info.firmware}))
    return found


def _user_and_programs() -> dict[str, Any]:
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container without an entry for its user
        user = ""
    return {
        "user": user,
        "host": socket.gethostname(),
        "gs2ci": __version__,
        "python": platform.python_version(),
        "system": platform.platform(),
        "command": sys.argv[:1] and [Path(sys.argv[0]).name, *sys.argv[1:]],
    }


def _line(level: str, event: str, figures: dict[str, Any]) -> str:
    row = {"at": datetime.now(UTC).isoformat(timespec="microseconds"), "level": level, "event": event, **figures}
    return json.dumps(row, ensure_ascii=False, default=str) + "\n"


def _shown(data: bytes) -> str:
    """Return a block as hexadecimal digits, a long one as length and checksum."""
    return data.hex() if len(data) <= _SHOWN_BYTES else f"{len(data)} bytes, crc32 {zlib.crc32(data):08x}"
