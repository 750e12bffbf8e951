"""Standard errors in a run folder, its report and its scene file."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.findings import Code, finding
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.evaluate.points import Cameras
from gs2ci.evaluate.report import SurenessSection, read_report
from gs2ci.evaluate.run_folder import write_run
from gs2ci.evaluate.sureness import DEPTH_OTHER, errors_at, errors_of_centres, figures_of_errors, in_other_order
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


def test_depth_in_the_other_order_gives_the_same_displacements_to_the_opposite_travel():
    depth = np.linspace(2, 10, 480, dtype=np.float32).reshape(1, 20, 24)
    other = in_other_order(depth)
    ends = np.quantile(1 / depth, (0.005, 0.995))
    within = (1 / depth >= ends[0]) & (1 / depth <= ends[1])
    # Displacements of opposite travels, each 1 / depth times a constant, differ by what a turn adds: a constant.
    assert np.ptp((1 / depth + 1 / other)[within]) == pytest.approx(0, abs=1e-6)
    assert other.min() == pytest.approx(1 / ends[1], rel=1e-5)
    assert other.max() == pytest.approx(1 / ends[0], rel=1e-5)
    assert in_other_order(other)[within] == pytest.approx(depth[within], rel=0.01)


def test_depth_that_is_nowhere_or_everywhere_the_same_has_no_other_order():
    assert not in_other_order(np.zeros((1, 2, 3), np.float32)).any()
    even = np.array([[[5.0, 0.0, 5.0]]], np.float32)
    assert in_other_order(even).tolist() == even.tolist()


def test_a_run_whose_order_is_open_holds_the_depth_of_the_other_one(make_run, scene, tmp_path):
    shot, result = make_run()
    assert not (write_run(tmp_path / "settled", shot, result, scene) / DEPTH_OTHER).exists()
    doubted = replace(result, notes=(finding(Code.DEPTH_ORDER_OPEN, errors=0.3),))
    folder = write_run(tmp_path / "open", shot, doubted, scene)
    assert np.array_equal(np.load(folder / DEPTH_OTHER), in_other_order(result.depth))
    assert f"{DEPTH_OTHER} has depth with near and far exchanged" in (folder / "report.html").read_text()
