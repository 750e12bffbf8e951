"""Scenes from Gaussian PLY files, as fitted from real photographs.

Here: the file and its camera. Not here: the format (`gs2ci.render.ply`).
"""

from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.render.ply import read_ply
from gs2ci_sims.radiance import rendered_depth
from gs2ci_sims.scene import Scene, camera_looking_ahead

FIELD_OF_VIEW_DEG: Final = 60.0


def scene_from_ply(
    path: Path,
    size: tuple[int, int],
    *,
    intrinsics: F64 | None = None,
    world_to_camera: F64 | None = None,
) -> Scene:
    """Read a scene; its suggested camera is the given one.

    Args:
        path: A PLY file of Gaussians in the 3DGS convention. Its colours count as linear radiance, as gs2ci's are;
            other programs' are those of the photographs they were fitted to, usually sRGB, and are not decoded.
        size: Height and width of the camera's image, in pixels.
        intrinsics: [3, 3]; a centred camera of 60 degrees if None.
        world_to_camera: Its pose, [4, 4]; the origin, looking along z, if None.

    Raises:
        InputError: The file is not such a PLY file, or nothing of the scene is in front of the camera.
    """
    gaussians = read_ply(path)
    intrinsics = camera_looking_ahead(size, FIELD_OF_VIEW_DEG) if intrinsics is None else intrinsics
    world_to_camera = np.eye(4) if world_to_camera is None else world_to_camera
    depth = rendered_depth(gaussians, world_to_camera, intrinsics, size)
    return Scene(path.stem, gaussians, intrinsics, size, depth, world_to_camera)
