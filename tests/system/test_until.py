"""A simulated bench takes exposures until they are accurate enough, by reconstructing them together."""

import json

import pytest

from gs2ci.core.storage import count_shots

RIG = """
name = "small"
[modulator]
kind = "dlpc900"
trigger_out_2_bit = "disables"
[sensor]
kind = "v4l2"
height = 72
width = 96
format = "RG12"
black_level_dn = 64.0
[stage]
kind = "zaber"
[stage.mount]
[capture]
masks = 6
mask_s = 0.03
shots = 1
axis = "x"
from_mm = 74.0
to_mm = 78.0
[world]
scene = "planes"
height = 72
width = 96
"""


@pytest.mark.slow
def test_more_exposures_are_taken_until_their_standard_errors_are_small_enough(tmp_path, monkeypatch, gs2ci):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(RIG)
    assert gs2ci("capture", "--rig", "rig.toml", "-o", "shot.h5", "--no-probe", "--until", "25dB", "--shots", "4") == 0
    log = [json.loads(line) for line in (tmp_path / "shot.h5.session.jsonl").read_text().splitlines()]
    judged = [line for line in log if line["event"] == "judged"]
    assert [line["exposures"] for line in judged] == list(range(1, len(judged) + 1))
    assert 2 <= len(judged) <= 4
    assert judged[0]["figure"] < 25 <= judged[-1]["figure"]
    assert judged[-1]["enough"]
    assert count_shots(tmp_path / "shot.h5") == len(judged)
