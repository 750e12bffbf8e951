"""Sending a command and polling until the panel has acknowledged or refused it. EXPERIMENTAL, as the package says.

Here: the exchange. Not here: what is asked (`driver`), the bytes (`packets`).
"""

from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.display_slm.packets import MalformedSlmReplyError, control, find_status, status_request
from gs2ci_drivers.failures import BadReplyError, NoAnswerError, RefusedError
from gs2ci_drivers.ports import BytePort, port_errors

POLL_S: Final = 0.015
COMMAND_TIMEOUT_S: Final = 1.5
STATUS_TIMEOUT_S: Final = 0.5
BOOT_TIMEOUT_S: Final = 30.0
WRITE_TIMEOUT_S: Final = 2.0
_BLOCK_BYTES: Final = 4096
_NOT_YET: Final = ("", "NO RESPONSE")
_BUSY: Final = "BS"
_REFUSED: Final = "NG"
_MAX_STALE_BLOCKS: Final = 64


class SlmLink:
    """The exchange with one panel.

    Args:
        name: Name of the device, for messages.
        port: The FIFO.
        clock: Where deadlines are kept.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock) -> None:
        self._name = name
        self._port = port
        self._clock = clock
        self._unsure = False

    def ask(self, text: str) -> str:
        """Send a command; return the panel's status text for it ("OK", or the requested value).

        Raises:
            NoAnswerError: No status within the deadline, or busy beyond the time it needs to boot.
            BadReplyError: A reply came that is no status.
            RefusedError: The panel says NG.
            DisconnectedError: The panel is gone.
        """
        return self.send(control(text), text)

    def send(self, frames: bytes, asked: str) -> str:
        """Send frames of any kind and wait for the panel's status; raises as `ask`."""
        self._drain(asked)
        self._unsure = True  # until its status has arrived, a late one could be taken for the next command's
        with port_errors(self._name, asked, timeout_s=WRITE_TIMEOUT_S):
            self._port.write(frames, WRITE_TIMEOUT_S)
        begin_s = self._clock.now_s()
        limit_s = COMMAND_TIMEOUT_S
        while (waited_s := self._clock.now_s() - begin_s) < limit_s:
            word = self._status(asked)
            if word == _BUSY:
                limit_s = BOOT_TIMEOUT_S
            elif word not in _NOT_YET:
                self._unsure = False
                if word == _REFUSED:
                    raise RefusedError(self._name, asked, _REFUSED, "could not execute the command")
                return word
            self._clock.sleep_s(POLL_S)
        raise NoAnswerError(self._name, asked, waited_s)

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _status(self, asked: str) -> str:
        buffer = b""
        deadline_s = self._clock.now_s() + STATUS_TIMEOUT_S
        with port_errors(self._name, asked, timeout_s=WRITE_TIMEOUT_S):
            self._port.write(status_request(), WRITE_TIMEOUT_S)
            while True:
                left_s = deadline_s - self._clock.now_s()
                buffer += self._port.read(_BLOCK_BYTES, max(left_s, 0.0))
                try:
                    word, buffer = find_status(buffer)
                except MalformedSlmReplyError as error:
                    raise BadReplyError(self._name, asked, buffer, error.problem, allowed=error.allowed) from error
                if word is not None:
                    return word
                if self._clock.now_s() >= deadline_s:
                    raise NoAnswerError(self._name, asked, STATUS_TIMEOUT_S)

    def _drain(self, asked: str) -> None:
        if self._unsure:
            self._clock.sleep_s(STATUS_TIMEOUT_S)  # let late statuses arrive, so that they can be discarded
        with port_errors(self._name, asked, timeout_s=WRITE_TIMEOUT_S):
            for _ in range(_MAX_STALE_BLOCKS):
                if not self._port.read(_BLOCK_BYTES, 0.0):
                    return
