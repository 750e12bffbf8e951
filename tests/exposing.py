"""One coded exposure of a scene, without a bench: what `gs2ci capture` does behind drivers and twins, by one call."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, Truth
from gs2ci_sims.effects.base import Effect, LightStage
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import FullWell
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import ChargeNoise
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.exposure import Studio, calibrated_masks, first_row_s, integrate, lens_of, open_field, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.scene import Scene
from gs2ci_sims.signals import nominal_slices


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
    reading = read_out(integrate(scene, path, masks, chain, renderer=renderer), chain)
    sensor = rig.sensor
    field = open_field(chain, scene.size)
    brightest = max(float(field.max()), 1.0)
    # Without light there is no scale; readings then stay in electrons.
    full_scale_e = rig.full_scale_e * brightest or 1.0
    intervals = rig.timing.intervals_s(len(masks))
    moved, centres_s = chain.through(LightStage.MOTION, path), intervals.mean(axis=1)
    studio = Studio(scene, moved, chain, renderer or Renderer())
    sharp = np.stack([studio.sharp_view(float(time_s)) for time_s in centres_s]).astype(np.float32)
    seen = calibrated_masks(chain.through(LightStage.MASKS, masks), chain)
    return Shot(
        measurement=((reading - sensor.black_level_dn) * sensor.electrons_per_dn / full_scale_e).astype(np.float32),
        # The measurement is not divided by the open field, so what that lacks (dust) belongs to the masks.
        masks=(seen * (field / brightest)).astype(np.float32),
        weights=weights_of(chain, intervals, scene.size[0]).astype(np.float32),
        intrinsics=scene.intrinsics,
        distortion=None if (lens := lens_of(chain.effects)) is None else lens.coefficients,
        truth=Truth(sharp, moved.world_to_camera(centres_s), studio.depths(centres_s)),
        saturated=np.any(reading >= saturation_dn(chain), axis=2),
        cfa=next((effect.pattern for effect in chain.effects if isinstance(effect, BayerFilter)), None),
        name=scene.name,
        provenance={
            "source": "simulated exposure (gs2ci_sims)",
            "seed": seed,
            "effects": [f"{effect}" for effect in chain.effects],
            "rig": f"{rig}",
            "path": f"{path}",
            "within_mask": "moving" if _follows_motion(chain) else "still",
            **({"plan": dict(plan)} if plan is not None else {}),
        },
    ).check()


def weights_of(chain: EffectChain, intervals: F64, rows: int) -> F64:
    """Return for which share of its interval each mask was exposed, [N]; that of row 0 if rows differ."""
    slices = chain.through(LightStage.TIME, nominal_slices(intervals)).cut_by_rows(rows)
    return first_row_s(slices) @ slices.mix / chain.rig.timing.interval_s


def _follows_motion(chain: EffectChain) -> bool:
    """Tell whether light is integrated over the camera's motion within masks, instead of one moment of each."""
    return any(isinstance(effect, MotionBlur) and (effect.nodes > 1 or effect.edges_s) for effect in chain.effects)


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
