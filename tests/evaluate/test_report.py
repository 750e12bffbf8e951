import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gs2ci.core.errors import StorageError
from gs2ci.core.records import Truth
from gs2ci.evaluate.report import REPORT_NAME, SCHEMA, build_report, plain_json, read_report


def strict_json(value):
    return json.loads(json.dumps(value, allow_nan=False))


def test_the_report_has_the_keys_of_its_schema(make_run):
    report = build_report(*make_run())
    assert report["schema"] == "gs2ci.report/1"
    assert set(report["psnr_db"]) == set(report["ssim"]) == {"mean", "per_view"}
    assert set(report["trajectory"]) == {
        "ate",
        "nate",
        "translation_mean",
        "rotation_deg",
        "rpe_t",
        "rpe_r_deg",
    }
    assert set(report["seconds"]) == {"total", "decode", "geometry", "fit"}
    assert {"rms", "mean_abs"} <= set(report["residual"])
    for row in report["curve"]:
        assert set(row) == {"seconds", "iteration", "loss", "heldout", "psnr_db", "gaussians"}
    assert {"gaussians", "stopped_because", "peak_mib", "settings", "seed", "versions", "machine"} <= set(report)
    assert strict_json(report) == report


def test_means_are_those_of_the_views(make_run):
    shot, result = make_run()
    report = build_report(shot, result)
    assert len(report["psnr_db"]["per_view"]) == 8
    assert report["psnr_db"]["mean"] == pytest.approx(np.mean(report["psnr_db"]["per_view"]))
    assert report["psnr_db"]["mean"] > report["scene"]["psnr_db"]["mean"]
    assert report["psnr_db"]["mean"] > report["decode"]["psnr_db"]["mean"] + 5


def test_where_the_decode_is_better_the_report_gives_its_figures_and_says_so(make_run):
    shot, result = make_run()
    report = build_report(shot, replace(result, verdict="decode", views=result.decode))
    assert report["psnr_db"] == report["decode"]["psnr_db"] != report["scene"]["psnr_db"]
    assert "does not explain the measurement better" in report["notes"][0]


def test_without_truth_nothing_is_compared_with_it(make_run):
    report = build_report(*make_run(truth=False))
    assert report["psnr_db"] is report["ssim"] is report["trajectory"] is None
    assert report["residual"]["rms"] > 0


def test_true_views_without_true_poses_are_scored_alone(make_run):
    shot, result = make_run()
    report = build_report(replace(shot, truth=Truth(views=shot.truth.views)), result)
    assert report["psnr_db"] is not None
    assert report["trajectory"] is None


def test_a_straight_path_is_said_to_be_one(make_run):
    shot, result = make_run(count=2)
    assert any("too straight" in note for note in build_report(shot, result)["notes"])


def test_a_camera_that_stands_still_is_said_to(make_run):
    shot, result = make_run()
    still = replace(result, world_to_camera=np.tile(np.eye(4), (8, 1, 1)))
    report = build_report(shot, still)
    assert any("stands still" in note for note in report["notes"])
    assert report["trajectory"]["nate"] > 0.1


def test_numbers_that_are_not_finite_become_null(make_run):
    shot, result = make_run()
    point = replace(result.curve[0], loss=float("nan"), heldout=float("inf"))
    broken = replace(result, curve=[point], settings={"cap": np.float32(np.inf), "path": Path("a")})
    report = build_report(shot, broken)
    assert (report["curve"][0]["loss"], report["curve"][0]["heldout"]) == (None, None)
    assert report["settings"] == {"cap": None, "path": "a"}
    assert strict_json(report) == report


def test_plain_json_keeps_what_json_can_hold():
    @dataclass
    class Preset:
        steps: int
        rates: tuple[float, ...]

    value = {1: Preset(3, (0.5, float("nan"))), "array": np.arange(2), "flag": np.bool_(True), "none": None}
    assert plain_json(value) == {
        "1": {"steps": 3, "rates": [0.5, None]},
        "array": [0, 1],
        "flag": True,
        "none": None,
    }


def test_the_report_names_versions_and_machine_but_nobody(make_run):
    report = build_report(*make_run())
    assert report["versions"]["numpy"] == np.__version__
    assert set(report["machine"]) == {"processor", "architecture", "usable_cores", "memory_mib", "system"}
    assert report["peak_mib"] > 10


def test_a_written_report_reads_back(tmp_path):
    (tmp_path / REPORT_NAME).write_text(json.dumps({"schema": SCHEMA, "gaussians": 5}))
    assert read_report(tmp_path)["gaussians"] == 5


@pytest.mark.parametrize(
    "content",
    [
        None,
        "",
        '{"schema": "gs2ci.rep',
        '{"schema": "gs2ci.report/9"}',
        "[1, 2]",
        pytest.param("[" * 100_000, id="deep"),
    ],
)
def test_a_report_that_is_missing_cut_short_or_another_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / REPORT_NAME).write_text(content)
    with pytest.raises(StorageError, match=r"report\.json"):
        read_report(tmp_path)


def test_it_says_what_the_measurement_and_its_masks_are_like(make_run):
    shot, result = make_run(count=3, size=(4, 10))
    masks = np.zeros_like(shot.masks)
    masks[0, :, :5], masks[1, :, 2] = 1, 0.5
    masks[2] = 1  # never exposed, so what it opens stays unseen
    saturated = np.zeros((4, 10), bool)
    saturated[0, 0] = True
    dark = replace(shot, masks=masks, weights=np.array([1, 0.9, 0], np.float32), saturated=saturated)
    measured = build_report(dark, result)["measured"]
    assert measured["open_share"] == pytest.approx((20 + 2 + 40) / 120)
    assert measured["grey_share"] == pytest.approx(4 / 120)
    assert measured["closed_share"] == pytest.approx(0.5)
    assert measured["saturated_share"] == pytest.approx(1 / 40)
    assert measured["weights"] == pytest.approx([0, 1])
    assert measured["telemetry"] is False
    assert build_report(shot, result)["measured"]["saturated_share"] is None
