"""A bench in Bluesky's hands: scans, fly scans and coded exposures on the simulated bench, and what comes of faults."""

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import gs2ci
from gs2ci.core.errors import InputError
from gs2ci.core.storage import read_shot
from gs2ci_drivers.failures import FrameCorruptError, OutOfRangeError, PlanRefusedError

bluesky = pytest.importorskip("bluesky", reason="the extra `ophyd` is not installed")
from bluesky import plan_stubs, plans, preprocessors, protocols  # noqa: E402
from bluesky.utils import FailedStatus  # noqa: E402
from ophyd_async.core import DetectorTrigger, FlyMotorInfo, TriggerInfo  # noqa: E402

from gs2ci.api.ophyd.bench import coded_frames  # noqa: E402
from tests.api.conftest import RIG  # noqa: E402


@pytest.fixture(scope="module")
def engine():
    found = bluesky.RunEngine({})
    yield found
    found.loop.call_soon_threadsafe(found.loop.stop)
    found._th.join()
    found.loop.close()


@pytest.fixture
def open_bench(tmp_path):
    """Open small benches for Bluesky; all are closed at the end."""
    opened = []

    def run(capture="", world=""):
        path = tmp_path / "rig.toml"
        path.write_text(RIG.format(pixels="Y12", capture=f"mask_s = 0.01\n{capture}", world=f"noise = false\n{world}"))
        rig = gs2ci.open_rig(path)
        opened.append(gs2ci.ophyd_bench(rig, tmp_path))
        return rig, opened[-1]

    yield run
    for bench in opened:
        bench.close()


@pytest.fixture
def run(engine):
    """Run a plan; return its documents as (name, document)."""

    def through(plan):
        documents = []
        token = engine.subscribe(lambda name, document: documents.append((name, document)))
        try:
            engine(plan)
        finally:
            engine.unsubscribe(token)
        return documents

    return through


def named(documents, name):
    return [document for kind, document in documents if kind == name]


def at_rest(rig):
    bench = rig.rig.bench
    now_s = bench.world.clock.now_s()
    return not bench.world.masks_between(now_s - 1e-6, now_s) and not bench.sensor.streaming


def cause_of(error):
    while error.__cause__ is not None:
        error = error.__cause__
    return error


def test_the_devices_are_what_blueskys_protocols_ask_for(open_bench):
    _, bench = open_bench()
    for device, wanted in (
        (bench.axes["x"], (protocols.Readable, protocols.Locatable, protocols.Stoppable, protocols.Flyable)),
        (bench.modulator, (protocols.Readable, protocols.Stageable, protocols.Preparable, protocols.Flyable)),
        (bench.sensor, (protocols.Triggerable, protocols.Flyable, protocols.WritesStreamAssets)),
        (bench.coded, (protocols.Readable, protocols.Triggerable)),
    ):
        assert [one.__name__ for one in wanted if not isinstance(device, one)] == []


def test_a_scan_moves_an_axis_and_reads_where_it_is(open_bench, run):
    rig, bench = open_bench()
    documents = run(plans.scan([bench.axes["x"]], bench.axes["x"], 74.0, 75.0, 3))
    seen = [event["data"]["stage-x"] for event in named(documents, "event")]
    assert seen == pytest.approx([74.0, 74.5, 75.0], abs=1e-4)
    (told,) = named(documents, "descriptor")
    assert told["data_keys"]["stage-x"]["units"] == "mm"
    assert rig.rig.bench.stage.positions_mm_at(rig.rig.bench.world.clock.now_s())["x"] == pytest.approx(75.0, abs=1e-4)


def test_a_target_beyond_the_limits_is_refused_and_nothing_moves(open_bench, run):
    rig, bench = open_bench()
    before = rig.devices.stage.positions_mm()
    with pytest.raises(FailedStatus) as caught:
        run(plan_stubs.mv(bench.axes["x"], 1e6))
    assert isinstance(cause_of(caught.value), OutOfRangeError)
    assert rig.devices.stage.positions_mm() == before


def test_a_flight_crosses_its_range_at_constant_speed_and_ends_beyond_it(open_bench, run):
    rig, bench = open_bench()
    axis, crossed = bench.axes["x"], []

    @preprocessors.run_decorator()
    def plan():
        flight = FlyMotorInfo(start_position=74.0, end_position=76.0, time_for_move=0.4)
        yield from plan_stubs.prepare(axis, flight, wait=True)
        yield from plan_stubs.kickoff(axis, wait=True)
        crossed.append(rig.devices.clock.now_s())
        yield from plan_stubs.complete(axis, wait=True)

    run(plan())
    stage, clock_s = rig.rig.bench.stage, crossed[0]
    travelled = stage.positions_mm_at(clock_s + 0.2)["x"] - stage.positions_mm_at(clock_s + 0.1)["x"]
    assert travelled == pytest.approx(0.1 * 5.0, rel=0.02)
    assert rig.devices.stage.positions_mm()["x"] > 76.0


def test_a_move_that_is_stopped_ends_at_once_and_short_of_its_target(open_bench, run):
    rig, bench = open_bench()

    def plan():
        status = yield from plan_stubs.abs_set(bench.axes["x"], 140.0)
        yield from plan_stubs.stop(bench.axes["x"])
        while not status.done:
            yield from plan_stubs.sleep(0.01)

    with pytest.raises(FailedStatus, match="was stopped"):
        run(plan())
    assert not rig.devices.stage.status().moving
    assert rig.devices.stage.positions_mm()["x"] < 139.0


@pytest.mark.parametrize("mode", ["per-exposure", "gate"])
def test_coded_frames_are_those_that_a_capture_takes(open_bench, run, tmp_path, mode):
    rig, bench = open_bench(f'mode = "{mode}"', world='devices = "ideal"')  # every exposure begins equally late
    documents = run(coded_frames(bench, 3, {"sample": "fern"}))
    (start,), (stop,) = named(documents, "start"), named(documents, "stop")
    assert (start["sample"], start["masks"], start["mask_s"], stop["exit_status"]) == ("fern", 4, 0.01, "success")
    (resource,), data = named(documents, "stream_resource"), named(documents, "stream_datum")
    assert [(one["indices"]["start"], one["indices"]["stop"]) for one in data][-1][1] == 3
    file = Path(resource["uri"].removeprefix("file://localhost"))
    with h5py.File(file) as kept:
        frames, flags = kept[resource["parameters"]["dataset"]][:], kept["flags"][:]
        assert np.diff(kept["sequence"][:]).tolist() == [1, 1]
        assert (np.diff(kept["t_kernel_ns"][:]) > 0.04e9).all()
    assert frames.shape == (3, 24, 32)
    assert len(flags) == 3
    assert at_rest(rig)
    # The stage has not moved and there is no noise: the bench's own capture sees the same.
    path = rig.record(tmp_path / "own.h5", progress=gs2ci.Silent())
    with h5py.File(path) as own:
        np.testing.assert_array_equal(frames, np.broadcast_to(own["meas"][0].reshape(24, 32), frames.shape))


def test_a_scan_of_coded_exposures_writes_shots_that_can_be_reconstructed(open_bench, run):
    _, bench = open_bench()
    documents = run(plans.scan([bench.coded], bench.axes["x"], 74.0, 75.0, 2))
    events = [event["data"] for event in named(documents, "event")]
    shots = [read_shot(Path(event["coded-file"])) for event in events]
    assert [shot.masks.shape for shot in shots] == [(4, 24, 32)] * 2
    assert [event["coded-mean"] for event in events] == pytest.approx([shot.measurement.mean() for shot in shots])
    assert not np.array_equal(shots[0].measurement, shots[1].measurement)  # the camera had moved
    assert [event["coded-saturated"] for event in events] == [0.0, 0.0]


def test_the_sensors_own_frames_are_counted_one_by_one(open_bench, run):
    rig, bench = open_bench()
    documents = run(plans.count([bench.sensor], 2))
    assert named(documents, "stream_datum")[-1]["indices"]["stop"] == 2
    assert len(named(documents, "event")) == 2
    (told,) = named(documents, "descriptor")
    assert told["data_keys"]["sensor"]["shape"] == [1, 24, 32]
    assert "sensor-exposure" in told["configuration"]["sensor"]["data"]
    assert at_rest(rig)


def test_a_spoilt_frame_ends_the_run_with_the_drivers_error_and_the_bench_at_rest(open_bench, run):
    rig, bench = open_bench(world='faults = ["sensor: v4l2.frame_corrupt"]')
    with pytest.raises(FailedStatus) as caught:
        run(coded_frames(bench, 2))
    assert isinstance(cause_of(caught.value), FrameCorruptError)
    assert at_rest(rig)
    assert named(run(coded_frames(bench, 2)), "stop")[0]["exit_status"] == "success"


def test_a_plan_beyond_the_devices_is_refused_before_the_run_begins(open_bench, run):
    _, bench = open_bench()
    with pytest.raises(PlanRefusedError, match="1 or more"):
        run(coded_frames(bench, 0))


def test_a_dead_time_is_refused_since_sensors_have_their_own(open_bench, run):
    _, bench = open_bench()
    with pytest.raises(FailedStatus) as caught:
        run(plan_stubs.prepare(bench.sensor, TriggerInfo(trigger=DetectorTrigger.INTERNAL, deadtime=0.1), wait=True))
    assert isinstance(cause_of(caught.value), InputError)


def test_a_bench_whose_device_is_gone_is_closed_again(open_bench, tmp_path):
    rig, bench = open_bench()
    bench.close()
    bench.close()
    rig.rig.bench.sensor.unplug()
    with pytest.raises(gs2ci.DeviceError):
        gs2ci.ophyd_bench(rig, tmp_path)
    rig.rig.bench.sensor.plug_in()
    gs2ci.ophyd_bench(rig, tmp_path).close()


def test_without_the_extra_it_says_what_to_install(monkeypatch, tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG.format(pixels="Y12", capture="mask_s = 0.01", world="noise = false"))
    for name in [name for name in sys.modules if name.startswith("gs2ci.api.ophyd")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "ophyd_async", None)
    monkeypatch.setitem(sys.modules, "ophyd_async.core", None)
    with gs2ci.open_rig(path) as rig, pytest.raises(InputError, match=r"pip install 'gs2ci\[ophyd\]'"):
        gs2ci.ophyd_bench(rig, tmp_path)
