"""Scenes whose views, depths, paths and tracks are known exactly, and small ONNX models of any signature."""

import json
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper, save
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.cameras import nerfstudio_transforms
from gs2ci.reconstruct.geometry.path.motion import predict_positions
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks
from gs2ci.reconstruct.measurement.coding import Coding

REFERENCE_MARGIN = 40


def bent_path(views, rng, length=0.05, turn=0.012):
    """A smooth hand-held path, [N, 4, 4], the identity in the middle."""
    along = np.linspace(-1, 1, views) - np.linspace(-1, 1, views)[views // 2]
    bend = along[:, None] ** 2 * 0.4
    poses = np.tile(np.eye(4), (views, 1, 1))
    direction = rng.normal(size=3) * (1, 1, 0.2)
    centres = length * (
        along[:, None] * direction / np.linalg.norm(direction) + bend * rng.normal(size=3) * (1, 1, 0.2)
    )
    turns = turn * (along[:, None] * rng.normal(size=3) + bend * rng.normal(size=3))
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    return poses


def rotation_error_deg(a, b):
    return np.degrees(Rotation.from_matrix(a[:, :3, :3] @ b[:, :3, :3].transpose(0, 2, 1)).magnitude()).max()


def path_error(estimate, truth):
    """Root mean square distance of camera centres after the best scale, relative to the path's length."""
    centres = [-np.einsum("nji,nj->ni", p[:, :3, :3], p[:, :3, 3]) for p in (estimate, truth)]
    scale = (centres[0] * centres[1]).sum() / (centres[0] ** 2).sum()
    error = np.sqrt(((scale * centres[0] - centres[1]) ** 2).sum(1).mean())
    return error / np.linalg.norm(centres[1].max(0) - centres[1].min(0))


@dataclass(frozen=True)
class TrackedScene:
    tracks: Tracks
    intrinsics: np.ndarray
    poses: np.ndarray
    inverse_depth: np.ndarray


def make_tracks(seed=0, views=8, points=300, noise_px=0.0, outliers=0.0, missing=0.0, focal=300.0, poses=None):
    rng, size = np.random.default_rng(seed), (240, 320)
    intrinsics, reference = pinhole(focal, size), views // 2
    poses = bent_path(views, rng) if poses is None else poses
    corners = rng.uniform((0, 0), (size[1], size[0]), (points, 2))
    inverse_depth = rng.uniform(0.4, 1.8, points)
    positions = predict_positions(corners, inverse_depth, poses, intrinsics)
    noise = noise_px * rng.normal(size=positions.shape)
    spoilt = rng.random((points, views)) < outliers / views
    noise[spoilt] += 15 * rng.normal(size=(int(spoilt.sum()), 2))
    noise[rng.random((points, views)) < missing] = np.nan
    noise[:, reference] = 0
    return TrackedScene(Tracks(positions + noise, reference), intrinsics, poses, inverse_depth)


@dataclass(frozen=True)
class SeenScene:
    views: np.ndarray
    intrinsics: np.ndarray
    poses: np.ndarray
    inverse_depth: np.ndarray


def texture(rng, height, width, channels):
    layers = [cv2.GaussianBlur(rng.normal(size=(height, width, channels)), (0, 0), s) * s for s in (1.5, 4, 10)]
    image = sum(layers).reshape(height, width, channels)
    return (0.5 + 0.16 * image / image.std()).clip(0, 1).astype(np.float32)


def make_views(seed=0, views=5, size=(90, 120), channels=3, poses=None, focal=100.0, depths=(0.6, 1.4)):
    """Views of a textured wall and, before it, a textured panel in the middle: exact homographies of each."""
    rng, reference = np.random.default_rng(seed), views // 2
    intrinsics = pinhole(focal, size)
    poses = bent_path(views, rng, length=0.06, turn=0.01) if poses is None else poses
    height, width = size
    margin = REFERENCE_MARGIN
    panel = np.zeros((height + 2 * margin, width + 2 * margin), np.float32)
    panel[margin + height // 4 : margin + 3 * height // 4, margin + width // 4 : margin + 3 * width // 4] = 1
    # cv2.warpPerspective puts pixel centres at integers, and the texture starts at −margin.
    texture_from_pixel = np.array([[1, 0, margin - 0.5], [0, 1, margin - 0.5], [0, 0, 1.0]])
    array_from_pixel = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    stack = np.zeros((views, height, width, channels), np.float32)
    for depth, cover in zip(depths, (np.ones_like(panel), panel), strict=True):
        image = texture(rng, *panel.shape, channels)
        for i, pose in enumerate(poses):
            through = pose[:3, :3].copy()
            through[:, 2] += depth * pose[:3, 3]
            warp = array_from_pixel @ intrinsics @ through @ np.linalg.inv(texture_from_pixel @ intrinsics)
            colour = cv2.warpPerspective(image, warp, (width, height)).reshape(height, width, channels)
            alpha = cv2.warpPerspective(cover, warp, (width, height))[..., None]
            stack[i] = alpha * colour + (1 - alpha) * stack[i]
    truth = np.where(panel[margin:-margin, margin:-margin] > 0, depths[1], depths[0]).astype(np.float32)
    assert np.isfinite(stack[reference]).all()
    return SeenScene(stack, intrinsics, poses, truth)


@pytest.fixture(scope="session")
def tracked():
    """Make tracks of random points along a hand-held path; noise is in all views but the reference."""
    return make_tracks


@pytest.fixture(scope="session")
def seen():
    """Make views of two textured planes along a hand-held path."""
    return make_views


@pytest.fixture(scope="session")
def compare():
    """Compare paths: `path_error` and `rotation_error_deg`."""
    return path_error, rotation_error_deg


@pytest.fixture(scope="session")
def path():
    return bent_path


@pytest.fixture(scope="session")
def expose():
    """Code views by random masks into a shot that knows its camera."""

    def make(scene, *, share=0.35, **parts):
        masks = (np.random.default_rng(5).random(scene.views.shape[:3]) < share).astype(np.float32)
        given = Shot(
            measurement=(masks[..., None] * scene.views).sum(axis=0),
            masks=masks,
            weights=np.ones(len(masks), np.float32),
            intrinsics=scene.intrinsics,
        )
        return replace(given, **parts).check()

    return make


@pytest.fixture
def camera_file_of():
    """Write a transforms.json of a camera with its axis in the middle."""

    def write(folder, poses, focal_px, size, distortion=None):
        path = folder / "transforms.json"
        path.write_text(json.dumps(nerfstudio_transforms(poses, pinhole(focal_px, size), size, distortion)))
        return path

    return write


@pytest.fixture
def make_vggt(write_model):
    """Write a model of VGGT's signature that knows the views of a scene by their brightness, and answers from a table.

    It shows what it was made to say whatever the order of the views, as a real one should.
    """

    def make(scene, *, poses=None, focal=None, depth=None, matrices=False, batch=False, views="s", side=14):
        height, width = (s // side * side for s in scene.views.shape[1:3])
        poses = scene.poses if poses is None else poses
        focal = np.broadcast_to(scene.intrinsics[0, 0] if focal is None else focal, len(poses))
        depth = 1 / scene.inverse_depth if depth is None else depth
        shrink = min(height / scene.views.shape[1], width / scene.views.shape[2])
        inner = tuple(round(s * shrink) for s in scene.views.shape[1:3])
        fov = 2 * np.arctan(np.array([height, width]) / 2 / (focal[:, None] * shrink))
        pose_enc = np.zeros((len(poses), 9), np.float32)
        if not matrices:
            quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
            pose_enc = np.concatenate([poses[:, :3, 3], quaternions, fov], axis=1).astype(np.float32)
        frame, top, left = np.ones((height, width), np.float32), (height - inner[0]) // 2, (width - inner[1]) // 2
        depth_map = frame * float(np.median(depth))
        depth_map[top : top + inner[0], left : left + inner[1]] = cv2.resize(
            depth.astype(np.float32), inner[::-1], interpolation=cv2.INTER_NEAREST
        )
        means = []
        for view in scene.views:
            image = np.ones((height, width, 3), np.float32)
            image[top : top + inner[0], left : left + inner[1]] = cv2.resize(
                view, inner[::-1], interpolation=cv2.INTER_AREA
            ).reshape(*inner, -1)
            means.append(image.mean(dtype=np.float64))
        scaled = np.tile(np.diag([1.0, 1, 1]), (len(poses), 1, 1)).astype(np.float32)
        scaled[:, 0, 0] = scaled[:, 1, 1] = focal * shrink
        constants = {
            "means": np.array(means, np.float32)[None],
            "poses": pose_enc,
            "extrinsics_of": poses[:, :3].astype(np.float32),
            "intrinsics_of": scaled,
            "depths": np.tile(depth_map[None, ..., None], (len(poses), 1, 1, 1)),
            "flat": np.array([-1, 1], np.int64),
            "first": np.array([0], np.int64),
        }
        nodes = [
            ("ReduceMean", ["views"], ["mean"], {"axes": [1, 2, 3], "keepdims": 0}),
            ("Reshape", ["mean", "flat"], ["column"]),
            ("Sub", ["column", "means"], ["difference"]),
            ("Abs", ["difference"], ["distance"]),
            ("ArgMin", ["distance"], ["index"], {"axis": 1, "keepdims": 0}),
            ("Gather", ["depths", "index"], ["depth"]),
        ]
        nodes.insert(0, ("Squeeze", ["images", "first"], ["views"]) if batch else ("Identity", ["images"], ["views"]))
        if matrices:
            nodes += [("Gather", [f"{name}_of", "index"], [name]) for name in ("extrinsics", "intrinsics")]
            said = [("extrinsics", (views, 3, 4)), ("intrinsics", (views, 3, 3))]
        else:
            nodes.append(("Gather", ["poses", "index"], ["pose_enc"]))
            said = [("pose_enc", (views, 9))]
        shape = (1, views, 3, height, width) if batch else (views, 3, height, width)
        return write_model(
            nodes,
            [("images", shape)],
            [*said, ("depth", (views, height, width, 1))],
            [numpy_helper.from_array(value, name) for name, value in constants.items()],
        )

    return make


@pytest.fixture(scope="session")
def smooth_shot():
    """Four views of 32 × 40 pixels behind masks that open four elements in ten."""
    rng = np.random.default_rng(0)
    picture = gaussian_filter(rng.random((32, 40, 3)), (3, 3, 0))
    picture = 0.2 + 0.6 * (picture - picture.min()) / np.ptp(picture)
    views = np.stack([np.roll(picture, step, axis=1) for step in range(4)]).astype(np.float32)
    masks = (rng.random((4, 32, 40)) < 0.4).astype(np.float32)
    measurement = (masks[..., None] * views).sum(axis=0)
    return Shot(measurement=measurement, masks=masks, weights=np.ones(4, np.float32), truth=Truth(views)).check()


@pytest.fixture
def write_model(tmp_path):
    """Write a model; inputs, outputs: (name, shape[, kind]); nodes: (operator, inputs, outputs[, attributes])."""

    def value(name, shape, kind=TensorProto.FLOAT):
        return helper.make_tensor_value_info(name, kind, shape)

    def write(nodes, inputs, outputs, constants=(), *, opset=17, name="small.onnx"):
        graph = helper.make_graph(
            [helper.make_node(*node[:3], **(node[3] if len(node) > 3 else {})) for node in nodes],
            "small",
            [value(*one) for one in inputs],
            [value(*one) for one in outputs],
            list(constants),
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
        model.ir_version = 8
        save(model, tmp_path / name)
        return tmp_path / name

    return write


@pytest.fixture
def make_shot():
    """Code smooth views, the same for all or sliding from one to the next, under random masks."""

    def make(n=4, size=(32, 40), channels=1, *, slide=0.0, cfa=None, grey=False, noise=0.0, **parts):
        rng = np.random.default_rng(5)
        y, x = np.mgrid[: size[0], : size[1]] / 5
        moved = slide * np.arange(n)[:, None, None, None]
        shades = np.arange(3 if cfa else channels) * 0.4
        views = 0.5 + 0.35 * np.sin(x[None, ..., None] + moved + shades) * np.cos(y[None, ..., None] - shades)
        masks = rng.random((n, *size)) if grey else rng.random((n, *size)) < 0.5
        masks = masks.astype(np.float32)
        weights = np.ones(n, np.float32)
        blank = Shot(np.zeros((*size, 1 if cfa else channels), np.float32), masks, weights, cfa=cfa)
        coded = Coding.of(blank).forward(torch.from_numpy(views.astype(np.float32))).numpy()
        coded = coded + rng.normal(0, noise, coded.shape).astype(np.float32) if noise else coded
        return Shot(coded, masks, weights, cfa=cfa, truth=Truth(views.astype(np.float32)), **parts).check()

    return make
