"""Sending a command and polling until the panel has acknowledged or refused it. EXPERIMENTAL, as the package says.

By SlmCtrl.m (Santec Corporation, 2022): a status says NG or ER where a command failed, NO RESPONSE or TO where there is
none yet (CheckRecv, RequestReceiveData), and BS where the panel was busy and did not take the command (the manual of
SLMFunc, SLM_Ctrl_ReadSU: "about 40 seconds for power ON and phase table expand"), which is then sent again. Behind an
image the first request waits: "without waiting here it fails however often one tries" (slm_Ctrl_WriteMI, in Japanese).

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
BUSY_TIMEOUT_S: Final = 60.0
"""Longer than the 40 s of SLM_Ctrl_ReadSU and SLM_Ctrl_WriteVI."""
BUSY_STEP_S: Final = 1.0
IMAGE_S: Final = 0.15
WRITE_TIMEOUT_S: Final = 2.0
_BLOCK_BYTES: Final = 4096
_NOT_YET: Final = ("", "NO RESPONSE", "TO")
_BUSY: Final = "BS"
_REFUSED: Final = {"NG": "could not execute the command", "ER": "an error in the panel"}
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

    def ask(self, text: str, limit_s: float = COMMAND_TIMEOUT_S) -> str:
        """Send a command, again while the panel is busy; return its status text ("OK", or the requested value).

        Args:
            text: The command.
            limit_s: How long the panel may take for it.

        Raises:
            NoAnswerError: No status within the deadline, or busy beyond the time that the panel needs to boot.
            BadReplyError: A reply came that is no status.
            RefusedError: The panel says NG or ER.
            DisconnectedError: The panel is gone.
        """
        begin_s = self._clock.now_s()
        while (word := self._send(control(text), text, limit_s)) == _BUSY:
            waited_s = self._clock.now_s() - begin_s
            if waited_s > BUSY_TIMEOUT_S:
                raise NoAnswerError(self._name, text, waited_s)
            self._clock.sleep_s(BUSY_STEP_S)
        return word

    def send_image(self, frames: bytes, asked: str) -> None:
        """Send the frames of an image and wait for the panel's status; raises as `ask`."""
        word = self._send(frames, asked, COMMAND_TIMEOUT_S, IMAGE_S)
        if word == _BUSY:
            raise RefusedError(self._name, asked, _BUSY, "was busy and has not taken the image")

    def _send(self, frames: bytes, asked: str, limit_s: float, before_s: float = 0.0) -> str:
        self._drain(asked)
        self._unsure = True  # until its status has arrived, a late one could be taken for the next command's
        with port_errors(self._name, asked, timeout_s=WRITE_TIMEOUT_S):
            self._port.write(frames, WRITE_TIMEOUT_S)
        self._clock.sleep_s(before_s)
        begin_s, missed = self._clock.now_s(), False
        while (waited_s := self._clock.now_s() - begin_s) < limit_s:
            word = self._status(asked)
            missed = missed or word is None
            if word is not None and word not in _NOT_YET:
                self._unsure = missed  # the status that was late, or another one, may still come
                if word[:2] in _REFUSED:
                    raise RefusedError(self._name, asked, word[:2], _REFUSED[word[:2]])
                return _BUSY if word.startswith(_BUSY) else word
            self._clock.sleep_s(POLL_S)
        raise NoAnswerError(self._name, asked, waited_s)

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _status(self, asked: str) -> str | None:
        """Return the panel's status, None if none comes: Santec's own driver then asks again, too."""
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
                    return None

    def _drain(self, asked: str) -> None:
        if self._unsure:
            self._clock.sleep_s(STATUS_TIMEOUT_S)  # let late statuses arrive, so that they can be discarded
        with port_errors(self._name, asked, timeout_s=WRITE_TIMEOUT_S):
            for _ in range(_MAX_STALE_BLOCKS):
                if not self._port.read(_BLOCK_BYTES, 0.0):
                    return
