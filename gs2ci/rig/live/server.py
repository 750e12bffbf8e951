"""The page of a live bench, served on this machine: who may view it, who may control it, what happens at the end.

The first page that connects controls the bench: only it may press buttons, by a secret that it sends with each request.
Other pages see the same but have no buttons. If the controlling page sends nothing for `LAPSE_S`, or reports that it
closes, it loses control, and everything is disarmed. Requests for another host name are refused, so that a foreign web
page in the same browser cannot control the bench.

Here: `LiveServer`. Not here: what the buttons do (`bench`).
"""

import json
import sys
import threading
import time
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any, Final

from gs2ci.core.errors import Gs2ciError, InputError, reason_with_file
from gs2ci.core.json_text import parse_json
from gs2ci.rig.live.bench import LiveBench

LAPSE_S: Final = 4.0
"""After this time without a request the controlling page counts as gone."""
WATCH_S: Final = 0.25
LARGEST_REQUEST: Final = 4096
PORTS_TRIED: Final = 20
HIGHEST_PORT: Final = 65_535
ASSETS: Final = {
    "/": ("live.html", "text/html; charset=utf-8"),
    "/live.css": ("live.css", "text/css; charset=utf-8"),
    "/live.js": ("live.js", "text/javascript; charset=utf-8"),
}
POLICY: Final = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'"
TOKEN: Final = "X-Live-Token"  # noqa: S105 - the name of a header
LOCAL: Final = ("127.0.0.1", "localhost", "[::1]")


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
        self._local = host in LOCAL
        self._server = _listen(host, port, self)
        self._threads = [
            threading.Thread(target=self._server.serve_forever, name="live server", daemon=True),
            threading.Thread(target=self._watch, name="live watch", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def port(self) -> int:
        """Get the port on which the server listens."""
        return int(self._server.server_address[1])

    def stop(self) -> None:
        """Stop the server; its caller closes the bench."""
        self._ended.set()
        self._server.shutdown()
        self._server.server_close()
        for thread in self._threads:
            thread.join()

    def allows(self, name: str) -> bool:
        """Return whether a request with this host name may be answered."""
        return not self._local or name.rsplit(":", 1)[0] in LOCAL

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
            with self._lock:
                # The page's last action may still be running: the disarming below then waits for its end.
                gone = self._holder and time.monotonic() - self._last_call_s > LAPSE_S
                if gone:
                    self._holder = ""
            if gone:
                self._disarm()


_Assets = dict[str, tuple[bytes, str]]


class _Listener(ThreadingHTTPServer):
    """A server that prints nothing when a browser closes a connection early."""

    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _listen(host: str, port: int, live: LiveServer) -> ThreadingHTTPServer:
    if not 0 <= port <= HIGHEST_PORT:
        raise InputError(f"port {port}", allowed=f"0 to {HIGHEST_PORT}")
    tried = range(port, min(port + PORTS_TRIED, HIGHEST_PORT + 1)) if port else range(1)
    answer = partial(_Handler, live, _assets())
    for candidate in tried:
        try:
            return _Listener((host, candidate), answer)
        except OSError as error:
            reason = error
    raise InputError(
        f"nothing can be served at {host}, port {tried[0]} to {tried[-1]}: {reason}",
        remedy="choose another --port, or a --host of this machine such as 127.0.0.1",
    )


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

    def __init__(self, live: LiveServer, assets: _Assets, *connection: Any) -> None:
        self._live, self._assets = live, assets
        super().__init__(*connection)

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if not self._allowed():
            return
        if path in self._assets:
            self._answer(HTTPStatus.OK, *self._assets[path])
        elif path == "/state":
            self._tell(HTTPStatus.OK, self._live.state(self.headers.get(TOKEN, "")))
        elif (picture := self._live.picture(path)) is not None:
            self._answer(HTTPStatus.OK, picture, "image/png")
        else:
            self._tell(HTTPStatus.NOT_FOUND, {"error": "there is no such page"})

    def do_POST(self) -> None:
        length = int(self.headers.get("Content-Length") or 0)
        if not 0 <= length <= LARGEST_REQUEST:
            self.close_connection = True
            self._tell(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {"error": "too long"})
            return
        body = self.rfile.read(length)
        if not self._allowed():
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

    def _allowed(self) -> bool:
        if self._live.allows(self.headers.get("Host", "")):
            return True
        self._tell(HTTPStatus.MISDIRECTED_REQUEST, {"error": "the request was sent to another host name"})
        return False

    def _tell(self, status: HTTPStatus, answer: dict[str, Any]) -> None:
        self._answer(status, json.dumps(answer).encode(), "application/json")

    def _answer(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self.send_response(status)
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
