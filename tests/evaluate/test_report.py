import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from gs2ci.core.errors import StorageError
from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Truth
from gs2ci.core.run_figures import LightSection
from gs2ci.evaluate.report import Report, read_report
from gs2ci.evaluate.run_report import build_report
from gs2ci.evaluate.whole_folder import REPORT_NAME
from tests.evaluate.reports import GOOD, a_report

# What a damaged or foreign report may hold where something else is expected; ... stands for nothing at all.
WRONG = ("text", [], -1e200, {"mean": None}, {"unknown": 1}, 10**400, ...)


def codes(report):
    return [note.code for note in report.notes]


def test_what_is_written_reads_back_as_the_same(tmp_path, make_run):
    report = build_report(*make_run())
    (tmp_path / REPORT_NAME).write_text(report.text())
    assert read_report(tmp_path) == report
    assert json.loads(report.text())["schema"] == "gs2ci.report/2"


def test_brightness_is_read_by_the_name_that_it_had_before():
    section = {"estimated": [1.0], "standard_errors": [0.1], "errors_away": 1.0, "explains": 0.1, "views": "even"}
    assert a_report(light={**section, "believed": [1.1]}).light == LightSection(**section, used=[1.1])


def test_means_are_those_of_the_views(make_run):
    report = build_report(*make_run())
    assert len(report.psnr_db.per_view) == 8
    assert report.psnr_db.mean == pytest.approx(np.mean(report.psnr_db.per_view))
    assert report.psnr_db.mean > report.scene.psnr_db.mean
    assert report.psnr_db.mean > report.decode.psnr_db.mean + 5


def test_where_the_decode_is_better_the_report_gives_its_figures_and_says_so(make_run):
    shot, result = make_run()
    report = build_report(shot, replace(result, verdict="decode", views=result.decode))
    assert report.psnr_db == report.decode.psnr_db != report.scene.psnr_db
    assert codes(report)[0] is Code.DECODE_KEPT
    assert report.heldout_rms == report.residual.heldout_rms.decode


def test_without_truth_nothing_is_compared_with_it(make_run):
    report = build_report(*make_run(truth=False))
    assert report.psnr_db is report.ssim is report.trajectory is None
    assert report.residual.rms > 0


def test_depth_is_scored_where_its_truth_is_known(make_run):
    shot, result = make_run()
    assert build_report(shot, result).depth is None
    known = replace(shot, truth=replace(shot.truth, depth=0.4 * result.depth))
    report = build_report(known, result)
    assert report.depth.scale == pytest.approx(0.4)
    assert report.depth.median_rel == pytest.approx(0, abs=1e-5)
    assert report.depth.median_px == pytest.approx(0, abs=1e-3)
    assert report.depth.rank == pytest.approx(1)
    assert build_report(known, replace(result, depth=None)).depth is None
    assert Report.model_validate_json(report.text()) == report


def test_true_views_without_true_poses_are_scored_alone(make_run):
    shot, result = make_run()
    report = build_report(replace(shot, truth=Truth(views=shot.truth.views)), result)
    assert report.psnr_db is not None
    assert report.trajectory is None


def test_a_straight_path_is_said_to_be_one(make_run):
    assert Code.TRUE_PATH_STRAIGHT in codes(build_report(*make_run(count=2)))


def test_a_path_that_runs_backwards_is_said_to(make_run):
    shot, result = make_run()
    report = build_report(shot, result)
    assert not report.trajectory.reversed
    assert Code.TRUE_PATH_REVERSED not in codes(report)
    backwards = shot.truth.world_to_camera.copy()
    backwards[:, :3, 3] *= -1  # the cameras of these runs do not turn: their centres are mirrored
    report = build_report(
        replace(shot, truth=replace(shot.truth, depth=None)), replace(result, world_to_camera=backwards)
    )
    assert report.trajectory.reversed
    assert Code.TRUE_PATH_REVERSED in codes(report)


@pytest.mark.parametrize("exchanged", [False, True])
def test_true_poses_that_contradict_the_true_depth_are_told_from_a_reversed_order(make_run, exchanged):
    shot, result = make_run()
    depth = 2 + np.random.default_rng(0).random(result.depth.shape).astype(np.float32)
    truth = replace(shot.truth, depth=5 - depth if exchanged else depth)
    as_camera_to_world = np.linalg.inv(shot.truth.world_to_camera)
    told = codes(
        build_report(
            replace(shot, truth=replace(truth, world_to_camera=as_camera_to_world)), replace(result, depth=depth)
        )
    )
    assert (Code.TRUE_PATH_CONTRADICTED in told, Code.TRUE_PATH_REVERSED in told) == (not exchanged, exchanged)


def test_a_camera_that_stands_still_is_said_to(make_run):
    shot, result = make_run()
    report = build_report(shot, replace(result, world_to_camera=np.tile(np.eye(4), (8, 1, 1))))
    assert Code.TRUE_PATH_STILL in codes(report)
    assert report.trajectory.nate > 0.1


def test_numbers_that_are_not_finite_become_null(make_run):
    shot, result = make_run()
    point = replace(result.curve[0], loss=float("nan"), heldout=float("inf"))
    broken = replace(result, curve=[point], settings={"cap": np.float32(np.inf), "path": Path("a")})
    report = build_report(shot, broken)
    assert (report.curve[0].loss, report.curve[0].heldout) == (None, None)
    assert report.settings == {"cap": None, "path": "a"}


def test_the_report_names_versions_and_machine_but_nobody(make_run):
    report = build_report(*make_run())
    assert report.versions["numpy"] == np.__version__
    assert set(asdict(report.machine)) == {"processor", "architecture", "usable_cores", "memory_mib", "system"}
    assert report.peak_mib > 10


def test_findings_are_found_by_their_code():
    dark, stopped = finding(Code.VERY_DARK, share=0.01), finding(Code.FIT_DIVERGED, times=3, best=50)
    report = a_report(dark, stopped=stopped)
    assert report.found(Code.VERY_DARK) == dark
    assert report.found(Code.FIT_DIVERGED) == stopped
    assert report.found(Code.SATURATED) is None


@pytest.mark.parametrize(
    "content",
    [
        None,
        "",
        '{"schema": "gs2ci.rep',
        '{"schema": "gs2ci.report/2"}',
        '{"schema": "gs2ci.decode/1"}',
        '{"schema": 2}',
        "[1, 2]",
        pytest.param("[" * 100_000, id="deep"),
        pytest.param('{"schema": "gs2ci.report/2", "settings": ' + '{"a":' * 500 + "1" + "}" * 501, id="deep settings"),
    ],
)
def test_a_report_that_is_missing_cut_short_or_another_is_one_typed_error(tmp_path, content):
    if content is not None:
        (tmp_path / REPORT_NAME).write_text(content)
    with pytest.raises(StorageError, match=r"report\.json"):
        read_report(tmp_path)


@pytest.mark.parametrize("version", [1, 3])
def test_a_report_of_another_version_says_what_to_do(tmp_path, version):
    (tmp_path / REPORT_NAME).write_text(json.dumps({**GOOD, "schema": f"gs2ci.report/{version}"}))
    with pytest.raises(StorageError, match="reconstruct again, or read it with the version"):
        read_report(tmp_path)


def places(value, path=()):
    """List the paths to all values of a report but those of its free parts."""
    for key, inner in value.items():
        yield (*path, key)
        if isinstance(inner, dict) and key not in ("settings", "provenance", "versions", "figures", "effects"):
            yield from places(inner, (*path, key))


def damaged(path, wrong):
    report = json.loads(json.dumps(GOOD))
    at = report
    for key in path[:-1]:
        at = at[key]
    if wrong is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = wrong
    return report


@pytest.mark.parametrize("path", list(places(GOOD)), ids=".".join)
def test_a_value_of_the_wrong_kind_is_refused_and_its_place_named(tmp_path, path):
    refused = 0
    for wrong in WRONG:
        (tmp_path / REPORT_NAME).write_text(json.dumps(damaged(path, wrong)))
        try:
            read_report(tmp_path)
        except StorageError as error:
            refused += 1
            assert path[-1] in str(error) or "the whole" in str(error)  # noqa: PT017
    assert refused >= 4


def test_what_a_report_does_not_know_is_refused(tmp_path):
    (tmp_path / REPORT_NAME).write_text(json.dumps({**GOOD, "surprise": 1}))
    with pytest.raises(StorageError, match="surprise"):
        read_report(tmp_path)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"psnr_db": None}, "scored against the truth"),
        ({"scene": {"psnr_db": None, "ssim": None}}, "scored against the truth"),
        ({"views": 7}, "another number of views than 7"),
        ({"seconds": {"total": 1.0}}, "decode, geometry, fit are missing"),
    ],
)
def test_a_report_that_contradicts_itself_is_refused(changes, complaint):
    with pytest.raises(ValidationError, match=complaint):
        a_report(**changes)


def test_it_says_what_the_measurement_and_its_masks_are_like(make_run):
    shot, result = make_run(count=3, size=(4, 10))
    masks = np.zeros_like(shot.masks)
    masks[0, :, :5], masks[1, :, 2] = 1, 0.5
    masks[2] = 1  # never exposed, so what it opens stays unseen
    saturated = np.zeros((4, 10), bool)
    saturated[0, 0] = True
    dark = replace(shot, masks=masks, weights=np.array([1, 0.9, 0], np.float32), saturated=saturated)
    measured = build_report(dark, result).measured
    assert measured.open_share == pytest.approx((20 + 2 + 40) / 120)
    assert measured.grey_share == pytest.approx(4 / 120)
    assert measured.closed_share == pytest.approx(0.5)
    assert measured.saturated_share == pytest.approx(1 / 40)
    assert measured.weights == pytest.approx((0, 1))
    assert measured.telemetry is False
    assert build_report(shot, result).measured.saturated_share is None


def test_the_simulators_plan_is_a_section_and_the_rest_of_the_provenance_stays(make_run):
    shot, result = make_run()
    effect = {"bound_rms_dn": "unavoidable", "simulated": True, "why": "it is", "sampling": ""}
    plan = {"tolerance_dn": 1, "error_dn": 0.8, "views": 60, "effects": {"shot_noise": effect}}
    report = build_report(replace(shot, provenance={"plan": plan, "source": "simulated rig"}), result)
    assert report.simulation.effects["shot_noise"].bound_rms_dn == "unavoidable"
    assert report.provenance == {"source": "simulated rig"}


def test_a_plan_that_is_not_the_simulators_stays_where_it_is(make_run):
    shot, result = make_run()
    report = build_report(replace(shot, provenance={"plan": "to be back by six"}), result)
    assert report.simulation is None
    assert report.provenance == {"plan": "to be back by six"}


def test_the_schema_describes_every_section():
    schema = Report.model_json_schema(by_alias=True)
    assert schema["properties"]["schema"]["const"] == "gs2ci.report/2"
    assert {"MeasurementSection", "GeometrySection", "Simulation", "CurvePoint", "Finding"} <= set(schema["$defs"])
