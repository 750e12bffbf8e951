"""A live bench by its actions: what it shows, what it tells, and that nothing stays armed."""

import json
import sys
import threading
import time

import cv2
import numpy as np
import pytest

from gs2ci.core.errors import DeviceError, InputError
from gs2ci.rig.live import bench as live_bench
from gs2ci.rig.live.bench import LiveBench
from gs2ci.rig.opening import load_rig
from gs2ci_drivers.failures import AccessError, OutOfRangeError
from gs2ci_drivers.v4l2.setup import OpenCamera
from tests.patience import HANG_S
from tests.rig.live.conftest import MODULATOR


def wait_for(bench, done):
    until = time.monotonic() + HANG_S
    while not done(bench.view()) and time.monotonic() < until:
        time.sleep(0.01)
    assert done(bench.view()), bench.view().state
    return bench.view()


def pictures(bench, count=2):
    """Wait until so many more pictures have come."""
    number = bench.view().number + count
    return wait_for(bench, lambda view: view.number >= number)


def hasten(monkeypatch, *, camera):
    """Spare the test a person's pace: pictures come as fast as they are computed, without them the clock strides."""
    monkeypatch.setattr(live_bench, "PICTURES_PER_S", 1000.0 if camera else 5.0)


def at_rest(bench):
    world = bench._rig.bench.world
    now_s = world.clock.now_s()
    return not world.masks_between(now_s - 1e-6, now_s) and not bench._rig.bench.sensor.streaming


def test_nothing_is_armed_before_a_button_is_pressed(make_live):
    bench = make_live()
    assert bench.armed == []
    assert at_rest(bench)
    state = bench.view().state
    assert (state["kind"], state["masks"], state["shown"]) == ("simulated", 4, "dark")
    assert state["axes"]["x"]["min_mm"] == 0.0


@pytest.mark.parametrize("kind", ["v4l2", "genicam"])
def test_the_camera_shows_what_the_modulator_shows(make_live, kind):
    bench = make_live(kind)
    bench.act("camera", on=True)
    dark = pictures(bench).state["figures"]
    bench.act("show", what="open")
    assert bench.armed == ["the modulator shows everything open", "the camera streams"]
    view = pictures(bench)
    assert view.state["figures"]["mean_dn"] > dark["mean_dn"] + 100
    picture = cv2.imdecode(np.frombuffer(view.picture, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (96, 128, 3)
    assert picture.std() > 5
    assert sum(view.state["figures"]["histogram"]) == 96 * 128
    bench.act("show", what="dark")
    assert pictures(bench).state["figures"]["mean_dn"] == pytest.approx(dark["mean_dn"], abs=1.0)
    bench.act("camera", on=False)
    assert bench.armed == []
    assert at_rest(bench)


def test_saturation_grows_with_the_exposure_and_is_told(make_live):
    bench = make_live()
    bench.act("camera", on=True)
    bench.act("show", what="open")
    shares = []
    for seconds in (0.005, 1.0):
        bench.act("exposure", seconds=seconds)
        shares.append(pictures(bench).state["figures"]["saturated"])
    assert shares[0] < 0.01
    assert shares[1] > 0.9


def test_the_residual_of_a_mask_is_where_the_bench_has_it(make_live):
    world = "[world.effects.misregistration]\nright_px = 3.0\ndown_px = -2.0\n"
    bench = make_live(world=world)
    bench.act("camera", on=True)
    bench.act("exposure", seconds=0.03)
    bench.act("show", what="mask", index=1)
    residual = pictures(bench, 3).state["residual"]
    assert len(residual["arrows"]) >= 4
    # The effect moves the modulator's pixels, of which two make one of the sensor's.
    found = (residual["down_px"], residual["right_px"])
    assert np.hypot(*found) > 0.5
    for _, _, down, right in residual["arrows"]:
        assert (down, right) == pytest.approx(found, abs=1.01)
    bench.act("show", what="sequence")
    assert pictures(bench).state["residual"] is None


def test_a_mask_goes_dark_by_itself_unless_somebody_is_there(make_live, monkeypatch):
    monkeypatch.setattr(live_bench, "HOLD_S", 2.0)
    monkeypatch.setattr(live_bench, "RENEWED_S", 1.5)
    hasten(monkeypatch, camera=False)
    bench = make_live()
    world = bench._rig.bench.world
    bench.act("show", what="mask", index=0)
    begin_s = world.clock.now_s()
    wait_for(bench, lambda view: world.clock.now_s() - begin_s > 5.0)
    assert not at_rest(bench)  # it was begun anew
    # As if the process were gone: nobody begins it anew, and nobody says goodbye.
    monkeypatch.setattr(bench, "_renew", lambda: world.clock.sleep_s(0.1))
    begin_s = world.clock.now_s()
    wait_for(bench, lambda view: world.clock.now_s() - begin_s > 3.0)
    assert at_rest(bench)


@pytest.mark.parametrize("modulator", [MODULATOR, 'kind = "video"'])
@pytest.mark.parametrize("camera", [False, True])
def test_all_masks_are_shown_in_turn(make_live, monkeypatch, modulator, camera):
    hasten(monkeypatch, camera=camera)
    bench = make_live(modulator=modulator)
    world = bench._rig.bench.world
    bench.act("camera", on=camera)
    if camera:  # few frames to a second of the bench's: each is computed
        bench.act("exposure", seconds=0.05)
    begin_s = world.clock.now_s()
    bench.act("show", what="sequence")
    wait_for(bench, lambda view: world.clock.now_s() - begin_s > 4.0)
    assert bench.armed[0] == "the modulator shows all masks in turn"
    shown = [mask.levels.tobytes() for mask in world.masks_between(begin_s, world.clock.now_s())]
    assert len(set(shown)) == 4
    assert shown[4] == shown[0]


@pytest.mark.parametrize("what", ["mask", "sequence"])
@pytest.mark.parametrize(("modulator", "camera"), [('kind = "video"', True), ('kind = "santec"', False)])
def test_a_panel_that_the_host_steps_goes_on_showing(make_live, monkeypatch, modulator, camera, what):
    monkeypatch.setattr(live_bench, "HOLD_S", 1.2)
    monkeypatch.setattr(live_bench, "RENEWED_S", 0.8)
    hasten(monkeypatch, camera=camera)
    bench = make_live(modulator=modulator, world="panel_response_s = 0.0")  # else each mask fades into the next
    world = bench._rig.bench.world
    bench.act("camera", on=camera)
    if camera:  # few frames to a second of the bench's: each is computed
        bench.act("exposure", seconds=0.1)
    begin_s = world.clock.now_s()
    bench.act("show", what=what)
    shown_s = world.clock.now_s()
    view = wait_for(bench, lambda view: world.clock.now_s() - shown_s > 5.0)
    assert len(view.state["armed"]) == 1 + camera
    assert not [note for note in view.state["notes"] if "modulator" in note]
    now_s = world.clock.now_s()
    lit = [mask for mask in world.masks_between(begin_s, now_s) if mask.levels.any()]
    assert len({mask.levels.tobytes() for mask in lit}) == {"mask": 1, "sequence": 4}[what]
    assert lit[-1].end_s > now_s - 0.5
    assert sum(min(mask.end_s, now_s) - max(mask.start_s, shown_s) for mask in lit if mask.end_s > shown_s) > 2.5


def test_the_stage_is_jogged_within_its_limits(make_live):
    bench = make_live()
    before = bench.view().state["axes"]["x"]["mm"]
    bench.act("jog", axis="x", mm=0.5)
    assert bench.view().state["axes"]["x"]["mm"] == pytest.approx(before + 0.5, abs=1e-3)
    with pytest.raises(InputError, match="x by at most 10 mm"):
        bench.act("jog", axis="x", mm=11.0)
    with pytest.raises(InputError, match="jog 'y'"):
        bench.act("jog", axis="y", mm=1.0)
    bench.act("camera", on=True)
    for _ in range(int(bench.view().state["axes"]["x"]["mm"] // 10)):
        bench.act("jog", axis="x", mm=-10.0)
    with pytest.raises(OutOfRangeError, match="allowed"):
        bench.act("jog", axis="x", mm=-10.0)
    assert bench.armed == ["the camera streams"]  # a refused step changes nothing
    pictures(bench)
    # That nobody read the camera meanwhile is no loss to tell of.
    assert all("allowed" in note for note in bench.view().state["notes"])


def told_while(bench, action, **given):
    """Press a button; return what the page may have said was armed meanwhile, each once."""
    done, told = threading.Event(), []

    def press():
        try:
            bench.act(action, **given)
        finally:
            done.set()

    before = bench.view().state["armed"]
    pressing = threading.Thread(target=press)
    pressing.start()
    while not done.wait(0.001):
        if (armed := bench.view().state["armed"]) not in (before, *told):
            told.append(armed)
    pressing.join()
    return told


def test_what_moves_or_is_taken_is_told_meanwhile(make_live, monkeypatch):
    bench = make_live()
    sleep = bench._devices.clock.sleep_s
    monkeypatch.setattr(bench._devices.clock, "sleep_s", lambda seconds: (time.sleep(0.005), sleep(seconds)))
    assert told_while(bench, "jog", axis="x", mm=5.0) == [["the stage moves"]]
    monkeypatch.setattr(bench._devices.clock, "sleep_s", sleep)  # an exposure takes long enough to be seen
    bench.act("camera", on=True)
    assert ["one exposure is taken"] in told_while(bench, "take")
    assert bench.view().state["armed"] == []
    assert not bench.view().state["taking"]


@pytest.mark.parametrize("end", [lambda bench: bench.act("disarm"), lambda bench: bench.close()])
def test_a_moving_stage_is_stopped(make_live, monkeypatch, end):
    bench = make_live()
    sleep = bench._devices.clock.sleep_s
    monkeypatch.setattr(bench._devices.clock, "sleep_s", lambda seconds: (time.sleep(0.005), sleep(seconds)))
    clock, stage = bench._rig.bench.world.clock, bench._rig.bench.stage
    begun_mm = stage.positions_mm_at(clock.now_s())["x"]
    moving = threading.Thread(target=bench.act, args=("jog",), kwargs={"axis": "x", "mm": 10.0})
    moving.start()
    wait_for(bench, lambda view: view.state["armed"] == ["the stage moves"])
    end(bench)
    moving.join()
    assert bench.armed == []
    now_s = clock.now_s()
    rests_mm = stage.positions_mm_at(now_s)["x"]
    assert begun_mm < rests_mm < begun_mm + 9.0
    clock.sleep_s(1.0)
    assert stage.positions_mm_at(clock.now_s())["x"] == rests_mm


@pytest.mark.parametrize("end", [lambda bench: bench.act("disarm"), lambda bench: bench.close()])
def test_an_exposure_under_way_is_ended(make_live, monkeypatch, end):
    bench = make_live()
    modulator, shares = bench._devices.modulator, []

    def slowly(sequence, progress):
        for percent in range(100):
            shares.append(percent)
            time.sleep(0.02)
            progress(percent / 100)
        raise AssertionError("it was not ended")

    monkeypatch.setattr(modulator, "upload", slowly)
    refused = []

    def take():
        with pytest.raises(DeviceError, match="a request to disarm came") as error:
            bench.act("take")
        refused.append(error)

    taking = threading.Thread(target=take)
    taking.start()
    wait_for(bench, lambda view: view.state["armed"] == ["one exposure is taken"] and len(shares) > 2)
    end(bench)
    taking.join()
    assert refused
    assert len(shares) < 90
    assert bench.armed == []
    assert at_rest(bench)


@pytest.mark.parametrize("end", [lambda bench: bench.act("disarm"), lambda bench: bench.close()])
@pytest.mark.parametrize("modulator", [MODULATOR, 'kind = "video"\ntrigger_patch = [0, 0, 40, 40]'])
def test_an_exposure_is_ended_while_its_masks_are_shown(make_live, monkeypatch, end, modulator):
    bench = make_live(modulator=modulator, capture="mask_s = 2.0", light_e_per_s=1000.0)
    world, sleep = bench._rig.bench.world, bench._rig.bench.world.clock.sleep_s
    # Its seconds take a quarter of one, so that there is time to press the button.
    monkeypatch.setattr(world.clock, "sleep_s", lambda seconds: (time.sleep(max(seconds, 0.0) / 4), sleep(seconds)))
    refused = []

    def take():
        with pytest.raises(DeviceError, match="a request to disarm came") as error:
            bench.act("take")
        refused.append(error)

    begin_s = world.clock.now_s()
    taking = threading.Thread(target=take)
    taking.start()
    wait_for(bench, lambda view: world.masks_between(begin_s, world.clock.now_s()))
    shown_s = world.clock.now_s()
    end(bench)
    taking.join()
    assert refused
    assert world.clock.now_s() - shown_s < 4.0  # of the 8 s of its masks
    assert bench.armed == []
    assert at_rest(bench)


def test_one_exposure_is_taken_and_decoded(make_live):
    bench = make_live()
    bench.act("camera", on=True)
    bench.act("take")
    view = bench.view()
    assert bench.armed == []
    assert at_rest(bench)
    assert view.state["taken"]["views"] == len(view.views) == 4
    shown = cv2.imdecode(np.frombuffer(view.views[0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.shape[:2] == (96, 128)
    assert shown.std() > 5


def test_without_what_decodes_it_says_what_to_install(make_live, monkeypatch):
    bench = make_live()
    monkeypatch.setitem(sys.modules, "torch", None)
    for name in [name for name in sys.modules if name.startswith("gs2ci.reconstruct.decode")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(InputError, match=r"torch, which is not installed.*gs2ci\[reconstruct\]"):
        bench.act("take")


@pytest.mark.parametrize(
    ("action", "given", "text"),
    [
        ("explode", {}, "camera, show, exposure, jog, take, disarm"),
        ("show", {"what": "cat"}, "dark, open, mask, sequence"),
        ("show", {"what": "mask", "index": 4}, "mask 5; allowed: 1 to 4"),
        ("exposure", {"seconds": 1e9}, "an exposure of"),
        ("camera", {"off": True}, "camera with"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(make_live, action, given, text):
    bench = make_live()
    with pytest.raises(InputError, match=text):
        bench.act(action, **given)
    assert bench.armed == []


def test_a_bench_without_a_stage_says_so(tmp_path, make_live):
    bench = make_live()
    monkey = bench._devices
    object.__setattr__(monkey, "stage", None)
    with pytest.raises(InputError, match=r"no stage; what to do: add a \[stage\]"):
        bench.act("jog", axis="x", mm=1.0)


def test_a_device_that_goes_away_is_told_and_the_rest_is_disarmed(make_live):
    bench = make_live()
    bench.act("show", what="open")
    bench.act("camera", on=True)
    pictures(bench)
    bench._rig.bench.sensor.unplug()
    view = wait_for(bench, lambda view: not view.state["armed"])
    assert any("gone" in note or "went away" in note for note in view.state["notes"])
    with pytest.raises(AccessError, match="no such node"):
        bench.act("camera", on=True)
    bench._rig.bench.sensor.plug_in()
    bench.act("camera", on=True)
    pictures(bench)


def test_a_closed_bench_is_at_rest_and_refuses(make_live):
    bench = make_live()
    bench.act("show", what="sequence")
    bench.act("camera", on=True)
    bench.close()
    bench.close()
    assert bench.armed == []
    assert at_rest(bench)
    with pytest.raises(InputError, match="the bench is closed"):
        bench.act("disarm")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bench_that_dies_is_at_rest_says_why_and_refuses(make_live, monkeypatch):
    bench = make_live()
    bench.act("show", what="open")
    bench.act("camera", on=True)

    def broken(*_):
        raise ValueError("zero-size array")

    monkeypatch.setattr(bench._devices.sensor, "stop", broken)  # not even that ends as it should
    monkeypatch.setattr(live_bench, "figures_of", broken)
    bench._thread.join(HANG_S)
    assert not bench._thread.is_alive()
    assert bench._devices.modulator._closed
    assert bench._devices.sensor._closed
    with pytest.raises(InputError, match="the bench is closed"):
        bench.act("disarm")
    assert any("the bench has ended: zero-size array" in note for note in bench.view().state["notes"])


def test_what_is_asked_while_the_bench_ends_is_refused(make_live, monkeypatch):
    bench, answers = make_live(), []
    disarm = bench._disarm

    def slowly():
        asking = threading.Thread(target=ask)
        asking.start()
        while bench._asked.empty() and asking.is_alive():
            time.sleep(0.01)
        disarm()

    def ask():
        with pytest.raises(InputError, match="the bench is closed"):
            bench.act("disarm")
        answers.append("refused")

    monkeypatch.setattr(bench, "_disarm", slowly)
    bench.close()
    until = time.monotonic() + HANG_S
    while not answers and time.monotonic() < until:
        time.sleep(0.01)
    assert answers == ["refused"]


def test_a_camera_without_an_exposure_control_has_no_longest_exposure(make_live, monkeypatch):
    monkeypatch.setattr(OpenCamera, "_exposure_control", lambda camera, *given: None)
    bench = make_live()
    state = bench.view().state
    assert state["exposure_limits_s"] == [0.0, None]
    json.dumps(state, allow_nan=False)
    with pytest.raises(InputError, match="an exposure of inf s"):
        bench.act("exposure", seconds=float("inf"))


def test_a_bench_that_does_not_answer_is_closed_again(tmp_path, make_live):
    make_live()
    bench = LiveBench(load_rig(tmp_path / "rig.toml"))
    bench._rig.bench.sensor.unplug()
    with pytest.raises(Exception, match="sensor"):
        bench.begin()
    bench._rig.bench.sensor.plug_in()
    bench.begin()
    bench.close()
