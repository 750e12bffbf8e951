"""The live page over HTTP and in a real browser: one holder, onlookers, and nothing armed when everybody has gone."""

import json
import socket
import tempfile
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.rig.live import server as live_server
from gs2ci.rig.live.server import LiveServer
from tests.patience import HANG_S
from tests.rig.live.test_bench import at_rest, wait_for

CLICKS = 20


def ask(server, path, *, body=None, token="", **headers):
    given = {"X-Live-Token": token} | {name.replace("_", "-"): value for name, value in headers.items()}
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


def test_another_hosts_name_is_refused_and_the_page_may_load_nothing_from_elsewhere(served):
    _, server = served
    assert ask(server, "/state", Host="evil.example")[0] == 421
    assert ask(server, "/act", body=b"{}", token="a", Host="evil.example:80")[0] == 421
    status, page, headers = ask(server, "/")
    assert status == 200
    assert b"http" not in page.replace(b"http-equiv", b"")
    assert headers["Content-Security-Policy"].startswith("default-src 'none'")


def test_a_taken_port_gives_way_to_the_next_and_one_that_is_none_is_refused(make_live):
    bench = make_live()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        other = LiveServer(bench, port=port)
        assert port < other.port < port + live_server.PORTS_TRIED
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
    tab.ask("Page.navigate", url=f"http://127.0.0.1:{server.port}/")
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
