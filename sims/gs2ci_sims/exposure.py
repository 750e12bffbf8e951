"""One coded exposure: light is integrated over time behind changing masks, counted, and read out.

Here: the integral over time, and the read-out. Not here: effects and their order
(`light_path`), which of them are needed (`planner`), poses (`path`), masks (`masks`).

The forward model is the bench's, not the solver's: photons arrive at a rate while the camera moves, through the mask
that is shown at that moment, and one sensor collects them all. Nothing is imported from the solver.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.effects.base import Effect, LightStage, ViewEffect, having
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.moments import Moments, one_per_interval
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer, rendered_depth, with_margin
from gs2ci_sims.scene import Scene
from gs2ci_sims.signals import Slices, View, nominal_slices


def integrate(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    chain: EffectChain,
    *,
    slices: Slices | None = None,
    moments: Moments | None = None,
    renderer: Renderer | None = None,
) -> F64:
    """Integrate light over time, behind each mask while it is shown.

    Args:
        scene: The scene.
        path: The camera path, before effects.
        masks: The nominal masks, [N, H, W].
        chain: Effects; all stages up to PHOTONS act here.
        slices: When which mask is shown, before effects; None takes the rig's timing.
        moments: When views are rendered; None takes the moments of the chain's motion blur.
        renderer: Renders the views.

    Returns:
        The mean number of photons that reach each pixel, [H, W, 3].

    Raises:
        InputError: The sensor's window misses all masks.
    """
    intervals = chain.rig.timing.intervals_s(len(masks))
    slices = chain.through(LightStage.TIME, slices or nominal_slices(intervals)).cut_by_rows(scene.size[0])
    if not (first_row_s(slices) @ slices.mix).any():
        raise InputError(
            "the sensor's window misses all masks", remedy="reduce the trigger's latency and jitter, or expose longer"
        )
    moments = moments or chain.through(LightStage.MOMENTS, one_per_interval(intervals))
    shown = chain.through(LightStage.MASKS, masks)
    studio = Studio(scene, chain.through(LightStage.MOTION, path), chain, renderer or Renderer())
    photons = np.zeros((*scene.size, 3))
    stands_for = moments.weights_s(slices) * chain.rig.photons_per_s
    for k in np.flatnonzero(stands_for.any(axis=1)):
        photons += _open_share(stands_for[k], slices, shown)[..., None] * studio.view(float(moments.times_s[k]))
    # Rounding may give negative light: where the weights of moments cancel, and beside it by convolutions with large
    # kernels, which go through a Fourier transform.
    return np.maximum(chain.through(LightStage.PHOTONS, np.maximum(photons, 0)), 0)


def first_row_s(slices: Slices) -> F64:
    """Return for how much of each slice the first row of the sensor collects light, [S] seconds."""
    if slices.shutter is None:
        return slices.duration_s
    return slices.duration_s * slices.shutter.open_share(slices.start_s, slices.stop_s, 1)[:, 0]


def _open_share(weights: F64, slices: Slices, masks: NDArray[Any]) -> F64:
    """Return the share of a view with `weights` [S] in the slices that passes the masks at each pixel, [H, W]."""
    mixed = weights[:, None] * slices.mix
    if slices.shutter is None:
        return np.tensordot(mixed.sum(axis=0), masks, axes=1)
    rows = slices.shutter.open_share(slices.start_s, slices.stop_s, masks.shape[1])
    return np.einsum("nh,nhw->hw", mixed.T @ rows, masks)


class Studio:
    """Renders views of a scene along a path, with the effects between scene and modulator.

    Args:
        scene: The scene.
        path: The camera path.
        chain: Effects; those of the stages SCENE and RADIANCE act here.
        renderer: Renders the views.
    """

    def __init__(self, scene: Scene, path: CameraPath, chain: EffectChain, renderer: Renderer) -> None:
        def at_rest(_time_s: float) -> Gaussians:
            return scene.gaussians

        self._scene, self._path, self._chain, self._renderer = scene, path, chain, renderer
        self._moving = chain.through(LightStage.SCENE, at_rest)
        looking = having(chain.at(LightStage.RADIANCE), ViewEffect)
        self._margin = chain.margin_px(scene.size, scene.intrinsics)
        self._lens = lens_of(looking)
        self._needs_depth = any(effect.needs_depth for effect in looking)

    def view(self, time_s: float) -> F64:
        """Return the radiance that meets the modulator, [H, W, 3]."""
        scene, margin = self._scene, self._margin
        depth = None
        if self._needs_depth:
            pose, gaussians = self._path.world_to_camera(np.array([time_s]))[0], self._moving(time_s)
            depth = self._renderer.depth(scene, pose, gaussians=gaussians, margin=margin)
        bare = View(self._drawn(time_s), with_margin(scene.intrinsics, margin), margin, depth)
        return self._inner(self._chain.through(LightStage.RADIANCE, bare).radiance)

    def sharp_view(self, time_s: float) -> F64:
        """Return the scene's radiance without blur and fall-off, [H, W, 3], at the places where the lens images it."""
        bare = self._drawn(time_s)
        bent = bare if self._lens is None else self._lens.bent(bare, with_margin(self._scene.intrinsics, self._margin))
        return self._inner(bent)

    def _drawn(self, time_s: float) -> F64:
        """Return the scene's radiance with a margin, [H + 2 margin, W + 2 margin, 3]."""
        pose = self._path.world_to_camera(np.array([time_s]))
        views, _ = self._renderer.views(self._scene, pose, gaussians=self._moving(time_s), margin=self._margin)
        return views[0].astype(np.float64)

    def _inner(self, image: F64) -> F64:
        """Return an image without its margin."""
        height, width = self._scene.size
        return image[self._margin : self._margin + height, self._margin : self._margin + width]

    def depths(self, times_s: F64) -> F32:
        """Return the depth seen through the lens at some times, [T, H, W]; 0 at pixels without a surface.

        It takes several times as long as a view, so it is computed once if neither camera nor scene has moved.
        """
        found: list[F32] = []
        poses = self._path.world_to_camera(times_s)
        seen = [self._moving(float(time_s)) for time_s in times_s]
        for number, time_s in enumerate(times_s):
            same = number > 0 and seen[number] is seen[number - 1] and np.array_equal(poses[number], poses[number - 1])
            found.append(found[-1] if same else self.depth(float(time_s)))
        return np.stack(found)

    def depth(self, time_s: float) -> F32:
        """Return the depth seen through the lens, [H, W]; 0 at pixels without a surface."""
        scene = self._scene
        pose = self._path.world_to_camera(np.array([time_s]))[0]
        if scene.mesh is not None:
            depth = self._depth_of_mesh(pose)
        else:
            sampling = None if self._lens is None else self._lens.sampling(scene.size, scene.intrinsics)
            depth = rendered_depth(self._moving(time_s), pose, scene.intrinsics, scene.size, sampling)
        return np.nan_to_num(depth, nan=0.0).astype(np.float32)

    def _depth_of_mesh(self, pose: F64) -> F64:
        """Return the depth of a mesh from a pose [4, 4], [H, W]; through a lens, that of the nearest ray."""
        scene, margin = self._scene, self._margin
        depth = self._renderer.depth(scene, pose, margin=margin)
        if self._lens is not None:
            places = self._lens.sources_px(depth.shape, with_margin(scene.intrinsics, margin)) - 0.5
            depth = map_coordinates(depth, places, order=0, mode="nearest")
        return self._inner(depth)


def lens_of(effects: Sequence[Effect]) -> LensDistortion | None:
    """Return the lens among effects that bends straight lines, if there is one."""
    return next((effect for effect in effects if isinstance(effect, LensDistortion)), None)


def open_field(chain: EffectChain, size: tuple[int, int]) -> F64:
    """Return the light of an all-open mask on a flat field, over that without effects on photons, [H, W]."""
    return np.asarray(chain.through(LightStage.PHOTONS, np.ones((*size, 1)))[..., 0])


def calibrated_masks(masks: NDArray[Any], chain: EffectChain) -> F32:
    """Return the masks as a noiseless calibration measures them, [N, H, W].

    Each alone on a flat field, over the same field behind an all-open mask; 0 where that is dark.
    """
    if not chain.at(LightStage.PHOTONS):
        return np.asarray(np.clip(masks, 0, 1), dtype=np.float32)
    field = open_field(chain, masks.shape[1:])
    lit = field > 0
    seen = np.stack([chain.through(LightStage.PHOTONS, mask[..., None].astype(np.float64))[..., 0] for mask in masks])
    return np.asarray(np.clip(np.where(lit, seen, 0) / np.where(lit, field, 1), 0, 1), dtype=np.float32)


def read_out(photons: F64, chain: EffectChain) -> F64:
    """Count the photons and convert them to readings, [H, W, C] DN, through the sensor's effects in the chain.

    Raises:
        NumericsError: An effect gave readings that are not finite.
    """
    sensor = chain.rig.sensor
    charge = chain.through(LightStage.CHARGE, sensor.quantum_efficiency * photons)
    reading = chain.through(LightStage.READOUT, sensor.dn_from_electrons(charge))
    if not np.isfinite(reading).all():
        raise NumericsError(
            f"{np.count_nonzero(~np.isfinite(reading))} simulated readings are not finite, through the effects "
            f"{', '.join(effect.name for effect in chain.effects) or 'none'}",
            allowed="finite readings",
            remedy="leave effects out, those of plug-ins first, to find the one that gives them",
        )
    return reading
