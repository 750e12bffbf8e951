"""The whole reconstruction along paths from each source: files, stages, tracks, second looks, matches."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from gs2ci.evaluate.cameras import nerfstudio_transforms
from gs2ci.reconstruct.hypotheses import race
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.budget import Budget
from tests.reconstruct.pipeline.boards import FIRST, FOCAL_PX, QUICK, SHORT, VIEWS, expose, wall_with_a_board

pytestmark = pytest.mark.slow


def test_the_geometry_may_come_from_a_camera_file_found_in_proxy_views(shot, tmp_path):
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = -np.arange(VIEWS) / FOCAL_PX  # a camera that moves to the right
    camera_file = tmp_path / "transforms.json"
    camera_file.write_text(json.dumps(nerfstudio_transforms(poses, shot.intrinsics, shot.size)))
    settings = replace(FIRST, poses=f"file:{camera_file}", proxy="eni")
    result = reconstruct(shot, settings).result
    assert result.geometry.asked_for == f"file:{camera_file}"
    assert (result.geometry.method, result.geometry.proxy) == ("file", "eni")
    assert any("moved the poses of the file" in note.sentence for note in result.notes)


def test_a_stage_that_reports_millimetres_gives_path_and_depth_in_millimetres():
    """Of 60 px focal length: from step to step the board shifts by 2 px and the wall by 1 px.

    Tracks of so few pixels fall short of the shifts, so that depths are 4 to 11 % too large; between processors and
    seeds they differ by 2 % (docs/processors.md).
    """
    step_mm = 2.0
    shot = expose(wall_with_a_board(wall_px=1.0, board_px=2.0))
    told = np.tile(np.eye(4), (VIEWS, 1, 1))
    told[:, 0, 3] = -step_mm * np.arange(VIEWS)
    result = reconstruct(replace(shot, telemetry_world_to_camera=told), replace(QUICK, poses="auto")).result
    assert (result.geometry.method, result.geometry.unit_of) == ("stage", "stage")
    length_mm = np.linalg.norm(np.ptp(np.linalg.inv(result.world_to_camera)[:, :3, 3], axis=0))
    assert length_mm == pytest.approx(step_mm * (VIEWS - 1), rel=0.1)
    depth_mm = result.depth[VIEWS // 2]
    assert np.median(depth_mm[16:32, 24:40]) == pytest.approx(step_mm * FOCAL_PX / 2.0, rel=0.2)
    assert np.median(depth_mm[:8]) == pytest.approx(step_mm * FOCAL_PX / 1.0, rel=0.2)


def test_without_poses_that_were_given_lengths_have_no_unit(found_soon):
    assert found_soon.result.geometry.unit_of is None


def test_poses_that_the_views_do_not_bear_out_are_said_to_be_left_out(shot):
    """Not that the fit hardly moved them."""
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = np.linspace(0, 1, VIEWS)
    dark = replace(shot, measurement=np.zeros_like(shot.measurement), telemetry_world_to_camera=poses)
    settings = replace(FIRST, poses="stage")
    notes = [note.sentence for note in reconstruct(dark, settings).result.notes]
    assert any("poses of the stage were not used" in note for note in notes)
    assert not any("moved the poses" in note for note in notes)


def test_a_second_look_is_handed_over_where_held_out_pixels_prefer_it(shot, found_soon):
    """Every path is doubtful by this criterion; the first attempt is that of `found_soon`."""
    strict = replace(SHORT.geometry, criteria=replace(SHORT.geometry.criteria, path_error=0.0))
    again = reconstruct(shot, replace(SHORT, look_again=True, geometry=strict)).result
    judged = {one.hypothesis: one.refined_rms for one in again.race if one.refined_rms is not None}
    (taken,) = [one.hypothesis for one in again.race if one.outcome == "taken"]
    assert taken == min(judged, key=judged.get)
    assert (finding(Code.PATH_FOUND_AGAIN) in again.notes) == (taken == "second look")
    assert again.geometry.path_error_expected == found_soon.result.geometry.path_error_expected


def test_a_budget_leaves_no_time_for_a_second_look(shot, monkeypatch):
    monkeypatch.setattr(race, "second_look", lambda *_: pytest.fail("looked again"))
    strict = replace(SHORT.geometry, criteria=replace(SHORT.geometry.criteria, path_error=0.0))
    settings = replace(SHORT, look_again=True, geometry=strict)
    # A clock that goes on by two seconds whenever it is read: some forty iterations.
    budget = Budget(100.0, 0.0, lambda preset: replace(preset, fits=1), itertools.count(0.0, 2.0).__next__)
    assert reconstruct(shot, settings, budget=budget).result.views.shape == shot.truth.views.shape


def test_a_choice_by_evidence_is_explained_in_the_notes(shot):
    still = replace(shot, telemetry_world_to_camera=np.tile(np.eye(4), (VIEWS, 1, 1)))
    result = reconstruct(still, replace(FIRST, poses="auto")).result
    method = result.geometry.method
    assert result.geometry.asked_for == "auto"
    assert method == "tracks"
    said = [note.sentence for note in result.notes]
    begins = f"Geometry from {method}. Residual of each source that was tried: the stage failed"
    assert any(note.startswith(begins) for note in said)


def test_a_camera_at_rest_gets_no_path_and_one_picture_for_all_views(monkeypatch):
    shot = expose(wall_with_a_board()[VIEWS // 2 : VIEWS // 2 + 1].repeat(VIEWS, axis=0))

    def second_look(*given):
        raise AssertionError("a path was sought in the views of the fit")

    monkeypatch.setattr(race, "second_look", second_look)
    result = reconstruct(shot, replace(SHORT, poses="rest", look_again=True)).result
    assert (result.geometry.method, result.geometry.verdict) == ("rest", "static")
    assert Code.CAMERA_GIVEN_AT_REST in [note.code for note in result.notes]
    assert np.array_equal(result.world_to_camera, np.tile(np.eye(4), (VIEWS, 1, 1)))
    assert np.array_equal(result.scene_views[0], result.scene_views[-1])
