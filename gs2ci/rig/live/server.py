"""The page of a live bench, served on this machine: who may control it, what happens at the end.

Only who knows the secret of the address enters (`gs2ci.core.door`). The first page that connects controls the bench:
only it may press buttons, by a token that it sends with each request. Other pages see the same but have no buttons. If
the controlling page sends nothing for `LAPSE_S`, or reports that it closes, it loses control, and all is disarmed.

A request has `REQUEST_S` to arrive, a connection without one `IDLE_S`; there are at most `MOST_CONNECTIONS`. Whoever
opens connections and sends nothing keeps nobody out.

Here: `LiveServer`. Not here: what the buttons do (`bench`).
"""

import contextlib
import json
import socket
import sys
import threading
import time
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, Final
from urllib.parse import quote

from gs2ci.core.door import LOCAL, MOST_CONNECTIONS, PARAMETER, Door, listening
from gs2ci.core.errors import Gs2ciError, reason_with_file
from gs2ci.core.json_text import parse_json
from gs2ci.rig.live.bench import LiveBench

LAPSE_S: Final = 4.0
"""After this time without a request the controlling page counts as gone."""
WATCH_S: Final = 0.25
STOP_S: Final = 0.05
"""How long the server may take to see that it is to stop."""
REQUEST_S: Final = 10.0
"""Time for a request to arrive, from its first wait on."""
IDLE_S: Final = 30.0
"""Time for which a connection that has been used may wait for the next request."""
LARGEST_REQUEST: Final = 4096
ASSETS: Final = {
    "/": ("live.html", "text/html; charset=utf-8"),
    "/live.css": ("live.css", "text/css; charset=utf-8"),
    "/live.js": ("live.js", "text/javascript; charset=utf-8"),
}
POLICY: Final = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'"
TOKEN: Final = "X-Live-Token"  # noqa: S105 - the name of a header


class LiveServer:
    """Serves a bench to browsers.

    Args:
        bench: The bench, begun.
        host: Address to listen on.
        port: Port; if it is in use, the next free one; 0 takes any.

    Raises:
        InputError: The server cannot listen there.
    """

    def __init__(self, bench: LiveBench, host: str = "127.0.0.1", port: int = 0) -> None:
        self._bench = bench
        self._lock = threading.Lock()
        self._holder = ""
        self._last_call_s = 0.0
        self._ended = threading.Event()
        self.door = Door("gs2ci live", local=host in LOCAL)
        self._name = "localhost" if host == "0.0.0.0" else host  # noqa: S104
        answer = partial(_Handler, self, _assets())
        self._server = listening(host, port, lambda address: _Listener(address, answer))
        self._threads = [
            threading.Thread(target=self._server.serve_forever, args=(STOP_S,), name="live server", daemon=True),
            threading.Thread(target=self._watch, name="live watch", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def port(self) -> int:
        """Get the port on which the server listens."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """Get the address of the page, with its secret."""
        return f"http://{self._name}:{self.port}/?{PARAMETER}={quote(self.door.secret)}"

    def stop(self) -> None:
        """Stop the server; its caller closes the bench."""
        self._ended.set()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def hold(self, token: str) -> bool:
        """Note that a page is connected; return whether it controls the bench, which it does if no other page does."""
        with self._lock:
            if not self._holder and token:
                self._holder = token
            if token != self._holder:
                return False
            self._last_call_s = time.monotonic()
            return True

    def leave(self, token: str) -> None:
        """End a page's control and disarm everything; if a page without control closes, nothing changes."""
        with self._lock:
            if not token or token != self._holder:
                return
            self._holder = ""
        self._disarm()

    def act(self, token: str, request: dict[str, Any]) -> tuple[HTTPStatus, dict[str, Any]]:
        """Carry out an action of the controlling page; refuse those of other pages."""
        if not token or not self.hold(token):
            return HTTPStatus.FORBIDDEN, {"error": "another page controls this bench; this page only shows it"}
        given = {key: value for key, value in request.items() if key != "action"}
        try:
            self._bench.act(str(request.get("action", "")), **given)
        except Gs2ciError as error:
            return HTTPStatus.BAD_REQUEST, {"error": str(error)}
        except Exception as error:  # the bench has disarmed everything, and the page says why
            return HTTPStatus.INTERNAL_SERVER_ERROR, {"error": reason_with_file(error) or type(error).__name__}
        return HTTPStatus.OK, {}

    def state(self, token: str) -> dict[str, Any]:
        """Return the data that a page shows, and whether it may press buttons."""
        holds = self.hold(token)
        view = self._bench.view()
        return view.state | {"holds": holds, "picture": view.number, "size": view.size}

    def picture(self, path: str) -> bytes | None:
        """Return a picture by its path; a query string is ignored."""
        view = self._bench.view()
        if path == "/picture.png":
            return view.picture or None
        index = path.removeprefix("/view/").removesuffix(".png")
        if path.startswith("/view/") and index.isdecimal() and int(index) < len(view.views):
            return view.views[int(index)]
        return None

    def _disarm(self) -> None:
        try:
            self._bench.act("disarm")
        except Gs2ciError:  # the bench is closed, and at rest
            return

    def _watch(self) -> None:
        """Disarm everything if the controlling page disappears without a message."""
        while not self._ended.wait(WATCH_S):
            self._server.end_the_silent()
            with self._lock:
                # The page's last action may still be running: the disarming below then waits for its end.
                gone = self._holder and time.monotonic() - self._last_call_s > LAPSE_S
                if gone:
                    self._holder = ""
            if gone:
                self._disarm()


_Assets = dict[str, tuple[bytes, str]]


class _Listener(ThreadingHTTPServer):
    """A server that ends connections on which nothing comes, and prints nothing when a browser closes one early."""

    daemon_threads = True
    request_queue_size = MOST_CONNECTIONS

    def __init__(self, *arguments: Any) -> None:
        self._due_s: dict[socket.socket, float] = {}
        self._open = 0
        self._due_lock = threading.Lock()
        super().__init__(*arguments)

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Accept a connection while there are not too many."""
        with self._due_lock:
            accepted = self._open < MOST_CONNECTIONS
            self._open += accepted
            if accepted:
                self._due_s[request] = time.monotonic() + REQUEST_S
        return accepted

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._due_lock:
                self._open -= 1
                self._due_s.pop(request, None)

    def expect(self, connection: socket.socket, within_s: float | None) -> None:
        """Note within which time something has to come on a connection; None while it is answered."""
        with self._due_lock:
            if within_s is None:
                self._due_s.pop(connection, None)
            else:
                self._due_s[connection] = time.monotonic() + within_s

    def end_the_silent(self) -> None:
        """End the connections on which nothing has come in time: their threads then end, too."""
        now_s = time.monotonic()
        with self._due_lock:
            late = [one for one, due_s in self._due_s.items() if due_s < now_s]
            for one in late:
                del self._due_s[one]
        for one in late:
            with contextlib.suppress(OSError):  # its other end may have closed it just now
                one.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _assets() -> _Assets:
    folder = resources.files("gs2ci.rig.live") / "page"
    return {path: ((folder / name).read_bytes(), kind) for path, (name, kind) in ASSETS.items()}


class _Handler(BaseHTTPRequestHandler):
    """One request of a browser: which answer it gets, by path.

    Args:
        live: What is served.
        assets: Content and kind of the page's files by path.
        connection: As `BaseHTTPRequestHandler` has them; the request is answered while the object is made.
    """

    protocol_version = "HTTP/1.1"
    server: _Listener

    def __init__(self, live: LiveServer, assets: _Assets, *connection: Any) -> None:
        self._live, self._assets = live, assets
        super().__init__(*connection)

    def handle_one_request(self) -> None:
        """Answer one request, which has to come in time."""
        super().handle_one_request()
        self.server.expect(self.connection, IDLE_S)

    def do_GET(self) -> None:
        self.server.expect(self.connection, None)
        path, _, query = self.path.partition("?")
        if not self._allowed(query):
            return
        if path == "/" and self._live.door.knows_by_query(query):
            self._enter()
        elif path in self._assets:
            self._answer(HTTPStatus.OK, *self._assets[path])
        elif path == "/state":
            self._tell(HTTPStatus.OK, self._live.state(self.headers.get(TOKEN, "")))
        elif (picture := self._live.picture(path)) is not None:
            self._answer(HTTPStatus.OK, picture, "image/png")
        else:
            self._tell(HTTPStatus.NOT_FOUND, {"error": "there is no such page"})

    def do_POST(self) -> None:
        body = self._body()
        if body is None or not self._allowed(self.path.partition("?")[2]):
            return
        if self.path == "/leave":
            self._live.leave(body.decode("ascii", "replace"))
            self._tell(HTTPStatus.OK, {})
            return
        try:
            request = parse_json(body.decode())
        except ValueError:
            request = None
        if self.path != "/act" or not isinstance(request, dict):
            self._tell(HTTPStatus.BAD_REQUEST, {"error": "not understood"})
            return
        self._tell(*self._live.act(self.headers.get(TOKEN, ""), request))

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class calls it so
        """Print nothing on the terminal."""

    def _body(self) -> bytes | None:
        """Read a request's body; None if it cannot be, which is answered."""
        given = self.headers.get("Content-Length", "0").strip()
        refused = None
        if self.headers.get("Transfer-Encoding") or len(self.headers.get_all("Content-Length", [])) > 1:
            refused = HTTPStatus.LENGTH_REQUIRED, "a request has one Content-Length, and no Transfer-Encoding"
        elif not (given.isascii() and given.isdecimal()):
            refused = HTTPStatus.BAD_REQUEST, "Content-Length is no number"
        elif len(given) > len(str(LARGEST_REQUEST)) or int(given) > LARGEST_REQUEST:
            refused = HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "too long"
        body = b"" if refused else self.rfile.read(int(given))
        self.server.expect(self.connection, None)
        if refused is None and len(body) < int(given):
            refused = HTTPStatus.BAD_REQUEST, "the request ended early"
        if refused is None:
            return body
        self.close_connection = True  # what follows on it would be taken for another request
        self._tell(refused[0], {"error": refused[1]})
        return None

    def _allowed(self, query: str) -> bool:
        refused = self._live.door.refusal(self._live.port, lambda name: self.headers.get(name, ""), query)
        if refused is None:
            return True
        self._tell(refused[0], {"error": refused[1]})
        return False

    def _enter(self) -> None:
        """Give a browser its cookie and send it to the address without the secret."""
        cookie = self._live.door.cookie(self._live.port)
        self._answer(HTTPStatus.SEE_OTHER, b"", "text/plain", Location="/", Set_Cookie=cookie)

    def _tell(self, status: HTTPStatus, answer: dict[str, Any]) -> None:
        self._answer(status, json.dumps(answer).encode(), "application/json")

    def _answer(self, status: HTTPStatus, body: bytes, kind: str, **more: str) -> None:
        self.send_response(status)
        for name, value in {name.replace("_", "-"): value for name, value in more.items()}.items():
            self.send_header(name, value)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Cache-Control": "no-store",
            "Content-Security-Policy": POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
