import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.evaluate.novel_views import (
    NovelViews,
    poses_in_estimate,
    read_novel_views,
    score_novel_views,
)
from gs2ci.evaluate.trajectory import align
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians

pytestmark = pytest.mark.usefixtures("undrawn")

CAMERA = np.array([[60.0, 0, 24], [0, 60, 16], [0, 0, 1]])
SIZE = (32, 48)


def path(count, seed):
    """Cameras near the origin that look along z, and never along one line."""
    rng = np.random.default_rng(seed)
    found = np.tile(np.eye(4), (count, 1, 1))
    found[:, :3, :3] = Rotation.from_rotvec(0.1 * rng.standard_normal((count, 3))).as_matrix()
    found[:, :3, 3] = 0.3 * rng.standard_normal((count, 3))
    return found


def balls(scale=1.0, turn=None, shift=(0.0, 0.0, 0.0)):
    """Coloured balls before the cameras, in a world x' = scale · turn x + shift."""
    rng = np.random.default_rng(3)
    turn = Rotation.identity() if turn is None else turn
    places = rng.uniform((-1, -1, 3), (1, 1, 5), (40, 3))
    return Gaussians(
        means=torch.tensor(scale * turn.apply(places) + shift).float(),
        log_scales=torch.full((40, 3), float(np.log(0.15 * scale))),
        quaternions=torch.tensor([[1.0, 0, 0, 0]]).repeat(40, 1),
        opacity_logits=torch.full((40,), 2.0),
        colours=torch.tensor(rng.random((40, 3))).float(),
    )


def moved(world_to_camera, scale, turn, shift):
    """The same cameras in the world x' = scale · turn x + shift."""
    found = world_to_camera.copy()
    found[:, :3, :3] = world_to_camera[:, :3, :3] @ turn.as_matrix().T
    found[:, :3, 3] = scale * world_to_camera[:, :3, 3] - found[:, :3, :3] @ shift
    return found


TURN, SHIFT = Rotation.from_rotvec([0.4, -0.7, 1.1]), np.array([0.5, -2.0, 1.0])


def seen(scene, poses):
    with torch.no_grad():
        images, _ = load_backend().views(scene, torch.from_numpy(poses).float(), torch.from_numpy(CAMERA).float(), SIZE)
    return images.numpy()


def test_a_scene_recovered_in_another_world_shows_the_true_views():
    true_path, elsewhere = path(6, 0), path(3, 1)
    novel = NovelViews(seen(balls(), elsewhere), elsewhere)
    alignment = align(moved(true_path, 2.5, TURN, SHIFT), true_path)
    scores = score_novel_views(balls(2.5, TURN, SHIFT), alignment, CAMERA, novel)
    assert len(scores["psnr_db"]["per_view"]) == 3
    assert min(scores["psnr_db"]["per_view"]) > 60
    assert scores["ssim"]["mean"] > 0.999
    wrong = score_novel_views(balls(), alignment, CAMERA, novel)
    assert wrong["psnr_db"]["mean"] < scores["psnr_db"]["mean"] - 20


def test_mono_views_are_compared_with_the_mean_of_the_channels():
    elsewhere = path(2, 1)
    images = seen(balls(), elsewhere)
    alignment = align(path(6, 0), path(6, 0))
    novel = NovelViews(images.mean(axis=3, keepdims=True), elsewhere)
    assert score_novel_views(balls(), alignment, CAMERA, novel)["psnr_db"]["mean"] > 60


def test_poses_come_back_as_they_were_before_the_world_was_moved():
    true_path, elsewhere = path(6, 0), path(3, 1)
    alignment = align(moved(true_path, 2.5, TURN, SHIFT), true_path)
    found, wanted = poses_in_estimate(alignment, elsewhere), moved(elsewhere, 2.5, TURN, SHIFT)
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_a_file_of_bytes_or_floats_is_read(tmp_path):
    poses = path(2, 1)
    np.savez(tmp_path / "bytes.npz", views=np.full((2, 4, 5, 3), 255, np.uint8), world_to_camera=poses)
    found = read_novel_views(tmp_path / "bytes.npz")
    assert found.views.dtype == np.float32
    assert (found.views == 1).all()
    np.savez(tmp_path / "words.npz", views=np.full((2, 4, 5, 3), 65535, np.uint16), world_to_camera=poses)
    assert (read_novel_views(tmp_path / "words.npz").views == 1).all()
    np.savez(tmp_path / "floats.npz", views=np.full((2, 4, 5, 1), 0.25), world_to_camera=poses)
    assert (read_novel_views(tmp_path / "floats.npz").views == 0.25).all()


@pytest.mark.parametrize(
    "parts",
    [
        {},
        {"views": np.zeros((2, 4, 5, 3))},
        {"views": np.zeros((2, 4, 5, 3)), "world_to_camera": np.full((2, 4, 4), "a")},
        {"views": np.full((2, 4, 5, 3), "a"), "world_to_camera": np.zeros((2, 4, 4))},
        {"views": np.zeros((2, 4, 5, 2)), "world_to_camera": np.zeros((2, 4, 4))},
        {"views": np.zeros((2, 4, 5, 3)), "world_to_camera": np.zeros((3, 4, 4))},
        {"views": np.zeros((0, 4, 5, 3)), "world_to_camera": np.zeros((0, 4, 4))},
        {"views": np.full((2, 4, 5, 3), np.nan), "world_to_camera": np.zeros((2, 4, 4))},
    ],
)
def test_files_that_hold_no_novel_views_are_refused(tmp_path, parts):
    np.savez(tmp_path / "novel.npz", **parts)
    with pytest.raises(InputError, match="holds"):
        read_novel_views(tmp_path / "novel.npz")
    with pytest.raises(InputError, match="holds no novel views"):
        read_novel_views(tmp_path / "missing.npz")


@pytest.mark.parametrize("value", [255.0, 2.0, -1.0, np.int64(255), np.int16(-4)])
def test_views_of_another_scale_are_refused(tmp_path, value):
    views = np.zeros((2, 4, 5, 3), np.asarray(value).dtype)
    views[1, 2, 3, 0] = value
    np.savez(tmp_path / "novel.npz", views=views, world_to_camera=path(2, 1))
    with pytest.raises(InputError, match=rf"holds views from .*{value:g}.*allowed: full scale 1.*divide them"):
        read_novel_views(tmp_path / "novel.npz")


@pytest.mark.parametrize("scale", [2.0, -1.0, 0.0])
def test_poses_that_are_not_rigid_are_refused(tmp_path, scale):
    poses = path(2, 1)
    poses[1, :3, :3] *= scale
    np.savez(tmp_path / "novel.npz", views=np.zeros((2, 4, 5, 3)), world_to_camera=poses)
    with pytest.raises(InputError, match=r"novel\.npz: world_to_camera are no rigid motions"):
        read_novel_views(tmp_path / "novel.npz")


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and no more", b"text"])
def test_files_that_are_no_archive_are_refused(tmp_path, content):
    (tmp_path / "novel.npz").write_bytes(content)
    with pytest.raises(InputError, match="holds no novel views"):
        read_novel_views(tmp_path / "novel.npz")


def test_a_lone_array_is_refused(tmp_path):
    np.save(tmp_path / "novel.npy", np.zeros((2, 4, 5, 3)))
    with pytest.raises(InputError, match="holds no novel views"):
        read_novel_views(tmp_path / "novel.npy")
