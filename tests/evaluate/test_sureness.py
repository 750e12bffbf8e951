"""Standard errors in a run folder, its report and its scene file."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.uncertainty import Uncertainty
from gs2ci.evaluate.report import read_report
from gs2ci.evaluate.run_folder import write_run
from gs2ci.evaluate.sureness import errors_of_centres, figures_of_errors
from gs2ci.reconstruct.uncertainty.factors import UNKNOWN_DEPTH
from gs2ci.render.ply import ERROR_PROPERTY, read_ply_scene

pytestmark = pytest.mark.usefixtures("undrawn")


def test_maps_and_figures_lie_in_the_run_folder(make_run, scene, tmp_path):
    shot, result = make_run()
    other = replace(result.uncertainty, other_depth=result.depth[..., ::-1].copy())
    folder = write_run(tmp_path / "run", shot, replace(result, uncertainty=other), scene)
    maps = {"views_error": other.views, "depth_error": other.depth, "depth_other": other.other_depth}
    for name, values in maps.items():
        assert np.array_equal(np.load(folder / f"{name}.npy"), values)
    said = read_report(folder).sureness
    assert said.views_mean == pytest.approx(0.055)
    assert said.views_sure_share == pytest.approx(29 / 64)
    assert said.depth_median == pytest.approx(0.055, rel=1e-5)
    assert said.positions == [0.004] * 8
    assert said.rotations_deg == pytest.approx([np.degrees(0.002)] * 8)
    assert said.other_order


def test_a_run_without_them_has_neither_files_nor_figures(make_run, scene, tmp_path):
    shot, result = make_run()
    folder = write_run(tmp_path / "run", shot, replace(result, uncertainty=None), scene)
    assert not [path for path in folder.iterdir() if path.name.endswith(("_error.npy", "_other.npy"))]
    assert read_report(folder).sureness is None
    assert read_ply_scene(folder / "scene.ply").ignored == ()


def test_a_run_without_a_path_states_those_of_views_alone(make_run):
    _, result = make_run()
    alone = replace(result, uncertainty=Uncertainty(result.uncertainty.views))
    assert set(figures_of_errors(alone)) == {"views_mean", "views_sure_share", "other_order"}
    assert figures_of_errors(replace(result, depth=np.zeros_like(result.depth))).get("depth_median") is None


def test_centres_err_as_the_depth_that_the_middle_view_sees_there(make_run, scene):
    _, result = make_run(count=1)
    pose = result.world_to_camera[0]
    places = np.array([[0.02, 0.02, 5], [0.4, 0, 5], [50.0, 0, 5], [0, 0, -3]])
    means = torch.from_numpy((places - pose[:3, 3]) @ pose[:3, :3]).float()
    found = errors_of_centres(replace(scene, means=means), result)
    ramp = result.uncertainty.views[0, 24]
    columns = [int(32 + 70.4 * x / 5) for x in (0.02, 0.4)]
    assert found[:2] == pytest.approx(5 * ramp[columns], rel=1e-4)
    assert found[2:] == pytest.approx([5 * UNKNOWN_DEPTH, 3 * UNKNOWN_DEPTH])
    assert errors_of_centres(scene, replace(result, uncertainty=None)) is None


def test_the_scene_file_has_them_as_a_property_that_readers_may_ignore(make_run, scene, tmp_path):
    shot, result = make_run()
    path = write_run(tmp_path / "run", shot, result, scene) / "scene.ply"
    back = read_ply_scene(path)
    assert back.ignored == (ERROR_PROPERTY,)
    torch.testing.assert_close(back.gaussians.means, scene.means, rtol=0, atol=0)
