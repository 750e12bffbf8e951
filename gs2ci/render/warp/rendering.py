"""One rendering on a device, with what its gradient needs: the order in which the kernels run."""

import threading
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
import warp as wp
from torch import Tensor

from gs2ci.render.warp.blend import blend, blend_backward, gather
from gs2ci.render.warp.coding import OpenBlocks
from gs2ci.render.warp.lists import WarpReuse, list_gaussians
from gs2ci.render.warp.project import project, project_backward, sum_poses
from gs2ci.render.warp.stopping import depth_fields, stop_light
from gs2ci.render.warp.types import BLOCK, LEAST_TRANSMITTANCE, Pose, Record, Row

_POSE_THREADS: Final = 256
_FIBERS: Final = threading.Lock()


def _one_at_a_time(device: str) -> AbstractContextManager[object]:
    """Keep fibers of two host threads apart: they would share one stack of tiles, and end the process (warp 1.19)."""
    return _FIBERS if device == "cpu" else nullcontext()


@dataclass(frozen=True)
class SceneInputs:
    """A scene and poses, float32 and contiguous: on the rendering device, where they are shared, or on the host.

    Args:
        means: [G, 3], or in each view [V, G, 3].
        log_scales: [G, 3].
        quaternions: [G, 4].
        logits: [G].
        colours: [G, 3], or in each view [V, G, 3].
        poses: [V, 4, 4].
    """

    means: Tensor
    log_scales: Tensor
    quaternions: Tensor
    logits: Tensor
    colours: Tensor
    poses: Tensor

    @classmethod
    def of(cls, *tensors: Tensor) -> "SceneInputs":
        """Take tensors in the order of the fields."""
        return cls(*(one.detach().to(torch.float32).contiguous() for one in tensors))


@dataclass(frozen=True)
class SceneGradients:
    """Gradients by the fields of `SceneInputs`, beside these, and what each Gaussian's sightings were, [G, 3]."""

    means: Tensor
    log_scales: Tensor
    quaternions: Tensor
    logits: Tensor
    colours: Tensor
    poses: Tensor
    sightings: Tensor


class Rendering:
    """Gaussians blended at the open pixels of a coding.

    Args:
        inputs: The scene.
        intrinsics: Camera matrix on the canvas, [3, 3].
        coding: The open pixels.
        termination: Blending of a pixel stops below this transmittance.
        reuse: Whose lists serve, and which keeps new ones.
    """

    def __init__(
        self,
        inputs: SceneInputs,
        intrinsics: Tensor,
        coding: OpenBlocks,
        termination: float,
        reuse: WarpReuse | None = None,
    ) -> None:
        self._coding, self._device = coding, coding.device
        self._termination = max(float(termination), LEAST_TRANSMITTANCE)
        self._gaussians, self._views = len(inputs.logits), coding.views
        self._shapes = (inputs.means.shape, inputs.colours.shape)
        self._home = inputs.means.device
        self._means, self._mean_stride = self._per_view(inputs.means)
        self._colours, self._colour_stride = self._per_view(inputs.colours)
        self._log_scales = self._sent(inputs.log_scales, wp.vec3)
        self._quaternions = self._sent(inputs.quaternions, wp.vec4)
        self._logits = self._sent(inputs.logits, wp.float32)
        self._poses = self._sent(inputs.poses, Pose)
        self._camera = coding.camera(intrinsics.detach().double().numpy())
        pairs = self._views * self._gaussians
        self._records = self._empty(pairs, Record)
        boxes, depths, counts = (self._empty(pairs, kind) for kind in (wp.vec4i, wp.float32, wp.int32))
        margin = 0.0 if reuse is None else reuse.margin_px
        self._launch(
            project,
            (self._views, self._gaussians),
            [
                *(self._means, self._mean_stride, self._log_scales, self._quaternions, self._logits),
                *(self._colours, self._colour_stride, self._poses, self._camera, margin, coding.blocks_before),
            ],
            [self._records, boxes, depths, counts],
        )
        lists = None if reuse is None else reuse.kept(self._gaussians, coding)
        if lists is None:
            lists = list_gaussians(boxes, depths, counts, coding, self._camera, self._gaussians)
            if reuse is not None:
                reuse.keep(lists, self._gaussians, coding)
        self._lists = lists
        slots = len(coding.x)
        self._blended, self._last = self._empty(slots, wp.vec4), self._empty(slots, wp.int32)
        self._launch_blocks(
            blend,
            coding.blocks,
            BLOCK,
            [*self._listed(), coding.x, coding.y, self._termination],
            [self._blended, self._last],
        )

    def gathered(self) -> Tensor:
        """Return the outputs beside the inputs, [outputs, 4]: weighted colours and light that passes."""
        out = wp.zeros(self._coding.outputs, dtype=wp.vec4, device=self._device)
        inputs = [self._coding.start, self._coding.slots, self._coding.weight, self._blended]
        self._launch(gather, self._coding.outputs, inputs, [out])
        return self._returned(out)

    def differentiate(self, gradient: Tensor) -> SceneGradients:
        """Return the gradients of an objective, given that by the outputs, [outputs, 4]."""
        coding, lists, count = self._coding, self._lists, self._gaussians
        pulled = self._sent(gradient.detach().to(torch.float32).contiguous(), wp.vec4)
        sums = wp.zeros(max(lists.total, 1), dtype=Row, device=self._device)
        self._launch_blocks(
            blend_backward,
            coding.blocks,
            BLOCK,
            [
                *(*self._listed(), coding.x, coding.y, self._blended, self._last),
                *(coding.into, coding.weight, pulled),
            ],
            [sums],
        )
        views = self._views if self._mean_stride else 1
        coloured = self._views if self._colour_stride else 1
        found = [
            self._zeros(views * count, wp.vec3),
            self._zeros(count, wp.vec3),
            self._zeros(count, wp.vec4),
            self._zeros(count, wp.float32),
            self._zeros(coloured * count, wp.vec3),
            self._zeros(count, wp.vec3),
        ]
        parts = self._zeros(self._views * count * 12, wp.float32)
        self._launch(
            project_backward,
            count,
            [
                *(self._means, self._mean_stride, self._log_scales, self._quaternions, self._logits),
                *(self._colour_stride, self._poses, self._camera, lists.starts, lists.counts, sums),
            ],
            [*found, parts],
        )
        poses = self._zeros(self._views * 16, wp.float32)
        self._launch_blocks(sum_poses, self._views * 12, _POSE_THREADS, [parts, count], [poses])
        means, log_scales, quaternions, logits, colours, sightings = map(self._returned, found)
        means, colours = (one.reshape(shape) for one, shape in zip((means, colours), self._shapes, strict=True))
        of_poses = self._returned(poses).reshape(self._views, 4, 4)
        return SceneGradients(means, log_scales, quaternions, logits, colours, of_poses, sightings)

    def stopped(self) -> Tensor:
        """Return depth, spread, stopped and nearby light of each output, [outputs, 4]."""
        coding = self._coding
        fields = self._empty(self._views * self._gaussians, wp.vec4)
        scene = [self._means, self._mean_stride, self._log_scales, self._quaternions, self._poses, self._camera]
        self._launch(depth_fields, (self._views, self._gaussians), scene, [fields])
        maps = wp.zeros(coding.outputs, dtype=wp.vec4, device=self._device)
        _, *lists = self._listed()
        inputs = [coding.block_of, *lists, fields, coding.x, coding.y, self._termination, coding.into]
        self._launch(stop_light, len(coding.x), inputs, [maps])
        return self._returned(maps)

    def _listed(self) -> list[Any]:
        lists = self._lists
        return [self._coding.first, lists.begin, lists.end, lists.rows, lists.owner, self._records]

    def _per_view(self, values: Tensor) -> tuple[Any, int]:
        """Return vectors on the device, and how far those of the next view are: 0 if all views share them."""
        return self._sent(values.reshape(-1, 3), wp.vec3), self._gaussians if values.ndim == 3 else 0

    def _sent(self, values: Tensor, kind: Any) -> Any:
        """Share memory of the same device, which is not written to before the rendering is differentiated, or copy."""
        if str(wp.device_from_torch(values.device).alias if values.is_cuda else "cpu") == self._device:
            return wp.from_torch(values, dtype=kind)
        return wp.array(values.cpu().numpy(), dtype=kind, device=self._device)

    def _returned(self, values: Any) -> Tensor:
        """Return numbers of the device beside the inputs, shared if they lie there."""
        if self._home.type == "cpu":
            return torch.from_numpy(np.asarray(values.numpy()))
        shared: Tensor = wp.to_torch(values)
        return shared.to(self._home)

    def _empty(self, count: int, kind: Any) -> Any:
        return wp.empty(count, dtype=kind, device=self._device)

    def _zeros(self, count: int, kind: Any) -> Any:
        return wp.zeros(count, dtype=kind, device=self._device)

    def _launch(self, kernel: Any, dim: int | tuple[int, int], inputs: list[Any], outputs: list[Any]) -> None:
        if np.prod(dim):
            wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)

    def _launch_blocks(self, kernel: Any, blocks: int, threads: int, inputs: list[Any], outputs: list[Any]) -> None:
        if blocks:
            with _one_at_a_time(self._device):
                wp.launch_tiled(
                    kernel, dim=[blocks], block_dim=threads, inputs=inputs, outputs=outputs, device=self._device
                )


class Blended(torch.autograd.Function):
    """The outputs of a rendering, [outputs, 4], with their gradient; not twice differentiable."""

    @staticmethod
    def forward(ctx: Any, job: Any, *parameters: Tensor) -> Tensor:
        """Render; `parameters` in the order of `SceneInputs`, `job` makes the rendering and takes its sightings."""
        ctx.job, ctx.rendering = job, job.render(SceneInputs.of(*parameters))
        ctx.save_for_backward(*parameters)
        outputs: Tensor = ctx.rendering.gathered()
        return outputs

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Differentiate."""
        assert ctx.saved_tensors is not None  # lets torch notice that a parameter was overwritten meanwhile
        found = ctx.rendering.differentiate(gradients[0])
        ctx.job.saw(found.sightings)
        return (None, found.means, found.log_scales, found.quaternions, found.logits, found.colours, found.poses)
