"""The live page over HTTP and in a real browser: one holder, onlookers, and nothing armed when everybody has gone."""

import json
import socket
import tempfile
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from gs2ci.core.door import PORTS_TRIED
from gs2ci.core.errors import InputError
from gs2ci.rig.live import server as live_server
from gs2ci.rig.live.server import LiveServer
from tests.patience import HANG_S
from tests.rig.live.test_bench import at_rest, wait_for

CLICKS = 20


def ask(server, path, *, body=None, token="", secret=None, **headers):
    known = server.door.secret if secret is None else secret
    given = {"X-Live-Token": token, "X-Gs2ci-Secret": known} | {
        name.replace("_", "-"): value for name, value in headers.items()
    }
    request = urllib.request.Request(f"http://127.0.0.1:{server.port}{path}", body, given)
    try:
        with urllib.request.urlopen(request, timeout=HANG_S) as answer:
            return answer.status, answer.read(), answer.headers
    except urllib.error.HTTPError as error:
        return error.code, error.read(), error.headers


def press(server, token, **request):
    status, text, _ = ask(server, "/act", body=json.dumps(request).encode(), token=token)
    return status, json.loads(text)


def test_the_first_page_holds_the_bench_and_the_second_looks_on(served):
    bench, server = served
    assert json.loads(ask(server, "/state", token="a")[1])["holds"]
    seen = json.loads(ask(server, "/state", token="b")[1])
    assert not seen["holds"]
    assert seen["shown"] == "dark"
    assert press(server, "a", action="show", what="open") == (200, {})
    status, told = press(server, "b", action="disarm")
    assert (status, "another page controls" in told["error"]) == (403, True)
    assert press(server, "", action="disarm")[0] == 403
    assert bench.armed
    assert not json.loads(ask(server, "/state")[1])["holds"]  # a program that only reads


def test_a_holder_that_says_that_it_leaves_disarms_everything_and_makes_room(served):
    bench, server = served
    press(server, "a", action="show", what="open")
    press(server, "a", action="camera", on=True)
    ask(server, "/leave", body=b"b")
    assert len(bench.armed) == 2
    ask(server, "/leave", body=b"a")
    assert bench.armed == []
    assert at_rest(bench)
    assert press(server, "b", action="camera", on=True)[0] == 200


def test_a_holder_that_falls_silent_is_forgotten_and_everything_is_disarmed(served, monkeypatch):
    bench, server = served
    monkeypatch.setattr(live_server, "LAPSE_S", 0.3)
    press(server, "a", action="camera", on=True)
    wait_for(bench, lambda view: not view.state["armed"])
    assert at_rest(bench)


def test_what_cannot_be_is_answered_with_what_can(served):
    _, server = served
    status, told = press(server, "a", action="show", what="mask", index=99)
    assert (status, "mask 100; allowed: 1 to 4" in told["error"]) == (400, True)
    for index in ("x", None, 0.5, -1, float("inf")):
        assert press(server, "a", action="show", what="mask", index=index)[0] == 400
    for path, body in (
        ("/act", b"no json"),
        ("/act", b"[]"),
        ("/other", b"{}"),
        ("/act", b"[" * 4000),
        ("/act", b"\xff"),
    ):
        assert ask(server, path, body=body, token="a")[0] == 400
    assert ask(server, "/act", body=b"x" * 5000, token="a")[0] == 413
    assert ask(server, "/picture.png")[0] == 404  # none was taken
    assert ask(server, "/view/0.png")[0] == 404
    assert ask(server, "/../secret")[0] == 404


def test_an_action_that_no_device_refused_is_answered_as_well(served, monkeypatch, tmp_path, capsys):
    bench, server = served
    press(server, "a", action="camera", on=True)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    status, told = press(server, "a", action="take")
    assert (status, "No such file" in told["error"]) == (500, True)
    assert bench.armed == []
    assert "Traceback" not in capsys.readouterr().err


def test_another_hosts_name_is_refused_and_the_page_may_load_nothing_from_elsewhere(standing):
    _, server = standing
    assert ask(server, "/state", Host="evil.example")[0] == 421
    assert ask(server, "/act", body=b"{}", token="a", Host="evil.example:80")[0] == 421
    status, page, headers = ask(server, "/")
    assert status == 200
    assert b"http" not in page.replace(b"http-equiv", b"")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'")


def raw(server, text, *, end=True):
    """Send bytes as they are, and return all that comes back until the connection ends."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=HANG_S) as line:
        line.sendall(text)
        if end:
            line.shutdown(socket.SHUT_WR)
        answer = b""
        while part := line.recv(65536):
            answer += part
    return answer


def request_of(server, head, body=b""):
    secret = f"Host: localhost\r\nX-Gs2ci-Secret: {server.door.secret}\r\nConnection: close\r\n"
    return (head[0] + "\r\n" + secret + "".join(f"{line}\r\n" for line in head[1:]) + "\r\n").encode() + body


@pytest.mark.parametrize("path", ["/", "/live.js", "/live.css", "/state", "/picture.png", "/view/0.png", "/none"])
def test_nothing_is_told_without_the_secret(standing, path):
    _, server = standing
    for secret in ("", "wrong", server.door.secret[:-1], server.door.secret + "x", "\xff\xfe"):
        status, told, _ = ask(server, path, token="a", secret=secret)
        assert (status, b"has printed" in told) == (403, True)
    assert ask(server, f"{path}?secret=wrong", token="a", secret="")[0] == 403
    assert ask(server, f"{path}?" + "&".join(["secret=x"] * 99), token="a", secret="")[0] == 403


def test_without_the_secret_no_action_is_taken_and_no_control_given(standing):
    bench, server = standing
    for path, body in (("/act", b'{"action": "show", "what": "open"}'), ("/leave", b"a")):
        assert ask(server, path, body=body, token="a", secret="")[0] == 403
    assert bench.armed == []
    assert server._holder == ""


def test_the_printed_address_gives_a_cookie_and_leads_to_one_without_the_secret(standing):
    _, server = standing
    assert server.door.secret in server.address
    path = server.address.partition(str(server.port))[2]
    answer = raw(server, f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode()).decode()
    assert answer.startswith("HTTP/1.1 303")
    assert "\r\nLocation: /\r\n" in answer
    cookie = next(line for line in answer.splitlines() if line.startswith("Set-Cookie: "))
    assert cookie.endswith("; Path=/; HttpOnly; SameSite=Strict")
    given = cookie.removeprefix("Set-Cookie: ").partition(";")[0]
    assert given.startswith(f"gs2ci-live-{server.port}=")
    assert ask(server, "/", secret="", Cookie=f"other=1; {given}")[0] == 200
    for wrong in (given[:-1], given.replace("live", "lift"), "=;;=\x01", "gs2ci-live-1=" + server.door.secret):
        assert ask(server, "/", secret="", Cookie=wrong)[0] == 403


def test_each_bench_has_a_secret_of_its_own(make_live):
    one, two = LiveServer(make_live()), LiveServer(make_live())
    assert one.door.secret != two.door.secret
    assert len(one.door.secret) >= 32
    assert ask(two, "/", secret=one.door.secret)[0] == 403
    one.stop()
    two.stop()


def test_another_web_page_is_refused_even_with_the_secret(served):
    bench, server = served
    body = b'{"action": "show", "what": "open"}'
    for origin in ("http://evil.example", "null", f"https://127.0.0.1:{server.port}", "http://127.0.0.1:1"):
        assert ask(server, "/act", body=body, token="a", Origin=origin)[0] == 403
    assert bench.armed == []
    assert ask(server, "/act", body=body, token="a", Origin=f"http://127.0.0.1:{server.port}")[0] == 200


def test_another_address_is_served_with_the_secret_alone(make_live):
    bench = make_live()
    server = LiveServer(bench, "0.0.0.0")
    assert server.address.startswith(f"http://localhost:{server.port}/?secret=")
    assert ask(server, "/state", secret="", Host="bench.lab")[0] == 403
    assert ask(server, "/state", Host="bench.lab")[0] == 200
    server.stop()


@pytest.mark.parametrize("length", ["abc", "-1", "+2", "0x2", "2.0", "²", "", "1_0"])
def test_a_length_that_is_no_number_is_an_answer(standing, capsys, length):
    _, server = standing
    answer = raw(server, request_of(server, ["POST /act HTTP/1.1", f"Content-Length: {length}"], b"{}"))
    assert answer.startswith(b"HTTP/1.1 400")
    assert b"Content-Length is no number" in answer
    assert capsys.readouterr().err == ""
    assert ask(server, "/state")[0] == 200


@pytest.mark.parametrize(
    ("lines", "body", "status"),
    [
        (["Content-Length: 99999999999999999999"], b"", b"413"),
        (["Content-Length: 5000"], b"x" * 5000, b"413"),
        (["Content-Length: 2", "Content-Length: 3"], b"{}", b"411"),
        (["Transfer-Encoding: chunked"], b"2\r\n{}\r\n0\r\n\r\n", b"411"),
        (["Content-Length: 50"], b"{}", b"400"),
    ],
)
def test_a_body_that_cannot_be_read_is_an_answer_and_ends_the_connection(standing, capsys, lines, body, status):
    _, server = standing
    answer = raw(server, request_of(server, ["POST /act HTTP/1.1", *lines], body))
    assert answer.startswith(b"HTTP/1.1 " + status)
    assert answer.count(b"HTTP/1.1") == 1
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "text",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
        b"GET\r\n\r\n",
        b"BREW / HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 200 + b"\r\n",
        b"GET /" + b"x" * 70_000 + b" HTTP/1.1\r\n\r\n",
        b"POST /act HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"",
    ],
)
def test_what_is_no_request_is_survived_without_a_word_on_the_terminal(standing, capsys, text):
    _, server = standing
    raw(server, text)
    assert ask(server, "/state")[0] == 200
    assert capsys.readouterr().err == ""


def test_a_hundred_half_open_connections_leave_the_bench_responsive_and_are_ended(served, monkeypatch):
    bench, server = served
    monkeypatch.setattr(live_server, "REQUEST_S", 1.0)
    begun = [b"", b"GET / HT", b"POST /act HTTP/1.1\r\nContent-Length: 40\r\n\r\n{", b"GET / HTTP/1.1\r\nX: "]
    lines = []
    for i in range(100):
        line = socket.create_connection(("127.0.0.1", server.port), timeout=HANG_S)
        line.sendall(begun[i % len(begun)])
        lines.append(line)
    assert press(server, "a", action="show", what="open") == (200, {})
    assert bench.armed
    assert json.loads(ask(server, "/state", token="a")[1])["holds"]
    for line in lines:
        while line.recv(4096):  # whatever is answered, it is ended
            pass
        line.close()
    until_s = time.monotonic() + HANG_S
    while server._server._open > 1 and time.monotonic() < until_s:
        time.sleep(0.02)
    assert server._server._open <= 1


def test_connections_beyond_the_most_are_closed_at_once_and_make_room_again(served, monkeypatch):
    _, server = served
    monkeypatch.setattr(live_server, "MOST_CONNECTIONS", 3)
    lines = [socket.create_connection(("127.0.0.1", server.port), timeout=HANG_S) for _ in range(3)]
    until_s = time.monotonic() + HANG_S
    while server._server._open < 3 and time.monotonic() < until_s:
        time.sleep(0.02)
    with socket.create_connection(("127.0.0.1", server.port), timeout=HANG_S) as beyond:
        assert beyond.recv(1) == b""
    for line in lines:
        line.close()
    while server._server._open and time.monotonic() < until_s:
        time.sleep(0.02)
    assert ask(server, "/state")[0] == 200


def test_a_connection_that_is_used_no_longer_is_ended(served, monkeypatch):
    _, server = served
    monkeypatch.setattr(live_server, "IDLE_S", 0.2)
    text = request_of(server, ["GET /state HTTP/1.1"]).replace(b"Connection: close\r\n", b"")
    answer = raw(server, text, end=False)
    assert answer.startswith(b"HTTP/1.1 200")


def test_a_taken_port_gives_way_to_the_next_and_one_that_is_none_is_refused(make_live):
    bench = make_live()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        other = LiveServer(bench, port=port)
        assert port < other.port < port + PORTS_TRIED
        other.stop()
    with pytest.raises(InputError, match="port 70000"):
        LiveServer(bench, port=70_000)
    with pytest.raises(InputError, match=r"nothing can be served at 192\.0\.2\.1"):
        LiveServer(bench, "192.0.2.1")


def open_page(tab, server, width=1600, height=1000):
    tab.ask("Emulation.setEmulatedMedia", media="screen")
    tab.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
    tab.complaints.clear()
    tab.requests.clear()
    tab.ask("Page.navigate", url=server.address)
    until(tab, "document.readyState === 'complete' && document.title.startsWith('Live: ')")
    return tab


def until(tab, script):
    end = time.monotonic() + HANG_S
    while not (found := tab.run(script)) and time.monotonic() < end:
        time.sleep(0.02)
    assert found, (script, tab.run("document.body.innerText"))


def click(tab, name):
    until(tab, f"!document.getElementById('{name}').disabled")
    tab.run(f"document.getElementById('{name}').click()")


def leave(tab):
    tab.ask("Page.navigate", url="about:blank")


def test_an_alignment_in_a_browser(served, tab):
    bench, server = served
    open_page(tab, server)
    assert tab.run("document.getElementById('armed').textContent") == "nothing is armed"
    hidden = "[...document.querySelectorAll('[hidden]')].map(one => getComputedStyle(one).display)"
    assert set(tab.run(hidden)) == {"none"}
    assert tab.run("document.getElementById('picture').hidden")
    click(tab, "camera")
    click(tab, "open")
    until(tab, "document.getElementById('armed').textContent.includes('everything open')")
    until(tab, "document.getElementById('picture').naturalWidth === 128")
    until(tab, "Number(document.getElementById('sharpness').textContent) > 0")
    assert tab.run("document.querySelectorAll('#histogram rect').length") == 64
    tab.run("document.getElementById('exposure').value = 30")
    click(tab, "expose")
    tab.run("document.getElementById('mask').value = 2")
    click(tab, "show")
    until(tab, "document.getElementById('armed').textContent.includes('mask 2')")
    until(tab, "document.querySelectorAll('#arrows line').length > 3")
    assert "px" in tab.run("document.getElementById('residual').textContent")
    click(tab, "on-x")
    click(tab, "take")
    until(tab, "document.querySelectorAll('#views img').length === 4")
    until(tab, "[...document.querySelectorAll('#views img')].every(one => one.naturalWidth === 128)")
    assert tab.run("document.getElementById('armed').textContent") == "nothing is armed"
    click(tab, "camera")
    until(tab, "document.getElementById('camera').textContent === 'Switch off'")
    assert tab.complaints == []
    assert all(url.startswith((f"http://127.0.0.1:{server.port}/", "data:")) for url in tab.requests)
    leave(tab)
    wait_for(bench, lambda view: not view.state["armed"])
    assert at_rest(bench)


@pytest.mark.parametrize("width", [400, 1600])
def test_the_page_fits_its_window(served, tab, width):
    _, server = served
    open_page(tab, server, width)
    click(tab, "camera")
    until(tab, "document.getElementById('picture').naturalWidth === 128")
    assert tab.run("document.documentElement.scrollWidth") <= width
    small = "[...document.querySelectorAll('button')].filter(b => b.offsetParent && b.offsetHeight < 40).length"
    assert tab.run(small) == 0
    shot = tab.shoot()
    assert shot.shape[1] == width
    assert len(np.unique(shot.reshape(-1, 3), axis=0)) > 30
    leave(tab)


def test_an_onlooker_can_press_nothing(served, tab):
    bench, server = served
    press(server, "somebody", action="camera", on=True)
    open_page(tab, server)
    for _ in range(3):
        ask(server, "/state", token="somebody")
    until(tab, "!document.getElementById('role').hidden")
    assert tab.run("[...document.querySelectorAll('button, input, select')].every(one => one.disabled)")
    until(tab, "document.getElementById('picture').naturalWidth === 128")
    leave(tab)
    assert bench.armed == ["the camera streams"]


def test_twenty_clicks_in_random_order_leave_nothing_armed(served, tab):
    bench, server = served
    rng = np.random.default_rng(20)
    open_page(tab, server)
    names = ["camera", "expose", "dark", "open", "sequence", "show", "on-x", "back-x", "take", "disarm"]
    armed = 0
    for name in rng.permutation(names * (CLICKS // len(names))):
        if rng.random() < 0.7:  # else whether it may be pressed or not
            until(tab, "!document.getElementById('dark').disabled")
        tab.run(f"document.getElementById('{name}').click()")
        time.sleep(float(rng.uniform(0, 0.1)))
        armed += bool(bench.armed)
    assert armed, "nothing was ever armed"
    leave(tab)
    wait_for(bench, lambda view: not view.state["armed"])
    world = bench._rig.bench.world
    bench.close()
    assert at_rest(bench)
    stage, now_s = bench._rig.bench.stage, world.clock.now_s()
    world.clock.sleep_s(1.0)
    assert stage.positions_mm_at(now_s) == stage.positions_mm_at(world.clock.now_s())
    assert world.masks_between(now_s, world.clock.now_s()) == ()
