"""The two passes over the kernels, on numpy arrays: parameters to cells, and gradients of cells to gradients.

Here buffers are sized and kernels called in order. What the cells mean (views or a coded sum) is decided by the caller.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.kernels import in_parts
from gs2ci.render.conventions import FRUSTUM_MARGIN
from gs2ci.render.cpu.blend import CELL, CELLS_PER_TASK, blend, differentiate_blend
from gs2ci.render.cpu.layout import Layout
from gs2ci.render.cpu.lists import CpuReuse, Lists, list_gaussians
from gs2ci.render.cpu.project import project
from gs2ci.render.cpu.project_backward import POSE_ENTRIES, differentiate_project, tasks_for
from gs2ci.render.cpu.record import CAMERA_FIELDS, FIELDS
from gs2ci.render.cpu.sighting import COLUMNS
from gs2ci.render.cpu.workspace import Lease, Workspace
from gs2ci.render.simd.vector import LANES

BACKWARD_TASKS_MIN: Final = 8
"""A few views are cut into bands until there are this many tasks. A constant, not the number of threads: bands
decide the order of sums, and results must not depend on threads. Each band costs one more gradient record."""


@dataclass(frozen=True)
class Inputs:
    """Parameters of one rendering as C-contiguous float32.

    Args:
        means: [G, 3], or [V, G, 3] where Gaussians move between the views.
        log_scales: [G, 3].
        quaternions: [G, 4].
        logits: [G].
        colours: [G, 3], or [V, G, 3] where views have their own.
        poses: world_to_camera, [V, 4, 4].
        camera: The fields of `record.py`.
    """

    means: F32
    log_scales: F32
    quaternions: F32
    logits: F32
    colours: F32
    poses: F32
    camera: F32

    @property
    def count(self) -> int:
        """Get the number of Gaussians, G."""
        return int(self.logits.shape[0])

    @property
    def blocks(self) -> int:
        """Get the number of blocks of 16 Gaussians."""
        return -(-self.count // LANES)

    def flat(self) -> tuple[Any, ...]:
        """Return the parameters as the projection kernels take them."""
        return (
            self.means.reshape(-1),
            self.means.ndim == 3,
            self.log_scales.reshape(-1),
            self.quaternions.reshape(-1),
            self.logits,
            self.colours.reshape(-1),
            self.colours.ndim == 3,
            self.poses.reshape(-1, 16),
            self.camera,
        )


@dataclass(frozen=True)
class Rendered:
    """What the forward pass leaves for the backward pass; all arrays belong to the workspace, or to the lease.

    Args:
        records: Projected Gaussians, [V, blocks * 256].
        lists: Those that touched a pixel of each cell.
        cells: Red, green, blue and transmittance of each cell's pixels, [cells * 64].
        lease: Keeps memory that several renderings share, if any do.
    """

    records: F32
    lists: Lists
    cells: F32
    lease: Lease | None


def camera_fields(intrinsics: F64, height: int, width: int) -> F32:
    """Pack the intrinsics [3, 3], the image size and the bounds of the linearisation for the kernels."""
    fx, fy, cx, cy = intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
    margin_u, margin_v = FRUSTUM_MARGIN * width / fx, FRUSTUM_MARGIN * height / fy
    fields = (
        *(fx, fy, cx, cy, width, height),
        *(-cx / fx - margin_u, (width - cx) / fx + margin_u),
        *(-cy / fy - margin_v, (height - cy) / fy + margin_v),
    )
    assert len(fields) == CAMERA_FIELDS
    return np.array(fields, np.float32)


def render_cells(
    inputs: Inputs, layout: Layout, termination: float, workspace: Workspace, reuse: CpuReuse | None = None
) -> Rendered:
    """Render the open pixels of all views; lists of Gaussians are taken from `reuse`, if given."""
    margin_px = 0.0 if reuse is None else reuse.margin_px
    records = workspace.get("records", (layout.views, inputs.blocks * LANES * FIELDS))
    in_parts(project, tasks_for(inputs.blocks), *inputs.flat(), np.float32(margin_px), records.reshape(-1))

    def listed(kept: Workspace) -> Lists:
        return list_gaussians(records, inputs.count, layout, margin_px + layout.margin_px, workspace, kept)

    if reuse is None:
        candidates, lease = listed(workspace), None
        touching = candidates.gaussians
    else:
        candidates, lease = reuse.lists(inputs.count, layout, listed)
        touching = workspace.get("touching", candidates.gaussians.shape, np.int32)
    kept = workspace.get("kept", (layout.cells,), np.int32)
    cells = workspace.get("cells", (layout.cells * CELL,))
    in_parts(
        blend,
        -(-layout.cells // CELLS_PER_TASK),
        records.reshape(-1),
        layout.cell_view,
        layout.x,
        layout.y,
        candidates.start,
        candidates.entries,
        candidates.view_start,
        candidates.gaussians,
        np.float32(termination),
        kept,
        touching,
        cells,
    )
    return Rendered(records, replace(candidates, entries=kept, gaussians=touching), cells, lease)


@dataclass(frozen=True)
class Gradients:
    """dL/d of each parameter, shaped like it; `poses` is [V, 4, 4] with a zero last row.

    `sightings` holds the columns of `sighting.py`, [G, 3].
    """

    means: F32
    log_scales: F32
    quaternions: F32
    logits: F32
    colours: F32
    poses: F32
    sightings: F32

    def of_scene(self) -> dict[str, F32]:
        """Return those of a scene's parameters by their names in `Gaussians`."""
        return {
            "means": self.means,
            "log_scales": self.log_scales,
            "quaternions": self.quaternions,
            "opacity_logits": self.logits,
            "colours": self.colours,
        }


def differentiate_cells(
    inputs: Inputs, layout: Layout, rendered: Rendered, cell_gradients: F32, workspace: Workspace
) -> Gradients:
    """Turn dL/d(cells) into the gradients of all parameters and poses."""
    views = layout.views
    bands = -(-BACKWARD_TASKS_MIN // max(views, 1))
    sums = workspace.get("sums", (bands * rendered.records.size,))
    in_parts(
        differentiate_blend,
        views * bands,
        rendered.records.reshape(-1),
        layout.cell_start,
        layout.x,
        layout.y,
        rendered.lists.start,
        rendered.lists.entries,
        rendered.lists.view_start,
        rendered.lists.gaussians,
        int(rendered.lists.entries.max(initial=0)),
        cell_gradients,
        bands,
        sums,
    )
    gradients = Gradients(
        np.zeros_like(inputs.means),
        np.empty_like(inputs.log_scales),
        np.empty_like(inputs.quaternions),
        np.empty_like(inputs.logits),
        np.empty_like(inputs.colours),
        np.zeros((views, 4, 4), np.float32),
        np.empty((inputs.count, COLUMNS), np.float32),
    )
    pose_parts = np.empty((tasks_for(inputs.blocks), views * POSE_ENTRIES), np.float64)
    in_parts(
        differentiate_project,
        len(pose_parts),
        *inputs.flat(),
        rendered.records.reshape(-1),
        sums.reshape(bands, -1),
        gradients.means.reshape(-1),
        gradients.log_scales.reshape(-1),
        gradients.quaternions.reshape(-1),
        gradients.logits,
        gradients.colours.reshape(-1),
        gradients.sightings.reshape(-1),
        pose_parts,
    )
    gradients.poses[:, :3] = pose_parts.sum(axis=0).reshape(views, 3, 4)
    return gradients
