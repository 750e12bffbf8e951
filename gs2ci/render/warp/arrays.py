"""The memory of a rendering and the launches on it, which serve again as long as population and masks stay.

Gaussians that lie on the rendering device are shared with torch; those of the host are copied in. Here: the arrays, and
in which order kernels run on them. Not here: for how long they serve (`reuse.py`), what a caller gets
(`rendering.py`), the kernels.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
import warp as wp
from torch import Tensor

from gs2ci.render.recording import Launcher, Recording
from gs2ci.render.warp.blend import blend, blend_backward, gather
from gs2ci.render.warp.coding import OpenBlocks
from gs2ci.render.warp.lists import BlockLists
from gs2ci.render.warp.project import project, project_backward, sum_poses
from gs2ci.render.warp.types import BLOCK, Pose, Record, Row

_POSE_THREADS: Final = 256


@dataclass(frozen=True)
class DeviceArraysKey:
    """What decides how much memory a rendering takes, and what its kernels are given beside arrays.

    Args:
        coding: The open pixels; compared by identity.
        gaussians: G.
        moving: Whether centres differ from view to view.
        coloured: Whether colours do.
        intrinsics: Camera matrix on the canvas, its numbers row by row.
        termination: Blending of a pixel stops below this transmittance.
        margin_px: See `WarpReuse`.
    """

    coding: OpenBlocks
    gaussians: int
    moving: bool
    coloured: bool
    intrinsics: tuple[float, ...]
    termination: float
    margin_px: float


class DeviceArrays:
    """Arrays of a rendering, and its kernels in their order.

    Args:
        key: Sizes and constants.
    """

    def __init__(self, key: DeviceArraysKey) -> None:
        self.key, coding = key, key.coding
        self._device, self._coding = coding.device, coding
        self.camera = coding.camera(np.array(key.intrinsics).reshape(3, 3))
        count, views, slots = key.gaussians, coding.views, len(coding.x)
        self._mean_stride, self._colour_stride = (count if apart else 0 for apart in (key.moving, key.coloured))
        self._given: list[Given] = [
            *(Given(kind, self._device) for kind in (wp.vec3, wp.vec3, wp.vec4, wp.float32, wp.vec3)),
            Given(Pose, self._device, views),
        ]
        pairs = views * count
        self.records = self._empty(pairs, Record)
        self.boxes, self.depths = self._empty(pairs, wp.vec4i), self._empty(pairs, wp.float32)
        # One more, which is 0, so that the number before the end is that of all.
        self.counts = wp.zeros(pairs + 1, dtype=wp.int32, device=self._device)
        self._blended, self._last = self._empty(slots, wp.vec4), self._empty(slots, wp.int32)
        self._image = wp.zeros(coding.outputs, dtype=wp.vec4, device=self._device)
        self._pulled: Any = None
        self._lists: BlockLists | None = None
        self._sums: Any = None
        self._projecting = Recording(self._device, self._project)
        self._blending = Recording(self._device, self._blend)
        self._pulling = Recording(self._device, self._pull)

    def project(self, inputs: tuple[Tensor, ...]) -> None:
        """Take the inputs, in the order of `SceneInputs`, and project the Gaussians into every view."""
        # Each is taken, whether one before it has moved or not.
        moved = [place.take(values) for place, values in zip(self._given, inputs, strict=True)]
        if any(moved):
            self._projecting.forget()
            self._pulling.forget()
        self._projecting.run()

    def blend(self, lists: BlockLists) -> None:
        """Blend the Gaussians of these lists."""
        if self._lists is None or self._lists.rows is not lists.rows:
            self._blending.forget()
            self._pulling.forget()
            self._sums = None
        self._lists = lists
        self._blending.run()

    def image(self, home: torch.device) -> Tensor:
        """Return the outputs on a device, [outputs, 4]: weighted colours and light that passes."""
        return copied(self._image, home)

    def pull(self, gradient: Tensor, home: torch.device) -> list[Tensor]:
        """Return the gradients by the inputs, and what sightings were, on a device, given that by the outputs.

        Args:
            gradient: [outputs, 4], or without the light that passes, [outputs, 3].
            home: Where the result shall lie.
        """
        assert self._lists is not None
        if self._pulled is None:
            self._prepare_to_pull()
        if self._sums is None:
            self._sums = self._empty(max(len(self._lists.rows), 1), Row)
        self._fill_pulled(gradient)
        self._pulling.run()
        numbers = copied(self._gradients, home)
        return [numbers[start : start + size] for start, size in self._parts]

    def listed(self) -> list[Any]:
        """Return what kernels of blocks read of the lists, and the records."""
        lists = self._lists
        assert lists is not None
        return [self._coding.first, lists.begin, lists.end, lists.rows, lists.owner, self.records]

    # ------------------------------------------------------------------------------------------------- launches

    def _project(self, launch: Launcher) -> None:
        means, log_scales, quaternions, logits, colours, poses = (place.array for place in self._given)
        launch(
            project,
            (self._coding.views, self.key.gaussians),
            [
                *(means, self._mean_stride, log_scales, quaternions, logits, colours, self._colour_stride),
                *(poses, self.camera, self.key.margin_px, self._coding.blocks_before),
            ],
            [self.records, self.boxes, self.depths, self.counts],
        )

    def _blend(self, launch: Launcher) -> None:
        coding = self._coding
        inputs = [*self.listed(), coding.x, coding.y, self.key.termination]
        launch.blocks(blend, coding.blocks, BLOCK, inputs, [self._blended, self._last])
        launch(gather, coding.outputs, [coding.start, coding.slots, coding.weight, self._blended], [self._image])

    def _pull(self, launch: Launcher) -> None:
        coding, lists, count = self._coding, self._lists, self.key.gaussians
        assert lists is not None
        inputs = [*self.listed(), coding.x, coding.y, self._blended, self._last, coding.into, coding.weight]
        launch.blocks(blend_backward, coding.blocks, BLOCK, [*inputs, self._pulled], [self._sums])
        means, log_scales, quaternions, logits, _, poses = (place.array for place in self._given)
        scene = [means, self._mean_stride, log_scales, quaternions, logits, self._colour_stride, poses, self.camera]
        *found, by_poses = self._found
        launch(project_backward, count, [*scene, lists.starts, self._sums], [*found, self._pose_parts])
        launch.blocks(sum_poses, coding.views * 12, _POSE_THREADS, [self._pose_parts, count], [by_poses])

    # --------------------------------------------------------------------------------------------------- memory

    def _prepare_to_pull(self) -> None:
        """Make what only a gradient needs; all gradients lie in one piece of memory, and are copied out at once."""
        count, views = self.key.gaussians, self._coding.views
        self._pulled = wp.zeros(self._coding.outputs, dtype=wp.vec4, device=self._device)
        self._pulled_dirty = False
        means, colours = (views if apart else 1 for apart in (self.key.moving, self.key.coloured))
        rows = (
            *((means * count, wp.vec3), (count, wp.vec3), (count, wp.vec4), (count, wp.float32)),
            *((colours * count, wp.vec3), (count, wp.vec3), (views * 16, wp.float32)),
        )
        sizes = [number * wp.types.type_size_in_bytes(kind) // 4 for number, kind in rows]
        starts = [sum(sizes[:k]) for k in range(len(sizes))]
        self._parts = list(zip(starts, sizes, strict=True))
        self._gradients = wp.zeros(sum(sizes), dtype=wp.float32, device=self._device)
        self._found = [
            wp.array(ptr=self._gradients.ptr + 4 * start, dtype=kind, shape=(number,), device=self._device, copy=False)
            for start, (number, kind) in zip(starts, rows, strict=True)
        ]
        self._pose_parts = self._empty(views * count * 12, wp.float32)

    def _fill_pulled(self, gradient: Tensor) -> None:
        columns = gradient.shape[1]
        if not _is_shared(gradient, self._device):
            given = np.zeros((len(gradient), 4), np.float32)
            given[:, :columns] = gradient.cpu().numpy()
            self._pulled.assign(given)
            return
        there: Tensor = wp.to_torch(self._pulled)
        if self._pulled_dirty and columns < 4:
            there[:, columns:] = 0
        there[:, :columns].copy_(gradient)
        self._pulled_dirty = columns == 4

    def _empty(self, count: int, kind: Any) -> Any:
        return wp.empty(count, dtype=kind, device=self._device)


class Given:
    """One input on the device: memory of torch's that is shared, or memory of its own that is copied into.

    Args:
        kind: Of an element.
        device: A name of Warp's.
        room: Elements of memory of its own, for what comes from other memory each time; 0: what is shared is used.
    """

    def __init__(self, kind: Any, device: str, room: int = 0) -> None:
        self._kind, self._device = kind, device
        self.array: Any = wp.empty(room, dtype=kind, device=device) if room else None
        self._room = room
        self._tensor: Tensor | None = None

    def take(self, values: Tensor) -> bool:
        """Take new values, and tell whether they lie elsewhere than those before."""
        shared = _is_shared(values, self._device)
        if shared and not self._room:
            before, self._tensor = self._tensor, values
            if before is not None and before.data_ptr() == values.data_ptr() and before.shape == values.shape:
                return False
            shape = self._kind._shape_ if hasattr(self._kind, "_shape_") else ()
            self.array = wp.from_torch(values.reshape(-1, *shape), dtype=self._kind)
            return True
        if shared and self._room:
            wp.to_torch(self.array).copy_(values)
            return False
        copied = wp.array(values.cpu().numpy(), dtype=self._kind, device="cpu")
        moved = self.array is None or len(self.array) != len(copied)
        if moved:
            self.array = wp.empty(len(copied), dtype=self._kind, device=self._device)
        wp.copy(self.array, copied)
        return moved


def _is_shared(values: Tensor, device: str) -> bool:
    """Tell whether a tensor lies on the rendering device."""
    return str(wp.device_from_torch(values.device).alias if values.is_cuda else "cpu") == device


def copied(values: Any, home: torch.device) -> Tensor:
    """Return a copy of an array's numbers where a caller wants them: the array is written to again."""
    if values.device.is_cuda and home.type == "cpu":
        return torch.from_numpy(np.asarray(values.numpy()))
    shared: Tensor = wp.to_torch(values)
    return shared.to(home, copy=True)
