import json
import re

import pytest

from gs2ci.core.errors import StorageError
from gs2ci.evaluate.environment import Machine
from gs2ci.evaluate.tradeoff import record as module
from gs2ci.evaluate.tradeoff.record import RECORD_NAME, TradeoffRecord, Tried, read_record, write_record

RECORD = TradeoffRecord(
    "a shot",
    "psnr_db",
    ("Decode: 24.00 dB in 1 s.",),
    (
        Tried("decode", "preset", 1.0, 24.0, 0.9, None, 20.0, 0, 0, unbeaten=True),
        Tried("standard", "preset", 60.0, 31.0, 0.95, 0.01, 21.0, 1000, 5000, unbeaten=True),
    ),
    "gs2ci tradeoff shot.h5",
    Machine("a processor", "x86_64", 4, 1000, "Linux"),
    {"gs2ci": "1.0"},
)


def test_what_was_written_is_read_back(tmp_path):
    assert write_record(tmp_path, RECORD) == tmp_path / "tradeoff.json"
    assert read_record(tmp_path) == RECORD
    assert [path.name for path in tmp_path.iterdir()] == [RECORD_NAME]


def test_a_folder_without_one_has_none(tmp_path):
    assert read_record(tmp_path) is None


def test_cells_stand_under_the_headings_with_a_dash_for_what_is_not_known():
    assert RECORD.trials[0].cells == ("1.0", "24.00", "0.9000", "–", "20.00", "0", "0")
    assert len(RECORD.trials[0].cells) == len(module.HEADINGS) - 1


def test_a_place_that_cannot_be_written_is_a_clear_error(tmp_path):
    with pytest.raises(StorageError, match="cannot be written"):
        write_record(tmp_path / "nowhere", RECORD)
    (tmp_path / RECORD_NAME).mkdir()
    with pytest.raises(StorageError, match="cannot be written"):
        write_record(tmp_path, RECORD)
    assert [path.name for path in tmp_path.iterdir()] == [RECORD_NAME]


def spoil(folder, *path, to):
    """Change one value of a good record; ... takes it away."""
    held = json.loads(write_record(folder, RECORD).read_text())
    at = held
    for key in path[:-1]:
        at = at[key]
    if to is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = to
    (folder / RECORD_NAME).write_text(json.dumps(held))


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (("schema",), "gs2ci.tradeoff/2"),
        (("schema",), ...),
        (("measure",), "luck"),
        (("measure",), ["psnr_db"]),
        (("name",), 5),
        (("sentences",), [{"a": 1}]),
        (("sentences",), None),
        (("trials",), 7),
        (("trials", 0), None),
        (("trials", 0, "trial"), None),
        (("trials", 0, "seconds"), 0),
        (("trials", 0, "seconds"), 1e-300),
        (("trials", 0, "seconds"), float("nan")),
        (("trials", 0, "seconds"), float("inf")),
        (("trials", 0, "seconds"), 1e300),
        (("trials", 0, "seconds"), None),
        (("trials", 0, "psnr_db"), "31"),
        (("trials", 0, "psnr_db"), True),
        (("trials", 0, "psnr_db"), 10**400),
        (("trials", 0, "iterations"), 1.5),
        (("trials", 0, "gaussians"), -1),
        (("trials", 0, "unbeaten"), "yes"),
        (("trials", 0, "unbeaten"), ...),
        (("machine",), []),
        (("machine", "usable_cores"), None),
        (("versions", "gs2ci"), 1),
    ],
)
def test_values_that_are_none_of_ours_are_one_typed_error(tmp_path, path, to):
    spoil(tmp_path, *path, to=to)
    with pytest.raises(StorageError, match=r"tradeoff\.json cannot be read") as refused:
        read_record(tmp_path)
    assert "delete it" in str(refused.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "[" * 100_000, "\xff"], ids=["empty", "cut", "list", "deep", "bytes"])
def test_a_record_that_is_no_record_is_one_typed_error(tmp_path, text):
    (tmp_path / RECORD_NAME).write_text(text, encoding="latin-1")
    with pytest.raises(StorageError, match="cannot be read"):
        read_record(tmp_path)


@pytest.mark.parametrize("kept", [1, 100, 700])
def test_a_record_cut_short_is_one_typed_error(tmp_path, kept):
    path = write_record(tmp_path, RECORD)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(StorageError, match="cannot be read"):
        read_record(tmp_path)


def test_a_record_that_is_too_large_is_refused_before_it_is_read(tmp_path, monkeypatch):
    size = write_record(tmp_path, RECORD).stat().st_size
    monkeypatch.setattr(module, "LIMIT_BYTES", size - 1)
    with pytest.raises(StorageError, match=re.escape(f"it has {size} bytes")):
        read_record(tmp_path)
