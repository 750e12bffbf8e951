r"""Zaber ASCII lines: building requests and reading answers. Pure; no port, no time.

    request  /DD A ID text[:CC]\n            address, axis, message id, checksum
    reply    @DD A [ID] OK|RJ BUSY|IDLE WW data[:CC]\r\n
    info     #DD A [ID] text
    alert    !DD A BUSY|IDLE WW [data]

Source: Zaber ASCII protocol manual, "Message format"; reference section 3.1. The driver imports this.
"""

import re
from dataclasses import dataclass

LONGEST_REQUEST = 80
"""Characters of a request with its end, by the protocol's default."""
MESSAGE_IDS = 100
"""Message ids run from 0 to 99."""

_CHECKSUM = re.compile(r"^(.*):([0-9A-Fa-f]{2})$", re.DOTALL)
_REPLY = re.compile(r"^@(\d{1,2}) (\d{1,2})(?: (\d{1,2}))? (OK|RJ) (BUSY|IDLE) ([A-Z-]{2})(?: (.*))?$")
_ALERT = re.compile(r"^!(\d{1,2}) (\d{1,2}) (BUSY|IDLE) ([A-Z-]{2})(?: (.*))?$")
_INFO = re.compile(r"^#\d{1,2} \d{1,2}(?: |$)")


@dataclass(frozen=True)
class ZaberReply:
    """A device's answer to a request.

    Args:
        address: Device.
        axis: Axis, 0 for the whole device.
        message_id: The request's id where it had one.
        accepted: OK or RJ.
        busy: Whether the axis (or any axis) moves.
        warning: Flag of highest priority, or "--".
        data: Value, or the reason of a rejection.
    """

    address: int
    axis: int
    message_id: int | None
    accepted: bool
    busy: bool
    warning: str
    data: str


@dataclass(frozen=True)
class Alert:
    """A message that a device sends without a request."""

    address: int
    axis: int
    busy: bool
    warning: str
    data: str


def checksum(body: str) -> str:
    """Return the two hex digits that make a message's bytes sum to zero.

    Args:
        body: What stands between the leading marker and the colon.

    `01 tools echo` gives `8F`.
    """
    return f"{-sum(body.encode('ascii')) & 0xFF:02X}"


def request(address: int, axis: int, message_id: int, text: str, *, with_checksum: bool) -> bytes:
    """Build a request.

    Raises:
        ValueError: Longer than a device accepts, or not plain ASCII.
    """
    body = f"{address:02d} {axis} {message_id:02d}" + (f" {text}" if text else "")
    line = f"/{body}:{checksum(body)}\n" if with_checksum else f"/{body}\n"
    if len(line) > LONGEST_REQUEST:
        raise ValueError(f"{len(line)} characters; a device takes at most {LONGEST_REQUEST}")
    return line.encode("ascii")


def parse(line: bytes) -> ZaberReply | Alert | None:
    """Read one line without its end; bytes before its last marker are noise and are dropped.

    Returns:
        None for an info, which only adds text to a reply.

    Raises:
        ValueError: Not a message, or its checksum is wrong.
    """
    text = line.decode("ascii", "replace")
    start = max(text.rfind(marker) for marker in "@#!")
    if start < 0:
        raise ValueError("no message begins with @, # or !")
    text = text[start:].rstrip("\r\n")
    if "�" in text:
        raise ValueError("bytes that are not ASCII")
    match = _CHECKSUM.match(text)
    if match:
        text, found = match.groups()
        wanted = checksum(text[1:])
        if found.upper() != wanted:
            raise ValueError(f"checksum {found}, should be {wanted}")
    return _parse_body(text)


def _parse_body(text: str) -> ZaberReply | Alert | None:
    if match := _REPLY.match(text):
        address, axis, message_id, result, status, warning, data = match.groups()
        return ZaberReply(
            int(address),
            int(axis),
            None if message_id is None else int(message_id),
            result == "OK",
            status == "BUSY",
            warning,
            data or "",
        )
    if match := _ALERT.match(text):
        address, axis, status, warning, data = match.groups()
        return Alert(int(address), int(axis), status == "BUSY", warning, data or "")
    if not _INFO.match(text):
        raise ValueError("not a reply, an info or an alert")
    return None
