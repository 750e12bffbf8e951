from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.ply import write_ply
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.scenes.ply import scene_from_ply


@pytest.fixture
def file(small_scene, tmp_path):
    path = tmp_path / "stand.ply"
    write_ply(path, small_scene.gaussians)
    return path


def test_a_scene_read_from_its_file_looks_the_same(small_scene, file):
    scene = scene_from_ply(file, small_scene.size, intrinsics=small_scene.intrinsics)
    assert scene.name == "stand"
    here, there = (Renderer().views(each, np.eye(4)[None])[0] for each in (small_scene, scene))
    np.testing.assert_allclose(there, here, atol=1e-4)
    assert scene.median_depth == pytest.approx(small_scene.median_depth, rel=0.05)


def test_without_intrinsics_the_camera_is_centred(file):
    scene = scene_from_ply(file, (30, 40))
    assert scene.intrinsics[:2, 2].tolist() == [20.0, 15.0]


def test_a_camera_that_looks_away_is_told_that_it_sees_nothing(file):
    with pytest.raises(InputError, match="nothing in front"):
        scene_from_ply(file, (30, 40), world_to_camera=np.diag([1.0, -1.0, -1.0, 1.0]))


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"missing\.ply"):
        scene_from_ply(tmp_path / "missing.ply", (30, 40))


def test_colours_that_change_with_direction_come_along(small_scene, tmp_path):
    harmonics = torch.full((len(small_scene.gaussians), 8, 3), 0.1)
    path = write_ply(tmp_path / "shiny.ply", replace(small_scene.gaussians, harmonics=harmonics))
    assert torch.equal(scene_from_ply(path, (30, 40)).gaussians.harmonics, harmonics)
