"""Poses of a camera that is carried around a point, and looks at it: wide baselines for tests."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

PLACES = ((9, 2), (-8, -3), (0, 0), (4, -4), (-11, 3))
"""Degrees around the point, right and down, in no order; the middle one looks straight."""


def around(places: Sequence[tuple[float, float]], distance: float) -> NDArray[np.float64]:
    """Return the poses, [N, 4, 4], around a point at a distance along the axis of the camera that looks straight."""
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    pivot = np.array([0.0, 0.0, distance])
    for pose, (across, up) in zip(poses, places, strict=True):
        turn = Rotation.from_euler("yx", (across, up), degrees=True).as_matrix()
        pose[:3, :3], pose[:3, 3] = turn, pivot - turn @ pivot
    return poses
