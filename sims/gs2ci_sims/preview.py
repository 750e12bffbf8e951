"""What the planner and the bounds know of a measurement before it is simulated: one quick look. For effects.

A preview renders a few views along the path (no more than `MOMENTS`), and derives from them, the masks and the rig's
figures what every bound needs: the charge that each pixel collects, gradients, motion. Its numbers are those of the
nominal light path: everything off. Not here: any effect.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Rig
from gs2ci_sims.scenes.base import Scene

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Begin, middle and end of the exposure.
MOMENTS: Final = 3


@dataclass(frozen=True)
class Preview:
    """One quick look at a measurement.

    Args:
        scene: What is seen.
        path: Where the camera is at any time, as nominally planned.
        masks: As nominally shown, at the sensor's pixels, [N, H, W].
        rig: The figures.
        times_s: Moments of the views, [P].
        views: [P, H, W, 3], radiance, full scale 1.
    """

    scene: Scene
    path: CameraPath
    masks: F32
    rig: Rig
    times_s: F64
    views: F64

    @cached_property
    def intervals_s(self) -> F64:
        """Get start and stop of the mask intervals, [N, 2]."""
        return self.rig.timing.intervals_s(len(self.masks))

    @cached_property
    def open_time_s(self) -> F64:
        """Get for how long each pixel is open, weighted by transmission, [H, W]."""
        total: F64 = self.masks.sum(axis=0, dtype=np.float64) * self.rig.timing.interval_s
        return total

    @cached_property
    def charge_e(self) -> F64:
        """Get the most that each pixel collects if nothing moved away from it: brightest view, [H, W, 3]."""
        rate_e = self.rig.photons_per_s * self.rig.sensor.quantum_efficiency
        return np.asarray(rate_e * self.open_time_s[..., None] * self.views.max(axis=0))

    @cached_property
    def signal_dn(self) -> F64:
        """Get the readings above black that belong to `charge_e`, unclipped, [H, W, 3]."""
        return self.charge_e * self.rig.dn_per_e


def preview(scene: Scene, path: CameraPath, masks: F32, rig: Rig, renderer: Renderer | None = None) -> Preview:
    """Take a quick look: render the views at the begin, middle and end of the exposure."""
    intervals = rig.timing.intervals_s(len(masks))
    times = np.linspace(intervals[0, 0], intervals[-1, 1], MOMENTS)
    views, _ = (renderer or Renderer()).views(scene, path.world_to_camera(times))
    return Preview(scene, path, masks, rig, times, views.astype(np.float64))
