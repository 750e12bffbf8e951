"""A renderer that shares nothing with the solver's: Gaussian scenes ray by ray in float64.

It stands behind the interface of `radiance.Renderer`, so that exposures, plans and twins take either. Not here: the
rays (`rays`), the solver's rasteriser, which the other renderer uses.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
import torch
from pydantic import PositiveInt

from gs2ci.core.arrays import F64
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import colours_seen
from gs2ci_sims.effects.base import Bound
from gs2ci_sims.preview import Preview
from gs2ci_sims.radiance import Renderer, with_margin
from gs2ci_sims.rays.gaussians import trace_gaussians
from gs2ci_sims.scene import Scene

# Windows of so many pixels per side are compared, spread over the frame.
WINDOW_PX: Final = 16
WINDOWS: Final = 9


def rendering_error(look: Preview, exact: Renderer) -> Bound:
    """Bound what the renderer of a preview makes of the readings against an exact one.

    Measured in the preview's middle view, in `WINDOWS` windows (small frames: everywhere), with three standard errors
    of the mean square over the windows; it counts as if it were aligned with the masks in the worst way.
    """
    number = len(look.views) // 2
    pose = look.path.world_to_camera(look.times_s[number : number + 1])
    squares, peak = [], 0.0
    for rows, columns in _windows(look.scene.size):
        size = (rows.stop - rows.start, columns.stop - columns.start)
        intrinsics = look.scene.intrinsics.copy()
        intrinsics[:2, 2] -= [columns.start, rows.start]
        part = replace(look.scene, intrinsics=intrinsics, size=size, depth=look.scene.depth[rows, columns])
        missed = look.views[number][rows, columns] - exact.views(part, pose)[0][0]
        squares.append(float(np.square(missed).mean()))
        peak = max(peak, float(np.abs(missed).max()))
    scatter = 3 * float(np.std(squares)) / len(squares) ** 0.5
    rms = float(np.sqrt(np.mean(squares) + scatter))
    return look.of_views(rms, max(peak, rms))


def _windows(size: tuple[int, int]) -> Iterator[tuple[slice, slice]]:
    """List windows of an image, spread evenly; a small image is one window."""
    if size[0] * size[1] <= WINDOWS * WINDOW_PX**2:
        yield slice(0, size[0]), slice(0, size[1])
        return
    per_side = int(WINDOWS**0.5)
    starts = [np.linspace(0, max(side - WINDOW_PX, 0), per_side).astype(int) for side in size]
    for top in starts[0]:
        for left in starts[1]:
            yield slice(top, min(top + WINDOW_PX, size[0])), slice(left, min(left + WINDOW_PX, size[1]))


@dataclass(frozen=True)
class ExactRenderer(Renderer):
    """Renders scenes ray by ray (`rays.gaussians` holds the definition).

    Args:
        supersampling: Rays per pixel side; a pixel is their mean. What more rays would change is in the table of
            `python -m tests.benchmarks exact_renderer`.
        backend: Of no consequence.
    """

    grain: ClassVar[float] = 9e-5
    sample_filter_px2: ClassVar[float] = 0.0

    supersampling: PositiveInt = 4

    def depth(self, scene: Scene, world_to_camera: F64, *, gaussians: Gaussians | None = None, margin: int = 0) -> F64:
        """Return the depth that the weights along the ray through each pixel's centre expect; see `Renderer.depth`."""
        if scene.mesh is not None:
            return super().depth(scene, world_to_camera, margin=margin)
        gaussians = scene.gaussians if gaussians is None else gaussians
        size = (scene.size[0] + 2 * margin, scene.size[1] + 2 * margin)
        colours = np.zeros((len(gaussians), 3))
        intrinsics = with_margin(scene.intrinsics, margin)
        _, coverage, depth = trace_gaussians(gaussians, colours, world_to_camera, intrinsics, size)
        return np.where(coverage >= 0.5, depth / np.maximum(coverage, 0.5), np.nan)

    def _drawn(
        self, scene: Scene, world_to_camera: F64, gaussians: Gaussians, margin: int
    ) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        intrinsics, size = self._enlarged(scene, margin)
        for pose in world_to_camera:
            colours = gaussians.colours.detach().to(torch.float64)
            if gaussians.harmonics is not None:
                exact = gaussians.detach().map(torch.Tensor.double)
                colours = colours_seen(exact, torch.from_numpy(pose[None]))[0]
            radiance, coverage, _ = trace_gaussians(gaussians, colours.numpy(), pose, intrinsics, size)
            yield torch.from_numpy(radiance[None]), torch.from_numpy(coverage[None])
