"""The rasteriser as a differentiable torch function.

Not twice differentiable. Gradients reach all scene parameters and the poses; the intrinsics get none.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import in_parts
from gs2ci.render.cpu.blend import CELL
from gs2ci.render.cpu.gather import (
    cells_to_coded,
    cells_to_views,
    coded_gradient_to_cells,
    view_gradients_to_cells,
)
from gs2ci.render.cpu.layout import Layout
from gs2ci.render.cpu.lists import CpuReuse
from gs2ci.render.cpu.passes import Inputs, differentiate_cells, render_cells
from gs2ci.render.cpu.workspace import Pool, Workspace
from gs2ci.render.screen import ScreenStatistics


class RenderTarget(Protocol):
    """What rendered cells are turned into, and how its gradient comes back to the cells."""

    @property
    def layout(self) -> Layout:
        """Get the cells it expects."""

    def collect(self, cells: F32) -> tuple[Tensor, ...]:
        """Turn cells [cells * 64] into the outputs."""

    def spread(self, gradients: tuple[Tensor, ...], workspace: Workspace) -> F32:
        """Turn the outputs' gradients into dL/d(cells), in the place of the cells."""


@dataclass(frozen=True)
class ViewImages:
    """Images [V, H, W, 3] and alphas [V, H, W]; the layout must hold every pixel."""

    layout: Layout

    def collect(self, cells: F32) -> tuple[Tensor, ...]:
        """Turn cells into images and alphas."""
        views, pixels = self.layout.views, self.layout.size[0] * self.layout.size[1]
        images, alphas = np.empty((views, pixels * 3), np.float32), np.empty((views, pixels), np.float32)
        in_parts(cells_to_views, views, cells, self.layout.pixel, self.layout.cell_start, images, alphas)
        size = (views, *self.layout.size)
        return torch.from_numpy(images).view(*size, 3), torch.from_numpy(alphas).view(size)

    def spread(self, gradients: tuple[Tensor, ...], workspace: Workspace) -> F32:
        """Collect the gradients of images and alphas."""
        images, alphas = (as_float32(g).reshape(self.layout.views, -1) for g in gradients)
        cells = workspace.get("cells", (self.layout.cells * CELL,))
        layout = self.layout
        places = (layout.pixel, layout.weight, layout.cell_start)
        in_parts(view_gradients_to_cells, layout.views, images, alphas, *places, cells)
        return cells


@dataclass(frozen=True)
class CodedSum:
    """The coded sum Y = sum_i M_i * X_i, [H, W, 3]; no view is ever an image."""

    layout: Layout

    def collect(self, cells: F32) -> tuple[Tensor, ...]:
        """Add the cells up under their masks."""
        layout = self.layout
        coded = np.zeros(layout.size[0] * layout.size[1] * 3, np.float32)
        places = (layout.pixel, layout.weight, layout.cell_start, layout.first, layout.last)
        in_parts(cells_to_coded, layout.strips, cells, *places, coded)
        return (torch.from_numpy(coded).view(*layout.size, 3),)

    def spread(self, gradients: tuple[Tensor, ...], workspace: Workspace) -> F32:
        """Weigh the gradient of the sum by the masks."""
        return self.spread_array(as_float32(gradients[0]), workspace)

    def spread_array(self, gradient: F32, workspace: Workspace) -> F32:
        """Do so for an array, [H, W, 3]."""
        layout = self.layout
        cells = workspace.get("cells", (layout.cells * CELL,))
        flat = np.ascontiguousarray(gradient, np.float32).reshape(-1)
        places = (layout.pixel, layout.weight, layout.cell_start)
        in_parts(coded_gradient_to_cells, layout.views, flat, *places, cells)
        return cells


@dataclass(frozen=True)
class Job:
    """What a rendering needs beside its tensors."""

    target: RenderTarget
    camera: F32
    termination: float
    pool: Pool
    screen: ScreenStatistics | None = None
    reuse: CpuReuse | None = None


def as_float32(tensor: Tensor) -> F32:
    """View a tensor as a C-contiguous float32 array; copies only if it is not one already."""
    array: NDArray[Any] = tensor.detach().numpy()
    return np.ascontiguousarray(array, dtype=np.float32)


def _inputs(job: Job, parameters: tuple[Tensor, ...]) -> Inputs:
    means, log_scales, quaternions, logits, colours, poses = (as_float32(p) for p in parameters)
    return Inputs(means, log_scales, quaternions, logits, colours, poses, job.camera)


class Rasterise(torch.autograd.Function):
    """Render the cells of a layout and collect them; see `RenderTarget` for what comes out."""

    @staticmethod
    def forward(ctx: Any, job: Job, *parameters: Tensor) -> tuple[Tensor, ...]:
        """Render. `parameters`: means, log_scales, quaternions, logits, colours, poses; all float32."""
        inputs = _inputs(job, parameters)
        lease = job.pool.lease()
        assert lease.workspace is not None
        rendered = render_cells(inputs, job.target.layout, job.termination, lease.workspace, job.reuse)
        outputs = job.target.collect(rendered.cells)
        # Saving the inputs lets torch notice if one is overwritten before the backward pass reads it again.
        ctx.save_for_backward(*parameters)
        ctx.job, ctx.lease, ctx.rendered = job, lease, rendered
        return outputs

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Differentiate, then give the workspace back.

        Raises:
            RuntimeError: Called a second time: the lists of Gaussians per cell are gone by then.
        """
        workspace = ctx.lease.workspace
        if workspace is None:
            raise RuntimeError("backward ran twice through one rendering; render again for a second gradient")
        inputs = _inputs(ctx.job, ctx.saved_tensors)
        cells = ctx.job.target.spread(gradients, workspace)
        result = differentiate_cells(inputs, ctx.job.target.layout, ctx.rendered, cells, workspace)
        if ctx.job.screen is not None:
            ctx.job.screen.add(*torch.from_numpy(result.sightings).unbind(dim=1))
        ctx.rendered = None
        ctx.lease.release()
        arrays = (
            *(result.means, result.log_scales, result.quaternions),
            *(result.logits, result.colours, result.poses),
        )
        return (None, *(torch.from_numpy(a) for a in arrays))
