"""One tagged request and its one reply, with deadlines, repetition of repeatable requests, and resynchronisation.

Here: the exchange. Not here: what is asked (`driver`), the bytes (`packets`).
"""

from typing import Final

from gs2ci.core.clock import Clock
from gs2ci_drivers.failures import BadReplyError, LinkError, NoAnswerError, RefusedError
from gs2ci_drivers.lines import LineChannel
from gs2ci_drivers.ports import BytePort, with_one_retry
from gs2ci_drivers.scpi_modulator.packets import (
    TAGS,
    MalformedScpiReplyError,
    block_request,
    parse_error,
    parse_reply,
    request,
)

# A device drops an unfinished line after half a second of silence: then both sides expect the start of a line.
QUIET_S: Final = 0.6
# 512 bytes take half a second at 9600 baud, within the line's write timeout.
_CHUNK_BYTES: Final = 512
_QUEUE_LENGTH: Final = 32


class ScpiLink:
    """The exchange with one modulator.

    Args:
        name: Name of the device, for messages.
        port: The serial line.
        clock: Where deadlines are kept.
        incidents: Receives the problems from which the link recovered.
        timeout_s: How long a reply may take.
    """

    def __init__(self, name: str, port: BytePort, clock: Clock, *, incidents: list[str], timeout_s: float) -> None:
        self._name = name
        self._clock = clock
        self._incidents = incidents
        self._timeout_s = timeout_s
        self._lines = LineChannel(name, port, clock)
        # The session begins at a tag that most probably differs from the last one's end, so old replies are recognised.
        self._tag = int(clock.now_s() * 1e3) % TAGS
        self._unsure = True

    def ask(self, command: str) -> str:
        """Send a request that may be sent twice; a lost or damaged answer is requested again once.

        Raises:
            NoAnswerError, BadReplyError: No usable answer, twice.
            RefusedError: The device refused.
            DisconnectedError: The port is gone.
        """
        return with_one_retry(lambda: self.once(command), self._incidents)

    def once(self, command: str) -> str:
        """Send a request that must not be sent twice; return the reply's text.

        Raises:
            NoAnswerError, BadReplyError, RefusedError, DisconnectedError: As `ask`.
        """
        return self._checked(self._exchange([request(self._next_tag(), command)], command), command)

    def load(self, index: int, data: bytes) -> None:
        """Send one mask.

        Raises:
            NoAnswerError, BadReplyError, RefusedError, DisconnectedError: As `ask`.
        """
        message = block_request(self._next_tag(), index, data)
        chunks = [message[at : at + _CHUNK_BYTES] for at in range(0, len(message), _CHUNK_BYTES)]
        asked = f"SEQ:DATA {index}"
        body = self._exchange(chunks, asked)
        # After a block that it could not read, the device ignores all bytes until the line is silent.
        self._unsure = body == "ERR"
        self._checked(body, asked)

    def close(self) -> None:
        """Close the port."""
        self._lines.close()

    def _next_tag(self) -> int:
        self._tag = (self._tag + 1) % TAGS
        return self._tag

    def _checked(self, body: str, asked: str) -> str:
        if body != "ERR":
            return body
        code, text = self._take_errors()
        raise RefusedError(self._name, asked, code, text or "no reason given")

    def _take_errors(self) -> tuple[int, str]:
        """Empty the error queue; return its first entry, which caused the others."""
        first = (0, "")
        for _ in range(_QUEUE_LENGTH):
            asked = "SYST:ERR?"
            body = self._exchange([request(self._next_tag(), asked)], asked)
            try:
                entry = parse_error(body)
            except MalformedScpiReplyError as error:
                raise BadReplyError(self._name, asked, body.encode(), error.problem, allowed=error.allowed) from error
            if entry[0] == 0:
                break
            first = first if first[0] else entry
        return first

    def _exchange(self, chunks: list[bytes], asked: str) -> str:
        if self._unsure:
            self._clock.sleep_s(QUIET_S)
            self._lines.send(b"\n", asked)
        self._lines.drain(asked)
        self._unsure = True  # until the reply has arrived, device and host may be out of step
        for chunk in chunks:
            self._lines.send(chunk, asked)
        tag = self._tag
        deadline_s = self._clock.now_s() + self._timeout_s
        spoilt: tuple[bytes, MalformedScpiReplyError] | None = None
        while True:
            try:
                line = self._lines.line(deadline_s, asked)
            except NoAnswerError as error:
                if spoilt:
                    raise self._bad_reply(asked, *spoilt) from error
                raise
            try:
                reply = parse_reply(line)
            except MalformedScpiReplyError as error:
                spoilt = line, error
                continue
            if reply.tag == tag:
                self._unsure = False
                return reply.body

    def _bad_reply(self, asked: str, line: bytes, error: MalformedScpiReplyError) -> LinkError:
        return BadReplyError(self._name, asked, line, error.problem, allowed=error.allowed)
