"""One rendering on a device, and its gradient, as callers get them."""

from typing import Any, NamedTuple

import torch
import warp as wp
from torch import Tensor

from gs2ci.render.recording import Launcher
from gs2ci.render.warp.arrays import DeviceArrays, DeviceArraysKey, Given, copied
from gs2ci.render.warp.coding import OpenBlocks
from gs2ci.render.warp.lists import list_gaussians
from gs2ci.render.warp.reuse import WarpReuse
from gs2ci.render.warp.stopping import stop_light
from gs2ci.render.warp.types import LEAST_TRANSMITTANCE


class SceneInputs(NamedTuple):
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


class Rendering:
    """Gaussians blended at the open pixels of a coding.

    Args:
        inputs: The scene.
        intrinsics: Camera matrix on the canvas, [3, 3].
        coding: The open pixels.
        termination: Blending of a pixel stops below this transmittance.
        reuse: Whose lists and memory serve, and which keeps new ones.
    """

    def __init__(
        self,
        inputs: SceneInputs,
        intrinsics: Tensor,
        coding: OpenBlocks,
        termination: float,
        reuse: WarpReuse | None = None,
    ) -> None:
        self._coding, self._home, self._reuse = coding, inputs.means.device, reuse
        self._shapes = (inputs.means.shape, inputs.colours.shape)
        key = DeviceArraysKey(
            coding,
            len(inputs.logits),
            inputs.means.ndim == 3,
            inputs.colours.ndim == 3,
            tuple(intrinsics.detach().double().flatten().tolist()),
            max(float(termination), LEAST_TRANSMITTANCE),
            0.0 if reuse is None else reuse.margin_px,
        )
        self._arrays = DeviceArrays(key) if reuse is None else reuse.arrays(key)
        self._arrays.project(inputs)
        if reuse is None:
            lists = list_gaussians(self._arrays)
        else:
            lists = reuse.lists(self._arrays)
            reuse.used_by(self)
        self._arrays.blend(lists)

    def gathered(self) -> Tensor:
        """Return the outputs beside the inputs, [outputs, 4]: weighted colours and light that passes."""
        return self._arrays.image(self._home)

    def differentiate(self, gradient: Tensor) -> tuple[SceneInputs, Tensor]:
        """Return the gradients of an objective, given that by the outputs, [outputs, 4], or by their colours.

        Returns:
            Gradients by the inputs, beside them, and what each Gaussian's sightings were, [G, 3].
        """
        found = self._arrays.pull(gradient.detach().to(torch.float32), self._home)
        if self._reuse is not None:
            self._reuse.left_by(self)
        means, log_scales, quaternions, logits, colours, sightings, poses = found
        of_scene = means.reshape(self._shapes[0]), log_scales.reshape(-1, 3), quaternions.reshape(-1, 4), logits
        gradients = SceneInputs(*of_scene, colours.reshape(self._shapes[1]), poses.reshape(-1, 4, 4))
        return gradients, sightings.reshape(-1, 3)

    def stopped(self, fields: Tensor) -> Tensor:
        """Return depth, spread, stopped and nearby light of each output, [outputs, 4], given `depth_fields`."""
        coding, arrays = self._coding, self._arrays
        launch, told = Launcher(coding.device), Given(wp.vec4, coding.device)
        told.take(fields.view(-1, 4))
        maps = wp.zeros(coding.outputs, dtype=wp.vec4, device=coding.device)
        _, *lists = arrays.listed()
        inputs = [coding.block_of, *lists, told.array, coding.x, coding.y, arrays.key.termination, coding.into]
        launch(stop_light, len(coding.x), inputs, [maps])
        return copied(maps, self._home)


class Blended(torch.autograd.Function):
    """The outputs of a rendering, [outputs, 4], with their gradient; not twice differentiable."""

    @staticmethod
    def forward(ctx: Any, job: Any, *parameters: Tensor) -> Tensor:
        """Render; `parameters` in the order of `SceneInputs`, `job` makes the rendering and takes its sightings."""
        ctx.job, ctx.rendering = job, job.render(SceneInputs.of(*parameters))
        ctx.save_for_backward(*parameters)
        return ctx.rendering.gathered()

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        """Differentiate."""
        assert ctx.saved_tensors is not None  # lets torch notice that a parameter was overwritten meanwhile
        found, sightings = ctx.rendering.differentiate(gradients[0])
        ctx.job.saw(sightings)
        return (None, *found)
