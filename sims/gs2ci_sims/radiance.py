"""The light that a scene sends to the camera: linear radiance images, integrated over each pixel's area.

Here: the renderer with supersampling, and depth maps. Not here: time, masks, electrons (`exposure`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final

import numpy as np
import torch
from pydantic import PositiveInt

from gs2ci.core.arrays import F32, F64
from gs2ci.core.bounds import BoundedRecord
from gs2ci.render.backend import load_backend
from gs2ci.render.conventions import DILATION_PX2
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.sampling import CanvasSampling
from gs2ci_sims.rays.meshes import trace_mesh
from gs2ci_sims.scene import Scene

# With few rays, sharp edges of triangles make a moving image grainier than Gaussians do: 1.8e-3 to 3.8e-3 of full scale
# on `blocks` with two rays per pixel side, 2.3e-3 with four, 1.7e-3 with eight.
MESH_GRAIN: Final = 4e-3
# Poses per call of the rasteriser: bounds the memory of supersampled views.
VIEWS_AT_ONCE: Final = 8


@dataclass(frozen=True)
class Renderer(BoundedRecord):
    """Renders scenes as a sensor with square, fully sensitive pixels sees them.

    Args:
        supersampling: Samples per pixel side. Each image is drawn that much larger and averaged over the pixels'
            areas; the splats' own pixel filter then shrinks with the sample and hardly blurs.
        backend: Which rasteriser of `gs2ci.render.backend`.
    """

    grain: ClassVar[float] = 8e-5
    """Rms variation of a moving image's views that is an artefact of rendering, as a share of full scale: on planes,
    4e-5 to 8e-5 about a polynomial through a pixel of motion."""
    sample_filter_px2: ClassVar[float] = DILATION_PX2
    """Variance of the blur of each sample, in samples squared."""

    supersampling: PositiveInt = 2
    backend: str = "cpu"
    _last: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def finer(self, scene: Scene) -> "Renderer":
        """Return a renderer with twice as many samples, which resolves detail that this one's samples alias.

        For meshes it is this one: their grain includes the detail between rays.
        """
        return self if scene.mesh is not None else replace(self, supersampling=2 * self.supersampling)

    def grain_of(self, scene: Scene) -> float:
        """Return the grain of this scene's views."""
        return self.grain if scene.mesh is None else MESH_GRAIN * float(np.sqrt(2 / self.supersampling))

    def views(
        self, scene: Scene, world_to_camera: F64, *, gaussians: Gaussians | None = None, margin: int = 0
    ) -> tuple[F32, F32]:
        """Render the scene from each pose.

        Args:
            scene: The scene and its camera.
            world_to_camera: Poses, [V, 4, 4].
            gaussians: Gaussians in place of the scene's own, if something moves.
            margin: Pixels to add on each side; H and W below grow by twice that.

        Returns:
            Radiance [V, H, W, 3] (>= 0; 1 is white) and coverage [V, H, W] (0 where a ray meets nothing).
        """
        factor = self.supersampling
        radiance, coverage = [], []
        for images, alphas in self._large_views(scene, world_to_camera, gaussians, margin):
            radiance.append(binned(images, factor))
            coverage.append(binned(alphas[..., None], factor)[..., 0])
        # Spherical harmonics of a fitted scene may be negative; light is not.
        return (
            np.maximum(np.concatenate(radiance), 0).astype(np.float32, copy=False),
            np.concatenate(coverage).astype(np.float32, copy=False),
        )

    def supersampled_views(self, scene: Scene, world_to_camera: F64, *, margin: int = 0) -> F32:
        """Render the scene before it is averaged over the pixels' areas, [V, H s, W s, 3] with s samples per side."""
        images = [images.numpy() for images, _ in self._large_views(scene, world_to_camera, None, margin)]
        return np.asarray(np.maximum(np.concatenate(images), 0), dtype=np.float32)

    def depth(self, scene: Scene, world_to_camera: F64, *, gaussians: Gaussians | None = None, margin: int = 0) -> F64:
        """Render the depth (z) from one pose [4, 4], [H, W]; NaN at pixels with less than half coverage.

        Arguments as in `views`.
        """
        size = (scene.size[0] + 2 * margin, scene.size[1] + 2 * margin)
        intrinsics = with_margin(scene.intrinsics, margin)
        if scene.mesh is not None:
            depth = trace_mesh(scene.mesh, world_to_camera, intrinsics, size)[1]
            return np.where(np.isfinite(depth), depth, np.nan)
        return rendered_depth(scene.gaussians if gaussians is None else gaussians, world_to_camera, intrinsics, size)

    def _large_views(
        self, scene: Scene, world_to_camera: F64, gaussians: Gaussians | None, margin: int
    ) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """Render images and coverage before averaging; the last single view is cached, for cameras at rest."""
        gaussians = scene.gaussians if gaussians is None else gaussians
        draw = self._drawn if scene.mesh is None else self._drawn_mesh
        if len(world_to_camera) != 1:
            yield from draw(scene, world_to_camera, gaussians, margin)
            return
        last = self._last
        same = last and last["gaussians"] is gaussians and last["scene"] is scene and last["margin"] >= margin
        if not same or not np.array_equal(last["pose"], world_to_camera):
            (view,) = draw(scene, world_to_camera, gaussians, margin)
            last.update(
                gaussians=gaussians, scene=scene, margin=margin, pose=np.array(world_to_camera, copy=True), view=view
            )
        rim = (last["margin"] - margin) * self.supersampling
        images, alphas = last["view"]
        inner = slice(rim, -rim or None)
        yield images[:, inner, inner], alphas[:, inner, inner]

    def _enlarged(self, scene: Scene, margin: int) -> tuple[F64, tuple[int, int]]:
        """Return the camera matrix and the size of images before averaging."""
        factor = self.supersampling
        enlarged = with_margin(scene.intrinsics, margin) * np.array([[factor], [factor], [1.0]])
        return enlarged, ((scene.size[0] + 2 * margin) * factor, (scene.size[1] + 2 * margin) * factor)

    def _drawn_mesh(
        self, scene: Scene, world_to_camera: F64, gaussians: Gaussians, margin: int
    ) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        """Render a mesh by rays, which every renderer does."""
        assert scene.mesh is not None
        enlarged, large = self._enlarged(scene, margin)
        for pose in world_to_camera:
            radiance, depth = trace_mesh(scene.mesh, pose, enlarged, large)
            yield torch.from_numpy(radiance[None]), torch.from_numpy(np.isfinite(depth[None]).astype(np.float64))

    def _drawn(
        self, scene: Scene, world_to_camera: F64, gaussians: Gaussians, margin: int
    ) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        backend = load_backend(self.backend)
        gaussians = gaussians.detach()
        enlarged, large = self._enlarged(scene, margin)
        intrinsics = torch.tensor(enlarged, dtype=torch.float32)
        for first in range(0, len(world_to_camera), VIEWS_AT_ONCE):
            poses = torch.tensor(world_to_camera[first : first + VIEWS_AT_ONCE], dtype=torch.float32)
            with torch.no_grad():
                yield backend.views(gaussians, poses, intrinsics, large)


def with_margin(intrinsics: F64, margin: int) -> F64:
    """Return the intrinsics, [3, 3], of an image with `margin` more pixels on each side."""
    shifted = intrinsics.copy()
    shifted[:2, 2] += margin
    return shifted


def rendered_depth(
    gaussians: Gaussians,
    world_to_camera: F64,
    intrinsics: F64,
    size: tuple[int, int],
    sampling: CanvasSampling | None = None,
) -> F64:
    """Render the depth (z) at which light is absorbed, [H, W]; NaN at pixels where less than half of it is.

    Args:
        gaussians: The Gaussians.
        world_to_camera: The pose, [4, 4].
        intrinsics: [3, 3], px.
        size: Height and width, px.
        sampling: The pixels' viewing directions, for a lens with distortion.
    """
    found = load_backend("cpu").depths(
        gaussians.detach(),
        torch.tensor(world_to_camera, dtype=torch.float32)[None],
        torch.tensor(intrinsics, dtype=torch.float32),
        size,
        sampling,
    )
    depth = found.surface()[0].to(torch.float64).numpy()
    return np.where(depth > 0, depth, np.nan)


def binned(images: torch.Tensor, factor: int) -> F32:
    """Average [V, H f, W f, C] over blocks of f x f, to [V, H, W, C]."""
    views, rows, columns, channels = images.shape
    blocks = images.reshape(views, rows // factor, factor, columns // factor, factor, channels)
    return blocks.mean(dim=(2, 4)).numpy()
