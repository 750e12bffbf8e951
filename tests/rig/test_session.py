"""The session log beside a shot file, and the operator's metadata in it."""

import json
from pathlib import Path

import h5py
import pytest

import gs2ci
from gs2ci import cli
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.storage import read_shot
from gs2ci.core.storage.writer import ShotWriter
from gs2ci.reconstruct.fit.scene.mask_moments import stated_within_mask
from gs2ci.rig.session import SessionLog
from gs2ci_drivers.zaber.driver import ZaberStage
from gs2ci_drivers.zaber.options import ZaberOptions
from gs2ci_sims.world import VirtualClock
from tests.twins.zaber import OddAxis, ZaberTwin

RIG = """
name = "a bench"
session = "{level}"
[metadata]
operator = "A. Name"
sample = "fern, third leaf"
humidity_percent = 41.5
[modulator]
kind = "scpi"
port = "simulated"
[sensor]
kind = "{camera}"
port = "simulated"
height = 24
width = 32
format = "{picture}"
[stage]
kind = "zaber"
port = "simulated"
[capture]
masks = 4
mask_s = 0.02
shots = 2
axis = "x"
from_mm = 74.0
to_mm = 76.0
[world]
scene = "planes"
height = 24
width = 32
"""


def rows_of(shot):
    return [json.loads(line) for line in Path(f"{shot}.session.jsonl").read_text(encoding="utf-8").splitlines()]


def captured(tmp_path, monkeypatch, level="info", camera="v4l2", *more):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(level=level, camera=camera, picture="Y12" if camera == "v4l2" else "Mono12"))
    monkeypatch.setattr("sys.argv", ["gs2ci", "capture", "--rig", str(rig), "-o", str(tmp_path / "shot.h5"), *more])
    status = cli.main()
    return status, tmp_path / "shot.h5"


def test_it_says_who_when_on_what_how_warm_and_what_happened(tmp_path, monkeypatch):
    status, shot = captured(tmp_path, monkeypatch, "info", "genicam")
    assert status == 0
    rows = rows_of(shot)
    assert {row["level"] for row in rows} == {"info"}
    begin = rows[0]
    assert (begin["event"], begin["session"], begin["rig"]) == ("begin", "gs2ci.session/1", "a bench")
    assert begin["metadata"] == {"operator": "A. Name", "sample": "fern, third leaf", "humidity_percent": 41.5}
    assert begin["command"][:2] == ["gs2ci", "capture"]
    assert begin["host"]
    assert begin["at"].endswith("+00:00")
    assert [row["device"] for row in rows if row["event"] == "device"] == ["modulator", "sensor", "stage"]
    # Before the first shot and after the last, from the devices that tell.
    warm = [(row["device"], row["celsius"]) for row in rows if row["event"] == "temperatures"]
    assert warm == 2 * [("sensor", {"DeviceTemperature": 41.5}), ("stage", {"x": 31.4})]
    assert [row["index"] for row in rows if row["event"] == "shot"] == [0, 1]
    assert (rows[-1]["event"], rows[-1]["rows"]) == ("end", 2)
    # Two sessions can be compared by the settings of the camera, in the log and in the shot file.
    with h5py.File(shot) as file:
        events = [json.loads(line) for line in file["events"][:]]
    (told,) = [row["sensor"] for row in rows if row["event"] == "settings"]
    assert [event["sensor"] for event in events if event["kind"] == "settings"] == [told]
    assert (told["PixelFormat"], told["ReverseX"], told["TriggerMode"], told["Gain"]) == ("Mono12", False, "On", 0.0)
    provenance = read_shot(shot).provenance
    assert provenance["metadata"]["operator"] == "A. Name"
    assert provenance["taken_at"].endswith("+00:00")
    assert stated_within_mask(read_shot(shot)) == "moving"


def test_the_log_reports_no_shot_before_its_row_is_whole(tmp_path, monkeypatch):
    """A capture killed in between had one shot fewer in its file than in its log."""
    order = []
    append, note = ShotWriter.append, SessionLog.note

    def appending(writer, *row, **more):
        append(writer, *row, **more)
        order.append("row")

    def noting(log, event, **more):
        order.extend([event] * (event == "shot"))
        note(log, event, **more)

    monkeypatch.setattr(ShotWriter, "append", appending)
    monkeypatch.setattr(SessionLog, "note", noting)
    assert captured(tmp_path, monkeypatch)[0] == 0
    assert order == ["row", "shot"] * 2


def test_at_debug_every_command_and_answer_is_in_it_from_the_first_on(tmp_path, monkeypatch):
    status, shot = captured(tmp_path, monkeypatch, "debug")
    assert status == 0
    rows = rows_of(shot)
    calls = [row for row in rows if row["level"] == "debug"]
    assert {row["device"] for row in calls} == {"modulator", "sensor", "stage"}
    sent = [bytes.fromhex(text) for row in calls if row["device"] == "stage" for text in row.get("sent", [])]
    assert any(b"get version" in command for command in sent), "the first question on connecting"
    assert any(b"move abs" in command for command in sent)
    answers = [text for row in calls if row["device"] == "stage" for text in row.get("got", [])]
    assert any(b" OK " in bytes.fromhex(text) for text in answers)
    # Pixels are told by their length and checksum: the log stays small.
    long = [text for row in calls for text in (*row.get("sent", []), *row.get("got", [])) if "crc32" in text]
    assert any(text.startswith(f"{24 * 32 * 2} bytes, crc32 ") for text in long)


def test_off_writes_none_and_a_dry_run_neither(tmp_path, monkeypatch):
    assert captured(tmp_path, monkeypatch, "info", "v4l2", "--dry-run")[0] in (0, None)
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]
    status, shot = captured(tmp_path, monkeypatch, "off")
    assert status == 0
    assert not Path(f"{shot}.session.jsonl").exists()


def test_a_capture_that_fails_says_so_in_its_log(tmp_path):
    rig = tmp_path / "rig.toml"
    text = RIG.format(level="info", camera="v4l2", picture="Y12")
    rig.write_text(text)
    with gs2ci.open_rig(rig) as bench:
        prepared = bench.plan(progress=gs2ci.Silent())

        def fail(*_):
            raise RuntimeError("the building shook")

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("gs2ci.rig.recording.capture", fail)
            with pytest.raises(RuntimeError, match="shook"):
                bench.record(tmp_path / "shot.h5", prepared, progress=gs2ci.Silent())
    last = rows_of(tmp_path / "shot.h5")[-1]
    assert (last["event"], last["error"], last["message"]) == ("failed", "RuntimeError", "the building shook")


def test_a_second_capture_of_an_open_rig_has_its_own_log(tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.format(level="info", camera="v4l2", picture="Y12"))
    with gs2ci.open_rig(rig) as bench:
        for name in ("one.h5", "two.h5"):
            bench.record(tmp_path / name, bench.plan(shots=1, progress=gs2ci.Silent()), progress=gs2ci.Silent())
    assert [rows_of(tmp_path / name)[0]["file"] for name in ("one.h5", "two.h5")] == ["one.h5", "two.h5"]


def test_a_place_that_cannot_be_written_is_told(tmp_path):
    log = SessionLog(tmp_path / "nowhere" / "shot.h5", "info")
    with pytest.raises(StorageError, match=r"session log .* cannot be written.*session = \"off\""):
        log.begin()


def test_metadata_are_plain_values(tmp_path):
    rig = tmp_path / "rig.toml"
    text = RIG.format(level="info", camera="v4l2", picture="Y12")
    rig.write_text(text.replace("humidity_percent = 41.5", "humidity_percent = [41, 42]"))
    with pytest.raises(InputError, match="humidity_percent"):
        gs2ci.open_rig(rig)


def test_a_stage_without_a_thermometer_says_nothing():
    clock = VirtualClock()
    twin = ZaberTwin(clock, OddAxis(temperature_c=None))
    stage = ZaberStage("stage", twin.open(), clock, ZaberOptions())
    stage.connect()
    assert stage.temperatures_c() == {}
    stage.close()
