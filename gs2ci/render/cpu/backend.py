"""The CPU rasteriser behind the `Backend` interface. Users get it from `gs2ci.render.backend.load_backend`."""

from collections import OrderedDict
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import torch
from torch import Tensor

from gs2ci.core.arrays import F32
from gs2ci.render.adjoint import Pull, accumulate
from gs2ci.render.cpu.function import CodedSum, Job, Rasterise, RenderTarget, ViewImages, as_float32
from gs2ci.render.cpu.harmonics import colours_of
from gs2ci.render.cpu.layout import Layout, lay_out
from gs2ci.render.cpu.lists import CpuReuse
from gs2ci.render.cpu.passes import Inputs, camera_fields, differentiate_cells, render_cells
from gs2ci.render.cpu.stopping import stop_light
from gs2ci.render.cpu.workspace import Pool
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.inputs import check_masks, check_rendering, check_screen, check_size, own_masks, own_reuse
from gs2ci.render.interface import MaskSet, Reuse
from gs2ci.render.sampling import CanvasSampling, check_sampling, on_canvas
from gs2ci.render.screen import ScreenStatistics
from gs2ci.render.settings import RasterSettings
from gs2ci.render.stopping import StoppedLight, depth_fields

_FULL_LAYOUTS_KEPT: Final = 4

MOST_PIXELS_AT_ONCE: Final = 2**22
"""Views of more pixels than these together are rendered a few at a time where no gradient is wanted: whole views take
some 60 bytes a pixel meanwhile, 2 GB for sixteen of 1920 x 1080. What a view shows depends on no other.

Before these, and after a coded sum of so many pixels that no gradient is wanted of, what earlier renderings left is
freed: they come where much else is held, and an iteration of a fit leaves 1.5 GB."""


@dataclass(frozen=True)
class CpuMaskSet(MaskSet):
    """A mask set compacted into cells."""

    layout: Layout
    sampling: CanvasSampling | None = None


class CpuBackend:
    """Numba kernels on all cores; the same result on any number of them.

    Args:
        settings: What may be left out; None takes the defaults.

    Raises:
        InputError: The settings make no sense.
    """

    name = "cpu"
    device = torch.device("cpu")

    def __init__(self, settings: RasterSettings | None = None) -> None:
        self._settings = (settings or RasterSettings()).check()
        self._pool = Pool()
        # Apart from the others, which are much larger.
        self._list_pool = Pool()
        self._full_layouts: OrderedDict[tuple[int, int, int, CanvasSampling | None], Layout] = OrderedDict()

    @property
    def idle_workspaces(self) -> int:
        """Get how many workspaces wait for the next rendering."""
        return self._pool.idle

    @property
    def idle_lists(self) -> int:
        """Get how many workspaces wait for the next lists that outlive a rendering."""
        return self._list_pool.idle

    def code(self, masks: Tensor, sampling: CanvasSampling | None = None) -> CpuMaskSet:
        """Compact the open pixels of a mask set; see `Backend.code`."""
        check_masks(masks)
        values = np.ascontiguousarray(masks.detach().numpy(), dtype=np.float32)
        views, height, width = values.shape
        check_sampling(sampling, (height, width))
        return CpuMaskSet(views, (height, width), lay_out(values, sampling=sampling), sampling)

    def reuse(self) -> CpuReuse:
        """Share lists of Gaussians among renderings; see `Backend.reuse`."""
        return CpuReuse(self._list_pool, self._settings.relist_every, self._settings.list_margin_px)

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
        target, camera, kept = self._coded_job(scene, world_to_camera, intrinsics, mask_set, screen, reuse, times)
        colours = colours_of(scene, world_to_camera, times)
        (image,) = self._run(target, scene, colours, world_to_camera, camera, times, screen, kept)
        if not image.requires_grad:
            self._make_room(mask_set.views, mask_set.size)
        return image

    def coded_with_pull(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None = None,
        reuse: Reuse | None = None,
    ) -> tuple[F32, Pull]:
        """Render the coded sum, and differentiate it without a graph; see `AdjointBackend`."""
        target, camera, kept = self._coded_job(scene, world_to_camera, intrinsics, mask_set, screen, reuse, None)
        inputs = _inputs(scene, scene.means, world_to_camera, camera)
        lease = self._pool.lease()
        assert lease.workspace is not None
        rendered = render_cells(inputs, target.layout, self._settings.termination_transmittance, lease.workspace, kept)
        image = target.collect(rendered.cells)[0].numpy()

        def pull(gradient: F32) -> F32:
            workspace = lease.workspace
            if workspace is None:
                raise RuntimeError("one rendering was differentiated twice; render again for a second gradient")
            cells = target.spread_array(gradient, workspace)
            found = differentiate_cells(inputs, target.layout, rendered, cells, workspace)
            if screen is not None:
                screen.add(*torch.from_numpy(found.sightings).unbind(dim=1))
            lease.release()
            accumulate(scene, found.of_scene())
            return found.poses

        return image, pull

    def _coded_job(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        mask_set: MaskSet,
        screen: ScreenStatistics | None,
        reuse: Reuse | None,
        times: Tensor | None,
    ) -> tuple[CodedSum, F32, CpuReuse | None]:
        """Check what a coded sum is to be rendered from; return its cells, camera and lists that may be shared.

        Raises:
            InputError: See `Backend.coded`.
        """
        coded, kept = own_masks(mask_set, CpuMaskSet, self.name), own_reuse(reuse, CpuReuse, self.name)
        check_rendering(scene, world_to_camera, intrinsics, views=mask_set.views, times=times)
        check_screen(screen, scene)
        camera = _camera(on_canvas(intrinsics, coded.sampling), coded.layout)
        # Lists that serve once lie in the rendering's own workspace, without a margin.
        return CodedSum(coded.layout), camera, kept if self._settings.relist_every > 1 else None

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
        given = (*scene.parameters().values(), world_to_camera, *(() if colours is None else (colours,)))
        wanted = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in given)
        if not wanted and len(self._parts_with_room(int(world_to_camera.shape[0]), size)) > 1:
            return self._views_in_parts(scene, world_to_camera, intrinsics, size, colours, sampling, times)
        target = ViewImages(self._full_layout((int(world_to_camera.shape[0]), *size), sampling))
        used = colours_of(scene, world_to_camera, times) if colours is None else colours
        camera = _camera(on_canvas(intrinsics, sampling), target.layout)
        images, alphas = self._run(target, scene, used, world_to_camera, camera, times)
        return images, alphas

    def _views_in_parts(
        self,
        scene: Gaussians,
        world_to_camera: Tensor,
        intrinsics: Tensor,
        size: tuple[int, int],
        colours: Tensor | None,
        sampling: CanvasSampling | None,
        times: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        """Render views a few at a time, without a gradient."""
        count = int(world_to_camera.shape[0])
        images, alphas = torch.empty(count, *size, 3), torch.empty(count, *size)
        for part in self._parts_with_room(count, size):
            own = colours[part] if colours is not None and colours.ndim == 3 else colours
            when = None if times is None else times[part]
            images[part], alphas[part] = self.views(scene, world_to_camera[part], intrinsics, size, own, sampling, when)
        return images, alphas

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
        parts = self._parts_with_room(int(world_to_camera.shape[0]), size)
        if len(parts) > 1:
            found = StoppedLight(*torch.empty(len(fields(StoppedLight)), int(world_to_camera.shape[0]), *size))
            for part in parts:
                when = None if times is None else times[part]
                one = self.depths(scene, world_to_camera[part], intrinsics, size, sampling, when)
                for field in fields(StoppedLight):
                    getattr(found, field.name)[part] = getattr(one, field.name)
            return found
        layout = self._full_layout((int(world_to_camera.shape[0]), *size), sampling)
        camera = _camera(on_canvas(intrinsics, sampling), layout)
        means = _means(scene, times)
        lease = self._pool.lease()
        assert lease.workspace is not None
        inputs = _inputs(scene, means, world_to_camera, camera)
        rendered = render_cells(inputs, layout, self._settings.termination_transmittance, lease.workspace)
        places = (means, scene.log_scales, scene.quaternions, world_to_camera, on_canvas(intrinsics, sampling))
        told = depth_fields(*places, (layout.height, layout.width)).numpy()
        maps = stop_light(rendered.records, rendered.lists, layout, told)
        lease.release()
        return StoppedLight(*torch.from_numpy(maps))

    def _run(
        self,
        target: RenderTarget,
        scene: Gaussians,
        colours: Tensor,
        world_to_camera: Tensor,
        camera: F32,
        times: Tensor | None,
        screen: ScreenStatistics | None = None,
        reuse: CpuReuse | None = None,
    ) -> tuple[Tensor, ...]:
        parameters = (
            *(_means(scene, times), scene.log_scales, scene.quaternions),
            *(scene.opacity_logits, colours, world_to_camera),
        )
        job = Job(target, camera, self._settings.termination_transmittance, self._pool, screen, reuse)
        # Converted outside the function, so that float64 poses get float64 gradients.
        return Rasterise.apply(job, *(p.to(torch.float32) for p in parameters))

    def _parts_with_room(self, views: int, size: tuple[int, int]) -> list[slice]:
        """Make room, and divide views among renderings of at most `MOST_PIXELS_AT_ONCE`, but at least one view each."""
        at_once = self._make_room(views, size)
        return [slice(first, min(first + at_once, views)) for first in range(0, views, at_once)]

    def _make_room(self, views: int, size: tuple[int, int]) -> int:
        """Free what earlier renderings left if views are too many for one rendering; return how many are not."""
        at_once = max(1, MOST_PIXELS_AT_ONCE // (size[0] * size[1]))
        if at_once < views:
            self._pool.forget()
        return at_once

    def _full_layout(self, shape: tuple[int, int, int], sampling: CanvasSampling | None) -> Layout:
        key = (*shape, sampling)
        layout = self._full_layouts.pop(key, None)
        if layout is None:
            layout = lay_out(np.ones(shape, np.float32), sampling=sampling)
        self._full_layouts[key] = layout
        if len(self._full_layouts) > _FULL_LAYOUTS_KEPT:
            self._full_layouts.popitem(last=False)
        return layout


def _inputs(scene: Gaussians, means: Tensor, world_to_camera: Tensor, camera: F32) -> Inputs:
    """Return a scene with its centres where `means` says, and poses, as the kernels take them."""
    return Inputs(
        means=as_float32(means),
        log_scales=as_float32(scene.log_scales),
        quaternions=as_float32(scene.quaternions),
        logits=as_float32(scene.opacity_logits),
        colours=as_float32(scene.colours),
        poses=as_float32(world_to_camera),
        camera=camera,
    )


def _means(scene: Gaussians, times: Tensor | None) -> Tensor:
    """Return where centres are, [G, 3], or in each view, [V, G, 3], where they move."""
    return scene.means if times is None else scene.means_at(times)


def _camera(intrinsics: Tensor, layout: Layout) -> F32:
    return camera_fields(intrinsics.detach().to(torch.float64).numpy(), height=layout.height, width=layout.width)
