"""The gate before a local server: who gets through, to what, and what ends the rest."""

import http.server
import socket
import threading
import time
import urllib.error
import urllib.request

import pytest

from gs2ci.evaluate import gate as gates
from gs2ci.evaluate.gate import Gate
from tests.patience import HANG_S


class Inner(http.server.BaseHTTPRequestHandler):
    """Tells what has reached it; a request to upgrade becomes an echo."""

    protocol_version = "HTTP/1.1"

    def do_GET(self):
        if self.headers.get("Upgrade"):
            self.connection.sendall(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
            while data := self.connection.recv(4096):
                self.connection.sendall(data[::-1])
            self.close_connection = True
            return
        body = f"{self.path} {self.headers.get('Connection')}".encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def gate():
    inner = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Inner)
    inner.daemon_threads = True
    thread = threading.Thread(target=inner.serve_forever, args=(0.01,))
    thread.start()
    made = Gate("gs2ci view", socket.create_server(("127.0.0.1", 0)), "127.0.0.1", inner.server_address[1])
    yield made
    made.stop()
    inner.shutdown()
    inner.server_close()
    thread.join()


def ask(gate, path, **headers):
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    request = urllib.request.Request(f"http://127.0.0.1:{gate.port}{path}", None, given)
    try:
        with urllib.request.urlopen(request, timeout=HANG_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def raw(gate, text):
    with socket.create_connection(("127.0.0.1", gate.port), timeout=HANG_S) as line:
        line.sendall(text)
        answer = b""
        while part := line.recv(65536):
            answer += part
        return answer


def test_a_browser_that_opens_the_address_gets_through_and_loses_the_secret_from_it(gate):
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with browser.open(gate.address, timeout=HANG_S) as answer:
        assert answer.url == f"http://127.0.0.1:{gate.port}/"
        assert answer.read() == b"/ close"
    with browser.open(f"http://127.0.0.1:{gate.port}/assets/x.js?y=1", timeout=HANG_S) as answer:
        assert answer.read() == b"/assets/x.js?y=1 close"


def test_nobody_else_gets_through(gate):
    assert ask(gate, "/") == (403, "open the address that `gs2ci view` has printed: it holds a secret")
    assert ask(gate, "/?secret=wrong")[0] == 403
    secret = gate.door.secret
    assert ask(gate, "/", X_Gs2ci_Secret=secret) == (200, "/ close")
    assert ask(gate, "/", X_Gs2ci_Secret=secret, Origin="http://evil.example")[0] == 403
    assert ask(gate, "/", X_Gs2ci_Secret=secret, Host="evil.example")[0] == 421
    upgrade = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{gate.port}\r\nUpgrade: websocket\r\n\r\n".encode()
    assert raw(gate, upgrade).startswith(b"HTTP/1.1 403")


def test_each_request_is_checked_because_a_connection_carries_one(gate):
    head = f"GET /a HTTP/1.1\r\nHost: localhost\r\nX-Gs2ci-Secret: {gate.door.secret}\r\nConnection: keep-alive\r\n\r\n"
    answer = raw(gate, head.encode() + b"GET /b HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert b"/a close" in answer
    assert b"/b" not in answer


def test_a_websocket_is_handed_on_in_both_directions(gate):
    with socket.create_connection(("127.0.0.1", gate.port), timeout=HANG_S) as line:
        line.sendall(
            f"GET /ws HTTP/1.1\r\nHost: localhost\r\nX-Gs2ci-Secret: {gate.door.secret}\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\n\r\n".encode()
        )
        assert line.recv(4096).startswith(b"HTTP/1.1 101")
        for text in (b"abc", b"x" * 1000):
            line.sendall(text)
            assert line.recv(4096) == text[::-1]


@pytest.mark.parametrize(
    "text",
    [
        b"\x16\x03\x01\x02\x00\r\n\r\n",
        b"GET\r\n\r\n",
        b"GET http://x/ HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\n folded\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"x" * 40_000,
    ],
)
def test_what_is_no_request_is_refused(gate, text, capsys):
    try:
        assert raw(gate, text).startswith(b"HTTP/1.1 400")
    except ConnectionResetError:  # it has sent more than is read
        assert len(text) > gates.LARGEST_HEAD
    assert capsys.readouterr().err == ""
    assert ask(gate, "/", X_Gs2ci_Secret=gate.door.secret)[0] == 200


def test_half_open_connections_keep_nobody_out_and_are_ended(gate, monkeypatch):
    monkeypatch.setattr(gates, "REQUEST_S", 0.5)
    lines = [socket.create_connection(("127.0.0.1", gate.port), timeout=HANG_S) for _ in range(100)]
    for i, line in enumerate(lines):
        line.sendall(b"GET / HT"[: i % 8])
    assert ask(gate, "/", X_Gs2ci_Secret=gate.door.secret)[0] == 200
    for line in lines:
        while line.recv(4096):
            pass
        line.close()


def test_connections_beyond_the_most_are_closed_at_once(monkeypatch):
    monkeypatch.setattr(gates, "MOST_CONNECTIONS", 2)
    made = Gate("gs2ci view", socket.create_server(("127.0.0.1", 0)), "0.0.0.0", 9)
    assert made.address.startswith(f"http://localhost:{made.port}/?secret=")
    lines = [socket.create_connection(("127.0.0.1", made.port), timeout=HANG_S) for _ in range(2)]
    until_s = time.monotonic() + HANG_S
    while made._places._value and time.monotonic() < until_s:
        time.sleep(0.01)
    with socket.create_connection(("127.0.0.1", made.port), timeout=HANG_S) as beyond:
        assert beyond.recv(1) == b""
    for line in lines:
        line.close()
    made.stop()


def test_a_server_behind_that_is_gone_ends_the_connection(gate):
    gate._inner_port = 1
    with pytest.raises((urllib.error.URLError, ConnectionError)):
        ask(gate, "/", X_Gs2ci_Secret=gate.door.secret)
