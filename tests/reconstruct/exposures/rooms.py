"""Exposures of one room whose views, paths and depths are known exactly: a wall and, before it, a panel."""

from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.cameras import in_world, pinhole
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Untied
from gs2ci.reconstruct.geometry.depth.view_depths import grid, project
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import Verdict
from gs2ci.reconstruct.geometry.path.motion import rays

SIZE = (96, 128)
FOCAL_PX = 140.0
VIEWS = 3
WALL, PANEL = 2.0, 1.1
HALF_PANEL = (0.28, 0.24)
"""Half its width and height, in the room's unit."""


def textures(seed):
    """Draw the textures of the wall and the panel, 3.2 and 0.6 wide, by layers of blurred noise."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(2):
        layers = [cv2.GaussianBlur(rng.normal(size=(400, 400, 3)), (0, 0), s) * s for s in (2, 5, 12)]
        image = sum(layers).mean(axis=2, keepdims=True) + 0.4 * sum(layers)
        found.append((0.5 + 0.2 * image / image.std()).clip(0, 1).astype(np.float32))
    return found


def seen(pose, images, wall=WALL, panel=PANEL):
    """Look at the room from a pose, [4, 4]: a view, [H, W, 3], and its depth, [H, W]."""
    directions = rays(grid(SIZE, 1), pinhole(FOCAL_PX, SIZE))
    origin = in_world(np.zeros((1, 3)), pose)[0]
    through = in_world(directions, pose) - origin
    view, depth = np.zeros((*SIZE, 3), np.float32), np.zeros(SIZE, np.float32)
    for at, half, image in ((wall, (1.9, 1.9), images[0]), (panel, HALF_PANEL, images[1])):
        along = (at - origin[2]) / through[:, 2]
        hit = origin + along[:, None] * through
        places = ((hit[:, :2] / half + 1) * 200 - 0.5).astype(np.float32).reshape(*SIZE, 2)
        colour = cv2.remap(image, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        covers = (np.abs(hit[:, :2]) < half).all(axis=1).reshape(SIZE) | (at == wall)
        view[covers], depth[covers] = colour[covers], along.reshape(SIZE)[covers]
    return view, depth


def middle(right=0.0, down=0.0, turn_deg=(0.0, 0.0, 0.0)):
    """Return the pose of a camera that was moved sideways and turned, [4, 4]."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(np.radians(turn_deg)).as_matrix()
    pose[:3, 3] = -pose[:3, :3] @ (right, down, 0.0)
    return pose


def path(at, travel=0.06):
    """Return the poses of a short straight motion about a pose, [VIEWS, 4, 4]."""
    poses = np.tile(at, (VIEWS, 1, 1))
    poses[:, 0, 3] -= np.linspace(-travel / 2, travel / 2, VIEWS)
    return poses


def exposure(name, at, seed=0, unit=1.0, noise=0.0, poses=None, **room):
    """Expose the room along a short path about a pose; the exposure's own unit is so many of the room's."""
    images, rng = textures(seed), np.random.default_rng([seed, round(1e6 * abs(at).sum())])
    poses = path(at) if poses is None else poses
    looks = [seen(pose, images, **room) for pose in poses]
    views = np.stack([view for view, _ in looks])
    views = (views + noise * rng.standard_normal(views.shape)).clip(0, 1).astype(np.float32)
    reference = len(poses) // 2
    own = poses @ np.linalg.inv(poses[reference])
    own[:, :3, 3] /= unit
    geometry = Geometry(
        world_to_camera=own,
        intrinsics=pinhole(FOCAL_PX, SIZE),
        focal_source="file",
        inverse_depth=(unit / looks[reference][1]).astype(np.float32),
        reference=reference,
        tracks=100,
        reprojection_rms_px=0.3,
        parallax_px=5.0,
        verdict=Verdict.FULL,
        notes=(),
        order_errors=10.0,
    )
    return Untied(name, views, geometry)


def truly(poses, units, first=0):
    """Return common_from_own of exposures about poses, whose units are known; common are those of the first."""
    found = []
    for pose, unit in zip(poses, units, strict=True):
        between = poses[first] @ np.linalg.inv(pose)
        found.append(Similarity(unit / units[first], between[:3, :3], between[:3, 3] / units[first]))
    return found


def off_px(found, true, geometry):
    """Return how far apart two similarities place what an exposure sees, as the first exposure sees it, px."""
    pixels = grid(SIZE, 8)
    depth = geometry.inverse_depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    points = rays(pixels, geometry.intrinsics) / depth[:, None]
    ends = [project(one.points(points), np.eye(4), geometry.intrinsics)[0] for one in (found, true)]
    return float(np.median(np.linalg.norm(ends[0] - ends[1], axis=1)))


def distorted(one, stretch=0.8, offset=0.15):
    """Return an exposure whose depth map is stretched and offset, as a small motion leaves it."""
    depth = (stretch * one.geometry.inverse_depth + offset).astype(np.float32)
    return replace(one, geometry=replace(one.geometry, inverse_depth=depth))


PLACES = (
    middle(),
    middle(0.25, 0.02, (0.5, -3.0, 1.0)),
    middle(-0.2, 0.1, (-1.0, 2.0, -2.0)),
    middle(0.05, -0.2, (2.0, 1.0, 3.0)),
)
UNITS = (1.5, 1.0, 2.0, 0.7)
