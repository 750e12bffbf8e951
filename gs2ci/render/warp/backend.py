"""The Warp rasteriser behind the `Backend` interface. Users get it from `gs2ci.render.backend.load_backend`.

Gaussians that lie on the rendering device are shared with torch, and so are results; those of the host are copied for
each rendering (docs/gpu.md).
"""

from dataclasses import dataclass
from typing import Final

import torch
import warp as wp
from torch import Tensor

from gs2ci.core.errors import InputError
from gs2ci.render.adjoint import Image, Pull, accumulate, as_image
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import colours_seen
from gs2ci.render.inputs import check_masks, check_rendering, check_screen, check_size, own_masks, own_reuse
from gs2ci.render.interface import MaskSet, Reuse
from gs2ci.render.sampling import CanvasSampling, check_sampling, on_canvas
from gs2ci.render.screen import ScreenStatistics
from gs2ci.render.settings import RasterSettings
from gs2ci.render.stopping import StoppedLight, depth_fields
from gs2ci.render.warp.coding import OpenBlocks, code
from gs2ci.render.warp.rendering import Blended, Rendering, SceneInputs
from gs2ci.render.warp.reuse import WarpReuse

_FULL_CODINGS_KEPT: Final = 4


@dataclass(frozen=True)
class WarpMaskSet(MaskSet):
    """A mask set compacted into blocks on a device."""

    coding: OpenBlocks
    sampling: CanvasSampling | None = None


@dataclass(frozen=True)
class _Job:
    """What a rendering needs beside its tensors."""

    coding: OpenBlocks
    intrinsics: Tensor
    termination: float
    screen: ScreenStatistics | None = None
    reuse: WarpReuse | None = None

    def render(self, inputs: SceneInputs) -> Rendering:
        return Rendering(inputs, self.intrinsics, self.coding, self.termination, self.reuse)

    def saw(self, sightings: Tensor) -> None:
        if self.screen is not None:
            self.screen.add(*sightings.unbind(dim=1))


class WarpBackend:
    """Warp kernels on a CUDA device, or on the CPU by fibers: the same bits from run to run on one device.

    They are queued on torch's default stream of the device; who computes on another stream waits for it, and lets it
    wait, as `gs2ci.reconstruct` does.

    Args:
        settings: What may be left out; None takes the defaults.
        device: A name of Warp's, such as "cuda:0"; None takes the first CUDA device there is, else the CPU.

    Raises:
        InputError: The settings make no sense, or there is no such device.
    """

    name = "warp"

    def __init__(self, settings: RasterSettings | None = None, device: str | None = None) -> None:
        self._settings = (settings or RasterSettings()).check()
        self.place = device_named(device)
        # Only torch built for CUDA can hold tensors there.
        shared = self.place != "cpu" and torch.cuda.is_available()
        self.device = torch.device(self.place if shared else "cpu")
        if shared:
            # What either of the two queues waits for what the other has queued before, in their order.
            wp.set_stream(wp.stream_from_torch(torch.cuda.default_stream(self.device)), self.place)
        self._full_codings: dict[tuple[int, int, int, CanvasSampling | None], OpenBlocks] = {}

    def code(self, masks: Tensor, sampling: CanvasSampling | None = None) -> WarpMaskSet:
        """Compact the open pixels of a mask set; see `Backend.code`."""
        check_masks(masks)
        views, height, width = masks.shape
        check_sampling(sampling, (height, width))
        there = masks.detach().to(self.device, torch.float32)
        return WarpMaskSet(views, (height, width), code(there, self.place, sampling), sampling)

    def reuse(self) -> WarpReuse:
        """Share lists of Gaussians among renderings; see `Backend.reuse`."""
        every = self._settings.relist_every
        return WarpReuse(every, self._settings.list_margin_px if every > 1 else 0.0)

    def coded(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None = None,
        reuse: Reuse | None = None,
        times: Tensor | None = None,
    ) -> Tensor:
        """Render the coded sum; see `Backend.coded`."""
        job = self._coded_job(scene, world_to_camera, intrinsics, mask_set, screen, reuse, times)
        outputs: Tensor = Blended.apply(job, *_parameters(scene, world_to_camera, times))
        return outputs[:, :3].reshape(*mask_set.size, 3)

    def coded_with_pull(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None = None,
        reuse: Reuse | None = None,
    ) -> tuple[Image, Pull]:
        """Render the coded sum, and differentiate it without a graph; see `AdjointBackend`."""
        job = self._coded_job(scene, world_to_camera, intrinsics, mask_set, screen, reuse, None)
        rendering: Rendering | None = job.render(SceneInputs.of(*_parameters(scene, world_to_camera, None)))
        assert rendering is not None
        image = rendering.gathered()[:, :3].reshape(*mask_set.size, 3)

        def pull(gradient: Image) -> Image:
            nonlocal rendering
            if rendering is None:
                raise RuntimeError("one rendering was differentiated twice; render again for a second gradient")
            found, sightings = rendering.differentiate(torch.as_tensor(gradient).reshape(-1, 3))
            rendering = None
            job.saw(sightings)
            named = ("means", "log_scales", "quaternions", "colours")
            of_scene = {name: getattr(found, name) for name in named} | {"opacity_logits": found.logits}
            accumulate(scene, of_scene)
            return as_image(found.poses)

        return as_image(image), pull

    def _coded_job(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None,
        reuse: Reuse | None,
        times: Tensor | None,
    ) -> _Job:
        """Check what a coded sum is to be rendered from.

        Raises:
            InputError: See `Backend.coded`.
        """
        coded, kept = own_masks(mask_set, WarpMaskSet, self.name), own_reuse(reuse, WarpReuse, self.name)
        check_rendering(scene, world_to_camera, intrinsics, views=mask_set.views, times=times)
        check_screen(screen, scene)
        return self._job(coded.coding, intrinsics, coded.sampling, screen, kept)

    def views(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        size: tuple[int, int],
        colours: Tensor | None = None,
        sampling: CanvasSampling | None = None,
        times: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Render whole views; see `Backend.views`."""
        check_size(size)
        check_sampling(sampling, size)
        check_rendering(scene, world_to_camera, intrinsics, colours=colours, times=times)
        shape = (int(world_to_camera.shape[0]), *size)
        job = self._job(self._full_coding(shape, sampling), intrinsics, sampling)
        outputs: Tensor = Blended.apply(job, *_parameters(scene, world_to_camera, times, colours))
        return outputs[:, :3].reshape(*shape, 3), 1 - outputs[:, 3].reshape(shape)

    def depths(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        size: tuple[int, int],
        sampling: CanvasSampling | None = None,
        times: Tensor | None = None,
    ) -> StoppedLight:
        """Find where light is stopped; see `Backend.depths`."""
        check_size(size)
        check_sampling(sampling, size)
        check_rendering(scene, world_to_camera, intrinsics, times=times)
        shape = (int(world_to_camera.shape[0]), *size)
        job = self._job(self._full_coding(shape, sampling), intrinsics, sampling)
        # What light looks like does not matter here.
        plain = _parameters(scene, world_to_camera, times, scene.colours)
        means, log_scales, quaternions, _, _, poses = plain
        frame = size if sampling is None else sampling.canvas
        fields = depth_fields(means, log_scales, quaternions, poses, on_canvas(intrinsics, sampling), frame)
        maps = job.render(SceneInputs.of(*plain)).stopped(fields)
        return StoppedLight(*(maps[:, k].reshape(shape).clone() for k in range(4)))

    def _job(
        self,
        coding: OpenBlocks,
        intrinsics: Tensor,
        sampling: CanvasSampling | None,
        screen: ScreenStatistics | None = None,
        reuse: WarpReuse | None = None,
    ) -> _Job:
        termination = self._settings.termination_transmittance
        return _Job(coding, on_canvas(intrinsics, sampling), termination, screen, reuse)

    def _full_coding(self, shape: tuple[int, int, int], sampling: CanvasSampling | None) -> OpenBlocks:
        key = (*shape, sampling)
        coding = self._full_codings.pop(key, None)
        if coding is None:
            coding = code(torch.ones(shape, device=self.device), self.place, sampling, apart=True)
        self._full_codings[key] = coding
        if len(self._full_codings) > _FULL_CODINGS_KEPT:
            del self._full_codings[next(iter(self._full_codings))]
        return coding


def device_named(name: str | None) -> str:
    """Return a device of Warp's; None takes the first CUDA device there is, else the CPU.

    Raises:
        InputError: There is no such device.
    """
    wp.init()
    known = ["cpu", *(str(device.alias) for device in wp.get_cuda_devices())]
    if name is None:
        return known[0] if len(known) == 1 else known[1]
    if name not in known:
        raise InputError(
            f"no device {name!r} for the warp backend",
            allowed=", ".join(known),
            remedy="NVIDIA's driver and a card from Turing on make a device cuda:0",
        )
    return name


def _parameters(
    scene: Gaussians, world_to_camera: Tensor, times: Tensor | None, colours: Tensor | None = None
) -> tuple[Tensor, ...]:
    """Return what is rendered in the order of `SceneInputs`, float32, so that float64 poses get float64 gradients."""
    times = None if times is None else times.to(scene.means.device)
    if colours is None:
        colours = scene.colours if scene.harmonics is None else colours_seen(scene, world_to_camera, times)
    means = scene.means if times is None or scene.motion is None else scene.means_at(times)
    parameters = (means, scene.log_scales, scene.quaternions, scene.opacity_logits, colours, world_to_camera)
    return tuple(one.to(torch.float32) for one in parameters)
