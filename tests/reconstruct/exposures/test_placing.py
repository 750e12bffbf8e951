"""Exposures in common coordinates."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot
from gs2ci.reconstruct.exposures.observing import by_stage, first_of_all, moved, placed
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.fit.scene.start import round_gaussians
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict

SIZE = (30, 40)
MATRIX = pinhole(40.0, SIZE)


def path(x=0.0, views=3):
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = -x - 0.05 * (np.arange(views) - views // 2)
    return poses


def geometry(poses, **changes):
    return Geometry(
        world_to_camera=poses,
        intrinsics=MATRIX,
        focal_source="file",
        inverse_depth=np.full(SIZE, 0.5, np.float32),
        reference=len(poses) // 2,
        tracks=0,
        reprojection_rms_px=0.0,
        parallax_px=0.0,
        verdict=Verdict.FULL,
        notes=(),
        **changes,
    )


def staged(world_to_camera, unit):
    """Return a shot, and its geometry: in the axes of its reference view, with so much of the stage's as unit."""
    reference = len(world_to_camera) // 2
    own = world_to_camera @ np.linalg.inv(world_to_camera[reference])
    own[:, :3, 3] /= unit
    shot = Shot(np.zeros((*SIZE, 1)), np.ones((len(own), *SIZE)), telemetry_world_to_camera=world_to_camera)
    return shot, geometry(own, source=PathSource.STAGE, unit=unit)


def turned(x, angle_deg):
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("y", angle_deg, degrees=True).as_matrix()
    return path(x) @ turn


def test_what_a_stage_reports_brings_paths_into_the_frame_and_the_unit_of_the_first():
    shots, geometries = zip(*(staged(*one) for one in ((turned(0.0, 3), 2.0), (turned(0.3, -8), 5.0))), strict=True)
    ties = by_stage(shots, geometries)
    common = [placed(one, ties[number]) for number, one in enumerate(geometries)]
    # Both see the stage's world alike, up to one similarity.
    world = shots[0].telemetry_world_to_camera[1]
    for shot, one in zip(shots, common, strict=True):
        expected = shot.telemetry_world_to_camera @ np.linalg.inv(world)
        expected[:, :3, 3] /= 2.0
        np.testing.assert_allclose(one.world_to_camera, expected, atol=1e-12)
        assert one.unit == pytest.approx(2.0)
    # A depth of 2 of its own is one of 5 in the unit of the first.
    np.testing.assert_allclose(1 / common[1].inverse_depth, 2 * 5.0 / 2.0, rtol=1e-6)


def test_a_stage_ties_those_whose_paths_it_gave():
    shots, geometries = zip(*(staged(path(x), 2.0) for x in (0.0, 0.3, 0.6)), strict=True)
    other = replace(geometries[0], source=PathSource.TRACKS)
    assert by_stage(shots, [other] * 3) == {}
    assert list(by_stage(shots, [other, *geometries[1:]])) == [1, 2]
    assert list(by_stage(shots, [geometries[0], other, geometries[2]])) == [0, 2]


def test_of_further_exposures_only_gaussians_that_earlier_ones_do_not_show_are_added():
    def start(x):
        places = np.array([[x, 0.0, 2.0], [x + 0.9, 0.0, 2.0], [x + 1.2, 0.0, 2.0]])
        return round_gaussians(places, np.full(3, 0.1), 0.3, np.zeros((3, 3)))

    # The picture of the first is half a depth wide to either side: 1 at a depth of 2.
    geometries = [geometry(path()), geometry(path(0.5))]
    scene, growth = first_of_all([start(0.0), start(0.5)], geometries)
    assert scene.means[3:, 0].tolist() == pytest.approx([1.4, 1.7])
    assert growth == pytest.approx(5 / 3)


def test_gaussians_move_and_grow_with_the_similarity():
    similarity = Similarity(2.0, Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.array([0.0, 0.0, 1.0]))
    scene = round_gaussians(np.array([[1.0, 0.0, 2.0]]), np.array([0.1]), 0.3, np.zeros((1, 3)))
    found = moved(scene, similarity)
    torch.testing.assert_close(found.means, torch.tensor([[0.0, 2.0, 5.0]]))
    torch.testing.assert_close(found.log_scales.exp(), torch.full((1, 3), 0.2))
