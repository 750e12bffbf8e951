"""The simulation of everything: every effect, and time sampled ever more finely until nothing changes.

It is what plans are measured against, in tests and in `python -m tests.tables simulate`. Each mask interval is cut
into equal parts, each of which is rendered at its middle (the midpoint rule), with twice as many parts again and
again. Not here: the light path itself (`exposure`), which is the same for both.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import NumericsError
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import ShotNoise
from gs2ci_sims.effects.readout import Quantisation
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.moments import Moments
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.scene import Scene

PARTS_MAX: Final = 1024
# Counting and rounding: what the tolerance of a plan is stated before.
GRAIN: Final = (ShotNoise.name, Quantisation.name)


@dataclass(frozen=True)
class BruteForce:
    """What the full simulation gave.

    Args:
        photons: Mean number in each pixel, [H, W, 3].
        chain: All effects.
        parts: Views per mask at which nothing changed any more.
        views: Rendered for that, the coarser rounds not counted.
        seconds: What these took.
        all_seconds: What all rounds took, as nobody knows beforehand which one is the last.
    """

    photons: F64
    chain: EffectChain
    parts: int
    views: int
    seconds: float
    all_seconds: float


def simulate_everything(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    rig: RigFigures,
    effects: Sequence[Effect],
    *,
    seed: int,
    settle_dn: float = 0.01,
    renderer: Renderer | None = None,
) -> BruteForce:
    """Simulate every effect, with twice as many views until the readings change by less than `settle_dn` rms.

    Raises:
        NumericsError: They still change with `PARTS_MAX` views per mask.
    """
    chain = EffectChain([effect for effect in effects if not isinstance(effect, MotionBlur)], seed, rig)
    intervals = rig.timing.intervals_s(len(masks))
    before: F64 | None = None
    parts, all_seconds = 1, 0.0
    while parts <= PARTS_MAX:
        started = time.perf_counter()
        moments = _even(intervals, parts)
        photons = integrate(scene, path, masks, chain, moments=moments, renderer=renderer)
        seconds = time.perf_counter() - started
        all_seconds += seconds
        scale = rig.sensor.quantum_efficiency * rig.dn_per_e
        if before is not None and scale * np.sqrt(np.square(photons - before).mean()) <= settle_dn:
            return BruteForce(photons, chain, parts, len(moments.times_s), seconds, all_seconds)
        before, parts = photons, 2 * parts
    raise NumericsError(
        f"the readings still change by more than {settle_dn} DN with {PARTS_MAX} views per mask",
        remedy="slow the camera down or raise settle_dn",
    )


def deviation_dn(brute: BruteForce, photons: F64, simulated: Sequence[Effect], seed: int) -> float:
    """Return by how much a simulation's readings differ from the full one's before counting and rounding, DN rms.

    Args:
        brute: The full simulation.
        photons: Of the other one, [H, W, 3].
        simulated: Effects of the other one; noises that it left out count with what they draw.
        seed: Of both.
    """
    common = {effect.name for effect in simulated} & set(GRAIN)
    rig = brute.chain.rig
    full = EffectChain([effect for effect in brute.chain.effects if effect.name not in common], seed, rig)
    less = EffectChain([effect for effect in simulated if effect.name not in common], seed, rig)
    difference = read_out(photons, less) - read_out(brute.photons, full)
    return float(np.sqrt(np.square(difference).mean()))


def _even(intervals_s: F64, parts: int) -> Moments:
    """Return the middles of equal parts of each interval; a part reaches on into the gap that follows."""
    within = intervals_s[:, :1] + np.diff(intervals_s, axis=1) * np.linspace(0, 1, parts + 1)
    edges = within.ravel()
    keep = np.concatenate([[True], np.diff(edges) > 1e-9 * (edges[-1] - edges[0])])
    return Moments(edges[keep], 1)
