"""One coded exposure: light is integrated over time behind changing masks, counted, and read out.

Here: the integral over time, the read-out, and `expose`, which does both. Not here: effects and their order
(`light_path`), which of them are needed (`planner`), poses (`path`), masks (`masks`).

The forward model is the bench's, not the solver's: photons arrive at a rate while the camera moves, through the mask
that is shown at that moment, and one sensor collects them all. Nothing is imported from the solver.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.render.gaussians import Gaussians
from gs2ci_sims.effects.base import Effect, LightStage, ViewEffect, having
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import FullWell
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import ChargeNoise
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.effects.views import LensDistortion
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.moments import Moments, one_per_interval
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer, rendered_depth, with_margin
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.scene import Scene
from gs2ci_sims.signals import Slices, View, nominal_slices

# From this share of closed pixels on, rendering only the open ones is faster than rendering all.
CLOSED_SHARE_MIN: Final = 0.5


def expose(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    rig: RigFigures,
    *,
    effects: Sequence[Effect],
    seed: int,
    plan: Mapping[str, Any] | None = None,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> Shot:
    """Expose the sensor once to the scene behind the masks.

    Args:
        scene: The scene; its camera is the sensor's.
        path: The camera path; time 0 is the middle of the exposure.
        masks: Transmissions at the sensor's pixels, [N, H, W] in [0, 1], in the order shown.
        rig: The figures of light, modulator, timing and sensor.
        effects: The effects that are simulated; `planner.plan` chooses them.
        seed: Seed of all draws.
        plan: The plan by which `effects` were chosen (`planner.Plan.record`), to be stored with the shot.
        renderer: Renders the views.
        progress: Is called for each view.

    Returns:
        The shot, in units of one view's full scale, with true views and poses at the centre of each mask's interval,
        with camera and lens as from a perfect calibration, and with the pixels marked that may be clipped. Full scale
        includes the light that a ghost adds to an all-open mask on a flat field.

    Raises:
        InputError: Masks do not fit the scene or the rig.
        NumericsError: An effect gave readings that are not finite.
    """
    _check(scene, masks, rig)
    chain = EffectChain(effects, seed, rig)
    light = integrate(scene, path, masks, chain, renderer=renderer, progress=progress)
    reading = read_out(light.photons, chain)
    sensor = rig.sensor
    field = open_field(chain, scene.size)
    brightest = max(float(field.max()), 1.0)
    # Without light there is no scale; readings then stay in electrons.
    full_scale_e = rig.full_scale_e * brightest or 1.0
    return Shot(
        measurement=(sensor.electrons_from_dn(reading) / full_scale_e).astype(np.float32),
        # The measurement is not divided by the open field, so what that lacks (dust) belongs to the masks.
        masks=(calibrated_masks(light.masks, chain) * (field / brightest)).astype(np.float32),
        weights=light.weights.astype(np.float32),
        intrinsics=scene.intrinsics,
        distortion=None if (lens := lens_of(chain.effects)) is None else lens.coefficients,
        truth=Truth(light.truth_views, light.truth_world_to_camera, light.truth_depth),
        saturated=np.any(reading >= saturation_dn(chain), axis=2),
        cfa=next((effect.pattern for effect in chain.effects if isinstance(effect, BayerFilter)), None),
        name=scene.name,
        provenance={
            "source": "simulated exposure (gs2ci_sims)",
            "seed": seed,
            "effects": [f"{effect}" for effect in chain.effects],
            "rig": f"{rig}",
            "path": f"{path}",
            "rendered_views": light.rendered_views,
            "covered_share": light.covered_share,
            "within_mask": "moving" if _follows_motion(chain) else "still",
            **({"plan": dict(plan)} if plan is not None else {}),
        },
    ).check()


def _follows_motion(chain: EffectChain) -> bool:
    """Tell whether light is integrated over the camera's motion within masks, instead of one moment of each."""
    return any(isinstance(effect, MotionBlur) and (effect.nodes > 1 or effect.edges_s) for effect in chain.effects)


@dataclass(frozen=True)
class ExposureLight:
    """The light that reached the sensor.

    Args:
        photons: Mean number in each pixel, [H, W, 3].
        masks: The masks as imaged onto the sensor, [N, H, W].
        weights: Share of its nominal interval during which each mask was exposed, [N]; that of row 0 if rows differ.
        truth_views: The scene at the middle of each mask's nominal interval, through a sharp lens with this one's
            distortion, [N, H, W, 3] float32, radiance.
        truth_world_to_camera: The camera's poses at these moments, [N, 4, 4].
        covered_share: Smallest share of pixels that see the scene, over these moments.
        rendered_views: How many views were rendered.
        find_depth: Computes `truth_depth`.
    """

    photons: F64
    masks: NDArray[Any]
    weights: F64
    truth_views: F32
    truth_world_to_camera: F64
    covered_share: float
    rendered_views: int
    find_depth: Callable[[], F32] = field(repr=False, compare=False)

    @cached_property
    def truth_depth(self) -> F32:
        """Get the depth along the optical axis at these moments, through this lens, [N, H, W] float32.

        It is 0 where less than half of the light is absorbed. It is computed only on request: a bench integrates
        hundreds of exposures whose depth is never used, and computing it took most of their time.
        """
        return self.find_depth()


def integrate(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    chain: EffectChain,
    *,
    slices: Slices | None = None,
    moments: Moments | None = None,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> ExposureLight:
    """Integrate light over time, behind each mask while it is shown.

    Args:
        scene: The scene.
        path: The camera path, before effects.
        masks: The nominal masks, [N, H, W].
        chain: Effects; all stages up to PHOTONS act here.
        slices: When which mask is shown, before effects; None takes the rig's timing.
        moments: When views are rendered; None takes the moments of the chain's motion blur.
        renderer: Renders the views.
        progress: Is called for each view.

    Raises:
        InputError: The sensor's window misses all masks.
    """
    intervals = chain.rig.timing.intervals_s(len(masks))
    path = chain.through(LightStage.MOTION, path)
    slices = chain.through(LightStage.TIME, slices or nominal_slices(intervals)).cut_by_rows(scene.size[0])
    weights = _first_row_s(slices) @ slices.mix / chain.rig.timing.interval_s
    if not weights.any():
        raise InputError(
            "the sensor's window misses all masks", remedy="reduce the trigger's latency and jitter, or expose longer"
        )
    moments = moments or chain.through(LightStage.MOMENTS, one_per_interval(intervals))
    shown = chain.through(LightStage.MASKS, masks)
    studio = Studio(scene, path, chain, renderer or Renderer())
    progress = progress or Silent()
    stands_for = moments.weights_s(slices) * chain.rig.photons_per_s
    truth_share = moments.interpolation(intervals.mean(axis=1))
    truth_share[np.abs(truth_share) < 1e-12] = 0.0  # a moment that is a node needs no other: the rest is rounding
    needed = np.flatnonzero(np.any(stands_for != 0, axis=1) | np.any(truth_share != 0, axis=0))
    progress.stage("exposure", len(needed))
    photons = np.zeros((*scene.size, 3))
    truth_views = np.zeros((len(masks), *scene.size, 3))
    coverage = np.zeros((len(masks), *scene.size))
    for done, k in enumerate(needed):
        share = _open_share(stands_for[k], slices, shown)
        if not truth_share[:, k].any() and studio.can_skip(share):
            photons += studio.behind(share, float(moments.times_s[k]))
            progress.step(done + 1)
            continue
        bare, covered, view = studio.view(float(moments.times_s[k]))
        photons += share[..., None] * view
        for n in np.flatnonzero(truth_share[:, k]):
            truth_views[n] += truth_share[n, k] * bare
            coverage[n] += truth_share[n, k] * covered
        progress.step(done + 1)
    centres_s = intervals.mean(axis=1)
    # Rounding may give negative light: where the weights of moments cancel, and beside it by convolutions with large
    # kernels, which go through a Fourier transform.
    photons = np.maximum(chain.through(LightStage.PHOTONS, np.maximum(photons, 0)), 0)
    return ExposureLight(
        photons,
        shown,
        weights,
        np.maximum(truth_views, 0).astype(np.float32),
        path.world_to_camera(centres_s),
        float((coverage >= 0.99).mean(axis=(1, 2)).min()),
        len(needed),
        lambda: studio.depths(centres_s),
    )


def _first_row_s(slices: Slices) -> F64:
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

    def view(self, time_s: float) -> tuple[F64, F64, F64]:
        """Return the scene's radiance [H, W, 3], its coverage [H, W], and the radiance that meets the modulator.

        The first two are without blur and fall-off, at the places where the lens images them.
        """
        scene, margin = self._scene, self._margin
        pose = self._path.world_to_camera(np.array([time_s]))
        gaussians = self._moving(time_s)
        radiance, coverage = self._renderer.views(scene, pose, gaussians=gaussians, margin=margin)
        bare = radiance[0].astype(np.float64)
        intrinsics = with_margin(scene.intrinsics, margin)
        depth = None
        if self._needs_depth:
            depth = self._renderer.depth(scene, pose[0], gaussians=gaussians, margin=margin)
        seen = self._chain.through(LightStage.RADIANCE, View(bare, intrinsics, margin, depth)).radiance
        truth = np.concatenate([bare, coverage[0][..., None]], axis=2)
        truth = truth if self._lens is None else self._lens.bent(truth, intrinsics)
        height, width = scene.size
        inner = np.s_[margin : margin + height, margin : margin + width]
        return truth[inner][..., :-1], truth[inner][..., -1], seen[inner]

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
        return np.asarray(depth[margin : margin + scene.size[0], margin : margin + scene.size[1]])

    def can_skip(self, open_share: F64) -> bool:
        """Return whether skipping the closed pixels [H, W] gives the same light and saves work."""
        plain = not self._chain.at(LightStage.RADIANCE) and self._renderer.skips
        plain = plain and self._scene.mesh is None
        return plain and open_share.min() >= 0 and float((open_share == 0).mean()) >= CLOSED_SHARE_MIN

    def behind(self, open_share: F64, time_s: float) -> F64:
        """Return the view behind a mask, [H, W, 3], with only the open pixels rendered."""
        pose = self._path.world_to_camera(np.array([time_s]))
        return self._renderer.masked(self._scene, pose, open_share, gaussians=self._moving(time_s))


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


def saturation_dn(chain: EffectChain) -> float:
    """Return the reading from which on a pixel may be clipped: what a full well reads at least, or the converter's top.

    Full pixels scatter by rounding and by all that is added behind the well; four standard deviations of read noise,
    row noise and offsets together include all but one in 30 000.
    """
    sensor = chain.rig.sensor
    capacity_e = next(
        (effect.capacity_e for effect in chain.effects if isinstance(effect, FullWell)), sensor.full_well_e
    )
    noise_e = math.hypot(*(effect.sigma_e for effect in chain.effects if isinstance(effect, ChargeNoise)))
    steady = [effect for effect in chain.effects if isinstance(effect, GainNonlinearity | BlackLevel)]
    behind = EffectChain(steady, chain.seed, chain.rig)
    charge = behind.through(LightStage.CHARGE, np.full((1, 1, 1), capacity_e))
    full_dn = float(behind.through(LightStage.READOUT, sensor.dn_from_electrons(charge))[0, 0, 0])
    top_dn = next((effect.max_dn for effect in chain.effects if isinstance(effect, Quantisation)), 2**sensor.bits - 1)
    return min(full_dn - 4 * noise_e * chain.rig.dn_per_e - 0.5, float(top_dn))


def _check(scene: Scene, masks: F32, rig: RigFigures) -> None:
    if masks.ndim != 3 or masks.shape[1:] != scene.size:
        raise InputError(
            f"masks of shape {list(masks.shape)} on a sensor of {list(scene.size)}",
            allowed=f"[N, {scene.size[0]}, {scene.size[1]}]",
        )
    if len(masks) != rig.modulator.masks:
        raise InputError(
            f"{len(masks)} masks on a rig that shows {rig.modulator.masks}",
            remedy="set [modulator] masks of the rig to the number of masks",
        )
