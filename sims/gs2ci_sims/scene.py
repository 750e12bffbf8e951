"""What a scene is: Gaussians or a mesh, the camera that suits them, and the true depth.

Here: the record. Not here: any particular scene (`gs2ci_sims.scenes`), poses over time (`gs2ci_sims.path`), rendering
(`gs2ci_sims.radiance`).
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import pinhole
from gs2ci.core.errors import InputError
from gs2ci.core.records import check_intrinsics, check_rigid
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.rays.meshes import TexturedMesh


@dataclass(frozen=True)
class Scene:
    """Something to look at, and from where.

    Args:
        name: For reports.
        gaussians: The scene; colours are linear radiance, 1 is white.
        intrinsics: Suggested camera in pixels, [3, 3]; pixel centres at +0.5.
        size: Height and width of its image, in pixels.
        depth: True depth (z) from the suggested camera, [H, W], scene units; NaN where nothing is.
        world_to_camera: Pose of the suggested camera, [4, 4], OpenCV axes.
        mesh: What is there instead of Gaussians; then there are none.

    Raises:
        InputError: Parts disagree, the pose is no rigid motion, or nothing is in front of the camera.
    """

    name: str
    gaussians: Gaussians
    intrinsics: F64
    size: tuple[int, int]
    depth: F64
    world_to_camera: F64 = field(default_factory=lambda: np.eye(4))
    mesh: TexturedMesh | None = None

    def __post_init__(self) -> None:
        check_intrinsics(self.intrinsics)
        if self.mesh is not None and len(self.gaussians):
            raise InputError(
                f"scene {self.name!r} of {len(self.gaussians)} Gaussians and a mesh", allowed="one kind or the other"
            )
        if min(self.size) < 1 or self.depth.shape != self.size:
            raise InputError(
                f"scene {self.name!r}: image size {self.size} with a depth map of shape {self.depth.shape}",
                allowed="a positive height and width, and one depth per pixel",
            )
        if self.world_to_camera.shape != (4, 4) or not np.isfinite(self.world_to_camera).all():
            raise InputError(
                f"scene {self.name!r}: camera pose {self.world_to_camera.tolist()}",
                allowed="a rigid world-to-camera matrix, [4, 4], of finite numbers",
            )
        check_rigid(f"scene {self.name!r}: the camera's poses", self.world_to_camera[None])
        if not (self.depth[np.isfinite(self.depth)] > 0).any():
            raise InputError(
                f"scene {self.name!r} has nothing in front of its camera",
                remedy="turn the camera, or move the scene to positive depth (z)",
            )

    @cached_property
    def median_depth(self) -> float:
        """Get the median true depth in scene units (above 0)."""
        return float(np.nanmedian(self.depth))

    @cached_property
    def brightest(self) -> float:
        """Get the radiance that no pixel exceeds, whatever it sees, from wherever: blending only averages colours.

        Harmonics h add at most |h| (sum of Y^2)^(1/2) (Cauchy and Schwarz), and sum of Y^2 over the orders up to L,
        the constant one aside, is ((L + 1)^2 - 1) / (4 pi) in every direction (the addition theorem).
        """
        if self.mesh is not None:
            return self.mesh.brightest
        colours = self.gaussians.colours.detach().to(torch.float64)
        harmonics = self.gaussians.harmonics
        if harmonics is not None:
            degrees = harmonics.shape[1]
            norms = torch.linalg.vector_norm(harmonics.detach().to(torch.float64), dim=1)
            colours = colours + norms * float(np.sqrt(degrees / (4 * np.pi)))
        return max(float(colours.max()), 0.0) if colours.numel() else 0.0

    def depth_range(self) -> tuple[float, float]:
        """Get the nearest and farthest depth of the middle 98 % of the pixels, in scene units."""
        return self._depth_range

    # A plan asks dozens of times.
    @cached_property
    def _depth_range(self) -> tuple[float, float]:
        low, high = np.nanquantile(self.depth, [0.01, 0.99])
        return float(low), float(high)


def camera_looking_ahead(size: tuple[int, int], field_of_view_deg: float) -> F64:
    """Build the intrinsics of a centred camera from its horizontal field of view, [3, 3].

    Raises:
        InputError: The field of view is not between 0 and 180 degrees.
    """
    if not 0 < field_of_view_deg < 180:
        raise InputError(f"field of view of {field_of_view_deg} degrees", allowed="more than 0, less than 180")
    return pinhole(0.5 * size[1] / np.tan(0.5 * np.deg2rad(field_of_view_deg)), size)
