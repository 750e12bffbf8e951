"""Standard errors in a run folder, its report and its scene file."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.uncertainty import Uncertainty
from gs2ci.evaluate.points import Cameras
from gs2ci.evaluate.report import SurenessSection, read_report
from gs2ci.evaluate.run_folder import write_run
from gs2ci.evaluate.sureness import errors_at, errors_of_centres, figures_of_errors
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.render.ply import read_ply_scene

pytestmark = pytest.mark.usefixtures("undrawn")


def test_maps_and_figures_lie_in_the_run_folder(make_run, scene, tmp_path):
    shot, result = make_run()
    folder = write_run(tmp_path / "run", shot, result, scene)
    maps = {"views_error": result.uncertainty.views, "depth_error": result.uncertainty.depth}
    for name, values in maps.items():
        assert np.array_equal(np.load(folder / f"{name}.npy"), values)
    said = read_report(folder).sureness
    assert said.views_mean == pytest.approx(0.055)
    assert said.views_sure_share == pytest.approx(29 / 64)
    assert said.depth_median == pytest.approx(0.055, rel=1e-5)
    assert said.positions == [0.004] * 8
    assert said.rotations_deg == pytest.approx([np.degrees(0.002)] * 8)


def test_a_run_without_them_has_neither_files_nor_figures(make_run, scene, tmp_path):
    shot, result = make_run()
    folder = write_run(tmp_path / "run", shot, replace(result, uncertainty=None), scene)
    assert not [path for path in folder.iterdir() if path.name.endswith("_error.npy")]
    assert read_report(folder).sureness is None
    assert read_ply_scene(folder / "scene.ply").standard_errors is None


def test_a_run_without_a_path_states_those_of_views_alone(make_run):
    _, result = make_run()
    alone = replace(result, uncertainty=Uncertainty(result.uncertainty.views))
    figures = figures_of_errors(alone)
    assert figures == SurenessSection(figures.views_mean, figures.views_sure_share)
    assert figures_of_errors(replace(result, depth=np.zeros_like(result.depth))).depth_median is None


def test_points_err_as_the_depth_that_a_view_sees_there(make_run, scene):
    _, result = make_run(count=1)
    pose, depth = result.world_to_camera[0], np.full_like(result.depth, 5.0)
    ramp = result.uncertainty.views
    result = replace(result, depth=depth, uncertainty=replace(result.uncertainty, depth=5 * ramp))
    places = np.array([[0.02, 0.02, 5], [0.4, 0, 5.2], [50.0, 0, 5], [0, 0, -3], [0.02, 0.02, 9]])
    means = torch.from_numpy((places - pose[:3, 3]) @ pose[:3, :3]).float()
    found = errors_of_centres(replace(scene, means=means), result)
    seen = [ramp[0, 24, int(32 + 70.4 * x / z)] * z for x, _, z in places[:2]]
    assert found[:2] == pytest.approx(seen, rel=1e-4)
    assert found[2:] == pytest.approx(factors.unknown_depth * np.linalg.norm(places[2:], axis=1), rel=1e-4)
    assert errors_of_centres(scene, replace(result, uncertainty=None)) is None


def test_of_several_views_the_surest_counts(make_run, scene):
    _, result = make_run(count=2)
    poses, depth = np.tile(np.eye(4), (2, 1, 1)), np.full_like(result.depth, 5.0)
    errors = np.stack([np.full(depth.shape[1:], 0.4), np.full(depth.shape[1:], 0.2)]).astype(np.float32)
    cameras = Cameras(poses, result.intrinsics)
    assert errors_at(np.array([[0.0, 0, 5]]), depth, errors, cameras) == pytest.approx([0.2])
    errors[1], depth[1] = 0.1, 0.0
    assert errors_at(np.array([[0.0, 0, 5]]), depth, errors, cameras) == pytest.approx([0.4])


def test_the_scene_file_has_them_as_a_property_that_readers_may_ignore(make_run, scene, tmp_path):
    shot, result = make_run()
    path = write_run(tmp_path / "run", shot, result, scene) / "scene.ply"
    back = read_ply_scene(path)
    np.testing.assert_array_equal(back.standard_errors, errors_of_centres(scene, result))
    torch.testing.assert_close(back.gaussians.means, scene.means, rtol=0, atol=0)
