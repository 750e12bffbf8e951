"""Any renderer, behind a lens: its images are the sensor's, and whoever renders need not know.

Here: the wrapper that tells a backend where the sensor's pixels look. Not here: the lens (`reconstruct.lens`), the
rendering (`gs2ci.render`). For `gs2ci.reconstruct.pipeline`.
"""

from dataclasses import dataclass

from torch import Tensor

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend, MaskSet, Reuse
from gs2ci.render.sampling import CanvasSampling
from gs2ci.render.screen import ScreenStatistics
from gs2ci.render.stopping import StoppedLight


@dataclass(frozen=True)
class ThroughLens:
    """A backend whose images are bent by a lens.

    Args:
        backend: The renderer.
        lens: What it looks through; camera matrices are then those of the pinhole in the sensor's pixels.
    """

    backend: Backend
    lens: Lens

    @property
    def name(self) -> str:
        """Get the renderer's name."""
        return self.backend.name

    def code(self, masks: Tensor, sampling: CanvasSampling | None = None) -> MaskSet:
        """Prepare a mask set; see `Backend.code`."""
        return self.backend.code(masks, self._only(sampling))

    def reuse(self) -> Reuse:
        """Return what renderings may share; see `Backend.reuse`."""
        return self.backend.reuse()

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
        return self.backend.coded(scene, world_to_camera, intrinsics, mask_set, screen, reuse, times)

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
        return self.backend.views(scene, world_to_camera, intrinsics, size, colours, self._only(sampling), times)

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
        return self.backend.depths(scene, world_to_camera, intrinsics, size, self._only(sampling), times)

    def _only(self, sampling: CanvasSampling | None) -> CanvasSampling:
        if sampling is not None:
            raise InputError("places of pixels are given to a renderer that has a lens", remedy="leave them out")
        return self.lens.sampling


def through(lens: Lens | None, backend: Backend) -> Backend:
    """Put a lens before a renderer; without one it is as it was."""
    return backend if lens is None else ThroughLens(backend, lens)
