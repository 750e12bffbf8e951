"""A gate before a local web server that takes no secret itself: only who has the secret of the address gets through.

The server behind it listens on a port of 127.0.0.1 alone. Each connection carries one request, or one WebSocket, so
that each is checked: a browser may use a connection again for a request that another page makes.

Here: `Gate`. Not here: the check (`gs2ci.core.door`), what is served (`viewer`).
"""

import contextlib
import selectors
import socket
import threading
import time
from http import HTTPStatus
from typing import Final
from urllib.parse import quote

from gs2ci.core.door import LOCAL, MOST_CONNECTIONS, PARAMETER, Door

REQUEST_S: Final = 10.0
"""Time for the head of a request to arrive."""
LARGEST_HEAD: Final = 16_384
_CHUNK: Final = 65_536
_END: Final = b"\r\n\r\n"


class Gate:
    """Lets requests through to a server on this machine.

    Args:
        name: What is served, for the cookie and for messages: "gs2ci view".
        listener: The socket that is listened on.
        host: The address that it was bound to, as the user gave it.
        inner_port: Port of the server behind, on 127.0.0.1.
    """

    def __init__(self, name: str, listener: socket.socket, host: str, inner_port: int) -> None:
        self.door = Door(name, local=host in LOCAL)
        self.port = int(listener.getsockname()[1])
        shown = "localhost" if host == "0.0.0.0" else host  # noqa: S104
        self.address = f"http://{shown}:{self.port}/?{PARAMETER}={quote(self.door.secret)}"
        self._listener = listener
        self._inner_port = inner_port
        self._places = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self._thread = threading.Thread(target=self._accept, name="gate", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Take no more connections."""
        with contextlib.suppress(OSError):  # it may be closed
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()

    def _accept(self) -> None:
        while True:
            try:
                line, _ = self._listener.accept()
            except OSError:  # stopped
                return
            if self._places.acquire(blocking=False):
                threading.Thread(target=self._serve, args=(line,), name="gate", daemon=True).start()
            else:
                line.close()

    def _serve(self, line: socket.socket) -> None:
        try:
            with line, contextlib.suppress(OSError):  # either side may close it at any time
                self._answer(line)
        finally:
            self._places.release()

    def _answer(self, line: socket.socket) -> None:
        head, rest = _head_of(line)
        request, headers = _parsed(head)
        if request is None:
            _reply(line, HTTPStatus.BAD_REQUEST, "not understood")
            return
        path, _, query = request[1].partition("?")
        refused = self.door.refusal(self.port, lambda name: headers.get(name.lower(), ""), query)
        if refused is not None:
            _reply(line, *refused)
        elif path == "/" and self.door.knows_by_query(query):
            _reply(line, HTTPStatus.SEE_OTHER, "", f"Location: /\r\nSet-Cookie: {self.door.cookie(self.port)}\r\n")
        else:
            self._pass(line, _for_one_request(head, headers) + rest)

    def _pass(self, line: socket.socket, begun: bytes) -> None:
        """Connect with the server behind, and hand bytes to and fro until one side has ended."""
        with socket.create_connection(("127.0.0.1", self._inner_port), timeout=REQUEST_S) as inner:
            inner.sendall(begun)
            for one in (line, inner):
                one.settimeout(None)
            with selectors.DefaultSelector() as ready:
                ready.register(line, selectors.EVENT_READ, inner)
                ready.register(inner, selectors.EVENT_READ, line)
                while True:
                    for key, _ in ready.select():
                        source: socket.socket = key.fileobj  # type: ignore[assignment]
                        data = source.recv(_CHUNK)
                        if not data:
                            return
                        key.data.sendall(data)


def _head_of(line: socket.socket) -> tuple[bytes, bytes]:
    """Read the head of a request, which has to come in time; return it and what came behind it."""
    due_s, data = time.monotonic() + REQUEST_S, b""
    while _END not in data and len(data) <= LARGEST_HEAD:
        line.settimeout(max(due_s - time.monotonic(), 1e-3))
        part = line.recv(4096)
        if not part:
            break
        data += part
    head, end, rest = data.partition(_END)
    return (head, rest) if end else (b"", b"")


def _parsed(head: bytes) -> tuple[tuple[str, str] | None, dict[str, str]]:
    """Return method and path of a request, None if it is none, and its headers by their names in lower case."""
    first, *lines = head.decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not words[1].startswith("/") or not words[2].startswith("HTTP/1."):
        return None, {}
    headers: dict[str, str] = {}
    for text in lines:
        name, colon, value = text.partition(":")
        if not colon or name != name.strip() or name.lower() in headers:  # folded, malformed or twice: of no browser
            return None, {}
        headers[name.lower()] = value.strip()
    return (words[0], words[1]), headers


def _for_one_request(head: bytes, headers: dict[str, str]) -> bytes:
    """Return a head that asks the server to end the connection after its answer, unless it becomes a WebSocket."""
    if headers.get("upgrade", "").lower() == "websocket":
        return head + _END
    kept = [text for text in head.split(b"\r\n") if not text.lower().startswith(b"connection:")]
    return b"\r\n".join([*kept, b"Connection: close"]) + _END


def _reply(line: socket.socket, status: HTTPStatus, text: str, headers: str = "") -> None:
    body = text.encode()
    line.sendall(
        f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: text/plain; charset=utf-8\r\n"
        f"Cache-Control: no-store\r\nContent-Length: {len(body)}\r\n{headers}Connection: close\r\n\r\n".encode()
        + body
    )
